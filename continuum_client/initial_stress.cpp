#include "continuum_client/initial_stress.hpp"

#include <algorithm>

namespace lockstep::continuum {

Mat3 InitialState::zone_stress(const Grid& grid, std::size_t z) const {
  const Mat3 elastic = continuum::zone_stress(grid.geometry(z), grid.moduli(z), gather(displacement, grid.zone[z]));
  return stress.empty() ? elastic : Mat3(stress[z] + elastic);
}

std::vector<Mat3> stress_by_depth(const Grid& grid, const std::vector<Layer>& layers, double k0, double gravity) {
  // Mass above a height, per area: the ground's own material down to the first layer, and so on.
  const auto mass_above = [&](double z) {
    double mass = 0, top = grid.high.z();
    std::int32_t material = 0;
    for (const Layer& layer : layers) {
      const double border = std::min(layer.top, grid.high.z());
      if (border <= z) break;
      mass += grid.materials[material].density * (top - border);
      top = border, material = layer.material;
    }
    return mass + grid.materials[material].density * (top - z);
  };
  std::vector<Mat3> stress(grid.zone_count());
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    const double vertical = -gravity * mass_above(grid.zone_center(z).z());
    stress[z] = Vec3(k0 * vertical, k0 * vertical, vertical).asDiagonal();
  }
  return stress;
}

Vec3s prescribed_force(const Grid& grid, const InitialState& state, const std::vector<char>& is_included) {
  Vec3s force(grid.node_count(), Vec3::Zero());
  for (std::size_t z = 0; z < state.stress.size(); ++z) {
    if (!is_included.empty() && !is_included[z]) continue;
    const ZoneVectors f = zone_force_of_stress(grid.geometry(z), state.stress[z]);
    for (int a = 0; a < 8; ++a) force[grid.zone[z][a]] += f[a];
  }
  return force;
}

}  // namespace lockstep::continuum
