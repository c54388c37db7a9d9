// Where pebbles touch the faces of facets, eight pebble-facet pairs at a time: the common case of interface_facets.hpp, without its
// edges and corners. Compiled once for each instruction set, like the pair kernel, with the same bits as closest_point().
//
// No includes but records: see there.
#pragma once
#include "dem_server/records.hpp"

namespace lockstep::dem {

// One node of the surface in a step.
struct alignas(64) FacetNode {
  double x, y, z, unused_x;     // contact geometry, t_n [m]
  double vx, vy, vz, unused_v;  // t_{n-1/2} [m/s]
};

// A box in a facet's own frame that holds it.
struct alignas(64) FacetBox {
  double x, y, z, unused;  // its centre [m]
  struct Axis {
    double x, y, z, half;  // unit, orthogonal; half the extent along it [m]
  } axis[3];
};

struct FacetSurface {
  const SphereRecord* pebbles;
  const FacetNode* nodes;
  const FacetBox* boxes;
  const std::int32_t (*corners)[4];  // nodes of each facet
};

// Pairs of a pebble and a facet that it might touch.
struct FacetPairs {
  const std::int32_t* pebble;
  const std::int32_t* facet;
};

enum class FaceContact : std::int32_t {
  None,      // the foot lies inside the face, and the pebble does not reach it
  Touching,  // the foot lies inside the face, and the pebble reaches it
  Unknown    // on an edge or a corner, or the facet is too warped: ask closest_point()
};

// The foot of a pebble on a facet, where it lies inside the face.
struct alignas(32) FaceFoot {
  double weight[4];   // N_j
  double nx, ny, nz;  // unit normal, into the grains
  double overlap;     // along it [m]
};

inline constexpr int facet_block = 8;

struct FacetKernels {
  // Writes those pairs of [begin, end) whose pebble comes nearer to the facet's box than its radius and `reach` more [m] to `near`,
  // and returns how many they are.
  std::int32_t (*find_near)(const FacetSurface&, const FacetPairs&, std::int32_t begin, std::int32_t end, double reach,
                            std::int32_t* near);
  // The feet of `count` pairs `near`.
  void (*find_feet)(const FacetSurface&, const FacetPairs&, const std::int32_t* near, std::int32_t count,
                    FaceFoot* feet, FaceContact* contacts);
  // What is written needs room for facet_block more than there are.
};

// One for each instruction set; not there where this build has it not.
FacetKernels facet_kernel_generic();
FacetKernels facet_kernel_avx2();
FacetKernels facet_kernel_avx512();

}  // namespace lockstep::dem
