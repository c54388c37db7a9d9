#include "dem_server/wall_shapes.hpp"

#include <algorithm>
#include <cmath>

#include "common/checks.hpp"

namespace lockstep::dem {

namespace {

// A point in the half plane through an axis: distance from it, and along it from its beginning.
struct Meridian {
  double r = 0, s = 0;          // [m]
  Vec3 radial = Vec3::UnitX();  // unit, away from the axis
};

Meridian meridian_of(const Vec3& point, const Vec3& axis, const Vec3& x) {
  Meridian m;
  const Vec3 from_begin = x - point;
  m.s = from_begin.dot(axis);
  const Vec3 across = from_begin - m.s * axis;
  m.r = across.norm();
  m.radial = m.r > 0 ? Vec3(across / m.r) : Vec3(axis.unitOrthogonal());
  return m;
}

// The closest point of the straight piece from (r0, s0) to (r1, s1) to a point at (r, s).
struct PieceFoot {
  double distance = 0;        // [m]
  double to_r = 0, to_s = 0;  // from the foot to the point [m]
};

PieceFoot foot_on_piece(double r0, double s0, double r1, double s1, double r, double s) {
  const double along_r = r1 - r0, along_s = s1 - s0;
  const double length = along_r * along_r + along_s * along_s;
  const double t = length > 0 ? std::clamp(((r - r0) * along_r + (s - s0) * along_s) / length, 0.0, 1.0) : 0.0;
  PieceFoot foot;
  foot.to_r = r - (r0 + t * along_r);
  foot.to_s = s - (s0 + t * along_s);
  foot.distance = std::hypot(foot.to_r, foot.to_s);
  return foot;
}

void make_unit(Vec3& direction, const std::string& where, const char* key, const char* remedy) {
  const double length = direction.norm();
  if (!(length > 0 && std::isfinite(length)))
    throw InputError(fmt::format("{}{} = {} {} {} has no direction; {}", where, key, direction.x(), direction.y(),
                                 direction.z(), remedy));
  direction /= length;
}

void check_positive(double value, const std::string& where, const char* key) {
  if (!(value > 0 && std::isfinite(value)))
    throw InputError(fmt::format("{}{} = {} m is out of range; it must be positive", where, key, value));
}

}  // namespace

Vec3 radial_direction(const Vec3& point, const Vec3& axis, const Vec3& x) { return meridian_of(point, axis, x).radial; }

WallPoint CylinderShape::closest(const Vec3& x) const {
  const Meridian m = meridian_of(point, axis, x);
  if (side == Side::Inside) return {radius - m.r, -m.radial};
  return {m.r - radius, m.radial};
}

WallPoint FrustumShape::closest(const Vec3& x) const {
  const Meridian m = meridian_of(point, axis, x);
  const auto in_space = [&](double to_r, double to_s) -> Vec3 { return to_r * m.radial + to_s * axis; };
  // Outward unit normal of the side in (r, s): the side's direction turned by a right angle.
  const double slant = std::hypot(end_radius - begin_radius, length);
  const double side_r = length / slant, side_s = (begin_radius - end_radius) / slant;

  const PieceFoot on_side = foot_on_piece(begin_radius, 0, end_radius, length, m.r, m.s);
  const double off_side = (m.r - begin_radius) * side_r + m.s * side_s;
  const bool is_inside = off_side <= 0 && m.s >= 0 && m.s <= length;

  if (side == Side::Inside) {
    if (on_side.distance > 0) return {on_side.distance, in_space(on_side.to_r, on_side.to_s) / on_side.distance};
    return {0, in_space(-side_r, -side_s)};
  }
  if (is_inside) {  // out through the nearest of the three surfaces of a convex body
    if (off_side >= -m.s && off_side >= m.s - length) return {off_side, in_space(side_r, side_s)};
    if (m.s <= length - m.s) return {-m.s, -axis};
    return {m.s - length, axis};
  }
  const PieceFoot on_begin = foot_on_piece(0, 0, begin_radius, 0, m.r, m.s);
  const PieceFoot on_end = foot_on_piece(0, length, end_radius, length, m.r, m.s);
  const PieceFoot* nearest = &on_side;
  if (on_begin.distance < nearest->distance) nearest = &on_begin;
  if (on_end.distance < nearest->distance) nearest = &on_end;
  if (nearest->distance > 0) return {nearest->distance, in_space(nearest->to_r, nearest->to_s) / nearest->distance};
  return {0, in_space(side_r, side_s)};
}

double FrustumShape::side_area() const {
  return pi * (begin_radius + end_radius) * std::hypot(end_radius - begin_radius, length);
}

void check(PlaneShape& shape, const std::string& where) {
  make_unit(shape.normal, where, "plane.normal", "give the side where the grains are");
}

void check(CylinderShape& shape, const std::string& where) {
  make_unit(shape.axis, where, "cylinder.axis", "give the direction of the axis");
  check_positive(shape.radius, where, "cylinder.radius");
}

void check(FrustumShape& shape, const std::string& where) {
  make_unit(shape.axis, where, "axis", "give the direction of the axis");
  check_positive(shape.length, where, "length");
  for (const double radius : {shape.begin_radius, shape.end_radius})
    if (!(radius >= 0 && std::isfinite(radius)))
      throw InputError(fmt::format("{}radius = {} m is out of range; no radius may be negative", where, radius));
  if (!(shape.begin_radius + shape.end_radius > 0))
    throw InputError(fmt::format("{}begin_radius = end_radius = 0 m has no surface; give one of them", where));
}

}  // namespace lockstep::dem
