#include "dem_server/neighbor_search.hpp"

#include <algorithm>
#include <cmath>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

std::array<std::int16_t, 3> nearest_image(const Vec3& from_i_to_j, const Vec3& period) {
  std::array<std::int16_t, 3> image;
  for (int k = 0; k < 3; ++k) image[k] = static_cast<std::int16_t>(-std::lround(from_i_to_j[k] / period[k]));
  return image;
}

void NeighborSearch::find(const Particles& particles, double reach, const std::optional<Vec3>& period,
                          std::vector<PebblePair>& pairs) {
  pairs.clear();
  const auto pebbles = static_cast<std::int32_t>(particles.pebble_count());
  if (pebbles == 0) return;
  const Vec3s& center = particles.pebble_center;
  const std::vector<double>& radius = particles.pebble_radius;

  Vec3 low = center[0], high = center[0];
  double largest_radius = 0;
  for (std::int32_t p = 0; p < pebbles; ++p) {
    if (!center[p].allFinite()) {
      const std::int32_t body = particles.pebble_body[p];
      throw NumericalError(
          fmt::format("grain {} is no longer at a finite place (mass {:.3g} kg, radius {:.3g} m): lower "
                      "fidelity.step_fraction",
                      body, particles.mass[body], particles.equivalent_radius[body]));
    }
    low = low.cwiseMin(center[p]);
    high = high.cwiseMax(center[p]);
    largest_radius = std::max(largest_radius, radius[p]);
  }
  if (period) low.setZero(), high = *period;

  // Cells at least one interaction range wide, so that a pebble's partners lie in the 27 cells around it.
  const double range = 2 * largest_radius + reach;
  double widen = 1;
  if (!period) {
    const double cells = ((high - low) / range + Vec3::Ones()).prod();
    widen = std::max(1.0, std::cbrt(cells / (cells_per_pebble * pebbles + 64)));
  }
  std::array<std::int32_t, 3> count;
  Vec3 per_length;
  for (int k = 0; k < 3; ++k) {
    const double extent = high[k] - low[k];
    count[k] = std::max(1, static_cast<std::int32_t>(std::min(extent / (range * widen), 1e6)));
    per_length[k] = extent > 0 ? count[k] / extent : 0;
    if (period && extent < 2 * range)
      throw InputError(
          fmt::format("grains.packing.cube_grains: a periodic cube of {:.3g} m is less than two interaction "
                      "ranges ({:.3g} m) wide, so that a grain would meet its own image; ask for more grains",
                      extent, range));
  }

  const auto cell_coordinate = [&](const Vec3& x, int k) {
    double offset = x[k] - low[k];
    if (period) offset -= (*period)[k] * std::floor(offset / (*period)[k]);
    return std::clamp(static_cast<std::int32_t>(offset * per_length[k]), 0, count[k] - 1);
  };
  const auto cell_index = [&](std::int32_t cx, std::int32_t cy, std::int32_t cz) {
    return (cz * count[1] + cy) * count[0] + cx;
  };

  // Around a periodic ring of one or two cells the neighbour on either side is the same cell: visit it once.
  std::array<std::int32_t, 3> first = {-1, -1, -1}, last = {1, 1, 1};
  if (period)
    for (int k = 0; k < 3; ++k) {
      if (count[k] < 3) first[k] = 0;
      if (count[k] < 2) last[k] = 0;
    }

  // Counting sort of the pebbles by cell; within a cell they stay in order.
  cell_of_pebble_.resize(pebbles);
  cell_begin_.assign(static_cast<std::size_t>(count[0]) * count[1] * count[2] + 1, 0);
  for (std::int32_t p = 0; p < pebbles; ++p) {
    cell_of_pebble_[p] =
        cell_index(cell_coordinate(center[p], 0), cell_coordinate(center[p], 1), cell_coordinate(center[p], 2));
    ++cell_begin_[cell_of_pebble_[p] + 1];
  }
  for (std::size_t c = 1; c < cell_begin_.size(); ++c) cell_begin_[c] += cell_begin_[c - 1];
  pebbles_by_cell_.resize(pebbles);
  for (std::int32_t p = 0; p < pebbles; ++p) pebbles_by_cell_[cell_begin_[cell_of_pebble_[p]]++] = p;
  for (std::size_t c = cell_begin_.size() - 1; c > 0; --c) cell_begin_[c] = cell_begin_[c - 1];
  cell_begin_[0] = 0;

  for (std::int32_t i = 0; i < pebbles; ++i) {
    near_.clear();
    const std::int32_t cell = cell_of_pebble_[i], body = particles.pebble_body[i];
    const std::array<std::int32_t, 3> at = {cell % count[0], cell / count[0] % count[1], cell / (count[0] * count[1])};
    for (std::int32_t dz = first[2]; dz <= last[2]; ++dz)
      for (std::int32_t dy = first[1]; dy <= last[1]; ++dy)
        for (std::int32_t dx = first[0]; dx <= last[0]; ++dx) {
          std::array<std::int32_t, 3> c = {at[0] + dx, at[1] + dy, at[2] + dz};
          if (period) {
            for (int k = 0; k < 3; ++k) c[k] = (c[k] + count[k]) % count[k];
          } else if (c[0] < 0 || c[1] < 0 || c[2] < 0 || c[0] >= count[0] || c[1] >= count[1] || c[2] >= count[2]) {
            continue;
          }
          const std::int32_t other = cell_index(c[0], c[1], c[2]);
          for (std::int32_t k = cell_begin_[other]; k < cell_begin_[other + 1]; ++k) {
            const std::int32_t j = pebbles_by_cell_[k];
            if (j <= i || particles.pebble_body[j] == body) continue;
            Vec3 d = center[j] - center[i];
            if (period)
              for (int axis = 0; axis < 3; ++axis) d[axis] -= (*period)[axis] * std::round(d[axis] / (*period)[axis]);
            const double range_ij = radius[i] + radius[j] + reach;
            if (d.squaredNorm() < range_ij * range_ij) near_.push_back(j);
          }
        }
    std::sort(near_.begin(), near_.end());
    for (const std::int32_t j : near_) pairs.push_back({i, j, body, particles.pebble_body[j]});
  }
}

}  // namespace lockstep::dem
