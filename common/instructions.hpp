// Which instructions the kernels use. All give the same bits.
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
