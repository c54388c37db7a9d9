// Spheres of radius 0.03 m against planes and the pile.
#include <catch2/catch.hpp>
#include <cmath>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "tests/dem_server/spheres_at_walls.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

Walls walls_of(const std::vector<PlaneSettings>& planes, double friction = 0) { return Walls(planes, friction); }
Walls floor_plane(double friction = 0) { return walls_of({{Vec3::Zero(), Vec3::UnitZ(), Vec3::Zero()}}, friction); }

PileShape cone(double angle) {
  PileShape shape;
  shape.tip = PileTip::Cone;
  shape.cone_angle = angle;
  return shape;
}

}  // namespace

TEST_CASE("A sphere pressed on a plane is pushed back by k_n U, and the plane by as much") {
  const double overlap = 1e-4;
  Particles p = spheres_at({{0.2, -0.1, R - overlap}});
  Walls planes = floor_plane();
  const WallTotals totals = planes.compute(p, grain(), 1e-5);
  const double expected = k_n() * overlap;
  INFO("force " << p.force(0).transpose() << " N, expected z " << expected);
  CHECK(totals.contacts == 1);
  CHECK(p.force(0).z() == Approx(expected).epsilon(1e-11));
  CHECK((p.force(0) + totals.force).norm() == 0);
  CHECK(totals.elastic_energy == Approx(0.5 * k_n() * overlap * overlap).epsilon(1e-11));
  CHECK(totals.max_overlap == Approx(overlap / R).epsilon(1e-11));
  planes.for_each_contact([&](const ContactView& view) {
    CHECK(view.body_b == -1);
    CHECK((view.normal + Vec3::UnitZ()).norm() == 0);
    CHECK(view.point.z() == Approx(-overlap / 2).epsilon(1e-9));  // eq. 1: the middle of the overlap
  });
}

TEST_CASE("A sphere that slides on a plane ends up rolling at 5/7 of its speed") {
  // About the contact point friction has no moment: m v0 R = m v R + 0.4 m R^2 w, and rolling is v = R w, so v = 5/7
  // v0. The spring acts at x_C, U/2 above the plane, and rolls on R - U/2: corrections of order U/R = 1e-6.
  const double v0 = 1.0, overlap = 1e-6 * R, dt = 1e-5;
  Particles p = spheres_at({{0, 0, R - overlap}});
  p.velocity(0) = Vec3(v0, 0, 0);
  Walls planes = floor_plane(0.5);
  const double weight = k_n() * overlap;
  double slip_work = 0;
  for (int step = 0; step < 400000 && !(step > 1000 && p.velocity(0).x() - R * p.spin(0).y() < 0); ++step) {
    p.clear_forces();
    const WallTotals totals = planes.compute(p, grain(), dt);
    slip_work += totals.slip_work;
    p.add_force(0, std::as_const(p).position(0), Vec3(0, 0, -weight));  // stays in vertical balance
    move(p, dt);
  }
  const double lost = 0.5 * p.mass(0) * v0 * v0 * 2 / 7;  // 1 - (5/7)^2 - 0.4 (5/7)^2 = 2/7
  INFO("rolling speed " << p.velocity(0).x() << ", 5/7 = " << 5.0 / 7 << "; slip work " << slip_work << " J, lost "
                        << lost);
  CHECK(p.velocity(0).x() == Approx(5.0 / 7 * v0).epsilon(1e-3));
  CHECK(slip_work == Approx(lost).epsilon(1e-2));
}

TEST_CASE("A frictionless bounce on a plane gives the speed back") {
  // The leap-frog conserves a discrete energy exactly for a linear spring; the incoming and outgoing speeds differ only
  // by where the first and last step fall: of order (w dt)^2.
  Particles p = spheres_at({{0, 0, R + 1e-5}});
  const double omega = std::sqrt(k_n() / p.mass(0)), dt = 0.01 / omega;
  p.velocity(0) = Vec3(0.3, 0, -1);
  Walls planes = floor_plane();
  double touched = 0;
  for (int step = 0; step < 1000; ++step) {
    p.clear_forces();
    touched += static_cast<double>(planes.compute(p, grain(), dt).contacts);
    move(p, dt);
  }
  INFO("v_z after " << p.velocity(0).z() << " m/s; contact lasted " << touched * dt * omega / pi << " half periods");
  CHECK(p.velocity(0).z() == Approx(1).epsilon(1e-4));
  CHECK(p.velocity(0).x() == 0.3);
  CHECK(touched * dt * omega == Approx(pi).epsilon(0.01));
}

TEST_CASE("A dashpot lets a sphere bounce off a plane at the restitution it stands for") {
  // contact_law.hpp: zeta = damping_ratio(e); a wall is a body without end, m_eff = m.
  const double restitution = 0.8;
  GrainMaterial material = grain();
  material.damping_ratio = damping_ratio(restitution);
  Particles p = spheres_at({{0, 0, R + 1e-5}});
  const double dt = 0.002 / std::sqrt(k_n() / p.mass(0));
  p.velocity(0) = Vec3(0, 0, -1);
  Walls planes = floor_plane();
  double dashpot_work = 0;
  for (int step = 0; step < 5000; ++step) {
    p.clear_forces();
    dashpot_work += planes.compute(p, material, dt).dashpot_work;
    move(p, dt);
  }
  const double lost = 0.5 * p.mass(0) * (1 - p.velocity(0).z() * p.velocity(0).z());
  INFO("restitution " << p.velocity(0).z() << "; dashpot " << dashpot_work << " J of " << lost << " J lost");
  CHECK(p.velocity(0).z() == Approx(restitution).epsilon(0.02));
  CHECK(p.velocity(0).z() < 0.9);
  CHECK(dashpot_work == Approx(lost).epsilon(0.05));
}

TEST_CASE("A moving plane's power is the power its grains receive") {
  Particles p = spheres_at({{0, 0, R - 2e-4}, {0.1, 0, R - 1e-4}});
  Walls planes = walls_of({{Vec3::Zero(), Vec3::UnitZ(), Vec3(0.1, 0, 0.2)}}, 0.5);
  const WallTotals totals = planes.compute(p, grain(), 1e-4);
  const double expected = (p.force(0) + p.force(1)).dot(Vec3(0.1, 0, 0.2));
  CAPTURE(totals.power, expected);
  CHECK(totals.power == Approx(expected).epsilon(1e-14));
  CHECK(p.force(0).x() > 0);  // dragged along
}

TEST_CASE("Two planes that meet press a sphere from both sides, and each has its own totals and spring") {
  Particles p = spheres_at({{R - 1e-4, 0, R - 2e-4}});
  p.velocity(0) = Vec3(0, 1, 0);
  Walls planes =
      walls_of({{Vec3::Zero(), Vec3::UnitZ(), Vec3::Zero()}, {Vec3::Zero(), Vec3::UnitX(), Vec3::Zero()}}, 10);
  planes.compute(p, grain(), 1e-5);
  p.clear_forces();
  const WallTotals totals = planes.compute(p, grain(), 1e-5);
  REQUIRE(totals.contacts == 2);
  CHECK(planes.totals()[0].force.z() == Approx(-k_n() * 2e-4));
  CHECK(planes.totals()[1].force.x() == Approx(-k_n() * 1e-4));
  // Two steps of 1e-5 m at k_s = k_n/8 on each plane.
  const double shear = k_n() / 8 * 2e-5;
  CAPTURE(p.force(0).y(), shear);
  CHECK(planes.totals()[0].force.y() == Approx(shear).epsilon(1e-12));
  CHECK(planes.totals()[1].force.y() == Approx(shear).epsilon(1e-12));
}

TEST_CASE("The point of the pile closest to a grain is on the face, the rim, the shaft or the cone") {
  const double a = 0.125, tip = -4;
  const Pile flat(PileShape{}, tip);
  const auto check = [](const PilePoint& at, PilePart part, double distance, const Vec3& normal) {
    INFO("distance " << at.distance << " of " << distance << ", normal " << at.outward_normal.transpose());
    CHECK(at.part == part);
    CHECK(at.distance == Approx(distance).epsilon(1e-12));
    CHECK((at.outward_normal - normal).norm() < 1e-12);
  };
  check(flat.closest({0.05, 0.02, tip - 0.029}), PilePart::Face, 0.029, -Vec3::UnitZ());
  check(flat.closest({0, 0, tip - 0.029}), PilePart::Face, 0.029, -Vec3::UnitZ());
  check(flat.closest({0, a + 0.02, -2}), PilePart::Shaft, 0.02, Vec3::UnitY());
  check(flat.closest({0, -a - 0.02, 100}), PilePart::Shaft, 0.02, -Vec3::UnitY());
  check(flat.closest({a + 0.003, 0, tip - 0.004}), PilePart::Rim, 0.005, Vec3(0.6, 0, -0.8));
  // Inside: out through the nearer surface.
  check(flat.closest({0, 0, tip + 0.01}), PilePart::Face, -0.01, -Vec3::UnitZ());
  check(flat.closest({a - 0.01, 0, tip + 0.02}), PilePart::Shaft, -0.01, Vec3::UnitX());
  check(flat.closest({0, 0, -1}), PilePart::Shaft, -a, Vec3::UnitX());

  // 60 degrees: the cone's normal points 30 degrees below the horizontal.
  const Pile pointed(cone(pi / 3), tip);
  const double height = a * std::sqrt(3.0);
  CHECK(pointed.rim_z() == Approx(tip + height));
  const Vec3 normal(std::cos(pi / 6), 0, -0.5), middle(a / 2, 0, tip + height / 2);
  check(pointed.closest(middle + 0.02 * normal), PilePart::Face, 0.02, normal);
  check(pointed.closest(middle - 0.01 * normal), PilePart::Face, -0.01, normal);
  check(pointed.closest({0, 0, tip - 0.01}), PilePart::Face, 0.01, -Vec3::UnitZ());
  const double beta = -pi / 12;  // between the cone's normal and the shaft's
  const Vec3 rim_normal(std::cos(beta), 0, std::sin(beta));
  check(pointed.closest(Vec3(a, 0, tip + height) + 0.02 * rim_normal), PilePart::Rim, 0.02, rim_normal);
  check(pointed.closest({a + 0.01, 0, tip + height + 1e-6}), PilePart::Shaft, 0.01, Vec3::UnitX());
}

TEST_CASE("The distance to the pile is continuous and its gradient is the normal, inside and outside") {
  // Central differences; across the inner ridge, where two surfaces are equally near, only continuity can hold.
  Random random(7);
  const double h = 1e-6;
  double worst_gradient = 0, worst_jump = 0;
  for (const Pile& pile : {Pile(PileShape{}, 0), Pile(cone(pi / 3), 0)})
    for (int i = 0; i < 2000; ++i) {
      const Vec3 x(random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2), random.uniform(-0.1, 0.4));
      const PilePoint at = pile.closest(x);
      Vec3 gradient;
      for (int k = 0; k < 3; ++k) {
        const Vec3 d = h * Vec3::Unit(k);
        const double up = pile.closest(x + d).distance, down = pile.closest(x - d).distance;
        gradient[k] = (up - down) / (2 * h);
        worst_jump = std::max({worst_jump, std::abs(up - at.distance), std::abs(down - at.distance)});
      }
      if (at.distance > 0) worst_gradient = std::max(worst_gradient, (gradient - at.outward_normal).norm());
    }
  CAPTURE(worst_gradient, worst_jump);
  CHECK(worst_gradient < 1e-4);
  CHECK(worst_jump < 1.001 * h);
}

TEST_CASE("A shaft that moves down drags grains down and is pushed up itself") {
  const double v = -0.1, dt = 1e-5, overlap = 1e-4;
  Particles p = spheres_at({{0.125 + R - overlap, 0, -1}});
  Pile pile(PileShape{}, -4, 1.0);
  pile.set_velocity(v);
  const PileTotals totals = pile.compute(p, grain(), dt);
  const double drag = k_n() / 8 * v * dt;  // the spring of one step, down
  CAPTURE(p.force(0).z(), totals.shaft_force.z(), drag);
  CHECK(totals.shaft.contacts == 1);
  CHECK(totals.tip.contacts == 0);
  CHECK(p.force(0).z() == Approx(drag).epsilon(1e-12));
  CHECK(p.force(0).z() < 0);
  CHECK(totals.shaft_force.z() > 0);
  CHECK(p.force(0).x() == Approx(k_n() * overlap).epsilon(1e-10));
  CHECK(totals.shaft.power > 0);  // the pile does work on the grain
  CHECK(totals.shaft.power == Approx(p.force(0).z() * v).epsilon(1e-12));

  pile.set_friction(0);
  pile.clear_history();
  p.clear_forces();
  CHECK(pile.compute(p, grain(), dt).shaft_force.z() == 0);
}

TEST_CASE("Grains below the tip push it up; the rim counts for the tip") {
  const double overlap = 1e-4, a = 0.125;
  Particles p = spheres_at(
      {{0, 0, -4 - R + overlap}, {a + 0.6 * (R - overlap), 0, -4 - 0.8 * (R - overlap)}, {0, a + R - overlap, -3}});
  Pile pile(PileShape{}, -4, 0);
  const PileTotals totals = pile.compute(p, grain(), 1e-5);
  CHECK(totals.tip.contacts == 2);
  CHECK(totals.shaft.contacts == 1);
  const double f = k_n() * overlap;
  CAPTURE(totals.tip_force.transpose(), totals.shaft_force.transpose(), f);
  CHECK((totals.tip_force - Vec3(-0.6 * f, 0, 1.8 * f)).norm() < 1e-9 * f);
  CHECK((totals.shaft_force - Vec3(0, -f, 0)).norm() < 1e-9 * f);
  CHECK(pile.tip_area() == Approx(pi * a * a));
  CHECK(totals.tip_stiffness == Approx(2 * k_n()));
  CHECK(totals.one_contact_stiffness == Approx(k_n()));
  const Vec3 sum = p.force(0) + p.force(1) + p.force(2) + totals.all().force;
  INFO("sum of forces on grains and pile " << sum.norm() << " N");
  CHECK(sum.norm() <= 1e-15 * 3 * f);
}

TEST_CASE("A grain that rolls from the face over the rim to the shaft feels no jump") {
  // Overlap is held on a path around the rim; the normal force stays k_n U and its direction turns by at most the step.
  const double overlap = 1e-4, d = R - overlap, a = 0.125;
  Particles p = spheres_at({{a - 0.01, 0, -d}});
  Pile pile(PileShape{}, 0, 0);
  Vec3 last = Vec3::Zero();
  double worst = 0;
  const int steps = 2000;
  for (int i = 0; i <= steps; ++i) {
    const double s = i * (0.02 + d * pi / 2) / steps - 0.01;  // length along the path, 0 below the rim
    const double angle = std::clamp(s / d, 0.0, pi / 2);
    p.position(0) =
        Vec3(a + d * std::sin(angle) + std::min(0.0, s), 0, -d * std::cos(angle) + std::max(0.0, s - d * pi / 2));
    p.place_pebbles();
    p.clear_forces();
    REQUIRE(pile.compute(p, grain(), 0).all().contacts == 1);
    if (i > 0) worst = std::max(worst, (p.force(0) - last).norm() / (k_n() * overlap));
    last = p.force(0);
  }
  const double turn = (0.02 + d * pi / 2) / steps / d;
  CAPTURE(worst, turn);
  CHECK(worst < 1.01 * turn);
}

TEST_CASE("The pile's spring follows a grain over the rim") {
  // Stuck to the pile (friction without end) and moved along y: the spring lies along y on face and rim alike.
  const double overlap = 1e-4, d = R - overlap, a = 0.125, v = 0.01, dt = 1e-4;
  Particles p = spheres_at({{a, 0, -d}});
  p.velocity(0) = Vec3(0, v, 0);
  Pile pile(PileShape{}, 0, 1e9);
  for (int i = 0; i < 20; ++i) {
    const double angle = 0.02 * (i - 10);
    p.position(0) =
        Vec3(a + d * std::max(0.0, std::sin(angle)) - 0.001 * (i < 10), 0, -d * (angle > 0 ? std::cos(angle) : 1.0));
    p.place_pebbles();
    p.clear_forces();
    pile.compute(p, grain(), dt);
  }
  const double expected = -20 * v * dt * k_n() / 8;
  CAPTURE(p.force(0).y(), expected);
  CHECK(p.force(0).y() == Approx(expected).epsilon(1e-9));
}

TEST_CASE("What a moving pile does in work is what its grain has in energy") {
  // A pile strikes a free sphere without friction: kinetic and elastic energy = sum F_grain . v dt, the leap-frog's
  // error is of order (w dt)^2. When they part the sphere flies at twice the pile's speed.
  Particles p = spheres_at({{0.02, 0.01, -R - 1e-6}});
  Pile pile(PileShape{}, 0, 0);
  const double v = -0.5, omega = std::sqrt(k_n() / p.mass(0)), dt = 0.005 / omega;
  pile.set_velocity(v);
  double work = 0, worst = 0;
  for (int step = 0; step < 1000; ++step) {
    p.clear_forces();
    const PileTotals totals = pile.compute(p, grain(), dt);
    const double mid_speed = p.velocity(0).z() + 0.5 * p.force(0).z() / p.mass(0) * dt;
    const double half_work = 0.5 * totals.tip.power * dt;  // up to t_n
    const double energy = 0.5 * p.mass(0) * mid_speed * mid_speed + totals.tip.elastic_energy;
    worst = std::max(worst, std::abs(work + half_work - energy));
    work += totals.tip.power * dt;
    move(p, dt);
    pile.advance(dt);
  }
  const double whole = 0.5 * p.mass(0) * 4 * v * v;
  INFO("worst |work - energy| / work " << worst / whole << ", final speed / 2 v " << p.velocity(0).z() / (2 * v));
  CHECK(worst < 1e-3 * whole);
  CHECK(p.velocity(0).z() == Approx(2 * v).epsilon(1e-4));
}

TEST_CASE("Lists of candidates do not change the answer") {
  // A cloud that drifts past planes and pile: lists that bear 0.01 m of travel, against a look at every pebble in each
  // step. Both see the same cloud, so every bit must be the same.
  Random random(3);
  Vec3s centers;
  for (int i = 0; i < 300; ++i)
    centers.push_back({random.uniform(-0.4, 0.4), random.uniform(-0.4, 0.4), random.uniform(-0.3, 0.3)});
  Particles p = spheres_at(centers), q = p;
  Pile pile(cone(pi / 2), 0, 0.5), fresh_pile = pile;
  Walls planes = walls_of(
      {{Vec3(0, 0, -0.3), Vec3::UnitZ(), Vec3(0, 0, 1)}, {Vec3(0.4, 0, 0), -Vec3::UnitX(), Vec3::Zero()}}, 0.5);
  planes.set_spin(0, {0.3, 0, 0});
  Walls fresh_planes = planes;
  pile.set_velocity(-2);
  fresh_pile.set_velocity(-2);
  Marks marks(0.01);
  std::size_t contacts = 0, candidates = 0;
  for (int step = 0; step < 300; ++step) {
    for (std::size_t b = 0; b < p.body_count(); ++b)
      p.position(b) += random.uniform() * random.uniform() * 0.003 *
                       Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    p.place_pebbles();
    p.clear_forces();
    q = p;
    const TravelLimits& limits = marks.renew_if_needed(p);
    contacts += planes.compute(p, grain(), 1e-4, limits).contacts;
    contacts += pile.compute(p, grain(), 1e-4, limits).all().contacts;
    candidates += planes.candidates() + pile.candidates();
    fresh_planes.compute(q, grain(), 1e-4);
    fresh_pile.compute(q, grain(), 1e-4);
    Hash with, without;
    planes.hash(with), pile.hash(with), with.add(std::span<const Vec3>(forces_on(p)));
    fresh_planes.hash(without), fresh_pile.hash(without), without.add(std::span<const Vec3>(forces_on(q)));
    REQUIRE(with.value() == without.value());
    for (auto* w : {&planes, &fresh_planes}) w->advance(3e-4);
    for (auto* w : {&pile, &fresh_pile}) w->advance(3e-4);
  }
  INFO(contacts << " contacts, " << candidates << " candidates of " << 300 * 300 * 3 << ", lists " << planes.renewals()
                << " and " << pile.renewals());
  CHECK(contacts > 1000);
  CHECK(candidates < 300 * 300 * 3 / 3);
  CHECK(pile.renewals() < 200);
}

TEST_CASE("A pebble far from every wall costs nothing between two renewals") {
  // 1,000 spheres 2 m above the floor, which stand for a thousand steps: one list, and nobody on it.
  Vec3s centers;
  for (int i = 0; i < 1000; ++i) centers.push_back({0.1 * (i % 10), 0.1 * (i / 10 % 10), 2 + 0.1 * (i / 100)});
  Particles p = spheres_at(centers);
  Walls planes = floor_plane();
  Pile pile(PileShape{}, -4);
  Marks marks(0.005);
  for (int step = 0; step < 1000; ++step) {
    const TravelLimits& limits = marks.renew_if_needed(p);
    planes.compute(p, grain(), 1e-4, limits);
    planes.advance(1e-4);
  }
  CHECK(planes.renewals() == 1);
  CHECK(planes.candidates() == 0);
}

TEST_CASE("Walls refuse shapes that have no surface") {
  CHECK_THROWS_AS(walls_of({{Vec3::Zero(), Vec3::Zero(), Vec3::Zero()}}), InputError);
  PileShape shape;
  shape.radius = 0;
  CHECK_THROWS_AS(Pile(shape, 0), InputError);
  CHECK_THROWS_AS(Pile(cone(pi), 0), InputError);
}

TEST_CASE("What lies behind a wall is known for planes, endless cylinders and solid bodies, shells have no behind") {
  const auto is_behind = [](const WallShape& shape, const Vec3& x) {
    WallSettings one;
    one.shape = shape;
    return Walls(std::vector<WallSettings>{one}).is_behind(x);
  };
  const PlaneShape floor{Vec3(0, 0, 1), Vec3::UnitZ()};
  CHECK(is_behind(floor, {0, 0, 0.9}));
  CHECK_FALSE(is_behind(floor, {0, 0, 1.1}));
  const CylinderShape drum{Vec3::Zero(), Vec3::UnitY(), 0.5, Side::Inside};
  CHECK(is_behind(drum, {0.6, 3, 0}));
  CHECK_FALSE(is_behind(drum, {0.4, 3, 0}));
  const FrustumShape rod{Vec3::Zero(), Vec3::UnitZ(), 0.5, 0.2, 1, Side::Outside};
  CHECK(is_behind(rod, {0.3, 0, 0.5}));
  CHECK_FALSE(is_behind(rod, {0.4, 0, 0.5}));
  CHECK_FALSE(is_behind(rod, {0, 0, 1.1}));
  FrustumShape funnel = rod;
  funnel.side = Side::Inside;
  CHECK_FALSE(is_behind(funnel, {0.3, 0, 0.5}));
  CHECK_FALSE(is_behind(funnel, {0.4, 0, 0.5}));
  // Where a wall stands now counts: 0.2 m lower after a second.
  WallSettings sinking;
  sinking.shape = floor;
  sinking.velocity = {0, 0, -0.2};
  Walls walls(std::vector<WallSettings>{sinking});
  walls.advance(1);
  CHECK_FALSE(walls.is_behind({0, 0, 0.9}));
  CHECK(walls.is_behind({0, 0, 0.7}));
}
