// Forces on nodes that several threads add up, in an order that does not depend on them. The nodes are cut into ranges; what
// belongs to a range adds to the range's nodes and to some after them, in memory of the range's own. Then each range sums
// its nodes over the ranges before it that reach into it, in their order.
//
//   nodes    |-- range 0 --|-- range 1 --|-- range 2 --|
//   memory   [0 ............... reach)
//                          [1 ............... reach)
//                                        [2 ..........)
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "continuum_client/stiffness_kernel.hpp"

namespace lockstep::continuum {

struct NodeRange {
  std::int32_t begin = 0, end = 0;  // its own nodes
  std::int32_t reach = 0;           // past the highest node that it adds to
};

// Ranges hold this many nodes at least, or twice as many as one of them reaches beyond: little is added up twice then.
constexpr std::int32_t fewest_range_nodes = 1024;
// What threads share out: more than there will be threads, few enough to cost nothing.
constexpr std::int32_t ranges_wanted = 32;

class PartialForces {
 public:
  PartialForces() = default;
  // Ranges one after the other.
  explicit PartialForces(const std::vector<NodeRange>& ranges);

  const NodeRange& range(std::size_t r) const { return ranges_[r]; }
  // The memory of range r, emptied: node i at index i - begin. Sixteen entries past its reach may be written.
  Components clear(std::size_t r);
  // f[3 i ..] = reference[3 i ..] + what all ranges hold for the nodes of range r.
  void join(std::size_t r, const StiffnessKernel& kernel, const double* reference, double* f);

 private:
  Components components(std::size_t r);

  std::vector<NodeRange> ranges_;
  std::vector<std::vector<double>> memory_;  // three components one after the other [N]
  std::vector<std::size_t> first_;           // per range: the first that reaches into it
};

}  // namespace lockstep::continuum
