// The small scenes, both sides in one process: what they show is known beforehand.
#include <catch2/catch.hpp>
#include <cmath>

#include "dem_server/settings.hpp"
#include "tests/continuum_client/fixtures.hpp"
#include "tests/continuum_client/mesh_writers.hpp"
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

TEST_CASE("a grain at rest presses with its weight on a ground whose mesh is from a file, on its top and in its hole") {
  // As on the built-in block, whose mesh is written out and shuffled; and at the bottom of a hole that zones were deleted
  // from: W = 2650 x 4/3 pi R^3 x 9.81.
  using namespace continuum;
  const std::string ground = "continuum {{ mesh_file {{ file: '{}' {} }} }} ";
  const std::string stages =
      "balance { servo: NONE max_cycles: 0 } apply { damping: 0.7 tolerance: 1e-4 } run { duration: 0.05 damping: 0.7 "
      "continuum_damping: 0.7 } output { zones: false }";
  const auto weight = [](double radius) { return 2650 * 4.0 / 3.0 * pi * std::pow(radius, 3) * 9.81; };
  const auto run = [&](const MeshOnDisk& file, const std::string& domain, const std::string& grain) {
    return run_in_process(
        parse_scene(fmt::format(fmt::runtime(ground), file.path().string(), domain) + grain + stages, "test.txt"));
  };
  const MeshOnDisk block(vtu(shuffled(plain(brick(0.2, 0.2, 0.1, 4, 4, 2)), 3), VtuForm::Inline));
  const Reports top = run(block, "", "grains { grain { center { x: 0.013 y: -0.021 z: 0.03 } radius: 0.03 } } ");
  CAPTURE(top.grains.interface_force.transpose(), weight(0.03));
  CHECK(top.zones.zones == 32);
  CHECK(top.grains.interface_force.z() == Approx(-weight(0.03)).epsilon(1e-4));
  CHECK(top.grains.worst_action_reaction < 1e-14);

  const MeshOnDisk cylinder(msh_4(shuffled(plain(small_cylinder()), 8), true));
  const Reports hole = run(cylinder, "discrete_domain: 'grains here'",
                           "grains { grain { center { x: 0.05 y: 0.02 z: -2.4 } radius: 0.1 } } ");
  CAPTURE(hole.grains.interface_force.transpose(), weight(0.1), hole.zones.excavation_residual, hole.zones.settlement);
  CHECK(hole.zones.zones_deleted == 192);
  CHECK(hole.zones.excavation_residual < 1e-10);
  CHECK(hole.grains.interface_force.z() == Approx(-weight(0.1)).epsilon(1e-3));
  CHECK(hole.grains.worst_action_reaction < 1e-14);
}

TEST_CASE("grains pack the hole that a scene gives for its mesh file") {
  const auto settings =
      dem::make_settings(parse_scene("continuum { mesh_file { file: 'a.msh' discrete_domain: 'a' hole { diameter: 0.86 "
                                     "depth: 2.5 } } } grains { packing { } }",
                                     "test.txt"));
  REQUIRE(settings.packing);
  CHECK(settings.packing->container.volume() == Approx(pi / 4 * 0.86 * 0.86 * 2.5));
}

TEST_CASE("clay over sand, in a mesh from a file, settles by what each gives way") {
  // Smooth sides and a uniform pressure p: strain p / M in each, exact for distorted zones (patch test).
  const SceneFile scene = read_scene(scenario("ground_from_file"));
  const continuum::RunReport report = continuum::run_continuum(scene, {}, nullptr, {});
  const auto modulus = [](double e, double nu) { return e * (1 - nu) / ((1 + nu) * (1 - 2 * nu)); };
  const double expected = 1e5 * (0.6 / modulus(5e6, 0.4) + 0.4 / modulus(44.3e6, 0.3));
  // The weight above the middle of the lowest zones, to the scatter of their heights.
  const double vertical = -9.81 * (1500 * 0.6 + 1630 * 0.3);
  CAPTURE(report.settlement, expected, report.settlement / expected - 1, report.bottom_vertical_stress, vertical);
  CHECK(report.settlement == Approx(expected).epsilon(1e-6));
  CHECK(report.bottom_vertical_stress == Approx(vertical).epsilon(0.02));
}

TEST_CASE("sand that yields between smooth sides settles by what its flow rule says") {
  // Between the sides total strain is zero: ((1 - nu) K_a - nu) p / E = lambda (1 + s) / 2, s = sin psi, of the flow of the two
  // planes that meet at equal lateral stresses; axially they give lambda (1 - s) beside the elastic (1 - 2 nu K_a) p / E.
  const SceneFile scene = read_scene(scenario("yielding_sand"));
  const continuum::RunReport report = continuum::run_continuum(scene, {}, nullptr, {});
  const double nu = 0.1, active = 1.0 / 3, s = std::sin(10 * pi / 180), strain = 1e5 / 10e6;
  const double expected = strain * (1 - 2 * nu * active + 2 * (1 - s) / (1 + s) * ((1 - nu) * active - nu));
  CAPTURE(report.settlement, expected, report.settlement / expected - 1, report.ledger.work.yielded);
  CHECK(report.settlement == Approx(expected).epsilon(1e-4));
  REQUIRE(report.zones_yielded);
  CHECK(*report.zones_yielded == 3 * 3 * 8);
  // All work at a load that rises from zero along one way: p settlement / 2, less what is stored, p^2 / 2E (1 - 4 nu K_a + 2 (1 - nu) K_a^2).
  const double stored = 0.5 * 1e5 * strain * (1 - 4 * nu * active + 2 * (1 - nu) * active * active);
  CHECK(report.ledger.elastic == Approx(stored).epsilon(1e-3));
  CHECK(report.ledger.work.yielded == Approx(0.5 * 1e5 * expected - stored).epsilon(1e-2));
  CHECK(report.ledger_residual_fraction < 1e-12);
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
