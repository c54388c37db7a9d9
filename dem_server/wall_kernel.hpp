// Contacts of grains with rigid surfaces, eight at a time: which pebbles touch a plane or a cylinder, and what touching
// ones and their surface do to each other. Compiled once for each instruction set, like the pair kernel; the bits are
// those of contact_law.hpp and wall_shapes.hpp, contact by contact.
//
// No includes but records: see there.
#pragma once
#include "dem_server/records.hpp"

namespace lockstep::dem {

// A pebble that touches a surface.
struct alignas(64) WallTouch {
  double nx, ny, nz;  // unit, from the surface towards the grain, world
  double overlap;     // [m]
  std::int32_t pebble;
  std::int32_t body;
  std::int32_t part;     // wall's index, or PilePart
  std::int32_t heir_of;  // whose spring it goes on with, among those of the last step; -1: none's
};

// What a contact hands to the next step.
struct alignas(64) WallSpring {
  double sx, sy, sz;  // shear force on the grain [N]
  std::int32_t pebble, part;
  double nx, ny, nz;  // unit normal, from grain to wall
  std::int32_t body, unused;
};

// What a contact has done in this step.
struct alignas(64) WallPress {
  double fx, fy, fz;        // on the grain [N]
  double normal_force;      // |F_n| [N]
  double elastic_energy;    // [J]
  double slip_work;         // taken out by sliding in this step [J]
  double dashpot_work;      // taken out by the dashpot in this step [J]
  double power;             // of the wall on the grain [W]
  double x, y, z;           // middle of the overlap [m]
  double overlap;           // [m]
  double normal_stiffness;  // [N/m]
  double shear_stiffness;   // [N/m]
  double overlap_ratio;     // over the pebble's radius
  std::int32_t part, unused;
};

// What contacts add up to, each sum in their order.
struct alignas(32) WallSums {
  double fx = 0, fy = 0, fz = 0;                                          // on the grains [N]
  double normal_force = 0;                                                // [N]
  double mx = 0, my = 0, mz = 0, unused_m = 0;                            // of these forces about the centre [N m]
  double elastic_energy = 0, slip_work = 0, dashpot_work = 0, power = 0;  // [J], [W]
  double normal_stiffness = 0;                                            // [N/m]
  double largest_overlap_ratio = 0;
  std::int64_t contacts = 0;
};

struct GrainRecords {
  const SphereRecord* pebbles;
  const MotionRecord* motion;  // of spheres
  const TwistRecord* twists;   // of clumps; null for spheres
  LoadRecord* loads;
};

struct WallLaw {
  double contact_modulus;  // E* [Pa]
  double stiffness_ratio;  // k_n / k_s
  double friction;
  double damping_ratio;
  double time_step;  // the step that led to t_n [s]
};

// How a rigid surface moves: a point x of it with v + w x (x - c). [m], [m/s], [rad/s]
struct WallMotion {
  double velocity[3], spin[3], center[3];
};

// A velocity that a point of the surface has beside that [m/s].
struct alignas(32) SurfaceVelocity {
  double x, y, z, unused;
};

// A shape in its own frame, where x_world = centre + turn x.
struct ShapeFrame {
  double center[3];   // [m]
  double turn[3][3];  // [row][column]
};
struct PlaneFace {
  double point[3], normal[3];
};
struct CylinderFace {
  double point[3], axis[3];
  double across[3];  // unit, where a centre on the axis is pushed
  double radius;     // [m]
  double outside;    // 1: grains outside; -1: inside
};

struct WallKernels {
  // Those of the `count` candidates (pebbles) that touch: pebble, normal and overlap. `touches` has room for wall_block
  // more than there are candidates. Returns how many touch.
  std::int32_t (*touch_plane)(const GrainRecords&, const ShapeFrame&, const PlaneFace&, const std::int32_t* candidates,
                              std::int32_t count, WallTouch* touches);
  std::int32_t (*touch_cylinder)(const GrainRecords&, const ShapeFrame&, const CylinderFace&,
                                 const std::int32_t* candidates, std::int32_t count, WallTouch* touches);
  // Presses: adds loads to the bodies, in the order of touches. One `surface` velocity a touch, or null.
  // `springs` and `presses` have room for wall_block more.
  void (*press)(const GrainRecords&, const WallLaw&, const WallMotion&, const SurfaceVelocity* surface,
                const WallTouch* touches, std::int32_t count, const WallSpring* last_step, WallSpring* springs,
                WallPress* presses);
  // Adds contacts to sums, moments about `center` [m].
  void (*add_up)(const WallPress* presses, std::int32_t count, const double* center, WallSums& sums);
  TwistMaker make_twists;
};

inline constexpr int wall_block = 8;

// One for each instruction set; not there where this build has it not.
WallKernels wall_kernel_generic();
WallKernels wall_kernel_avx2();
WallKernels wall_kernel_avx512();

}  // namespace lockstep::dem
