// Grains without a continuum: one process, from the packing to the end.
#include <unistd.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "common/checks.hpp"
#include "common/interrupt.hpp"
#include "common/log.hpp"
#include "dem_server/settings.hpp"
#include "dem_server/stages.hpp"
#include "protocol/loopback_channel.hpp"

using namespace lockstep;
using namespace lockstep::dem;
using Catch::Contains;

namespace {

namespace fs = std::filesystem;

RunReport run_alone(const SceneFile& scene, const RunOptions& options = {}) {
  spdlog::set_level(spdlog::level::warn);
  return run_grains(scene, nullptr, options);
}

SceneFile scenario(const std::string& name, const std::vector<std::string>& overrides = {}) {
  return read_scene(fs::path(SOURCE_DIR) / "scenarios" / name / "scene.txt", overrides);
}

// The scene of the pile with 600 grains, a third of the way.
SceneFile small_pile(const std::vector<std::string>& overrides = {}) {
  std::vector<std::string> all = {"grains.packing.count=600", "grains.packing.cube_grains=150",
                                  "grains.packing.porosity=0.4", "pile.penetration=0.1", "balance.tolerance=1e-2"};
  all.insert(all.end(), overrides.begin(), overrides.end());
  return scenario("pile_particles_small", all);
}

// A folder for results that goes with its test.
struct Folder {
  fs::path path = fs::temp_directory_path() / fmt::format("lockstep_alone_{}", ::getpid());
  Folder() { fs::create_directories(path); }
  ~Folder() { fs::remove_all(path); }
};

// Columns of a history, by name.
std::map<std::string, std::vector<double>> columns_of(const fs::path& csv) {
  std::ifstream file(csv);
  REQUIRE(file.good());
  std::vector<std::string> names;
  std::string line, cell;
  std::getline(file, line);
  for (std::istringstream cells(line); std::getline(cells, cell, ',');) names.push_back(cell);
  std::map<std::string, std::vector<double>> columns;
  while (std::getline(file, line)) {
    std::istringstream cells(line);
    for (const std::string& name : names) {
      std::getline(cells, cell, ',');
      columns[name].push_back(std::stod(cell));
    }
  }
  return columns;
}

std::string content_of(const fs::path& path) {
  std::ifstream file(path);
  REQUIRE(file.good());
  return {std::istreambuf_iterator<char>(file), {}};
}

std::string complaint_about(const std::string& blocks) {
  try {
    make_settings(parse_scene(blocks, "a scene"));
  } catch (const Error& error) {
    return error.what();
  }
  return "no complaint";
}

constexpr const char* cell_walls =
    "wall { cylinder { axis { z: 1 } radius: 0.2 } }\n"
    "wall { plane { point { z: -0.5 } normal { z: 1 } } }\n";

}  // namespace

TEST_CASE("A sphere rolls down a slope with 5/7 of a sliding block's acceleration") {
  // Gravity turns about the contact, at (R - U/2) from the centre: with I = 2/5 m R^2 the centre gains
  // a = g sin(theta) / (1 + 2/5 (R/(R - U/2))^2), 5/7 g sin(theta) to U/R = 1e-5. The velocity is that half a step before
  // the end. While the shear spring winds up, the sphere slides a little: it swings with sqrt(2/7 m / k_s) about pure rolling,
  // undamped, by a/omega = 2e-3 m/s at most, of 1.2 m/s.
  // The ledger closes to second order in the step: half of it leaves a quarter of the residual, less in a run that ends
  // elsewhere in the swing.
  const RunReport r = run_alone(scenario("rolling_grain")),
                  finer = run_alone(scenario("rolling_grain", {"fidelity.step_fraction=0.45"}));
  const double theta = 20 * pi / 180;
  const double mass = 2650 * 4.0 / 3.0 * pi * std::pow(0.03, 3);
  const double speed = r.momentum.dot(Vec3(std::cos(theta), 0, -std::sin(theta))) / mass;
  const double expected = 5.0 / 7.0 * 9.81 * std::sin(theta) * r.time;
  const double error = speed / expected - 1;
  CAPTURE(r.time, speed, expected, error, r.energy_residual, finer.energy_residual, r.worst_vertical_imbalance);
  CHECK(std::abs(finer.energy_residual) < 0.5 * std::abs(r.energy_residual));
  CHECK(std::abs(finer.energy_residual) < 1e-4);
  CHECK(r.time == Approx(0.5).epsilon(1e-3));
  CHECK(std::abs(error) < 2e-3);
  CHECK(r.worst_vertical_imbalance < 1e-12);
}

TEST_CASE("Plates that press a cube of grains carry their servos' pressures, and so does the cube") {
  // Without gravity each pair of plates balances: both carry p_i A, A the servos' 0.16 m2. By the divergence theorem
  // V <sigma_ii> = sum of force times place over the plates = -p_i A L_i, L_i between the plates as they stand. Contact points
  // lie U/2 behind them, 2e-3 R or 1e-4 L on each side. V, the ball's room, is counted by points 5 mm apart: in each
  // direction by one of them more or less.
  const Folder folder;
  RunOptions options;
  options.results = folder.path;
  const RunReport r = run_alone(scenario("pressed_cube"), options);
  auto walls = columns_of(folder.path / "wall_history.csv");
  auto ball = columns_of(folder.path / "ball_0.csv");
  const std::array pressure = {100e3, 120e3, 150e3};
  const std::array names = {"east", "north", "top"};
  Vec3 length;
  for (int i = 0; i < 3; ++i) length[i] = 0.4 - walls[std::string(names[i]) + " servo way [m]"].back();
  REQUIRE(r.walls.size() == 6);
  for (int i = 0; i < 3; ++i) {
    const double load = pressure[i] * 0.16;
    const double held = r.walls[i + 3].force[i] / load - 1;
    const double passed_on = r.walls[i].force[i] / -load - 1;
    const std::string name = std::string("stress ") + "xyz"[i] + "xyz"[i] + " [Pa]";
    const double room = ball["room"].back() * 4.0 / 3.0 * pi * std::pow(0.4, 3);  // of the ball's volume [m3]
    const double stress = room * ball[name].back() / (-load * length[i]) - 1;
    CAPTURE(i, held, passed_on, stress, length.transpose());
    CHECK(room == Approx(length.prod()).epsilon(3 * 0.005 / 0.4));
    CHECK(std::abs(held) < 1e-3);
    CHECK(std::abs(passed_on) < 1e-3);
    CHECK(std::abs(stress) < 2e-3);
  }
}

TEST_CASE("A specimen is packed in a cylinder and held by servos on mantle and lid") {
  // No gravity: mantle and lid each at their own pressure, the bottom with what the lid carries. What friction, which begins
  // with Apply, makes of the balance has died away after 0.3 s.
  const RunReport r = run_alone(parse_scene(R"(
    gravity: 0
    grains { packing { count: 500 porosity: 0.4 cube_grains: 150 } }
    wall { cylinder { point { z: -0.4 } axis { z: 1 } radius: 0.2 length: 0.8 } servo { pressure: 50e3 } }
    wall { plane { point { z: -0.4 } normal { z: 1 } } }
    wall { plane { point { z: 0.4 } normal { z: -1 } } servo { pressure: 80e3 area: 0.12566 } }
    balance { tolerance: 1e-3 }
    run { duration: 0.4 damping: 0.7 })",
                                            "a specimen"));
  REQUIRE(r.walls.size() == 3);
  const double mantle = r.walls[0].pressure / 50e3 - 1, lid = r.walls[2].pressure / 80e3 - 1;
  const double bottom = -r.walls[1].force.z() / r.walls[2].force.z() - 1;
  CAPTURE(r.grains, mantle, lid, bottom);
  CHECK(std::abs(static_cast<double>(r.grains) - 500) <= 5);
  CHECK(std::abs(mantle) < 5e-3);
  CHECK(std::abs(lid) < 5e-3);
  CHECK(std::abs(bottom) < 5e-3);
}

TEST_CASE(
    "The triaxial scene begins with its pressure on all sides and keeps it on the mantle while the platen comes down") {
  // No gravity: platen and bottom carry p pi R^2, R the mantle's at the moment, and the mantle p over the height between them,
  // all within the balance's 3e-3. Then the platen's way is the velocity's integral, v (t - ramp/2), the mantle's pressure lags by
  // its servo's offset, and works and energies balance.
  const Folder folder;
  RunOptions options;
  options.results = folder.path;
  const RunReport r = run_alone(
      scenario("triaxial", {"grains.packing.count=400", "grains.packing.cube_grains=150",
                            "grains.packing.porosity=0.41", "run.duration=0.15", "output.history_interval=1"}),
      options);
  auto walls = columns_of(folder.path / "wall_history.csv");
  const double radius = walls["mantle radius [m]"].front(), load = 100e3 * pi * radius * radius;
  const double top = walls["top force z [N]"].front() / load - 1,
               bottom = -walls["bottom force z [N]"].front() / load - 1;
  const double mantle = walls["mantle pressure [Pa]"].front() / 100e3 - 1;
  CAPTURE(r.grains, top, bottom, mantle);
  CHECK(std::abs(top) < 5e-3);
  CHECK(std::abs(bottom) < 5e-3);
  CHECK(std::abs(mantle) < 5e-3);
  double worst = 0;
  for (const double pressure : walls["mantle pressure [Pa]"]) worst = std::max(worst, std::abs(pressure / 100e3 - 1));
  const double way = walls["top centre z [m]"].front() - walls["top centre z [m]"].back();
  const double expected = 0.06 * (r.time - 0.5 * 0.05);
  CAPTURE(worst, way / expected - 1, r.energy_residual);
  CHECK(way == Approx(expected).epsilon(2e-3));
  CHECK(walls["top servo way [m]"].front() == walls["top servo way [m]"].back());
  CHECK(walls["top force z [N]"].back() > 2 * load);
  CHECK(worst < 0.02);
  CHECK(std::abs(r.energy_residual) < 2e-3);
}

TEST_CASE("A tub carries the weight of the grains in it") {
  const RunReport r = run_alone(parse_scene(std::string(cell_walls) + R"(
    grains { wall_friction: 0.5 packing { count: 400 porosity: 0.4 cube_grains: 150 } }
    balance { tolerance: 1e-3 }
    run { duration: 0.1 damping: 0.7 })",
                                            "a tub"));
  const double weight = r.mass * 9.81;
  const double error = (r.walls[0].force.z() + r.walls[1].force.z()) / -weight - 1;
  CAPTURE(weight, error, r.kinetic_energy);
  CHECK(std::abs(error) < 1e-3);
  CHECK(r.worst_vertical_imbalance < 1e-12);
}

TEST_CASE("A pile goes into grains alone: the forces balance at each step and the ledger closes") {
  const Folder folder;
  RunOptions options;
  options.results = folder.path;
  const RunReport r = run_alone(small_pile(), options);
  CAPTURE(r.s_over_d, r.tip_resistance, r.shaft_force, r.worst_vertical_imbalance, r.energy_residual, r.bottom_mismatch,
          r.ring_mismatch);
  CHECK(r.s_over_d == Approx(0.1).margin(1e-3));
  CHECK(r.tip_resistance > 0);
  CHECK(r.shaft_force > 0);
  // Tip, shaft, weight, walls, inertia and local damping, of the largest of them.
  CHECK(r.worst_vertical_imbalance < 1e-12);
  CHECK(std::abs(r.energy_residual) < 2e-3);
  // At the end of Balance the tip carried the weight above it, and the bottom weight and tip.
  CHECK(r.ring_mismatch < 1);
  CHECK(r.bottom_mismatch < 1);
  const auto figure = [summary = content_of(folder.path / "dem_summary.json")](const std::string& key) {
    return std::stod(summary.substr(summary.find("\"" + key + "\":") + key.size() + 3));
  };
  const double room = pi * 0.4375 * 0.4375 * 1.2 - pi * 0.125 * 0.125 * 0.5;  // of tub less pile [m3]
  const double pressure_above = r.mass * 9.81 / room * 0.5;
  CAPTURE(figure("tip_pressure_pa"), figure("weight_n"), pressure_above);
  CHECK(figure("weight_n") == Approx(r.mass * 9.81).epsilon(1e-5));
  CHECK(std::abs(figure("tip_pressure_pa") - pressure_above) < 0.02 * pressure_above + 500);  // the servo's tolerance
  // The step is cut where contacts stiffen, and never grows.
  const std::vector<double> step = columns_of(folder.path / "dem_history.csv").at("time step [s]");
  CAPTURE(step.front(), step.back());
  CHECK(std::is_sorted(step.rbegin(), step.rend()));
  CHECK(step.back() < step.front());
}

TEST_CASE("Grains alone end in the same bits for any number of threads, and from a packing on file") {
  const RunReport one = run_alone(small_pile());
  RunOptions options;
  for (const int threads : {2, 3}) {
    options.threads = options.balance_threads = threads;
    const RunReport r = run_alone(small_pile(), options);
    CAPTURE(threads);
    CHECK(r.state_hash == one.state_hash);
    CHECK(r.steps == one.steps);
    CHECK(r.time == one.time);
    CHECK(r.energy_residual == Approx(one.energy_residual).epsilon(1e-9));  // a team of another size renews its list
  }
  CHECK(run_alone(small_pile({"seed=2"})).state_hash != one.state_hash);
  const Folder folder;
  options.packing = folder.path / "packing";
  CHECK(run_alone(small_pile(), options).state_hash == one.state_hash);  // writes it
  REQUIRE(fs::exists(options.packing));
  CHECK(run_alone(small_pile(), options).state_hash == one.state_hash);  // takes it
  CHECK_THROWS_WITH(run_alone(small_pile({"wall[0].cylinder.radius=0.45"}), options),
                    Contains("wall[0].cylinder.radius is 0.4375 there and 0.45 here"));
}

TEST_CASE("Grains alone that are interrupted say so and leave their state") {
  const Folder folder;
  RunOptions options;
  options.results = folder.path;
  struct Restored {
    ~Restored() { interrupt_requested() = false; }
  } restored;
  interrupt_requested() = true;
  SECTION("on their way") {
    const RunReport r = run_alone(scenario("rolling_grain"), options);  // takes its one grain as it stands
    CHECK(r.is_interrupted);
    CHECK(r.steps == 0);
    CHECK(fs::exists(folder.path / "dem_summary.json"));
  }
  SECTION("while they are packed") { CHECK_THROWS_AS(run_alone(scenario("pressed_cube"), options), Interrupted); }
}

TEST_CASE("Company is checked: a peer for grains alone, or none for a scene with ground, is an error with a remedy") {
  auto [server, client] = protocol::make_loopback();
  CHECK_THROWS_WITH(run_grains(scenario("rolling_grain"), std::move(server), {}),
                    Contains("no continuum") && Contains("leave --listen out"));
  CHECK_THROWS_WITH(run_alone(scenario("grain_on_block")),
                    Contains("has a continuum") && Contains("--listen HOST:PORT") && Contains("tools/run"));
}

TEST_CASE("What a packing alone fills comes from the walls, or is refused with a remedy") {
  const std::string grains = "grains { packing { count: 100 } }\n";
  const auto container = [](const std::string& text) {
    return make_settings(parse_scene(text, "a scene")).packing->container;
  };
  const Container cell = container(grains + cell_walls);
  CHECK(cell.kind == Container::Kind::Cylinder);
  CHECK(cell.radius == 0.2);
  CHECK(cell.bottom == -0.5);
  CHECK(cell.top == 0);
  CHECK_FALSE(cell.has_lid);
  CHECK(cell.volume() == Approx(pi * 0.04 * 0.5));
  CHECK(cell.surface() == Approx(2 * pi * 0.2 * 0.5 + 2 * pi * 0.04));
  const Container filled = container("grains { packing { count: 100 fill_height: 0.8 } }\n" + std::string(cell_walls));
  CHECK(filled.top == Approx(0.3));
  const Container lidded = container(grains + cell_walls + "plane { point { z: 0.25 } normal { z: -1 } }");
  CHECK(lidded.top == 0.25);
  CHECK(lidded.has_lid);
  CHECK(lidded.depth_inside({0, 0, 0.2}) == Approx(0.05));
  const std::string sides =
      "plane { point { x: -1 } normal { x: 1 } } plane { point { x: 1 } normal { x: -1 } }\n"
      "plane { point { y: -2 } normal { y: 1 } } plane { point { y: 2 } normal { y: -1 } }\n";
  const std::string bottom = "plane { point { z: -3 } normal { z: 1 } }";
  const Container box = container(grains + sides + bottom);
  CHECK(box.kind == Container::Kind::Box);
  CHECK(box.volume() == Approx(2 * 4 * 3));
  // A box brings its walls along, the bottom as well: a scene with ground has its block there.
  CHECK(make_settings(parse_scene("grains { packing { count: 9 box { } } }", "a scene")).planes.size() == 5);
  CHECK(make_settings(parse_scene("grains { packing { count: 9 box { } } } continuum { block { } }", "a scene"))
            .planes.size() == 4);

  CHECK_THAT(complaint_about(grains + sides),
             Contains("grains.packing") && Contains("no bottom") && Contains("normal { z: 1 }"));
  CHECK_THAT(complaint_about(grains + bottom), Contains("no sides") && Contains("grains.packing.box"));
  CHECK_THAT(complaint_about(grains + bottom + " wall { cylinder { point { x: 0.1 } axis { z: 1 } } }"),
             Contains("no sides"));
  CHECK_THAT(complaint_about(grains + bottom + sides + " plane { point { x: 0.5 } normal { x: -1 } }"),
             Contains("x = -1 and 0.5 m") && Contains("same distance"));
  CHECK_THAT(complaint_about(
                 "grains { packing { count: 100 fill_height: 0.8 } } plane { point { z: 0.1 } normal { z: -1 } }\n" +
                 std::string(cell_walls)),
             Contains("fill_height = 0.8 m") && Contains("the lid at 0.1 m"));
  const std::string pile = "pile { embedment: 0.2 diameter: 0.1 penetration: 0.5 }\n";
  CHECK(complaint_about(grains + cell_walls + pile) == "no complaint");
  CHECK_THAT(complaint_about("grains { packing { count: 100 fill_height: 0.4 } }\n" + std::string(cell_walls) + pile),
             Contains("pile.embedment = 0.2 m") && Contains("filled to z = -0.1"));
  CHECK_THAT(complaint_about(grains + cell_walls + "pile { embedment: 0.2 diameter: 0.4 }"),
             Contains("pile.diameter = 0.4 m") && Contains("thinner pile"));
  CHECK_THAT(complaint_about(grains + cell_walls + "pile { embedment: 0.46 diameter: 0.1 penetration: 0.5 }"),
             Contains("to -0.51 m") && Contains("bottom at -0.5 m"));
}
