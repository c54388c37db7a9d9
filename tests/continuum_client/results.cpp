// What is written of the ground: strain, reactions and unbalanced forces, points, sections and lines.
#include <catch2/catch.hpp>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>
#include <sstream>
#include <thread>

#include "common/interrupt.hpp"
#include "continuum_client/cycle.hpp"
#include "continuum_client/observers.hpp"
#include "continuum_client/section.hpp"
#include "continuum_client/settings.hpp"
#include "continuum_client/stages.hpp"
#include "continuum_client/zone_map.hpp"
#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

using Catch::Matchers::Contains;

// A displacement of one strain and one rotation: u = a + H x.
struct LinearField {
  Vec3 shift = Vec3(3, -2, 1) * 1e-4;  // of the strain's size: what cancels in a zone costs no digits
  Mat3 gradient = (Mat3() << 1, -4, 2, 3, -2, 5, -1, 2, 3).finished() * 1e-4;

  Vec3 at(const Vec3& x) const { return shift + gradient * x; }
  Vec3s on(const Grid& grid) const {
    Vec3s u;
    for (const Vec3& x : grid.node) u.push_back(at(x));
    return u;
  }
  Mat3 strain() const { return 0.5 * (gradient + gradient.transpose()); }
};

// A block whose zones are no two alike; its outer faces stay plane.
Grid distorted_inside(int n, ZoneKind kind = ZoneKind::MixedDiscretization) {
  Grid grid = brick(2, 2, 2, n, n, n, test_material, kind);
  Grid moved = grid;
  distort(moved, 2.0 / n, 0.15);
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    for (int c = 0; c < 3; ++c)
      if (grid.node[i][c] > grid.low[c] + 1e-9 && grid.node[i][c] < grid.high[c] - 1e-9)
        grid.node[i][c] = moved.node[i][c];
  return grid;
}

Vec3 area_vector(const Section& s, const Vec3s& x, std::size_t polygon) {
  const auto& p = s.polygon[polygon];
  Vec3 sum = Vec3::Zero();
  for (std::size_t k = 1; k + 1 < p.size(); ++k) sum += 0.5 * (x[p[k]] - x[p[0]]).cross(x[p[k + 1]] - x[p[0]]);
  return sum;
}

struct Cut {
  Section section;
  Vec3s position;
  double area = 0;         // sum of the polygons' areas [m2]
  double least_along = 1;  // of a polygon's area along the normal, over its area [-]

  Cut(const Grid& grid, const std::vector<char>& is_left, const Vec3& point, const Vec3& normal)
      : section(cut_zones(grid, is_left, point, normal)) {
    for (const CutPoint& p : section.point) position.push_back(p.interpolate(grid.node));
    for (std::size_t k = 0; k < section.polygon.size(); ++k) {
      const Vec3 a = area_vector(section, position, k);
      area += a.norm();
      least_along = std::min(least_along, a.dot(normal.normalized()) / a.norm());
    }
  }
  // Edges that belong to one polygon alone, by length: the outline of what is cut [m].
  double outline() const {
    std::map<std::pair<std::int32_t, std::int32_t>, int> owners;
    for (const auto& p : section.polygon)
      for (std::size_t k = 0; k < p.size(); ++k) ++owners[std::minmax(p[k], p[(k + 1) % p.size()])];
    double length = 0;
    for (const auto& [edge, count] : owners) {
      CHECK(count <= 2);
      if (count == 1) length += (position[edge.first] - position[edge.second]).norm();
    }
    return length;
  }
};

// The ground of a block under gravity at rest, all forces of its step in place, one step gone.
struct Rest {
  CoupledGround ground;
  InitialState initial;
  double weight = 0, load = 0;  // [N]

  explicit Rest(ZoneKind kind, Supports supports = Supports::Rollers) {
    ground.grid = distorted_inside(4, kind);
    const Grid& grid = ground.grid;
    const StiffnessMatrix k = assemble_stiffness(grid);
    const std::vector<double> mass = lumped_masses(grid);
    const Vec3s is_free = free_components(grid, supports, mass);
    ground.gravity = Vec3(0, 0, -9.81);
    reach_equilibrium(k, mass, is_free, ground.gravity, {0.7, 1e-8, 1000, 0.9}, initial.displacement, {});
    ground.internal_force = InternalForce(k);
    k.multiply(initial.displacement, ground.internal_force.reference);
    ground.integrator = Integrator(mass, is_free);
    ground.interface = interface_surface(grid);
    const std::size_t count = grid.node_count();
    ground.load_force = {loaded_nodes(grid, {Vec3(-1, -1, 0), Vec3(1, 1, 0), Vec3(0, 0, -1e5), 0, 0, "test"}, {})};
    ground.loads.resize(1);
    ground.incoming.force.assign(ground.interface.node_count(), Vec3::Zero());
    ground.baseline.force = ground.incoming.force;
    ground.motion = {Vec3s(count, Vec3::Zero()), Vec3s(count, Vec3::Zero())};
    ground.internal.resize(count);
    solve_static(k, is_free, ground.load_force[0], ground.motion.displacement, {});
    ground.velocity_limit = 1e9;
    const double dt = 0.5 * stable_step(frequency_squared_bound(k, mass, is_free), 0);
    ground.step_sizes = {dt, dt};
    ground.time = 1;  // the load is there
    for (const double m : mass) weight += 9.81 * m;
    load = 1e5 * 4;
  }
  void step() {
    ground.compute_internal_forces();
    ground.load_surface();
    ground.advance();
  }
};

std::vector<std::vector<double>> numbers_of(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  std::vector<std::vector<double>> rows;
  while (std::getline(file, line)) {
    rows.emplace_back();
    std::stringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) rows.back().push_back(std::stod(cell));
  }
  return rows;
}

struct Folder {
  std::filesystem::path path =
      std::filesystem::temp_directory_path() / ("lockstep_results_" + std::to_string(std::random_device{}()));
  ~Folder() { std::filesystem::remove_all(path); }
  std::size_t count(const std::string& prefix) const {
    std::size_t n = 0;
    for (const auto& entry : std::filesystem::directory_iterator(path))
      n += entry.path().filename().string().starts_with(prefix);
    return n;
  }
};

}  // namespace

TEST_CASE("a uniform strain comes back from distorted zones, and the law of it is their stress") {
  // Every kind of zone takes linear fields exactly: e = sym H in each, and sigma = sigma0 + law(e) with the mean volume
  // change of the zone, since tr e is the same at all its points.
  const LinearField field;
  for (const ZoneKind kind : zone_kinds) {
    CoupledGround ground;
    ground.grid = distorted_inside(4, kind);
    ground.motion.displacement = field.on(ground.grid);
    InitialState initial(Vec3s(ground.grid.node_count(), Vec3::Zero()));
    initial.stress.assign(ground.grid.zone_count(), Vec3(-1e3, -2e3, -3e3).asDiagonal());
    double error = 0, of_law = 0;
    for (std::size_t z = 0; z < ground.grid.zone_count(); ++z) {
      const Mat3 e = ground.zone_strain(z), s = ground.zone_stress(initial, z);
      error = std::max(error, (e - field.strain()).norm() / field.strain().norm());
      of_law = std::max(of_law, (s - initial.stress[z] - elastic_stress(test_moduli, e, e.trace())).norm() / s.norm());
    }
    INFO("kind " << static_cast<int>(kind) << ": strain " << error << ", stress less law of strain " << of_law);
    CHECK(error < 1e-13);
    CHECK(of_law < 1e-14);
  }
}

TEST_CASE("stress is the law of the strain written beside it for any displacement, initial stress apart") {
  // Both are means over the same points, and the law is linear: sum V (2 G dev e + K theta I) / V with theta the mean of its
  // group. Displacements are random, the initial stress is that of gravity.
  for (const ZoneKind kind : zone_kinds) {
    Rest rest(kind);
    Random random(5);
    for (Vec3& u : rest.ground.motion.displacement)
      for (int c = 0; c < 3; ++c) u[c] = 1e-3 * random.uniform(-1, 1);
    double error = 0, scale = 0;
    for (std::size_t z = 0; z < rest.ground.grid.zone_count(); ++z) {
      const Mat3 e = rest.ground.zone_strain(z), s = rest.ground.zone_stress(rest.initial, z);
      const Mat3 expected = rest.initial.zone_stress(rest.ground.grid, z) + elastic_stress(test_moduli, e, e.trace());
      error = std::max(error, (s - expected).norm()), scale = std::max(scale, s.norm());
    }
    INFO("kind " << static_cast<int>(kind) << ": " << error / scale);
    CHECK(error / scale < 1e-14);
  }
}

TEST_CASE("the incremental route adds up the strain of its stress") {
  // Small strain: the same number as B u. Large strain, a block stretched to 1.5 along x with its sides held: increments
  // 2 (l' - l) / (l' + l) add up to the logarithmic strain ln 1.5, to second order in the step.
  const LinearField field;
  for (const ZoneKind kind : zone_kinds) {
    Grid grid = distorted_inside(3, kind);
    const InitialState initial(Vec3s(grid.node_count(), Vec3::Zero()));
    const Vec3s last = field.on(grid);
    IncrementalForce force(grid, {}, initial, false);
    force.keep_strain();
    Vec3s u(grid.node_count(), Vec3::Zero()), v(grid.node_count()), f(grid.node_count());
    for (std::size_t i = 0; i < u.size(); ++i) v[i] = last[i] / 10;
    for (int n = 1; n <= 10; ++n) {
      for (std::size_t i = 0; i < u.size(); ++i) u[i] += v[i];
      force.advance(u, v, 1, f);
    }
    double error = 0;
    for (std::size_t z = 0; z < grid.zone_count(); ++z)
      error = std::max(error, (force.zone_strain(z) - field.strain()).norm() / field.strain().norm());
    std::vector<double> large;
    for (const int steps : {20, 40, 80}) {
      IncrementalForce stretched(grid, {}, initial, true);
      stretched.keep_strain();
      std::fill(u.begin(), u.end(), Vec3::Zero());
      for (int n = 1; n <= steps; ++n) {
        for (std::size_t i = 0; i < u.size(); ++i) {
          const Vec3 now(0.5 * n / steps * grid.node[i].x(), 0, 0);
          v[i] = now - u[i], u[i] = now;
        }
        stretched.advance(u, v, 1, f);
      }
      const Mat3 expected = Vec3(std::log(1.5), 0, 0).asDiagonal();
      large.push_back((stretched.zone_strain(5) - expected).norm());
    }
    INFO("kind " << static_cast<int>(kind) << ": small strain " << error << "; large " << large[0] << " " << large[1]
                 << " " << large[2]);
    CHECK(error < 1e-12);
    CHECK(large[2] < 1e-5);
    CHECK(std::log2(large[0] / large[1]) > 1.9);
    CHECK(std::log2(large[1] / large[2]) > 1.9);
  }
  // Simple shear x += g y: as the stress of the test beside it, e_xy = sin(g) / 2 and e_xx = (1 - cos g) / 2.
  Grid grid = brick(1, 1, 1, 2, 2, 2);
  IncrementalForce force(grid, {}, InitialState(Vec3s(grid.node_count(), Vec3::Zero())), true);
  force.keep_strain();
  Vec3s u(grid.node_count(), Vec3::Zero()), v(grid.node_count()), f(grid.node_count());
  for (int n = 1; n <= 400; ++n) {
    for (std::size_t i = 0; i < u.size(); ++i) {
      const Vec3 now(n / 400.0 * grid.node[i].y(), 0, 0);
      v[i] = now - u[i], u[i] = now;
    }
    force.advance(u, v, 1, f);
  }
  const Mat3 e = force.zone_strain(0);
  INFO("simple shear: e_xy " << e(0, 1) << " against " << 0.5 * std::sin(1.0) << ", e_xx " << e(0, 0) << " against "
                             << 0.5 * (1 - std::cos(1.0)));
  CHECK(e(0, 1) == Approx(0.5 * std::sin(1.0)).epsilon(1e-5));
  CHECK(e(0, 0) == Approx(0.5 * (1 - std::cos(1.0))).epsilon(1e-5));
}

TEST_CASE("supports carry the weight and the load of a ground at rest") {
  for (const ZoneKind kind : zone_kinds) {
    Rest rest(kind);
    rest.step();
    Vec3 sum = Vec3::Zero();
    double sideways = 0, at_free = 0;
    for (std::size_t i = 0; i < rest.ground.grid.node_count(); ++i) {
      const Vec3 r = rest.ground.support_force(i);
      sum += r;
      sideways += r.head<2>().norm();
      at_free = std::max(at_free, r.cwiseProduct(rest.ground.integrator.is_free()[i]).norm());
    }
    const double all = rest.weight + rest.load, error = (sum - Vec3(0, 0, all)).norm() / all;
    INFO("kind " << static_cast<int>(kind) << ": sum of reactions over weight and load, less 1: " << error
                 << "; sideways " << sideways / all);
    CHECK(error < 1e-12);
    // Each side of a column of earth is pressed with K0 times the mean vertical stress.
    CHECK(sideways > 0.5 * all);
    CHECK(at_free == 0);
  }
}

TEST_CASE("supports that are taken away count with the reactions that are kept") {
  Rest rest(ZoneKind::MixedDiscretization);
  CoupledGround& g = rest.ground;
  const std::vector<double>& mass = g.integrator.mass();
  const Vec3s before = g.integrator.is_free(), after = free_components(g.grid, Supports::Quiet, mass);
  g.kept_reaction = released_reactions(before, after, g.internal_force.reference, weights(mass, 9.81));
  g.reaction_load = g.kept_reaction;
  g.integrator = Integrator(mass, after);
  g.loads.clear();
  g.internal = g.internal_force.reference;
  Vec3 sum = Vec3::Zero();
  double unbalanced = 0;
  for (std::size_t i = 0; i < g.grid.node_count(); ++i) {
    sum += g.support_force(i);
    unbalanced += g.unbalanced_force(i).norm();
  }
  INFO("sum over weight, less 1: " << sum.z() / rest.weight - 1 << ", unbalanced " << unbalanced / rest.weight);
  CHECK((sum - Vec3(0, 0, rest.weight)).norm() / rest.weight < 1e-12);
  CHECK(unbalanced / rest.weight < 1e-10);
}

TEST_CASE("the field of unbalanced force is the one that the ratio is made of") {
  // Mean |F| over free directions by mean |f_int| is StepSums::unbalanced_ratio(), with contacts, baseline, load and
  // stiffness damping in place. The sums differ by their order.
  for (const ZoneKind kind : zone_kinds) {
    Rest rest(kind);
    CoupledGround& g = rest.ground;
    g.interface.node = {7, 20, 31, 60};
    g.interface.position.assign(4, Vec3::Zero());
    g.incoming.force = {Vec3(1e3, 0, 0), Vec3(0, 2e3, 0), Vec3(0, 0, 3e3), Vec3(-4e3, 0, 0)};
    g.baseline.force = {Vec3(0, 1e3, 0), Vec3(2e3, 0, 0), Vec3(0, -3e3, 0), Vec3(0, 0, 4e3)};
    g.stiffness_damping = 1e-5;
    g.internal = g.last_internal = g.internal_force.reference;
    for (int n = 0; n < 3; ++n) rest.step();
    double unbalanced = 0, internal = 0;
    for (std::size_t i = 0; i < g.grid.node_count(); ++i)
      unbalanced += g.unbalanced_force(i).norm(), internal += g.internal[i].norm();
    const double ratio = g.sums.unbalanced_ratio(), error = unbalanced / internal / ratio - 1;
    INFO("kind " << static_cast<int>(kind) << ": ratio " << ratio << ", field's less 1: " << error);
    CHECK(ratio > 1e-3);
    CHECK(std::abs(error) < 1e-13);
  }
}

TEST_CASE("a linear field is met at any point of distorted zones, and each point in one zone") {
  const LinearField field;
  const Grid grid = distorted_inside(4);
  const Vec3s u = field.on(grid);
  Random random(8);
  double error = 0, back = 0;
  for (int n = 0; n < 2000; ++n) {
    // Every tenth on a face of the block, every tenth on a gridpoint.
    Vec3 x(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-2, 0));
    if (n % 10 == 1) x[n / 10 % 3] = grid.high[n / 10 % 3];
    if (n % 10 == 2) x = grid.node[static_cast<std::size_t>(n) % grid.node_count()];
    const std::optional<Place> place = find_place(grid, {}, x);
    REQUIRE(place);
    error = std::max(error, (place->interpolate(grid, u) - field.at(x)).norm() / field.at(x).norm());
    back = std::max(back, (place->interpolate(grid, grid.node) - x).norm());
    if (n % 10 == 2) CHECK(grid.node[place->nearest_node(grid)] == x);
  }
  INFO("field " << error << ", the point itself " << back << " m");
  CHECK(error < 1e-14);
  CHECK(back < 1e-14);
}

TEST_CASE("a section is the exact cross-section of the brick, cut once, and meets linear fields") {
  // Areas of the brick 2 x 2 x 2 m: y = const 4; through the space diagonal's middle and across it a regular hexagon of side
  // sqrt(2), area 3 sqrt(3); normal (1, 0, 1) through the middle a rectangle 2 x 2 sqrt(2). Zones inside are distorted, their
  // faces warped.
  const LinearField field;
  const struct {
    Vec3 point, normal;
    double area, outline;
  } planes[] = {{{0, 0.31, 0}, {0, 3, 0}, 4, 8},
                {{0, 0, -1}, {1, 1, 1}, 3 * std::sqrt(3.0), 6 * std::sqrt(2.0)},
                {{0, 0, -1}, {-1, -1, 1}, 3 * std::sqrt(3.0), 6 * std::sqrt(2.0)},
                {{0, 0, -1}, {1, 0, 1}, 4 * std::sqrt(2.0), 4 + 4 * std::sqrt(2.0)}};
  for (const auto& p : planes) {
    const Grid grid = distorted_inside(5);
    const Cut cut(grid, {}, p.point, p.normal);
    const Vec3s u = field.on(grid);
    double error = 0, off = 0;
    for (std::size_t k = 0; k < cut.position.size(); ++k) {
      const Vec3 exact = field.at(cut.position[k]);
      error = std::max(error, (cut.section.point[k].interpolate(u) - exact).norm() / exact.norm());
      off = std::max(off, std::abs((cut.position[k] - p.point).dot(p.normal.normalized())));
    }
    INFO("area " << cut.area / p.area - 1 << ", outline " << cut.outline() / p.outline - 1 << ", field " << error
                 << ", off the plane " << off << " m, " << cut.section.polygon.size() << " polygons");
    CHECK(cut.area == Approx(p.area).epsilon(1e-13));
    CHECK(cut.outline() == Approx(p.outline).epsilon(1e-13));
    CHECK(cut.least_along > 1 - 1e-9);
    CHECK(error < 1e-14);
    CHECK(off < 1e-14);
    CHECK(cut.section.zone.size() == cut.section.polygon.size());
  }
}

TEST_CASE("a plane along zone faces is cut once, at the ground's own faces too") {
  // 4 x 4 faces of 0.25 m2 each, from either side, at the top, in the middle, and at the bottom.
  const Grid grid = brick(2, 2, 2, 4, 4, 4);
  for (const double z : {0.0, -1.0, -2.0})
    for (const double side : {1.0, -1.0}) {
      const Cut cut(grid, {}, Vec3(0, 0, z), Vec3(0, 0, side));
      CAPTURE(z, side, cut.section.polygon.size(), cut.area);
      CHECK(cut.section.polygon.size() == 16);
      CHECK(cut.section.point.size() == 25);
      CHECK(cut.area == Approx(4).epsilon(1e-14));
      CHECK(cut.outline() == Approx(8).epsilon(1e-14));
      CHECK(cut.least_along > 1 - 1e-12);
    }
  // Along the diagonals of zones' faces: prisms, each face's diagonal 0.5 sqrt(2).
  const Cut diagonal(grid, {}, Vec3(0, 0, 0), Vec3(1, 1, 0));
  CHECK(diagonal.area == Approx(2 * 2 * std::sqrt(2.0)).epsilon(1e-14));
  CHECK(diagonal.outline() == Approx(4 + 4 * std::sqrt(2.0)).epsilon(1e-14));
  // One that only touches a corner cuts nothing.
  CHECK(cut_zones(grid, {}, Vec3(1, 1, 0), Vec3(1, 1, 1)).polygon.empty());
  CHECK(cut_zones(grid, {}, Vec3(1, 1, 0), Vec3(-1, -1, -1)).polygon.empty());
}

TEST_CASE("a section through the hole lacks the zones that are deleted") {
  // y = 0 goes through gridpoints of the polygon around the hole, 2 R apart: 3 x 4 m less 0.875 x 2.5 m. At z = -1 the hole
  // is a polygon of 16 sides, area 8 R^2 sin(pi/8).
  const Grid grid = small_cylinder();
  const CylinderMesh m = small_cylinder_mesh();
  const std::vector<char> is_left = zones_outside_discrete_domain(grid);
  const Vec3 y(0, 1, 0), z(0, 0, 1);
  const double upright = m.width * m.depth, level = m.width * m.width, r = m.hole_diameter / 2;
  const Cut whole(grid, {}, Vec3::Zero(), y), left(grid, is_left, Vec3::Zero(), y);
  const Cut whole_level(grid, {}, Vec3(0, 0, -1), z), left_level(grid, is_left, Vec3(0, 0, -1), z);
  INFO("upright " << whole.area / upright - 1 << " " << left.area / (upright - m.hole_diameter * m.hole_depth) - 1
                  << ", level " << whole_level.area / level - 1);
  CHECK(whole.area == Approx(upright).epsilon(1e-13));
  CHECK(left.area == Approx(upright - m.hole_diameter * m.hole_depth).epsilon(1e-13));
  CHECK(whole_level.area == Approx(level).epsilon(1e-13));
  CHECK(left_level.area == Approx(level - 8 * r * r * std::sin(pi / 8)).epsilon(1e-13));
}

TEST_CASE("places outside of the ground or in deleted zones are refused with the nearest that would do") {
  const Grid grid = small_cylinder();
  const std::vector<char> is_left = zones_outside_discrete_domain(grid);
  const auto error_of = [&](const std::string& keys) {
    try {
      const Settings s =
          read_settings(parse_scene("continuum { cylinder_in_brick { } results { " + keys + " } }", "test.txt"));
      Observers({}, s.results, grid, is_left);
    } catch (const InputError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  CHECK(error_of("point { name: \"a\" near { x: 1 z: -3 } } section { name: \"a\" normal { y: 1 } } "
                 "line { name: \"a\" end { x: 1.5 } } strain: true") == "no error");
  // The brick is 3 m wide: from x = 2 the nearest place is its side.
  CHECK_THAT(error_of("point { name: \"a\" near { x: 2 z: -1 } }"),
             Contains("test.txt:1: continuum.results.point[0].near") && Contains("(2, 0, -1)") &&
                 Contains("(1.5, 0, -1)") && Contains("outside of the ground"));
  // On the axis, just above the hole's bottom.
  CHECK_THAT(error_of("point { name: \"a\" near { z: -2.4 } }"),
             Contains("deleted at Excavate") && Contains("(0, 0, -2.5)"));
  CHECK_THAT(error_of("section { name: \"a\" point { y: 7 } normal { y: 2 } }"),
             Contains("continuum.results.section[0]") && Contains("it is at 7 m") && Contains("from -1.5 to 1.5 m"));
  CHECK_THAT(error_of("section { name: \"a\" }"), Contains("normal is zero"));
  CHECK_THAT(error_of("line { name: \"a\" begin { z: 1 } end { x: 1 z: 1 } }"),
             Contains("continuum.results.line[0]") && Contains("none of the 51 points"));
  CHECK_THAT(error_of("line { name: \"a\" }"), Contains("same point"));
  CHECK_THAT(error_of("point { near { x: 1 } }"), Contains("point[0].name is missing"));
  CHECK_THAT(error_of("point { name: \"../a\" near { x: 1 } }"), Contains("point[0].name") && Contains("../a"));
  CHECK_THAT(error_of("point { name: \"\" near { x: 1 } }"), Contains("1 to 64 letters"));
  CHECK_THAT(error_of("line { name: \"a\" end { z: -4 } } line { name: \"a\" end { x: 1.5 } }"),
             Contains("line[1].name") && Contains("taken"));
}

TEST_CASE("a surface load's points and lines end at the uniaxial strain sigma / M, in as many snapshots as asked for") {
  // 1e5 Pa on a column between rollers: e_zz = -sigma / M at rest, u_z = e_zz times the height above the bottom, whatever the
  // zones. M = E (1 - nu) / ((1 + nu) (1 - 2 nu)). At the ratio of 1e-10 that ends the run about as much is missing.
  const std::string scene =
      "continuum { block { width_x: 2 width_y: 2 height: 4 zones_x: 2 zones_y: 2 zones_z: 8 } supports: ROLLERS route: "
      "@ "
      "load { low { x: -1 y: -1 } high { x: 1 y: 1 } traction { z: -1e5 } ramp: 0.05 } "
      "results { strain: true unbalanced_force: true reactions: true point { name: \"p\" near { x: 0.3 y: -0.7 z: -1.9 "
      "} } "
      "line { name: \"l\" begin { z: -4 } end { z: 1 } points: 11 } section { name: \"s\" normal { x: 1 } } } } "
      "run { duration: 5 continuum_damping: 0.7 tolerance: 1e-10 } output { snapshot_interval: 0.1 history_interval: "
      "50 }";
  const double strain = -1e5 / test_moduli.constrained();
  for (const std::string route : {"ASSEMBLED", "INCREMENTAL"}) {
    Folder folder;
    std::string text = scene;
    text.replace(text.find('@'), 1, route);
    const RunReport report = run_continuum(parse_scene(text, "test.txt"), folder.path, nullptr, {});
    // step, time, u, v, stress, strain (xx yy zz xy yz zx), unbalanced force.
    const auto point = numbers_of(folder.path / "point_p.csv");
    CHECK(point.size() == (report.steps + 49) / 50);
    const std::vector<double>& last = point.back();
    INFO(route << ": u_z " << last[4] / (2.1 * strain) - 1 << ", e_zz " << last[16] / strain - 1);
    CHECK(last[4] == Approx(2.1 * strain).epsilon(1e-8));
    CHECK(last[16] == Approx(strain).epsilon(1e-8));
    CHECK(std::abs(last[14]) < 1e-8 * std::abs(strain));
    // The first, one each 0.1 s, and the last.
    const std::size_t snapshots = 2 + static_cast<std::size_t>(report.time / 0.1);
    for (const char* prefix : {"zones_", "line_l_", "section_s_"}) CHECK(folder.count(prefix) == snapshots);
    // Distance, position, u, stress, strain; two of the eleven points are above the ground.
    const auto line = numbers_of(folder.path / fmt::format("line_l_{:04d}.csv", snapshots - 1));
    REQUIRE(line.size() == 9);
    for (const auto& row : line) {
      CHECK(row[3] == Approx(row[0] - 4).margin(1e-12));
      CHECK(row[6] == Approx(row[0] * strain).epsilon(1e-8).margin(1e-15));
      CHECK(row[15] == Approx(strain).epsilon(1e-8));
    }
    std::stringstream zones;
    zones << std::ifstream(folder.path / "zones_0001.vtu").rdbuf();
    for (const char* field : {"strain xx", "unbalanced force [N]", "reaction [N]"})
      CHECK_THAT(zones.str(), Contains(field));
  }
}

TEST_CASE("who asks for no results gets none, and looking changes no bit") {
  const std::string
      begin = "continuum { block { zones_z: 8 } load { low { x: -1 y: -1 } high { x: 1 y: 1 } traction { z: -1e5 } } ",
      end = "} run { duration: 0.02 }";
  Folder plain, full;
  const RunReport first = run_continuum(parse_scene(begin + end, "t"), plain.path, nullptr, {});
  const RunReport second = run_continuum(
      parse_scene(
          begin +
              "results { strain: true unbalanced_force: true reactions: true point { name: \"p\" near { z: -0.1 } } "
              "section { name: \"s\" normal { y: 1 } } line { name: \"l\" end { z: -1 } } }" +
              end,
          "t"),
      full.path, nullptr, {});
  CHECK(first.state_hash == second.state_hash);
  std::stringstream zones;
  zones << std::ifstream(plain.path / "zones_0001.vtu").rdbuf();
  for (const char* field : {"strain", "unbalanced", "reaction"}) CHECK_THAT(zones.str(), !Contains(field));
  for (const char* prefix : {"point_", "section_", "line_"}) CHECK(plain.count(prefix) == 0);
}

TEST_CASE("a run alone that fails or is interrupted leaves whole files") {
  // A load that throws the top off makes nodes run away; a small one goes on until the interrupt, which comes once the point
  // has rows.
  const std::string scene =
      "continuum { block { zones_z: 8 } load { low { x: -1 y: -1 } high { x: 1 y: 1 } traction { z: -@ } } "
      "results { point { name: \"p\" near { z: -0.1 } } line { name: \"l\" end { z: -1 } } "
      "section { name: \"s\" normal { x: 1 } } } } run { duration: 1e5 } output { history_interval: 1 }";
  const auto with_load = [&](const std::string& load) {
    std::string text = scene;
    return parse_scene(text.replace(text.find('@'), 1, load), "t");
  };
  Folder failed, interrupted;
  CHECK_THROWS_WITH(run_continuum(with_load("1e9"), failed.path, nullptr, {}), Contains("runs away"));
  std::jthread user([&](std::stop_token stop) {
    while (!stop.stop_requested() && numbers_of(interrupted.path / "point_p.csv").size() < 3) std::this_thread::yield();
    interrupt_requested() = true;
  });
  const RunReport report = run_continuum(with_load("1e3"), interrupted.path, nullptr, {});
  user.join();
  interrupt_requested() = false;
  CHECK(report.is_interrupted);
  CHECK(report.steps == numbers_of(interrupted.path / "point_p.csv").size());
  for (const Folder* folder : {&failed, &interrupted}) {
    std::stringstream summary, points;
    summary << std::ifstream(folder->path / "continuum_summary.json").rdbuf();
    points << std::ifstream(folder->path / "point_p.csv").rdbuf();
    CHECK(summary.str().ends_with("}"));
    CHECK(points.str().ends_with("\n"));
    // The first state and the last.
    for (const char* prefix : {"line_l_", "section_s_0", "zones_"}) CHECK(folder->count(prefix) == 2);
    CHECK(folder->count("section_s.pvd") == 1);
  }
}

}  // namespace lockstep::continuum
