#include "dem_server/periodic_cell.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/checks.hpp"
#include "common/interrupt.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/integrator.hpp"
#include "dem_server/measure.hpp"
#include "dem_server/timestep.hpp"

namespace lockstep::dem {

namespace {

constexpr double bound_share = 0.9;  // of the stable step, which is a bound itself

// The servo: M over E*, steps that close the error, and the fastest strain in a step. Packings have an E of 0.3 to 0.6 E*;
// a servo that is stiffer than its packing by a factor of fifty chatters.
constexpr double modulus_share = 0.43;
constexpr double closing_steps = 20;
constexpr double fastest_strain = 1e-5;

// Pressed: pressures within this share, unbalanced ratio, and strain in a window of steps (creep passes the force test alone).
constexpr double pressed_tolerance = 2e-3;
constexpr double pressed_ratio = 1e-3;
constexpr double pressed_strain = 2e-6;
constexpr std::int64_t pressed_window = 500;
constexpr std::int64_t most_pressing_steps = 200000;

// The first strain is slow: rate = min(r, r (first_share + strain / slow_strain)), so that no wave starts.
constexpr double first_share = 0.01;
constexpr double slow_strain = 0.01;
constexpr double fine_strain = 1e-3;      // rows are dense up to here
constexpr double fine_interval = 2e-5;    // of strain, between rows
constexpr double coarse_interval = 2e-4;  // further on
constexpr int heartbeat = 1000;           // steps between signs of life

}  // namespace

PeriodicCell::PeriodicCell(Particles grains, const Vec3& period, const GrainMaterial& material, Team& team)
    : particles_(std::move(grains)),
      contacts_(list_skin * particles_.mean_radius(), period),
      material_(material),
      team_(&team),
      time_step_(quiet_step(particles_, material)),
      last_step_(time_step_) {}

void PeriodicCell::renew_step(double damping) {
  StiffnessSum stiffness;
  stiffness.reset(particles_.body_count());
  contacts_.for_each_branch(
      particles_, [&](const ContactView& contact, const Vec3& branch) { stiffness.add(contact, particles_, branch); });
  time_step_ = std::min(time_step_, bound_share * stiffness.stable_step(damping));
}

void PeriodicCell::step(const std::array<Axis, 3>& axes, double damping) {
  contacts_.update(particles_, *team_);
  totals_ = contacts_.compute(particles_, material_, last_step_, Detail::All, *team_);
  if (steps_ % limit_interval == 0) renew_step(damping);
  const double servo_stiffness = modulus_share * material_.contact_modulus * closing_steps * time_step_;  // [Pa s]
  const Vec3 pressure = -stress();
  for (int k = 0; k < 3; ++k) {
    const double fastest = fastest_strain / time_step_;
    rate_[k] = axes[k].pressure ? std::clamp((pressure[k] - *axes[k].pressure) / servo_stiffness, -fastest, fastest)
                                : axes[k].rate;
  }
  MotionOptions options;
  options.team = team_;
  options.partition = &contacts_.partition();
  const MotionTotals motion = integrate(particles_, Vec3::Zero(), last_step_, time_step_, damping, options);
  unbalanced_ =
      dem::unbalanced_ratio(motion.unbalanced_force, particles_.body_count(), totals_.contact_force, totals_.active);
  contacts_.strain(particles_, rate_, time_step_);
  last_step_ = time_step_;
  ++steps_;
}

double PeriodicCell::porosity() const { return 1 - solid_volume(particles_) / period().prod(); }

double PeriodicCell::coordination() const {
  Coordination coordination(particles_.body_count());
  contacts_.for_each_contact(particles_, [&](const ContactView& c) { coordination.add(c); });
  return coordination.mean();
}

namespace {

using Axis = PeriodicCell::Axis;

void check_interrupt() {
  if (interrupt_requested()) throw Interrupted("interrupted in a cell test");
}

void press(PeriodicCell& cell, const CellTest& test) {
  const Axis held{test.pressure, 0};
  Vec3 last = cell.period();
  while (true) {
    cell.step({held, held, held}, test.preparation_damping);
    if (cell.steps() % pressed_window != 0) continue;
    check_interrupt();
    const double strained = (cell.period().cwiseQuotient(last) - Vec3::Ones()).cwiseAbs().maxCoeff();
    const double off = (cell.stress() / test.pressure + Vec3::Ones()).cwiseAbs().maxCoeff();
    if (off < pressed_tolerance && cell.unbalanced_ratio() < pressed_ratio && strained < pressed_strain) return;
    if (cell.steps() > most_pressing_steps)
      throw NumericalError(fmt::format(
          "the cell does not come to rest at {:.4g} Pa within {} steps (off by {:.2g}, unbalanced ratio {:.2g}, "
          "strain {:.2g} in {} steps): a larger preparation friction (now {}) creeps less",
          test.pressure, most_pressing_steps, off, cell.unbalanced_ratio(), strained, pressed_window,
          test.preparation_friction.value_or(0)));
    last = cell.period();
  }
}

CellState state_of(const PeriodicCell& cell, const Vec3& start) {
  const Vec3 strain = -cell.period().cwiseQuotient(start).array().log().matrix();
  const Vec3 pressure = -cell.stress();
  CellState s;
  s.axial_strain = strain.z();
  s.radial_strain = 0.5 * (strain.x() + strain.y());
  s.volume_strain = strain.sum();
  s.axial_stress = pressure.z();
  s.radial_stress = 0.5 * (pressure.x() + pressure.y());
  s.porosity = cell.porosity();
  s.coordination = cell.coordination();
  s.unbalanced_ratio = cell.unbalanced_ratio();
  return s;
}

}  // namespace

CellTestResult run_cell_test(const Cube& cube, const GrainMaterial& material, const CellTest& test, Team& team,
                             const std::function<void(const CellState&)>& record) {
  PeriodicCell cell(cube.particles, cube.period, material, team);
  cell.set_friction(test.preparation_friction.value_or(std::min(cube.preparation_friction, material.friction)));
  press(cell, test);
  cell.set_friction(material.friction);

  const Vec3 start = cell.period();
  const double density = cell.particles().total_mass() / solid_volume(cell.particles());
  const double rate = test.inertial_number / (2 * cell.particles().mean_radius() * std::sqrt(density / test.pressure));
  CellTestResult result;
  result.pressed = state_of(cell, start);
  record(result.pressed);
  const Axis held{test.pressure, 0};
  double strain = 0, next_row = fine_interval;
  const std::int64_t begin = cell.steps();
  while (strain < test.axial_strain) {
    const double now = rate * std::min(1.0, first_share + strain / slow_strain);
    cell.step({held, held, Axis{{}, -now}}, test.damping);
    strain = -std::log(cell.period().z() / start.z());
    if (strain >= next_row) {
      record(state_of(cell, start));
      next_row += strain < fine_strain ? fine_interval : coarse_interval;
    }
    if ((cell.steps() - begin) % heartbeat != 0) continue;
    check_interrupt();
    if (test.progress) test.progress(strain / test.axial_strain);
  }
  result.steps = cell.steps();
  return result;
}

}  // namespace lockstep::dem
