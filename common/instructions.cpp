#include "common/instructions.hpp"

#include <array>
#include <utility>

#include "common/checks.hpp"

namespace lockstep {

namespace {

constexpr std::array<std::pair<std::string_view, InstructionSet>, 3> names = {
    {{"generic", InstructionSet::Generic}, {"avx2", InstructionSet::Avx2}, {"avx512", InstructionSet::Avx512}}};

bool has(InstructionSet set) {
#if !defined(LOCKSTEP_GENERIC_KERNELS_ONLY)
  const bool has_avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  if (set == InstructionSet::Avx2) return has_avx2;
  if (set == InstructionSet::Avx512)
    return has_avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
#endif
  return set == InstructionSet::Generic;
}

}  // namespace

std::vector<InstructionSet> known_instructions() {
  std::vector<InstructionSet> sets;
  for (const auto& [name, set] : names)
    if (has(set)) sets.push_back(set);
  return sets;
}

InstructionSet best_instructions() { return known_instructions().back(); }

InstructionSet instructions_by_name(std::string_view name) {
  std::string here;
  for (const InstructionSet set : known_instructions()) {
    if (name_of(set) == name) return set;
    here += (here.empty() ? "" : ", ") + std::string(name_of(set));
  }
  throw InputError(fmt::format("instructions {}: no such set on this machine; it has {}", name, here));
}

std::string_view name_of(InstructionSet set) {
  for (const auto& [name, is] : names)
    if (is == set) return name;
  return "";
}

}  // namespace lockstep
