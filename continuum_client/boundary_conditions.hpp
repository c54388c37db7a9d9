// Supports: which components of which nodes are held at zero velocity. Only the planes x = const, y = const of the
// sides and z = const of the bottom are supported; the top is free.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "common/shape_functions.hpp"
#include "common/vectors.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/settings.hpp"

namespace lockstep::continuum {

// Per node and component 1 where it is free and 0 where it is held. Nodes without mass are held, and all nodes in the
// directions where `is_free_direction` is 0.
Vec3s free_components(const Grid& grid, Supports supports, const std::vector<double>& mass,
                      const Vec3& is_free_direction = Vec3::Ones());

// Loads that stand in for supports that are taken away: the reaction f_int - f_ext of each component that was held in
// `before` and is free in `after`, zero elsewhere; empty if there is none [N].
Vec3s released_reactions(const Vec3s& before, const Vec3s& after, const Vec3s& internal, const Vec3s& external);

// A face of one zone alone, nodes of the grid.
struct OuterFace {
  std::array<std::int32_t, 4> node{};
  std::int32_t zone = 0;
};
std::vector<OuterFace> outer_faces(const Grid& grid, const std::vector<char>& is_included);
FacetCorners corners_of(const Grid& grid, const OuterFace& face);

// Viscosities that let waves out of a quiet boundary (Lysmer & Kuhlemeyer, J. Eng. Mech. Div. ASCE 95, 1969): rho c_p A
// along the normal and rho c_s A across, A a node's bilinear share of its faces. Empty where `supports` has none
// [N s/m].
//
// Exact for waves that arrive along the normal, but for the zones' own dispersion; of the energy of P-waves at 45
// degrees 0.6 % comes back, at 60 degrees 4 %. A quiet boundary has no stiffness: it keeps the reactions that
// released_reactions() hands it, and creeps away under what is added for good.
Vec3s quiet_dashpots(const Grid& grid, Supports supports, const std::vector<char>& is_included);

// Nodal forces of the full traction [N]. InputError if no face has its centre in the box.
Vec3s loaded_nodes(const Grid& grid, const SurfaceLoad& load, const std::vector<char>& is_included);

// Share of the full traction at `time` since the load began [-].
double load_share(const SurfaceLoad& load, double time);

// s(t) = 3 t^2 - 2 t^3 from 0 to 1: starts and ends without a kink, so that what follows it sends no wave of its own.
inline double smoothstep(double t) { return t >= 1 ? 1.0 : t * t * (3 - 2 * t); }

}  // namespace lockstep::continuum
