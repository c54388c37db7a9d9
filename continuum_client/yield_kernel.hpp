// What zones that have yielded exert beside f0 + K u, eight zones at a time (yielding_zones.hpp). Compiled once for each
// instruction set, with the same bits.
#pragma once
#include <cstdint>

#include "continuum_client/zone_blocks.hpp"

namespace lockstep::continuum {

struct YieldingMaterial;

// Of the eight zones of a ZoneBlock. Tensors by component: xx yy zz xy yz zx.
struct alignas(64) YieldBlock {
  double shear[8], bulk[8];         // [Pa]
  double friction[8], strength[8];  // sin phi [-], c cos phi [Pa]
  double initial[6][8];             // stress of the reference state [Pa]
  double plastic[6][8];             // stress less that of the elastic law: -D times the plastic strain [Pa]
  double stress[6][8];              // of the last step [Pa]
  std::int32_t material[8];
  bool has_yielded = false;  // any of them, ever
};

struct YieldSums {
  double energy = 0;          // what the elastic energy has beside u . (f0 + f) / 2 [J]
  double dissipated = 0;      // in this step [J]
  std::int64_t yielding = 0;  // zones, in this step
};

// Brings the plastic stresses of `count` blocks to the displacements u, from those they have; f += their forces, as ZoneKernel.
using YieldKernel = YieldSums (*)(const ZoneBlock* blocks, YieldBlock* states, std::int32_t count,
                                  const std::int32_t* tables, const YieldingMaterial* materials, const Components& x,
                                  const Components& u, const Components& f, std::int32_t f_begin);

YieldKernel yield_kernel_generic();
YieldKernel yield_kernel_avx2();
YieldKernel yield_kernel_avx512();

// The law itself, of one zone: `stress`, xx yy zz xy yz zx, goes back to the surface. Whether it was beyond it.
bool yield_zone(const YieldingMaterial* materials, std::int32_t material, double* stress);

}  // namespace lockstep::continuum
