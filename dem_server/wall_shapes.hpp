// Shapes of rigid walls: where a point stands to a plane, a cylinder, or a body of revolution with straight sides.
//
// Each has one closest point, so a sphere has one contact with it; meshes may give several (triangle_mesh.hpp).
//
//   plane      the half space behind it is wall: what is there is pushed back, however deep it is.
//   cylinder   endless along its axis; the wall is all that lies beyond its surface as seen from the grains' side.
//   frustum    finite: a cylinder or a cone, cut square to its axis at both ends.
//              Outside: a solid body, closed by flat ends. A centre inside it is pushed out through the nearest surface.
//              Inside: a thin open shell, without ends. It presses on either side, towards the side a centre is on, so
//              that grains may also lie around a tube; its two rims count.
//
//     r ^                     The half plane (r, s) of a frustum: s along the axis, r from it. The side is the straight
//       |      _--+ r_end     piece from (r_begin, 0) to (r_end, length), the ends run from the axis to its ends. Both
//       |  _--    |           are convex and a point's closest point has the point's own azimuth.
//       +--       |
//   r_begin       |           Inside a frustum that is narrower than the grains the true contact is a ring; one contact
//       +---------+--> s      cannot stand for it. Frustums are made for grains that fit.
//       0      length
#pragma once
#include <string>

#include "common/vectors.hpp"

namespace lockstep::dem {

// Where a point stands to a wall.
struct WallPoint {
  double distance = 0;          // from the surface; negative inside the wall [m]
  Vec3 normal = Vec3::UnitZ();  // unit, from the closest point towards the grain
};

enum class Side { Inside, Outside };  // where the grains are

struct PlaneShape {
  Vec3 point = Vec3::Zero();    // any point of the plane [m]
  Vec3 normal = Vec3::UnitZ();  // unit, towards the grains

  WallPoint closest(const Vec3& x) const { return {(x - point).dot(normal), normal}; }
};

struct CylinderShape {
  Vec3 point = Vec3::Zero();  // any point of the axis [m]
  Vec3 axis = Vec3::UnitZ();  // unit
  double radius = 0;          // [m]
  Side side = Side::Inside;

  WallPoint closest(const Vec3& x) const;
};

struct FrustumShape {
  Vec3 point = Vec3::Zero();  // of the axis, where it begins [m]
  Vec3 axis = Vec3::UnitZ();  // unit, from begin to end
  double begin_radius = 0;    // [m]
  double end_radius = 0;      // [m]
  double length = 0;          // [m]
  Side side = Side::Inside;

  WallPoint closest(const Vec3& x) const;
  bool is_cylinder() const { return begin_radius == end_radius; }
  double side_area() const;  // [m2]
};

// Unit vector from the axis (point, unit direction) to x; any one across the axis when x lies on it.
Vec3 radial_direction(const Vec3& point, const Vec3& axis, const Vec3& x);

// InputError, in words that begin with `where` (file, line and key of the wall), for what has no surface. Directions are
// made unit.
void check(PlaneShape& shape, const std::string& where);
void check(CylinderShape& shape, const std::string& where);
void check(FrustumShape& shape, const std::string& where);

}  // namespace lockstep::dem
