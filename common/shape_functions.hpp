// Bilinear quadrilateral and trilinear hexahedron.
//
// Facet: nodes 0..3 counter-clockwise seen from the side its normal points to, (xi, eta) in [-1, 1]^2,
//   3 ---- 2        N_j = (1 + xi_j xi)(1 + eta_j eta) / 4  (paper eq. 13's weights K_j)
//   |      |        normal = dx/dxi x dx/deta
//   0 ---- 1
#pragma once
#include <array>

#include "common/vectors.hpp"

namespace lockstep {

using FacetCorners = std::array<Vec3, 4>;

inline std::array<double, 4> bilinear_weights(double xi, double eta) {
  return {0.25 * (1 - xi) * (1 - eta), 0.25 * (1 + xi) * (1 - eta), 0.25 * (1 + xi) * (1 + eta),
          0.25 * (1 - xi) * (1 + eta)};
}

inline Vec3 interpolate(const std::array<double, 4>& weights, const FacetCorners& x) {
  return weights[0] * x[0] + weights[1] * x[1] + weights[2] * x[2] + weights[3] * x[3];
}

inline Vec3 facet_tangent_xi(const FacetCorners& x, double eta) {
  return 0.25 * ((1 - eta) * (x[1] - x[0]) + (1 + eta) * (x[2] - x[3]));
}

inline Vec3 facet_tangent_eta(const FacetCorners& x, double xi) {
  return 0.25 * ((1 - xi) * (x[3] - x[0]) + (1 + xi) * (x[2] - x[1]));
}

// Area vector of the bilinear facet, exact for warped facets too: half the cross product of its diagonals. [m2]
inline Vec3 facet_area_vector(const FacetCorners& x) { return 0.5 * (x[2] - x[0]).cross(x[3] - x[1]); }

}  // namespace lockstep
