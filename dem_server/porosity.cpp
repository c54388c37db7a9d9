#include "dem_server/porosity.hpp"

#include <algorithm>
#include <cmath>

#include "common/checks.hpp"

namespace lockstep::dem {

// -------------------------------------------------------------------------------------------------------------- points

SolidPoints::SolidPoints(const Particles& particles, const Box& bounds, const std::array<std::int64_t, 3>& count)
    : bounds_(bounds), count_(count) {
  constexpr std::int64_t most_points = 1'000'000'000;  // one byte each
  if (count[0] * count[1] > most_points / count[2])
    throw InputError(
        fmt::format("porosity by {} x {} x {} points: that is more than {}; "
                    "use fewer points a diameter, or a smaller "
                    "region",
                    count[0], count[1], count[2], most_points));
  for (int axis = 0; axis < 3; ++axis)
    brick_[axis] = (bounds.high[axis] - bounds.low[axis]) / static_cast<double>(count[axis]);
  is_solid_.assign(static_cast<std::size_t>(count[0] * count[1] * count[2]), 0);
  // Each pebble marks the points in it; a point marked twice is one point.
  for (std::size_t p = 0; p < particles.pebble_count(); ++p)
    mark(particles.pebble_center(p), particles.pebble_radius(p));
}

// Plane by plane and row by row, each a chord of the sphere.
void SolidPoints::mark(const Vec3& center, double radius) {
  const auto chord = [&](int axis, double half) -> std::array<std::int64_t, 2> {
    const double low = std::ceil((center[axis] - half - bounds_.low[axis]) / brick_[axis] - 0.5);
    const double high = std::floor((center[axis] + half - bounds_.low[axis]) / brick_[axis] - 0.5);
    const auto last = static_cast<double>(count_[axis] - 1);
    if (!(low <= last && high >= 0)) return {0, -1};
    return {static_cast<std::int64_t>(std::max(0.0, low)), static_cast<std::int64_t>(std::min(last, high))};
  };
  const auto [first_k, last_k] = chord(2, radius);
  for (std::int64_t k = first_k; k <= last_k; ++k) {
    const double up = place(0, 0, k).z() - center.z(), disc = radius * radius - up * up;
    if (!(disc > 0)) continue;
    const auto [first_j, last_j] = chord(1, std::sqrt(disc));
    for (std::int64_t j = first_j; j <= last_j; ++j) {
      const double aside = place(0, j, k).y() - center.y(), row = disc - aside * aside;
      if (!(row > 0)) continue;
      const auto [first_i, last_i] = chord(0, std::sqrt(row));
      if (first_i <= last_i)
        std::fill_n(is_solid_.begin() + static_cast<std::ptrdiff_t>(index(first_i, j, k)), last_i - first_i + 1,
                    char{1});
    }
  }
}

namespace {

struct PointCount {
  std::int64_t all = 0, room = 0, solid = 0;
  RegionSolid shares() const {
    if (room == 0) return {0, 0};
    return {static_cast<double>(room) / static_cast<double>(all),
            static_cast<double>(solid) / static_cast<double>(room)};
  }
};

// Of the points that `is_inside` accepts: all, those in the room, and the solid ones among them.
template <class Inside>
PointCount count_points(const Particles& particles, const Box& bounds, double spacing, const Inside& is_inside,
                        const Room& room) {
  constexpr double most_a_side = 1e5;
  std::array<std::int64_t, 3> count;
  for (int axis = 0; axis < 3; ++axis) {
    const double length = bounds.high[axis] - bounds.low[axis], points = std::floor(length / spacing);
    if (!(points >= 1 && points < most_a_side))
      throw InputError(
          fmt::format("porosity region of {:.3g} m with points {:.3g} m apart: "
                      "needs 1 to {:.0f} points a "
                      "side; lower the spacing, or give a larger region",
                      length, spacing, most_a_side));
    count[axis] = static_cast<std::int64_t>(points);
  }
  const SolidPoints points(particles, bounds, count);
  PointCount n;
  for (std::int64_t k = 0; k < count[2]; ++k)
    for (std::int64_t j = 0; j < count[1]; ++j)
      for (std::int64_t i = 0; i < count[0]; ++i) {
        const Vec3 x = points.place(i, j, k);
        if (!is_inside(x)) continue;
        ++n.all;
        if (room && !room(x)) continue;
        ++n.room;
        n.solid += points.is_solid(i, j, k);
      }
  return n;
}

double porosity_of(const PointCount& n, double spacing) {
  if (n.room == 0)
    throw InputError(
        fmt::format("porosity region holds none of the points "
                    "{:.3g} m apart: lower the spacing",
                    spacing));
  return n.shares().porosity();
}

}  // namespace

double porosity(const Particles& particles, const Box& bounds, double spacing, const Room& is_inside) {
  return porosity_of(count_points(
                         particles, bounds, spacing, [](const Vec3&) { return true; }, is_inside),
                     spacing);
}

double porosity(const Particles& particles, const Box& region, double spacing) {
  return porosity(particles, region, spacing, Room());
}

double porosity(const Particles& particles, const Ball& region, double spacing) {
  return porosity_of(
      count_points(
          particles, region.bounds(), spacing, [&](const Vec3& x) { return region.contains(x); }, Room()),
      spacing);
}

// -------------------------------------------------------------------------------------------------------------- shares

RegionSolid solid_share(const Particles& particles, std::span<const ContactView> contacts, const Ball& ball,
                        double spacing, const Room& room) {
  const PointCount n = count_points(
      particles, ball.bounds(), spacing, [&](const Vec3& x) { return ball.contains(x); }, room);
  if (particles.has_clumps() || n.room < n.all) return n.shares();
  return {1, solid_of_spheres(particles, contacts, ball) / ball.volume()};
}

namespace {

// Spheres and lenses, each to the cells that they are in: shares of the cells' volume.
std::vector<double> solid_of_spheres_by_cell(const Particles& particles, std::span<const ContactView> contacts,
                                             const CellGrid& grid) {
  std::vector<double> solid(grid.size(), 0);
  for (std::size_t b = 0; b < particles.body_count(); ++b) {
    const Vec3 x = particles.position(b);
    const double radius = particles.equivalent_radius(b);
    const auto [i0, i1] = grid.range(0, x.x() - radius, x.x() + radius);
    const auto [j0, j1] = grid.range(1, x.y() - radius, x.y() + radius);
    const auto [k0, k1] = grid.range(2, x.z() - radius, x.z() + radius);
    for (int k = k0; k <= k1; ++k)
      for (int j = j0; j <= j1; ++j)
        for (int i = i0; i <= i1; ++i) solid[grid.index(i, j, k)] += grid.cell(i, j, k).part_of_sphere(x, radius);
  }
  for (const ContactView& c : contacts)
    if (c.body_b >= 0)
      grid.for_each_piece(c.point, c.point, [&](std::size_t cell, double share) {
        solid[cell] -= share * shared_volume(particles.equivalent_radius(c.body_a),
                                             particles.equivalent_radius(c.body_b), c.overlap);
      });
  for (double& s : solid) s /= grid.cell_volume();
  return solid;
}

}  // namespace

std::vector<RegionSolid> solid_shares(const Particles& particles, std::span<const ContactView> contacts,
                                      const CellGrid& grid, double spacing, const Room& room) {
  // The same number of points in each cell, so that none belongs to two.
  std::array<std::int64_t, 3> in_cell, count;
  for (int axis = 0; axis < 3; ++axis) {
    in_cell[axis] = std::max<std::int64_t>(1, std::llround(grid.cell_size()[axis] / spacing));
    count[axis] = in_cell[axis] * grid.count()[axis];
  }
  const SolidPoints points(particles, grid.bounds(), count);
  std::vector<PointCount> counts(grid.size());
  for (std::int64_t k = 0; k < count[2]; ++k)
    for (std::int64_t j = 0; j < count[1]; ++j)
      for (std::int64_t i = 0; i < count[0]; ++i) {
        PointCount& n = counts[grid.index(static_cast<int>(i / in_cell[0]), static_cast<int>(j / in_cell[1]),
                                          static_cast<int>(k / in_cell[2]))];
        ++n.all;
        if (room && !room(points.place(i, j, k))) continue;
        ++n.room;
        n.solid += points.is_solid(i, j, k);
      }
  std::vector<RegionSolid> shares(grid.size());
  for (std::size_t cell = 0; cell < shares.size(); ++cell) shares[cell] = counts[cell].shares();
  if (particles.has_clumps()) return shares;
  const std::vector<double> exact = solid_of_spheres_by_cell(particles, contacts, grid);
  for (std::size_t cell = 0; cell < shares.size(); ++cell)
    if (counts[cell].room == counts[cell].all) shares[cell].solid = exact[cell];
  return shares;
}

double solid_volume(const Particles& particles) {
  double sum = 0;
  for (std::size_t b = 0; b < particles.body_count(); ++b) sum += std::pow(particles.equivalent_radius(b), 3);
  return 4.0 / 3.0 * pi * sum;
}

}  // namespace lockstep::dem
