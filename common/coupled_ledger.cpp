#include "common/coupled_ledger.hpp"

#include <spdlog/fmt/fmt.h>

#include <algorithm>
#include <cmath>

namespace lockstep {
namespace {

// Kinetic energy over what can have been put in. A stable oscillator of omega dt = 2 f keeps its energy E while its |kinetic
// energy| reaches E / (1 - f^2), some 50 E at 0.99 of the limit; an unstable one passes any bound, by a factor of 1.3 a step
// at 1.01 of the limit.
constexpr double unexplained_factor = 100;

// Of all the energy that there can be, what may come from nowhere. Contacts that the steps follow make errors of a small part of
// what moves.
constexpr double from_nowhere = 0.5;

// Of the strain energy that there is, the motion that counts: below it is round-off of what rests under load.
constexpr double least_share = 1e-9;

double outer_work(const Energies& e) { return e.gravity_work + e.boundary_work; }

}  // namespace

Vec3 moment_of(const Vec3s& position, const Vec3s& force) {
  Vec3 sum = Vec3::Zero();
  for (std::size_t i = 0; i < std::min(position.size(), force.size()); ++i) sum += position[i].cross(force[i]);
  return sum;
}

void CoupledLedger::book_interface(std::uint64_t step, double time, double dt, const InterfaceSums& sums) {
  step_ = step, time_ = time, sums_ = sums;
  impulse_ += sums.nodes_force * dt;
  force_gap_ = std::max(force_gap_, (sums.nodes_force + sums.particles_force).norm());
  largest_force_ = std::max(largest_force_, sums.particles_force.norm());
  moment_gap_ = std::max(moment_gap_, (sums.nodes_moment + sums.particles_moment).norm());
  largest_moment_ = std::max(largest_moment_, sums.particles_moment.norm());
}

void CoupledLedger::book_energies(const Energies& grains, const Energies& zones) {
  if (!has_energies_) {
    has_energies_ = true;
    start_ = grains.balance() + zones.balance();
    start_kinetic_ = std::abs(grains.kinetic) + std::abs(zones.kinetic);
    start_outer_ = outer_work(grains) + outer_work(zones);
    start_elastic_ = grains.elastic + zones.elastic;
    strained_ = std::abs(grains.elastic) + std::abs(zones.elastic);
    work_done_ = start_kinetic_ + strained_;
  } else {
    const auto change = [](double Energies::*kind, const Energies& now, const Energies& before) {
      return std::abs(now.*kind - before.*kind);
    };
    for (const auto& [now, before] : {std::pair(&grains, &grains_), std::pair(&zones, &zones_)}) {
      const double outer =
          change(&Energies::gravity_work, *now, *before) + change(&Energies::boundary_work, *now, *before);
      work_done_ += outer + change(&Energies::interface_work, *now, *before) +
                    change(&Energies::damped, *now, *before) + change(&Energies::friction, *now, *before);
    }
  }
  grains_ = grains, zones_ = zones;
  put_in_ = std::max(put_in_, outer_work(grains) + outer_work(zones) - start_outer_);
  released_ = std::max(released_, start_elastic_ - grains.elastic - zones.elastic);
  gap_ = grains.interface_work + zones.interface_work;
  // What the two sides book as the interface's work cancels where each sees the other's forces and velocities.
  residual_ = grains.balance() + zones.balance() + gap_ - start_;
  worst_residual_ = std::max(worst_residual_, std::abs(residual_fraction()));
}

std::string CoupledLedger::alarm() const {
  if (!has_energies_) return {};
  const double kinetic = std::abs(grains_.kinetic) + std::abs(zones_.kinetic);
  const double explained = start_kinetic_ + put_in_ + released_ + least_share * strained_;
  if (explained > 0 && kinetic > unexplained_factor * explained)
    return fmt::format(
        "step {}: kinetic energies of {:.3g} J (grains) and {:.3g} J (zones) against {:.3g} J that were there, were "
        "put "
        "in by gravity, pile and walls or came out of strain: the coupled run went unstable; lower "
        "fidelity.step_fraction",
        step_, grains_.kinetic, zones_.kinetic, explained);
  const double there = start_kinetic_ + put_in_ + strained_;
  if (there > 0 && std::abs(residual_) > from_nowhere * there)
    return fmt::format(
        "step {}: {:.3g} J came from nowhere, where {:.3g} J were there or were put in by gravity, pile and walls: "
        "contacts open and close faster than the steps follow, and the coupled run went unstable; lower "
        "fidelity.step_fraction",
        step_, residual_, there);
  if (stop_at_ > 0 && std::abs(residual_fraction()) > stop_at_)
    return fmt::format(
        "step {}: {:.3g} J do not balance, {:.2g} of the work done ({:.3g} J), above coupling.stop_if_energy_error = "
        "{}: "
        "lower fidelity.step_fraction, or stiffen what overlaps too much (grains.contact_modulus)",
        step_, residual_, std::abs(residual_fraction()), work_done_, stop_at_);
  return {};
}

double CoupledLedger::worst_force_gap() const { return largest_force_ > 0 ? force_gap_ / largest_force_ : 0.0; }
double CoupledLedger::worst_moment_gap() const { return largest_moment_ > 0 ? moment_gap_ / largest_moment_ : 0.0; }

std::vector<std::string> CoupledLedger::columns() {
  std::vector<std::string> names = {"step", "time [s]"};
  const auto add = [&](const std::string& what, const std::string& unit) {
    for (const char* axis : {"x", "y", "z"}) names.push_back(fmt::format("{} {} [{}]", what, axis, unit));
  };
  add("force on nodes", "N"), add("force on grains", "N"), add("moment on nodes", "N m"),
      add("moment on grains", "N m");
  add("impulse on nodes", "N s");
  for (const char* name : {"work on grains [J]", "work on nodes [J]", "works added [J]", "kinetic of grains [J]",
                           "kinetic of zones [J]", "elastic of grains [J]", "elastic of zones [J]", "damped [J]",
                           "friction [J]", "outer work [J]", "residual [J]", "residual over work done [-]"})
    names.push_back(name);
  return names;
}

std::vector<double> CoupledLedger::row() const {
  std::vector<double> row = {static_cast<double>(step_), time_};
  for (const Vec3& v : {sums_.nodes_force, sums_.particles_force, sums_.nodes_moment, sums_.particles_moment, impulse_})
    row.insert(row.end(), v.data(), v.data() + 3);
  const double outer = grains_.gravity_work + grains_.boundary_work + zones_.gravity_work + zones_.boundary_work;
  for (const double value : {grains_.interface_work, zones_.interface_work, gap_, grains_.kinetic, zones_.kinetic,
                             grains_.elastic, zones_.elastic, grains_.damped + zones_.damped,
                             grains_.friction + zones_.friction, outer, residual_, residual_fraction()})
    row.push_back(value);
  return row;
}

Json CoupledLedger::summary() const {
  Json j;
  j.add("worst_force_gap", worst_force_gap()).add("worst_moment_gap", worst_moment_gap());
  j.add("impulse_on_nodes_ns", std::vector<double>{impulse_.x(), impulse_.y(), impulse_.z()});
  if (has_energies_)
    j.add("work_on_grains_j", grains_.interface_work)
        .add("work_on_nodes_j", zones_.interface_work)
        .add("works_added_j", gap_)
        .add("residual_j", residual_)
        .add("work_done_j", work_done_)
        .add("residual_over_work", residual_fraction())
        .add("worst_residual_over_work", worst_residual_);
  return j;
}

}  // namespace lockstep
