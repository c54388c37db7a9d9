// Balanced packings in files: what is read is what was written, to the last bit and for the future too; what is damaged
// or does not fit is refused in words.
#include <unistd.h>

#include <catch2/catch.hpp>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/packing_file.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

namespace fs = std::filesystem;

// A folder of its own for one test.
struct Folder {
  fs::path path;
  Folder() : path(fs::temp_directory_path() / fmt::format("lockstep_packing_{}", ::getpid())) {
    fs::remove_all(path);
    fs::create_directories(path);
  }
  ~Folder() { fs::remove_all(path); }
};

constexpr double radius = 0.03;  // mean [m]

// A bowl for some grains: a floor of four facets, two rough planes one of which moves, and a pile in the middle.
Model make_world() {
  Model m(0.05 * radius);
  const double half = 0.25;
  Vec3s nodes;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) nodes.emplace_back(half * (i - 1), half * (j - 1), 0);
  m.facets = InterfaceFacets(nodes, {{0, 1, 4, 3}, {1, 2, 5, 4}, {3, 4, 7, 6}, {4, 5, 8, 7}}, 0);
  m.facet_material.friction = 0.4;
  m.walls =
      Walls({{{-half, 0, 0}, Vec3::UnitX(), Vec3::Zero()}, {{half, 0, 0}, -Vec3::UnitX(), Vec3(0, 0.01, 0)}}, 0.3);
  m.pile.emplace(PileShape{0.05, PileTip::Flat, pi / 3}, 0.1, 0.5);
  m.material.friction = 0.5;
  m.gravity = {0, 0, -200};  // settles in a few hundred steps [m/s2]
  m.damping = 0.3;
  return m;
}

// Clumps, and a sphere among them, that have fallen for some time: springs of every kind are there.
Model make_heap() {
  Model m = make_world();
  const ClumpTemplate clump = make_clump(4, 1.5), sphere = make_clump(1, 1);
  Random random(3);
  for (int k = 0; k < 4; ++k)
    for (int j = 0; j < 7; ++j)
      for (int i = 0; i < 7; ++i)
        if (i != 3 || j != 3)
          m.particles.add((i + j + k) % 5 ? clump : sphere, radius * random.uniform(0.9, 1.1), 2650,
                          {0.068 * (i - 3), 0.068 * (j - 3), 0.04 + 0.075 * k}, random.rotation());
  Vec3s offsets;  // as a servo leaves them
  for (std::size_t k = 0; k < m.facets.node_count(); ++k) offsets.emplace_back(0, 0, 1e-4 * static_cast<double>(k));
  m.facets.set_offsets(offsets);
  Held held(5e-5);
  evaluate_forces(m);
  for (int n = 0; n < 1500 || (n < 4000 && m.pile->contacts().empty()); ++n) cycle(m, held);
  return m;
}

BalancedPacking packing_of(const Model& m) {
  BalancedPacking packing;
  packing.keys = {{"seed", "1"}, {"gravity", "9.81"}, {"grains.friction", "0.7"}};
  packing.ground.nodes = m.facets.positions();
  for (std::size_t f = 0; f < m.facets.facet_count(); ++f) packing.ground.facets.push_back(m.facets.nodes_of(f));
  packing.ground.ring = {-1, -1, 0, 1};
  packing.ground.traction = Vec3s(4, Vec3(0, 0, -1000));
  packing.ground.bulk_density = 1630;
  packing.ground.tip_target = 16e3;
  packing.assembly.mean_radius = radius;
  packing.assembly.preparation_friction = 0.123;
  packing.figures.cycles = 1500;
  packing.figures.has_servo = true;
  packing.figures.rings.resize(2);
  packing.figures.rings[1].facets = {3};
  packing.figures.rings[1].pressure = 1234.5;
  packing.figures.rings[1].is_at_end = true;
  packing.state = state_of(m);
  return packing;
}

std::string bytes_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void put_bytes(const fs::path& path, const std::string& bytes) { std::ofstream(path, std::ios::binary) << bytes; }

std::string complaint_of(const fs::path& path, ExitCode& code) {
  try {
    read_packing(path);
  } catch (const Error& error) {
    code = error.code();
    return error.what();
  }
  return "";
}

}  // namespace

TEST_CASE("a packing that was written and read has the same state and the same future, bit for bit") {
  const Folder folder;
  const fs::path path = folder.path / "heap.packing";
  Model one = make_heap();
  // What is compared must be there.
  REQUIRE(one.contacts.springs().size() > 50);
  REQUIRE(one.facets.contact_count() > 10);
  REQUIRE(one.walls.contacts().size() > 0);
  REQUIRE(one.pile->contacts().size() > 0);
  const BalancedPacking written = packing_of(one);
  write_packing(path, written);

  const BalancedPacking read = read_packing(path);
  CHECK(read.keys == written.keys);
  CHECK(read.ground.nodes == written.ground.nodes);
  CHECK(read.ground.facets == written.ground.facets);
  CHECK(read.ground.ring == written.ground.ring);
  CHECK(read.ground.traction == written.ground.traction);
  CHECK(read.ground.tip_target == 16e3);
  CHECK(read.assembly.preparation_friction == 0.123);
  CHECK(read.figures.cycles == 1500);
  REQUIRE(read.figures.rings.size() == 2);
  CHECK(read.figures.rings[1].facets == std::vector<std::int32_t>{3});
  CHECK(read.figures.rings[1].pressure == 1234.5);
  CHECK(read.figures.rings[1].is_at_end);

  for (const int threads : {1, 2}) {
    Model two = make_world();
    two.team = std::make_unique<Team>(threads);
    restore(two, read.state);
    two.pile->set_velocity(one.pile->velocity());
    Model reference = make_world();
    restore(reference, written.state);  // from memory: the file has added nothing
    CAPTURE(threads);
    CHECK(two.hash() == one.hash());
    // The run that goes on against the runs that begin with the file.
    evaluate_forces(two), evaluate_forces(reference);
    two.last_time_step = reference.last_time_step = one.last_time_step;
    Held held(5e-5);
    for (int n = 0; n < 300; ++n) cycle(two, held), cycle(reference, held);
    CHECK(two.hash() == reference.hash());
    CHECK(two.hash() != one.hash());  // they have moved
  }
}

TEST_CASE("the run that wrote a packing goes on as the run that reads it") {
  const Folder folder;
  Model one = make_heap();
  write_packing(folder.path / "heap.packing", packing_of(one));
  Model two = make_world();
  restore(two, read_packing(folder.path / "heap.packing").state);
  for (Model* m : {&one, &two}) {
    evaluate_forces(*m);
    m->step = 0, m->time = 0, m->last_time_step = 0;
  }
  Held held(5e-5);
  for (int n = 0; n < 300; ++n) cycle(one, held), cycle(two, held);
  CHECK(one.hash() == two.hash());
}

TEST_CASE("spheres alone are read as spheres alone") {
  const Folder folder;
  Model one = make_world();
  for (int k = 0; k < 20; ++k)
    one.particles.add(make_clump(1, 1), radius, 2650, {0.06 * (k % 4) - 0.1, 0.1, 0.03 + 0.06 * (k / 4)},
                      Quat::Identity());
  one.is_fixed.assign(20, 0), one.is_fixed[7] = 1;
  write_packing(folder.path / "spheres.packing", packing_of(one));
  const PackingState state = read_packing(folder.path / "spheres.packing").state;
  CHECK(!state.particles.has_clumps());
  CHECK(state.is_fixed == one.is_fixed);
  Model two = make_world();
  restore(two, state);
  CHECK(two.hash() == one.hash());
}

TEST_CASE("a packing that is cut off, damaged, foreign or of another version is refused in words") {
  const Folder folder;
  const fs::path path = folder.path / "heap.packing";
  const Model heap = make_heap();
  write_packing(path, packing_of(heap));
  const std::string whole = bytes_of(path);
  ExitCode code = ExitCode::Success;
  const auto complaint = [&](const std::string& bytes) {
    put_bytes(path, bytes);
    std::string text = complaint_of(path, code);
    CHECK_THAT(text, Catch::Contains(path.string()));
    return text;
  };

  for (const std::size_t length :
       {std::size_t{5}, std::size_t{20}, std::size_t{32}, whole.size() / 2, whole.size() - 1}) {
    CAPTURE(length, whole.size());
    CHECK_THAT(complaint(whole.substr(0, length)), Catch::Contains("cut off"));
    CHECK(code == ExitCode::Io);
  }
  CHECK_THAT(complaint(whole + "x"), Catch::Contains("added to"));
  for (const std::size_t at : {std::size_t{40}, whole.size() / 3, whole.size() - 1}) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ 4);
    CAPTURE(at);
    CHECK_THAT(complaint(damaged), Catch::Contains("damaged"));
    CHECK(code == ExitCode::Io);
  }
  CHECK_THAT(complaint("grains { }\n"), Catch::Contains("no packing"));
  CHECK(code == ExitCode::Input);
  CHECK_THAT(complaint(""), Catch::Contains("no packing"));
  std::string newer = whole;
  newer[8] = 77;
  CHECK_THAT(complaint(newer), Catch::Contains("version 77") && Catch::Contains("remove"));
  CHECK(code == ExitCode::Input);

  CHECK_THAT(complaint_of(folder.path, code), Catch::Contains("directory"));
  CHECK(code == ExitCode::Io);
  CHECK_THAT(complaint_of(folder.path / "none", code), Catch::Contains("No such file"));
  CHECK(code == ExitCode::Io);
}

TEST_CASE("a path without a file yet promises nothing but that one can be written") {
  const Folder folder;
  CHECK(!open_packing(folder.path / "new.packing", {}).has_value());
  CHECK(fs::is_empty(folder.path));
  put_bytes(folder.path / "a_file", "x");
  CHECK_THROWS_AS(open_packing(folder.path / "a_file" / "new.packing", {}), IoError);
}

TEST_CASE("the first thing in which packing and scene differ is named with both values and a remedy") {
  const fs::path path = "p";
  const SceneKeys keys = {{"seed", "1"}, {"grains.friction", "0.7"}, {"pile.diameter", "0.25"}};
  const auto complaint = [&](const SceneKeys& packing, const SceneKeys& scene) -> std::string {
    try {
      check_fits(packing, scene, path);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  CHECK(complaint(keys, keys).empty());
  SceneKeys other = keys;
  other[1].second = "0.6", other[2].second = "0.3";
  CHECK_THAT(complaint(keys, other), Catch::Contains("grains.friction is 0.7 there and 0.6 here") &&
                                         Catch::Contains("--packing") && !Catch::Contains("diameter"));
  const SceneKeys without(keys.begin(), keys.end() - 1);
  CHECK_THAT(complaint(keys, without), Catch::Contains("pile.diameter is 0.25 there and not here"));
  CHECK_THAT(complaint(without, keys), Catch::Contains("pile.diameter is not there and 0.25 here"));
  SceneKeys with_wall = keys;
  with_wall.insert(with_wall.begin() + 1, {"wall[0].plane.point.x", "2"});
  CHECK_THAT(complaint(keys, with_wall), Catch::Contains("wall[0].plane.point.x is not there and 2 here"));
  CHECK_THAT(complaint(with_wall, keys), Catch::Contains("wall[0].plane.point.x is 2 there and not here"));
}

TEST_CASE("another interface or another stress of the ground is named") {
  const HandedOver mine = packing_of(make_world()).ground;
  const auto complaint = [&](auto&& change) -> std::string {
    HandedOver other = mine;
    change(other);
    try {
      check_fits(mine, other, "p");
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  CHECK(complaint([](HandedOver&) {}).empty());
  // The ground's solver stops near the same stress, not at the same bits.
  CHECK(complaint([](HandedOver& g) { g.traction[2] *= 1 + 1e-5; }).empty());
  CHECK_THAT(complaint([](HandedOver& g) { g.traction[2] *= 1.01; }),
             Catch::Contains("facet 2") && Catch::Contains("-1000") && Catch::Contains("-1010"));
  CHECK_THAT(complaint([](HandedOver& g) { g.nodes[4].z() = 1e-9; }),
             Catch::Contains("node 4") && Catch::Contains("1e-09"));
  CHECK_THAT(complaint([](HandedOver& g) { g.nodes.pop_back(); }), Catch::Contains("9 there and 8 here"));
  CHECK_THAT(complaint([](HandedOver& g) { g.ring[3] = 5; }),
             Catch::Contains("ring") && Catch::Contains("1 there and 5"));
  CHECK_THAT(complaint([](HandedOver& g) { std::swap(g.facets[1][0], g.facets[1][1]); }), Catch::Contains("facet 1"));
  CHECK_THAT(complaint([](HandedOver& g) { g.bulk_density = 1700; }),
             Catch::Contains("1630 there") && Catch::Contains("1700 here"));
  CHECK_THAT(complaint([](HandedOver& g) { g.tip_target = 17e3; }), Catch::Contains("16000"));
}
