// f = reference + K u, arranged for the machine, with the same bits for any number of threads and any instruction set.
//
// A zone deforms its nodes' neighbours in a column of alike zones in just the same way, so nodes of one column share
// their whole row of blocks. Two formats, chosen by what they must read:
//
//   shared rows   runs of consecutive nodes with equal rows: 27 blocks for the whole run, both halves. Eight nodes at a
//                 time, blocks as broadcasts. An extruded mesh of 20,000 zones needs 7 MB instead of 25; each node's sum
//                 is its own, so threads share out the runs.
//   half rows     any mesh: the upper half, each block once, f_i += K_ij u_j and f_j += K_ij^T u_i. Nodes of equal
//                 offsets are taken eight at a time with interleaved blocks. Chunks of nodes, whose borders depend on the
//                 matrix alone, gather into memory of their own; the parts are added in the order of chunks.
//
// Rejected: zone kernels (twice the arithmetic and a gather and a scatter of 24 numbers a zone), whole rows for any mesh
// (twice the memory to read), single precision (weights of nodes off by 1e-4).
#pragma once
#include <cstdint>
#include <vector>

#include "common/instructions.hpp"
#include "common/parallel.hpp"
#include "common/vectors.hpp"
#include "continuum_client/stiffness_kernel.hpp"

namespace lockstep::continuum {

struct StiffnessMatrix;

class StiffnessProduct {
 public:
  enum class Format { SharedRows, HalfRows };

  StiffnessProduct() = default;
  explicit StiffnessProduct(const StiffnessMatrix& matrix, InstructionSet instructions = best_instructions());
  // As above, in a format of the caller's choice.
  StiffnessProduct(const StiffnessMatrix& matrix, Format format, InstructionSet instructions = best_instructions());

  std::size_t node_count() const { return static_cast<std::size_t>(nodes_); }
  // f = reference + K u; all of length node_count(). An empty `reference` is zero.
  void evaluate(const Vec3s& u, const Vec3s& reference, Vec3s& f, Team& team = Team::alone());

  Format format() const { return format_; }
  std::size_t bytes() const;  // that a product reads of the matrix

 private:
  struct Chunk {
    std::int32_t begin = 0, end = 0;          // nodes
    std::int32_t last = 0;                    // past the highest neighbour
    std::int32_t run_begin = 0, run_end = 0;  // runs
    std::vector<double> force;                // three components of `stride`, half rows only
    std::size_t stride = 0;
    std::int32_t first_part = 0;  // the first chunk that reaches into this one
    Components components() { return {force.data(), force.data() + stride, force.data() + 2 * stride}; }
  };

  void arrange(const StiffnessMatrix& matrix, Format format);
  void arrange_shared(const StiffnessMatrix& matrix);
  void arrange_half(const StiffnessMatrix& matrix);
  void cut_chunks(std::int32_t reach, const std::vector<std::int64_t>& cost);

  std::int32_t nodes_ = 0;
  Format format_ = Format::SharedRows;
  StiffnessKernel kernel_{};
  std::vector<StiffnessRun> runs_;
  std::vector<std::int32_t> offsets_;
  std::vector<double> blocks_;
  std::vector<Chunk> chunks_;
  std::vector<double> u_;  // by component
  std::size_t stride_ = 0;
  Vec3s zero_;
};

}  // namespace lockstep::continuum
