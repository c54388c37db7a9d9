#include "continuum_client/grid.hpp"

#include <algorithm>
#include <string>

#include "common/checks.hpp"
#include "continuum_client/constants.hpp"

namespace lockstep::continuum {

ZoneVectors gather(const Vec3s& field, const std::array<std::int32_t, 8>& nodes) {
  ZoneVectors values;
  for (int a = 0; a < 8; ++a) values[a] = field[nodes[a]];
  return values;
}

ZoneVectors Grid::corners(std::size_t z) const { return gather(node, zone[z]); }

Vec3 Grid::zone_center(std::size_t z) const {
  Vec3 sum = Vec3::Zero();
  for (std::int32_t n : zone[z]) sum += node[n];
  return sum / 8;
}

std::vector<char> zones_outside_discrete_domain(const Grid& grid) {
  std::vector<char> is_left(grid.zone_count());
  for (std::size_t z = 0; z < grid.zone_count(); ++z) is_left[z] = grid.in_discrete_domain[z] ? 0 : 1;
  return is_left;
}

double replaced_density(const Grid& grid) {
  double mass = 0, volume = 0;
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    if (!grid.in_discrete_domain[z]) continue;
    const double of_zone = grid.geometry(z).zone_volume();
    mass += of_zone * grid.material_of(z).density, volume += of_zone;
  }
  return volume > 0 && grid.materials.size() > 1 ? mass / volume : grid.materials.front().density;
}

double fastest_wave(const Grid& grid) {
  double fastest = 0;
  for (const Material& m : grid.materials) fastest = std::max(fastest, p_wave_speed(m.moduli, m.density));
  return fastest;
}

std::vector<std::int32_t> representative_zones(const Grid& grid) {
  std::vector<std::int32_t> representative(grid.zone_count());
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    representative[z] = static_cast<std::int32_t>(z);
    if (z == 0 || grid.material[z] != grid.material[z - 1]) continue;
    const auto candidate = static_cast<std::size_t>(representative[z - 1]);
    const ZoneVectors mine = grid.corners(z), its = grid.corners(candidate);
    const double tolerance = congruence_tolerance * (its[6] - its[0]).norm();
    bool is_translate = true;
    for (int a = 1; a < 8; ++a) is_translate &= ((mine[a] - mine[0]) - (its[a] - its[0])).norm() <= tolerance;
    if (is_translate) representative[z] = representative[candidate];
  }
  return representative;
}

void check_zones(const Grid& grid, const std::string& where, const std::string& remedy) {
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    const double smallest = grid.geometry(z).smallest_volume;
    if (!(smallest > 0)) {
      const Vec3 c = grid.zone_center(z);
      throw InputError(fmt::format(
          "{}: the zone around ({:.4g}, {:.4g}, {:.4g}) m is flat or turned inside out (a part of {:.3g} m3); "
          "{}",
          where, c.x(), c.y(), c.z(), smallest, remedy));
    }
  }
}

}  // namespace lockstep::continuum
