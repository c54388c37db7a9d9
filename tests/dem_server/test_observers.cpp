#include <catch2/catch.hpp>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "common/checks.hpp"
#include "common/scene.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/observers.hpp"
#include "dem_server/output.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

struct Folder {
  std::filesystem::path path;
  Folder() {
    path = std::filesystem::temp_directory_path() / fmt::format("lockstep_observers_{}", ::getpid());
    std::filesystem::remove_all(path);
    std::filesystem::create_directories(path);
  }
  ~Folder() { std::filesystem::remove_all(path); }
};

using Table = std::map<std::string, std::vector<double>>;

Table read_table(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::string line, cell;
  std::getline(file, line);
  std::vector<std::string> names;
  for (std::istringstream cells(line); std::getline(cells, cell, ',');) names.push_back(cell);
  Table table;
  while (std::getline(file, line)) {
    std::istringstream cells(line);
    for (const std::string& name : names) std::getline(cells, cell, ','), table[name].push_back(std::stod(cell));
  }
  return table;
}

Settings settings_of(const std::string& measure) {
  return make_settings(parse_scene(
      "grains { pebbles: 1 grain { } } output { history_interval: 1 } measure { " + measure + " }", "test"));
}

// A cubic lattice of spheres a unit of 0.1 m apart, pressed by an overlap.
Model lattice(double overlap) {
  Model m(0.002);
  for (int n = 0; n < 64; ++n)
    m.particles.add(make_clump(1, 1), 0.05 + 0.5 * overlap, 2650, 0.1 * Vec3(n % 4, n / 4 % 4, n / 16),
                    Quat::Identity());
  evaluate_forces(m);
  return m;
}

}  // namespace

TEST_CASE("a ball and a grid in a pressed lattice report its porosity, stress and coordination") {
  // Contacts of stiffness k = E* 2 R and overlap U press with k U on a face of 0.1 m squared; three lenses a sphere.
  const double overlap = 0.001, radius = 0.05 + 0.5 * overlap;
  Model m = lattice(overlap);
  Settings settings = settings_of(
      "interval: 2 ball { center { x: 0.15 y: 0.15 z: 0.15 } radius: 0.1 } fabric: true force_network: true "
      "grid { cell: 0.990099 low { x: 0.07 y: 0.07 z: 0.07 } high { x: 0.27 y: 0.27 z: 0.27 } }");
  const double stress = -m.material.contact_modulus * 2 * radius * overlap / 0.01;
  const Folder folder;
  {
    Observers observers(settings, folder.path);
    m.step = 1;
    observers.record(m, 0);
    m.step = 2;
    observers.record(m, 0);
    observers.snapshot(m, 7);
  }
  const Table ball = read_table(folder.path / "ball_0.csv"), fabric = read_table(folder.path / "fabric.csv");
  REQUIRE(ball.at("step") == std::vector<double>{2});
  CHECK(ball.at("room")[0] == 1);
  CHECK(ball.at("bodies")[0] == 8);
  CHECK(ball.at("coordination")[0] == 6);
  CHECK(ball.at("fabric deviator")[0] == Approx(0).margin(1e-12));
  CHECK(ball.at("stress xx [Pa]")[0] == Approx(ball.at("stress zz [Pa]")[0]));
  // 64 spheres in a 4 x 4 x 4 block: 3 x 48 pairs.
  CHECK(fabric.at("coordination")[0] == Approx(2.0 * 144 / 64));
  CHECK(fabric.at("contacts")[0] == 144);
  CHECK(read_table(folder.path / "forces.csv").at("strong contacts")[0] < 1);
  CHECK(read_table(folder.path / "coordination_0007.csv").at("bodies") == std::vector<double>{0, 0, 0, 8, 24, 24, 8});
  CHECK(std::filesystem::exists(folder.path / "grid_0_0007.vtu"));
  CHECK(std::filesystem::exists(folder.path / "mobilisation_0007.csv"));

  // Each cell of the grid holds one period.
  const CellGrid grid(*settings.measure.grids[0].box, 0.1);
  const ContactSurvey seen = survey(m);
  const auto solid = solid_shares(m.particles, seen.between_grains(), grid, 0.01, room_of(m, settings));
  StressField field(grid);
  for (const ContactView& c : seen.contacts) field.add(c, m.particles);
  const double exact = 1 - (4.0 / 3.0 * pi * std::pow(radius, 3) - 3 * shared_volume(radius, radius, overlap)) / 1e-3;
  for (std::size_t cell = 0; cell < grid.size(); ++cell) {
    CHECK(solid[cell].porosity() == Approx(exact).epsilon(1e-9));
    CHECK(field.stress(cell)[1] == Approx(stress).epsilon(1e-9));
  }
}

TEST_CASE("a survey of some bodies has those contacts of the whole one that touch them, in its order") {
  Model m = lattice(0.001);
  m.walls = Walls(std::vector<PlaneSettings>{{Vec3(0, 0, -0.05), Vec3::UnitZ(), Vec3::Zero()}}, 0);
  evaluate_forces(m);
  std::vector<char> is_wanted(m.particles.body_count(), 0);
  for (const std::size_t b : {0, 21, 63}) is_wanted[b] = 1;
  const auto is_one = [&](std::int32_t body) { return body >= 0 && is_wanted[static_cast<std::size_t>(body)]; };
  const ContactSurvey some = survey(m, is_wanted);
  std::size_t found = 0;
  for (const ContactView& c : survey(m).contacts) {
    if (!is_one(c.body_a) && !is_one(c.body_b)) continue;
    REQUIRE(found < some.contacts.size());
    const ContactView& same = some.contacts[found++];
    CHECK((same.body_a == c.body_a && same.body_b == c.body_b && same.force_on_a == c.force_on_a));
  }
  // Corners have three partners each, the inner grain six, and the lower corner stands on the wall.
  CHECK(found == 3 + 6 + 3 + 1);
  CHECK(some.contacts.size() == found);
  CHECK(some.grain_pairs == found - 1);
}

TEST_CASE("a tracked grain is the nearest or the numbered one, and its way, turn and force are told") {
  // Two spheres and a clump in free flight with a constant spin about a principal axis: x = v t, turn = w t.
  Model m(0.002);
  m.particles.add(make_clump(1, 1), 0.05, 2650, Vec3(0, 0, 0), Quat::Identity());
  m.particles.add(make_clump(1, 1), 0.05, 2650, Vec3(1, 0, 0), Quat::Identity());
  m.particles.add(make_clump(3, 1.5), 0.05, 2650, Vec3(2, 0, 0), Quat(Eigen::AngleAxisd(0.3, Vec3::UnitX())));
  const Vec3 velocity(0.1, -0.2, 0.3), spin(2, 0, 0);
  for (std::size_t b = 0; b < 3; ++b) m.particles.velocity(b) = velocity, m.particles.spin(b) = spin;
  for (std::size_t b = 0; b < 3; ++b) m.particles.set_orientation(b, m.particles.orientation(b));
  const Settings settings =
      settings_of("tracked { near { x: 0.9 } } tracked { grain: 2 } tracked { near { x: 1.1 z: 0.3 } }");
  const Folder folder;
  const double dt = 1e-3;
  constexpr int steps = 1000;
  {
    Observers observers(settings, folder.path);
    observers.snapshot(m, 0);  // the start
    Held held(dt);
    for (int n = 0; n < steps; ++n) cycle(m, held), observers.record(m, 0);
  }
  for (int n = 0; n < 2; ++n) {
    const Table way = read_table(folder.path / fmt::format("tracked_{}.csv", n));
    REQUIRE(way.at("step").size() == steps);
    CHECK(way.at("grain")[0] == n + 1);
    const double moved = way.at("displacement z [m]").back() - velocity.z() * steps * dt;
    const double turned = way.at("rotation x [rad]").back() - spin.x() * steps * dt;
    CAPTURE(n, moved, turned);
    CHECK(std::abs(moved) < 1e-12);
    // A clump's turn is the integrator's, of second order: about (w dt)^2 / 12 of the angle of 2 rad.
    CHECK(std::abs(turned) < (n == 0 ? 1e-9 : 1e-6));
    CHECK(way.at("contact force sum [N]").back() == 0);
    CHECK(way.at("partners").back() == 0);
  }
  CHECK(read_table(folder.path / "tracked_2.csv").at("grain")[0] == 1);
}

TEST_CASE("a tracked grain's contact force is the force that moves it") {
  Model m = lattice(0.001);
  m.particles.position(0) += Vec3(0.0003, 0.0002, 0);
  evaluate_forces(m);
  const Settings settings = settings_of("tracked { grain: 0 }");
  const Folder folder;
  {
    Observers observers(settings, folder.path);
    observers.record(m, 0);
  }
  const Table way = read_table(folder.path / "tracked_0.csv");
  const Vec3 force = std::as_const(m.particles).force(0);
  CHECK(way.at("partners")[0] == 3);
  CHECK(way.at("contact force x [N]")[0] == Approx(force.x()));
  CHECK(way.at("contact force z [N]")[0] == Approx(force.z()));
  CHECK(force.norm() > 1);
}

TEST_CASE("the energies by kind in the history sum up to the ledger's") {
  // Spheres that meet off centre, with friction: spin and shear springs are both there.
  Model m(0.002);
  m.particles.add(make_clump(1, 1), 0.05, 2650, Vec3(0, 0, 0), Quat::Identity());
  m.particles.add(make_clump(3, 1.5), 0.05, 2650, Vec3(0.13, 0.03, 0.01), Quat::Identity());
  m.particles.velocity(0) = Vec3(3, 0, 0);
  const Settings settings = settings_of("energy_by_kind: true");
  const Folder folder;
  {
    Output output(settings, folder.path);
    Held held(2e-6);
    for (int n = 0; n < 6000; ++n) cycle(m, held), output.record(m, 0, 0);
  }
  const Table h = read_table(folder.path / "dem_history.csv");
  double kinetic = 0, elastic = 0, turning = 0, shear = 0;
  for (std::size_t n = 0; n < h.at("step").size(); ++n) {
    kinetic = std::max(kinetic, std::abs(h.at("kinetic translational [J]")[n] + h.at("kinetic rotational [J]")[n] -
                                         h.at("kinetic [J]")[n]));
    elastic = std::max(elastic,
                       std::abs(h.at("elastic normal [J]")[n] + h.at("elastic shear [J]")[n] - h.at("elastic [J]")[n]));
    turning = std::max(turning, h.at("kinetic rotational [J]")[n]);
    shear = std::max(shear, h.at("elastic shear [J]")[n]);
  }
  const double scale = h.at("kinetic [J]")[0];
  CAPTURE(kinetic, elastic, turning, shear, scale);
  CHECK(kinetic < 1e-14 * scale);
  CHECK(elastic < 1e-12 * scale);
  CHECK(turning > 1e-3 * scale);
  CHECK(shear > 1e-4 * scale);
  CHECK(read_table(folder.path / "dem_history.csv").count("elastic shear [J]") == 1);
}

TEST_CASE("nothing is measured unless the scene asks") {
  Model m = lattice(0.001);
  const Settings settings =
      make_settings(parse_scene("grains { pebbles: 1 grain { } } measure { interval: 5 }", "test"));
  CHECK_FALSE(settings.measure.is_any());
  const Folder folder;
  {
    Output output(settings, folder.path);
    for (int n = 0; n < 40; ++n) output.record(m, 0, 0);
    output.snapshot(m, settings);
    CHECK(output.measuring_seconds() == 0);
  }
  const Table h = read_table(folder.path / "dem_history.csv");
  CHECK(h.count("kinetic [J]") == 1);
  CHECK(h.count("elastic shear [J]") == 0);
  CHECK_FALSE(std::filesystem::exists(folder.path / "fabric.csv"));
}

TEST_CASE("measurements that make no sense are refused with key and remedy") {
  using Catch::Matchers::Contains;
  CHECK_THROWS_WITH(settings_of("ball { follows_pile: true }"),
                    Contains("measure.ball[0].follows_pile") && Contains("no pile"));
  CHECK_THROWS_WITH(settings_of("grid { low { x: 1 } }"), Contains("measure.grid[0]") && Contains("give both"));
  CHECK_THROWS_WITH(settings_of("grid { low { x: 1 y: 0 z: 0 } high { x: 1 y: 1 z: 1 } }"),
                    Contains("high.x = 1") && Contains("low.x = 1"));
  CHECK_THROWS_WITH(settings_of("tracked { }"), Contains("measure.tracked[0]") && Contains("near"));
  CHECK_THROWS_WITH(settings_of("interval: 0"), Contains("measure.interval = 0 is out of range"));
  Model m = lattice(0);
  const Settings settings = settings_of("tracked { grain: 64 }");
  CHECK_THROWS_WITH(find_tracked(settings.measure.tracked[0], m.particles),
                    Contains("measure.tracked[0].grain = 64") && Contains("[0, 63]"));
  const Settings huge = settings_of("grid { cell: 0.2 low { } high { x: 1e6 y: 1 z: 1 } }");
  const Folder folder;
  Observers observers(huge, folder.path);
  CHECK_THROWS_WITH(observers.snapshot(m, 0), Contains("measure.grid[0]") && Contains("larger cells"));
}
