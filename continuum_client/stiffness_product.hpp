// f = reference + K u, arranged for the machine, with the same bits for any number of threads and any instruction set.
//
// A zone deforms its nodes' neighbours in a column of alike zones in just the same way, so nodes of one column share
// their whole row of blocks. Three formats, chosen by what they cost:
//
//   shared rows   runs of consecutive nodes with equal rows: 27 blocks for the whole run, both halves. Eight nodes at a
//                 time, blocks as broadcasts. An extruded mesh of 20,000 zones needs 5 MB instead of 25; each node's sum
//                 is its own, so threads share out the runs.
//   half rows     any mesh: the upper half, each block once, f_i += K_ij u_j and f_j += K_ij^T u_i. Nodes of equal
//                 offsets are taken eight at a time with interleaved blocks.
//   zones         no blocks at all: each zone's forces from its shape (zone_kernel.hpp), of one-point zones: 1.3 times as
//                 fast as half rows that no cache of the core holds.
//
// Half rows and zones add to nodes that others add to as well: partial_forces.hpp.
//
// Rejected: whole rows for any mesh (twice the memory to read), stored zone matrices (4.7 kB a zone), single precision
// (weights of nodes off by 1e-4), and a choice by a trial run (another choice is other bits).
#pragma once
#include <cstdint>
#include <vector>

#include "common/instructions.hpp"
#include "common/parallel.hpp"
#include "common/vectors.hpp"
#include "continuum_client/partial_forces.hpp"
#include "continuum_client/zone_product.hpp"

namespace lockstep::continuum {

struct StiffnessMatrix;

class StiffnessProduct {
 public:
  enum class Format { SharedRows, HalfRows, Zones };

  StiffnessProduct() = default;
  // Rows, whichever cost less.
  explicit StiffnessProduct(const StiffnessMatrix& matrix, InstructionSet instructions = best_instructions());
  // Rows or zones: those of the grid that the matrix was assembled from.
  StiffnessProduct(const StiffnessMatrix& matrix, const Grid& grid, const std::vector<char>& is_included,
                   InstructionSet instructions = best_instructions());
  // In a format of the caller's choice; a matrix alone has no zones.
  StiffnessProduct(const StiffnessMatrix& matrix, Format format, InstructionSet instructions = best_instructions());
  static StiffnessProduct of_zones(const Grid& grid, const std::vector<char>& is_included,
                                   InstructionSet instructions = best_instructions());

  std::size_t node_count() const { return static_cast<std::size_t>(nodes_); }
  // f = reference + K u; all of length node_count(). An empty `reference` is zero.
  void evaluate(const Vec3s& u, const Vec3s& reference, Vec3s& f, Team& team = Team::alone());

  Format format() const { return format_; }
  std::size_t bytes() const;  // that a product reads of the matrix, or of the zones

 private:
  // Of consecutive nodes, and of their runs.
  struct Chunk {
    NodeRange nodes;
    std::int32_t run_begin = 0, run_end = 0;
  };

  void allocate(std::size_t nodes);
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
  PartialForces partial_;  // of half rows: a range a chunk
  ZoneProduct zones_;
  std::vector<double> u_;  // by component
  std::size_t stride_ = 0;
  Vec3s zero_;
};

}  // namespace lockstep::continuum
