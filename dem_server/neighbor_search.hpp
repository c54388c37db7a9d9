// Which pebbles are near which: grids of cells, one for each class of size, visited when the outer list is made.
//
//   sizes alike:  one grid, cells one interaction range wide          1 : 20:  five grids, each pebble in that of its size;
//   +---+---+---+                                                      a pebble looks into each within its own reach of
//   |   | * |   |  a pebble looks at most into 27 cells                that size, so that small ones do not crowd the
//   +---+---+---+                                                      cells of large ones
//
// Records of pebbles lie in the order of cells, so that three cells in a row are one stretch of memory. Rejected: cells of half
// the width, which hold a third fewer pebbles that are too far but make 25 rows out of 9 (twice the time).
//
// A pebble's partners are found in any order and sorted by index: lists do not depend on the grids.
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "dem_server/particles.hpp"

namespace lockstep::dem {

class NeighborSearch {
 public:
  // Sorts the pebbles into cells. `reach` is the largest gap that counts [m]. With `period` the cell is 0..period in each
  // direction and the nearest image counts; every side must be two interaction ranges long (InputError otherwise).
  // NumericalError, naming the body, when a position is not finite.
  void sort(const Particles& particles, double reach, const std::optional<Vec3>& period);

  // Partners of pebble i where it is now, of others where they were sorted: with a gap below the reach, pebbles of its own
  // body left out, in rising order. May be called by several threads.
  void partners(const Particles& particles, std::int32_t i, std::vector<std::int32_t>& partners) const;
  // Those j > i alone.
  void partners_after(const Particles& particles, std::int32_t i, std::vector<std::int32_t>& partners) const;

  std::size_t memory() const;  // [bytes]

 private:
  struct Grid;
  // Partners from number `lowest` on.
  void find(const Particles& particles, std::int32_t i, std::int32_t lowest, std::vector<std::int32_t>& partners) const;
  // Adds those in one grid, in any order.
  void look_into(const Grid& grid, const Particles& particles, std::int32_t i, const Vec3& center, std::int32_t lowest,
                 std::vector<std::int32_t>& partners) const;

  // Pebbles of radii in (half the largest, largest].
  struct Grid {
    double largest_radius = 0;             // [m]
    Vec3 low = Vec3::Zero();               // corner [m]
    Vec3 cells_per_length = Vec3::Zero();  // [1/m]
    std::array<std::int32_t, 3> count{1, 1, 1};
    std::vector<std::int32_t> cell_begin;  // one more than cells
    std::vector<std::int32_t> pebbles;     // by cell; within a cell in order
    std::vector<SphereRecord> records;     // of these pebbles
    std::int32_t cell_of(const Vec3& point, const std::optional<Vec3>& period) const;
  };
  void fill(Grid& grid, const Particles& particles, const std::vector<std::int32_t>& members, const Vec3& low,
            const Vec3& high);

  double reach_ = 0;  // [m]
  std::optional<Vec3> period_;
  std::vector<Grid> grids_;
};

// What to add to x_j - x_i so that it goes to the nearest image [m].
Vec3 nearest_image(const Vec3& from_i_to_j, const Vec3& period);

}  // namespace lockstep::dem
