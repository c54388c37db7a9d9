// Which instructions the kernels use. All give the same bits.
#pragma once
#include <string_view>

namespace lockstep::dem {

enum class InstructionSet { Generic, Avx2, Avx512 };

// The best that this machine has.
InstructionSet best_instructions();
// Names: generic, avx2, avx512. InputError, naming those that this machine has, when it lacks it.
InstructionSet instructions_by_name(std::string_view name);
std::string_view name_of(InstructionSet set);

}  // namespace lockstep::dem
