#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "common/random.hpp"
#include "tests/dem_server/free_grains.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

// One pebble with three different moments [kg m2], which is no sphere: it has an attitude.
Particles asymmetric_body(const Vec3& inertia, const Vec3& spin) {
  const double radius = 0.03, density = 2650;
  ClumpTemplate shape = make_clump(1, 1);
  shape.inertia_per_mass = inertia / (density * 4.0 / 3.0 * pi * std::pow(radius, 5));
  Particles p;
  p.add(shape, radius, density, Vec3::Zero(), Quat(Eigen::AngleAxisd(0.7, Vec3(1, 2, 3).normalized())));
  CHECK((p.inertia(0) - inertia).norm() <= 1e-15 * inertia.norm());
  // `spin` in body axes.
  p.spin(0) = p.orientation(0) * spin;
  return p;
}

double rotation_energy(const Particles& p) {
  const Vec3 w = p.orientation(0).conjugate() * p.spin(0);
  return 0.5 * w.dot(p.inertia(0).cwiseProduct(w));
}

Vec3 angular_momentum(const Particles& p) {
  const Vec3 w = p.orientation(0).conjugate() * p.spin(0);
  return p.orientation(0) * p.inertia(0).cwiseProduct(w);
}

void turn(Particles& p, double dt, int steps) {
  MotionTotals totals;
  for (int k = 0; k < steps; ++k) totals = integrate(p, Vec3::Zero(), dt, dt, 0);
}

const Vec3 moments(1e-4, 2e-4, 3e-4);

}  // namespace

TEST_CASE("free flight under gravity is the leap-frog's parabola to round-off") {
  // v(n+1/2) = (n+1) g dt from rest at v(-1/2) = 0: x(n) = g dt^2 n (n+1) / 2.
  FreeGrains world;
  world.sphere(Vec3::Zero(), 0.03);
  world.gravity = Vec3(0, 0, -9.81);
  const double dt = 1e-3;
  double gravity_work = 0;
  for (int k = 0; k < 100; ++k) {
    world.step(dt);
    gravity_work += world.motion.gravity_work;
  }
  const double exact = -9.81 * dt * dt * 100 * 101 / 2;
  const double error = world.particles.position(0).z() / exact - 1;
  const double kinetic = 0.5 * world.particles.mass(0) * world.particles.velocity(0).squaredNorm();
  CAPTURE(error, gravity_work / kinetic - 1);
  CHECK(std::abs(error) < 1e-13);
  CHECK(std::abs(gravity_work / kinetic - 1) < 1e-13);
}

TEST_CASE("a change of step keeps positions on the velocities' clock") {
  // Constant acceleration: v(n+1/2) - v(n-1/2) must use half of either step.
  Particles p;
  p.add(make_clump(1, 1), 0.03, 2650, Vec3::Zero(), Quat::Identity());
  MotionTotals totals;
  totals = integrate(p, Vec3(0, 0, -10), 2e-3, 1e-3, 0);
  CHECK(p.velocity(0).z() == Approx(-10 * 1.5e-3).epsilon(1e-15));
  CHECK(p.position(0).z() == Approx(-10 * 1.5e-3 * 1e-3).epsilon(1e-15));
}

TEST_CASE("a torque-free body keeps its angular momentum to round-off and its energy without drift") {
  Particles p = asymmetric_body(moments, Vec3(3, 20, 11));
  const Vec3 momentum = angular_momentum(p);
  const double energy = rotation_energy(p);
  double early = 0, late = 0;
  const double dt = 2e-3;  // 0.05 rad a step
  for (int k = 0; k < 100000; ++k) {
    turn(p, dt, 1);
    const double error = std::abs(rotation_energy(p) / energy - 1);
    if (k < 10000) early = std::max(early, error);
    if (k >= 90000) late = std::max(late, error);
  }
  const double momentum_error = (angular_momentum(p) - momentum).norm() / momentum.norm();
  CAPTURE(momentum_error, early, late);
  CHECK(momentum_error < 1e-11);
  CHECK(early < 1e-3);
  CHECK(late < 1.05 * early);
}

TEST_CASE("torque-free rotation is of second order") {
  // Truth: the same motion with a step 64 times smaller. The error is the angle between attitudes at t = 0.5 s.
  const double time = 0.5;
  const auto attitude_after = [&](int steps) {
    Particles p = asymmetric_body(moments, Vec3(3, 20, 11));
    turn(p, time / steps, steps);
    return p.orientation(0);
  };
  const Quat truth = attitude_after(64 * 400);
  const double coarse = attitude_after(200).angularDistance(truth), fine = attitude_after(400).angularDistance(truth);
  CAPTURE(coarse, fine, std::log2(coarse / fine));
  CHECK(std::log2(coarse / fine) == Approx(2).margin(0.1));
}

TEST_CASE("spin about the middle axis flips over with the period of the exact solution") {
  // Moments 1:2:3, spin w2 about the middle axis, disturbed by w1 = w3 = epsilon w2. Linearised, the disturbance obeys
  //   I1 w1' = (I2 - I3) w2 w3, I3 w3' = (I1 - I2) w1 w2   =>  growth rate l = w2 sqrt((I2-I1)(I3-I2)/(I1 I3)) =
  //   w2/sqrt(3),
  // and the first passage through w2 = 0 of the exact elliptic solution lies between 1/l and 3/l times ln(1/epsilon).
  const double w2 = 20, epsilon = 1e-3, rate = w2 / std::sqrt(3.0), dt = 5e-4;
  const auto first_passage = [&](double step) {
    Particles p = asymmetric_body(moments, Vec3(-epsilon * w2, w2, epsilon * w2));
    double time = 0, last = w2;
    while (time < 10) {
      turn(p, step, 1);
      time += step;
      const double now = (p.orientation(0).conjugate() * p.spin(0)).y();
      if (now < 0) return time - step * now / (now - last);
      last = now;
    }
    return time;
  };
  // The exact passage by a fine 4th-order solution of Euler's equations in body axes, an independent path.
  const auto slope = [](const Vec3& w) {
    return Vec3((moments.y() - moments.z()) / moments.x() * w.y() * w.z(),
                (moments.z() - moments.x()) / moments.y() * w.z() * w.x(),
                (moments.x() - moments.y()) / moments.z() * w.x() * w.y());
  };
  Vec3 w(-epsilon * w2, w2, epsilon * w2);
  double exact = 0;
  const double h = 1e-5;
  while (w.y() > 0) {
    const Vec3 a = slope(w), b = slope(w + 0.5 * h * a), c = slope(w + 0.5 * h * b), d = slope(w + h * c);
    w += h / 6 * (a + 2 * b + 2 * c + d);
    exact += h;
  }
  const double error = first_passage(dt) / exact - 1, half = first_passage(0.5 * dt) / exact - 1;
  CAPTURE(exact, exact * rate, error, half);
  CHECK(exact * rate > 3);
  CHECK(std::abs(error) < 2e-3);
  CHECK(std::abs(half) < 0.35 * std::abs(error) + 1e-5);
}

TEST_CASE("an axisymmetric clump precesses at the rate of theory") {
  // Free symmetric top: the axis turns about L at |L|/I2. Error of the angle after one second, against dt.
  const auto axis_error = [](int steps) {
    Particles p;
    p.add(make_clump(3, 1.5), 0.03, 2650, Vec3::Zero(), Quat::Identity());
    p.spin(0) = Vec3(30, 10, 0);
    const Vec3 momentum = angular_momentum(p), axis = momentum.normalized();
    turn(p, 1.0 / steps, steps);
    const Vec3 expected = Eigen::AngleAxisd(momentum.norm() / p.inertia(0).y(), axis) * Vec3::UnitX();
    return (p.orientation(0) * Vec3::UnitX() - expected).norm();
  };
  const double coarse = axis_error(1000), fine = axis_error(2000);
  CAPTURE(coarse, fine, std::log2(coarse / fine));
  CHECK(fine < 1e-3);
  CHECK(std::log2(coarse / fine) == Approx(2).margin(0.05));
}

TEST_CASE("local damping takes its share of the unbalanced force, against the motion") {
  // A falling sphere with alpha = 0.7 feels 0.3 g once it moves down; the first step from rest is undamped.
  FreeGrains world;
  world.sphere(Vec3::Zero(), 0.03);
  world.gravity = Vec3(0, 0, -10);
  world.damping = 0.7;
  world.step(1e-3);
  const double first = world.particles.velocity(0).z();
  world.step(1e-3);
  CHECK(first == Approx(-10e-3).epsilon(1e-14));
  CHECK(world.particles.velocity(0).z() - first == Approx(-3e-3).epsilon(1e-12));
  CHECK(world.motion.damping_force.z() == Approx(7 * world.particles.mass(0)).epsilon(1e-12));
  CHECK(world.motion.unbalanced_force == Approx(10 * world.particles.mass(0)).epsilon(1e-12));
  CHECK(fastest_body(world.particles) == 0);
}

TEST_CASE("works add up to the change of kinetic energy to round-off") {
  Particles p;
  for (int b = 0; b < 3; ++b)
    p.add(make_clump(b == 0 ? 1 : 3, 1.5), 0.03, 2650, Vec3(b, 0, 0), Quat(1, 0.2 * b, 0.3, 0.1).normalized());
  double work = 0;
  MotionTotals totals;
  const auto kinetic = [&] {
    double sum = 0;
    for (std::size_t b = 0; b < p.body_count(); ++b) {
      const Vec3 w = p.orientation(b).conjugate() * p.spin(b);
      sum += 0.5 * p.mass(b) * p.velocity(b).squaredNorm() + 0.5 * w.dot(p.inertia(b).cwiseProduct(w));
    }
    return sum;
  };
  // Rotation conserves energy only to order 2 between the kicks, so the ledger is closed over one kick from rest and
  // one more of spheres.
  for (int b = 0; b < 3; ++b) p.set_loads(b, Vec3(1, -2, 3), Vec3(0.01, 0.02, -0.03));
  totals = integrate(p, Vec3(0, 0, -9.81), 1e-4, 1e-4, 0.5);
  work = totals.contact_work + totals.gravity_work - totals.damped_work;
  CAPTURE(work, kinetic());
  CHECK(work == Approx(kinetic()).epsilon(1e-6));
  CHECK((totals.momentum - totals.momentum_change).norm() < 1e-15);
}

TEST_CASE("a fixed body stays where it is whatever pulls it") {
  Particles p;
  p.add(make_clump(3, 1.5), 0.03, 2650, Vec3::Zero(), Quat::Identity());
  p.set_loads(0, Vec3(1e6, 0, 0), Vec3::Zero());
  p.velocity(0) = Vec3(1, 1, 1);
  MotionTotals totals;
  const std::vector<char> fixed = {1};
  totals = integrate(p, Vec3(0, 0, -9.81), 1e-3, 1e-3, 0, {&fixed});
  CHECK(p.position(0) == Vec3::Zero());
  CHECK(p.velocity(0) == Vec3::Zero());
  CHECK(totals.kinetic_energy() == 0);
}

// ------------------------------------------------------------------------- lanes against one body at a time

namespace {

using Real = long double;
using Real3 = Eigen::Matrix<Real, 3, 1>;
using RealMatrix = Eigen::Matrix<Real, 3, 3>;

Real3 real(const Vec3& v) { return v.cast<Real>(); }

RealMatrix cross_matrix(const Real3& v) {
  RealMatrix m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

// Cayley's map of the rotation vector a: (1 - [a]/2)^-1 (1 + [a]/2), the turn by 2 atan(|a|/2) about a.
RealMatrix cayley(const Real3& a) {
  const RealMatrix half = cross_matrix(a) / 2, one = RealMatrix::Identity();
  return (one - half).inverse() * (one + half);
}

struct BodyTruth {
  Real3 velocity, position, spin;
  RealMatrix attitude;
  Real translation = 0, rotation = 0, gravity_work = 0, damped_work = 0, contact_work = 0, unbalanced = 0;
};

Real3 damped(const Real3& force, const Real3& velocity, double damping) {
  Real3 f = force;
  for (int k = 0; k < 3; ++k)
    if (velocity[k] != 0) f[k] -= damping * std::abs(force[k]) * (std::signbit(velocity[k]) ? -1 : 1);
  return f;
}

// integrator.hpp line by line, with matrices instead of quaternions.
BodyTruth one_body(const Particles& p, std::size_t b, bool is_fixed, const Vec3& g, double dt_old, double dt_new,
                   double damping) {
  const Real dt = (static_cast<Real>(dt_old) + dt_new) / 2, m = p.mass(b);
  const Real3 v = real(p.velocity(b)), w = real(p.spin(b)), f = real(p.force(b));
  const Real3 t = real(p.moment(b)) - real(p.position(b)).cross(f);
  const RealMatrix q = p.orientation(b).cast<Real>().toRotationMatrix();
  BodyTruth after;
  after.velocity = after.spin = Real3::Zero();
  after.position = real(p.position(b));
  after.attitude = q;
  if (is_fixed) return after;
  const Real3 unbalanced = f + m * real(g), force = damped(unbalanced, v, damping), torque = damped(t, w, damping);
  after.velocity = v + dt / m * force;
  after.position += static_cast<Real>(dt_new) * after.velocity;
  const Real3 mean = (v + after.velocity) / 2;
  // A sphere's moments are the same in all frames.
  const Real3 inertia = real(p.inertia(b)), own_spin = q.transpose() * w;
  Real3 momentum = inertia.cwiseProduct(own_spin) + dt * (q.transpose() * torque);
  const Real3 kicked = momentum.cwiseQuotient(inertia), middle = q * (own_spin + kicked) / 2;
  after.translation = m * v.dot(after.velocity) / 2;
  after.rotation = own_spin.dot(momentum) / 2;
  after.gravity_work = dt * m * real(g).dot(mean);
  after.contact_work = dt * (f.dot(mean) + t.dot(middle));
  after.damped_work = -dt * ((force - unbalanced).dot(mean) + (torque - t).dot(middle));
  after.unbalanced = unbalanced.norm();
  if (p.pebble_end(b) - p.pebble_begin(b) == 1) {  // keeps its attitude
    after.spin = q * kicked;
    return after;
  }
  const Real rate_2 = 1 / inertia.y();
  const auto turn_about = [&](int axis, Real step) {
    const RealMatrix turn = cayley(step * (1 / inertia[axis] - rate_2) * momentum[axis] * Real3::Unit(axis));
    after.attitude = after.attitude * turn;
    momentum = turn.transpose() * momentum;
  };
  after.attitude = q * cayley(static_cast<Real>(dt_new) * rate_2 * momentum);
  if (p.inertia(b).y() == p.inertia(b).z()) {  // one turn about the axis: half turns would have another Cayley map
    turn_about(0, dt_new);
  } else {
    turn_about(0, static_cast<Real>(dt_new) / 2);
    turn_about(2, dt_new);
    turn_about(0, static_cast<Real>(dt_new) / 2);
  }
  after.spin = after.attitude * momentum.cwiseQuotient(inertia);
  return after;
}

}  // namespace

TEST_CASE("eight lanes move bodies as one at a time, to round-off: spheres, clumps, held ones, with local damping") {
  // Moments of a row are axisymmetric and take the short way through the splitting; the lopsided shape, two pebbles with
  // three different moments, takes the long one; the bent one has pebbles off the axis. Bodies of a group are of one shape
  // or stand mixed, so that lanes differ. 35 bodies: five groups, the last with three. Quaternions are unit to 1e-16: the
  // attitude errs by a few of these.
  constexpr double round_off = 5e-15;
  const ClumpTemplate sphere = make_clump(1, 1), row = make_clump(3, 1.5), long_row = make_clump(9, 2);
  ClumpTemplate lopsided = make_clump(2, 1.5), bent = row;
  lopsided.inertia_per_mass = Vec3(0.3, 0.45, 0.62);
  bent.pebble_center = {Vec3(0.5, 0.1, -0.2), Vec3(-0.3, 0.4, 0), Vec3(0, -0.6, 0.3)};
  bent.inertia_per_mass = Vec3(0.5, 0.35, 0.41);
  const std::vector<ClumpTemplate> crowds[] = {
      {sphere}, {row}, {lopsided}, {bent}, {sphere, row, lopsided, long_row}, {row, bent, sphere}};
  Random random(17);
  const auto vector = [&](double size) -> Vec3 {
    return size * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  };
  for (const InstructionSet set : {InstructionSet::Generic, InstructionSet::Avx2, InstructionSet::Avx512}) {
    if (set > best_instructions()) continue;
    for (const std::vector<ClumpTemplate>& shapes : crowds)
      for (const double damping : {0.0, 0.7}) {
        Particles p;
        std::vector<char> fixed;
        for (int k = 0; k < 35; ++k) {
          const std::int32_t b =
              p.add(shapes[k % shapes.size()], random.uniform(0.005, 0.1), 2650, vector(1), random.rotation());
          p.velocity(b) = vector(2), p.spin(b) = vector(50);
          const Vec3 force = p.mass(b) * vector(100), torque = p.mass(b) * vector(1);
          p.set_loads(b, force, torque);
          if (k % 4 == 1) p.velocity(b).y() = 0, p.spin(b).x() = -0.0;  // at rest in a direction: no damping there
          fixed.push_back(k % 11 == 5);
        }
        const Vec3 g(0.3, -0.2, -9.81);
        const double dt_old = 1.3e-3, dt_new = 0.9e-3;
        std::vector<BodyTruth> truth;
        for (std::size_t b = 0; b < p.body_count(); ++b)
          truth.push_back(one_body(p, b, fixed[b], g, dt_old, dt_new, damping));
        const MotionTotals totals =
            integrate(p, g, dt_old, dt_new, damping, {&fixed, nullptr, nullptr, set, Detail::All, 1e9});

        double position = 0, velocity = 0, spin = 0, attitude = 0, pebbles = 0;
        BodyTruth sum;
        Real scale = 0;
        for (std::size_t b = 0; b < p.body_count(); ++b) {
          const BodyTruth& t = truth[b];
          const auto raise = [](double& worst, Real error) { worst = std::max(worst, static_cast<double>(error)); };
          raise(position, (real(std::as_const(p).position(b)) - t.position).norm());
          raise(velocity, (real(std::as_const(p).velocity(b)) - t.velocity).norm() / 3);
          // Moments about the origin round off as the bodies' distances from there, here of 1 m.
          const double moment = 100 * p.mass(b);
          raise(spin,
                (real(std::as_const(p).spin(b)) - t.spin).norm() / (80 + dt_old * moment / p.inertia(b).minCoeff()));
          raise(attitude, (p.orientation(b).cast<Real>().toRotationMatrix() - t.attitude).norm());
          for (std::int32_t k = p.pebble_begin(b); k < p.pebble_end(b); ++k)
            raise(pebbles, (real(p.pebble_center(k)) - t.position - t.attitude * real(p.pebble_offset(k))).norm());
          sum.translation += t.translation, sum.rotation += t.rotation, sum.unbalanced += t.unbalanced;
          sum.gravity_work += t.gravity_work, sum.damped_work += t.damped_work, sum.contact_work += t.contact_work;
          scale += std::abs(t.translation) + std::abs(t.rotation) + std::abs(t.contact_work);
          CHECK(std::as_const(p).force(b) == Vec3::Zero());
          CHECK(std::as_const(p).torque(b) == Vec3::Zero());
        }
        const auto off = [&](double value, Real exact) { return static_cast<double>(std::abs(value - exact) / scale); };
        const double sums =
            std::max({off(totals.translation_energy, sum.translation), off(totals.rotation_energy, sum.rotation),
                      off(totals.gravity_work, sum.gravity_work), off(totals.damped_work, sum.damped_work),
                      off(totals.contact_work, sum.contact_work)});
        const double unbalanced = static_cast<double>(std::abs(totals.unbalanced_force / sum.unbalanced - 1));
        CAPTURE(name_of(set), &shapes - crowds, damping, position, velocity, spin, attitude, pebbles, sums, unbalanced);
        for (const double error : {position, velocity, spin, attitude, pebbles, sums, unbalanced})
          CHECK(error < round_off);
        CHECK(std::abs(totals.damped_work) >= (damping > 0 ? 1e-6 : 0.0));
      }
  }
}

TEST_CASE("a body that crosses half its radius in a step is reported whichever lane it is in, and NaN is") {
  for (const int pebbles : {1, 3})
    for (std::size_t fast = 0; fast < 19; ++fast)
      for (const double share : {0.49, 0.51, std::numeric_limits<double>::quiet_NaN()}) {
        Particles p;
        for (int k = 0; k < 19; ++k) p.add(make_clump(pebbles, 1.5), 0.03, 2650, Vec3(k, 0, 0), Quat::Identity());
        p.velocity(fast) = Vec3(0, share * 0.03 / 1e-4, 0);
        const MotionTotals totals = integrate(p, Vec3::Zero(), 1e-4, 1e-4, 0);
        CAPTURE(pebbles, fast, share);
        CHECK(totals.is_too_fast == !(share <= 0.5));
        CHECK(fastest_body(p) == static_cast<std::int32_t>(fast));
      }
}
