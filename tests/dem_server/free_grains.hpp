// A crowd of grains without walls, stepped as the cycle does: a five-line world for the tests of this folder.
#pragma once
#include <optional>

#include "dem_server/clumps.hpp"
#include "dem_server/contacts.hpp"
#include "dem_server/integrator.hpp"

namespace lockstep::dem {

struct FreeGrains {
  explicit FreeGrains(double skin = 0.005, std::optional<Vec3> period = {}) : contacts(skin, period) {}

  Particles particles;
  PairContacts contacts;
  GrainMaterial material;
  Vec3 gravity = Vec3::Zero();
  double damping = 0;
  bool tells_ways = false;  // to the lists; nothing but steps may move the grains then
  ContactTotals totals;
  MotionTotals motion;
  double slip_work = 0, dashpot_work = 0, damped_work = 0;  // since the start [J]

  std::int32_t sphere(const Vec3& center, double radius, double density = 2650) {
    return particles.add(make_clump(1, 1), radius, density, center, Quat::Identity());
  }

  void step(double dt) {
    particles.clear_forces();
    contacts.update(particles, Team::alone(), tells_ways ? motion.ways : std::vector<double>{});
    totals = contacts.compute(particles, material, dt);
    motion = integrate(particles, gravity, dt, dt, damping);
    slip_work += totals.slip_work;
    dashpot_work += totals.dashpot_work;
    damped_work += motion.damped_work;
  }

  // Of the last step, at t_n [J].
  double energy() const { return motion.kinetic_energy() + totals.elastic_energy(); }

  Vec3 momentum() const {
    Vec3 sum = Vec3::Zero();
    for (std::size_t b = 0; b < particles.body_count(); ++b) sum += particles.mass(b) * particles.velocity(b);
    return sum;
  }

  // About the origin. Position at t_n and velocity at t_{n-1/2} (or both a step later) pair without error, since the
  // position between them moves along the velocity.
  Vec3 angular_momentum() const {
    Vec3 sum = Vec3::Zero();
    for (std::size_t b = 0; b < particles.body_count(); ++b) {
      const Mat3 r = particles.orientation(b).toRotationMatrix();
      sum += particles.mass(b) * particles.position(b).cross(particles.velocity(b)) +
             r * particles.inertia(b).cwiseProduct(r.transpose() * particles.spin(b));
    }
    return sum;
  }

  std::uint64_t state_hash() const {
    Hash h;
    particles.hash(h);
    contacts.hash(h);
    return h.value();
  }
};

}  // namespace lockstep::dem
