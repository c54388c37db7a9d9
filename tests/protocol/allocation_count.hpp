// Counts what this thread takes from the heap, to prove that a hot path takes nothing.
#pragma once
#include <cstddef>

namespace lockstep {

std::size_t allocation_count();

}  // namespace lockstep
