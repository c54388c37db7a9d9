#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "dem_server/measure.hpp"
#include "tests/dem_server/free_grains.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

// 6 x 6 x 6 grains on a jittered lattice, moving at random and loosely confined by nothing: they collide and part.
FreeGrains cloud(int pebbles, double skin, std::optional<Vec3> period = {}) {
  FreeGrains world(skin, period);
  world.material.contact_modulus = 1e6;  // clumps overlap at the start: soft ones part without a bang
  Random random(7);
  const ClumpTemplate shape = make_clump(pebbles, 1.5);
  const double spacing = 0.056;
  for (int k = 0; k < 216; ++k) {
    const Vec3 cell(k % 6, k / 6 % 6, k / 36);
    const double jx = random.uniform(-0.1, 0.1), jy = random.uniform(-0.1, 0.1), jz = random.uniform(-0.1, 0.1);
    const std::int32_t b = world.particles.add(shape, random.uniform(0.024, 0.030), 2650,
                                               spacing * (cell + Vec3(jx, jy, jz)), random.rotation());
    const Vec3 inward = Vec3(2.5, 2.5, 2.5) - cell;
    world.particles.velocity(b) = 0.2 * inward + Vec3(random.uniform(-1, 1), random.uniform(-1, 1), 0);
    world.particles.spin(b) = Vec3(random.uniform(-9, 9), random.uniform(-9, 9), random.uniform(-9, 9));
  }
  return world;
}

struct Bounce {
  double restitution, duration;
};

// Two equal spheres meet head-on at 1 m/s.
Bounce bounce(double damping_share, double dt) {
  FreeGrains world;
  world.material.damping_ratio = damping_share;
  const double r = 0.03;
  world.sphere(Vec3(-r, 0, 0), r);
  world.sphere(Vec3(r, 0, 0), r);
  world.particles.velocity(0).x() = 0.5;
  world.particles.velocity(1).x() = -0.5;
  // v(-1/2) and v(1/2) are equal at a force-free t_0: the gap closes at t = 0 exactly.
  double time = 0, previous_gap = 0;
  while (true) {
    world.step(dt);
    time += dt;
    const double gap = world.particles.position(1).x() - world.particles.position(0).x() - 2 * r;
    if (gap > 0) {
      const double part = previous_gap / (previous_gap - gap);  // linear between two steps
      world.step(dt);
      return {world.particles.velocity(1).x() - world.particles.velocity(0).x(), time - dt + part * dt};
    }
    previous_gap = gap;
  }
}

}  // namespace

TEST_CASE("an undamped bounce lasts half a period and gives the speed back, to second order") {
  // m_eff u'' = -k u: duration pi sqrt(m_eff / k), m_eff = m/2, k = E* 2 r.
  const double r = 0.03, mass = 2650 * 4.0 / 3.0 * pi * r * r * r, k = 94e6 * 2 * r;
  const double half_period = pi * std::sqrt(0.5 * mass / k);
  const Bounce coarse = bounce(0, half_period / 50.3), fine = bounce(0, half_period / 201.2);
  const double coarse_error = coarse.duration / half_period - 1, fine_error = fine.duration / half_period - 1;
  CAPTURE(half_period, coarse_error, fine_error, coarse.restitution - 1, fine.restitution - 1);
  CHECK(std::abs(coarse_error) < 1e-3);
  CHECK(std::abs(fine_error) < 1e-3 / 12);
  CHECK(std::abs(fine.restitution - 1) < 1e-3);
  CHECK(std::abs(fine.restitution - 1) < 0.15 * std::abs(coarse.restitution - 1) + 1e-9);
}

TEST_CASE("a damped bounce gives back the restitution asked for") {
  const double r = 0.03, mass = 2650 * 4.0 / 3.0 * pi * r * r * r, k = 94e6 * 2 * r;
  const double half_period = pi * std::sqrt(0.5 * mass / k);
  for (const double restitution : {0.9, 0.5, 0.1}) {
    const double error = bounce(damping_ratio(restitution), half_period / 2000).restitution / restitution - 1;
    const double coarse = bounce(damping_ratio(restitution), half_period / 500).restitution / restitution - 1;
    CAPTURE(restitution, error, coarse);
    CHECK(std::abs(error) < 5e-3);
    CHECK(std::abs(error) < 0.5 * std::abs(coarse) + 1e-4);
  }
}

TEST_CASE("a sphere that slides on a wide fixed one ends up rolling at 5/7 of its speed") {
  // Friction f acts until v = w r: m dv = -f dt, 2/5 m r dw = f dt  =>  v_end = 5/7 v_0, whatever f. The floor is a
  // fixed sphere of 1e4 radii, flat over the way travelled; gravity is on top of a contact settled at U = m g / k.
  FreeGrains world;
  const double r = 0.05, floor = 500, v0 = 0.5, g = 9.81;
  world.sphere(Vec3(0, 0, -floor), floor, 1);
  world.material.contact_modulus = 1e4;  // the floor's radius is in the pair's stiffness
  world.material.friction = 0.3;
  const double mass = 2650 * 4.0 / 3.0 * pi * r * r * r, k = 1e4 * (floor + r);
  world.sphere(Vec3(0, 0, r - mass * g / k), r);
  world.particles.velocity(1).x() = v0;
  MotionTotals motion;
  const std::vector<char> fixed = {1, 0};
  const double dt = 0.05 * std::sqrt(mass / k);
  // Slides for 2/7 v0 / (mu g) = 0.049 s; then the shear spring rings undamped, and rolling is its mean over many
  // periods.
  double v = 0, slip = 0;
  int samples = 0;
  for (double time = 0; time < 0.15; time += dt) {
    world.particles.clear_forces();
    world.contacts.update(world.particles);
    world.contacts.compute(world.particles, world.material, dt);
    integrate(world.particles, Vec3(0, 0, -g), dt, dt, 0, {&fixed});
    if (time < 0.06) continue;
    v += world.particles.velocity(1).x();
    slip += (world.particles.velocity(1).x() - world.particles.spin(1).y() * r) / v0;
    ++samples;
  }
  v /= samples;
  slip /= samples;
  const double error = v / v0 - 5.0 / 7;
  CAPTURE(error, slip);
  CHECK(std::abs(error) < 2e-3);
  CHECK(std::abs(slip) < 4e-3);
}

TEST_CASE("a colliding cloud keeps momentum and angular momentum to round-off") {
  for (int pebbles : {1, 3}) {
    FreeGrains world = cloud(pebbles, 0.004);
    world.material.friction = 0.7;
    world.material.damping_ratio = 0.1;
    const Vec3 momentum = world.momentum(), angular = world.angular_momentum();
    double mass_speed = 0;
    for (std::size_t b = 0; b < world.particles.body_count(); ++b)
      mass_speed += world.particles.mass(b) * world.particles.velocity(b).norm();
    std::int64_t touches = 0;
    for (int k = 0; k < 1000; ++k) {
      world.step(3e-5);
      touches += world.totals.active;
    }
    const double error = (world.momentum() - momentum).norm() / mass_speed;
    const double angular_error = (world.angular_momentum() - angular).norm() / (mass_speed * 0.1);
    CAPTURE(pebbles, touches, error, angular_error);
    CHECK(touches > 5000);
    CHECK(error < 1e-13);
    CHECK(angular_error < 1e-12);
  }
}

TEST_CASE("bits do not depend on the skin of the lists, nor on when they are renewed") {
  for (int pebbles : {1, 3}) {
    FreeGrains tight = cloud(pebbles, 0.0006), wide = cloud(pebbles, 0.004), disturbed = cloud(pebbles, 0.004);
    for (int k = 0; k < 400; ++k) {
      tight.step(3e-5);
      wide.step(3e-5);
      if (k % 37 == 0) disturbed.contacts.restore(disturbed.particles, disturbed.contacts.springs());
      disturbed.step(3e-5);
    }
    CAPTURE(pebbles, tight.contacts.refreshes(), wide.contacts.refreshes(), tight.contacts.rebuilds());
    CHECK(tight.contacts.refreshes() > 2 * wide.contacts.refreshes());
    CHECK(tight.state_hash() == wide.state_hash());
    CHECK(disturbed.state_hash() == wide.state_hash());
  }
}

TEST_CASE("lists find every touching pair that a search of all pairs finds") {
  FreeGrains world = cloud(3, 0.002);
  for (int k = 0; k < 300; ++k) world.step(3e-5);
  world.particles.clear_forces();
  world.contacts.update(world.particles);
  const ContactTotals totals = world.contacts.compute(world.particles, world.material, 3e-5);
  const Particles& p = world.particles;
  std::int64_t touching = 0;
  for (std::size_t i = 0; i < p.pebble_count(); ++i)
    for (std::size_t j = i + 1; j < p.pebble_count(); ++j)
      touching += p.pebble_body(i) != p.pebble_body(j) &&
                  (p.pebble_center(i) - p.pebble_center(j)).norm() < p.pebble_radius(i) + p.pebble_radius(j);
  std::int64_t visited = 0;
  Vec3 force = Vec3::Zero();
  world.contacts.for_each_contact(world.particles, [&](const ContactView& c) {
    ++visited;
    if (c.body_a == 100) force += c.force_on_a;
    if (c.body_b == 100) force -= c.force_on_a;
  });
  const double force_error = (force - p.force(100)).norm();
  CAPTURE(touching, totals.active, force.norm(), force_error);
  CHECK(force_error <= 1e-12 * force.norm());
  CHECK(totals.active == touching);
  CHECK(visited == touching);
}

TEST_CASE("an undamped frictionless cloud keeps its energy, to second order in the step") {
  for (int pebbles : {1, 3}) {
    const auto worst_error = [&](double dt) {
      FreeGrains world = cloud(pebbles, 0.003);
      world.material.friction = 0;
      world.material.contact_modulus = 5e6;
      const int steps = static_cast<int>(std::lround(0.01 / dt));
      double start = 0, worst = 0;
      for (int k = 0; k < steps; ++k) {
        world.step(dt);
        if (k == 0) start = world.energy();
        worst = std::max(worst, std::abs(world.energy() / start - 1));
      }
      return worst;
    };
    const double coarse = worst_error(4e-5), fine = worst_error(1e-5);
    CAPTURE(pebbles, coarse, fine, std::log(coarse / fine) / std::log(4.0));
    CHECK(fine < 1e-3);
    CHECK(std::log(coarse / fine) / std::log(4.0) > 1.6);
  }
}

TEST_CASE("friction's ledger closes: kinetic plus elastic plus slip is constant") {
  const auto imbalance = [&](double dt) {
    FreeGrains world = cloud(1, 0.003);
    world.material.contact_modulus = 5e6;
    world.material.friction = 0.5;
    const int steps = static_cast<int>(std::lround(0.01 / dt));
    double start = 0;
    for (int k = 0; k < steps; ++k) {
      world.step(dt);
      if (k == 0) start = world.energy() + world.slip_work;
    }
    CHECK(world.slip_work > 0.02 * start);
    return std::abs((world.energy() + world.slip_work) / start - 1);
  };
  const double coarse = imbalance(4e-5), fine = imbalance(1e-5);
  CAPTURE(coarse, fine);
  CHECK(fine < 2e-3);
  CHECK(fine < 0.4 * coarse);
}

TEST_CASE("turning a loaded pair as a whole turns its force with it") {
  // Two spheres pressed and sheared, then turned rigidly about z in 500 steps of prescribed motion: the shear force
  // along z and the one in the plane must both come along unchanged in size. The prescribed velocity is tangential, theta/dt
  // instead of the chord's sin(theta)/dt, theta = pi/1000: the turn errs by theta^4/12 a step, 4e-9 in all.
  FreeGrains world;
  const double r = 0.03, dt = 1e-5;
  world.sphere(Vec3(-r + 1e-5, 0, 0), r);
  world.sphere(Vec3(r - 1e-5, 0, 0), r);
  world.particles.velocity(1) = Vec3(0, 0.02, 0.05);
  const auto touch = [&] {
    world.particles.clear_forces();
    world.contacts.update(world.particles);
    world.contacts.compute(world.particles, world.material, dt);
  };
  touch();
  const Vec3 loaded = world.particles.force(0);
  REQUIRE(std::abs(loaded.y()) > 0.1);
  const double spin = 0.5 * pi / (500 * dt);
  for (int k = 1; k <= 500; ++k) {
    const Quat turn(Eigen::AngleAxisd(0.5 * pi * k / 500, Vec3::UnitZ()));
    for (int b : {0, 1}) {
      world.particles.position(b) = turn * Vec3((b == 0 ? -1 : 1) * (r - 1e-5), 0, 0);
      world.particles.velocity(b) = Vec3(0, 0, spin).cross(world.particles.position(b));
      world.particles.spin(b) = Vec3(0, 0, spin);
    }
    world.particles.place_pebbles();
    touch();
  }
  const Vec3 expected(-loaded.y(), loaded.x(), loaded.z());
  const double error = (world.particles.force(0) - expected).norm() / loaded.norm();
  CAPTURE(loaded.transpose(), world.particles.force(0).transpose(), error);
  CHECK(error < 5e-9);
}

TEST_CASE("contacts act across the faces of a periodic cell as they do inside it") {
  // The same pair, once in the middle and once astride a face, an edge and a corner, and once a whole cell outside.
  const Vec3 period(0.3, 0.3, 0.3);
  const auto force_at = [&](const Vec3& at, const Vec3& image) {
    FreeGrains world(0.003, period);
    world.sphere(at, 0.03);
    world.sphere(at + Vec3(0.05, 0.02, 0.02) + image, 0.03);
    world.contacts.update(world.particles);
    world.contacts.compute(world.particles, world.material, 1e-5);
    return Vec3(world.particles.force(1));
  };
  const Vec3 inside = force_at(Vec3(0.1, 0.1, 0.1), Vec3::Zero());
  REQUIRE(inside.norm() > 1);
  const double face = (force_at(Vec3(0.28, 0.1, 0.1), Vec3(-0.3, 0, 0)) - inside).norm() / inside.norm();
  const double corner = (force_at(Vec3(0.28, 0.29, 0.29), Vec3(-0.3, -0.3, -0.3)) - inside).norm() / inside.norm();
  const double outside = (force_at(Vec3(0.88, 0.1, 0.1), Vec3(-0.9, 0, 0)) - inside).norm() / inside.norm();
  CAPTURE(face, corner, outside);
  CHECK(face < 1e-9);
  CHECK(corner < 1e-9);
  CHECK(outside < 1e-9);
}

TEST_CASE("a squeezed cubic lattice has the modulus k/(2R) along its axes") {
  // Periodic 5^3 cell of touching spheres, squeezed by e along x: each contact along x closes by 2 R e, force k 2 R e
  // per area (2R)^2, so sigma_xx = k/(2R) e = E* e for k = E* 2R; the other directions carry nothing.
  const double r = 0.03, squeeze = 1e-4;
  FreeGrains world(0.003, Vec3(10 * r * (1 - squeeze), 10 * r, 10 * r));
  for (int k = 0; k < 125; ++k)
    world.sphere(Vec3((2 * (k % 5) + 1) * r * (1 - squeeze), (2 * (k / 5 % 5) + 1) * r, (2 * (k / 25) + 1) * r), r);
  world.contacts.update(world.particles);
  world.contacts.compute(world.particles, world.material, 1e-5);
  MeanStress stress(Box{Vec3::Zero(), Vec3(10 * r * (1 - squeeze), 10 * r, 10 * r)});
  world.contacts.for_each_branch(world.particles,
                                 [&](const ContactView& c, const Vec3& branch) { stress.add(c, branch); });
  const double modulus = -stress.stress()[0] / squeeze;
  const double error = modulus / 94e6 - 1;  // branch and volume are shorter by the same factor
  CAPTURE(modulus, error, stress.stress().transpose());
  CHECK(std::abs(error) < 1e-10);
  CHECK(std::abs(stress.stress()[1]) < 1e-6 * std::abs(stress.stress()[0]));
}

TEST_CASE("a compression wave runs along a chain at the speed of the discrete theory") {
  // Standing wave of wavelength N d in a periodic, slightly squeezed chain: omega = 2 sqrt(k/m) sin(pi/N) for mass
  // points on springs, and leap-frog turns it into sin(omega' dt/2) = omega dt/2. From the time of the first zero of
  // the amplitude.
  const int n = 16;
  const double r = 0.03, d = 2 * r * (1 - 1e-3);
  FreeGrains world(0.003, Vec3(n * d, n * d, n * d));
  for (int k = 0; k < n; ++k) world.sphere(Vec3((k + 0.5) * d, 0, 0), r);
  const double mass = world.particles.mass(0), stiffness = 94e6 * 2 * r, dt = 0.1 * std::sqrt(mass / stiffness);
  const double omega = 2 * std::sqrt(stiffness / mass) * std::sin(pi / n);
  const double omega_discrete = 2 / dt * std::asin(0.5 * omega * dt);
  for (int k = 0; k < n; ++k) world.particles.velocity(k).x() = 1e-3 * std::sin(2 * pi * k / n);
  // Velocity at t_{-1/2} is the same as at t_{1/2} at a force-free start: v(t) = v0 cos(omega (t)) / cos(omega dt / 2).
  double last = 1, time = 0.5 * dt, zero = 0;
  for (int step = 0; step < 1000 && zero == 0; ++step) {
    world.step(dt);
    double amplitude = 0;
    for (int k = 0; k < n; ++k) amplitude += world.particles.velocity(k).x() * std::sin(2 * pi * k / n);
    if (step > 0) time += dt;
    if (amplitude < 0) zero = time - dt * amplitude / (amplitude - last);
    last = amplitude;
  }
  const double error = zero / (0.5 * pi / omega_discrete) - 1;
  const double speed = n * d * omega_discrete / (2 * pi), long_wave = d * std::sqrt(stiffness / mass);
  CAPTURE(error, speed, long_wave);
  CHECK(std::abs(error) < 1e-4);
}

TEST_CASE("a grain that is no longer at a finite place is named") {
  FreeGrains world = cloud(1, 0.003);
  world.step(1e-5);
  world.particles.position(17).y() = std::numeric_limits<double>::quiet_NaN();
  world.particles.place_pebbles();
  CHECK_THROWS_AS(world.contacts.update(world.particles), NumericalError);
  CHECK_THROWS_WITH(world.contacts.update(world.particles), Catch::Contains("grain 17"));
}

TEST_CASE("an empty crowd costs nothing and moves nowhere") {
  FreeGrains world;
  world.step(1e-5);
  CHECK(world.totals.active == 0);
  CHECK(world.energy() == 0);
}
