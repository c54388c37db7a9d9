// Clumps: rigid rows of overlapping pebbles (paper, section 2.3), as shapes of unit equivalent radius.
//
//        A = elongation
//   .--(   )--.            The pebbles of a row stand on the long axis of an ellipsoid of revolution with A/B =
//  (  ( ( ) )  ) B   x ->  elongation, each as large as fits inside it; the outermost have the ellipsoid's radius of
//   '--(   )--'            curvature at its tip, B^2/A, and their centres bound an even spacing, for even and odd counts
//                          alike. Two pebbles cannot cover the middle that way: they are equal spheres with the
//                          ellipsoid's length and width instead.
//
// Volume, mass and inertia are those of the UNION of the pebbles: adding pebbles up counts their overlaps twice and
// makes a 3-pebble clump 26 % too heavy, a 9-pebble clump 319 %.
#pragma once
#include "dem_server/shapes.hpp"

namespace lockstep::dem {

inline constexpr int most_pebbles = 9;  // more change the union's volume by less than 1 % and cost as much again

// Shape with 1 to most_pebbles `pebbles` along x and A/B = `elongation` in [1, 2], scaled so that the union has the
// volume of the unit sphere. One pebble, or elongation 1, is the sphere. InputError for other counts or elongations.
ClumpTemplate make_clump(int pebbles, double elongation);

// Any row of pebbles that is symmetric about x = 0, scaled alike. `center` along x and `radius` in any common unit, at
// least one pebble; the union must be one piece.
ClumpTemplate row_of_pebbles(const std::vector<double>& center, const std::vector<double>& radius);

}  // namespace lockstep::dem
