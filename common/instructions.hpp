// Which instructions the kernels use. AVX2 and AVX-512 give the same bits; so does the generic set but for the grains,
// whose kernels round products and their sums once where they can (multiply_add() in lanes.hpp).
#pragma once
#include <string_view>
#include <vector>

namespace lockstep {

enum class InstructionSet { Generic, Avx2, Avx512 };

// Those of this machine, the best last.
std::vector<InstructionSet> known_instructions();
InstructionSet best_instructions();
// Names: generic, avx2, avx512. InputError, naming those that this machine has, when it lacks it.
InstructionSet instructions_by_name(std::string_view name);
std::string_view name_of(InstructionSet set);

}  // namespace lockstep

// A kernel that lockstep_kernels() compiles once for each set: name_generic, name_avx2 and name_avx512, or the first alone
// where the compiler's machine has no others.
#if defined(LOCKSTEP_GENERIC_KERNELS_ONLY)
#define LOCKSTEP_KERNEL_FOR(set, name) (static_cast<void>(set), name##_generic)
#else
#define LOCKSTEP_KERNEL_FOR(set, name)                         \
  ((set) == ::lockstep::InstructionSet::Avx512 ? name##_avx512 \
   : (set) == ::lockstep::InstructionSet::Avx2 ? name##_avx2   \
                                               : name##_generic)
#endif
