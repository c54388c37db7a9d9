#include "dem_server/instructions.hpp"

#include <array>
#include <utility>

#include "common/checks.hpp"

namespace lockstep::dem {

namespace {

constexpr std::array<std::pair<std::string_view, InstructionSet>, 3> names = {
    {{"generic", InstructionSet::Generic}, {"avx2", InstructionSet::Avx2}, {"avx512", InstructionSet::Avx512}}};

bool has(InstructionSet set) {
#if !defined(LOCKSTEP_GENERIC_KERNELS_ONLY)
  if (set == InstructionSet::Avx2) return __builtin_cpu_supports("avx2");
  if (set == InstructionSet::Avx512)
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
#endif
  return set == InstructionSet::Generic;
}

}  // namespace

InstructionSet best_instructions() {
  for (const InstructionSet set : {InstructionSet::Avx512, InstructionSet::Avx2})
    if (has(set)) return set;
  return InstructionSet::Generic;
}

InstructionSet instructions_by_name(std::string_view name) {
  std::string here;
  for (const auto& [known, set] : names) {
    if (!has(set)) continue;
    if (known == name) return set;
    here += (here.empty() ? "" : ", ") + std::string(known);
  }
  throw InputError(fmt::format("instructions {}: no such set on this machine; it has {}", name, here));
}

std::string_view name_of(InstructionSet set) {
  for (const auto& [name, is] : names)
    if (is == set) return name;
  return "";
}

}  // namespace lockstep::dem
