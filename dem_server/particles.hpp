// The grains: rigid bodies (clumps of pebbles; a sphere is a clump of one) and walls' view of them.
//
// Time levels on entry to a cycle: position, orientation and pebble centres at t_n, velocity and spin at t_{n-1/2}.
// Body arrays are indexed by body, pebble arrays by pebble; the pebbles of body b are pebble_begin[b] ..
// pebble_begin[b+1]-1.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/hash.hpp"
#include "common/vectors.hpp"

namespace lockstep::dem {

// A rigid shape whose union of pebbles has the volume of the unit sphere, in its principal axes, about its centre of
// mass. clumps.hpp makes them.
struct ClumpTemplate {
  Vec3s pebble_center;                   // [R_eq]
  std::vector<double> pebble_radius;     // [R_eq]
  Vec3 inertia_per_mass = Vec3::Zero();  // principal moments / (m R_eq^2); 0.4 each for a sphere
  double bounding_radius = 1;            // [R_eq]
};

struct Particles {
  // One entry a body.
  Vec3s position;                         // centre of mass, t_n [m]
  std::vector<Quat> orientation;          // body frame -> world, t_n
  Vec3s velocity;                         // t_{n-1/2} [m/s]
  Vec3s spin;                             // world frame, t_{n-1/2} [rad/s]
  std::vector<double> mass;               // [kg]
  std::vector<double> equivalent_radius;  // of the sphere of the same volume [m]
  Vec3s inertia;                          // principal moments, body frame [kg m2]
  Vec3s force;                            // sum of contact forces at t_n, gravity not included [N]
  Vec3s torque;                           // about the centre of mass, world frame [N m]
  std::vector<std::int32_t> pebble_begin = {0};

  // One entry a pebble.
  std::vector<std::int32_t> pebble_body;
  Vec3s pebble_offset;                // from the centre of mass, body frame [m]
  std::vector<double> pebble_radius;  // [m]
  Vec3s pebble_center;                // world frame, t_n [m]

  std::size_t body_count() const { return position.size(); }
  std::size_t pebble_count() const { return pebble_body.size(); }

  // Adds a body at rest and returns its index.
  std::int32_t add(const ClumpTemplate& shape, double radius, double density, const Vec3& center, const Quat& attitude);
  // Pebble centres from the body's pose.
  void place_pebbles();
  void place_pebbles(std::int32_t body);
  // The same for a caller that has the rotation matrix of the body's orientation.
  void place_pebbles(std::int32_t body, const Mat3& rotation) {
    const Vec3 center = position[body];
    for (std::int32_t p = pebble_begin[body]; p < pebble_begin[body + 1]; ++p)
      pebble_center[p] = center + rotation * pebble_offset[p];
  }
  // Multiplies every length of a body by `factor`; density is kept.
  void scale(std::int32_t body, double factor);
  // Keeps only the bodies for which keep[b] is true, in order.
  void keep_only(const std::vector<char>& keep);
  // Velocity of the material point of `body` at `point`.
  Vec3 velocity_at(std::int32_t body, const Vec3& point) const {
    return velocity[body] + spin[body].cross(point - position[body]);
  }
  void add_force(std::int32_t body, const Vec3& at, const Vec3& f) {
    force[body] += f;
    torque[body] += (at - position[body]).cross(f);
  }
  void clear_forces();
  void hash(Hash& h) const;
};

}  // namespace lockstep::dem
