// A balanced packing that one run writes and others begin with.
#include <unistd.h>

#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "tests/coupled/coupled_fixture.hpp"

namespace lockstep::coupled {

namespace {

// Both sides in this process, with options for the grains.
dem::RunReport run_with(const std::vector<std::string>& overrides, const dem::RunOptions& options) {
  spdlog::set_level(spdlog::level::warn);
  // 300 grains, 1.5 across the pile: what is shown here does not need many.
  std::vector<std::string> all = {
      "fidelity.particle_scale=3", "fidelity.pile_velocity=0.5",     "fidelity.mesh_refinement=0.5",
      "pile.penetration=0.02",     "grains.packing.cube_grains=150", "grains.packing.porosity=0.4",
      "balance.tolerance=2e-2",    "balance.max_servo_travel=0.3",   "balance.max_cycles=20000"};
  all.insert(all.end(), overrides.begin(), overrides.end());
  const SceneFile scene = read_scene(scenario("pile_quick"), all);
  auto [server, client] = protocol::make_loopback();
  dem::RunReport report;
  std::exception_ptr grains_failed, zones_failed;
  std::thread grains([&, channel = std::move(server)]() mutable {
    try {
      report = dem::run_grains(scene, std::move(channel), options);
    } catch (...) {
      grains_failed = std::current_exception();
    }
  });
  try {
    continuum::run_continuum(scene, {}, std::move(client), {});
  } catch (...) {
    zones_failed = std::current_exception();
  }
  grains.join();
  if (grains_failed) std::rethrow_exception(grains_failed);
  if (zones_failed) std::rethrow_exception(zones_failed);
  return report;
}

}  // namespace

TEST_CASE("a run that takes a packing from a file ends in the same bits as the run that made it") {
  const auto path = std::filesystem::temp_directory_path() / fmt::format("lockstep_reuse_{}.packing", ::getpid());
  std::filesystem::remove(path);
  dem::RunOptions options;
  const dem::RunReport unsaved = run_with({}, options);
  options.packing = path;
  const dem::RunReport making = run_with({}, options);
  REQUIRE(std::filesystem::exists(path));
  const dem::RunReport taking = run_with({}, options);
  CAPTURE(making.grains, making.steps, making.s_over_d, making.ring_mismatch);
  CHECK(making.state_hash == unsaved.state_hash);
  CHECK(taking.state_hash == making.state_hash);
  CHECK(taking.position_hash == making.position_hash);
  CHECK(taking.steps == making.steps);
  CHECK(taking.time == making.time);
  CHECK(taking.tip_resistance == making.tip_resistance);
  CHECK(taking.energy_residual == making.energy_residual);
  CHECK(taking.ring_mismatch == making.ring_mismatch);
  CHECK(taking.bottom_mismatch == making.bottom_mismatch);

  options.threads = 3, options.balance_threads = 2;
  CHECK(run_with({}, options).state_hash == making.state_hash);
  // The rest of the procedure is another matter: the packing is taken, and its future is the new scene's.
  const dem::RunReport faster =
      run_with({"fidelity.pile_velocity=1", "run.damping=0.1", "fidelity.step_fraction=0.8"}, options);
  CHECK(faster.state_hash != making.state_hash);
  CHECK(faster.grains == making.grains);
  CHECK_THROWS_WITH(run_with({"grains.friction=0.6"}, options),
                    Catch::Contains("grains.friction is 0.7 there and 0.6 here"));
  // Heavier ground hands over another stress, which no key of the grains tells.
  CHECK_THROWS_WITH(run_with({"continuum.density=1700"}, options), Catch::Contains("there and"));
  std::filesystem::remove(path);
}

}  // namespace lockstep::coupled
