// The state that the ground is in before anything happens: stress from gravity's displacements, or prescribed by depth.
//
//   gravity       K u0 = m g on the supports of InitialStress; sigma of a zone from u0, K0 = nu / (1 - nu)
//   prescribed    sigma_v = -integral of rho g above the zone's centre, sigma_h = K0 sigma_v, one stress a zone, and
//                 f = integral of B^T sigma. On horizontal levels it balances gravity to round-off, since a zone's vertical
//                 force on a level of nodes is sigma_v times area and differs from the next zone's by what is lumped
//                 there; u0 is then what solves the rest, zero but for distorted zones.
// Both are one struct: displacements and zone stresses, which add up.
#pragma once
#include <vector>

#include "common/vectors.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/settings.hpp"

namespace lockstep::continuum {

struct InitialState {
  Vec3s displacement;        // per node [m]
  std::vector<Mat3> stress;  // prescribed per zone; empty: none [Pa]

  InitialState() = default;
  explicit InitialState(Vec3s of_gravity) : displacement(std::move(of_gravity)) {}

  // Mean stress of a zone [Pa].
  Mat3 zone_stress(const Grid& grid, std::size_t z) const;
};

// The prescribed stresses for K0 `k0` under gravity `gravity` [m/s2], for ground in horizontal layers.
std::vector<Mat3> stress_by_depth(const Grid& grid, const std::vector<Layer>& layers, double k0, double gravity);

// Nodal forces of the prescribed stresses of the zones with is_included[z] (empty: all); zero without any [N].
Vec3s prescribed_force(const Grid& grid, const InitialState& state, const std::vector<char>& is_included = {});

}  // namespace lockstep::continuum
