// The coupled ledger over the smallest coupled system (tests/common/test_coupled_limit.cpp): leap-frog of a node on a spring
// and a grain behind a contact, both sides booked as the two solvers book them.
#include <catch2/catch.hpp>
#include <cmath>

#include "common/coupled_ledger.hpp"

namespace lockstep {
namespace {

struct Pair {
  double node_spring = 1, node_mass = 1, contact = 1, grain_mass = 1;
  bool is_late = false;   // the node gets the contact's force of the step before
  double lost_share = 0;  // of the contact's force that never reaches the node

  double u = 0, x = 0, node_velocity = 0, grain_velocity = 0;
  double last_force = 0;
  Energies zones, grains;

  // One step; energies are then those of the time at which it began.
  void step(double dt) {
    const double force = contact * (x - u);  // on the node
    const double taken = (1 - lost_share) * (is_late ? last_force : force);
    const double node_before = node_velocity, grain_before = grain_velocity;
    node_velocity += (taken - node_spring * u) / node_mass * dt;
    grain_velocity += -force / grain_mass * dt;
    zones.kinetic = 0.5 * node_mass * node_before * node_velocity;
    grains.kinetic = 0.5 * grain_mass * grain_before * grain_velocity;
    zones.elastic = 0.5 * node_spring * u * u;
    grains.elastic = 0.5 * contact * (x - u) * (x - u);
    // Half of a force's work lies on each side of its time; energies are booked with the half before.
    zones.interface_work = zones_work_ + 0.5 * taken * node_before * dt;
    grains.interface_work = grains_work_ - 0.5 * force * node_before * dt;
    zones_work_ = zones.interface_work + 0.5 * taken * node_velocity * dt;
    grains_work_ = grains.interface_work - 0.5 * force * node_velocity * dt;
    u += node_velocity * dt, x += grain_velocity * dt;
    last_force = force;
    force_on_node = taken, force_on_grain = -force;
  }

  double force_on_node = 0, force_on_grain = 0;  // [N]
  double true_kinetic() const {
    return 0.5 * node_mass * node_velocity * node_velocity + 0.5 * grain_mass * grain_velocity * grain_velocity;
  }

 private:
  double zones_work_ = 0, grains_work_ = 0;
};

// (3 + sqrt 5) / 2 is omega^2 of the pair with all ones.
const double limit = 2 / std::sqrt(0.5 * (3 + std::sqrt(5.0)));

InterfaceSums sums_of(const Pair& pair) {
  InterfaceSums sums;
  sums.nodes_force.z() = pair.force_on_node, sums.particles_force.z() = pair.force_on_grain;
  sums.nodes_moment = Vec3::UnitX().cross(sums.nodes_force);
  sums.particles_moment = Vec3::UnitX().cross(sums.particles_force);
  return sums;
}

CoupledLedger booked(Pair pair, double dt, int steps, double stop_at = 0) {
  CoupledLedger ledger(stop_at);
  pair.grain_velocity = 1;
  for (int n = 0; n < steps && ledger.alarm().empty(); ++n) {
    pair.step(dt);
    ledger.book_interface(static_cast<std::uint64_t>(n), n * dt, dt, sums_of(pair));
    ledger.book_energies(pair.grains, pair.zones);
  }
  return ledger;
}

}  // namespace

TEST_CASE("nothing is left over in the ledger of a synchronous exchange, at any stable step") {
  for (const double fraction : {0.01, 0.5, 0.9, 0.99}) {
    const CoupledLedger ledger = booked({}, fraction * limit, 20000);
    INFO("at " << fraction << " of the limit: residual over work " << ledger.residual_fraction() << ", works added "
               << ledger.interface_gap() / ledger.work_done());
    CHECK(std::abs(ledger.residual_fraction()) < 1e-13);
    CHECK(std::abs(ledger.interface_gap()) < 1e-13 * ledger.work_done());
    CHECK(ledger.worst_force_gap() < 1e-15);
    CHECK(ledger.worst_moment_gap() < 1e-15);
    CHECK(ledger.alarm().empty());
  }
}

TEST_CASE("a force that is one step old shows in force, work and energy, and stops the run") {
  Pair pair;
  pair.is_late = true;
  const CoupledLedger ledger = booked(pair, 0.1 * limit, 2000, 0.01);
  INFO("force gap " << ledger.worst_force_gap() << ", works added over work done "
                    << ledger.interface_gap() / ledger.work_done() << "; " << ledger.alarm());
  CHECK(ledger.worst_force_gap() > 0.05);
  CHECK(std::abs(ledger.interface_gap()) > 1e-3 * ledger.work_done());
  CHECK_THAT(ledger.alarm(), Catch::Contains("do not balance") && Catch::Contains("stop_if_energy_error"));
}

TEST_CASE("weights that do not sum to one show in force, moment and energy") {
  Pair pair;
  pair.lost_share = 1e-3;
  const CoupledLedger ledger = booked(pair, 0.1 * limit, 2000, 1e-4);
  INFO("force gap " << ledger.worst_force_gap() << ", moment gap " << ledger.worst_moment_gap() << "; "
                    << ledger.alarm());
  CHECK(ledger.worst_force_gap() == Approx(1e-3).epsilon(1e-9));
  CHECK(ledger.worst_moment_gap() == Approx(1e-3).epsilon(1e-9));
  CHECK(!ledger.alarm().empty());
}

TEST_CASE(
    "a step above the limit is told from one below by kinetic energy that no work explains, within 100 steps of "
    "onset") {
  // Onset: the true kinetic energy is above ten times all the energy that there is.
  for (const double fraction : {1.001, 1.01, 1.1, 1.5}) {
    Pair pair;
    pair.grain_velocity = 1;
    CoupledLedger ledger;
    int onset = -1, alarm = -1;
    for (int n = 0; n < 20000 && alarm < 0; ++n) {
      pair.step(fraction * limit);
      if (onset < 0 && pair.true_kinetic() > 10 * 0.5) onset = n;
      ledger.book_energies(pair.grains, pair.zones);
      if (!ledger.alarm().empty()) alarm = n;
    }
    INFO("at " << fraction << " of the limit: onset at step " << onset << ", alarm at step " << alarm);
    CHECK(onset >= 0);
    CHECK(alarm >= 0);
    CHECK(alarm - onset < 100);
    CHECK(std::abs(ledger.residual_fraction()) < 1e-6);  // the balance itself does not tell
  }
}

TEST_CASE("a preload that stays where it is does not hide what grows beside it") {
  // A million times the energy of the motion is held by contacts that nothing opens.
  for (const bool is_stable : {true, false}) {
    Pair pair;
    pair.grain_velocity = 1;
    CoupledLedger ledger;
    int onset = -1, alarm = -1;
    for (int n = 0; n < 2000 && alarm < 0; ++n) {
      pair.step((is_stable ? 0.99 : 1.01) * limit);
      if (onset < 0 && pair.true_kinetic() > 10 * 0.5) onset = n;
      Energies preloaded = pair.grains;
      preloaded.elastic += 1e6 * 0.5;
      ledger.book_energies(preloaded, pair.zones);
      if (!ledger.alarm().empty()) alarm = n;
    }
    INFO((is_stable ? "stable" : "unstable")
         << ": onset at step " << onset << ", alarm at step " << alarm << " " << ledger.alarm());
    CHECK((alarm >= 0) == !is_stable);
    if (!is_stable) CHECK(alarm - onset < 100);
  }
}

TEST_CASE("energy that comes from nowhere ends the run once it exceeds all that there is") {
  // A grain on a wall whose contact it meets for one step at a time: thrown back with v (4 f^2 s - 1), s the share of a step that
  // it is in touch, f the step over the contact's limit. In the mean of s in (0, 1) its energy grows by 16 f^4 / 3 - 4 f^2 + 1 =
  // 3.1 at f = 1.05; at f = 0.1, many steps to a contact, it keeps to what it had.
  for (const double fraction : {0.1, 1.3}) {
    double x = 0.3, v = -1;
    const double dt = 2 * fraction;  // k = m = 1
    CoupledLedger ledger;
    int alarm = -1, n = 0;
    for (; n < 4000 && alarm < 0; ++n) {
      const double force = x < 0 ? -x : x > 10 ? 10 - x : 0.0;  // a wall on either side
      const double before = v;
      v += force * dt;
      Energies grain;
      grain.kinetic = 0.5 * before * v, grain.elastic = 0.5 * force * force;
      ledger.book_energies(grain, {});
      x += v * dt;
      if (!ledger.alarm().empty()) alarm = n;
    }
    INFO(fraction << " of the limit: residual " << ledger.residual() << " J of 0.5 J, alarm at step " << alarm << " "
                  << ledger.alarm());
    CHECK((alarm >= 0) == (fraction > 1));
    if (alarm < 0) CHECK(std::abs(ledger.residual()) < 0.1);
  }
}

TEST_CASE("bookings that are far apart close as those of each step do") {
  Pair pair;
  pair.grain_velocity = 1;
  CoupledLedger ledger;
  for (int n = 0; n < 5000; ++n) {
    pair.step(0.9 * limit);
    if (n % 37 == 0) ledger.book_energies(pair.grains, pair.zones);
  }
  CHECK(std::abs(ledger.residual_fraction()) < 1e-13);
}

}  // namespace lockstep
