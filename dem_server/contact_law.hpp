// The linear contact with an incremental shear spring and Coulomb friction (paper eqs 2-3 and 8-11), for pairs of
// grains and for grains against walls, pile and facets alike: a free function of (material, geometry, dt, history).
//
//   normal n from A to B, overlap U = R_A + R_B - d > 0
//   F_n = k_n U n                                             (eq. 3)  acts on B, and -F_n on A
//   V   = velocity of B at the contact point less that of A   (eq. 4)
//   the spring s (a force on A) first turns with the normal, then s += k_s V_s dt   (eqs 8-10; notes, 3)
//   |s| is cut to mu |F_n| and keeps its direction            (eq. 11)
// Force on A = s - F_n n (plus dashpots); on B the opposite.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "common/vectors.hpp"

namespace lockstep::dem {

struct ContactMaterial {
  double normal_stiffness = 0;  // k_n of the pair [N/m]
  double shear_stiffness = 0;   // k_s of the pair [N/m]
  double friction = 0;          // [-]
  double normal_dashpot = 0;    // [N s/m]; the total normal force never pulls
  double shear_dashpot = 0;     // [N s/m]
};

// Floor of 1 + n0 . n: a normal that flips over in one step (1 + n0 . n = 0) leaves the spring instead of dividing by
// zero.
inline constexpr double smallest_turn = 1e-9;

// What a contact with a wall, the pile or a facet remembers from step to step. (Pairs of grains keep the spring alone.)
struct ContactHistory {
  Vec3 spring = Vec3::Zero();  // shear force on A at the last step [N]
  Vec3 normal = Vec3::Zero();  // unit normal of the last step; zero for a contact that was not touching
};

struct ContactResult {
  Vec3 force_on_a;       // [N]; force on B is its negative
  double normal_force;   // pressing positive, dashpot included [N]
  double slip_work;      // taken out by sliding in this step [J]
  double dashpot_power;  // taken out by dashpots [W]
};

// One contact, as output, measurement and the step guard see it: the same for every family of contacts.
struct ContactView {
  std::int32_t body_a = -1;
  std::int32_t body_b = -1;        // -1: not a grain (wall, pile or facet)
  Vec3 point = Vec3::Zero();       // middle of the overlap, t_n [m]
  Vec3 normal = Vec3::Zero();      // unit, from A to B
  double overlap = 0;              // [m]
  double normal_stiffness = 0;     // [N/m]
  double shear_stiffness = 0;      // [N/m]
  Vec3 force_on_a = Vec3::Zero();  // [N]
};

// What two grains are made of. The pair's stiffness belongs to the grains' size, so that the packing's modulus does
// not.
struct GrainMaterial {
  double contact_modulus = 94e6;  // E* [Pa]
  double stiffness_ratio = 8;     // k_n / k_s [-]
  double friction = 0.7;          // [-]
  double damping_ratio = 0;       // of the normal dashpot; see damping_ratio() [-]

  // k_n = E* (R_eq,a + R_eq,b), radii of the equivalent spheres of the whole clumps [N/m].
  double normal_stiffness(double radius_a, double radius_b) const { return contact_modulus * (radius_a + radius_b); }
};

// Share zeta of critical damping that makes two bodies part at `restitution` times the speed they met with. InputError
// outside [0.001, 1]. The force never pulls, so they part when spring and dashpot together reach zero, before the
// overlap is gone; for a linear pair that gives (Schwager & Poeschel, Granular Matter 9, 2007, eq. 21, with its angles
// summed up)
//   ln e = -2 zeta acos(zeta) / sqrt(1 - zeta^2),        acosh and sqrt(zeta^2 - 1) above 1.
// The textbook zeta = -ln e / sqrt(pi^2 + ln^2 e) holds for a contact that may pull; asked for 0.5 it would give 0.55
// here.
double damping_ratio(double restitution);

// Dashpot of a pair [N s/m]: c = 2 zeta sqrt(k m_eff), m_eff = m_a m_b / (m_a + m_b).
inline double pair_dashpot(double ratio, double stiffness, double mass_a, double mass_b) {
  return 2 * ratio * std::sqrt(stiffness * mass_a * mass_b / (mass_a + mass_b));
}

// `relative_velocity` is V: velocity of B at the contact point less that of A [m/s]. Updates the history; a contact
// that does not touch (overlap <= 0) forgets it. `material.friction` may be infinite. Inline, for it is the hot loop's
// body.
//
// The spring turns with the normal by the smallest rotation that takes the last normal n0 to n. With s . n0 = 0 that is
//   s <- s - (n0 + n) (n . s) / (1 + n0 . n),
// which keeps |s| (Rodrigues' formula for the axis n0 x n). Spin about the normal does not turn the spring. The pair
// kernel does the same without n0.
inline ContactResult contact_force(const ContactMaterial& material, const Vec3& normal, double overlap,
                                   const Vec3& relative_velocity, double time_step, ContactHistory& history) {
  if (!(overlap > 0)) {
    history = ContactHistory{};
    return {Vec3::Zero(), 0.0, 0.0, 0.0};
  }
  const double normal_velocity = relative_velocity.dot(normal);  // parting is positive
  const Vec3 shear_velocity = relative_velocity - normal_velocity * normal;

  const double elastic_force = material.normal_stiffness * overlap;
  const double normal_force = std::max(0.0, elastic_force - material.normal_dashpot * normal_velocity);
  double dashpot_power = -(normal_force - elastic_force) * normal_velocity;

  // A contact that was not touching has a zero normal and a zero spring: the turn below leaves the spring zero.
  Vec3 spring = history.spring;
  const double turn = std::max(smallest_turn, 1 + history.normal.dot(normal));
  spring -= (normal.dot(spring) / turn) * (history.normal + normal);
  const Vec3 turned = spring;
  spring += material.shear_stiffness * time_step * shear_velocity;

  const double limit = material.friction * normal_force;
  const double squared = spring.squaredNorm();
  double slip_work = 0;
  Vec3 shear_force = spring;
  if (squared > limit * limit) {
    // The slip distance is what the cut takes from the spring, over k_s. Leap-frog's work of a displacement is done by
    // the mean of the forces before and after it; with that mean the slip's book closes to second order.
    const double kept = limit / std::sqrt(squared);
    if (material.shear_stiffness > 0)
      slip_work = 0.5 * (1 - kept) * (turned + kept * spring).dot(spring) / material.shear_stiffness;
    spring *= kept;
    shear_force = spring;
  } else if (material.shear_dashpot > 0) {
    shear_force += material.shear_dashpot * shear_velocity;
    const double total = shear_force.norm();
    if (total > limit) shear_force *= limit / total;
    dashpot_power += (shear_force - spring).dot(shear_velocity);
  }
  history.spring = spring;
  history.normal = normal;
  return {shear_force - normal_force * normal, normal_force, slip_work, dashpot_power};
}

// Elastic energy held by a contact's two springs [J].
inline double contact_energy(const ContactMaterial& m, double overlap, const ContactHistory& history) {
  const double shear = m.shear_stiffness > 0 ? history.spring.squaredNorm() / m.shear_stiffness : 0.0;
  return 0.5 * (m.normal_stiffness * overlap * overlap + shear);
}

}  // namespace lockstep::dem
