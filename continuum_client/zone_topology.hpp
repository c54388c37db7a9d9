// A zone's nodes, faces and hourglass patterns: plain numbers, for the kernels too. The order of nodes is that of the
// drawing in zone_kinematics.hpp.
#pragma once

namespace lockstep::continuum {

// Faces by node numbers, seen from outside counter-clockwise.
constexpr int zone_faces[6][4] = {{0, 3, 2, 1}, {4, 5, 6, 7}, {0, 1, 5, 4}, {1, 2, 6, 5}, {2, 3, 7, 6}, {3, 0, 4, 7}};

// Where the nodes stand in the cube -1 .. 1.
constexpr int node_at[8][3] = {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1},
                               {-1, -1, 1},  {1, -1, 1},  {1, 1, 1},  {-1, 1, 1}};

// Of nodes' displacements that a single point does not see: xi eta, eta zeta, zeta xi, xi eta zeta.
constexpr int hourglass_pattern(int pattern, int node) {
  const auto& x = node_at[node];
  return pattern == 3 ? x[0] * x[1] * x[2] : x[pattern] * x[(pattern + 1) % 3];
}

}  // namespace lockstep::continuum
