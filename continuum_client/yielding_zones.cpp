#include "continuum_client/yielding_zones.hpp"

#include <algorithm>

#include "common/checks.hpp"
#include "continuum_client/constants.hpp"

namespace lockstep::continuum {
namespace {

bool may_yield(const Grid& grid, const std::vector<char>& is_included, std::size_t z) {
  return (is_included.empty() || is_included[z]) && grid.material_of(z).yield_law;
}

}  // namespace

bool yield_zone(const YieldingMaterial* materials, std::int32_t material, double* stress) {
  const YieldingMaterial& m = materials[material];
  Eigen::Map<Voigt> now(stress);
  const Mat3 trial = from_voigt(now), left = yielded_stress(m.law, m.moduli, trial);
  if (left == trial) return false;
  now = to_voigt(left);
  return true;
}

YieldingZones::YieldingZones(const Grid& grid, const std::vector<char>& is_included, const InitialState& initial,
                             InstructionSet instructions)
    : node_kernel_(stiffness_kernel(instructions)),
      kernel_(LOCKSTEP_KERNEL_FOR(instructions, yield_kernel)()),
      place_(grid.zone_count(), -1),
      x_(positions_by_component(grid)),
      u_(grid.node_count()) {
  std::vector<char> yields(grid.zone_count());
  for (std::size_t z = 0; z < yields.size(); ++z) yields[z] = may_yield(grid, is_included, z);
  std::vector<NodeRange> ranges;
  blocks_ = arrange_zones(grid, yields, ranges);
  partial_ = PartialForces(ranges);
  part_sums_.resize(ranges.size());
  for (const Material& m : grid.materials) materials_.push_back({m.yield_law.value_or(MohrCoulomb{}), m.moduli});
  states_.resize(blocks_.block.size());
  for (std::size_t k = 0; k < states_.size(); ++k)
    for (std::size_t l = 0; l < nodes_at_once; ++l) {
      YieldBlock& b = states_[k];
      const auto z = static_cast<std::size_t>(blocks_.zone[nodes_at_once * k + l]);
      const Material& material = grid.material_of(z);
      b.shear[l] = material.moduli.shear, b.bulk[l] = material.moduli.bulk;
      b.friction[l] = material.yield_law->friction_sine, b.strength[l] = material.yield_law->strength;
      b.material[l] = grid.material[z];
      const Voigt stress = to_voigt(initial.zone_stress(grid, z));
      for (int c = 0; c < 6; ++c) b.initial[c][l] = b.stress[c][l] = stress[c], b.plastic[c][l] = 0;
      if (static_cast<std::int32_t>(l) < blocks_.block[k].zones)
        place_[z] = static_cast<std::int64_t>(nodes_at_once * k + l);
    }
}

void YieldingZones::advance(const Vec3s& displacement, Vec3s& force, Team& team) {
  const Components x = x_.get(), u = u_.get();
  const double* const from = reinterpret_cast<const double*>(displacement.data());
  double* const to = reinterpret_cast<double*>(force.data());
  team.run([&](int thread) {
    const auto [begin, end] = share_of(static_cast<std::int32_t>(displacement.size()), thread, team.size());
    node_kernel_.split(from, begin, end, {u.x + begin, u.y + begin, u.z + begin});
  });
  blocks_.for_each_range(team, [&](std::size_t r) {
    const auto [begin, end] = blocks_.share[r];
    part_sums_[r] = kernel_(blocks_.block.data() + begin, states_.data() + begin, end - begin, blocks_.table.data(),
                            materials_.data(), x, u, partial_.clear(r), partial_.range(r).begin);
  });
  blocks_.for_each_range(team, [&](std::size_t r) { partial_.join(r, node_kernel_, to, to); });
  sums_ = {};
  for (const YieldSums& s : part_sums_)
    sums_.energy += s.energy, sums_.dissipated += s.dissipated, sums_.yielding += s.yielding;
  dissipated_ += sums_.dissipated;
}

Mat3 YieldingZones::plastic_stress(std::size_t z) const {
  if (place_[z] < 0) return Mat3::Zero();
  const auto at = static_cast<std::size_t>(place_[z]);
  Voigt p;
  for (int c = 0; c < 6; ++c) p[c] = states_[at / nodes_at_once].plastic[c][at % nodes_at_once];
  return from_voigt(p);
}

Mat3 YieldingZones::plastic_strain(std::size_t z) const {
  if (place_[z] < 0) return Mat3::Zero();
  const auto at = static_cast<std::size_t>(place_[z]);
  const YieldBlock& b = states_[at / nodes_at_once];
  const Mat3 p = plastic_stress(z), mean = p.trace() / 3 * Mat3::Identity();
  return -(p - mean) / (2 * b.shear[at % nodes_at_once]) - mean / (3 * b.bulk[at % nodes_at_once]);
}

std::int64_t YieldingZones::yielded() const {
  return std::count_if(place_.begin(), place_.end(), [&](const std::int64_t& at) {
    return at >= 0 && !plastic_stress(static_cast<std::size_t>(&at - place_.data())).isZero(0);
  });
}

std::size_t YieldingZones::zone_count() const {
  return static_cast<std::size_t>(std::count_if(place_.begin(), place_.end(), [](std::int64_t at) { return at >= 0; }));
}

void check_initial_yield(const Grid& grid, const std::vector<char>& is_included, const InitialState& initial,
                         const std::string& where) {
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    if (!may_yield(grid, is_included, z)) continue;
    const MohrCoulomb& law = *grid.material_of(z).yield_law;
    const Mat3 stress = initial.zone_stress(grid, z);
    const double excess = yield_excess(law, stress);
    if (excess <= yield_tolerance * stress.cwiseAbs().maxCoeff()) continue;
    const Vec3 x = grid.zone_center(z);
    throw InputError(fmt::format(
        "{}: the ground cannot bear its own initial stress: in zone {} at ({:.4g}, {:.4g}, {:.4g}) m the vertical "
        "stress is {:.4g} Pa and the horizontal one {:.4g} Pa, {:.3g} Pa of shear too much; give a horizontal stress "
        "nearer to the vertical one (initial_stress.k0, or poisson_ratio without it), a larger friction_angle or a "
        "cohesion",
        where, z, x.x(), x.y(), x.z(), stress(2, 2), stress(0, 0), excess));
  }
}

}  // namespace lockstep::continuum
