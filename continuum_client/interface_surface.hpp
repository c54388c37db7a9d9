// The interface with the grains: its nodes and facets in the order that holds for the whole session, where its nodes
// are, and what the deleted zones did to it.
//
// Signs as on the wire: forces and tractions are those ON the continuum, normals point into the grains.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "common/shape_functions.hpp"
#include "common/vectors.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/initial_stress.hpp"

namespace lockstep::continuum {

// Vertical and horizontal stress of one level of the discrete domain, volume means, tension positive.
struct LevelStress {
  double z = 0;           // of the level's middle [m]
  double vertical = 0;    // sigma_zz [Pa]
  double horizontal = 0;  // (sigma_xx + sigma_yy) / 2 [Pa]
};

struct InterfaceSurface {
  std::vector<std::int32_t> node;                  // grid node of each interface node, rising
  std::vector<std::array<std::int32_t, 4>> facet;  // interface nodes
  std::vector<std::int32_t> ring;                  // per facet
  Vec3s position;                                  // x(n), advanced by x += v dt only [m]

  std::size_t node_count() const { return node.size(); }
  std::size_t facet_count() const { return facet.size(); }
  FacetCorners corners(std::size_t f) const;
  // Mean edge of the facets at the reference, the scale that displacements are compared with [m].
  double mean_facet_size() const;

  // x(n+1) = x(n) + v(n+1/2) dt: the very expression that the grains' side uses, on the same doubles.
  void advance(const Vec3s& interface_velocity, double dt) {
    for (std::size_t i = 0; i < position.size(); ++i) position[i] += interface_velocity[i] * dt;
  }
  std::uint64_t position_hash() const;
};

InterfaceSurface interface_surface(const Grid& grid);

// Values of a grid field at the interface's nodes; `values` is reused.
void gather_interface(const InterfaceSurface& surface, const Vec3s& field, Vec3s& values);

// f_A per interface node: what the zones of the discrete domain do to the nodes they share with the others, weight
// included:
// -(K_e u)_i + m_e g summed over those zones. Zero everywhere for a mesh that deletes none [N].
Vec3s discrete_domain_reaction(const Grid& grid, const InterfaceSurface& surface, double gravity,
                               const InitialState& state);

// Mean stress per facet of the zones on either side of it that own it as a face [Pa].
std::vector<Voigt> facet_stress(const Grid& grid, const InterfaceSurface& surface, const InitialState& state);

// Traction per facet on the continuum [Pa] such that the facets' sum is the nodes': first sigma n, lumped to nodes by
// bilinear weights; what a node's f_A has beyond that is shared out to its facets by area. Lumping f_A alone would
// smear the bottom's vertical force over the lowest ring of the side, and its horizontal one over the rim of the
// bottom.
Vec3s facet_traction(const InterfaceSurface& surface, const std::vector<Voigt>& stress, const Vec3s& reaction);

// Integrals of the four bilinear weights over a facet [m2]; their sum is its area, exact for plane ones.
std::array<double, 4> nodal_areas(const FacetCorners& corners);

// By rising z; empty if the mesh deletes no zones.
std::vector<LevelStress> discrete_domain_profile(const Grid& grid, const InitialState& state);

// Mean stress per zone [Pa].
std::vector<Voigt> zone_stresses(const Grid& grid, const InitialState& state);

}  // namespace lockstep::continuum
