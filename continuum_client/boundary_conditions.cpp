#include "continuum_client/boundary_conditions.hpp"

#include <fmt/ranges.h>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "common/checks.hpp"
#include "continuum_client/constants.hpp"
#include "continuum_client/interface_surface.hpp"
#include "continuum_client/zone_adjacency.hpp"

namespace lockstep::continuum {

Vec3s free_components(const Grid& grid, Supports supports, const std::vector<double>& mass,
                      const Vec3& is_free_direction) {
  const double tolerance = plane_tolerance * (grid.high - grid.low).maxCoeff();
  const auto on_side = [&](const Vec3& x, int axis) {
    return std::abs(x[axis] - grid.low[axis]) <= tolerance || std::abs(x[axis] - grid.high[axis]) <= tolerance;
  };
  Vec3s is_free(grid.node_count(), is_free_direction);
  for (std::size_t i = 0; i < grid.node_count(); ++i) {
    const Vec3& x = grid.node[i];
    const bool on_x = on_side(x, 0), on_y = on_side(x, 1), on_bottom = std::abs(x.z() - grid.low.z()) <= tolerance;
    switch (supports) {
      case Supports::AllFixed:
        if (on_x || on_y || on_bottom) is_free[i].setZero();
        break;
      case Supports::Rollers:
        if (on_x) is_free[i].x() = 0;
        if (on_y) is_free[i].y() = 0;
        if (on_bottom) is_free[i].z() = 0;
        break;
      case Supports::BottomFixed:
        if (on_bottom) is_free[i].setZero();
        break;
      case Supports::BottomRoller:
        if (on_bottom) is_free[i].z() = 0;
        break;
      case Supports::Quiet:
        break;
      case Supports::QuietSides:
        if (on_bottom) is_free[i].setZero();
        break;
    }
    if (!(mass[i] > 0)) is_free[i].setZero();
  }
  return is_free;
}

Vec3s released_reactions(const Vec3s& before, const Vec3s& after, const Vec3s& internal, const Vec3s& external) {
  Vec3s load(before.size(), Vec3::Zero());
  bool is_any_released = false;
  for (std::size_t i = 0; i < before.size(); ++i)
    for (int c = 0; c < 3; ++c)
      if (before[i][c] == 0 && after[i][c] != 0) {
        load[i][c] = internal[i][c] - external[i][c];
        is_any_released = true;
      }
  if (!is_any_released) load.clear();
  return load;
}

std::vector<OuterFace> outer_faces(const Grid& grid, const std::vector<char>& is_included) {
  std::vector<OuterFace> faces;
  std::vector<std::pair<std::int32_t, std::int32_t>> place;  // zone and its face
  for_each_place(sorted_faces(grid.zone, is_included), [&](const ZoneFace* face, std::size_t count) {
    if (count == 1) place.emplace_back(face->zone, face->face);
  });
  std::sort(place.begin(), place.end());
  for (const auto& [zone, face] : place) faces.push_back({face_nodes(grid.zone[zone], face), zone});
  return faces;
}

FacetCorners corners_of(const Grid& grid, const OuterFace& face) {
  return {grid.node[face.node[0]], grid.node[face.node[1]], grid.node[face.node[2]], grid.node[face.node[3]]};
}

Vec3s quiet_dashpots(const Grid& grid, Supports supports, const std::vector<char>& is_included) {
  if (supports != Supports::Quiet && supports != Supports::QuietSides) return {};
  const double tolerance = plane_tolerance * (grid.high - grid.low).maxCoeff();
  Vec3s dashpot(grid.node_count(), Vec3::Zero());
  for (const OuterFace& face : outer_faces(grid, is_included)) {
    const FacetCorners corners = corners_of(grid, face);
    const auto lies_on = [&](int axis, double plane) {
      return std::all_of(corners.begin(), corners.end(),
                         [&](const Vec3& x) { return std::abs(x[axis] - plane) <= tolerance; });
    };
    for (int axis = 0; axis < 3; ++axis) {
      const bool is_low = lies_on(axis, grid.low[axis]), is_high = axis < 2 && lies_on(axis, grid.high[axis]);
      if (!is_low && !is_high) continue;
      if (axis == 2 && supports == Supports::QuietSides) continue;
      const Material& material = grid.material_of(face.zone);
      Vec3 impedance = Vec3::Constant(material.density * s_wave_speed(material.moduli, material.density));
      impedance[axis] = material.density * p_wave_speed(material.moduli, material.density);
      const std::array<double, 4> area = nodal_areas(corners);
      for (int c = 0; c < 4; ++c) dashpot[face.node[c]] += area[c] * impedance;
    }
  }
  return dashpot;
}

Vec3s loaded_nodes(const Grid& grid, const SurfaceLoad& load, const std::vector<char>& is_included) {
  Vec3s force(grid.node_count(), Vec3::Zero());
  const Vec3 slack = Vec3::Constant(plane_tolerance * (grid.high - grid.low).maxCoeff());
  double area_in_box = 0;
  for (const OuterFace& face : outer_faces(grid, is_included)) {
    const FacetCorners corners = corners_of(grid, face);
    const Vec3 center = 0.25 * (corners[0] + corners[1] + corners[2] + corners[3]);
    if ((center.array() < (load.low - slack).array()).any() || (center.array() > (load.high + slack).array()).any())
      continue;
    const std::array<double, 4> area = nodal_areas(corners);
    for (int c = 0; c < 4; ++c) {
      force[face.node[c]] += area[c] * load.traction;
      area_in_box += area[c];
    }
  }
  if (!(area_in_box > 0))
    throw InputError(
        fmt::format("{}: no outer face of the ground has its centre in the box; the ground reaches from ({}) to ({}) m",
                    load.where, fmt::join(grid.low, ", "), fmt::join(grid.high, ", ")));
  return force;
}

double load_share(const SurfaceLoad& load, double time) {
  const double end = load.duration > 0 ? 2 * load.ramp + load.duration : std::numeric_limits<double>::infinity();
  const double way = std::min(time, end - time);
  return way <= 0 ? 0.0 : smoothstep(load.ramp > 0 ? way / load.ramp : 1.0);
}

}  // namespace lockstep::continuum
