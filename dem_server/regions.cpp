#include "dem_server/regions.hpp"

#include "common/checks.hpp"

namespace lockstep::dem {

// --------------------------------------------------------------------------------------------------------------- lines

double Box::share_of_line(const Vec3& begin, const Vec3& end) const {
  double from = 0, to = 1;
  for (int axis = 0; axis < 3; ++axis) {
    const double length = end[axis] - begin[axis];
    if (length == 0) {
      if (begin[axis] < low[axis] || begin[axis] >= high[axis]) return 0;
      continue;
    }
    const double a = (low[axis] - begin[axis]) / length, b = (high[axis] - begin[axis]) / length;
    from = std::max(from, std::min(a, b));
    to = std::min(to, std::max(a, b));
  }
  return std::max(0.0, to - from);
}

// |b + t l - c|^2 = r^2 with h = b - c: t = (-h.l -+ sqrt((h.l)^2 - l^2 (h^2 - r^2))) / l^2.
double Ball::share_of_line(const Vec3& begin, const Vec3& end) const {
  const Vec3 line = end - begin, from_center = begin - center;
  const double square = line.squaredNorm(), along = from_center.dot(line);
  if (square == 0) return contains(begin) ? 1 : 0;
  const double root = along * along - square * (from_center.squaredNorm() - radius * radius);
  if (!(root > 0)) return 0;
  const double half = std::sqrt(root);
  return std::max(0.0, std::min(1.0, (half - along) / square) - std::max(0.0, (-half - along) / square));
}

// ------------------------------------------------------------------------------------------------------------- spheres

// The lens of two spheres, d = R_a + R_b - U apart: two caps, whose heights h_a and h_b sum to U. With the caps'
// common plane that is pi U^2 (d^2 + 2 d (R_a + R_b) - 3 (R_a - R_b)^2) / (12 d).
double shared_volume(double radius_a, double radius_b, double overlap) {
  if (!(overlap > 0)) return 0;
  const double smaller = std::min(radius_a, radius_b), sum = radius_a + radius_b, distance = sum - overlap;
  if (distance <= sum - 2 * smaller) return 4.0 / 3.0 * pi * smaller * smaller * smaller;  // one inside the other
  const double difference = radius_a - radius_b;
  return pi * overlap * overlap * (distance * distance + 2 * distance * sum - 3 * difference * difference) /
         (12 * distance);
}

double Ball::part_of_sphere(const Vec3& at, double sphere_radius) const {
  return shared_volume(radius, sphere_radius, radius + sphere_radius - (at - center).norm());
}

namespace {

// Parts of the unit ball beyond one, two or three planes square to the axes: x > a, y > b, z > c.
//
// For thresholds that are not negative. By the divergence theorem, with r.n = 1 on the sphere and -a on
// the face x = a,
//   3 V = W - a A_a - b A_b - c A_c,
// where A are the faces' areas and W is that of the part on the sphere. The part is bounded by arcs of circles of
// radius rho_a = sqrt(1 - a^2) that turn through phi_a; an arc's geodesic curvature is a / rho_a, so Gauss and Bonnet
// give
//   W = 2 pi - a phi_a - b phi_b - c phi_c - sum of the turns at the corners,
// and where the circles x = a and y = b meet the boundary turns by the angle between e_x - a p and e_y - b p, the
// arc's inward normals: acos(-a b / (rho_a rho_b)). A part is empty once its innermost point (a, b, c) is outside.
double beyond(double a) { return pi * (1 - a) * (1 - a) * (2 + a) / 3; }

double rho(double a) { return std::sqrt(std::max(0.0, 1 - a * a)); }
double cosine_angle(double x) { return std::acos(std::clamp(x, -1.0, 1.0)); }
double chord(double r, double t) { return std::sqrt(std::max(0.0, r * r - t * t)); }
double turn(double a, double b) { return cosine_angle(-a * b / (rho(a) * rho(b))); }

double beyond(double a, double b) {
  if (a * a + b * b >= 1) return 0;
  const auto half_arc = [](double r, double t) { return cosine_angle(t / r); };
  const auto face = [&](double r, double t) { return r * r * half_arc(r, t) - t * chord(r, t); };
  const double sphere = 2 * pi - 2 * a * half_arc(rho(a), b) - 2 * b * half_arc(rho(b), a) - 2 * turn(a, b);
  return (sphere - a * face(rho(a), b) - b * face(rho(b), a)) / 3;
}

double beyond(double a, double b, double c) {
  if (a * a + b * b + c * c >= 1) return 0;
  // In the circle of radius r the arc beyond s and t, and the face between it and the corner (s, t).
  const auto arc = [](double r, double s, double t) { return cosine_angle(s / r) - std::asin(std::min(1.0, t / r)); };
  const auto face = [&](double r, double s, double t) {
    return 0.5 * (r * r * arc(r, s, t) - s * (chord(r, s) - t) - t * (chord(r, t) - s));
  };
  const double sphere = 2 * pi - a * arc(rho(a), b, c) - b * arc(rho(b), c, a) - c * arc(rho(c), a, b) - turn(a, b) -
                        turn(b, c) - turn(c, a);
  return (sphere - a * face(rho(a), b, c) - b * face(rho(b), c, a) - c * face(rho(c), a, b)) / 3;
}

// The same for thresholds of any sign: what is beyond a negative one is all less what is beyond its mirror image.
double beyond_any(double a) { return a < 0 ? 4.0 / 3.0 * pi - beyond(-a) : beyond(a); }
double beyond_any(double a, double b) {
  if (a < 0) return beyond_any(b) - beyond_any(-a, b);
  if (b < 0) return beyond_any(a) - beyond_any(a, -b);
  return beyond(a, b);
}
double beyond_any(double a, double b, double c) {
  if (a < 0) return beyond_any(b, c) - beyond_any(-a, b, c);
  if (b < 0) return beyond_any(c, a) - beyond_any(a, -b, c);
  if (c < 0) return beyond_any(a, b) - beyond_any(a, b, -c);
  return beyond(a, b, c);
}

}  // namespace

double Box::part_of_sphere(const Vec3& center, double radius) const {
  const Vec3 from = (low - center) / radius, to = (high - center) / radius;
  if ((from.array() >= 1).any() || (to.array() <= -1).any()) return 0;
  if ((from.array() <= -1).all() && (to.array() >= 1).all()) return 4.0 / 3.0 * pi * radius * radius * radius;
  // Beyond the low planes less beyond the high ones, axis by axis: eight corners.
  double sum = 0;
  for (int corner = 0; corner < 8; ++corner) {
    std::array<double, 3> plane;
    double sign = 1;
    for (int axis = 0; axis < 3; ++axis) {
      const bool is_high = corner >> axis & 1;
      plane[axis] = std::clamp(is_high ? to[axis] : from[axis], -1.0, 1.0);
      if (is_high) sign = -sign;
    }
    if (std::max({plane[0], plane[1], plane[2]}) < 1) sum += sign * beyond_any(plane[0], plane[1], plane[2]);
  }
  return std::max(0.0, sum) * radius * radius * radius;
}

// --------------------------------------------------------------------------------------------------------------- cells

CellGrid::CellGrid(const Box& bounds, double cell) : bounds_(bounds) {
  constexpr double most_cells = 1e6;  // along one axis; the product of three still fits a size
  for (int axis = 0; axis < 3; ++axis) {
    const double length = bounds.high[axis] - bounds.low[axis], cells = std::max(1.0, std::round(length / cell));
    if (!(length > 0 && cell > 0 && cells <= most_cells))
      throw InputError(
          fmt::format("a grid of {:.3g} m with cells of {:.3g} m along {}: "
                      "needs a length above 0 and at most {:.0f} "
                      "cells; give other corners, or larger cells",
                      length, cell, "xyz"[axis], most_cells));
    count_[axis] = static_cast<int>(cells);
    cell_[axis] = length / cells;
  }
}

Box CellGrid::cell(int i, int j, int k) const {
  const Vec3 low = bounds_.low + cell_.cwiseProduct(Vec3(i, j, k));
  return {low, low + cell_};
}

std::array<int, 2> CellGrid::range(int axis, double low, double high) const {
  const auto cell_of = [&](double x) {
    return static_cast<int>(std::clamp(std::floor((x - bounds_.low[axis]) / cell_[axis]), -1.0, 1.0 * count_[axis]));
  };
  return {std::max(0, cell_of(low)), std::min(count_[axis] - 1, cell_of(high))};
}

}  // namespace lockstep::dem
