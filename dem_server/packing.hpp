// The grains of a scene, placed but not yet balanced: single grains, a lattice, or a packing that fills the container.
//
// A packing is cut from a relaxed periodic cube (generation.hpp): the cube is tiled over the container, grains that
// come too near to sides, bottom or pile are left out, and the count asked for is met by the size of the grains, since
// the whole cube may be magnified: contact stiffness goes with the radius, so a magnified cube is the same packing.
// What touches too hard after the cut is relaxed by the caller before gravity is switched on. Rejected: growing the
// radii in place (3 to 6 times the time) and pouring (slower still, and not at rest at the end).
#pragma once
#include <functional>
#include <string_view>
#include <vector>

#include "dem_server/generation.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/settings.hpp"

namespace lockstep::dem {

struct Assembly {
  Particles particles;
  std::vector<char> is_fixed;       // empty: none
  double mean_radius = 0;           // equivalent [m]
  double solid_density = 0;         // as used [kg/m3]
  double cube_porosity = 0;         // at its packing pressure; 0 without a packing
  double overall_porosity = 0;      // of the container less the pile; 0 without a packing
  double preparation_friction = 0;  // in the cube
};

// Threads that pay for so many grains, at most `threads`: a thread with less to do waits for the others longer than it
// works, and on a busy machine loses its core each time.
int worthwhile_threads(std::size_t grains, int threads);

// Of the scene's packing, with a mean radius [m]; threads and progress are left to the caller.
CubeRequest cube_request(const Settings& settings, double radius);

using Heartbeat = std::function<void(std::string_view text, double fraction)>;

// `ground_density` is the bulk density of the ground that the grains replace [kg/m3]. The bits do not depend on
// `threads`.
Assembly assemble(const Settings& settings, double ground_density, const Heartbeat& heartbeat, int threads = 1);

// Porosity of the packing as it stands, away from sides, bottom, surface and pile, whose order loosens it; 0 when the container
// is too narrow to have such a place.
double bulk_porosity(const Settings& settings, const Assembly& assembly, const Particles& particles);

// Brings radii, porosity and density up to date after the grains of a packing were grown: with MATCH_CONTINUUM they
// weigh again what the ground weighed. Nothing for scenes without a packing.
void refit(Assembly& assembly, const Settings& settings, double ground_density, Particles& particles);

}  // namespace lockstep::dem
