// Masses for motion that does not count: the same rest in fewer steps, and never where waves matter.
#include <catch2/catch.hpp>

#include "continuum_client/stages.hpp"
#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

double largest_move(const Vec3s& a, const Vec3s& b) {
  double worst = 0;
  for (std::size_t i = 0; i < a.size(); ++i) worst = std::max(worst, (a[i] - b[i]).norm());
  return worst;
}

}  // namespace

TEST_CASE("scaled masses give every node the step of the most critical one and no node more mass") {
  // Row sums over masses are all the same number, that of the most critical node's real mass: the bound stays, and the
  // true frequency does not exceed it.
  const Grid grid = small_cylinder();
  const StiffnessMatrix k = assemble_stiffness(grid);
  const std::vector<double> mass = lumped_masses(grid);
  const Vec3s is_free = free_components(grid, Supports::Rollers, mass);
  const std::vector<double> scaled = scaled_masses(k, mass, is_free);
  const double bound = gershgorin_frequency_squared(k, mass, is_free);
  double heaviest = 0, lightest = 1;
  for (std::size_t i = 0; i < mass.size(); ++i) {
    heaviest = std::max(heaviest, scaled[i] / mass[i]);
    lightest = std::min(lightest, scaled[i] / mass[i]);
  }
  const double truth = lanczos_frequency_squared(k, scaled, is_free, 200);
  INFO("masses " << lightest << " to " << heaviest << " of the real ones, omega^2 over its bound " << truth / bound);
  CHECK(heaviest == Approx(1).epsilon(1e-12));
  CHECK(lightest < 0.5);
  CHECK(gershgorin_frequency_squared(k, scaled, is_free) == Approx(bound).epsilon(1e-12));
  CHECK(truth <= bound);
}

TEST_CASE("cycles from rest end where the solution is, in fewer steps with scaled masses") {
  const Grid grid = small_cylinder();
  const StiffnessMatrix k = assemble_stiffness(grid);
  const std::vector<double> mass = lumped_masses(grid);
  const Vec3s is_free = free_components(grid, Supports::Rollers, mass);
  const Vec3 gravity(0, 0, -9.81);
  Vec3s solved, real, scaled;
  EquilibriumSettings settings;
  settings.tolerance = 1e-7, settings.max_cycles = 100000;
  reach_equilibrium(k, mass, is_free, gravity, settings, solved, {});
  settings.is_solved = false;
  const std::uint32_t with_real = reach_equilibrium(k, mass, is_free, gravity, settings, real, {}).cycles;
  settings.scales_density = true;
  const std::uint32_t with_scaled = reach_equilibrium(k, mass, is_free, gravity, settings, scaled, {}).cycles;
  double size = 0;
  for (const Vec3& u : solved) size = std::max(size, u.norm());
  INFO("cycles " << with_real << " with real masses, " << with_scaled << " with scaled ones; errors "
                 << largest_move(real, solved) / size << " and " << largest_move(scaled, solved) / size);
  CHECK(largest_move(real, solved) < 1e-4 * size);
  CHECK(largest_move(scaled, solved) < 1e-4 * size);
  CHECK(with_scaled < 0.8 * with_real);
}

TEST_CASE("a loaded ground alone settles by p H / M and ends at its tolerance, with scaled masses too") {
  // A column with rollers under p = 10 kPa: the top goes down by p H / M = 1e4 * 4 / 59.6e6 m.
  const std::string scene =
      "gravity: 9.81 continuum { block { width_x: 1 width_y: 1 height: 4 zones_x: 2 zones_y: 2 zones_z: 16 } "
      "supports: ROLLERS load { low { x: -1 y: -1 z: -0.01 } high { x: 1 y: 1 z: 0.01 } traction { z: -1e4 } ramp: "
      "0.02 } } "
      "run { duration: 20 tolerance: 1e-7 continuum_damping: 0.7 } ";
  const double exact = 1e4 * 4 / test_moduli.constrained();
  for (const std::string& fidelity : {std::string(), std::string("fidelity { density_scaling: true }")}) {
    const RunReport report = run_continuum(parse_scene(scene + fidelity, "test.txt"), {}, nullptr, {});
    INFO(fidelity << ": " << report.steps << " steps, settlement " << report.settlement << " m, exact " << exact);
    CHECK(report.settlement == Approx(exact).epsilon(1e-4));
    CHECK(report.time < 19);  // its tolerance ended it
  }
}

TEST_CASE("scaled masses are refused where waves count") {
  const auto read = [](const std::string& ground) {
    return read_settings(parse_scene("continuum { block { } " + ground + " } fidelity { density_scaling: true }", "t"));
  };
  CHECK_THROWS_WITH(read("dynamic: true"), Catch::Contains("waves travel at other speeds"));
  CHECK_THROWS_WITH(read("supports: QUIET"), Catch::Contains("absorb waves"));
  CHECK_THROWS_WITH(read("rayleigh { }"), Catch::Contains("rayleigh"));
}

}  // namespace lockstep::continuum
