#include "continuum_client/zone_product.hpp"

#include <algorithm>

#include "common/checks.hpp"

namespace lockstep::continuum {
namespace {

// Of a zone, in the units of stiffness_product.cpp, where a node of a distorted mesh costs 170 in half rows: measured as
// 0.78 of that, with 200,000 zones and one thread.
constexpr double zone_cycles = 132;

}  // namespace

bool ZoneProduct::has_kernel(ZoneKind kind) { return kind == ZoneKind::OnePoint; }

double ZoneProduct::cost(const Grid& grid, const std::vector<char>& is_included) {
  const auto zones = is_included.empty() ? static_cast<std::ptrdiff_t>(grid.zone_count())
                                         : std::count(is_included.begin(), is_included.end(), 1);
  return zone_cycles * static_cast<double>(zones);
}

ZoneProduct::ZoneProduct(const Grid& grid, const std::vector<char>& is_included, InstructionSet instructions)
    : node_kernel_(stiffness_kernel(instructions)), x_(positions_by_component(grid)) {
  LOCKSTEP_ASSERT(has_kernel(grid.zone_kind), "no kernel for this kind of zone");
  kernel_ = LOCKSTEP_KERNEL_FOR(instructions, zone_kernel)();
  std::vector<NodeRange> ranges;
  blocks_ = arrange_zones(grid, is_included, ranges);
  partial_ = PartialForces(ranges);
  for (std::size_t first = 0; first < blocks_.zone.size(); first += nodes_at_once)
    for (const bool is_shear : {true, false})
      for (std::size_t l = first; l < first + nodes_at_once; ++l) {
        const ElasticModuli& m = grid.moduli(static_cast<std::size_t>(blocks_.zone[l]));
        moduli_.push_back(is_shear ? m.shear : m.bulk);
      }
}

void ZoneProduct::evaluate(const Components& u, const double* reference, double* f, Team& team) {
  const Components x = x_.get();
  blocks_.for_each_range(team, [&](std::size_t r) {
    const auto [begin, end] = blocks_.share[r];
    kernel_(blocks_.block.data() + begin, end - begin, blocks_.table.data(), moduli_.data() + 2 * nodes_at_once * begin,
            x, u, partial_.clear(r), partial_.range(r).begin);
  });
  blocks_.for_each_range(team, [&](std::size_t r) { partial_.join(r, node_kernel_, reference, f); });
}

std::size_t ZoneProduct::bytes() const {
  return blocks_.bytes() + (moduli_.size() + x_.values.size()) * sizeof(double);
}

}  // namespace lockstep::continuum
