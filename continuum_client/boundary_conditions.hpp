// Supports: which components of which nodes are held at zero velocity. Only the planes x = const, y = const of the
// sides and z = const of the bottom are supported; the top is free.
#pragma once
#include <vector>

#include "common/vectors.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/settings.hpp"

namespace lockstep::continuum {

// Per node and component 1 where it is free and 0 where it is held. Nodes without mass are held.
Vec3s free_components(const Grid& grid, Supports supports, const std::vector<double>& mass);

// Loads that stand in for supports that are taken away: the reaction f_int - f_ext of each component that was held in
// `before` and is free in `after`, zero elsewhere; empty if there is none [N].
Vec3s released_reactions(const Vec3s& before, const Vec3s& after, const Vec3s& internal, const Vec3s& external);

}  // namespace lockstep::continuum
