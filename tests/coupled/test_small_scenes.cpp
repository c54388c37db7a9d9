// The small scenes, both sides in one process: what they show is known beforehand.
#include <catch2/catch.hpp>
#include <cmath>

#include "tests/coupled/coupled_fixture.hpp"

namespace lockstep::coupled {

TEST_CASE("a grain at rest presses on the block with exactly its weight") {
  // m g = 2650 x 4/3 pi 0.03^3 x 9.81 = 2.9401 N, downwards on the continuum.
  const Reports r = run_in_process("grain_on_block");
  const double weight = 2650 * 4.0 / 3.0 * pi * std::pow(0.03, 3) * 9.81;
  CAPTURE(r.grains.interface_force.transpose(), weight);
  CHECK(r.grains.interface_force.z() == Approx(-weight).epsilon(1e-4));
  CHECK(std::abs(r.grains.interface_force.x()) < 1e-4 * weight);
  CHECK(r.grains.kinetic_energy < 1e-9);
  CHECK(r.grains.worst_action_reaction < 1e-14);
  CHECK(r.grains.worst_vertical_imbalance < 1e-12);
}

TEST_CASE("an impact takes from the sphere what it gives to the block") {
  const Reports r = run_in_process("impact_on_block");
  const double mass = 2650 * 4.0 / 3.0 * pi * std::pow(0.05, 3);
  const double speed = r.grains.momentum.z() / mass;
  // Energy before: m/2. After: the sphere's, and the block's kinetic, elastic and the work of its held bottom (none).
  const double before = 0.5 * mass;
  const double after = r.grains.kinetic_energy + r.zones.ledger.kinetic + r.zones.ledger.elastic;
  CAPTURE(speed, before, after, r.grains.energy_residual, r.zones.ledger_residual_fraction);
  CHECK(speed > 0.1);  // it rebounds, slower than it came
  CHECK(speed < 0.95);
  CHECK(after == Approx(before).epsilon(2e-3));
  CHECK(std::abs(r.grains.energy_residual) < 1e-3);
  CHECK(r.grains.worst_vertical_imbalance < 1e-12);
}

TEST_CASE("a pulse goes from grains into zones of equal impedance with next to no echo") {
  // Kinetic energy of the pulse at the start: sum of m v^2/2 with v = V (1 + cos)/2 over 3.0 m of grains at pitch 0.1
  // m; the mean of ((1 + cos)/2)^2 is 3/8. The theory for lambda/h of 20 to 30 gives |R| near 0.006, so some 4e-5 of
  // the energy.
  const Reports r = run_in_process("bar");
  const double mass = 2650 * 4.0 / 3.0 * pi * std::pow(0.05, 3);
  const double before = 0.5 * mass * 0.01 * 0.01 * 3.0 / 8.0 * 3.0 / 0.1;
  const double echo = r.grains.kinetic_energy / before;
  const double passed = (r.zones.ledger.kinetic) / before;
  CAPTURE(echo, passed, r.grains.energy_residual, r.zones.ledger_residual_fraction);
  CHECK(echo < 5e-4);
  CHECK(passed == Approx(1).margin(0.02));
}

TEST_CASE("a box of grains settles the block under it by W/A h/M") {
  const Reports r = run_in_process("oedometer");
  // The weight W is what the interface carries. Whatever its distribution, the settlement's mean over the area is that of
  // uniaxial strain under W/A: by Betti's theorem with the state of uniform pressure p, W (p h / M) = p A <u>, and the
  // zones give that state exactly. So <u> = (W/A) h / M to what is still in motion.
  const double weight = -r.grains.interface_force.z();
  const double oedometer_modulus = 44.3e6 * 0.7 / (1.3 * 0.4);
  const double expected = weight / 0.16 * 0.4 / oedometer_modulus;
  CAPTURE(weight, expected, r.zones.settlement, r.grains.grains);
  CHECK(r.grains.grains == Approx(600).epsilon(0.01));
  CHECK(r.zones.settlement == Approx(expected).epsilon(2e-3));
  CHECK(r.grains.worst_vertical_imbalance < 1e-10);
}

TEST_CASE("the same scene gives the same bits twice") {
  const std::vector<std::string> shorter = {"run.duration=0.005", "apply.max_steps=500"};
  const Reports first = run_in_process("oedometer", shorter);
  const Reports second = run_in_process("oedometer", shorter);
  CHECK(first.grains.steps == second.grains.steps);
  CHECK(first.grains.state_hash == second.grains.state_hash);
  CHECK(first.zones.state_hash == second.zones.state_hash);
}

}  // namespace lockstep::coupled
