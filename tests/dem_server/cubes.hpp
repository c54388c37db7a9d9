// Packed cubes small enough for a test.
#pragma once
#include "common/checks.hpp"
#include "dem_server/generation.hpp"

namespace lockstep::dem {

// The first cube, from the request's seed on, that meets its porosity; `request` is left with its seed. make_cube gives
// a seed up after five frictions, and the fewer the grains, the more their porosity scatters: of 24 seeds 8 are refused
// with 60 grains, 1 to 3 with 150. Five seeds in a row are one time in 3e4 at one refusal in eight; more is a fault.
inline Cube first_cube(CubeRequest& request) {
  constexpr int most_refused = 4;
  for (int refused = 0; true; ++refused, ++request.seed) {
    try {
      return make_cube(request);
    } catch (const NumericalError&) {
      if (refused == most_refused) throw;
    }
  }
}

}  // namespace lockstep::dem
