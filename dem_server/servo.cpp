#include "dem_server/servo.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace lockstep::dem {

Servo::Servo(const Model& model, std::span<const std::int32_t> ring, std::span<const Vec3> traction, double tip_target,
             const ServoSettings& settings)
    : settings_(settings), tip_target_(tip_target) {
  const InterfaceFacets& facets = model.facets;
  std::map<std::int32_t, Ring> by_id;
  for (std::size_t f = 0; f < ring.size(); ++f) {
    const Vec3 area = facets.area_vector(f);
    Ring& r = by_id[ring[f]];
    r.id = ring[f];
    r.facets.push_back(static_cast<std::int32_t>(f));
    r.target -= traction[f].dot(area);
    r.area += area.norm();
    r.center_z += area.norm() * facets.center(f).z();
  }
  for (auto& [id, r] : by_id) {
    r.target /= r.area;
    r.center_z /= r.area;
    rings_.push_back(std::move(r));
  }

  const std::size_t nodes = facets.positions().size();
  node_normal_.assign(nodes, Vec3::Zero());
  node_rings_.resize(nodes);
  node_velocity_.assign(nodes, Vec3::Zero());
  for (std::size_t r = 0; r < rings_.size(); ++r) {
    if (!rings_[r].is_side()) continue;
    for (const std::int32_t f : rings_[r].facets) {
      const Vec3 area = facets.area_vector(f);
      for (const std::int32_t node : facets.nodes_of(f)) {
        node_normal_[node] += Vec3(area.x(), area.y(), 0);
        auto& of_node = node_rings_[node];
        if (std::find(of_node.begin(), of_node.end(), r) == of_node.end())
          of_node.push_back(static_cast<std::int32_t>(r));
      }
    }
  }
  for (Vec3& n : node_normal_)
    if (n.norm() > 0) n.normalize();
}

bool Servo::move_facets(Model& m) {
  m.facets.move_offsets(node_velocity_, m.last_time_step);
  for (Ring& r : rings_) r.travel += r.velocity * m.last_time_step;
  m.time_step = time_step;
  return true;
}

void Servo::take_forces(Model& m) {
  const double blend = has_pressures_ ? 1 / settings_.averaging : 1.0;
  has_pressures_ = true;
  const auto limited = [&](double v) { return std::clamp(v, -settings_.top_speed, settings_.top_speed); };

  for (Ring& r : rings_) {
    double pressing = 0;
    double stiffness = 0;
    for (const std::int32_t f : r.facets) {
      pressing -= m.facets.facet_force()[f].dot(m.facets.area_vector(f).normalized());
      stiffness += m.facets.facet_stiffness()[f];
    }
    const double pressure = pressing / r.area;
    r.pressure += blend * (pressure - r.pressure);
    r.velocity = 0;
    if (is_active && r.is_side() && stiffness > 0) {
      r.velocity = limited(settings_.closing * (r.target - pressure) * r.area / (stiffness * time_step));
      r.is_at_end = std::abs(r.travel + r.velocity * time_step) > settings_.max_travel;
      if (r.is_at_end) r.velocity = 0;
    }
    r.mean_velocity += blend * (r.velocity - r.mean_velocity);
  }
  for (std::size_t node = 0; node < node_velocity_.size(); ++node) {
    node_velocity_[node].setZero();
    if (node_rings_[node].empty()) continue;
    double speed = 0;
    for (const std::int32_t r : node_rings_[node]) speed += rings_[r].velocity;
    node_velocity_[node] = speed / static_cast<double>(node_rings_[node].size()) * node_normal_[node];
  }

  if (!m.pile) return;
  const double area = m.pile->tip_area();
  const double pressure =
      m.pile_totals.tip_force.z() / area;  // of the last step: the pile's contacts come later in a cycle
  tip_pressure_ += blend * (pressure - tip_pressure_);
  tip_velocity_ = 0;
  if (is_active) {
    const double stiffness = std::max(m.pile_totals.tip_stiffness, m.pile_totals.one_contact_stiffness);
    tip_velocity_ =
        stiffness > 0 ? limited(settings_.closing * (pressure - tip_target_) * area / (stiffness * time_step)) : 0;
  }
  m.pile->set_velocity(tip_velocity_);
  mean_tip_velocity_ += blend * (tip_velocity_ - mean_tip_velocity_);
}

double Servo::fastest() const {
  double v = std::abs(mean_tip_velocity_);
  for (const Ring& r : rings_) v = std::max(v, std::abs(r.mean_velocity));
  return v;
}

double Servo::mismatch(const Ring& r, double relative) const {
  return r.is_side() ? std::abs(r.pressure - r.target) / (relative * r.target + pressure_floor) : 0.0;
}

double Servo::tip_mismatch(double relative) const {
  return tip_target_ > 0 ? std::abs(tip_pressure_ - tip_target_) / (relative * tip_target_ + pressure_floor) : 0.0;
}

double Servo::worst_mismatch(double relative) const {
  double worst = tip_mismatch(relative);
  for (const Ring& r : rings_) worst = std::max(worst, mismatch(r, relative));
  return worst;
}

double Servo::worst_movable_mismatch(double relative) const {
  double worst = tip_mismatch(relative);
  for (const Ring& r : rings_)
    if (!r.is_at_end) worst = std::max(worst, mismatch(r, relative));
  return worst;
}

}  // namespace lockstep::dem
