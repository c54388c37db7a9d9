#include "dem_server/wall_history.hpp"

#include <string>

namespace lockstep::dem {

WallHistory::WallHistory(const std::vector<WallSettings>& walls, const std::filesystem::path& folder) {
  std::vector<std::string> columns = {"step", "time [s]"};
  for (std::size_t k = 0; k < walls.size(); ++k) {
    if (walls[k].name.empty()) continue;
    Sum sum;
    sum.wall = k;
    const auto* tube = std::get_if<FrustumShape>(&walls[k].shape);
    sum.has_radius = std::holds_alternative<CylinderShape>(walls[k].shape) || (tube && tube->is_cylinder());
    sums_.push_back(sum);
    for (const char* quantity :
         {"force x [N]", "force y [N]", "force z [N]", "torque x [N m]", "torque y [N m]", "torque z [N m]",
          "pressure [Pa]", "contacts", "centre x [m]", "centre y [m]", "centre z [m]", "servo way [m]"})
      columns.push_back(walls[k].name + " " + quantity);
    if (sums_.back().has_radius) columns.push_back(walls[k].name + " radius [m]");
  }
  if (!sums_.empty() && !folder.empty()) history_ = std::make_unique<History>(folder / "wall_history.csv", columns);
}

void WallHistory::record(const Walls& walls) {
  if (!history_) return;
  for (Sum& sum : sums_) {
    const WallTotals& totals = walls.totals()[sum.wall];
    sum.force += totals.force;
    sum.torque += totals.torque;
    sum.pressure += walls.pressure(sum.wall);
    sum.contacts += static_cast<double>(totals.contacts);
  }
  ++steps_;
}

void WallHistory::write_row(const Walls& walls, std::uint64_t step, double time) {
  if (!history_ || steps_ == 0) return;
  std::vector<double> row = {static_cast<double>(step), time};
  for (Sum& sum : sums_) {
    const Vec3& center = walls.center(sum.wall);
    for (const Vec3& v : {Vec3(sum.force / steps_), Vec3(sum.torque / steps_)})
      row.insert(row.end(), v.data(), v.data() + 3);
    row.push_back(sum.pressure / steps_);
    row.push_back(sum.contacts / steps_);
    row.insert(row.end(), center.data(), center.data() + 3);
    row.push_back(walls.state(sum.wall).servo_way);
    if (sum.has_radius) row.push_back(*walls.radius(sum.wall));
    sum = Sum{sum.wall, sum.has_radius};
  }
  steps_ = 0;
  history_->add(row);
}

}  // namespace lockstep::dem
