// Quiet boundaries, Rayleigh damping and tractions: how waves leave, and how they fade.
#include <catch2/catch.hpp>
#include <cmath>

#include "continuum_client/cycle.hpp"
#include "continuum_client/settings.hpp"
#include "continuum_client/stages.hpp"
#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

// A column of cubes of side h = 1/zones_per_meter whose bottom absorbs; nodes move along `axis` alone, so that the
// column carries plane waves: 2 P, 0 S. The pulse 0.5 (1 - cos) of `width` zones starts in the middle and runs down.
struct Column {
  static constexpr int zones = 200;
  static constexpr double h = 0.05;
  Grid grid = brick(h, h, zones* h, 1, 1, zones);
  std::vector<double> mass = lumped_masses(grid);
  int axis;
  double speed;
  InternalForce force{assemble_stiffness(grid)};
  Vec3s is_free = Vec3s(grid.node_count(), Vec3::Zero());
  Motion motion{is_free, is_free};
  Vec3s internal = is_free;

  explicit Column(int along) : axis(along) {
    speed = axis == 2 ? p_wave_speed(test_moduli, test_density) : s_wave_speed(test_moduli, test_density);
    for (Vec3& f : is_free) f[axis] = 1;
  }
  // u = f(z + c t): v = c f', taken at t = -dt/2.
  void start_pulse(int width, double dt) {
    const double length = width * h, middle = -0.5 * zones * h;
    for (std::size_t i = 0; i < grid.node_count(); ++i) {
      const auto value = [&](double z) {
        const double s = (z - middle) / length;
        return std::abs(s) < 0.5 ? 0.5 * (1 + std::cos(2 * pi * s)) : 0.0;
      };
      const double z = grid.node[i].z();
      motion.displacement[i][axis] = value(z);
      motion.velocity[i][axis] = (value(z) - value(z - speed * dt)) / dt;
    }
  }
};

// Largest displacement left once a pulse should have gone through the bottom.
double echo(int axis, int width, double step_fraction) {
  Column c(axis);
  const Vec3s dashpot = quiet_dashpots(c.grid, Supports::Quiet, {});
  Vec3s at_bottom(dashpot.size(), Vec3::Zero());  // the sides of a column of plane waves absorb nothing
  for (std::size_t i = 0; i < dashpot.size(); ++i)
    if (c.grid.node[i].z() < c.grid.low.z() + 1e-9) {
      const double area = Column::h * Column::h / 4;
      at_bottom[i][axis] = area * test_density * c.speed;
      // What quiet_dashpots() gives there: bottom and, at these corners, two half faces of the sides.
      const double side = 2 * area * test_density * s_wave_speed(test_moduli, test_density);
      if (axis == 2) CHECK(dashpot[i].z() == Approx(at_bottom[i].z() + side));
    }
  const double dt =
      step_fraction * stable_step(frequency_squared_bound(assemble_stiffness(c.grid), c.mass, c.is_free), 0);
  Integrator integrator(c.mass, c.is_free, at_bottom);
  c.start_pulse(width, dt);
  const auto steps = static_cast<int>((0.65 * Column::zones + 1.5 * width) * Column::h / c.speed / dt);
  for (int n = 0; n < steps; ++n) {
    c.force.evaluate(c.motion.displacement, c.internal);
    integrator.advance(c.motion, c.internal, c.force.reference, {}, 0, {dt, dt}, 1e9);
  }
  // Less the mean: nothing holds the column, and what the pulse left it with as a whole is no wave.
  double low = 1e9, high = -1e9;
  for (const Vec3& u : c.motion.displacement) low = std::min(low, u[axis]), high = std::max(high, u[axis]);
  return high - low;
}

}  // namespace

TEST_CASE("waves along the normal leave through a quiet boundary") {
  // Dashpots on the diagonal, pulses of 48, 24 and 12 zones: known to leave .004, .012 and .034 of their peak at half of
  // the stable step and .002, .007, .021 at 0.9, where a lagged dashpot blows up. What is left is the zones' dispersion:
  // it falls by about the square of the width.
  for (const int axis : {2, 0})
    for (const auto& [fraction, known] :
         {std::pair{0.5, std::array{0.004, 0.012, 0.034}}, std::pair{0.9, std::array{0.002, 0.007, 0.021}}}) {
      std::array<double, 3> left{};
      for (int k = 0; k < 3; ++k) left[static_cast<std::size_t>(k)] = echo(axis, 48 >> k, fraction);
      INFO("axis " << axis << ", " << fraction << " of the step: " << left[0] << " " << left[1] << " " << left[2]);
      for (std::size_t k = 0; k < 3; ++k) CHECK(left[k] < known[k]);
      CHECK(left[2] / left[0] > 4);
    }
}

TEST_CASE("dashpots take out of the ledger what they take out of the motion, at any step") {
  // The work of -c (v- + v+) / 2 at n closes the ledger as any other force's does; k = c dt / 2m of a hundred stops a node
  // instead of throwing it about.
  Grid grid = brick(1, 1, 1, 3, 3, 3);
  distort(grid, 1.0 / 3, 0.1);
  const std::vector<double> mass = lumped_masses(grid);
  const Vec3s is_free = free_components(grid, Supports::BottomFixed, mass);
  InternalForce force(assemble_stiffness(grid));
  const double dt = 0.9 * stable_step(frequency_squared_bound(assemble_stiffness(grid), mass, is_free), 0);
  for (const double strength : {0.1, 1.0, 100.0}) {
    Vec3s dashpot(mass.size()), internal(mass.size());
    for (std::size_t i = 0; i < mass.size(); ++i) dashpot[i] = Vec3(1, 0.5, 2) * strength * 2 * mass[i] / dt;
    Integrator integrator(mass, is_free, dashpot);
    Motion motion{Vec3s(mass.size(), Vec3::Zero()), Vec3s(mass.size(), Vec3(0.1, 0.2, -0.3))};
    for (std::size_t i = 0; i < mass.size(); ++i) motion.velocity[i] = motion.velocity[i].cwiseProduct(is_free[i]);
    double start = 0, worst = 0;
    for (int n = 0; n < 300; ++n) {
      force.evaluate(motion.displacement, internal);
      integrator.advance(motion, internal, force.reference, {}, 0, {dt, dt}, 1e9);
      const Ledger& l = integrator.ledger();
      // The first booking has half a step's work of dashpots that no step before brought.
      if (n == 0) start = l.residual();
      if (n > 0) worst = std::max(worst, std::abs(l.residual() - start) / std::abs(start));
    }
    INFO("strength " << strength << ": ledger error " << worst << ", kinetic " << integrator.ledger().kinetic);
    CHECK(worst < 1e-12);
  }
}

TEST_CASE("Rayleigh damping fades each mode by its own share of critical") {
  // A mode of frequency w fades as exp(-xi w t), xi = a/(2w) + b w/2: over a period by 2 pi xi. Column held at the bottom,
  // modes sin((2k+1) pi s / 2).
  Column c(2);
  for (std::size_t i = 0; i < c.grid.node_count(); ++i)
    if (c.grid.node[i].z() < c.grid.low.z() + 1e-9) c.is_free[i].setZero();
  const double length = Column::zones * Column::h;
  const double first = 0.5 * pi * c.speed / length;
  for (const auto& [a, b] :
       {std::pair{0.05 * first, 0.0}, std::pair{0.0, 0.05 / first}, std::pair{0.03 * first, 0.02 / first}})
    for (const int mode : {0, 1}) {
      const double omega = (2 * mode + 1) * first, xi = a / (2 * omega) + b * omega / 2;
      const double bound = frequency_squared_bound(assemble_stiffness(c.grid), c.mass, c.is_free);
      const double dt = std::min(0.5 * stable_step(bound, 0, b), 2 * pi / omega / 2000);
      Vec3s dashpot;
      if (a > 0)
        for (const double m : c.mass) dashpot.push_back(Vec3::Constant(a * m));
      CoupledGround ground;
      ground.grid = c.grid;
      ground.internal_force = InternalForce(assemble_stiffness(c.grid));
      ground.integrator = Integrator(c.mass, c.is_free, dashpot);
      ground.stiffness_damping = b;
      ground.step_sizes = {dt, dt};
      ground.velocity_limit = 1e9;
      ground.motion = {Vec3s(c.mass.size(), Vec3::Zero()), Vec3s(c.mass.size(), Vec3::Zero())};
      ground.internal = ground.motion.displacement;
      for (std::size_t i = 0; i < c.mass.size(); ++i)
        ground.motion.displacement[i].z() = std::sin((mode + 0.5) * pi * (c.grid.node[i].z() + length) / length);
      ground.internal_force.evaluate(ground.motion.displacement, ground.last_internal = ground.internal);
      const auto energy = [&] { return ground.integrator.ledger().kinetic + ground.integrator.ledger().elastic; };
      const auto step = [&] {
        ground.compute_internal_forces();
        ground.advance();
      };
      step();
      const double before = energy();
      const int steps = static_cast<int>(std::lround(2 * pi / omega / dt));  // one period
      for (int n = 0; n < steps; ++n) step();
      // Energy fades twice as fast as the amplitude. Over a whole period of the damped motion the energy's ripple closes.
      const double measured = -0.5 * std::log(energy() / before) / (2 * pi);
      INFO("a " << a << " b " << b << " mode " << mode << ": share of critical " << measured << ", exact " << xi);
      CHECK(measured == Approx(xi).epsilon(0.03));
    }
}

TEST_CASE("stiffness-proportional damping shortens the step as far as the formula says") {
  // One zone, highest mode: stable just below the limit, not above.
  const Grid grid = brick(1, 1, 1, 2, 2, 2);
  const std::vector<double> mass = lumped_masses(grid);
  const Vec3s is_free = free_components(grid, Supports::BottomFixed, mass);
  const StiffnessMatrix k = assemble_stiffness(grid);
  const double omega_squared = lanczos_frequency_squared(k, mass, is_free, 80);
  for (const double xi : {0.05, 0.5, 2.0}) {
    const double b = 2 * xi / std::sqrt(omega_squared);
    for (const double fraction : {0.98, 1.02}) {
      const double dt = fraction * stable_step(omega_squared, 0, b);
      CoupledGround ground;
      ground.grid = grid;
      ground.internal_force = InternalForce(k);
      ground.integrator = Integrator(mass, is_free);
      ground.stiffness_damping = b;
      ground.step_sizes = {dt, dt};
      ground.velocity_limit = 1e300;
      Random random(1);
      ground.motion = {Vec3s(mass.size(), Vec3::Zero()), Vec3s(mass.size(), Vec3::Zero())};
      for (std::size_t i = 0; i < mass.size(); ++i)
        for (int a = 0; a < 3; ++a) ground.motion.velocity[i][a] = is_free[i][a] * random.uniform(-1, 1);
      ground.internal = ground.last_internal = ground.motion.displacement;
      for (int n = 0; n < 600; ++n) {
        ground.compute_internal_forces();
        ground.advance();
      }
      double largest = 0;
      for (const Vec3& v : ground.motion.velocity) largest = std::max(largest, v.norm());
      INFO("xi " << xi << ", " << fraction << " of the limit: velocity " << largest);
      CHECK((largest > 1e3) == (fraction > 1));
    }
  }
}

TEST_CASE("a traction loads the faces in its box, and settles a column by p H / M") {
  const Grid grid = brick(1, 1, 4, 2, 2, 16);
  SurfaceLoad load;
  load.low = Vec3(-1, -1, -0.01), load.high = Vec3(1, 1, 0.01), load.traction = Vec3(0, 0, -1e4), load.where = "test";
  const Vec3s force = loaded_nodes(grid, load, {});
  Vec3 sum = Vec3::Zero();
  for (const Vec3& f : force) sum += f;
  CHECK(sum.z() == Approx(-1e4));
  const std::vector<double> mass = lumped_masses(grid);
  Vec3s u;
  solve_static(assemble_stiffness(grid), free_components(grid, Supports::Rollers, mass), force, u, {});
  CHECK(-u.back().z() == Approx(1e4 * 4 / test_moduli.constrained()).epsilon(1e-9));
  load.low.z() = 1, load.high.z() = 2;
  CHECK_THROWS_WITH(loaded_nodes(grid, load, {}), Catch::Contains("no outer face"));
  // Ramp up, plateau, ramp down: the middle of a smooth ramp is a half.
  load.ramp = 2, load.duration = 3;
  CHECK(load_share(load, 0) == 0);
  CHECK(load_share(load, 1) == Approx(0.5));
  CHECK(load_share(load, 4) == 1);
  CHECK(load_share(load, 6) == Approx(0.5));
  CHECK(load_share(load, 8) == 0);
}

TEST_CASE("held directions hold, and a packet's energy stays") {
  // A packet along y in a column of zones: 1/2 m v^2 over its nodes at the start, all of it kinetic, and no work ever done.
  const std::string scene =
      "gravity: 0 packet { velocity { y: 0.01 } center { z: -5 } length: 4 wavelength: 2 } run { duration: 0.05 } "
      "continuum { dynamic: true supports: BOTTOM_FIXED block { height: 10 zones_x: 1 zones_y: 1 zones_z: 40 } held { ";
  const RunReport sheared = run_continuum(parse_scene(scene + "x: true z: true } }", "test.txt"), {}, nullptr, {});
  // Mean of the squared hump 3/8, of the squared cosine 1/2, over 4 m of 1 m2.
  const double start = 0.5 * 1630 * 4 * 0.01 * 0.01 * 3.0 / 16;
  const Ledger& l = sheared.ledger;
  INFO("start " << l.start << " of " << start << " J, later " << l.kinetic << " + " << l.elastic << ", residual "
                << sheared.ledger_residual_fraction);
  CHECK(l.start == Approx(start).epsilon(1e-12));
  CHECK(l.kinetic + l.elastic == Approx(l.start).epsilon(1e-12));
  CHECK(l.elastic > 0.3 * l.start);
  CHECK(sheared.ledger_residual_fraction < 1e-13);
  const RunReport held = run_continuum(parse_scene(scene + "y: true } }", "test.txt"), {}, nullptr, {});
  CHECK(held.ledger.start == 0);
  CHECK(held.largest_displacement == 0);
}

}  // namespace lockstep::continuum
