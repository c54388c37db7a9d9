#include <catch2/catch.hpp>

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
  for (int b = 0; b < 3; ++b) p.force(b) = Vec3(1, -2, 3), p.torque(b) = Vec3(0.01, 0.02, -0.03);
  totals = integrate(p, Vec3(0, 0, -9.81), 1e-4, 1e-4, 0.5);
  work = totals.contact_work + totals.gravity_work - totals.damped_work;
  CAPTURE(work, kinetic());
  CHECK(work == Approx(kinetic()).epsilon(1e-6));
  CHECK((totals.momentum - totals.momentum_change).norm() < 1e-15);
}

TEST_CASE("a fixed body stays where it is whatever pulls it") {
  Particles p;
  p.add(make_clump(3, 1.5), 0.03, 2650, Vec3::Zero(), Quat::Identity());
  p.force(0) = Vec3(1e6, 0, 0);
  p.velocity(0) = Vec3(1, 1, 1);
  MotionTotals totals;
  const std::vector<char> fixed = {1};
  totals = integrate(p, Vec3(0, 0, -9.81), 1e-3, 1e-3, 0, {&fixed});
  CHECK(p.position(0) == Vec3::Zero());
  CHECK(p.velocity(0) == Vec3::Zero());
  CHECK(totals.kinetic_energy() == 0);
}
