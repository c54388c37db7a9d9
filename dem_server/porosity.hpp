// Porosity: the share of a region's room that no pebble covers, overlaps counted once.
//
// Two ways to count the solid.
//   spheres: the part of each sphere in the region, exact, less the lens that two spheres share (each lens belongs to the
//            region that holds its contact point). What is left out is what three spheres share.
//   clumps:  their pebbles overlap by design, so points are counted: equal bricks fill the region, and the brick's middle
//            is in a pebble or is not. In a cell of volume V with solid surface S, points h apart err by about
//            0.2 h^2 sqrt(S) / V; the README has the figure as measured.
//
// The room is what grains could fill: the region less pile, walls and ground. Where these cut a region points are
// counted even for spheres.
#pragma once
#include <functional>
#include <span>
#include <vector>

#include "dem_server/contact_law.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/regions.hpp"

namespace lockstep::dem {

// Says of a point whether grains could be there. Empty: everywhere.
using Room = std::function<bool(const Vec3&)>;

// The middles of equal bricks that fill a box, each in a pebble or not.
class SolidPoints {
 public:
  // `count` bricks along each axis.
  SolidPoints(const Particles& particles, const Box& bounds, const std::array<std::int64_t, 3>& count);
  std::int64_t count(int axis) const { return count_[axis]; }
  Vec3 place(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return bounds_.low + brick_.cwiseProduct(Vec3(static_cast<double>(i) + 0.5, static_cast<double>(j) + 0.5,
                                                  static_cast<double>(k) + 0.5));
  }
  bool is_solid(std::int64_t i, std::int64_t j, std::int64_t k) const { return is_solid_[index(i, j, k)] != 0; }

 private:
  std::size_t index(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return static_cast<std::size_t>((k * count_[1] + j) * count_[0] + i);
  }
  void mark(const Vec3& center, double radius);

  Box bounds_;
  std::array<std::int64_t, 3> count_;
  Vec3 brick_;  // [m]
  std::vector<char> is_solid_;
};

// By points `spacing` [m] apart. A spacing of R/8 gives 0.002 on 100 grains. InputError if the region holds no point.
double porosity(const Particles& particles, const Box& region, double spacing);
double porosity(const Particles& particles, const Ball& region, double spacing);
// In the part of the box that `is_inside` accepts (a ring, a wedge, a sleeve).
double porosity(const Particles& particles, const Box& bounds, double spacing, const Room& is_inside);

// Volume of spheres in a region, overlaps of two counted once [m3]. `contacts` are the touching pairs; no clumps.
template <class Region>
double solid_of_spheres(const Particles& particles, std::span<const ContactView> contacts, const Region& region) {
  double sum = 0;
  for (std::size_t b = 0; b < particles.body_count(); ++b)
    sum += region.part_of_sphere(particles.position(b), particles.equivalent_radius(b));
  for (const ContactView& c : contacts)
    if (c.body_b >= 0 && region.contains(c.point))
      sum -= shared_volume(particles.equivalent_radius(c.body_a), particles.equivalent_radius(c.body_b), c.overlap);
  return sum;
}

struct RegionSolid {
  double room = 1;   // share of the region that grains could fill [-]
  double solid = 0;  // share of that room that they fill [-]
  double porosity() const { return 1 - solid; }
};

// In a ball: exact for spheres where the whole ball is room, else by points `spacing` [m] apart. A ball without room
// has room 0 and solid 0.
RegionSolid solid_share(const Particles& particles, std::span<const ContactView> contacts, const Ball& ball,
                        double spacing, const Room& room);
// In each cell of a grid, in the same ways.
std::vector<RegionSolid> solid_shares(const Particles& particles, std::span<const ContactView> contacts,
                                      const CellGrid& grid, double spacing, const Room& room);

// Volume of the bodies' shapes: mass over density is what a scene knows; equivalent radius is what a body knows [m3].
double solid_volume(const Particles& particles);

}  // namespace lockstep::dem
