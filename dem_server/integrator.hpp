// Motion of the bodies: leap-frog in translation, a symplectic splitting in rotation, local damping.
//
// On entry x(n), q(n), v(n-1/2), forces at n. On return x(n+1), q(n+1), v(n+1/2), pebble centres at n+1.
//
// Translation (paper eqs 14, 16, 17):
//   v(n+1/2) = v(n-1/2) + F*/m (dt_old + dt_new)/2        x(n+1) = x(n) + v(n+1/2) dt_new
// Local damping: each component of the unbalanced force F (gravity included) and torque becomes
//   F* = F - alpha |F| sign(v(n-1/2)).
//
// Rotation. Paper eqs (15), (16) are for spheres. A clump's angular momentum L is what is stepped, in the world frame:
//   L(n+1/2) = L(n-1/2) + T* (dt_old + dt_new)/2,
// so that without torque it is constant to rounding (the sum is done in body axes of t_n, where I is diagonal). Then
// the body turns for dt_new with L held, under
//   H = |L|^2 / 2 I_2 + (1/I_1 - 1/I_2) p_1^2 / 2 + (1/I_3 - 1/I_2) p_3^2 / 2,      p = R^T L in body axes.
// The first term turns the body about L and commutes with the others; the second and third turn it about its own axes 1
// and 3. They are composed symmetrically (half a turn about 1, a turn about 3, half a turn about 1), which is
// symplectic, reversible and of order 2: the energy error stays bounded for ever (splitting after McLachlan 1993).
// Angles are applied by Cayley's map, angle -> 2 atan(angle/2): still a function of the conserved p_k alone, so still
// symplectic, still order 2, and without sines. An axisymmetric clump (I_2 = I_3) needs two turns and is exact up to
// that map. Rejected: Euler's equations stepped for the spin in body axes (order 2 needs an iteration; energy and
// momentum drift).
//
// `spin` is stored so that L can be had back from it: spin = R(q(n+1)) I^-1 R^T L(n+1/2). Body and momentum are half a
// step apart in it, which contact velocities feel only through the precession of fast clumps. A single pebble has no
// attitude to lose: its spin is stepped and its orientation left alone.
//
// Bodies go through motion_kernel.cpp eight at a time, chunk by chunk of chunk_bodies: what a step adds up to is summed
// over chunks in their order, so that neither threads nor instruction set change a bit.
#pragma once
#include <cstdint>
#include <vector>

#include "common/instructions.hpp"
#include "common/parallel.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/travel.hpp"

namespace lockstep::dem {

// Of one step. Work W of a force F(n) is F(n) . (v(n-1/2) + v(n+1/2))/2 times (dt_old + dt_new)/2, with which the
// ledger closes to round-off: kinetic energy of v(n+1/2) less that of v(n-1/2) is the sum of the works.
struct MotionTotals {
  double translation_energy = 0;  // at t_n: m v(n-1/2) . v(n+1/2) / 2 [J]
  double rotation_energy = 0;     // at t_n, likewise [J]
  double kinetic_energy() const { return translation_energy + rotation_energy; }
  double gravity_work = 0;              // [J]
  double damped_work = 0;               // taken out by local damping [J]
  double contact_work = 0;              // done by the forces and torques in `particles` [J]
  double unbalanced_force = 0;          // sum over moving bodies of |F + m g| [N]
  Vec3 damping_force = Vec3::Zero();    // sum of the local damping forces on the bodies [N]
  Vec3 momentum = Vec3::Zero();         // at t_{n+1/2} [kg m/s]
  Vec3 momentum_change = Vec3::Zero();  // of this step [kg m/s]
  double moving_mass = 0;               // of the bodies that are not fixed [kg]
  // These are always there, the others from Detail::Works on.
  double largest_speed = 0;  // [m/s]
  std::vector<double> ways;  // per chunk of chunk_bodies: no pebble has gone farther in this step [m]
  bool is_too_fast =
      false;  // a body crosses MotionOptions::fastest_travel of its radius in this step, or goes nowhere finite
};

struct MotionOptions {
  const std::vector<char>* fixed = nullptr;  // one mark a body: marked bodies keep zero velocity and spin and stay
  Team* team = nullptr;                      // null: the calling thread alone
  const Partition* partition = nullptr;      // null: equal shares
  InstructionSet instructions = best_instructions();
  Detail detail = Detail::All;
  double fastest_travel = 0.5;  // of its radius that a body may cross in a step
};

// `damping` is alpha in [0, 1). The loads of `particles` are zero afterwards, ready for the next step.
MotionTotals integrate(Particles& particles, const Vec3& gravity, double time_step_old, double time_step_new,
                       double damping, const MotionOptions& options = {});

// The body with the largest speed over radius, or the first whose motion is no number; -1 without bodies.
std::int32_t fastest_body(const Particles& particles);

}  // namespace lockstep::dem
