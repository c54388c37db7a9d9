// Zones by eights, for kernels that go from zone to zone: those that stand on each other in a column of the numbering are taken
// without a gather, others are gathered. Blocks belong to ranges of nodes that threads share out (partial_forces.hpp).
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/parallel.hpp"
#include "continuum_client/stiffness_kernel.hpp"

namespace lockstep::continuum {

struct Grid;
struct NodeRange;

// Up to eight zones. Corner a of zone l is node[a] + l, as in a column of the mesh, or, where `table` is not negative,
// tables[table + 8 a + l].
struct ZoneBlock {
  std::int32_t node[8];
  std::int32_t zones = 0;
  std::int32_t table = -1;
};

struct ZoneBlocks {
  struct Share {
    std::int32_t begin, end;
  };

  std::vector<ZoneBlock> block;
  std::vector<std::int32_t> table;  // nodes of gathered blocks
  std::vector<std::int32_t> zone;   // per block and lane, of the grid; lanes without one repeat the first
  std::vector<Share> share;         // of blocks, per range of nodes

  std::size_t bytes() const;  // of what a kernel reads
  // visit(r) for each range, shared out to threads.
  template <class Visit>
  void for_each_range(Team& team, const Visit& visit) const {
    team.run([&](int thread) {
      const auto [begin, end] = share_of(share.size(), thread, team.size());
      for (std::size_t r = begin; r < end; ++r) visit(r);
    });
  }
};

// Of the zones with is_included[z]; an empty list includes all. `ranges`: of nodes, as many as shares.
ZoneBlocks arrange_zones(const Grid& grid, const std::vector<char>& is_included, std::vector<NodeRange>& ranges);

// By component, with the spare entries that kernels may read.
struct NodeComponents {
  std::vector<double> values;
  std::size_t stride = 0;

  explicit NodeComponents(std::size_t nodes = 0)
      : values(3 * (nodes + nodes_at_once), 0.0), stride(nodes + nodes_at_once) {}
  Components get() { return {values.data(), values.data() + stride, values.data() + 2 * stride}; }
};

// Reference positions [m].
NodeComponents positions_by_component(const Grid& grid);

}  // namespace lockstep::continuum
