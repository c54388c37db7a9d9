// The records that kernels work on. Plain data and no includes but integers, since kernels are compiled for several
// instruction sets: an inline function of a library, compiled once for a newer machine, could be the one that an older
// machine is given at link time.
#pragma once
#include <cstddef>
#include <cstdint>

namespace lockstep::dem {

struct alignas(32) SphereRecord {
  double x, y, z, radius;  // [m]
};

struct alignas(64) MotionRecord {
  double vx, vy, vz;  // t_{n-1/2} [m/s]
  double radius;      // R_eq again: differences of records give that of the radii for nothing [m]
  double wx, wy, wz;  // world frame, t_{n-1/2} [rad/s]
  double mass;        // [kg]
};

// About the origin of coordinates, so that a contact puts one force and one moment on both bodies, with opposite signs.
struct alignas(64) LoadRecord {
  double fx, fy, fz, unused_f;  // [N]
  double mx, my, mz, unused_m;  // [N m]
};

// A clump's motion as that of its point at the origin of coordinates: v - w x x. Any point p of it moves with v + w x p, so
// that of two bodies a contact needs the difference alone.
struct alignas(64) TwistRecord {
  double vx, vy, vz;  // [m/s]
  double mass;        // [kg]
  double wx, wy, wz;  // [rad/s]
  double radius;      // R_eq [m]
};

// Makes those of bodies begin..end-1.
using TwistMaker = void (*)(const SphereRecord* bodies, const MotionRecord* motion, TwistRecord* twists,
                            std::int32_t begin, std::int32_t end);

struct alignas(32) AttitudeRecord {
  double qx, qy, qz, qw;  // body frame -> world, t_n
};

// What bodies of one shape have in common; shapes.hpp makes them.
struct alignas(64) ShapeRecord {
  double i1, i2, i3, is_clump;       // principal moments [m R_eq^2]; 1 for a clump, 0 for a sphere among clumps
  double over_i1, over_i2, over_i3;  // their inverses
  double farthest_square;            // of the pebbles' centres from the centre of mass [R_eq^2]
  std::int32_t first_pebble = 0, pebbles = 0;  // among those of all shapes
};

// How much of what a step adds up to is wanted.
enum class Detail {
  Forces,  // nothing
  Works,   // what can only be summed step by step
  All
};

}  // namespace lockstep::dem
