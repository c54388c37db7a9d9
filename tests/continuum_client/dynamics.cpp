// Waves, stability, energy and determinism of the explicit scheme.
#include <Eigen/Dense>
#include <catch2/catch.hpp>
#include <cmath>

#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

// Wave speed seen by the scheme in a column of height 1 that is held at the bottom: it starts at rest in its lowest
// mode, u = sin(pi s / 2), and the top passes through zero after a quarter period 1/c. `direction` 2: P-waves, 0:
// S-waves.
double measured_speed(int zones, int direction, double speed) {
  const Grid grid = brick(1.0 / zones, 1.0 / zones, 1, 1, 1, zones);
  Vec3s is_free(grid.node_count(), Vec3::Zero());
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    if (grid.node[i].z() > -1 + 1e-9) is_free[i][direction] = 1;
  FreeRun run(grid, is_free);
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    run.motion.displacement[i][direction] = std::sin(pi / 2 * (grid.node[i].z() + 1));
  const double dt = 0.5 / zones / speed;
  // At rest at n = 0: v(-1/2) = -v(1/2), which is half of the first step's change, backwards.
  run.force.evaluate(run.motion.displacement, run.internal);
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    run.motion.velocity[i] = 0.5 * dt * run.internal[i].cwiseProduct(is_free[i]) / run.integrator.mass()[i];
  double before = 0, after = 1;
  int n = 0;
  for (; after > 0; ++n) {
    before = after;
    run.step(dt, 0);
    after = run.motion.displacement.back()[direction];
  }
  // The cosine is straight near its zero: interpolation errs with the third power of the step.
  return 1 / (dt * (n - 1 + before / (before - after)));
}

double dense_frequency_squared(const StiffnessMatrix& k, const std::vector<double>& mass, const Vec3s& is_free) {
  const auto n = static_cast<Eigen::Index>(mass.size());
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(3 * n, 3 * n);
  for (Eigen::Index column = 0; column < 3 * n; ++column) {
    Vec3s u(mass.size(), Vec3::Zero()), f(mass.size());
    u[column / 3][column % 3] = is_free[column / 3][column % 3] / std::sqrt(mass[column / 3]);
    k.multiply(u, f);
    for (Eigen::Index i = 0; i < n; ++i)
      a.block<3, 1>(3 * i, column) = f[i].cwiseProduct(is_free[i]) / std::sqrt(mass[i]);
  }
  return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(a, Eigen::EigenvaluesOnly).eigenvalues()[3 * n - 1];
}

// Largest speed after `steps` from small random velocities.
double speed_after(FreeRun& run, double dt, double damping, int steps) {
  Random random(5);
  for (std::size_t i = 0; i < run.motion.velocity.size(); ++i)
    for (int c = 0; c < 3; ++c) run.motion.velocity[i][c] = run.integrator.is_free()[i][c] * random.uniform(-1, 1);
  double largest = 0;
  for (int n = 0; n < steps && largest < 1e9; ++n) {
    run.step(dt, damping);
    largest = 0;
    for (const Vec3& v : run.motion.velocity) largest = std::max(largest, v.norm());
  }
  return largest;
}

Grid distorted_brick() {
  Grid grid = brick(0.6, 0.6, 0.6, 3, 3, 3);
  distort(grid, 0.2, 0.2);
  return grid;
}

}  // namespace

TEST_CASE("P- and S-waves have the speeds of the material, with order 2") {
  const double speeds[2] = {s_wave_speed(test_moduli, test_density), p_wave_speed(test_moduli, test_density)};
  CHECK(speeds[1] == Approx(191.3).epsilon(1e-3));
  CHECK(speeds[0] == Approx(102.2).epsilon(1e-3));
  for (int direction : {0, 2}) {
    const double c = speeds[direction / 2];
    const double e8 = std::abs(measured_speed(8, direction, c) / c - 1),
                 e16 = std::abs(measured_speed(16, direction, c) / c - 1),
                 e32 = std::abs(measured_speed(32, direction, c) / c - 1);
    const double order = std::log2(e8 / e32) / 2;
    INFO((direction == 2 ? "P" : "S") << "-wave speed errors with 8, 16, 32 zones: " << e8 << " " << e16 << " " << e32
                                      << ", order " << order);
    CHECK(e32 < 1e-4);
    CHECK(order == Approx(2).margin(0.2));
  }
}

TEST_CASE("Lanczos meets the true highest frequency and Gershgorin bounds it") {
  const Grid grid = distorted_brick();
  const StiffnessMatrix k = assemble_stiffness(grid);
  const std::vector<double> mass = lumped_masses(grid);
  Vec3s is_free(grid.node_count(), Vec3::Ones());
  for (int i = 0; i < 16; ++i) is_free[i] = Vec3(i % 2, 0, 0);
  const double exact = dense_frequency_squared(k, mass, is_free);
  const double lanczos = lanczos_frequency_squared(k, mass, is_free, 40),
               gershgorin = gershgorin_frequency_squared(k, mass, is_free);
  INFO("of the true omega^2: Lanczos " << lanczos / exact << ", Gershgorin " << gershgorin / exact);
  CHECK(lanczos / exact == Approx(1).margin(1e-4));
  CHECK(lanczos / exact < 1 + 1e-9);
  CHECK(gershgorin / exact > 1);
  CHECK(gershgorin / exact < 3);
  CHECK(frequency_squared_bound(k, mass, is_free) > exact);
}

TEST_CASE("Lanczos' estimate only rises with more products, far beyond what the mesh has directions") {
  // The matrix of p products is the leading part of that of p + 1, whose largest eigenvalue is no smaller (Cauchy's
  // interlacing). A column of 5 zones, nodes free along z: 20 unknowns, so that beyond 20 products all off-diagonals are
  // round-off. Densities change nothing but the scale.
  double worst_fall = 0, worst_error = 0;
  for (const double density : {1.0, 10.0, 38.2, 100.0, 381.7, 1e3, 1e4}) {
    Grid grid = brick(0.1, 0.1, 0.5, 1, 1, 5);
    for (Material& m : grid.materials) m.density = density;
    const StiffnessMatrix k = assemble_stiffness(grid);
    const std::vector<double> mass = lumped_masses(grid);
    Vec3s is_free(grid.node_count());
    for (std::size_t i = 0; i < is_free.size(); ++i) is_free[i] = Vec3(0, 0, grid.node[i].z() > grid.low.z() ? 1 : 0);
    const double exact = dense_frequency_squared(k, mass, is_free);
    double last = 0;
    for (int products = 1; products <= 80; ++products) {
      const double estimate = lanczos_frequency_squared(k, mass, is_free, products);
      worst_fall = std::max(worst_fall, 1 - estimate / std::max(last, 1e-300));
      worst_error = std::max(worst_error, products < 25 ? 0.0 : std::abs(estimate / exact - 1));
      last = std::max(last, estimate);
    }
  }
  INFO("largest fall " << worst_fall << ", error from 25 products on " << worst_error);
  CHECK(worst_fall < 1e-12);
  CHECK(worst_error < 1e-3);
}

TEST_CASE("contact stiffness on nodes is bounded by the coupled limit") {
  // Springs to fixed points at random nodes: their exact frequency lies below omega_c^2 + max 2 sum(k w) / m.
  const Grid grid = distorted_brick();
  StiffnessMatrix k = assemble_stiffness(grid);
  const std::vector<double> mass = lumped_masses(grid);
  const Vec3s is_free(grid.node_count(), Vec3::Ones());
  const double alone = dense_frequency_squared(k, mass, is_free);
  const std::vector<std::int32_t> node = {48, 52, 57, 63};
  const std::vector<double> stiffness = {1e7, 3e6, 2e7, 5e6};
  std::vector<double> node_mass;
  for (const std::int32_t i : node) node_mass.push_back(mass[i]);
  CoupledLimit limit({alone, node_mass, 0, 0});
  limit.set_contacts(stiffness);
  const double bound = 4 / (limit.interface_limit() * limit.interface_limit());
  for (std::size_t i = 0; i < node.size(); ++i) k.block[k.row_begin[node[i]]] += stiffness[i] * Mat3::Identity();
  const double exact = dense_frequency_squared(k, mass, is_free);
  INFO("true over bound " << exact / bound << ", alone over bound " << alone / bound);
  CHECK(exact < bound);
  CHECK(exact > alone * 1.01);
  CHECK(exact > 0.4 * bound);
}

TEST_CASE("the ground blows up just above the stable step and not just below") {
  const Grid grid = distorted_brick();
  const Vec3s is_free(grid.node_count(), Vec3::Ones());
  const StiffnessMatrix k = assemble_stiffness(grid);
  const double limit = stable_step(dense_frequency_squared(k, lumped_masses(grid), is_free), 0);
  FreeRun above(grid, is_free), below(grid, is_free);
  CHECK(speed_after(above, 1.01 * limit, 0, 3000) > 1e9);
  CHECK(speed_after(below, 0.99 * limit, 0, 3000) < 100);
}

TEST_CASE("local damping shrinks the stable step by 1/sqrt(1 + alpha)") {
  // One free component is one oscillator: the factor is exact. In the mode that turns sign at each step the damped
  // force is (1 + alpha) F.
  const Grid grid = brick(1, 1, 1, 1, 1, 1);
  Vec3s is_free(grid.node_count(), Vec3::Zero());
  is_free[7].z() = 1;
  const StiffnessMatrix k = assemble_stiffness(grid);
  const double omega_squared = dense_frequency_squared(k, lumped_masses(grid), is_free);
  for (double alpha : {0.2, 0.7}) {
    const double limit = stable_step(omega_squared, alpha);
    CHECK(limit == Approx(stable_step(omega_squared, 0) / std::sqrt(1 + alpha)).epsilon(1e-14));
    FreeRun above(grid, is_free), below(grid, is_free);
    CAPTURE(alpha);
    CHECK(speed_after(above, 1.01 * limit, alpha, 5000) > 1e9);
    CHECK(speed_after(below, 0.99 * limit, alpha, 5000) < 1);
  }
  // The whole brick: the factor is safe, and without it damped motion is not.
  const Grid many = distorted_brick();
  const Vec3s all(many.node_count(), Vec3::Ones());
  const double undamped = stable_step(dense_frequency_squared(assemble_stiffness(many), lumped_masses(many), all), 0);
  FreeRun with_factor(many, all), without(many, all);
  CHECK(speed_after(with_factor, 0.99 * undamped / std::sqrt(1.7), 0.7, 3000) < 10);
  CHECK(speed_after(without, 0.99 * undamped, 0.7, 3000) > 1e9);
}

TEST_CASE("a node that runs away is named") {
  const Grid grid = distorted_brick();
  FreeRun run(grid, Vec3s(grid.node_count(), Vec3::Ones()));
  run.motion.velocity[17] = Vec3(0, 0, std::nan(""));
  CHECK(run.step(1e-6, 0, 100).runaway_node == 17);
}

TEST_CASE("the ledger of an undamped free vibration closes to round-off for any stable step") {
  // Kinetic energy from v(n-1/2) . v(n+1/2) plus 1/2 u K u is constant, see integrator.hpp; with either velocity alone
  // it would swing with the step.
  const Grid grid = distorted_brick();
  const Vec3s is_free(grid.node_count(), Vec3::Ones());
  const double limit = stable_step(dense_frequency_squared(assemble_stiffness(grid), lumped_masses(grid), is_free), 0);
  for (double fraction : {0.9, 0.45, 0.1}) {
    FreeRun run(grid, is_free);
    Random random(6);
    for (Vec3& v : run.motion.velocity)
      for (int c = 0; c < 3; ++c) v[c] = 1e-3 * random.uniform(-1, 1);
    run.step(fraction * limit, 0);
    const double start = run.integrator.ledger().residual();
    double worst = 0, elastic = 0;
    for (int n = 0; n < 1000; ++n) {
      run.step(fraction * limit, 0);
      worst = std::max(worst, std::abs(run.integrator.ledger().residual() - start) / start);
      elastic = std::max(elastic, run.integrator.ledger().elastic / start);
    }
    INFO("fraction " << fraction << ": residual " << worst << ", largest share of elastic energy " << elastic);
    CHECK(worst < 1e-11);
    CHECK(elastic > 0.3);
  }
}

TEST_CASE("the ledger accounts for gravity, damping, loads at the interface and a change of the step") {
  // A brick that is dropped onto its own supports with a load on its top: work in = energy + what damping took out.
  // Half of each step's damping work is booked on either side of n, so nothing is left over but the step change of the
  // first load.
  const Grid grid = brick(1, 1, 1, 3, 3, 3);
  const std::vector<double> mass = lumped_masses(grid);
  FreeRun run(grid, free_components(grid, Supports::BottomFixed, mass));
  const InterfaceSurface surface = interface_surface(grid);
  const Vec3s push(surface.node_count(), Vec3(3, 0, -20)), fading(surface.node_count(), Vec3(0, 5, 0));
  const Vec3 gravity(0, 0, -9.81);
  const double dt = 0.5 * stable_step(frequency_squared_bound(run.stiffness, mass, run.integrator.is_free()), 0.3);
  double worst = 0;
  StepSizes steps{dt, dt};
  for (int n = 0; n < 500; ++n) {
    steps.into = steps.out_of;
    if (n == 50) steps.out_of = 0.4 * dt;
    run.force.evaluate(run.motion.displacement, run.internal);
    run.integrator.advance(run.motion, run.internal, run.force.reference, {gravity, {}, surface.node, push, fading},
                           0.3, steps, 1e9);
    const Ledger& l = run.integrator.ledger();
    if (n > 0) worst = std::max(worst, std::abs(l.residual()) / (std::abs(l.work.gravity) + l.work.damped));
  }
  const Ledger& l = run.integrator.ledger();
  INFO("worst residual over work " << worst << "; gravity " << l.work.gravity << ", interface "
                                   << l.work.interface << ", baseline " << l.work.baseline << ", damped "
                                   << l.work.damped);
  CHECK(worst < 1e-11);
  CHECK(l.work.interface > 0);
  CHECK(l.work.baseline > 0);
  CHECK(l.work.damped > 0);
  CHECK(std::abs(l.work.step_change) > 1e-6 * l.work.damped);
}

TEST_CASE("the same run gives the same bits") {
  const auto hash = [] {
    const Grid grid = distorted_brick();
    FreeRun run(grid, Vec3s(grid.node_count(), Vec3::Ones()));
    speed_after(run, 1e-4, 0.2, 200);
    Hash h;
    h.add(std::span<const Vec3>(run.motion.displacement));
    return h.value();
  };
  CHECK(hash() == hash());
}

}  // namespace lockstep::continuum
