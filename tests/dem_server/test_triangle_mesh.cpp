// Meshes: the contacts of spheres with triangles, and STL files.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>

#include "common/checks.hpp"
#include "tests/dem_server/spheres_at_walls.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

using Triangles = std::vector<std::array<Vec3, 3>>;

// The square |x|, |y| <= 1 of n x n cells, each cut along one diagonal.
Triangles flat(int n) {
  Triangles triangles;
  const auto at = [&](int i, int j) { return Vec3(-1 + 2.0 * i / n, -1 + 2.0 * j / n, 0); };
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      triangles.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
      triangles.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  return triangles;
}

// A cylinder of n facets about the y axis, corners on radius r, |y| <= 1.
Triangles faceted(int n, double r) {
  Triangles triangles;
  const auto at = [&](int i, double y) {
    const double a = 2 * pi * (i % n) / n;
    return Vec3(r * std::cos(a), y, r * std::sin(a));
  };
  for (int i = 0; i < n; ++i) {
    triangles.push_back({at(i, -1), at(i + 1, -1), at(i + 1, 1)});
    triangles.push_back({at(i, -1), at(i + 1, 1), at(i, 1)});
  }
  return triangles;
}

Walls mesh_wall(const Triangles& triangles, double friction = 0) {
  return Walls(
      std::vector<WallSettings>{wall(MeshShape{std::make_shared<const TriangleMesh>(triangles, "mesh"), Vec3::Zero()})},
      friction);
}

}  // namespace

TEST_CASE("The closest point of a triangle beats every other point of it") {
  // Against 2,000 random points of the triangle: none is nearer; and the way to it stands across the triangle or leads
  // out over the edge or corner that is named.
  Random random(5);
  const auto vector = [&] { return Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)); };
  std::array<int, 3> features{};
  double worst = 0;
  for (int i = 0; i < 600; ++i) {
    const std::array<Vec3, 3> a = {vector(), vector(), vector()};
    const Vec3 x = 2 * vector();
    const TrianglePoint at = closest_point(a, x);
    ++features[static_cast<std::size_t>(at.feature)];
    const double distance = (x - at.point).norm();
    for (int k = 0; k < 2000; ++k) {
      double u = random.uniform(), v = random.uniform();
      if (u + v > 1) u = 1 - u, v = 1 - v;
      const double other = (x - (a[0] + u * (a[1] - a[0]) + v * (a[2] - a[0]))).norm();
      worst = std::max(worst, distance - other);
    }
    if (at.feature == TriangleFeature::Corner) CHECK(at.point == a[static_cast<std::size_t>(at.index)]);
    if (at.feature == TriangleFeature::Face) {
      CHECK(std::abs((x - at.point).dot((a[1] - a[0]).normalized())) < 1e-12);
      CHECK(std::abs((x - at.point).dot((a[2] - a[0]).normalized())) < 1e-12);
    }
  }
  CAPTURE(worst, features[0], features[1], features[2]);
  CHECK(worst < 1e-14);
  for (const int count : features) CHECK(count > 20);
}

TEST_CASE("A sphere over an edge, a corner or a face of a flat mesh has one contact and the plane's force") {
  // Pressed in lightly, and by 0.7 R into a mesh whose cells are as large as R: there edges all around it are touched, in
  // directions far from the normal.
  struct Case {
    int cells;
    double overlap;
  };
  for (const auto& [cells, overlap] : {Case{8, 1e-4}, Case{64, 0.7 * R}}) {
    Walls walls = mesh_wall(flat(cells));
    Random random(2);
    Vec3s places = {{0, 0, 0}, {0.25, 0, 0}, {0.1, 0, 0}, {0.125, 0.125, 0}, {0.3, 0.05, 0}, {-0.75, 0.5, 0}};
    for (int i = 0; i < 200; ++i) {
      const double x = random.uniform(-0.9, 0.9);
      places.push_back({x, x, 0});  // on the diagonals
      places.push_back({x, random.uniform(-0.9, 0.9), 0});
    }
    double worst = 0;
    std::size_t most = 0, least = places.size();
    for (const Vec3& place : places) {
      Particles p = spheres_at({place + (R - overlap) * Vec3::UnitZ()});
      const std::size_t contacts = walls.compute(p, grain(), 1e-5).contacts;
      most = std::max(most, contacts), least = std::min(least, contacts);
      worst = std::max(worst, (p.force(0) - k_n() * overlap * Vec3::UnitZ()).norm() / (k_n() * overlap));
    }
    CAPTURE(cells, worst, most, least);
    CHECK(most == 1);
    CHECK(least == 1);
    CHECK(worst < 1e-10);
  }
}

TEST_CASE("A sphere slides and rolls over a flat mesh as over a plane, edges, corners and springs included") {
  // Laid on the floor with a speed at an angle to all edges, it slides, then rolls, over 0.5 m: across some 70 edges of
  // the finer mesh, the diagonals at a grazing angle. A dashpot keeps it on the floor (bounces would multiply round-off
  // by 10 each). Its way and spin differ from the plane's by round-off alone, which 30,000 steps gather.
  const auto run = [](Walls walls) {
    GrainMaterial material = grain();
    material.damping_ratio = damping_ratio(0.3);
    Particles p = spheres_at({{-0.4, -0.35, R - 5.2e-7}});
    p.velocity(0) = Vec3(0.9, 0.6, 0);
    const double dt = 2e-5;
    for (int step = 0; step < 30000; ++step) {
      p.clear_forces();
      REQUIRE(walls.compute(p, material, dt).contacts == 1);
      move(p, dt, {0, 0, -standard_gravity});
    }
    return p;
  };
  const double friction = 0.3;
  const Particles plane = run(Walls(std::vector<WallSettings>{wall(PlaneShape{})}, friction));
  for (const int n : {1, 24}) {
    const Particles mesh = run(mesh_wall(flat(n), friction));
    const double way = (mesh.position(0) - plane.position(0)).norm();
    const double spin = (mesh.spin(0) - plane.spin(0)).norm() / plane.spin(0).norm();
    INFO(n << " x " << n << " cells: place differs by " << way << " m, spin by " << spin << "; it went to "
           << plane.position(0).transpose());
    CHECK(way < 1e-10);
    CHECK(spin < 1e-9);
  }
}

TEST_CASE("Inside and outside, a faceted cylinder converges to the round one with order 2, by one contact") {
  // Corners on radius R_c. Inside, over the middle of a facet the overlap is larger by the sagitta R_c (1 - cos(pi/n)),
  // over an edge by R (1/cos(pi/n) - 1) (the shortest push into the polygon that the centres may be in); outside it is
  // smaller by the sagitta over a facet and the same over an edge. The worst error of |F| is that over a facet.
  const double radius = 0.2, overlap = 1e-3;
  for (const bool is_inside : {true, false}) {
    double last = 0;
    for (const int n : {64, 128, 256}) {
      Walls walls = mesh_wall(faceted(n, radius));
      double worst = 0, over_edge = 0;
      const int places = 40;  // per facet, the first over its edge, the 21st over its middle
      for (int i = 0; i < 3 * places; ++i) {
        const double angle = 2 * pi * i / (n * places), r = is_inside ? radius - R + overlap : radius + R - overlap;
        Particles p = spheres_at({{r * std::cos(angle), 0.123, r * std::sin(angle)}});
        REQUIRE(walls.compute(p, grain(), 1e-5).contacts == 1);
        const double error = p.force(0).norm() / k_n() - overlap;
        worst = std::max(worst, std::abs(error));
        if (i % places == 0) over_edge = std::max(over_edge, std::abs(error));
      }
      const double sagitta = radius * (1 - std::cos(pi / n));
      const double edge = is_inside ? R * (1 / std::cos(pi / n) - 1) : 0.0;
      const double order = last > 0 ? std::log2(last / worst) : 2.0;
      INFO((is_inside ? "inside" : "outside")
           << ", " << n << " facets: worst error " << worst << " m, sagitta " << sagitta << " m, order " << order
           << "; over an edge " << over_edge << " m of " << edge);
      CHECK(worst == Approx(sagitta).epsilon(1e-9));
      CHECK(std::abs(over_edge - edge) < 1e-12);
      CHECK(order == Approx(2).margin(0.01));
      last = worst;
    }
  }
}

TEST_CASE("A frictionless sphere that slides round and round in a faceted drum keeps its energy") {
  // |t|^2/2 is the potential of the push; leap-frog keeps a discrete energy up to (omega dt)^2 of what the force's
  // kinks at facet borders leave. A second contact over each edge, or a jump there, would be seen at once.
  const double drum = 0.2, speed = 2;
  Walls walls = mesh_wall(faceted(24, drum));
  Particles p = spheres_at({{drum - R - 0.003, 0, 0}});
  p.velocity(0) = Vec3(0, 0, speed);
  const double mass = p.mass(0), dt = 0.02 / std::sqrt(k_n() / mass), start = 0.5 * mass * speed * speed;
  double worst = 0, turned = 0;
  for (int step = 0; step < 100000; ++step) {
    p.clear_forces();
    const WallTotals totals = walls.compute(p, grain(), dt);
    REQUIRE(totals.contacts <= 1);
    const Vec3 v = p.velocity(0), x = p.position(0);
    move(p, dt);
    const double energy = 0.5 * mass * v.dot(p.velocity(0)) + totals.elastic_energy;
    worst = std::max(worst, std::abs(energy / start - 1));
    turned += x.cross(v).y() / x.squaredNorm() * dt / (2 * pi);
  }
  INFO("energy strays by " << worst << " of itself over " << turned << " turns");
  CHECK(std::abs(turned) > 0.5);
  CHECK(worst < 1e-3);
}

TEST_CASE("The shortest push is met by all its constraints and no shorter one is") {
  // Against a search: no random direction with the length that its own constraints ask for is shorter.
  Random random(9);
  double worst = 0, longest_miss = 0;
  for (int trial = 0; trial < 200; ++trial) {
    std::vector<MeshContact> constraints;
    const int count = 1 + static_cast<int>(random.uniform(0, 12));
    for (int i = 0; i < count; ++i)
      constraints.push_back({random.uniform(0.1, 1),
                             Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(1.5, 3)).normalized()});
    const Vec3 push = shortest_push(constraints);
    for (const MeshContact& c : constraints) longest_miss = std::max(longest_miss, c.overlap - push.dot(c.normal));
    for (int i = 0; i < 3000; ++i) {
      const Vec3 direction =
          (push.normalized() + 0.5 * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)))
              .normalized();
      double length = 0;
      for (const MeshContact& c : constraints) {
        const double along = direction.dot(c.normal);
        length = std::max(length, along > 0 ? c.overlap / along : std::numeric_limits<double>::infinity());
      }
      worst = std::max(worst, push.norm() - length);
    }
  }
  CAPTURE(worst, longest_miss);
  CHECK(longest_miss < 1e-11);
  CHECK(worst < 1e-11);
}

TEST_CASE("Two sheets that meet at a right angle press a sphere from both sides, as two planes do") {
  const Triangles corner = {{Vec3(0, -1, 0), Vec3(2, -1, 0), Vec3(2, 1, 0)},
                            {Vec3(0, -1, 0), Vec3(2, 1, 0), Vec3(0, 1, 0)},
                            {Vec3(0, -1, 0), Vec3(0, 1, 0), Vec3(0, 1, 2)},
                            {Vec3(0, -1, 0), Vec3(0, 1, 2), Vec3(0, -1, 2)}};
  Walls walls = mesh_wall(corner);
  Particles p = spheres_at({{R - 1e-4, 0.1, R - 2e-4}});
  CHECK(walls.compute(p, grain(), 1e-5).contacts == 2);
  const Vec3 expected = k_n() * Vec3(1e-4, 0, 2e-4);
  INFO("force " << p.force(0).transpose() << " N of " << expected.transpose());
  CHECK((p.force(0) - expected).norm() < 1e-10 * expected.norm());
}

TEST_CASE("The grid finds the triangles within reach, all and no others, at a hundred thousand of them as well") {
  const int n = 224;  // 100,352 triangles
  Triangles triangles = flat(n);
  for (auto& t : triangles)
    for (Vec3& x : t) x.z() = 0.3 * std::sin(3 * x.x()) * std::cos(2 * x.y());
  const TriangleMesh mesh(triangles, "waves");
  CHECK(mesh.triangle_count() == 100352);
  CHECK(mesh.corner_count() == 225 * 225);
  Random random(4);
  std::size_t found_in_all = 0;
  for (int i = 0; i < 20; ++i) {
    const Vec3 x(random.uniform(-1.1, 1.1), random.uniform(-1.1, 1.1), random.uniform(-0.4, 0.4));
    const double reach = random.uniform(0.005, 0.2);
    std::vector<std::int32_t> found, expected;
    mesh.list_near(x, reach, found);
    for (std::size_t t = 0; t < mesh.triangle_count(); ++t)
      if ((closest_point(mesh.corners(t), x).point - x).norm() < reach)
        expected.push_back(static_cast<std::int32_t>(t));
    CHECK(found == expected);
    found_in_all += found.size();
  }
  CAPTURE(found_in_all);
  CHECK(found_in_all > 500);
}

TEST_CASE("A mesh of a hundred thousand triangles is looked at by the spheres beside it alone") {
  Walls walls = mesh_wall(flat(224));
  Particles p = spheres_at({{0, 0, 1}, {0.5, 0.5, R - 1e-4}, {0.2, 0.1, 0.3}, {0.3, 3, 0}});
  Marks marks(0.005);
  for (int step = 0; step < 100; ++step) walls.compute(p, grain(), 1e-5, marks.renew_if_needed(p));
  CHECK(walls.candidates() == 1);
  CHECK(walls.renewals() == 1);
  CHECK(walls.totals()[0].contacts == 1);
}

// --------------------------------------------------------------------------------------------------------- STL

namespace {

class StlFile {
 public:
  explicit StlFile(const std::string& bytes)
      : path_(std::filesystem::temp_directory_path() /
              ("lockstep_mesh_" + std::to_string(reinterpret_cast<std::uintptr_t>(this)) + ".stl")) {
    std::ofstream(path_, std::ios::binary) << bytes;
  }
  ~StlFile() { std::filesystem::remove(path_); }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

std::string ascii(const Triangles& triangles) {
  std::string text = "solid a name of its own\n";
  for (const auto& t : triangles) {
    text += "  facet normal 0 0 0\n    outer loop\n";
    for (const Vec3& x : t) text += fmt::format("      vertex {:.9g} {:.9g} {:.9g}\n", x.x(), x.y(), x.z());
    text += "    endloop\n  endfacet\n";
  }
  return text + "endsolid a name of its own\n";
}

std::string binary(const Triangles& triangles) {
  std::string bytes("solid, says this header, but the file is binary");
  bytes.resize(80, ' ');
  const auto put = [&](const auto& value) { bytes.append(reinterpret_cast<const char*>(&value), sizeof value); };
  put(static_cast<std::uint32_t>(triangles.size()));
  for (const auto& t : triangles) {
    for (int k = 0; k < 3; ++k) put(0.0f);
    for (const Vec3& x : t)
      for (int k = 0; k < 3; ++k) put(static_cast<float>(x[k]));
    put(static_cast<std::uint16_t>(0));
  }
  return bytes;
}

std::string complaint_about(const std::string& bytes, double scale = 1) {
  const StlFile file(bytes);
  try {
    read_stl(file.path(), scale);
  } catch (const InputError& error) {
    return error.what();
  }
  return "no complaint";
}

}  // namespace

TEST_CASE("ASCII and binary STL files give the same mesh, scaled and shifted") {
  // Quarters are exact as floats, so both are exact.
  const Triangles triangles = flat(8);
  const StlFile text(ascii(triangles)), bytes(binary(triangles));
  const Vec3 shift(1, 2, 3);
  const TriangleMesh a = read_stl(text.path(), 0.5, shift), b = read_stl(bytes.path(), 0.5, shift);
  REQUIRE(a.triangle_count() == triangles.size());
  REQUIRE(b.triangle_count() == triangles.size());
  CHECK(a.corner_count() == 81);
  CHECK(b.corner_count() == 81);
  CHECK(a.area() == Approx(1).epsilon(1e-14));  // 2 x 2 m, halved in each direction
  for (std::size_t t = 0; t < triangles.size(); ++t)
    for (std::size_t k = 0; k < 3; ++k) {
      CHECK(a.corners(t)[k] == 0.5 * triangles[t][k] + shift);
      CHECK(b.corners(t)[k] == 0.5 * triangles[t][k] + shift);
    }
}

TEST_CASE("What is no usable STL file is refused in words that say what to do") {
  using Catch::Contains;
  CHECK_THROWS_AS(read_stl("no/such/file.stl"), IoError);
  CHECK_THROWS_WITH(read_stl("no/such/file.stl"), Contains("no/such/file.stl") && Contains("No such file"));
  CHECK_THROWS_AS(read_stl(std::filesystem::temp_directory_path()), IoError);
  CHECK_THAT(complaint_about(""), Contains("no STL file"));
  CHECK_THAT(complaint_about(std::string(200, 'x')), Contains("200 bytes"));
  CHECK_THAT(complaint_about("solid nothing\nendsolid nothing\n"), Contains("no triangles"));
  const std::string good = ascii(flat(1)), good_bytes = binary(flat(1));
  CHECK(complaint_about(good) == "no complaint");
  CHECK(complaint_about(good_bytes) == "no complaint");
  CHECK_THAT(complaint_about(good.substr(0, good.find("endsolid"))), Contains("cut short"));
  std::string cut = good_bytes.substr(0, good_bytes.size() - 7);
  cut.replace(0, 5, "short");
  CHECK_THAT(complaint_about(cut), Contains("2 triangles") && Contains("184"));
  std::string wrong = good;
  wrong.replace(wrong.find("vertex -1"), 9, "vertex -o");
  CHECK_THAT(complaint_about(wrong), Contains(":4:") && Contains("\"-o\" is no coordinate"));
  wrong = good;
  wrong.replace(wrong.find("endloop"), 7, "vertex 0 0 0");
  CHECK_THAT(complaint_about(wrong), Contains("more than three"));
  wrong = good;
  wrong.replace(wrong.find("outer"), 5, "inner");
  CHECK_THAT(complaint_about(wrong), Contains(":3:") && Contains("\"inner\""));

  Triangles triangles = flat(2);
  triangles[3][2] = 0.5 * (triangles[3][0] + triangles[3][1]);
  CHECK_THAT(complaint_about(ascii(triangles)), Contains("1 of 8 triangles have no area: 4 with corners"));
  triangles = flat(1);
  triangles[0][1].x() = std::numeric_limits<double>::quiet_NaN();
  CHECK_THAT(complaint_about(binary(triangles)), Contains("triangle 1") && Contains("nan"));
  CHECK_THAT(complaint_about(good, 1e7), Contains("1e+06 m") && Contains("scale"));
  CHECK_THAT(complaint_about(good, 1e-8), Contains("2e-08 m large") && Contains("scale"));
}
