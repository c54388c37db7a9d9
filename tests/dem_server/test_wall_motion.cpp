// Walls that move, turn and press, and threads at walls.
#include <catch2/catch.hpp>
#include <cmath>

#include "common/checks.hpp"
#include "dem_server/clumps.hpp"
#include "tests/dem_server/spheres_at_walls.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

MeshShape box_mesh(double half) {
  std::vector<std::array<Vec3, 3>> triangles;
  for (int axis = 0; axis < 3; ++axis)
    for (const double side : {-1.0, 1.0}) {
      const Vec3 n = side * half * Vec3::Unit(axis), u = half * Vec3::Unit((axis + 1) % 3),
                 v = half * Vec3::Unit((axis + 2) % 3);
      triangles.push_back({n - u - v, n + u - v, n + u + v});
      triangles.push_back({n - u - v, n + u + v, n - u + v});
    }
  return {std::make_shared<const TriangleMesh>(triangles, "box"), Vec3::Zero()};
}

}  // namespace

TEST_CASE("A drum that turns in itself drags its grains and stays where it is, bit for bit") {
  // Surface speed w r; the shear spring of one step is k_s w r dt, and the torque on the drum about its axis is -F r with
  // r the contact point's distance R_c - U/2 + ... = (R_c - R + U) + R - U/2 from the axis.
  const double drum = 0.3, overlap = 1e-4, omega = 2, dt = 1e-5;
  WallSettings settings = wall(CylinderShape{Vec3(0, 5, 0), Vec3::UnitY(), drum, Side::Inside});
  settings.spin = Vec3(0, omega, 0);
  Walls walls(std::vector<WallSettings>{settings}, 1e3);
  Particles p = spheres_at({{0, 0, -(drum - R + overlap)}});
  const WallTotals totals = walls.compute(p, grain(), dt);
  const double arm = drum + overlap / 2, shear = k_n() / 8 * omega * arm * dt;
  INFO("drag " << p.force(0).x() << " N, expected " << -shear << "; torque " << walls.totals()[0].torque.y());
  CHECK(p.force(0).x() == Approx(-shear).epsilon(1e-9));  // (0, w, 0) x (0, 0, -r) = (-w r, 0, 0)
  CHECK(walls.totals()[0].torque.y() == Approx(-shear * arm).epsilon(1e-9));
  CHECK(totals.power == Approx(-walls.totals()[0].torque.y() * omega).epsilon(1e-12));
  CHECK(totals.power > 0);
  for (int step = 0; step < 1000; ++step) walls.advance(1e-3);
  CHECK(walls.state(0).attitude.coeffs() == Quat::Identity().coeffs());
  CHECK(walls.center(0) == Vec3(0, 5, 0));
}

TEST_CASE("A wall that slides along itself asks for no new lists") {
  Walls belt(std::vector<WallSettings>{wall(PlaneShape{}, {3, 0, 0})}, 0.5);
  Walls lift(std::vector<WallSettings>{wall(PlaneShape{}, {0, 0, -3})}, 0.5);
  Particles p = spheres_at({{0, 0, R - 1e-4}, {0, 0, 1}});
  Marks marks(0.005);
  for (int step = 0; step < 100; ++step) {
    for (Walls* walls : {&belt, &lift}) {
      walls->compute(p, grain(), 1e-4, marks.renew_if_needed(p));
      walls->advance(1e-4);
    }
  }
  CHECK(belt.renewals() == 1);
  CHECK(belt.candidates() == 1);
  CHECK(lift.renewals() == 10);  // 0.03 m at an allowance of 0.1 R: every 11th step
}

TEST_CASE("A plane and a mesh that turn are where the turn has put them") {
  // A quarter turn of the plane z = 0 about the x axis through (0, 1, 0): its normal goes from z to -y, and the plane
  // is y = 1. A box of half side 0.5 turned by 45 degrees about z has its edge at x = 0.5 sqrt 2. Turns are made of 90
  // equal ones, exact but for round-off.
  WallSettings plane = wall(PlaneShape{});
  plane.center = Vec3(0, 1, 0);
  plane.spin = Vec3(pi / 2, 0, 0);
  WallSettings box = wall(box_mesh(0.5));
  box.spin = Vec3(0, 0, pi / 4);
  box.velocity = Vec3(0, 0, 0.25);
  Walls walls(std::vector<WallSettings>{plane, box});
  for (int step = 0; step < 90; ++step) walls.advance(1.0 / 90);
  const double overlap = 1e-4, edge = 0.5 * std::sqrt(2.0);
  Particles p = spheres_at({{3, 1 - R + overlap, -2}, {edge + R - overlap, 0, 0.25}});
  walls.compute(p, grain(), 0);
  const double force = k_n() * overlap;
  CHECK((walls.planes()[0].normal + Vec3::UnitY()).norm() < 1e-13);
  INFO("forces over k_n U " << p.force(0).transpose() / force << " and " << p.force(1).transpose() / force);
  CHECK((p.force(0) + force * Vec3::UnitY()).norm() < 1e-8 * force);
  CHECK((p.force(1) - force * Vec3::UnitX()).norm() < 1e-8 * force);
}

TEST_CASE("Lists follow a mesh that turns") {
  // A box turns among 400 spheres that stand still: lists with an allowance against a look at every pebble in each step.
  Random random(8);
  Vec3s centers;
  for (int i = 0; i < 400; ++i)
    centers.push_back({random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-0.6, 0.6)});
  Particles p = spheres_at(centers), q = p;
  WallSettings box = wall(box_mesh(0.5));
  box.spin = Vec3(0.2, 0.3, 1);
  box.velocity = Vec3(0.3, 0, 0);
  Walls walls(std::vector<WallSettings>{box}, 0.5), fresh = walls;
  Marks marks(0.005);
  std::size_t contacts = 0;
  for (int step = 0; step < 300; ++step) {
    p.clear_forces(), q.clear_forces();
    contacts += walls.compute(p, grain(), 1e-3, marks.renew_if_needed(p)).contacts;
    fresh.compute(q, grain(), 1e-3);
    Hash with, without;
    walls.hash(with), fresh.hash(without);
    REQUIRE(with.value() == without.value());
    REQUIRE(forces_on(p) == forces_on(q));
    walls.advance(1e-3), fresh.advance(1e-3);
  }
  CAPTURE(contacts, walls.renewals());
  CHECK(contacts > 5000);
  CHECK(walls.renewals() < 250);
}

TEST_CASE("A wall with its own friction keeps it, and a share of none frees all") {
  WallSettings rough = wall(PlaneShape{}), plain = wall(PlaneShape{Vec3::Zero(), Vec3::UnitX()});
  rough.friction = 0.7;
  Walls walls(std::vector<WallSettings>{rough, plain}, 0.2);
  CHECK(walls.friction(0) == 0.7);
  CHECK(walls.friction(1) == 0.2);
  walls.set_friction_share(0);
  CHECK(walls.friction(0) == 0);
  Particles p = spheres_at({{1, 0, R - 1e-4}});
  p.velocity(0) = Vec3(0, 1, 0);
  walls.compute(p, grain(), 1e-4);
  CHECK(p.force(0).y() == 0);
  walls.set_friction_share(1);
  p.clear_forces();
  walls.compute(p, grain(), 1e-4);
  // Sticking would be k_s 1 m/s 1e-4 s = 70 N: the limit mu k_n U = 0.7 x 564 N is not reached.
  CHECK(p.force(0).y() == Approx(-k_n() / 8 * 1e-4).epsilon(1e-12));
}

TEST_CASE("A plane with a servo comes down on a sphere, reaches its pressure and rests") {
  // One sphere between the floor and the lid, weightless: at rest both press with p A, each overlap is p A / k_n, and
  // the lid stands 2 (R - p A / k_n) above the floor. A mesh with a direction does the same.
  const double pressure = 20e3, area = 0.01, force = pressure * area;
  for (const bool is_mesh : {false, true}) {
    WallSettings lid = is_mesh ? wall(box_mesh(0.5)) : wall(PlaneShape{Vec3(0, 0, 0.07), -Vec3::UnitZ()});
    if (is_mesh) std::get<MeshShape>(lid.shape).shift = Vec3(0, 0, 0.57);  // its underside
    lid.servo = WallServoSettings{pressure, area, 0.2, 0.2, Vec3(0, 0, -2)};
    Walls walls(std::vector<WallSettings>{wall(PlaneShape{}), lid});
    Particles p = spheres_at({{0, 0, R}});
    const double dt = 0.2 / std::sqrt(2 * k_n() / p.mass(0));
    Marks marks(0.005);
    double largest = 0;
    for (int step = 0; step < 4000; ++step) {
      p.clear_forces();
      walls.compute(p, grain(), dt, marks.renew_if_needed(p));
      largest = std::max(largest, walls.pressure(1));
      move(p, dt, Vec3::Zero(), 0.7);
      walls.advance(dt);
    }
    const double height = 0.07 - walls.state(1).servo_way, expected = 2 * (R - force / k_n());
    INFO((is_mesh ? "mesh" : "plane") << ": pressure " << walls.pressure(1) << " Pa, at most " << largest
                                      << "; height error " << height - expected << " m; speed "
                                      << walls.state(1).servo_speed << " m/s");
    CHECK(walls.pressure(1) == Approx(pressure).epsilon(1e-9));
    CHECK(walls.worst_servo_error() < 1e-9);
    CHECK(std::abs(height - expected) < 1e-12);
    CHECK(std::abs(walls.state(1).servo_speed) < 1e-9);
    CHECK(std::abs(p.velocity(0).z()) < 1e-9);
  }
}

TEST_CASE("A cylinder with a servo closes on a ring of spheres until their forces make up its pressure") {
  // Eight spheres between a fixed post of radius a and the drum: each carries p 2 pi r L / 8 at both its contacts, and
  // the drum's radius is r = a + 2 (R - F / k_n).
  const double post = 0.1, length = 0.5, pressure = 5e3;
  const int count = 8;
  Vec3s centers;
  for (int i = 0; i < count; ++i) {
    const double angle = 2 * pi * i / count;
    centers.push_back({(post + R) * std::cos(angle), (post + R) * std::sin(angle), 0});
  }
  for (const bool is_endless : {false, true}) {
    Particles p = spheres_at(centers);
    WallSettings drum = wall(FrustumShape{Vec3(0, 0, -0.25), Vec3::UnitZ(), 0.18, 0.18, length, Side::Inside});
    if (is_endless) drum.shape = CylinderShape{Vec3::Zero(), Vec3::UnitZ(), 0.18, Side::Inside};
    drum.servo = WallServoSettings{pressure, is_endless ? 2 * pi * 0.18 * length : 0.0, 0.2, 0.2, Vec3::Zero()};
    Walls walls(std::vector<WallSettings>{wall(CylinderShape{Vec3::Zero(), Vec3::UnitZ(), post, Side::Outside}), drum});
    const double dt = 0.2 / std::sqrt(2 * k_n() / p.mass(0));
    for (int step = 0; step < 6000; ++step) {
      p.clear_forces();
      walls.compute(p, grain(), dt);
      move(p, dt, Vec3::Zero(), 0.7);
      walls.advance(dt);
    }
    const double radius = 0.18 - walls.state(1).servo_way, force = pressure * 2 * pi * radius * length / count;
    const double expected = post + 2 * (R - force / k_n());
    INFO((is_endless ? "endless" : "tube")
         << ": pressure " << walls.pressure(1) << " Pa, radius " << radius << " m, error " << radius - expected);
    CHECK(walls.area(1) == Approx(2 * pi * radius * length).epsilon(1e-12));
    CHECK(walls.pressure(1) == Approx(pressure).epsilon(1e-9));
    CHECK(std::abs(radius - expected) < 1e-12);
    CHECK(walls.totals()[1].normal_force == Approx(count * force).epsilon(1e-9));
  }
}

TEST_CASE("A mantle's pressure counts between the platens, a platen presses first and is driven then, from rest") {
  // A tilted drum of length 0.5 with platens across its axis at 0.05 and 0.35, the upper one moving, and a plane at another
  // angle, which counts for nothing. Its area is 2 pi r times the distance of the platens.
  const Vec3 axis = Vec3(1, 0, 2).normalized();
  WallSettings drum = wall(FrustumShape{Vec3::Zero(), axis, 0.2, 0.2, 0.5, Side::Inside});
  drum.servo = WallServoSettings{1e6, 0, 0.2, 0.2, Vec3::Zero()};
  WallSettings top = wall(PlaneShape{0.35 * axis, -axis});
  top.servo = WallServoSettings{1e6, 0, 0.2, 0.2, Vec3::Zero(), true};
  top.velocity = -0.5 * axis;
  top.speed_ramp = 0.01;
  Walls walls(std::vector<WallSettings>{drum, wall(PlaneShape{0.05 * axis, axis}), top,
                                        wall(PlaneShape{Vec3(0, 0, 0.1), Vec3::UnitZ()})});
  walls.set_moving(false, true);
  Particles p = spheres_at({0.2 * axis});  // touches nobody
  const double dt = 1e-4;
  const auto advance = [&](int steps) {
    for (int n = 0; n < steps; ++n) walls.compute(p, grain(), dt), walls.advance(dt);
  };
  // Nothing presses back: both servos close as fast as they may.
  advance(100);
  const double way = 100 * dt * 0.2;
  CHECK(*walls.radius(0) == Approx(0.2 - way).epsilon(1e-12));
  CHECK(walls.area(0) == Approx(2 * pi * (0.2 - way) * (0.3 - way)).epsilon(1e-12));
  CHECK(walls.area(2) == Approx(pi * (0.2 - way) * (0.2 - way)).epsilon(1e-12));
  CHECK(walls.worst_servo_error() == Approx(1));
  // Driven: the ramp of 100 steps has speeds k/100 of the full one, k = 1, 2, ...; the servo's way stays.
  walls.end_balance();
  walls.set_moving(true, false);
  CHECK(walls.state(2).velocity.isZero(0));
  advance(150);
  const double driven = 0.5 * dt * (100 * 101 / 2 / 100.0 + 50);
  CHECK(walls.state(2).servo_way == Approx(way).epsilon(1e-12));
  CHECK((walls.state(2).center - (0.35 - driven) * axis).norm() < 1e-12);
  CHECK(walls.area(0) == Approx(2 * pi * (0.2 - way) * (0.3 - way - driven)).epsilon(1e-12));
}

TEST_CASE("A servo without what its wall needs is refused in words") {
  const auto text_of = [](WallShape shape, WallServoSettings servo) {
    WallSettings settings = wall(std::move(shape));
    settings.name = "lid";
    settings.servo = servo;
    try {
      Walls(std::vector<WallSettings>{settings});
    } catch (const InputError& error) {
      return std::string(error.what());
    }
    return std::string("no error");
  };
  using Catch::Contains;
  CHECK_THAT(text_of(PlaneShape{}, {1e3, 0, 1, 0.2, Vec3::Zero()}), Contains("lid") && Contains("servo.area = 0 m2"));
  CHECK_THAT(text_of(box_mesh(1), {1e3, 1, 1, 0.2, Vec3::Zero()}), Contains("servo.direction"));
  CHECK_THAT(text_of(PlaneShape{}, {-1, 1, 1, 0.2, Vec3::Zero()}), Contains("servo.pressure = -1 Pa"));
  CHECK(text_of(PlaneShape{}, {1e3, 1, 1, 0.2, Vec3::Zero()}) == "no error");
}

TEST_CASE("The work of a plane whose speed jumps at every step balances the energy to round-off") {
  // A linear contact and leap-frog: the change of 1/2 m v(n-1/2) v(n+1/2) + 1/2 k U^2 from n-1 to n is exactly
  // 1/2 (F(n-1) + F(n)) (x_wall(n) - x_wall(n-1)) while sphere and plane touch.
  const double held = 1e3;  // [N], with which the sphere starts in balance
  Particles p = spheres_at({{0, 0, R - held / k_n()}});
  Walls walls(std::vector<WallSettings>{wall(PlaneShape{})});
  const double mass = p.mass(0), dt = 0.1 / std::sqrt(k_n() / mass);
  Random random(1);
  double work = 0, start = 0, worst = 0, sum = 0;
  int touching = 0;
  for (int step = 0; step < 2000; ++step) {
    p.clear_forces();
    const WallTotals totals = walls.compute(p, grain(), step > 0 ? dt : 0.0);
    if (totals.contacts == 0) break;
    ++touching;
    work += totals.work, sum += std::abs(totals.work);
    const double v = p.velocity(0).z();
    // A constant weight holds the sphere down; its work is booked by its potential.
    const Vec3 weight(0, 0, -held / mass);
    const double height = p.position(0).z();
    move(p, dt, weight);
    const double energy = 0.5 * mass * v * p.velocity(0).z() + totals.elastic_energy + held * height;
    if (step == 0) start = energy;
    worst = std::max(worst, std::abs(energy - start - work));
    walls.set_velocity(0, {0, 0, random.uniform(-0.05, 0.05)});
    walls.advance(dt);
  }
  INFO("energy that does not balance " << worst << " J, of " << sum << " J of work, in " << touching << " steps");
  CHECK(touching > 200);
  CHECK(worst < 1e-12 * sum);
}

TEST_CASE("One, two, three and eight threads give the same bits at walls and pile") {
  // Clumps and spheres in a box with a drum, a cone, a mesh and the pile, all with friction and in motion; bodies are
  // shared out unevenly.
  const auto run = [](int threads, bool has_partition) {
    Team team(threads);
    Random random(6);
    Particles p;
    const ClumpTemplate clump = make_clump(3, 1.5);
    for (int i = 0; i < 600; ++i) {
      const Vec3 center(random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6));
      p.add(i % 3 == 0 ? unit_sphere() : clump, R, sphere_density, center, random.rotation());
      p.velocity(p.body_count() - 1) = Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    }
    Partition partition;
    if (has_partition)
      for (int t = 0; t <= threads; ++t)
        partition.body_begin.push_back(t == threads ? 600
                                                    : static_cast<std::int32_t>(t * t * 600 / (threads * threads)));
    WallSettings box = wall(box_mesh(0.3), {0.1, 0, 0});
    box.spin = Vec3(0, 0.5, 1);
    Walls walls(std::vector<WallSettings>{wall(CylinderShape{Vec3::Zero(), Vec3::UnitZ(), 0.55, Side::Inside}), box,
                                          wall(PlaneShape{Vec3(0, 0, -0.4), Vec3::UnitZ()}, {0, 0, 0.3}),
                                          wall(FrustumShape{Vec3(0.2, 0.2, -0.3), Vec3::UnitX(), 0.1, 0.2, 0.3,
                                                            Side::Outside})},
                0.6);
    Pile pile(PileShape{}, 0.1, 0.8);
    pile.set_velocity(-0.5);
    Marks marks(0.004);
    Hash h;
    const double dt = 1e-5;
    std::size_t contacts = 0;
    for (int step = 0; step < 60; ++step) {
      p.clear_forces();
      const TravelLimits& limits = marks.renew_if_needed(p);
      const WallTotals w = walls.compute(p, grain(), dt, limits, team, partition);
      const PileTotals all = pile.compute(p, grain(), dt, limits, team, partition);
      contacts += w.contacts + all.all().contacts;
      for (std::size_t k = 0; k < walls.size(); ++k) {
        const WallTotals& t = walls.totals()[k];
        h.add(t.force), h.add(t.torque);
        for (const double x : {t.normal_force, t.stiffness, t.elastic_energy, t.slip_work, t.dashpot_work, t.power,
                               t.work, t.max_overlap})
          h.add(x);
      }
      h.add(all.tip_force), h.add(all.shaft_force), h.add(all.all().slip_work), h.add(w.work);
      for (std::size_t b = 0; b < p.body_count(); ++b) {
        h.add(Vec3(p.force(b))), h.add(Vec3(p.torque(b)));
        p.velocity(b) += p.force(b) / p.mass(b) * dt;
        p.position(b) += p.velocity(b) * dt;
      }
      p.place_pebbles();
      walls.advance(dt), pile.advance(dt);
      walls.hash(h), pile.hash(h);
    }
    return std::make_pair(h.value(), contacts);
  };
  const auto [hash, contacts] = run(1, false);
  CAPTURE(contacts);
  CHECK(contacts > 5000);
  for (const int threads : {1, 2, 3, 8})
    for (const bool has_partition : {false, true}) {
      CAPTURE(threads, has_partition);
      CHECK(run(threads, has_partition).first == hash);
    }
}

TEST_CASE("Walls carry on where a stored state left them") {
  const auto make = [] {
    WallSettings lid = wall(PlaneShape{Vec3(0, 0, 0.06001), -Vec3::UnitZ()}), box = wall(box_mesh(0.5), {0.1, 0, 0});
    lid.servo = WallServoSettings{1e4, 0.01, 0.2, 0.2, Vec3::Zero()};
    box.spin = Vec3(0.1, 0.2, 0.3);
    return Walls(std::vector<WallSettings>{wall(PlaneShape{}), lid, box}, 0.4);
  };
  Walls walls = make();
  Particles p = spheres_at({{0, 0, R}, {0.4701, 0.1, 0.2}});
  p.velocity(0) = Vec3(0.1, 0, 0);
  const auto step = [](Walls& w, Particles& q) {
    q.clear_forces();
    w.compute(q, grain(), 1e-6);
    move(q, 1e-6);
    w.advance(1e-6);
  };
  for (int i = 0; i < 120; ++i) step(walls, p);
  REQUIRE(walls.contacts().size() >= 2);
  Walls other = make();
  Particles q = p;
  other.restore(walls.states(), walls.contacts());
  for (int i = 0; i < 200; ++i) step(walls, p), step(other, q);
  Hash a, b;
  walls.hash(a), p.hash(a), other.hash(b), q.hash(b);
  CHECK(a.value() == b.value());
  CHECK_THROWS_AS(other.restore({}, {}), InputError);
}
