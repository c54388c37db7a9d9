#include "continuum_client/internal_force.hpp"

#include <algorithm>
#include <utility>

namespace lockstep::continuum {

void StiffnessMatrix::multiply(const Vec3s& u, Vec3s& f) const {
  const std::size_t count = node_count();
  std::fill(f.begin(), f.end(), Vec3::Zero());
  const Mat3* const b = block.data();
  const std::int32_t* const c = column.data();
  for (std::size_t i = 0; i < count; ++i) {
    std::int64_t k = row_begin[i];
    const std::int64_t end = row_begin[i + 1];
    if (k == end) continue;
    const Vec3 ui = u[i];
    Vec3 fi = b[k].lazyProduct(ui);
    for (++k; k < end; ++k) {
      const std::int32_t j = c[k];
      fi += b[k].lazyProduct(u[j]);
      f[j] += b[k].transpose().lazyProduct(ui);
    }
    f[i] += fi;
  }
}

Mat3 StiffnessMatrix::diagonal(std::size_t node) const {
  return row_begin[node] == row_begin[node + 1] ? Mat3(Mat3::Zero()) : block[row_begin[node]];
}

StiffnessMatrix assemble_stiffness(const Grid& grid, const std::vector<char>& is_included) {
  const auto included = [&](std::size_t z) { return is_included.empty() || is_included[z]; };
  // The columns of each row: the node itself and its neighbours of higher number.
  std::vector<std::vector<std::int32_t>> neighbours(grid.node_count());
  for (std::size_t z = 0; z < grid.zone_count(); ++z)
    if (included(z))
      for (std::int32_t a : grid.zone[z])
        for (std::int32_t b : grid.zone[z])
          if (b >= a) neighbours[a].push_back(b);
  StiffnessMatrix k;
  k.row_begin.reserve(grid.node_count() + 1);
  for (auto& row : neighbours) {
    std::sort(row.begin(), row.end());
    row.erase(std::unique(row.begin(), row.end()), row.end());
    k.column.insert(k.column.end(), row.begin(), row.end());
    k.row_begin.push_back(static_cast<std::int64_t>(k.column.size()));
    row = {};
  }
  k.block.assign(k.column.size(), Mat3::Zero());
  const std::vector<std::int32_t> representative = representative_zones(grid);
  ZoneMatrix zone;
  std::int32_t zone_of = -1;
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    if (!included(z)) continue;
    if (representative[z] != zone_of) {
      zone_of = representative[z];
      zone = zone_stiffness(grid.geometry(zone_of), grid.moduli(zone_of));
    }
    for (int a = 0; a < 8; ++a)
      for (int b = 0; b < 8; ++b) {
        const std::int32_t i = grid.zone[z][a], j = grid.zone[z][b];
        if (j < i) continue;
        const auto row = k.column.begin() + k.row_begin[i];
        const auto at = std::lower_bound(row, k.column.begin() + k.row_begin[i + 1], j);
        k.block[at - k.column.begin()] += zone.block<3, 3>(3 * a, 3 * b);
      }
  }
  return k;
}

std::vector<double> lumped_masses(const Grid& grid, const std::vector<char>& is_included) {
  std::vector<double> mass(grid.node_count(), 0.0);
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    if (!is_included.empty() && !is_included[z]) continue;
    const std::array<double, 8> volume = grid.geometry(z).nodal_volume;
    for (int a = 0; a < 8; ++a) mass[grid.zone[z][a]] += grid.material_of(z).density * volume[a];
  }
  return mass;
}

InternalForce::InternalForce(const StiffnessMatrix& stiffness, InstructionSet instructions)
    : reference(stiffness.node_count(), Vec3::Zero()), product_(stiffness, instructions) {}

InternalForce::InternalForce(StiffnessProduct product)
    : reference(product.node_count(), Vec3::Zero()), product_(std::move(product)) {}

}  // namespace lockstep::continuum
