#include "common/coupled_limit.hpp"

#include <spdlog/fmt/fmt.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace lockstep {

double stable_step(double frequency_squared, double damping, double stiffness_damping) {
  if (!(frequency_squared > 0)) return std::numeric_limits<double>::infinity();
  const double omega = std::sqrt(frequency_squared), xi = 0.5 * stiffness_damping * omega;
  return 2 / omega * (std::sqrt(1 + xi * xi) - xi) / std::sqrt(1 + damping);
}

CoupledLimit::CoupledLimit(GroundStiffness ground, std::uint32_t exchange_interval)
    : ground_(std::move(ground)), exchange_interval_(exchange_interval) {
  zones_ = interface_ = share() * stable_step(ground_.frequency_squared, ground_.damping, ground_.stiffness_damping);
  grains_ = std::numeric_limits<double>::infinity();
}

void CoupledLimit::set_contacts(const std::vector<double>& node_stiffness) {
  double largest = 0;  // 2 sum(k w) / m [1/s2]
  worst_node_ = -1;
  for (std::size_t i = 0; i < std::min(node_stiffness.size(), ground_.node_mass.size()); ++i) {
    if (!(ground_.node_mass[i] > 0) || !(2 * node_stiffness[i] / ground_.node_mass[i] > largest)) continue;
    largest = 2 * node_stiffness[i] / ground_.node_mass[i];
    worst_node_ = static_cast<std::int64_t>(i), worst_stiffness_ = node_stiffness[i];
  }
  contacts_ = 0.5 * largest;
  interface_ = share() * stable_step(ground_.frequency_squared + largest, ground_.damping, ground_.stiffness_damping);
}

double CoupledLimit::grains_on_ground(double own, double touching) const {
  if (own + touching <= ground_.frequency_squared + 2 * contacts_) return own;
  const double zones = ground_.frequency_squared + contacts_, half = 0.5 * (own - zones);
  return 0.5 * (own + zones) + std::sqrt(half * half + touching * contacts_);
}

void CoupledLimit::set_grains(double limit, std::string culprit) {
  grains_ = limit > 0 ? limit : std::numeric_limits<double>::infinity();
  grains_culprit_ = std::move(culprit);
}

double CoupledLimit::limit() const { return std::min(interface_, grains_); }

const char* CoupledLimit::limited_by() const {
  if (grains_ < interface_) return "grains";
  return interface_ < zones_ ? "zones with contacts" : "zones";
}

std::string CoupledLimit::culprit(const Vec3s& nodes) const {
  if (grains_ < interface_)
    return fmt::format("{}; softer grains (grains.contact_modulus) or coarser ones (fidelity.particle_scale) raise it",
                       grains_culprit_.empty() ? "the grains" : grains_culprit_);
  if (!(interface_ < zones_) || worst_node_ < 0)
    return "the zones; fewer of them (fidelity.mesh_refinement) or a softer ground raise it";
  const auto i = static_cast<std::size_t>(worst_node_);
  const Vec3 x = i < nodes.size() ? nodes[i] : Vec3::Zero();
  return fmt::format(
      "interface node {} at ({:.4g}, {:.4g}, {:.4g}) m, whose contacts have {:.3g} N/m on {:.3g} kg; a smaller "
      "grains.facet_stiffness_factor or grains.contact_modulus, or larger zones there, raise it",
      worst_node_, x.x(), x.y(), x.z(), worst_stiffness_, ground_.node_mass[i]);
}

}  // namespace lockstep
