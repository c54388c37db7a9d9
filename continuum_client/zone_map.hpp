// A zone as the image of the cube -1 .. 1 under its trilinear map, x = sum N_a(xi) x_a: where in it a point lies, and the
// values of nodal fields there. Linear fields are met exactly whatever the zone's shape, since sum N_a x_a = x.
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/vectors.hpp"
#include "continuum_client/grid.hpp"

namespace lockstep::continuum {

// A point of the ground: its zone and the weights N_a of the zone's nodes there, which sum to 1.
struct Place {
  std::int32_t zone = -1;
  std::array<double, 8> weight{};

  // sum N_a value_a of a nodal field.
  Vec3 interpolate(const Grid& grid, const Vec3s& field) const;
  // The zone's node that is nearest in the cube: the one of the largest weight; of equal ones the first.
  std::int32_t nearest_node(const Grid& grid) const;
};

// Coordinates in the cube of a point, also of one that is a little outside; empty where Newton's iteration on x(xi) = point
// leaves the cube's surroundings or does not settle.
std::optional<Vec3> cube_coordinates(const ZoneVectors& corners, const Vec3& point);

// The first zone with is_included[z] (empty: all) that holds the point, its faces included to plane_tolerance of the ground's
// size; empty if there is none. Walks all zones: for places that are looked up once.
std::optional<Place> find_place(const Grid& grid, const std::vector<char>& is_included, const Vec3& point);

// The point of the included zones' surface that is nearest to `point`, faces taken as four triangles around their middle [m].
Vec3 nearest_on_surface(const Grid& grid, const std::vector<char>& is_included, const Vec3& point);

}  // namespace lockstep::continuum
