// The polygons in which a plane cuts zones.
//
// Each zone is walked face by face. A corner counts as above the plane where its height d >= 0, heights below
// plane_tolerance of the ground's size being zero; an edge between a corner above and one below is cut at one point. On a face,
// counter-clockwise seen from outside, the edge that goes down and the one that comes up again enclose each run of corners
// above: a segment joins their points. Every cut edge goes down in one of its zone's two faces and up in the other, so that the
// segments close to loops, which are the polygons.
//
//     d>0 +--------+ d>0      two zones that share a face see the same segment on it, also where the face is warped: it
//         |        |          depends on heights alone. So the polygons meet edge to edge and cover what is cut once.
//      *--|--------|--*       A plane along faces cuts the zones below it, with corners of d = 0 as points, and not those
//         |        |          above it; where there are none below, the outer faces of those above are taken.
//     d<0 +--------+ d<0
//
// Points lie on edges of zones, where displacement is linear between the two ends: linear fields are met exactly. Rejected:
// tetrahedra, with ten times as many polygons for the same points on edges.
#pragma once
#include <cstdint>
#include <vector>

#include "common/vectors.hpp"
#include "continuum_client/grid.hpp"

namespace lockstep::continuum {

// On the edge from node a to node b: (1 - share) a + share b.
struct CutPoint {
  std::int32_t a = 0, b = 0;
  double share = 0;

  Vec3 interpolate(const Vec3s& field) const { return (1 - share) * field[a] + share * field[b]; }
};

struct Section {
  std::vector<CutPoint> point;
  std::vector<std::vector<std::int32_t>> polygon;  // of points, counter-clockwise seen from the normal's tip
  std::vector<std::int32_t> zone;                  // per polygon
};

// The plane through `point` with `normal` (any length), cut through the zones with is_included[z] (empty: all).
Section cut_zones(const Grid& grid, const std::vector<char>& is_included, const Vec3& point, const Vec3& normal);

}  // namespace lockstep::continuum
