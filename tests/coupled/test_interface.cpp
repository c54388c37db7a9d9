// What the interface does to force, moment, work and the step: both solvers in one process.
#include <catch2/catch.hpp>
#include <cmath>
#include <fstream>
#include <iterator>
#include <utility>

#include "tests/coupled/coupled_fixture.hpp"

namespace lockstep::coupled {
namespace {

using Catch::Contains;
using Overrides = std::vector<std::string>;

// What both sides say when the run fails.
struct Verdicts {
  std::string grains, zones;
  ExitCode grains_code = ExitCode::Success, zones_code = ExitCode::Success;
};

Verdicts verdicts(const std::string& name, const Overrides& overrides) {
  spdlog::set_level(spdlog::level::off);
  const SceneFile scene = read_scene(scenario(name), overrides);
  auto [server, client] = protocol::make_loopback();
  Verdicts v;
  std::thread grains([&, channel = std::move(server)]() mutable {
    try {
      dem::run_grains(scene, std::move(channel), {});
    } catch (const Error& e) {
      v.grains = e.what(), v.grains_code = e.code();
    }
  });
  try {
    continuum::run_continuum(scene, {}, std::move(client), {});
  } catch (const Error& e) {
    v.zones = e.what(), v.zones_code = e.code();
  }
  grains.join();
  spdlog::set_level(spdlog::level::warn);
  return v;
}

// A sphere that hits the block at a slant, with friction.
const Overrides slanting = {"grains.grain[0].velocity.x=0.7", "grains.grain[0].spin.y=4", "grains.friction=0.5",
                            "grains.interface_friction=0.5"};

Overrides with(Overrides base, const Overrides& more) {
  base.insert(base.end(), more.begin(), more.end());
  return base;
}

}  // namespace

TEST_CASE("both sides hold the same ledger of the interface, and nothing is left over in it") {
  const Reports r = run_in_process("impact_on_block", slanting);
  REQUIRE(r.grains.coupled);
  REQUIRE(r.zones.coupled);
  const CoupledLedger& ledger = *r.grains.coupled;
  INFO("force gap " << ledger.worst_force_gap() << ", works added " << ledger.interface_gap() / ledger.work_done()
                    << ", residual " << ledger.residual_fraction() << " of the work done");
  CHECK(ledger.worst_force_gap() < 1e-14);
  CHECK(std::abs(ledger.interface_gap()) < 1e-13 * ledger.work_done());
  CHECK(std::abs(ledger.residual_fraction()) < 1e-3);
  CHECK(ledger.worst_force_gap() == r.zones.coupled->worst_force_gap());
  CHECK(ledger.worst_moment_gap() == r.zones.coupled->worst_moment_gap());
  CHECK(ledger.residual() == r.zones.coupled->residual());
  CHECK(ledger.work_done() == r.zones.coupled->work_done());
  CHECK((ledger.impulse() - r.zones.coupled->impulse()).norm() == 0);
  // The impulse on the nodes is what the sphere has lost of its momentum, to the half steps at both ends.
  const double mass = 2650 * 4.0 / 3.0 * pi * std::pow(0.05, 3);
  const Vec3 lost = mass * Vec3(0.7, 0, -1) - r.grains.momentum;
  CHECK((ledger.impulse() - lost).norm() < 1e-12 * lost.norm());
}

TEST_CASE("exact moment transfer leaves no moment over; eq. (13) drops a small one; the answer hardly changes") {
  const Reports paper = run_in_process("impact_on_block", slanting);
  const Reports exact = run_in_process("impact_on_block", with(slanting, {"coupling.moment_transfer=EXACT"}));
  const double speed = paper.grains.momentum.norm();
  INFO("moment gap: eq. (13) " << paper.grains.coupled->worst_moment_gap() << ", exact "
                               << exact.grains.coupled->worst_moment_gap() << "; momentum after the impact differs by "
                               << (paper.grains.momentum - exact.grains.momentum).norm() / speed);
  CHECK(paper.grains.coupled->worst_moment_gap() > 1e-4);
  CHECK(exact.grains.coupled->worst_moment_gap() < 1e-13);
  CHECK(std::abs(exact.grains.coupled->residual_fraction()) < 1e-3);
  CHECK((paper.grains.momentum - exact.grains.momentum).norm() < 0.01 * speed);
  CHECK((paper.grains.momentum - exact.grains.momentum).norm() > 0);
}

TEST_CASE("a scene without a ledger runs to the same state, bit for bit") {
  const Reports kept = run_in_process("impact_on_block", slanting);
  const Reports none = run_in_process("impact_on_block", with(slanting, {"coupling.ledger=false"}));
  CHECK(!none.grains.coupled);
  CHECK(!none.zones.coupled);
  CHECK(none.grains.state_hash == kept.grains.state_hash);
  CHECK(none.zones.state_hash == kept.zones.state_hash);
}

TEST_CASE("a step above the limit ends the run on both sides with code 4 and the same words") {
  const Verdicts v = verdicts("bar", {"fidelity.step_fraction=3.3", "run.duration=1"});
  CAPTURE(v.grains, v.zones);
  CHECK(v.grains_code == ExitCode::Numerical);
  CHECK(v.zones_code == ExitCode::Numerical);
  const bool is_by_grains = v.zones.find("peer gave up: ") == 0;
  const std::string& cause = is_by_grains ? v.grains : v.zones;
  const std::string& told = is_by_grains ? v.zones : v.grains;
  // Either the other side was told, or it came to the same verdict by itself.
  CHECK((told == cause || told.find(cause) != std::string::npos));
  CHECK_THAT(cause, Contains("fidelity.step_fraction"));
}

TEST_CASE("a packing that a long step liquefies in silence is told from one at rest") {
  // At 1.3 of the bound nothing is infinite and the energies balance, but the packing never comes to rest: with the step within
  // the bound it has an unbalanced ratio below 5e-3 after as many steps. Where the true limit lies above the bound depends on
  // the packing: at 1.2 seven seeds of twelve were caught, at 1.3 all.
  const Overrides shorter = {"run.duration=0.005", "apply.max_steps=500"};
  const Verdicts v = verdicts("oedometer", with(shorter, {"fidelity.step_fraction=1.3"}));
  CAPTURE(v.grains, v.zones);
  CHECK(v.grains_code == ExitCode::Numerical);
  CHECK(v.zones_code == ExitCode::Numerical);
  CHECK_THAT(v.grains, Contains("shivers instead of resting") && Contains("fidelity.step_fraction"));
  CHECK_THAT(v.zones, Contains(v.grains));
}

TEST_CASE("a run that fails goes back to its last sound state on both sides") {
  // A grain falls 30 mm onto the block, sqrt(2 h / g) = 0.078 s, some 700 steps. Until then energies balance to 1e-3; contacts of a
  // few steps do not to 1e-2. States are kept every 500 steps; the newest that is 100 steps older than the failure is shown.
  const SceneFile scene =
      read_scene(scenario("grain_on_block"),
                 {"grains.grain[0].center.z=0.06", "apply.max_steps=0", "run.damping=0", "run.continuum_damping=0",
                  "run.duration=0.2", "coupling.stop_if_energy_error=0.01", "output.history_interval=70"});
  const std::filesystem::path folder = std::filesystem::temp_directory_path() / "lockstep_last_sound_state";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  spdlog::set_level(spdlog::level::off);
  auto [server, client] = protocol::make_loopback();
  std::string verdict;
  std::thread grains([&, channel = std::move(server)]() mutable {
    dem::RunOptions options;
    options.results = folder;
    try {
      dem::run_grains(scene, std::move(channel), options);
    } catch (const Error& e) {
      verdict = e.what();
    }
  });
  CHECK_THROWS_AS(continuum::run_continuum(scene, folder, std::move(client), {}), Error);
  grains.join();
  spdlog::set_level(spdlog::level::warn);
  CHECK_THAT(verdict, Contains("do not balance"));
  REQUIRE(verdict.rfind("step ", 0) == 0);
  const int failed_at = std::stoi(verdict.substr(5)), sound = (failed_at - 100) / 500 * 500;
  CHECK(sound >= 500);
  for (const char* name : {"dem_summary.json", "continuum_summary.json"}) {
    std::ifstream file(folder / name);
    const std::string text{std::istreambuf_iterator<char>(file), {}};
    INFO(name << ": " << verdict);
    CHECK_THAT(text, Contains(fmt::format("\"steps\": {},", sound)));
  }
  // What was recorded before the failure stays; the state gone back to, between two rows, adds none behind them.
  // An exchange has the number of the step that it begins.
  for (const auto& [name, first] : {std::pair("dem_history.csv", 70), std::pair("continuum_history.csv", 70),
                                    std::pair("continuum_interface.csv", 69)}) {
    std::ifstream file(folder / name);
    std::string line;
    std::getline(file, line);
    int rows = 0;
    while (std::getline(file, line)) {
      INFO(name << ": " << line);
      CHECK(std::stoi(line) == first + 70 * rows++);
    }
    CHECK(rows == failed_at / 70);
  }
  std::filesystem::remove_all(folder);
}

TEST_CASE("a limit that falls is answered by a smaller step or by the end of the run, as the scene says") {
  // Whether a new contact lowers the limit, and not only moves it within what the step leaves, is up to the packing: with
  // 0.99 of the limit it did in five of six. The first of eight in which it does is taken.
  Overrides shorter;
  Reports cut;
  for (int seed = 1; seed <= 8 && cut.zones.step_cuts == 0; ++seed) {
    shorter = {"run.duration=0.02", "apply.max_steps=500", "fidelity.step_fraction=0.99", fmt::format("seed={}", seed)};
    cut = run_in_process("oedometer", shorter);
  }
  INFO(shorter.back() << ": steps of " << cut.zones.first_time_step << " s, cut " << cut.zones.step_cuts << " times to "
                      << cut.zones.last_time_step << " s");
  REQUIRE(cut.zones.step_cuts > 0);
  CHECK(cut.zones.last_time_step < cut.zones.first_time_step);
  const Verdicts v = verdicts("oedometer", with(shorter, {"coupling.when_limit_drops=STOP"}));
  CAPTURE(v.grains, v.zones);
  CHECK(v.grains_code == ExitCode::Numerical);
  CHECK(v.zones_code == ExitCode::Numerical);
  CHECK_THAT(v.zones, Contains("coupling.when_limit_drops is STOP") && (Contains("node ") || Contains("grain ")));
  CHECK_THAT(v.grains, Contains(v.zones));
}

TEST_CASE("the hand-off reports how far it moved the interface and changed the stresses") {
  // A column of zones held at its sides takes the weight W of a grain on its middle as sigma_zz = -W / A in each zone, and
  // settles by (W / A) h / M: before Apply it carried nothing but itself.
  const Reports r = run_in_process(
      "grain_on_block", {"continuum.block.zones_x=1", "continuum.block.zones_y=1", "continuum.supports=ROLLERS",
                         "grains.grain[0].center.x=0", "grains.grain[0].center.y=0", "apply.tolerance=1e-6"});
  const double weight = 2650 * 4.0 / 3.0 * pi * std::pow(0.03, 3) * 9.81, area = 0.04;
  const double oedometer_modulus = 44.3e6 * 0.7 / (1.3 * 0.4);
  INFO("stress " << r.zones.jump.stress / (weight / area) << ", move "
                 << r.zones.jump.largest / (weight / area * 0.1 / oedometer_modulus) << " of the exact ones");
  CHECK(r.zones.jump.stress == Approx(weight / area).epsilon(1e-3));
  CHECK(r.zones.jump.largest == Approx(weight / area * 0.1 / oedometer_modulus).epsilon(1e-3));
}

TEST_CASE("a coupled model at rest stays there: what drifts in energy, force and place is round-off") {
  // Doubles at z = 0.03 m are 2^-58 m apart. A move of less than half of that, 2^-59 m in a step, moves nothing, but its work on
  // the weight W is booked; and a step that does move is rounded by as much. So N steps may shift the residual by N W 2^-58 m,
  // and anything beyond is a drift.
  const Overrides at_rest = {"grains.grain[0].center.x=0", "grains.grain[0].center.y=0", "continuum.block.zones_x=3",
                             "continuum.block.zones_y=3"};
  const Reports first = run_in_process("grain_on_block", with(at_rest, {"run.duration=0.6"}));
  const Reports later = run_in_process("grain_on_block", with(at_rest, {"run.duration=3.0"}));
  const double weight = 2650 * 4.0 / 3.0 * pi * std::pow(0.03, 3) * 9.81;
  const double steps = static_cast<double>(later.grains.steps - first.grains.steps);
  const double residual = later.grains.coupled->residual() - first.grains.coupled->residual();
  INFO(steps << " steps more: residual " << residual << " J, allowed " << steps * weight * std::ldexp(1, -58)
             << " J; elastic energy of zones " << later.zones.ledger.elastic - first.zones.ledger.elastic << " J of "
             << later.zones.ledger.elastic << " J; force "
             << (later.grains.interface_force - first.grains.interface_force).norm() / weight
             << " of the weight; settlement " << later.zones.settlement - first.zones.settlement << " m");
  CHECK(steps > 20000);
  CHECK(std::abs(residual) < steps * weight * std::ldexp(1, -58));
  CHECK(std::abs(later.zones.ledger.elastic - first.zones.ledger.elastic) < 1e-9 * later.zones.ledger.elastic);
  CHECK((later.grains.interface_force - first.grains.interface_force).norm() < 1e-9 * weight);
  CHECK(std::abs(later.zones.settlement - first.zones.settlement) < 1e-9 * later.zones.settlement);
  CHECK(later.grains.kinetic_energy < 1e-25);
  CHECK(later.grains.momentum.norm() < 1e-12);
}

TEST_CASE("several steps of the grains to one of the ground: the same weight at rest, the same impulse on both sides") {
  // At rest the node's forces are the grain's weight, whatever they are the mean of. Sum F dt on the nodes is, to the last
  // steps' half, what gravity has given to the grain: both sides book the same.
  const double weight = 2650 * 4.0 / 3.0 * pi * std::pow(0.03, 3) * 9.81;
  for (const char* interval : {"2", "5", "20"}) {
    const Reports r = run_in_process(
        "grain_on_block", {std::string("fidelity.exchange_interval=") + interval, "coupling.hash_interval=1"});
    INFO(interval << " steps: force " << r.grains.interface_force.z() / weight << " of the weight, works added "
                  << r.grains.coupled->interface_gap() / r.grains.coupled->work_done() << " of the work done, residual "
                  << r.grains.coupled->residual_fraction());
    CHECK(r.grains.interface_force.z() == Approx(-weight).epsilon(1e-4));
    CHECK(r.grains.coupled->worst_force_gap() < 1e-14);
    CHECK((r.grains.coupled->impulse() - r.zones.coupled->impulse()).norm() == 0);
    CHECK(r.grains.coupled->work_done() > 0);
  }
}

TEST_CASE("exchange after several steps is refused in words where it cannot be stable") {
  CHECK_THROWS_WITH(read_scene(scenario("impact_on_block"), {"fidelity.exchange_interval=4"}),
                    Contains("fidelity.exchange_interval") && Contains("run.damping") && Contains("0.3 or more"));
  CHECK_THROWS_WITH(read_scene(scenario("grain_on_block"), {"fidelity.exchange_interval=4", "continuum.dynamic=true"}),
                    Contains("continuum.dynamic"));
}

}  // namespace lockstep::coupled
