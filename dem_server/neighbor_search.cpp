#include "dem_server/neighbor_search.hpp"

#include <algorithm>
#include <cmath>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

Vec3 nearest_image(const Vec3& from_i_to_j, const Vec3& period) {
  Vec3 shift;
  for (int k = 0; k < 3; ++k) shift[k] = -std::round(from_i_to_j[k] / period[k]) * period[k];
  return shift;
}

namespace {

constexpr double most_cells_a_side = 1e6;

Vec3 wrapped(Vec3 x, const std::optional<Vec3>& period) {
  if (period)
    for (int k = 0; k < 3; ++k) x[k] -= (*period)[k] * std::floor(x[k] / (*period)[k]);
  return x;
}

void check_finite(const Particles& particles, std::int32_t pebble) {
  const SphereRecord& p = particles.pebbles()[pebble];
  if (std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z)) return;
  const std::int32_t body = particles.pebble_body(pebble);
  throw NumericalError(fmt::format(
      "grain {} is no longer at a finite place (mass {:.3g} kg, radius {:.3g} m): lower fidelity.step_fraction", body,
      particles.mass(body), particles.equivalent_radius(body)));
}

}  // namespace

std::int32_t NeighborSearch::Grid::cell_of(const Vec3& point, const std::optional<Vec3>& period) const {
  const Vec3 x = wrapped(point, period);
  std::array<std::int32_t, 3> c;
  for (int k = 0; k < 3; ++k)
    c[k] = std::clamp(static_cast<std::int32_t>((x[k] - low[k]) * cells_per_length[k]), 0, count[k] - 1);
  return (c[2] * count[1] + c[1]) * count[0] + c[0];
}

void NeighborSearch::sort(const Particles& particles, double reach, const std::optional<Vec3>& period) {
  reach_ = reach;
  period_ = period;
  grids_.clear();
  const auto pebbles = static_cast<std::int32_t>(particles.pebble_count());
  if (pebbles == 0) return;

  Vec3 low = particles.pebble_center(0), high = low;
  double largest = 0, smallest = particles.pebble_radius(0);
  for (std::int32_t p = 0; p < pebbles; ++p) {
    check_finite(particles, p);
    const Vec3 center = particles.pebble_center(p);
    low = low.cwiseMin(center);
    high = high.cwiseMax(center);
    largest = std::max(largest, particles.pebble_radius(p));
    smallest = std::min(smallest, particles.pebble_radius(p));
  }
  if (period) {
    low.setZero(), high = *period;
    const double range = 2 * largest + reach;
    if (high.minCoeff() < 2 * range)
      throw InputError(
          fmt::format("grains.packing.cube_grains: a periodic cube of {:.3g} m is less than two interaction "
                      "ranges ({:.3g} m) wide, so that a grain would meet its own image; ask for more grains",
                      high.minCoeff(), range));
  }

  // One grid while sizes are alike; else one for each halving of the radius.
  const int classes = largest < grid_size_ratio * smallest ? 1 : 1 + static_cast<int>(std::log2(largest / smallest));
  std::vector<std::vector<std::int32_t>> members(static_cast<std::size_t>(classes));
  for (std::int32_t p = 0; p < pebbles; ++p) {
    const int of = classes > 1 ? static_cast<int>(std::log2(largest / particles.pebble_radius(p))) : 0;
    members[static_cast<std::size_t>(std::clamp(of, 0, classes - 1))].push_back(p);
  }
  for (const auto& group : members) {
    if (group.empty()) continue;
    grids_.emplace_back();
    fill(grids_.back(), particles, group, low, high);
  }
}

// Counting sort of the members by cell.
void NeighborSearch::fill(Grid& grid, const Particles& particles, const std::vector<std::int32_t>& members,
                          const Vec3& low, const Vec3& high) {
  for (const std::int32_t p : members) grid.largest_radius = std::max(grid.largest_radius, particles.pebble_radius(p));
  grid.low = low;
  const double range = 2 * grid.largest_radius + reach_;
  // A cloud that is mostly empty may not ask for more cells than pebbles can use.
  const double most_cells = cells_per_pebble * static_cast<double>(members.size()) + 64;
  Vec3 cells = ((high - low) / range).array().floor().min(most_cells_a_side).max(1.0).matrix();
  while (cells.prod() > most_cells) cells = (0.5 * cells).array().floor().max(1.0).matrix();
  for (int k = 0; k < 3; ++k) {
    grid.count[k] = static_cast<std::int32_t>(cells[k]);
    grid.cells_per_length[k] = grid.count[k] > 1 ? grid.count[k] / (high[k] - low[k]) : 0;
  }
  grid.cell_begin.assign(static_cast<std::size_t>(grid.count[0]) * grid.count[1] * grid.count[2] + 1, 0);
  std::vector<std::int32_t> cell(members.size());
  for (std::size_t m = 0; m < members.size(); ++m) {
    cell[m] = grid.cell_of(particles.pebble_center(members[m]), period_);
    ++grid.cell_begin[cell[m] + 1];
  }
  for (std::size_t c = 1; c < grid.cell_begin.size(); ++c) grid.cell_begin[c] += grid.cell_begin[c - 1];
  std::vector<std::int32_t> next(grid.cell_begin.begin(), grid.cell_begin.end() - 1);
  grid.pebbles.resize(members.size());
  grid.records.resize(members.size());
  for (std::size_t m = 0; m < members.size(); ++m) {
    const auto place = static_cast<std::size_t>(next[cell[m]]++);
    grid.pebbles[place] = members[m];
    grid.records[place] = particles.pebbles()[members[m]];
  }
}

void NeighborSearch::partners(const Particles& particles, std::int32_t i, std::vector<std::int32_t>& partners) const {
  find(particles, i, 0, partners);
}

void NeighborSearch::partners_after(const Particles& particles, std::int32_t i,
                                    std::vector<std::int32_t>& partners) const {
  find(particles, i, i + 1, partners);
}

void NeighborSearch::find(const Particles& particles, std::int32_t i, std::int32_t lowest,
                          std::vector<std::int32_t>& partners) const {
  partners.clear();
  const Vec3 center = wrapped(particles.pebble_center(i), period_);
  for (const Grid& grid : grids_) look_into(grid, particles, i, center, lowest, partners);
  std::sort(partners.begin(), partners.end());
}

void NeighborSearch::look_into(const Grid& grid, const Particles& particles, std::int32_t i, const Vec3& center,
                               std::int32_t lowest, std::vector<std::int32_t>& partners) const {
  const std::size_t known = partners.size();
  const std::int32_t body = particles.pebble_body(i);
  const SphereRecord own = particles.pebbles()[i];
  const double range = own.radius + grid.largest_radius + reach_;
  const SphereRecord* records = grid.records.data();
  const double reach = own.radius + reach_;
  const bool is_periodic = period_.has_value();
  const auto take = [&](std::int32_t begin, std::int32_t end) {
    // All are written down and those that are too far written over: no branch to guess.
    const std::size_t before = partners.size();
    partners.resize(before + static_cast<std::size_t>(end - begin));
    std::int32_t* next = partners.data() + before;
    for (std::int32_t k = begin; k < end; ++k) {
      double x = records[k].x - own.x, y = records[k].y - own.y, z = records[k].z - own.z;
      if (is_periodic) {
        const Vec3 shift = nearest_image({x, y, z}, *period_);
        x += shift.x(), y += shift.y(), z += shift.z();
      }
      const double range_ij = reach + records[k].radius;
      *next = k;
      next += x * x + y * y + z * z < range_ij * range_ij;
    }
    partners.resize(static_cast<std::size_t>(next - partners.data()));
  };
  // Cells first .. last along k that the range meets.
  const auto cells_within = [&](int k) {
    const double at = (center[k] - grid.low[k]) * grid.cells_per_length[k], width = range * grid.cells_per_length[k];
    if (!period_)
      return std::pair(std::clamp(static_cast<std::int32_t>(at - width), 0, grid.count[k] - 1),
                       std::clamp(static_cast<std::int32_t>(at + width), 0, grid.count[k] - 1));
    const auto first = static_cast<std::int32_t>(std::floor(at - width));
    return std::pair(first, std::min(static_cast<std::int32_t>(std::floor(at + width)), first + grid.count[k] - 1));
  };
  const auto in_cell = [&](std::int32_t c, int k) {
    return period_ ? (c % grid.count[k] + grid.count[k]) % grid.count[k] : c;
  };
  const auto [first_x, last_x] = cells_within(0);
  const auto [first_y, last_y] = cells_within(1);
  const auto [first_z, last_z] = cells_within(2);
  for (std::int32_t z = first_z; z <= last_z; ++z)
    for (std::int32_t y = first_y; y <= last_y; ++y) {
      const std::int32_t row = (in_cell(z, 2) * grid.count[1] + in_cell(y, 1)) * grid.count[0];
      if (!is_periodic)
        take(grid.cell_begin[row + first_x], grid.cell_begin[row + last_x + 1]);
      else
        for (std::int32_t x = first_x; x <= last_x; ++x)
          take(grid.cell_begin[row + in_cell(x, 0)], grid.cell_begin[row + in_cell(x, 0) + 1]);
    }
  auto kept = partners.begin() + static_cast<std::ptrdiff_t>(known);
  for (auto k = kept; k != partners.end(); ++k)
    if (const std::int32_t j = grid.pebbles[*k]; j >= lowest && particles.pebble_body(j) != body) *kept++ = j;
  partners.erase(kept, partners.end());
}

std::size_t NeighborSearch::memory() const {
  std::size_t bytes = 0;
  for (const Grid& grid : grids_)
    bytes += (grid.cell_begin.capacity() + grid.pebbles.capacity()) * sizeof(std::int32_t) +
             grid.records.capacity() * sizeof(SphereRecord);
  return bytes;
}

}  // namespace lockstep::dem
