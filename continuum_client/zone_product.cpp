#include "continuum_client/zone_product.hpp"

#include <algorithm>

#include "common/checks.hpp"

namespace lockstep::continuum {
namespace {

ZoneKernel kernel_of([[maybe_unused]] InstructionSet set) {
#if !defined(LOCKSTEP_GENERIC_KERNELS_ONLY)
  if (set == InstructionSet::Avx512) return zone_kernel_avx512();
  if (set == InstructionSet::Avx2) return zone_kernel_avx2();
#endif
  return zone_kernel_generic();
}

// Shorter columns are gathered with others.
constexpr std::size_t fewest_stacked = 4;
// Of a zone, in the units of stiffness_product.cpp, where a node of a distorted mesh costs 170 in half rows: measured as
// 0.78 of that, with 200,000 zones and one thread.
constexpr double zone_cycles = 132;

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

bool ZoneProduct::has_kernel(ZoneKind kind) { return kind == ZoneKind::OnePoint; }

double ZoneProduct::cost(const Grid& grid, const std::vector<char>& is_included) {
  const auto zones = is_included.empty() ? static_cast<std::ptrdiff_t>(grid.zone_count())
                                         : std::count(is_included.begin(), is_included.end(), 1);
  return zone_cycles * static_cast<double>(zones);
}

ZoneProduct::ZoneProduct(const Grid& grid, const std::vector<char>& is_included, InstructionSet instructions)
    : node_kernel_(stiffness_kernel(instructions)) {
  LOCKSTEP_ASSERT(has_kernel(grid.zone_kind), "no kernel for this kind of zone");
  kernel_ = kernel_of(instructions);
  const auto nodes = static_cast<std::int32_t>(grid.node_count());
  stride_ = grid.node_count() + nodes_at_once;
  x_.assign(3 * stride_, 0.0);
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    for (std::size_t c = 0; c < 3; ++c) x_[c * stride_ + i] = grid.node[i][static_cast<Eigen::Index>(c)];

  const auto add_block = [&](const std::int32_t* zone, std::size_t count, bool is_stacked) {
    ZoneBlock b;
    b.zones = static_cast<std::int32_t>(count);
    std::copy_n(grid.zone[zone[0]].begin(), 8, b.node);
    if (!is_stacked) {
      b.table = static_cast<std::int32_t>(tables_.size());
      // Lanes without a zone repeat the first; nothing is taken from them.
      for (std::size_t a = 0; a < 8; ++a)
        for (std::size_t l = 0; l < nodes_at_once; ++l) tables_.push_back(grid.zone[zone[l < count ? l : 0]][a]);
    }
    blocks_.push_back(b);
    for (const bool is_shear : {true, false})
      for (std::size_t l = 0; l < nodes_at_once; ++l) {
        const ElasticModuli& m = grid.moduli(static_cast<std::size_t>(zone[l < count ? l : 0]));
        moduli_.push_back(is_shear ? m.shear : m.bulk);
      }
  };

  const std::vector<std::int32_t> zones = by_lowest_node(grid, is_included);
  std::int32_t reach = 0;
  for (const std::int32_t z : zones) reach = std::max(reach, highest(grid.zone[z]) - lowest(grid.zone[z]));
  const std::int32_t fewest = std::max({fewest_range_nodes, 2 * reach, nodes / ranges_wanted + 1});
  std::vector<NodeRange> ranges;
  std::vector<std::int32_t> loose;
  for (std::size_t k = 0; k < zones.size();) {
    NodeRange range;
    range.begin = ranges.empty() ? 0 : lowest(grid.zone[zones[k]]);
    const auto first_block = static_cast<std::int32_t>(blocks_.size());
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
    shares_.push_back({first_block, static_cast<std::int32_t>(blocks_.size())});
  }
  if (ranges.empty()) ranges.push_back({0, nodes, 0}), shares_.push_back({0, 0});
  for (NodeRange& r : ranges) r.reach = std::max(r.reach, r.end);
  partial_ = PartialForces(ranges);
}

void ZoneProduct::evaluate(const Components& u, const double* reference, double* f, Team& team) {
  const Components x{x_.data(), x_.data() + stride_, x_.data() + 2 * stride_};
  const auto for_each_range = [&](const auto& visit) {
    team.run([&](int thread) {
      const auto [begin, end] = share_of(shares_.size(), thread, team.size());
      for (std::size_t r = begin; r < end; ++r) visit(r);
    });
  };
  for_each_range([&](std::size_t r) {
    const auto [begin, end] = shares_[r];
    kernel_(blocks_.data() + begin, end - begin, tables_.data(), moduli_.data() + 2 * nodes_at_once * begin, x, u,
            partial_.clear(r), partial_.range(r).begin);
  });
  for_each_range([&](std::size_t r) { partial_.join(r, node_kernel_, reference, f); });
}

std::size_t ZoneProduct::bytes() const {
  return blocks_.size() * sizeof(ZoneBlock) + tables_.size() * sizeof(std::int32_t) +
         (moduli_.size() + x_.size()) * sizeof(double);
}

}  // namespace lockstep::continuum
