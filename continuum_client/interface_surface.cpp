#include "continuum_client/interface_surface.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "common/hash.hpp"

namespace lockstep::continuum {

FacetCorners InterfaceSurface::corners(std::size_t f) const {
  const auto& n = facet[f];
  return {position[n[0]], position[n[1]], position[n[2]], position[n[3]]};
}

double InterfaceSurface::mean_facet_size() const {
  double sum = 0;
  for (std::size_t f = 0; f < facet_count(); ++f) sum += std::sqrt(facet_area_vector(corners(f)).norm());
  return facet_count() ? sum / static_cast<double>(facet_count()) : 0.0;
}

std::uint64_t InterfaceSurface::position_hash() const {
  Hash h;
  h.add(std::span<const Vec3>(position));
  return h.value();
}

InterfaceSurface interface_surface(const Grid& grid) {
  InterfaceSurface s;
  for (const auto& f : grid.facet) s.node.insert(s.node.end(), f.begin(), f.end());
  std::sort(s.node.begin(), s.node.end());
  s.node.erase(std::unique(s.node.begin(), s.node.end()), s.node.end());
  for (const auto& f : grid.facet) {
    std::array<std::int32_t, 4> local;
    for (int c = 0; c < 4; ++c)
      local[c] = static_cast<std::int32_t>(std::lower_bound(s.node.begin(), s.node.end(), f[c]) - s.node.begin());
    s.facet.push_back(local);
  }
  s.ring = grid.ring;
  // Minus zero plus zero is plus zero: without it a side that adds v dt = 0 would hold other bits than one that does
  // not.
  for (std::int32_t n : s.node) s.position.push_back(grid.node[n] + Vec3::Zero());
  return s;
}

void gather_interface(const InterfaceSurface& surface, const Vec3s& field, Vec3s& values) {
  values.resize(surface.node_count());
  for (std::size_t i = 0; i < surface.node_count(); ++i) values[i] = field[surface.node[i]];
}

Vec3s discrete_domain_reaction(const Grid& grid, const InterfaceSurface& surface, double gravity,
                               const InitialState& state) {
  Vec3s force = prescribed_force(grid, state, grid.in_discrete_domain);
  for (Vec3& f : force) f = -f;
  const std::vector<std::int32_t> representative = representative_zones(grid);
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    if (!grid.in_discrete_domain[z]) continue;
    const ZoneGeometry geometry = grid.geometry(representative[z]);
    // The assembled operator's own numbers, so that putting f_A in place of the zones leaves round-off alone.
    const ZoneMatrix stiffness = zone_stiffness(geometry, grid.moduli(z));
    const std::array<double, 8> volume = geometry.nodal_volume;
    Eigen::Matrix<double, 24, 1> u;
    for (int a = 0; a < 8; ++a) u.segment<3>(3 * a) = state.displacement[grid.zone[z][a]];
    const Eigen::Matrix<double, 24, 1> f = stiffness * u;
    for (int a = 0; a < 8; ++a)
      force[grid.zone[z][a]] += Vec3(0, 0, -grid.material_of(z).density * volume[a] * gravity) - f.segment<3>(3 * a);
  }
  Vec3s at_interface;
  gather_interface(surface, force, at_interface);
  return at_interface;
}

std::vector<Voigt> facet_stress(const Grid& grid, const InterfaceSurface& surface, const InitialState& state) {
  std::map<std::array<std::int32_t, 4>, std::size_t> facet_of;  // by sorted nodes
  for (std::size_t f = 0; f < grid.facet.size(); ++f) {
    std::array<std::int32_t, 4> key = grid.facet[f];
    std::sort(key.begin(), key.end());
    facet_of[key] = f;
  }
  std::vector<Voigt> sum(surface.facet_count(), Voigt::Zero());
  std::vector<int> owners(surface.facet_count(), 0);
  for (std::size_t z = 0; z < grid.zone_count(); ++z)
    for (const auto& face : zone_faces) {
      std::array<std::int32_t, 4> key;
      for (int c = 0; c < 4; ++c) key[c] = grid.zone[z][face[c]];
      std::sort(key.begin(), key.end());
      const auto found = facet_of.find(key);
      if (found == facet_of.end()) continue;
      sum[found->second] += to_voigt(state.zone_stress(grid, z));
      ++owners[found->second];
    }
  for (std::size_t f = 0; f < sum.size(); ++f) sum[f] /= std::max(1, owners[f]);
  return sum;
}

std::array<double, 4> nodal_areas(const FacetCorners& corners) {
  // 2 x 2 Gauss points: exact for plane facets, where N_j |dx/dxi x dx/deta| is biquadratic.
  const double g = 1 / std::sqrt(3.0);
  std::array<double, 4> area{};
  for (double eta : {-g, g})
    for (double xi : {-g, g}) {
      const std::array<double, 4> w = bilinear_weights(xi, eta);
      const double da = facet_tangent_xi(corners, eta).cross(facet_tangent_eta(corners, xi)).norm();
      for (int c = 0; c < 4; ++c) area[c] += w[c] * da;
    }
  return area;
}

Vec3s facet_traction(const InterfaceSurface& surface, const std::vector<Voigt>& stress, const Vec3s& reaction) {
  Vec3s left = reaction;  // what the facets' stress does not explain
  std::vector<double> node_area(surface.node_count(), 0.0);
  Vec3s traction(surface.facet_count());
  for (std::size_t f = 0; f < surface.facet_count(); ++f) {
    const FacetCorners corners = surface.corners(f);
    const std::array<double, 4> area = nodal_areas(corners);
    traction[f] = from_voigt(stress[f]) * facet_area_vector(corners).normalized();
    for (int c = 0; c < 4; ++c) {
      left[surface.facet[f][c]] -= area[c] * traction[f];
      node_area[surface.facet[f][c]] += area[c];
    }
  }
  for (std::size_t f = 0; f < surface.facet_count(); ++f) {
    const std::array<double, 4> area = nodal_areas(surface.corners(f));
    Vec3 force = Vec3::Zero();
    for (int c = 0; c < 4; ++c) force += area[c] / node_area[surface.facet[f][c]] * left[surface.facet[f][c]];
    traction[f] += force / (area[0] + area[1] + area[2] + area[3]);
  }
  return traction;
}

std::vector<LevelStress> discrete_domain_profile(const Grid& grid, const InitialState& state) {
  std::map<std::int32_t, std::pair<LevelStress, double>> sums;  // by level, with the volume
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    if (!grid.in_discrete_domain[z]) continue;
    const ZoneGeometry geometry = grid.geometry(z);
    const double volume = geometry.zone_volume();
    const Mat3 s = state.zone_stress(grid, z);
    auto& [level, sum] = sums[grid.level[z]];
    level.z += volume * grid.zone_center(z).z();
    level.vertical += volume * s(2, 2);
    level.horizontal += volume * 0.5 * (s(0, 0) + s(1, 1));
    sum += volume;
  }
  std::vector<LevelStress> profile;
  for (const auto& [index, level] : sums)
    profile.push_back(
        {level.first.z / level.second, level.first.vertical / level.second, level.first.horizontal / level.second});
  return profile;
}

std::vector<Voigt> zone_stresses(const Grid& grid, const InitialState& state) {
  std::vector<Voigt> stress;
  stress.reserve(grid.zone_count());
  for (std::size_t z = 0; z < grid.zone_count(); ++z) stress.push_back(to_voigt(state.zone_stress(grid, z)));
  return stress;
}

}  // namespace lockstep::continuum
