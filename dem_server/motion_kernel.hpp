// The motion of a stretch of bodies over one step, eight at a time (integrator.hpp has the equations). Compiled once for
// each instruction set, like the pair kernel, with the same bits from AVX2 and AVX-512.
#pragma once
#include "dem_server/records.hpp"

namespace lockstep::dem {

struct MotionStretch {
  SphereRecord* bodies;
  MotionRecord* motion;
  LoadRecord* loads;  // zero afterwards
  // Of clumps only.
  AttitudeRecord* attitudes;
  const ShapeRecord* shapes;
  const SphereRecord* shape_pebbles;  // of unit R_eq
  bool are_rows;                      // all of these stand on the first axis
  const std::int32_t* shape_numbers;  // per body
  const std::int32_t* pebble_begin;
  SphereRecord* pebbles;
  TwistRecord* twists;      // of the new positions and velocities
  const char* is_fixed;     // per body; null: none
  std::int32_t begin, end;  // bodies
};

struct MotionStep {
  double gravity[3];  // [m/s2]
  double mean_step;   // (dt_old + dt_new)/2 [s]
  double next_step;   // dt_new [s]
  double damping;     // alpha
  double fastest;     // speed over radius that counts as too fast [1/s]
};

// What a stretch adds up to; MotionTotals says what each is.
struct MotionSums {
  double too_fast = 0;        // 1 if any body is
  double largest_square = 0;  // of the speeds [m2/s2]
  double way = 0;             // at least as far as any pebble has gone in this step [m]
  // From Detail::Works on.
  double translation_energy = 0, rotation_energy = 0;
  double gravity_work = 0, damped_work = 0, contact_work = 0;
  double unbalanced_force = 0;
  double damping_force[3] = {}, momentum[3] = {}, momentum_change[3] = {};
  double moving_mass = 0;
};

using MotionKernel = void (*)(const MotionStretch&, const MotionStep&, MotionSums&);

// One for each instruction set, for spheres or for clumps.
MotionKernel motion_kernel_generic(bool has_clumps, Detail detail);
MotionKernel motion_kernel_avx2(bool has_clumps, Detail detail);
MotionKernel motion_kernel_avx512(bool has_clumps, Detail detail);

}  // namespace lockstep::dem
