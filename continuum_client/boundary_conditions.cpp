#include "continuum_client/boundary_conditions.hpp"

#include <cmath>

#include "continuum_client/constants.hpp"

namespace lockstep::continuum {

Vec3s free_components(const Grid& grid, Supports supports, const std::vector<double>& mass) {
  const double tolerance = plane_tolerance * (grid.high - grid.low).maxCoeff();
  const auto on_side = [&](const Vec3& x, int axis) {
    return std::abs(x[axis] - grid.low[axis]) <= tolerance || std::abs(x[axis] - grid.high[axis]) <= tolerance;
  };
  Vec3s is_free(grid.node_count(), Vec3::Ones());
  for (std::size_t i = 0; i < grid.node_count(); ++i) {
    const Vec3& x = grid.node[i];
    const bool on_x = on_side(x, 0), on_y = on_side(x, 1), on_bottom = std::abs(x.z() - grid.low.z()) <= tolerance;
    switch (supports) {
      case Supports::AllFixed:
        if (on_x || on_y || on_bottom) is_free[i].setZero();
        break;
      case Supports::Rollers:
        if (on_x) is_free[i].x() = 0;
        if (on_y) is_free[i].y() = 0;
        if (on_bottom) is_free[i].z() = 0;
        break;
      case Supports::BottomFixed:
        if (on_bottom) is_free[i].setZero();
        break;
      case Supports::BottomRoller:
        if (on_bottom) is_free[i].z() = 0;
        break;
    }
    if (!(mass[i] > 0)) is_free[i].setZero();
  }
  return is_free;
}

Vec3s released_reactions(const Vec3s& before, const Vec3s& after, const Vec3s& internal, const Vec3s& external) {
  Vec3s load(before.size(), Vec3::Zero());
  bool is_any_released = false;
  for (std::size_t i = 0; i < before.size(); ++i)
    for (int c = 0; c < 3; ++c)
      if (before[i][c] == 0 && after[i][c] != 0) {
        load[i][c] = internal[i][c] - external[i][c];
        is_any_released = true;
      }
  if (!is_any_released) load.clear();
  return load;
}

}  // namespace lockstep::continuum
