// Orders of accuracy in the time step, each against the answer of theory, printed with -s.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <utility>
#include <vector>

#include "common/random.hpp"
#include "tests/dem_server/free_grains.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

constexpr double radius = 0.03;   // [m]
constexpr double density = 2650;  // [kg/m3]
constexpr double modulus = 94e6;  // E* [Pa]
const double mass = density * 4.0 / 3.0 * pi * radius * radius * radius;
const double stiffness = modulus * 2 * radius;  // k_n of two equal spheres [N/m]

// Of the last two of a series whose steps halve.
double order(const std::vector<double>& errors) {
  const std::size_t n = errors.size();
  return std::log2(std::abs(errors[n - 2] / errors[n - 1]));
}

struct Bounce {
  double duration;     // [s]
  double restitution;  // speed of parting over speed of meeting
};

// Two equal spheres meet head-on at 1 m/s; a force-free t_0, so that v(-1/2) = v(1/2) and the gap closes at t = 0.
Bounce bounce(double damping_share, double dt) {
  FreeGrains world;
  world.material.damping_ratio = damping_share;
  world.sphere(Vec3(-radius, 0, 0), radius);
  world.sphere(Vec3(radius, 0, 0), radius);
  world.particles.velocity(0).x() = 0.5;
  world.particles.velocity(1).x() = -0.5;
  double gap = 0, before = 0, time = 0;
  while (gap <= 0) {
    world.step(dt);
    time += dt;
    before = gap;
    gap = world.particles.position(1).x() - world.particles.position(0).x() - 2 * radius;
  }
  const double duration = time - dt * gap / (gap - before);
  world.step(dt);
  return {duration, world.particles.velocity(1).x() - world.particles.velocity(0).x()};
}

}  // namespace

TEST_CASE("order: an undamped bounce lasts half the period of leap-frog, which errs by (omega dt)^2/24") {
  // x'' = -omega^2 x, omega^2 = k/m_eff, m_eff = m/2. Leap-frog swings at omega' with sin(omega' dt/2) = omega dt/2, so
  // the half period is shorter by (omega dt)^2/24. The gap's zero is taken linearly between steps: its curvature there
  // is zero, so this adds errors of third order. Steps cut the half period at the same phase, 0.3.
  const double omega = std::sqrt(2 * stiffness / mass), exact = pi / omega;
  std::vector<double> errors, against_discrete, speeds;
  for (const double steps : {25.3, 50.3, 100.3, 200.3}) {
    const double dt = exact / steps;
    const double discrete = pi / (2 / dt * std::asin(0.5 * omega * dt));
    const Bounce b = bounce(0, dt);
    errors.push_back(b.duration / exact - 1);
    against_discrete.push_back(b.duration / discrete - 1);
    speeds.push_back(b.restitution - 1);
  }
  CAPTURE(errors, against_discrete, speeds, order(errors), order(against_discrete), order(speeds));
  const double finest = omega * exact / 200.3;
  CHECK(errors.back() == Approx(-finest * finest / 24).epsilon(0.05));
  CHECK(order(errors) == Approx(2).margin(0.1));
  CHECK(std::abs(against_discrete.back()) < 0.05 * std::abs(errors.back()));
  CHECK(order(speeds) > 1.8);
}

TEST_CASE("order: a damped bounce gives back the restitution asked for") {
  // The dashpot acts with v(n-1/2), half a step old: first order.
  for (const double restitution : {0.8, 0.5}) {
    const double half_period = pi * std::sqrt(0.5 * mass / stiffness);
    std::vector<double> errors;
    for (const double steps : {200.3, 400.3, 800.3, 1600.3})
      errors.push_back(bounce(damping_ratio(restitution), half_period / steps).restitution / restitution - 1);
    CAPTURE(restitution, errors, order(errors));
    CHECK(std::abs(errors.back()) < 1e-3);
    CHECK(order(errors) > 0.8);
  }
}

TEST_CASE("sliding to rolling: v + 2/5 w R^2/(R - U/2) stays as it was, and v ends at 5/7, at any step") {
  // Friction f at the contact, an arm R - U/2 below the centre: m dv = -f dt, 2/5 m R^2 dw = f (R - U/2) dt in leap-frog
  // as in theory, so that v + 2/5 R^2/(R - U/2) w keeps its value v0 whatever dt and f. Rolling, v = w (R - U/2), then
  // means v = v0/(1 + 2/5 R^2/(R - U/2)^2) -> 5/7 v0. The floor is a fixed sphere of 1e4 radii and gravity
  // points at its centre. The tangent turns by 1e-9 a step and by 1e-4 in all.
  const double r = 0.05, floor = 500, v0 = 0.5, g = 9.81, soft = 1e4;
  const double m = density * 4.0 / 3.0 * pi * r * r * r, k = soft * (floor + r), overlap = m * g / k;
  const double arm = r - overlap / 2;
  const std::vector<char> fixed = {1, 0};
  std::vector<double> ends, drifts;
  for (const double share : {0.1, 0.05, 0.025}) {
    FreeGrains world;
    world.sphere(Vec3(0, 0, -floor), floor, 1);
    world.sphere(Vec3(0, 0, r - overlap), r);
    world.particles.velocity(1).x() = v0;
    world.material.contact_modulus = soft;
    world.material.friction = 0.3;
    world.material.damping_ratio = 0;
    const double dt = share * std::sqrt(m / k);
    double sum = 0, drift = 0;
    int samples = 0;
    for (double time = 0; time < 0.12; time += dt) {
      world.contacts.update(world.particles);
      world.contacts.compute(world.particles, world.material, dt);
      const Vec3 up = (std::as_const(world.particles).position(1) - Vec3(0, 0, -floor)).normalized();
      integrate(world.particles, -g * up, dt, dt, 0, {&fixed});
      const double v = world.particles.velocity(1).dot(Vec3::UnitY().cross(up)), w = world.particles.spin(1).y();
      drift = std::max(drift, std::abs((v + 0.4 * r * r / arm * w) / v0 - 1));
      if (time < 0.06) continue;  // slides for 2/7 v0/(mu g) = 0.049 s, then rings about rolling
      sum += v;
      ++samples;
    }
    ends.push_back(sum / samples / v0 - 1 / (1 + 0.4 * r * r / (arm * arm)));
    drifts.push_back(drift);
  }
  CAPTURE(ends, drifts);
  for (const double drift : drifts) CHECK(drift < 1e-7);
  for (const double end : ends) CHECK(std::abs(end) < 2e-4);
}

TEST_CASE("order: a torque-free clump keeps its momentum to round-off and its energy to second order") {
  // Any row of pebbles is axisymmetric: its turn is exact but for Cayley's map, and its energy is a function of the p_k
  // that the map keeps, so it is kept to round-off too. A body of three moments is split: second order, without drift.
  const auto errors = [](bool is_row, double dt) {
    ClumpTemplate shape = is_row ? make_clump(3, 1.5) : make_clump(1, 1);
    if (!is_row) shape.inertia_per_mass = Vec3(0.3, 0.45, 0.6);
    FreeGrains world;
    world.particles.add(shape, radius, density, Vec3::Zero(), Quat(Eigen::AngleAxisd(0.7, Vec3(1, 2, 3).normalized())));
    world.particles.spin(0) = Vec3(20, 9, 14);
    const auto energy = [&] {
      const Vec3 w = world.particles.orientation(0).conjugate() * Vec3(world.particles.spin(0));
      return 0.5 * w.dot(world.particles.inertia(0).cwiseProduct(w));
    };
    const Vec3 momentum = world.angular_momentum();
    const double start = energy();
    double worst = 0;
    for (double time = 0; time < 4; time += dt) {
      world.step(dt);
      worst = std::max(worst, std::abs(energy() / start - 1));
    }
    return std::pair(worst, (world.angular_momentum() - momentum).norm() / momentum.norm());
  };
  std::vector<double> energies, momenta, row_energies, row_momenta;
  for (const double dt : {4e-3, 2e-3, 1e-3}) {
    const auto [energy, momentum] = errors(false, dt);
    const auto [row_energy, row_momentum] = errors(true, dt);
    energies.push_back(energy), momenta.push_back(momentum);
    row_energies.push_back(row_energy), row_momenta.push_back(row_momentum);
  }
  CAPTURE(energies, momenta, order(energies), row_energies, row_momenta);
  CHECK(order(energies) == Approx(2).margin(0.1));
  for (const auto* series : {&momenta, &row_energies, &row_momenta})
    for (const double error : *series) CHECK(error < 1e-12);
}

TEST_CASE("order: a frictional loop of shear has the work of its area, and its ledger closes in each step") {
  // Two spheres pressed by a fixed overlap turn against each other by their spins alone, to and fro by a way +-A at the
  // contact: the spring goes up at k_s to mu F_n and slides. One round, once under way, encloses
  //   4 mu F_n (A - mu F_n/k_s).
  // In the step that sliding begins in, the share f of its way dx loads the spring and the rest slips; the slip is booked at
  // the mean force, k_s f dx/2 too little: k_s f (1 - f) dx^2/2, twice a round. The way from end to end of the spring,
  // 2 mu F_n/k_s, is chosen as 7 1/3 of the coarsest steps, so that f is 1/3 or 2/3 in all.
  // The torque's work by the mean of two steps is exactly what the spring gains and the slip takes.
  const double overlap = 2e-5, friction = 0.5, round = 1e-3;                         // [m], [-], [s]
  const double to_slide = 2 * friction * overlap * GrainMaterial().stiffness_ratio;  // 2 mu F_n/k_s [m]
  const double half_way = to_slide * 40 / (4 * (7 + 1.0 / 3));                       // [m]
  std::vector<double> errors, of_theory;
  double worst_step = 0;
  for (const int steps : {40, 80, 160, 320}) {
    FreeGrains world;
    world.sphere(Vec3::Zero(), radius);
    world.sphere(Vec3(2 * radius - overlap, 0, 0), radius);
    world.material.friction = friction;
    const double normal_force = stiffness * overlap, shear = stiffness / world.material.stiffness_ratio;
    const double area = 4 * friction * normal_force * (half_way - friction * normal_force / shear);
    REQUIRE(area > 0);
    const double dt = round / steps, arm = radius - overlap / 2, speed = 4 * half_way / round;  // at the contact [m/s]
    double slip = 0, last_energy = 0, last_shear = 0;
    for (int k = 0; k < 3 * steps; ++k) {
      const double sign = k % steps < steps / 2 ? 1 : -1;
      for (const int b : {0, 1}) world.particles.spin(b) = Vec3(0, 0, 0.5 * sign * speed / arm);
      world.particles.clear_forces();
      world.contacts.update(world.particles);
      world.totals = world.contacts.compute(world.particles, world.material, dt);
      // V = -(arm w_a + arm w_b) across: the force on A along y does the work F_y V_y on A and B together, negative.
      const double force = world.particles.force(0).y();
      const double work = -0.5 * (force + last_shear) * sign * -speed * dt;
      const double change = world.totals.shear_energy - last_energy + world.totals.slip_work;
      worst_step = std::max(worst_step, std::abs(std::abs(work) - std::abs(change)) / area);
      if (k >= 2 * steps) slip += world.totals.slip_work;
      last_energy = world.totals.shear_energy, last_shear = force;
    }
    errors.push_back(slip / area - 1);
    of_theory.push_back(errors.back() / (-2.0 / 9 * shear * speed * speed * dt * dt / area));
  }
  CAPTURE(errors, of_theory, order(errors), worst_step);
  CHECK(order(errors) == Approx(2).margin(0.01));
  for (const double ratio : of_theory) CHECK(ratio == Approx(1).epsilon(1e-6));
  CHECK(worst_step < 1e-13);
}

TEST_CASE("order: a spring that turns with a rolling pair errs by (pi/4) theta^3 a turn") {
  // The pair turns rigidly in chords, theta a step; a step of the kernel's turn is theta^4/8 of the spring off (see the
  // turn's own test), always stretching or always shrinking it: 2 pi/theta steps a turn give (pi/4) theta^3.
  const double d = 2 * radius - 2e-5, dt = 1e-5;
  std::vector<double> errors, of_theory;
  for (const int steps : {50, 100, 200, 400}) {
    const double theta = 2 * pi / steps;
    FreeGrains world;
    world.material.friction = 1e3;
    world.sphere(Vec3::Zero(), radius);
    world.sphere(Vec3(d, 0, 0), radius);
    world.contacts.restore(world.particles, {{0, 1, Vec3(0, 2, 0)}});
    for (int k = 1; k <= steps; ++k) {
      const Vec3 now = d * Vec3(std::cos(k * theta), std::sin(k * theta), 0), before = world.particles.position(1);
      world.particles.velocity(1) = (now - before) / dt;
      world.particles.position(1) = now;
      world.particles.spin(0) = world.particles.spin(1) = Vec3(0, 0, std::sin(theta) / dt);  // no shear at the contact
      world.contacts.update(world.particles);
      world.contacts.compute(world.particles, world.material, dt);
    }
    errors.push_back((world.contacts.springs().at(0).force - Vec3(0, 2, 0)).norm() / 2);
    of_theory.push_back(errors.back() / (pi / 4 * theta * theta * theta));
  }
  CAPTURE(errors, of_theory, order(errors));
  CHECK(order(errors) == Approx(3).margin(0.05));
  CHECK(of_theory.back() == Approx(1).margin(0.01));
}

TEST_CASE("order: a wave in a chain has the frequency of masses on springs but for (omega dt)^2/24") {
  // Standing wave of one wavelength in 16 grains of a squeezed periodic chain: omega = 2 sqrt(k/m) sin(pi/16), and
  // leap-frog's is higher by (omega dt)^2/24. The frequency is that of the first zero of the amplitude, by a straight
  // line between two steps, third order there.
  const int n = 16;
  const double d = 2 * radius * (1 - 1e-3), omega = 2 * std::sqrt(stiffness / mass) * std::sin(pi / n);
  std::vector<double> errors, of_theory;
  for (const double share : {0.8, 0.4, 0.2, 0.1}) {
    const double dt = share * std::sqrt(mass / stiffness);
    FreeGrains world(0.003, Vec3(n * d, n * d, n * d));
    for (int k = 0; k < n; ++k) world.sphere(Vec3((k + 0.5) * d, 0, 0), radius);
    for (int k = 0; k < n; ++k) world.particles.velocity(k).x() = 1e-3 * std::sin(2 * pi * k / n);
    // From a force-free start the displacement is s sin(omega' t)/omega', amplitude by positions.
    double last = 0, time = 0, zero = 0;
    while (zero == 0) {
      world.step(dt);
      time += dt;
      double amplitude = 0;
      for (int k = 0; k < n; ++k)
        amplitude += (std::as_const(world.particles).position(k).x() - (k + 0.5) * d) * std::sin(2 * pi * k / n);
      if (amplitude < 0) zero = time - dt * amplitude / (amplitude - last);
      last = amplitude;
    }
    errors.push_back(pi / omega / zero - 1);
    of_theory.push_back(errors.back() / (omega * omega * dt * dt / 24));
  }
  CAPTURE(errors, of_theory, order(errors));
  CHECK(of_theory.back() == Approx(1).margin(0.05));
  CHECK(order(errors) == Approx(2).margin(0.1));
}

TEST_CASE("order: an undamped frictionless cloud of spheres and clumps keeps its energy to second order") {
  // A symplectic step keeps an energy that differs from the true one by terms of dt^2: the largest error over a time of
  // several bounces falls fourfold with half the step.
  const auto worst_error = [](double dt) {
    FreeGrains world(0.003);
    world.material.friction = 0;
    world.material.contact_modulus = 5e6;
    Random random(7);
    const ClumpTemplate sphere = make_clump(1, 1), clump = make_clump(3, 1.5);
    for (int k = 0; k < 216; ++k) {
      const Vec3 cell(k % 6, k / 6 % 6, k / 36);
      const std::int32_t b = world.particles.add(k % 2 ? clump : sphere, random.uniform(0.022, 0.028), density,
                                                 0.062 * cell, random.rotation());
      world.particles.velocity(b) = 1.0 * (Vec3(2.5, 2.5, 2.5) - cell);
      world.particles.spin(b) = Vec3(random.uniform(-9, 9), random.uniform(-9, 9), random.uniform(-9, 9));
    }
    const int steps = static_cast<int>(std::lround(0.008 / dt));
    double start = 0, worst = 0, elastic = 0;
    for (int k = 0; k < steps; ++k) {
      world.step(dt);
      if (k == 0) start = world.energy();
      worst = std::max(worst, std::abs(world.energy() / start - 1));
      elastic = std::max(elastic, world.totals.elastic_energy() / start);
    }
    CHECK(elastic > 0.03);  // they do bounce
    return worst;
  };
  std::vector<double> errors;
  for (const double dt : {4e-5, 2e-5, 1e-5}) errors.push_back(worst_error(dt));
  CAPTURE(errors, order(errors));
  CHECK(order(errors) > 1.7);
  CHECK(errors.back() < 1e-3);
}
