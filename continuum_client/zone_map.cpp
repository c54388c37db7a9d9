#include "continuum_client/zone_map.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <limits>

#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/constants.hpp"

namespace lockstep::continuum {
namespace {

// After Ericson, Real-Time Collision Detection (2005), 5.1.5: by the regions around the triangle that the point may lie in.
Vec3 nearest_in_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap), d3 = ab.dot(bp), d4 = ac.dot(bp), d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d1 <= 0 && d2 <= 0) return a;
  if (d3 >= 0 && d4 <= d3) return b;
  if (d6 >= 0 && d5 <= d6) return c;
  const double of_c = d1 * d4 - d3 * d2, of_b = d5 * d2 - d1 * d6, of_a = d3 * d6 - d5 * d4;
  if (of_c <= 0 && d1 >= 0 && d3 <= 0) return a + d1 / (d1 - d3) * ab;
  if (of_b <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  if (of_a <= 0 && d4 >= d3 && d5 >= d6) return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
  return a + (of_b * ab + of_c * ac) / (of_a + of_b + of_c);
}

}  // namespace

Vec3 Place::interpolate(const Grid& grid, const Vec3s& field) const {
  Vec3 sum = Vec3::Zero();
  for (int a = 0; a < 8; ++a) sum += weight[a] * field[grid.zone[zone][a]];
  return sum;
}

std::int32_t Place::nearest_node(const Grid& grid) const {
  return grid.zone[zone][std::max_element(weight.begin(), weight.end()) - weight.begin()];
}

std::optional<Vec3> cube_coordinates(const ZoneVectors& corners, const Vec3& point) {
  Vec3 xi = Vec3::Zero();
  for (int n = 0; n < most_newton_steps; ++n) {
    const ShapeFunctions shape = trilinear(xi);
    Vec3 x = Vec3::Zero();
    for (int a = 0; a < 8; ++a) x += shape.value[a] * corners[a];
    const Vec3 step = jacobian(shape, corners).inverse() * (point - x);
    xi += step;
    if (!(xi.cwiseAbs().maxCoeff() < newton_reach)) return {};
    if (step.cwiseAbs().maxCoeff() < newton_tolerance) return xi;
  }
  return {};
}

std::optional<Place> find_place(const Grid& grid, const std::vector<char>& is_included, const Vec3& point) {
  const double slack = plane_tolerance * (grid.high - grid.low).maxCoeff();
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    if (!is_included.empty() && !is_included[z]) continue;
    const ZoneVectors corners = grid.corners(z);
    Vec3 low = corners[0], high = corners[0];
    for (const Vec3& x : corners) low = low.cwiseMin(x), high = high.cwiseMax(x);
    if (((point - low).array() < -slack).any() || ((high - point).array() < -slack).any()) continue;
    const std::optional<Vec3> xi = cube_coordinates(corners, point);
    if (!xi) continue;
    // Back inside, and not further from the point than the slack.
    const ShapeFunctions inside = trilinear(xi->cwiseMax(-1).cwiseMin(1));
    Place place{static_cast<std::int32_t>(z), inside.value};
    if ((place.interpolate(grid, grid.node) - point).norm() <= slack) return place;
  }
  return {};
}

Vec3 nearest_on_surface(const Grid& grid, const std::vector<char>& is_included, const Vec3& point) {
  Vec3 nearest = Vec3::Zero();
  double best = std::numeric_limits<double>::infinity();
  for (const OuterFace& face : outer_faces(grid, is_included)) {
    const FacetCorners x = corners_of(grid, face);
    const Vec3 middle = 0.25 * (x[0] + x[1] + x[2] + x[3]);
    for (int c = 0; c < 4; ++c) {
      const Vec3 candidate = nearest_in_triangle(point, x[c], x[(c + 1) % 4], middle);
      const double distance = (candidate - point).squaredNorm();
      if (distance < best) best = distance, nearest = candidate;
    }
  }
  return nearest;
}

}  // namespace lockstep::continuum
