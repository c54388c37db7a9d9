// The zone: an 8-node hexahedron in mixed discretization (Marti & Cundall, Int. J. Numer. Anal. Methods Geomech. 6,
// 1982), as FLAC3D has it.
//
//        7 ------- 6       Two overlays of five constant-strain tetrahedra fill the zone, each overlay with a large one
//        in
//       /|        /|       the middle (nodes 0 2 5 7, or 1 3 4 6) and four at the corners. Shape change is taken from
//       each
//      4 ------- 5 |       tetrahedron, volume change from the overlay as a whole:
//      | 3 ------|-2         e_t = sym(sum_a u_a (x) g_a),  theta = sum_t V_t tr(e_t) / sum_t V_t
//      |/        |/          sigma_t = 2 G (e_t - tr(e_t) I / 3) + K theta I
//      0 ------- 1           f_a = 1/2 sum_overlays sum_t V_t sigma_t g_a
//
// Why: tetrahedra alone lock when the material hardly changes volume, since each then has a constraint of its own; a
// shared theta leaves one per overlay. Why two overlays: one alone puts diagonals on the faces that do not meet those
// of the next zone and fails the patch test by 5e-3; the mean of the two has both diagonals on each face. Rejected:
// 2x2x2 B-bar, better in bending but not what the paper's code does; the assembled operator (internal_force.hpp) makes
// both cost the same. Small strain: gradients are those of the reference shape, always.
#pragma once
#include <array>

#include "common/vectors.hpp"
#include "continuum_client/elastic_law.hpp"

namespace lockstep::continuum {

// How strains are taken from a zone's nodes; the scene chooses.
enum class ZoneKind { MixedDiscretization, BBar, OnePoint };

using ZoneVectors = std::array<Vec3, 8>;  // one per node, in the order of the drawing
using ZoneMatrix = Eigen::Matrix<double, 24, 24>;

inline constexpr int overlay_count = 2;
inline constexpr int tetrahedra_per_overlay = 5;

// Node numbers of each tetrahedron, positive volume in a positive zone.
inline constexpr std::array<std::array<std::array<int, 4>, tetrahedra_per_overlay>, overlay_count> zone_tetrahedra = {{
    {{{0, 2, 7, 5}, {1, 2, 0, 5}, {3, 0, 2, 7}, {4, 7, 5, 0}, {6, 5, 7, 2}}},
    {{{1, 3, 4, 6}, {0, 1, 3, 4}, {2, 3, 1, 6}, {5, 4, 6, 1}, {7, 6, 4, 3}}},
}};

struct ZoneGeometry {
  double volume[overlay_count][tetrahedra_per_overlay];                 // [m3]
  std::array<Vec3, 4> gradient[overlay_count][tetrahedra_per_overlay];  // of the linear shape functions [1/m]

  double smallest_volume() const;  // of a tetrahedron; not positive: the zone is turned inside out [m3]
  double zone_volume() const;      // mean of the overlays [m3]
};

ZoneGeometry zone_geometry(ZoneKind kind, const ZoneVectors& corners);

// Nodal forces that hold the zone in the shape given by `displacement` [N].
ZoneVectors zone_force(const ZoneGeometry& geometry, const ElasticModuli& moduli, const ZoneVectors& displacement);

// Mean stress of the zone, weighted by volume [Pa].
Mat3 zone_stress(const ZoneGeometry& geometry, const ElasticModuli& moduli, const ZoneVectors& displacement);

// 24 x 24, row 3 a + i for component i at node a: zone_force of each unit displacement, symmetrized to the last bit
// [N/m].
ZoneMatrix zone_stiffness(const ZoneGeometry& geometry, const ElasticModuli& moduli);

// Share of the zone's volume that is lumped to each node: a quarter of each tetrahedron, halved for two overlays [m3].
std::array<double, 8> nodal_volumes(const ZoneGeometry& geometry);

}  // namespace lockstep::continuum
