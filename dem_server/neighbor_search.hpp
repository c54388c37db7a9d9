// Which pebbles are near which: a uniform grid of cells, visited once per build.
//
// The list is the half list (each pair once, i < j), pebbles of one body left out, sorted by (i, j). Sorted lists make
// sums over contacts independent of when the list was built: a pair that does not touch adds nothing, wherever it
// stands.
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "dem_server/particles.hpp"

namespace lockstep::dem {

struct PebblePair {
  std::int32_t i, j;  // pebbles, i < j
  std::int32_t a, b;  // their bodies
};

// Pairs whose gap is below `reach` [m], appended nowhere: `pairs` is overwritten. With `period` the cell is 0..period
// in each direction and the nearest image counts; every side must be two interaction ranges long (InputError
// otherwise). NumericalError, naming the body, when a position is not finite.
class NeighborSearch {
 public:
  void find(const Particles& particles, double reach, const std::optional<Vec3>& period,
            std::vector<PebblePair>& pairs);

 private:
  std::vector<std::int32_t> cell_of_pebble_;
  std::vector<std::int32_t> cell_begin_;
  std::vector<std::int32_t> pebbles_by_cell_;
  std::vector<std::int32_t> near_;  // of the pebble at hand
};

// Whole cells to add to x_i - x_j so that it becomes the nearest image's.
std::array<std::int16_t, 3> nearest_image(const Vec3& from_i_to_j, const Vec3& period);

}  // namespace lockstep::dem
