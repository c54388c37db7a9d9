// The innermost loop of the grains: forces of a stretch of the contact list, eight entries at a time.
//
// Compiled once for each instruction set (generic x86-64, AVX2, AVX-512) from pair_kernel.cpp and chosen at run time.
// AVX2 and AVX-512 give the same bits, since lanes do the arithmetic of single doubles and sums have a fixed order; generic
// x86-64 has no multiply-add in one rounding (common/lanes.hpp) and differs in the last bits.
// Specialised for what the scene has: a kernel for spheres reads no levers, one without friction no springs.
//
// No includes but records: see there.
#pragma once
#include "dem_server/records.hpp"

namespace lockstep::dem {

inline constexpr int tile_size = 8;

// Eight entries of the list. Entries that only fill up a tile name the record behind the last pebble.
struct alignas(64) PairTile {
  std::int32_t i[tile_size], j[tile_size];  // pebbles, i < j
};
struct alignas(64) BodyTile {
  std::int32_t a[tile_size], b[tile_size];  // their bodies; only where there are clumps
};
struct alignas(64) SpringTile {
  double x[tile_size], y[tile_size], z[tile_size];  // shear force on A at the last step [N]; zero while parted
};
struct alignas(64) ShiftTile {
  double x[tile_size], y[tile_size], z[tile_size];  // added to x_j - x_i in a periodic cell [m]
};

struct PairState {
  const SphereRecord* pebbles;
  const SphereRecord* bodies;  // centres and equivalent radii; only a periodic cell asks for them
  const MotionRecord* motion;  // of spheres
  const TwistRecord* twists;   // of clumps
  LoadRecord* loads;
  // Loads of bodies outside are put nowhere: where entries fill up the last tile, and by a bounded kernel, since another
  // thread computes the same contact for them.
  std::int32_t first_body, end_body;
};

struct PairStretch {
  const PairTile* pairs;
  const BodyTile* bodies;   // null for spheres
  const ShiftTile* shifts;  // null without a periodic cell
  SpringTile* springs;      // null without friction
  std::size_t tiles;
};

struct PairLaw {
  double contact_modulus;  // E* [Pa]
  double shear_share;      // k_s / k_n
  double friction;
  double damping_ratio;
  double time_step;  // the step that led to t_n [s]
  double strain_rate_x, strain_rate_y,
      strain_rate_z;  // of a periodic cell in that step: bodies part by so much of their distance [1/s]
};

// What a stretch adds up to.
struct PairSums {
  // From Detail::Works on.
  double slip_work = 0;     // [J]
  double dashpot_work = 0;  // [J]
  // Detail::All.
  double active = 0;         // touching entries
  double normal_force = 0;   // sum of |F_n| [N]
  double contact_force = 0;  // sum of |F| [N]
  double normal_energy = 0;  // [J]
  double shear_energy = 0;   // [J]
  double largest_overlap_ratio = 0;
  double virial_x = 0, virial_y = 0, virial_z = 0;  // sum of force on A times branch to B, periodic cells only [J]
};

struct PairKernelTraits {
  bool has_clumps = false;
  bool has_friction = true;
  bool has_dashpot = false;
  bool is_periodic = false;
  Detail detail = Detail::All;
};

struct PairKernels {
  using Kernel = void (*)(const PairState&, const PairStretch&, const PairLaw&, PairSums&);
  Kernel free, bounded;  // the second heeds first_body and end_body in all tiles
  TwistMaker make_twists;
};

// One for each instruction set; not there where this build has it not.
PairKernels pair_kernel_generic(const PairKernelTraits& traits);
PairKernels pair_kernel_avx2(const PairKernelTraits& traits);
PairKernels pair_kernel_avx512(const PairKernelTraits& traits);

}  // namespace lockstep::dem
