// Spheres of radius 0.03 m at walls, moved by leap-frog: a five-line world for the tests of walls.
#pragma once
#include "common/random.hpp"
#include "dem_server/walls.hpp"

namespace lockstep::dem {

inline constexpr double R = 0.03;                 // [m]
inline constexpr double sphere_density = 2650;    // [kg/m3]
inline constexpr double standard_gravity = 9.81;  // [m/s2]

inline ClumpTemplate unit_sphere() { return {{Vec3::Zero()}, {1.0}, Vec3::Constant(0.4), 1.0}; }

inline Particles spheres_at(const Vec3s& centers) {
  Particles p;
  for (const Vec3& center : centers) p.add(unit_sphere(), R, sphere_density, center, Quat::Identity());
  p.clear_forces();
  return p;
}

inline GrainMaterial grain() {
  GrainMaterial m;
  m.contact_modulus = 94e6;
  m.stiffness_ratio = 8;
  return m;
}

inline double k_n() { return grain().contact_modulus * 2 * R; }

// Orientation is of no interest for spheres. A share `damping` of the force is taken from what moves with it (local
// damping).
inline void move(Particles& p, double dt, const Vec3& gravity = Vec3::Zero(), double damping = 0) {
  for (std::size_t b = 0; b < p.body_count(); ++b) {
    Vec3 force = p.force(b) + p.mass(b) * gravity;
    for (int k = 0; k < 3; ++k) force[k] -= damping * std::abs(force[k]) * (p.velocity(b)[k] > 0 ? 1 : -1);
    p.velocity(b) += force / p.mass(b) * dt;
    p.spin(b) += p.torque(b) / p.inertia(b).x() * dt;
    p.position(b) += p.velocity(b) * dt;
  }
  p.place_pebbles();
}

// Marks for lists, as the pair contacts keep them: renewed before any pebble has strayed farther than its limit.
class Marks {
 public:
  explicit Marks(double limit) : limit_(limit) {}
  const TravelLimits& renew_if_needed(const Particles& p) {
    bool has_strayed = marks_.size() != p.pebble_count();
    for (std::size_t i = 0; i < p.pebble_count() && !has_strayed; ++i) {
      const SphereRecord& m = marks_[i];
      has_strayed = (p.pebble_center(i) - Vec3(m.x, m.y, m.z)).norm() > m.radius;
    }
    if (has_strayed) {
      marks_.clear();
      for (std::size_t i = 0; i < p.pebble_count(); ++i) {
        const Vec3 c = p.pebble_center(i);
        marks_.push_back({c.x(), c.y(), c.z(), limit_});
      }
      ++limits_.renewal;
      limits_.marks = marks_.data();
    }
    return limits_;
  }

 private:
  double limit_;  // [m]
  std::vector<SphereRecord> marks_;
  TravelLimits limits_;
};

inline WallSettings wall(WallShape shape, const Vec3& velocity = Vec3::Zero()) {
  WallSettings w;
  w.shape = std::move(shape);
  w.velocity = velocity;
  return w;
}

inline Vec3s forces_on(const Particles& p) {  // of all bodies [N]
  Vec3s forces;
  for (std::size_t b = 0; b < p.body_count(); ++b) forces.push_back(p.force(b));
  return forces;
}

}  // namespace lockstep::dem
