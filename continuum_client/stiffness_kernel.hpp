// f = reference + K u, eight nodes at a time (stiffness_product.hpp has the formats). Compiled once for each instruction
// set, with the same bits: products and sums of single doubles in one order, no contraction.
#pragma once
#include <cstdint>

namespace lockstep {
enum class InstructionSet;  // common/instructions.hpp
}

namespace lockstep::continuum {

// Consecutive nodes whose neighbours stand at the same offsets.
struct StiffnessRun {
  std::int32_t first = 0;  // node
  std::int32_t nodes = 0;
  std::int32_t neighbours = 0;  // offsets, one block each
  std::int32_t offset = 0;      // where its offsets begin
  std::int64_t block = 0;       // where its blocks begin, in doubles
};

// A vector a node, by component. Eight entries beyond the last node may be read and written.
struct Components {
  double *x, *y, *z;
};

struct StiffnessKernel {
  // to[i - begin] = from[3 i ..] for nodes begin .. end.
  void (*split)(const double* from, std::int32_t begin, std::int32_t end, const Components& to);

  // Whole rows, one block an offset for all nodes of a run: f[3 i ..] = reference[3 i ..] + sum_j K_ij u_j.
  void (*shared_rows)(const StiffnessRun* runs, std::int32_t count, const std::int32_t* offsets, const double* blocks,
                      const Components& u, const double* reference, double* f);

  // Upper half rows, each node with its own blocks: f_i += K_ij u_j and f_j += K_ij^T u_i. The first offset is zero.
  // Blocks of eight nodes lie interleaved, those of runs shorter than `fewest_lanes` one after the other. f_i is
  // at f.x[i - f_begin] and so on.
  void (*half_rows)(const StiffnessRun* runs, std::int32_t count, const std::int32_t* offsets, const double* blocks,
                    const Components& u, const Components& f, std::int32_t f_begin);

  // f[3 i ..] = reference[3 i ..] + sum over the `count` parts of part[i - part_begin], for nodes begin .. end.
  void (*join)(const double* reference, const Components* part, const std::int32_t* part_begin, std::int32_t count,
               std::int32_t begin, std::int32_t end, double* f);
};

constexpr std::int32_t nodes_at_once = 8;
constexpr std::int32_t fewest_lanes = 4;

StiffnessKernel stiffness_kernel(InstructionSet set);
StiffnessKernel stiffness_kernel_generic();
StiffnessKernel stiffness_kernel_avx2();
StiffnessKernel stiffness_kernel_avx512();

}  // namespace lockstep::continuum
