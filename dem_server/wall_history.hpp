// wall_history.csv: what each wall of the scene's `wall` blocks carries and where it is, a row whenever the grains'
// history has one. Forces, torques and pressures are means over the steps since the last row, places those of the row's
// step (a plane is where its servo has moved it beside its centre). Torques are about the wall's centre.
#pragma once
#include <filesystem>
#include <memory>
#include <vector>

#include "common/results.hpp"
#include "dem_server/walls.hpp"

namespace lockstep::dem {

class WallHistory {
 public:
  // Walls without a name (plane blocks, the sides of a box) are left out; no file when none is left, or without a folder.
  WallHistory(const std::vector<WallSettings>& walls, const std::filesystem::path& folder);

  // Takes part in the means.
  void record(const Walls& walls);
  void write_row(const Walls& walls, std::uint64_t step, double time);

 private:
  struct Sum {
    std::size_t wall = 0;
    bool has_radius = false;     // cylinders have a column for it
    Vec3 force = Vec3::Zero();   // [N]
    Vec3 torque = Vec3::Zero();  // [N m]
    double pressure = 0;         // [Pa]
    double contacts = 0;
  };
  std::unique_ptr<History> history_;
  std::vector<Sum> sums_;
  double steps_ = 0;
};

}  // namespace lockstep::dem
