// Cylinders and cones: where their surfaces are, and what spheres do at them.
#include <catch2/catch.hpp>
#include <cmath>

#include "common/checks.hpp"
#include "tests/dem_server/spheres_at_walls.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

const Vec3 tilted = Vec3(1, 2, -2) / 3;  // a unit vector

Walls one(WallShape shape, double friction = 0) {
  return Walls(std::vector<WallSettings>{wall(std::move(shape))}, friction);
}

FrustumShape frustum(double begin_radius, double end_radius, Side side) {
  return {Vec3(0.3, -0.2, 0.1), tilted, begin_radius, end_radius, 0.5, side};
}

// A square of side 2 about the origin, across z, of two triangles.
MeshShape square() {
  const Vec3 a(-1, -1, 0), b(1, -1, 0), c(1, 1, 0), d(-1, 1, 0);
  return {std::make_shared<const TriangleMesh>(std::vector<std::array<Vec3, 3>>{{a, b, c}, {a, c, d}}, "square"),
          Vec3::Zero()};
}

}  // namespace

TEST_CASE("A sphere pressed on a wall of any shape is pushed back by k_n U along the wall's normal") {
  // A surface point with its normal n towards the grains is known for each; the sphere stands at R - U from it.
  const Vec3 across = tilted.unitOrthogonal(), base(0.3, -0.2, 0.1);
  struct Case {
    const char* name;
    WallShape shape;
    Vec3 surface, normal;
  };
  // A side from radius 0.2 to 0.5 over 0.4 rises 3:4; its outward normal is (4, -3)/5 in (r, s).
  const FrustumShape cone{base, tilted, 0.2, 0.5, 0.4, Side::Outside},
      funnel{base, tilted, 0.2, 0.5, 0.4, Side::Inside};
  const Vec3 on_cone = base + 0.35 * across + 0.2 * tilted, cone_normal = 0.8 * across - 0.6 * tilted;
  const std::vector<Case> cases = {
      {"plane", PlaneShape{base, tilted}, base + across, tilted},
      {"drum", CylinderShape{base, tilted, 0.2, Side::Inside}, base + 0.2 * across + 7 * tilted, -across},
      {"post", CylinderShape{base, tilted, 0.2, Side::Outside}, base + 0.2 * across + 7 * tilted, across},
      {"tube", frustum(0.2, 0.2, Side::Inside), base + 0.2 * across + 0.3 * tilted, -across},
      {"tube, from around it", frustum(0.2, 0.2, Side::Inside), base + 0.2 * across + 0.3 * tilted, across},
      {"tube, rim", frustum(0.2, 0.2, Side::Inside), base + 0.2 * across, -tilted},
      {"rod", frustum(0.2, 0.2, Side::Outside), base + 0.2 * across + 0.3 * tilted, across},
      {"rod, begin", frustum(0.2, 0.2, Side::Outside), base + 0.1 * across, -tilted},
      {"rod, end", frustum(0.2, 0.2, Side::Outside), base + 0.1 * across + 0.5 * tilted, tilted},
      {"rod, rim", frustum(0.2, 0.2, Side::Outside), base + 0.2 * across, 0.6 * across - 0.8 * tilted},
      {"cone", cone, on_cone, cone_normal},
      {"funnel", funnel, on_cone, -cone_normal},
      {"cone's apex", FrustumShape{base, tilted, 0, 0.3, 0.4, Side::Outside}, base, -tilted},
      {"mesh", square(), {0.3, 0.2, 0}, Vec3::UnitZ()},
      {"mesh, from below", square(), {0.3, 0.2, 0}, -Vec3::UnitZ()},
      {"mesh, open edge", square(), {1, 0.2, 0}, {0.6, 0, 0.8}},
  };
  const double overlap = 1e-4, force = k_n() * overlap;
  for (const Case& c : cases) {
    Particles p = spheres_at({c.surface + (R - overlap) * c.normal});
    Walls walls = one(c.shape);
    const WallTotals totals = walls.compute(p, grain(), 1e-5);
    const double error = (p.force(0) - force * c.normal).norm() / force;
    INFO(c.name << ": force " << p.force(0).transpose() << " N, error over force " << error);
    CHECK(totals.contacts == 1);
    CHECK(error < 1e-10);  // U is the difference of lengths of 1 m, known to 1e-16 of them
    CHECK((p.force(0) + totals.force).norm() == 0);
    CHECK(totals.elastic_energy == Approx(0.5 * k_n() * overlap * overlap).epsilon(1e-9));
    Particles away = spheres_at({c.surface + (R + overlap) * c.normal});
    CHECK(walls.compute(away, grain(), 1e-5).contacts == 0);
  }
}

TEST_CASE("Behind a plane, in an endless wall and inside a solid rod a sphere is pushed out, however deep it is") {
  const double depth = 0.1;  // of the centre behind the surface: overlap R + depth
  struct Case {
    WallShape shape;
    Vec3 center, normal;
  };
  const std::vector<Case> cases = {
      {PlaneShape{Vec3::Zero(), Vec3::UnitZ()}, {0, 0, -depth}, Vec3::UnitZ()},
      {CylinderShape{Vec3::Zero(), Vec3::UnitZ(), 0.4, Side::Inside}, {0, 0.4 + depth, 1}, -Vec3::UnitY()},
      {CylinderShape{Vec3::Zero(), Vec3::UnitZ(), 0.4, Side::Outside}, {0, 0.4 - depth, 1}, Vec3::UnitY()},
      {FrustumShape{Vec3::Zero(), Vec3::UnitZ(), 0.4, 0.4, 1, Side::Outside}, {0, 0.4 - depth, 0.5}, Vec3::UnitY()},
      {FrustumShape{Vec3::Zero(), Vec3::UnitZ(), 0.4, 0.4, 1, Side::Outside}, {0, 0.1, 1 - depth}, Vec3::UnitZ()},
      {FrustumShape{Vec3::Zero(), Vec3::UnitZ(), 0.4, 0.4, 1, Side::Outside}, {0, 0.1, depth}, -Vec3::UnitZ()}};
  for (const Case& c : cases) {
    Particles p = spheres_at({c.center});
    one(c.shape).compute(p, grain(), 1e-5);
    const Vec3 expected = k_n() * (R + depth) * c.normal;
    INFO("force " << p.force(0).transpose() << " N of " << expected.transpose());
    CHECK((p.force(0) - expected).norm() < 1e-12 * expected.norm());
  }
}

TEST_CASE("The distance to a round wall is continuous and its gradient is the normal") {
  // Central differences with h = 1e-6: error of order h^2/r^2 and 1e-16/h. Inside a solid body, across the ridge where
  // two surfaces are equally near, and on the axis only continuity can hold.
  const std::vector<FrustumShape> frustums = {frustum(0.2, 0.2, Side::Outside), frustum(0.2, 0.2, Side::Inside),
                                              frustum(0.1, 0.3, Side::Outside), frustum(0.3, 0.1, Side::Inside),
                                              frustum(0, 0.2, Side::Outside)};
  Random random(11);
  const double h = 1e-6;
  double worst_gradient = 0, worst_jump = 0;
  int checked = 0;
  for (const FrustumShape& shape : frustums)
    for (int i = 0; i < 2000; ++i) {
      const Vec3 x(random.uniform(-0.2, 0.9), random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.5));
      const WallPoint at = shape.closest(x);
      Vec3 gradient;
      for (int k = 0; k < 3; ++k) {
        const double up = shape.closest(x + h * Vec3::Unit(k)).distance;
        const double down = shape.closest(x - h * Vec3::Unit(k)).distance;
        gradient[k] = (up - down) / (2 * h);
        worst_jump = std::max({worst_jump, std::abs(up - at.distance), std::abs(down - at.distance)});
      }
      const double off_axis = (x - shape.point).cross(shape.axis).norm();
      if (at.distance > 0.001 && off_axis > 0.01) {
        worst_gradient = std::max(worst_gradient, (gradient - at.normal).norm());
        ++checked;
      }
    }
  CAPTURE(worst_gradient, worst_jump, checked);
  CHECK(checked > 5000);
  CHECK(worst_gradient < 1e-5);
  CHECK(worst_jump < 1.001 * h);
}

TEST_CASE("A sphere that rolls from a rod's side over the rim to its flat end feels no jump") {
  // Held at a constant overlap on a path around the rim: the force stays k_n U and turns by at most the step's angle.
  const FrustumShape rod{Vec3::Zero(), Vec3::UnitZ(), 0.2, 0.2, 0.5, Side::Outside};
  Walls walls = one(rod);
  const double overlap = 1e-4, d = R - overlap, quarter = d * pi / 2;
  const int steps = 2000;
  Particles p = spheres_at({Vec3::Zero()});
  Vec3 last = Vec3::Zero();
  double worst = 0;
  for (int i = 0; i <= steps; ++i) {
    const double s = i * (0.02 + quarter) / steps - 0.01, angle = std::clamp(s / d, 0.0, pi / 2);
    p.position(0) =
        Vec3(0.2 + d * std::cos(angle) - std::max(0.0, s - quarter), 0, 0.5 + d * std::sin(angle) + std::min(0.0, s));
    p.clear_forces();
    REQUIRE(walls.compute(p, grain(), 0).contacts == 1);
    if (i > 0) worst = std::max(worst, (p.force(0) - last).norm() / (k_n() * overlap));
    last = p.force(0);
  }
  const double turn = (0.02 + quarter) / steps / d;
  CAPTURE(worst, turn);
  CHECK(worst < 1.01 * turn);
}

TEST_CASE("A sphere in the corner between a funnel and a floor has a contact with each") {
  // Side from radius 0.2 up to 0.5 over 0.4: inward normal (-4, 3)/5 in (r, z). The centre stands R - U_1 above the floor
  // and R - U_2 off the side: r = 0.2 + ((R - U_1) 3/5 - (R - U_2)) 5/4.
  const double u1 = 2e-4, u2 = 1e-4, z = R - u1, r = 0.2 + (0.6 * z - (R - u2)) / 0.8;
  const double azimuth = 0.7;
  const Vec3 out(std::cos(azimuth), std::sin(azimuth), 0);
  Particles p = spheres_at({r * out + z * Vec3::UnitZ()});
  Walls walls(std::vector<WallSettings>{wall(FrustumShape{Vec3::Zero(), Vec3::UnitZ(), 0.2, 0.5, 0.4, Side::Inside}),
                                        wall(PlaneShape{})});
  const WallTotals all = walls.compute(p, grain(), 1e-5);
  const Vec3 from_side = k_n() * u2 * (-0.8 * out + 0.6 * Vec3::UnitZ()), from_floor = k_n() * u1 * Vec3::UnitZ();
  const double side_error = (walls.totals()[0].force + from_side).norm() / from_side.norm();
  const double floor_error = (walls.totals()[1].force + from_floor).norm() / from_floor.norm();
  CAPTURE(side_error, floor_error);
  CHECK(all.contacts == 2);
  CHECK(side_error < 1e-11);
  CHECK(floor_error < 1e-11);
  CHECK((p.force(0) - from_side - from_floor).norm() < 1e-11 * from_floor.norm());
}

namespace {

// A sphere let go at a small angle inside a drum of radius R_c with a level axis. Returns the mean period over ten
// swings, and how far the energy strays from the start, of the swing's own m g h.
struct Swing {
  double period = 0;        // [s]
  double energy_error = 0;  // largest, over m g h
};

Swing swing_in_drum(double drum_radius, double angle, double friction) {
  const Vec3 gravity(0, 0, -standard_gravity);
  Particles p = spheres_at({Vec3::Zero()});
  const double mass = p.mass(0), overlap = mass * standard_gravity * std::cos(angle) / k_n();
  const double arm = drum_radius - R + overlap;
  p.position(0) = arm * Vec3(std::sin(angle), 0, -std::cos(angle));
  Walls walls = one(CylinderShape{Vec3::Zero(), Vec3::UnitY(), drum_radius, Side::Inside}, friction);
  const double dt = 0.1 / std::sqrt(k_n() / mass), swing_energy = mass * standard_gravity * arm * (1 - std::cos(angle));
  double first = -1, last = -1, before = p.position(0).x(), start = 0;
  int crossings = 0;
  Swing result;
  for (int step = 0; crossings < 21; ++step) {
    p.clear_forces();
    const WallTotals totals = walls.compute(p, grain(), step > 0 ? dt : 0.0);
    const Vec3 x = p.position(0), v = p.velocity(0), w = p.spin(0);
    move(p, dt, gravity);
    // Leap-frog's kinetic energy at t_n.
    const double kinetic = 0.5 * mass * v.dot(p.velocity(0)) + 0.5 * p.inertia(0).x() * w.dot(p.spin(0));
    const double energy = kinetic + totals.elastic_energy + totals.slip_work + mass * standard_gravity * x.z();
    if (step == 0) start = energy;
    result.energy_error = std::max(result.energy_error, std::abs(energy - start) / swing_energy);
    const double now = p.position(0).x();
    if ((now > 0) != (before > 0)) {
      last = dt * (step + before / (before - now));
      if (crossings++ == 0) first = last;
    }
    before = now;
  }
  result.period = (last - first) / 10;
  return result;
}

}  // namespace

TEST_CASE("A frictionless sphere swings in a drum as a pendulum of length R_c - R") {
  // omega^2 = g/(R_c - R); the period of the swing angle a is longer by a^2/16, and the overlap m g/k = 5e-7 m lengthens
  // the arm by 2e-6 of itself: it is counted.
  const double drum = 0.3, angle = 0.05;
  const Swing swing = swing_in_drum(drum, angle, 0);
  const double mass = sphere_density * 4 / 3 * pi * R * R * R;
  const double arm = drum - R + mass * standard_gravity / k_n();
  const double expected = 2 * pi * std::sqrt(arm / standard_gravity) * (1 + angle * angle / 16);
  INFO("period " << swing.period << " s, expected " << expected << ", error " << swing.period / expected - 1
                 << "; energy error " << swing.energy_error);
  CHECK(swing.period == Approx(expected).epsilon(1e-6));
  CHECK(swing.energy_error < 1e-4);
}

TEST_CASE("A sphere that rolls in a drum swings slower by sqrt(7/5), and keeps its energy") {
  // Rolling: 7/5 m (R_c - R)^2 a'' = -m g (R_c - R) sin a. The shear spring gives by (omega / omega_s)^2 = 1e-5 of the
  // way.
  const double drum = 0.3, angle = 0.05;
  const Swing swing = swing_in_drum(drum, angle, 1e3);
  const double mass = sphere_density * 4 / 3 * pi * R * R * R;
  const double arm = drum - R + mass * standard_gravity / k_n();
  const double expected = 2 * pi * std::sqrt(7.0 / 5 * arm / standard_gravity) * (1 + angle * angle / 16);
  INFO("period " << swing.period << " s, expected " << expected << ", error " << swing.period / expected - 1
                 << "; energy error " << swing.energy_error);
  CHECK(swing.period == Approx(expected).epsilon(1e-4));
  CHECK(swing.energy_error < 1e-3);
}

TEST_CASE("Round walls refuse what has no surface, in words") {
  const auto text_of = [](WallShape shape) {
    try {
      one(std::move(shape));
    } catch (const InputError& error) {
      return std::string(error.what());
    }
    return std::string("no error");
  };
  using Catch::Contains;
  CHECK_THAT(text_of(CylinderShape{Vec3::Zero(), Vec3::Zero(), 1, Side::Inside}), Contains("axis = 0 0 0"));
  CHECK_THAT(text_of(CylinderShape{Vec3::Zero(), Vec3::UnitZ(), 0, Side::Inside}), Contains("radius = 0 m"));
  CHECK_THAT(text_of(FrustumShape{Vec3::Zero(), Vec3::UnitZ(), 0, 0, 1, Side::Inside}), Contains("no surface"));
  CHECK_THAT(text_of(FrustumShape{Vec3::Zero(), Vec3::UnitZ(), 1, -1, 1, Side::Inside}), Contains("radius = -1 m"));
  CHECK_THAT(text_of(FrustumShape{Vec3::Zero(), Vec3::UnitZ(), 1, 1, 0, Side::Inside}), Contains("length = 0 m"));
  CHECK_THAT(text_of(MeshShape{}), Contains("mesh"));
}
