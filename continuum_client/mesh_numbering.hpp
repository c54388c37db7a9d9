// The order that Grid wants, found in a mesh that has none.
//
// Each zone is turned so that its third direction is the most upright of the three. Where zones stand on each other, top face
// on bottom face, they are a column; nodes one above the other are a column of nodes. Columns are numbered by Cuthill &
// McKee's walk over neighbours (Proc. 24th ACM Conf., 1969), so that neighbouring columns are near each other in memory,
// and upwards in each. A zone's first corner is the one with the lowest number: all zones of a column are turned alike.
//
// The walk begins from positions and not from the file's numbers, so that a mesh with columns gets the same order however
// its file was shuffled. A mesh without columns has columns of one node and one zone, and is right all the same.
#pragma once
#include <cstdint>
#include <vector>

#include "common/vectors.hpp"
#include "continuum_client/zone_adjacency.hpp"

namespace lockstep::continuum {

struct ColumnOrder {
  std::vector<std::int32_t> node;  // new number -> old
  std::vector<std::int32_t> zone;
  std::vector<ZoneNodes> zones;     // in new order and numbers, turned
  std::vector<std::int32_t> level;  // per new zone: from the bottom up
  std::int32_t longest_column = 0;  // [zones]
};

// Zones must be positive, and no face may belong to more than two.
ColumnOrder order_by_columns(const Vec3s& node, const std::vector<ZoneNodes>& zones);

}  // namespace lockstep::continuum
