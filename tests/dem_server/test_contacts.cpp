#include <catch2/catch.hpp>
#include <map>
#include <utility>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "dem_server/constants.hpp"
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

// ------------------------------------------------------------------------- lanes against one pair at a time

namespace {

using Real = long double;
using Real3 = Eigen::Matrix<Real, 3, 1>;

Real3 real(const Vec3& v) { return v.cast<Real>(); }

constexpr double deepest_turn = 0.9;  // the kernel's: of r_i + r_j, beyond which a spring is only projected

// What one pair of pebbles gives, written from the formulas of contact_law.hpp and pair_kernel.cpp in numbers of 64 bits of
// mantissa, so that the difference is the kernel's own rounding.
struct PairTruth {
  bool touches = false;
  Real3 force_a = Real3::Zero(), torque_a = Real3::Zero(), torque_b = Real3::Zero(), spring = Real3::Zero();
  Real normal_force = 0, slip_work = 0, dashpot_work = 0, normal_energy = 0, shear_energy = 0, overlap_ratio = 0;
};

PairTruth one_pair(const Particles& p, std::size_t i, std::size_t j, const Vec3& old_spring, const GrainMaterial& m,
                   double dt) {
  const std::size_t a = p.pebble_body(i), b = p.pebble_body(j);
  const Real3 xi = real(p.pebble_center(i)), xj = real(p.pebble_center(j)), xa = real(p.position(a)),
              xb = real(p.position(b)), va = real(p.velocity(a)), vb = real(p.velocity(b)), wa = real(p.spin(a)),
              wb = real(p.spin(b));
  const Real ri = p.pebble_radius(i), rj = p.pebble_radius(j), size_a = p.equivalent_radius(a),
             size_b = p.equivalent_radius(b), ma = p.mass(a), mb = p.mass(b);
  PairTruth t;
  const Real distance = (xj - xi).norm(), overlap = ri + rj - distance;
  if (!(overlap > 0)) return t;
  t.touches = true;
  const Real3 n = distance > 0 ? Real3((xj - xi) / distance) : Real3(0, 0, 1);
  const Real3 point = xi + (ri - overlap / 2) * n;
  const auto velocity_at = [](const Real3& v, const Real3& w, const Real3& arm) -> Real3 { return v + w.cross(arm); };
  const Real3 v = velocity_at(vb, wb, point - xb) - velocity_at(va, wa, point - xa);
  const Real3 centers = velocity_at(vb, wb, xj - xb) - velocity_at(va, wa, xi - xa);
  const Real stiffness = m.contact_modulus * (size_a + size_b), shear = stiffness / m.stiffness_ratio;
  const Real dashpot = 2 * m.damping_ratio * std::sqrt(stiffness * ma * mb / (ma + mb));
  const Real elastic = stiffness * overlap;
  t.normal_force = std::max<Real>(0, elastic - dashpot * v.dot(n));
  t.dashpot_work = (elastic - t.normal_force) * v.dot(n) * dt;
  if (m.friction > 0) {
    const Real3 s0 = real(old_spring);
    const Real3 way = overlap < deepest_turn * (ri + rj) ? Real3(dt / distance * (centers - centers.dot(n) * n))
                                                         : Real3(Real3::Zero());
    const Real3 turned = s0 - s0.dot(n) * (n - way / 2);
    const Real3 whole = turned + shear * dt * (v - v.dot(n) * n);
    const Real limit = m.friction * t.normal_force, length = whole.norm();
    t.spring = length > limit ? Real3(limit / length * whole) : whole;
    if (length > limit) t.slip_work = (1 - limit / length) * (turned + t.spring).dot(whole) / (2 * shear);
    t.shear_energy = t.spring.squaredNorm() / (2 * shear);
  }
  t.force_a = t.spring - t.normal_force * n;
  t.torque_a = (point - xa).cross(t.force_a);
  t.torque_b = -(point - xb).cross(t.force_a);
  t.normal_energy = elastic * overlap / 2;
  t.overlap_ratio = overlap / std::min(size_a, size_b);
  return t;
}

// Pairs of bodies, each pair far from the others: bodies 2 k and 2 k + 1.
struct Pairs {
  Particles particles;
  std::vector<PairContacts::Spring> springs;
};

enum class Gap { Any, Touching, Coincident };

// Of pebbles on axes (both ways), or in random directions.
Pairs random_pairs(int count, int pebbles, double size_ratio, Gap gap, Random& random) {
  Pairs pairs;
  const auto vector = [&](double size) -> Vec3 {
    return size * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  };
  const ClumpTemplate shape = make_clump(pebbles, 1.5);
  for (int k = 0; k < count; ++k) {
    const double large = 0.03, small = large / random.uniform(1, size_ratio);
    const Vec3 base(k % 8, k / 8 % 8, k / 64);
    const bool swapped = k % 2 == 1;
    const std::int32_t a = pairs.particles.add(shape, swapped ? small : large, 2650, base, random.rotation());
    const std::int32_t b = pairs.particles.add(shape, swapped ? large : small, 2650, base, random.rotation());
    // Opposite directions in turn, along axes and across.
    Vec3 n = k % 3 == 0 ? Vec3(Vec3::Unit(k / 3 % 3)) : vector(1).normalized();
    if (k / 9 % 2 == 1) n = -n;
    const std::size_t i = pairs.particles.pebble_begin(a), j = pairs.particles.pebble_begin(b);
    const double reach = pairs.particles.pebble_radius(i) + pairs.particles.pebble_radius(j);
    double distance = reach * (1 - random.uniform(-1e-3, 0.3));
    if (gap == Gap::Touching) distance = reach;
    if (gap == Gap::Coincident) distance = 0;
    pairs.particles.position(b) += pairs.particles.pebble_center(i) + distance * n - pairs.particles.pebble_center(j);
    pairs.particles.place_pebbles(b);
    if (gap == Gap::Coincident && pebbles == 1) pairs.particles.position(b) = base;
    for (const std::int32_t body : {a, b}) {
      pairs.particles.velocity(body) = vector(1);
      pairs.particles.spin(body) = vector(20);
    }
  }
  // A spring for every pebble pair, nearly across the normal.
  const Particles& p = pairs.particles;
  for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k)
    for (std::int32_t i = p.pebble_begin(2 * k); i < p.pebble_end(2 * k); ++i)
      for (std::int32_t j = p.pebble_begin(2 * k + 1); j < p.pebble_end(2 * k + 1); ++j)
        pairs.springs.push_back({i, j, vector(1)});
  return pairs;
}

// Largest differences, each over its natural size: k_n (r_i + r_j) and the spring for forces (overlaps are differences of
// lengths of that size), times the radius for torques and energies.
struct Differences {
  double force = 0, torque = 0, spring = 0, sums = 0;
  std::int64_t touching = 0, sliding = 0, pulling = 0;
};

Differences compare(Pairs& pairs, const GrainMaterial& material, double dt, InstructionSet set) {
  Particles& p = pairs.particles;
  PairContacts contacts(0.005, {}, set);
  contacts.restore(p, pairs.springs);
  contacts.update(p);
  p.clear_forces();
  const ContactTotals totals = contacts.compute(p, material, dt);
  std::map<std::pair<std::int32_t, std::int32_t>, Vec3> after;
  for (const auto& spring : contacts.springs()) after[{spring.i, spring.j}] = spring.force;

  Differences worst;
  const auto raise = [](double& most, Real error, Real scale) {
    const double relative = static_cast<double>(std::abs(error) / scale);
    if (!(relative <= most)) most = relative;  // not a number counts as worst
  };
  Real slip = 0, dashpots = 0, normal_energy = 0, shear_energy = 0, normal_force = 0, contact_force = 0, ratio = 0;
  Real force_scale = 0, energy_scale = 0, ratio_scale = 1, slip_scale = 0;
  for (std::size_t k = 0; k < p.body_count(); k += 2) {
    Real3 force = Real3::Zero(), torque_a = Real3::Zero(), torque_b = Real3::Zero();
    Real scale = 0, lever = 0;
    const Real stiffness = material.normal_stiffness(p.equivalent_radius(k), p.equivalent_radius(k + 1));
    for (const auto& old : pairs.springs) {
      if (static_cast<std::size_t>(p.pebble_body(old.i)) != k) continue;
      const PairTruth t = one_pair(p, old.i, old.j, old.force, material, dt);
      const Vec3 spring = after.contains({old.i, old.j}) ? after[{old.i, old.j}] : Vec3(Vec3::Zero());
      if (!t.touches) {
        raise(worst.spring, spring.norm(), 1);  // a parted pair keeps none
        continue;
      }
      const Real reach = p.pebble_radius(old.i) + p.pebble_radius(old.j);
      const Real size = stiffness * reach + old.force.norm();
      raise(worst.spring, (real(spring) - t.spring).norm(), size);
      force += t.force_a, torque_a += t.torque_a, torque_b += t.torque_b;
      scale += size, lever = 2 * reach;
      ratio = std::max(ratio, t.overlap_ratio);
      ratio_scale = std::max(ratio_scale,
                             reach / static_cast<Real>(std::min(p.equivalent_radius(k), p.equivalent_radius(k + 1))));
      slip += t.slip_work, dashpots += t.dashpot_work, normal_force += t.normal_force;
      contact_force += t.force_a.norm(), normal_energy += t.normal_energy, shear_energy += t.shear_energy;
      energy_scale += size * reach;
      slip_scale +=
          t.slip_work + (material.friction > 0 ? material.stiffness_ratio / stiffness * size * old.force.norm() : 0);
      ++worst.touching;
      worst.sliding += t.slip_work > 0;
      worst.pulling += t.normal_force == 0;
    }
    if (scale == 0) continue;
    force_scale += scale;
    raise(worst.force, (real(p.force(k)) - force).norm(), scale);
    raise(worst.force, (real(p.force(k + 1)) + force).norm(), scale);
    // Moments are summed about the origin, and round off as the bodies' distances from there.
    raise(worst.torque, (real(p.torque(k)) - torque_a).norm(), scale * (lever + p.position(k).norm()));
    raise(worst.torque, (real(p.torque(k + 1)) - torque_b).norm(), scale * (lever + p.position(k + 1).norm()));
  }
  CHECK(totals.active == worst.touching);
  raise(worst.sums, totals.normal_force - normal_force, force_scale);
  raise(worst.sums, totals.contact_force - contact_force, force_scale);
  raise(worst.sums, totals.normal_energy - normal_energy, energy_scale);
  raise(worst.sums, totals.shear_energy - shear_energy, energy_scale + shear_energy);
  raise(worst.sums, totals.slip_work - slip, energy_scale + slip_scale);
  raise(worst.sums, totals.dashpot_work - dashpots, energy_scale + dashpots);
  raise(worst.sums, totals.largest_overlap_ratio - ratio, ratio_scale);
  return worst;
}

}  // namespace

TEST_CASE("eight lanes give what one pair at a time gives, to round-off, for any shape, friction and stiffness") {
  // A few dozen operations of 1.1e-16 each.
  constexpr double round_off = 1e-14;
  Random random(3);
  Differences all;
  for (const InstructionSet set : known_instructions())
    for (const int pebbles : {1, 2, 3})
      for (const double size_ratio : {1.0, 20.0})
        for (const double friction : {0.0, 0.5, 1e3})
          for (const double restitution : {1.0, 0.5})
            for (const double modulus : {1e4, 1e8, 2e12}) {  // k_n from 3e2 to 1.2e11 N/m
              Pairs pairs = random_pairs(27, pebbles, size_ratio, Gap::Any, random);
              GrainMaterial material;
              material.contact_modulus = modulus;
              material.friction = friction;
              material.damping_ratio = restitution < 1 ? damping_ratio(restitution) : 0;
              const Differences d = compare(pairs, material, 1e-5, set);
              CAPTURE(name_of(set), pebbles, size_ratio, friction, restitution, modulus, d.force, d.torque, d.spring,
                      d.sums);
              CHECK(d.touching >= 20);
              CHECK(d.force < round_off);
              CHECK(d.torque < round_off);
              CHECK(d.spring < round_off);
              CHECK(d.sums < round_off);
              all.touching += d.touching, all.sliding += d.sliding, all.pulling += d.pulling;
              all.force = std::max(all.force, d.force), all.torque = std::max(all.torque, d.torque);
              all.spring = std::max(all.spring, d.spring), all.sums = std::max(all.sums, d.sums);
            }
  CAPTURE(all.touching, all.sliding, all.pulling, all.force, all.torque, all.spring, all.sums);
  CHECK(all.sliding > 100);  // and not all
  CHECK(all.sliding < all.touching / 2);
  CHECK(all.pulling > 10);  // a dashpot would have pulled
}

TEST_CASE("clumps' twists are those of their motion, whoever made them, and what is changed by hand counts") {
  // v + x x w is three products and sums in one order, in lanes by the motion and in rows where something was changed since.
  const GrainMaterial material = [] {
    GrainMaterial m;
    m.contact_modulus = 1e6;
    m.damping_ratio = 0.3;  // forces that tell velocities
    return m;
  }();
  for (const InstructionSet set : known_instructions()) {
    FreeGrains world = cloud(3, 1e-3);
    Particles& p = world.particles;
    PairContacts contacts(1e-3, {}, set);
    MotionOptions options;
    options.instructions = set;
    contacts.update(p);
    contacts.compute(p, material, 1e-4);
    integrate(p, Vec3(0, 0, -9.81), 1e-4, 1e-4, 0.3, options);
    contacts.update(p);
    CAPTURE(name_of(set));
    REQUIRE(p.has_twists());
    const auto bits_of = [](const Particles& grains) {
      Hash h;
      for (std::size_t b = 0; b <= grains.body_count(); ++b) {
        const TwistRecord& t = grains.twists()[b];
        h.add(Vec3(t.vx, t.vy, t.vz)), h.add(Vec3(t.wx, t.wy, t.wz)), h.add(t.mass), h.add(t.radius);
      }
      return h.value();
    };
    Particles by_hand = p;
    CHECK(by_hand.motion()->mass > 0);  // may have been written to
    CHECK_FALSE(by_hand.has_twists());
    PairContacts the_same = contacts;
    contacts.compute(p, material, 1e-4);
    the_same.compute(by_hand, material, 1e-4);
    CHECK(bits_of(by_hand) == bits_of(p));

    // One that touches is held still: its dashpots feel it.
    std::size_t touching = p.body_count();
    for (std::size_t b = 0; b < p.body_count(); ++b)
      if (std::as_const(p).force(b) != Vec3::Zero()) touching = b;
    REQUIRE(touching < p.body_count());
    const Vec3 moving = p.force(touching);
    p.velocity(touching).setZero(), p.spin(touching).setZero();
    p.clear_forces();
    contacts.compute(p, material, 0);
    CHECK((p.force(touching) - moving).norm() > 1e-3 * moving.norm());
  }
}

TEST_CASE("pairs that just touch have no force, and coincident ones push each other along z") {
  Random random(4);
  for (const InstructionSet set : known_instructions())
    for (const int pebbles : {1, 3}) {
      GrainMaterial material;
      material.contact_modulus = 1e8;
      // A distance of r_i + r_j as rounded may come out a bit shorter or longer: an overlap of 1e-16 of a place near 8.
      Pairs touching = random_pairs(64, pebbles, 20, Gap::Touching, random);
      PairContacts contacts(0.005, {}, set);
      contacts.update(touching.particles);
      const ContactTotals totals = contacts.compute(touching.particles, material, 1e-5);
      CAPTURE(name_of(set), pebbles, totals.active, totals.normal_force, totals.largest_overlap_ratio);
      CHECK(std::isfinite(totals.contact_force));
      if (pebbles == 1) CHECK(totals.largest_overlap_ratio < 1e-11);

      Pairs coincident = random_pairs(27, 1, 20, Gap::Coincident, random);
      for (auto& spring : coincident.springs) spring.force.z() = 0;  // across the normal that such a pair has
      for (std::size_t b = 0; b < coincident.particles.body_count(); ++b) coincident.particles.velocity(b).setZero();
      material.friction = 0.5;
      const Differences d = compare(coincident, material, 1e-5, set);
      CAPTURE(d.touching, d.force, d.torque, d.spring, d.sums);
      CHECK(d.touching == 27);
      CHECK(d.force < 1e-14);
      CHECK(d.spring < 1e-14);
      const Vec3 push = std::as_const(coincident.particles).force(0);
      CHECK(push.z() < 0);
      CHECK(std::abs(push.z()) > 100 * std::hypot(push.x(), push.y()));
    }
}

TEST_CASE("the kernel's turn of a spring is the law's, to fourth order in the angle of a step") {
  // A pair of spheres turns by theta about z in the step, centres a chord apart: delta_t = sin(theta) t, and the law's
  // s - (n0 + n)(n . s)/(1 + n0 . n) = s - (n - tan(theta/2) t)(n . s). The kernel has sin(theta)/2 for tan(theta/2):
  // theta^3/8 less, times n . s = |s| sin(theta) for a spring in the plane: theta^4/8 of the spring.
  const double r = 0.03, dt = 1e-5, d = 1.999 * r;
  GrainMaterial material;
  material.friction = 1e3;
  const auto error = [&](double theta) {
    Particles p;
    const Vec3 n0 = Vec3::UnitX(), n(std::cos(theta), std::sin(theta), 0), t0 = Vec3::UnitY();
    p.add(make_clump(1, 1), r, 2650, Vec3::Zero(), Quat::Identity());
    p.add(make_clump(1, 1), r, 2650, d * n, Quat::Identity());
    p.velocity(1) = d / dt * (n - n0);
    // Spins that keep the contact from shearing: d w = the velocity across n.
    const double rate = std::sin(theta) / dt;
    p.spin(0) = p.spin(1) = Vec3(0, 0, rate);
    PairContacts contacts(0.005);
    contacts.restore(p, {{0, 1, 2.0 * t0 + Vec3(0, 0, 3.0)}});
    contacts.update(p);
    contacts.compute(p, material, dt);
    ContactHistory law{2.0 * t0 + Vec3(0, 0, 3.0), n0};
    contact_force({1e6, 1e6, 1e9, 0, 0}, n, 1e-5, Vec3::Zero(), dt, law);
    return (contacts.springs().at(0).force - law.spring).norm() / 2.0;
  };
  const double coarse = error(0.2), fine = error(0.1);
  CAPTURE(coarse, fine, coarse / (std::pow(0.2, 4) / 8), fine / (std::pow(0.1, 4) / 8), std::log2(coarse / fine));
  CHECK(std::log2(coarse / fine) == Approx(4).margin(0.1));
  CHECK(fine / (std::pow(0.1, 4) / 8) == Approx(1).margin(0.02));
}

// ---------------------------------------------------------------------------------------- lists and rattlers

namespace {

// Touching pairs of pebbles, and the energy in their normal springs, from a search of all pairs.
struct BruteForce {
  std::int64_t touching = 0;
  double energy = 0;  // [J]
};

BruteForce all_pairs(const Particles& p, const GrainMaterial& material) {
  BruteForce sum;
  const SphereRecord* pebbles = p.pebbles();
  for (std::size_t i = 0; i < p.pebble_count(); ++i)
    for (std::size_t j = i + 1; j < p.pebble_count(); ++j) {
      const double x = pebbles[j].x - pebbles[i].x, y = pebbles[j].y - pebbles[i].y, z = pebbles[j].z - pebbles[i].z;
      const double reach = pebbles[i].radius + pebbles[j].radius;
      if (!(x * x + y * y + z * z < reach * reach) || p.pebble_body(i) == p.pebble_body(j)) continue;
      const double overlap = reach - std::sqrt(x * x + y * y + z * z);
      ++sum.touching;
      sum.energy +=
          0.5 * overlap * overlap *
          material.normal_stiffness(p.equivalent_radius(p.pebble_body(i)), p.equivalent_radius(p.pebble_body(j)));
    }
  return sum;
}

}  // namespace

TEST_CASE(
    "no contact is ever missed: 2,000 steps of an agitated mixed crowd that grows, against a search of all pairs") {
  FreeGrains world(0.002);
  world.material.contact_modulus = 1e6;
  Random random(9);
  const ClumpTemplate sphere = make_clump(1, 1), clump = make_clump(3, 1.5);
  for (int k = 0; k < 125; ++k) {
    const double radius = k % 7 == 0 ? 0.05 : random.uniform(0.012, 0.03);
    const std::int32_t b = world.particles.add(k % 2 ? clump : sphere, radius, 2650,
                                               0.065 * Vec3(k % 5, k / 5 % 5, k / 25), random.rotation());
    world.particles.spin(b) = Vec3(random.uniform(-9, 9), random.uniform(-9, 9), random.uniform(-9, 9));
  }
  const Vec3 middle = Vec3::Constant(0.13);
  std::int64_t touches = 0;
  int wrong = 0;
  double worst = 0;
  for (int k = 0; k < 2000; ++k) {
    // Kicks now and then, of different strengths, keep it hot; a pull to the middle keeps it together.
    for (std::size_t b = 0; b < world.particles.body_count(); ++b) {
      if (random.uniform() < 0.01)
        world.particles.velocity(b) +=
            random.uniform(0, 3) * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
      world.particles.velocity(b) *= 0.998;
      const Vec3 position = std::as_const(world.particles).position(b);
      world.particles.velocity(b) += 0.02 * (middle - position);
    }
    // Growth in small steps, in one great one, and shrinking.
    if (k > 500 && k < 900) world.particles.scale_all(1.0003);
    if (k == 1000) world.particles.scale_all(1.06);
    if (k > 1200 && k < 1300) world.particles.scale_all(0.999);
    world.particles.clear_forces();
    world.contacts.update(world.particles);
    const BruteForce truth = all_pairs(world.particles, world.material);
    world.totals = world.contacts.compute(world.particles, world.material, 5e-5);
    wrong += world.totals.active != truth.touching;
    worst = std::max(worst, std::abs(world.totals.normal_energy - truth.energy) / std::max(truth.energy, 1e-9));
    touches += truth.touching;
    integrate(world.particles, Vec3::Zero(), 5e-5, 5e-5, 0);
  }
  CAPTURE(touches / 2000, wrong, worst, world.contacts.refreshes(), world.contacts.rebuilds());
  CHECK(touches / 2000 > 25);
  CHECK(world.contacts.refreshes() > 100);
  CHECK(world.contacts.refreshes() < 1500);
  CHECK(world.contacts.rebuilds() > 10);
  CHECK(wrong == 0);
  CHECK(worst < 1e-11);
}

TEST_CASE("a rattler that flies in its cage renews the lists at most once a flight, not at each half skin") {
  // 7 x 7 x 7 spheres at rest in touch, the middle one smaller by two skins: it flies to and fro over four skins, eight half
  // skins of travel a flight. The first half skin makes it a fast one: from x skins off the middle, where the outer list
  // was made, it may then go outer_skin_factor/2 - |x| skins. With 6 that is from 0.5 to -2, from -2 to -1, from -1 to 1
  // and from 1 to -1 on the way back, once a flight; with 8 from 0.5 to -3, beyond its cage. The outer list is not used up.
  const double r = 0.03, skin = 0.003, dt = 1e-5, speed = 5;
  FreeGrains world(skin);
  for (int k = 0; k < 343; ++k)
    world.sphere(2 * r * Vec3(k % 7 - 3, k / 7 % 7 - 3, k / 49 - 3), k == 171 ? r - 2 * skin : r);
  std::vector<char> fixed(343, 1);
  fixed[171] = 0;
  world.material.friction = 0;
  world.particles.velocity(171) = Vec3(speed, 0, 0);
  double way = 0;
  int turns = 0;
  for (int k = 0; k < 4000; ++k) {
    world.contacts.update(world.particles);
    world.contacts.compute(world.particles, world.material, dt);
    const double before = world.particles.velocity(171).x();
    integrate(world.particles, Vec3::Zero(), dt, dt, 0, {&fixed});
    const double now = world.particles.velocity(171).x();
    turns += before * now < 0;
    way += std::abs(now) * dt;
  }
  const double half_skins = way / (0.5 * skin);
  CAPTURE(turns, half_skins, world.contacts.refreshes(), world.contacts.rebuilds());
  CHECK(turns > 10);
  CHECK(half_skins > 80);
  CHECK(world.contacts.refreshes() <= turns + 2);
  CHECK(world.contacts.refreshes() < std::lround(half_skins / 6));
  CHECK(world.contacts.rebuilds() == 1);
}

TEST_CASE("few grains that fly far are listed anew alone, and no contact of theirs is missed") {
  // 1,728 spheres at rest, a tenth of their diameter apart. Four more are led through them and through each other, some 60
  // outer skins far: cells are sorted once. Two meet in the middle, having both left the cells that know them.
  const double r = 0.02, skin = 0.0006, pitch = 2.2 * r;
  Particles p;
  const ClumpTemplate sphere = make_clump(1, 1);
  const auto add = [&](const Vec3& at) { return p.add(sphere, r, 2650, at, Quat::Identity()); };
  for (int k = 0; k < 864; ++k) add(pitch * Vec3(k % 12, k / 12 % 12, k / 144));
  const Vec3 ways[] = {{11, 11, 11}, {-11, 11, -11}, {11, -3, 5}, {0, 0, 11}};
  const Vec3 starts[] = {{0, 0, 0}, {11, 0, 11}, {0, 8, 3}, {5.5, 5.5, 0}};
  std::vector<std::int32_t> fliers;
  for (const Vec3& start : starts) fliers.push_back(add(pitch * start));
  for (int k = 864; k < 1728; ++k) add(pitch * Vec3(k % 12, k / 12 % 12, k / 144));
  for (const int threads : {1, 2}) {
    Team team(threads);
    PairContacts contacts(skin);
    GrainMaterial material;
    constexpr int steps = 1200;
    int wrong = 0, met = 0;
    std::int64_t touches = 0;
    for (int n = 0; n <= steps; ++n) {
      for (std::size_t f = 0; f < fliers.size(); ++f)
        p.position(fliers[f]) = pitch * (starts[f] + n / double(steps) * ways[f]);
      contacts.update(p, team);
      p.clear_forces();
      const std::int64_t found = contacts.compute(p, material, 1e-5, Detail::All, team).active;
      std::int64_t truth = 0;
      for (const std::int32_t f : fliers)
        for (std::size_t b = 0; b < p.body_count(); ++b) {
          const bool is_flier = std::find(fliers.begin(), fliers.end(), b) != fliers.end();
          if ((is_flier && static_cast<std::int32_t>(b) <= f) ||
              (std::as_const(p).position(b) - std::as_const(p).position(f)).norm() >= 2 * r)
            continue;
          ++truth;
          met += is_flier;
        }
      wrong += found != truth;
      touches += truth;
    }
    CAPTURE(threads, touches, met, contacts.refreshes());
    CHECK(wrong == 0);
    CHECK(touches > 5000);
    CHECK(met > 20);
    CHECK(contacts.refreshes() > 100);
    CHECK(contacts.rebuilds() <= 3);  // the skin widens by more than twice
  }
}

TEST_CASE("grains at rest have tight limits, and no contact is missed when they begin to move") {
  // 1,000 spheres on a lattice, 0.4 skins apart, and one that circles above them and asks for new lists. The limits of the
  // others fall to a tenth of half the skin: at a gap of 0.4 skins they are not listed. Then all shake along ways of their
  // own, by up to 0.45 skins from their places: neighbours come to touch and part, and all pairs are searched for the truth.
  const double r = 0.02, skin = 0.0006, pitch = 2 * r + 0.4 * skin;
  Particles p;
  const ClumpTemplate sphere = make_clump(1, 1);
  const auto place = [&](int k) -> Vec3 { return pitch * Vec3(k % 10, k / 10 % 10, k / 100); };
  const auto add = [&](const Vec3& at) { p.add(sphere, r, 2650, at, Quat::Identity()); };
  for (int k = 0; k < 1000; ++k) add(place(k));
  add({0, 0, 30 * r});
  PairContacts contacts(skin);
  GrainMaterial material;
  double steadiest = 1e300;
  for (int n = 0; n < 6000; ++n) {
    p.position(1000) = Vec3(20 * skin * std::cos(n / 1000.0), 20 * skin * std::sin(n / 1000.0), 30 * r);
    contacts.update(p);
    steadiest = std::min(steadiest, contacts.limits().marks[500].radius);
  }
  const std::int64_t lists_at_rest = contacts.refreshes();
  std::int64_t touches = 0;
  int wrong = 0;
  double widest = 0;
  for (int n = 0; n <= 300; ++n) {
    const double beat = std::sin(n / 20.0);
    for (int k = 0; k < 1000; ++k)
      p.position(static_cast<std::size_t>(k)) =
          place(k) + 0.45 * skin * beat * Vec3(std::sin(3.0 * k), std::cos(5.0 * k), std::sin(7.0 * k));
    contacts.update(p);
    widest = std::max(widest, contacts.limits().marks[500].radius);
    p.clear_forces();
    const std::int64_t found = contacts.compute(p, material, 1e-5).active;
    std::int64_t truth = 0;
    for (std::size_t i = 0; i < 1000; ++i)
      for (std::size_t j = i + 1; j < std::min<std::size_t>(1000, i + 112); ++j)  // to the diagonal neighbour above
        truth += (std::as_const(p).position(j) - std::as_const(p).position(i)).norm() < 2 * r;
    wrong += found != truth;
    touches += truth;
  }
  CAPTURE(lists_at_rest, steadiest / skin, widest / skin, contacts.refreshes(), touches);
  CHECK(lists_at_rest > 40);
  CHECK(steadiest < 0.06 * skin);
  CHECK(widest > 0.3 * skin);
  CHECK(touches > 10000);
  CHECK(wrong == 0);
}

TEST_CASE("lists that know the ways of the pebbles are renewed at the same steps as lists that look at all of them") {
  // Ways are bounds: of spheres they are exact, of clumps the longest way of a centre and the longest of a turn are added. Of
  // a row's two ends one goes at least as far as each of the two: the sum is twice too long at most.
  for (const int pebbles : {1, 3}) {
    FreeGrains looking = cloud(pebbles, 0.002), told = cloud(pebbles, 0.002);
    told.tells_ways = true;
    double shortest = 1e300, longest = 0;  // of a chunk's bound over the farthest way in it
    for (int k = 0; k < 400; ++k) {
      looking.step(3e-5);
      std::vector<SphereRecord> before(told.particles.pebbles(),
                                       told.particles.pebbles() + told.particles.pebble_count());
      told.step(3e-5);
      CHECK(told.contacts.refreshes() == looking.contacts.refreshes());
      std::vector<double> farthest(told.motion.ways.size());
      for (std::size_t p = 0; p < before.size(); ++p) {
        double& way = farthest[static_cast<std::size_t>(told.particles.pebble_body(p)) / chunk_bodies];
        way = std::max(way, (told.particles.pebble_center(p) - Vec3(before[p].x, before[p].y, before[p].z)).norm());
      }
      for (std::size_t c = 0; c < farthest.size(); ++c) {
        shortest = std::min(shortest, told.motion.ways[c] / farthest[c]);
        longest = std::max(longest, told.motion.ways[c] / farthest[c]);
      }
    }
    CAPTURE(pebbles, shortest - 1, longest, told.contacts.refreshes(), told.motion.ways.size());
    CHECK(told.contacts.refreshes() > 10);
    CHECK(shortest > 1 - 1e-9);
    CHECK(longest < (pebbles == 1 ? 1 + 1e-9 : 2));
    CHECK(told.state_hash() == looking.state_hash());
  }
}
