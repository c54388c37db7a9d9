// The zone: an 8-node hexahedron, strains taken at a few points of it. A point has a volume V, gradients g_a of the nodes'
// shape functions, and a group over which the volume's change is averaged:
//   e = sym(sum_a u_a (x) g_a),   theta = sum_group V tr(e) / sum_group V
//   sigma = 2 G (e - tr(e) I / 3) + K theta I,   f_a = sum V sigma g_a
//
//        7 ------- 6       mixed discretization (Marti & Cundall, Int. J. Numer. Anal. Methods Geomech. 6, 1982), as
//       /|        /|       FLAC3D has it: two overlays of five constant-strain tetrahedra fill the zone, each overlay
//      / |       / |       with a large one in the middle (nodes 0 2 5 7, or 1 3 4 6) and four at the corners. Points
//     4 ------- 5  |       are the ten tetrahedra, with half their volume; groups are the overlays.
//     |  3 -----|--2       B-bar (Hughes, Int. J. Numer. Methods Eng. 15, 1980): 2 x 2 x 2 Gauss points, one group.
//     | /       | /        One point: the exact mean gradient, and stiffness against the four hourglass patterns that it
//     |/        |/         does not see (Flanagan & Belytschko, Int. J. Numer. Methods Eng. 17, 1981).
//     0 ------- 1
//
// Why groups: points with a theta of their own lock when the material hardly changes volume. Why two overlays: one alone
// puts diagonals on the faces that do not meet those of the next zone and fails the patch test by 5e-3; the mean of the
// two has both diagonals on each face. Small strain: gradients are those of the reference shape.
//
// Hourglass patterns h_alpha, without what they have of linear fields: gamma_a = (h_a - sum_i (h . x_i) g_a,i) / 8. With
// q = sum_a gamma_a u_a they resist with f_a = C q gamma_a, C = kappa G V sum_a |g_a|^2. Of G and not of K + 4 G / 3,
// which would lock as nu goes to 1/2.
#pragma once
#include <array>

#include "common/vectors.hpp"
#include "continuum_client/elastic_law.hpp"
#include "continuum_client/zone_topology.hpp"

namespace lockstep::continuum {

// How strains are taken from a zone's nodes; the scene chooses.
enum class ZoneKind { MixedDiscretization, BBar, OnePoint };

using ZoneVectors = std::array<Vec3, 8>;  // one per node, in the order of the drawing
using ZoneMatrix = Eigen::Matrix<double, 24, 24>;

// Trilinear shape functions N_a and their gradients in the cube -1 .. 1.
struct ShapeFunctions {
  std::array<double, 8> value;
  std::array<Vec3, 8> gradient;
};
ShapeFunctions trilinear(const Vec3& xi);
// dx/dxi, columns along xi, eta, zeta [m].
Mat3 jacobian(const ShapeFunctions& shape, const ZoneVectors& corners);

struct StrainPoint {
  double volume = 0;               // [m3]
  int group = 0;                   // of those that share a dilatation
  std::array<Vec3, 8> gradient{};  // of the nodes' shape functions [1/m]
};

struct ZoneGeometry {
  static constexpr int most_points = 10, most_groups = 2, patterns = 4;
  int point_count = 0, group_count = 0;
  std::array<StrainPoint, most_points> point;
  std::array<double, most_groups> group_volume{};           // [m3]
  std::array<double, 8> nodal_volume{};                     // share of the volume that is lumped to each node [m3]
  std::array<std::array<double, 8>, patterns> hourglass{};  // gamma, of one-point zones
  double hourglass_stiffness = 0;                           // C / G; zero: the points see every pattern [m]
  double smallest_volume =
      0;  // of a tetrahedron, or 8 det(dx/dxi) at a Gauss point or corner; not positive: the zone is
          // turned inside out [m3]

  double zone_volume() const;  // [m3]
};

ZoneGeometry zone_geometry(ZoneKind kind, const ZoneVectors& corners);

// Nodal forces that hold the zone in the shape given by `displacement` [N].
ZoneVectors zone_force(const ZoneGeometry& geometry, const ElasticModuli& moduli, const ZoneVectors& displacement);

// Mean stress of the zone, weighted by volume [Pa].
Mat3 zone_stress(const ZoneGeometry& geometry, const ElasticModuli& moduli, const ZoneVectors& displacement);

// Mean strain of the zone, weighted by volume [-].
Mat3 zone_strain(const ZoneGeometry& geometry, const ZoneVectors& displacement);

// Nodal forces of one stress in the whole zone: the integral of B^T sigma [N].
ZoneVectors zone_force_of_stress(const ZoneGeometry& geometry, const Mat3& stress);

// 24 x 24, row 3 a + i for component i at node a; symmetric to the last bit [N/m].
ZoneMatrix zone_stiffness(const ZoneGeometry& geometry, const ElasticModuli& moduli);

}  // namespace lockstep::continuum
