#include "continuum_client/zone_blocks.hpp"

#include <algorithm>

#include "continuum_client/grid.hpp"
#include "continuum_client/partial_forces.hpp"

namespace lockstep::continuum {
namespace {

// Shorter columns are gathered with others.
constexpr std::size_t fewest_stacked = 4;

std::int32_t lowest(const std::array<std::int32_t, 8>& zone) { return *std::min_element(zone.begin(), zone.end()); }
std::int32_t highest(const std::array<std::int32_t, 8>& zone) { return *std::max_element(zone.begin(), zone.end()); }

std::vector<std::int32_t> by_lowest_node(const Grid& grid, const std::vector<char>& is_included) {
  std::vector<std::int32_t> zones;
  for (std::size_t z = 0; z < grid.zone_count(); ++z)
    if (is_included.empty() || is_included[z]) zones.push_back(static_cast<std::int32_t>(z));
  std::stable_sort(zones.begin(), zones.end(),
                   [&](std::int32_t a, std::int32_t b) { return lowest(grid.zone[a]) < lowest(grid.zone[b]); });
  return zones;
}

bool stands_on(const Grid& grid, std::int32_t below, std::int32_t above) {
  for (int a = 0; a < 8; ++a)
    if (grid.zone[above][a] != grid.zone[below][a] + 1) return false;
  return true;
}

}  // namespace

std::size_t ZoneBlocks::bytes() const { return block.size() * sizeof(ZoneBlock) + table.size() * sizeof(std::int32_t); }

ZoneBlocks arrange_zones(const Grid& grid, const std::vector<char>& is_included, std::vector<NodeRange>& ranges) {
  ZoneBlocks blocks;
  const auto add_block = [&](const std::int32_t* zone, std::size_t count, bool is_stacked) {
    ZoneBlock b;
    b.zones = static_cast<std::int32_t>(count);
    std::copy_n(grid.zone[zone[0]].begin(), 8, b.node);
    if (!is_stacked) {
      b.table = static_cast<std::int32_t>(blocks.table.size());
      // Lanes without a zone repeat the first; nothing is taken from them.
      for (std::size_t a = 0; a < 8; ++a)
        for (std::size_t l = 0; l < nodes_at_once; ++l) blocks.table.push_back(grid.zone[zone[l < count ? l : 0]][a]);
    }
    blocks.block.push_back(b);
    for (std::size_t l = 0; l < nodes_at_once; ++l) blocks.zone.push_back(zone[l < count ? l : 0]);
  };

  const auto nodes = static_cast<std::int32_t>(grid.node_count());
  const std::vector<std::int32_t> zones = by_lowest_node(grid, is_included);
  std::int32_t reach = 0;
  for (const std::int32_t z : zones) reach = std::max(reach, highest(grid.zone[z]) - lowest(grid.zone[z]));
  const std::int32_t fewest = std::max({fewest_range_nodes, 2 * reach, nodes / ranges_wanted + 1});
  ranges.clear();
  std::vector<std::int32_t> loose;
  for (std::size_t k = 0; k < zones.size();) {
    NodeRange range;
    range.begin = ranges.empty() ? 0 : lowest(grid.zone[zones[k]]);
    const auto first_block = static_cast<std::int32_t>(blocks.block.size());
    loose.clear();
    while (k < zones.size() && lowest(grid.zone[zones[k]]) < range.begin + fewest) {
      std::size_t end = k + 1;
      while (end < zones.size() && stands_on(grid, zones[end - 1], zones[end]) &&
             lowest(grid.zone[zones[end]]) < range.begin + fewest)
        ++end;
      for (std::size_t z = k; z < end; ++z) range.reach = std::max(range.reach, highest(grid.zone[zones[z]]) + 1);
      for (; k < end; k += std::min<std::size_t>(end - k, nodes_at_once)) {
        const std::size_t count = std::min<std::size_t>(end - k, nodes_at_once);
        if (count >= fewest_stacked)
          add_block(&zones[k], count, true);
        else
          loose.insert(loose.end(), zones.begin() + static_cast<std::ptrdiff_t>(k),
                       zones.begin() + static_cast<std::ptrdiff_t>(k + count));
      }
    }
    for (std::size_t l = 0; l < loose.size(); l += nodes_at_once)
      add_block(&loose[l], std::min<std::size_t>(loose.size() - l, nodes_at_once), false);
    if (!ranges.empty()) ranges.back().end = range.begin;
    range.end = nodes;
    ranges.push_back(range);
    blocks.share.push_back({first_block, static_cast<std::int32_t>(blocks.block.size())});
  }
  if (ranges.empty()) ranges.push_back({0, nodes, 0}), blocks.share.push_back({0, 0});
  for (NodeRange& r : ranges) r.reach = std::max(r.reach, r.end);
  return blocks;
}

NodeComponents positions_by_component(const Grid& grid) {
  NodeComponents x(grid.node_count());
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    for (std::size_t c = 0; c < 3; ++c) x.values[c * x.stride + i] = grid.node[i][static_cast<Eigen::Index>(c)];
  return x;
}

}  // namespace lockstep::continuum
