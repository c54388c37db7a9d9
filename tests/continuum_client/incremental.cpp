// The incremental route beside the assembled one, and what it alone can do.
#include "continuum_client/incremental_force.hpp"

#include <Eigen/Eigenvalues>
#include <catch2/catch.hpp>

#include "continuum_client/cycle.hpp"
#include "continuum_client/settings.hpp"
#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

Vec3 largest_difference(const Vec3s& a, const Vec3s& b) {
  Vec3 worst = Vec3::Zero();
  for (std::size_t i = 0; i < a.size(); ++i) worst = worst.cwiseMax((a[i] - b[i]).cwiseAbs());
  return worst;
}

double largest(const Vec3s& a) {
  double norm = 0;
  for (const Vec3& v : a) norm = std::max(norm, v.norm());
  return norm;
}

// Elastic up to a largest shear stress, then perfectly plastic: the deviator is cut back to |s| = 2 k (radially).
constexpr double yield = 1e3;  // [Pa]
Mat3 cut_deviator(const ElasticModuli& moduli, const Mat3& stress, const Mat3& strain, double dilatation) {
  const Mat3 trial = linear_elastic(moduli, stress, strain, dilatation);
  const Mat3 mean = trial.trace() / 3 * Mat3::Identity(), deviator = trial - mean;
  const double size = deviator.norm(), limit = std::sqrt(2.0) * yield;
  return size > limit ? Mat3(mean + limit / size * deviator) : trial;
}

}  // namespace

TEST_CASE("stored stresses move the ground as the assembled operator does, to round-off") {
  // 500 steps of free vibration of a distorted block with an initial stress, on any number of threads.
  for (const ZoneKind kind : zone_kinds) {
    Grid grid = brick(1, 1, 1, 3, 3, 4, test_material, kind);
    // Held before it is distorted: its bottom is plane then.
    const Vec3s is_free = free_components(grid, Supports::BottomFixed, lumped_masses(grid));
    distort(grid, 0.25, 0.15);
    const std::vector<double> mass = lumped_masses(grid);
    const StiffnessMatrix k = assemble_stiffness(grid);
    InitialState initial;
    reach_equilibrium(k, mass, is_free, Vec3(0, 0, -9.81), {0.7, 1e-8, 1000, 0.9}, initial.displacement, {});
    InternalForce assembled(k);
    k.multiply(initial.displacement, assembled.reference);
    const double dt = 0.5 * stable_step(frequency_squared_bound(k, mass, is_free), 0);
    Random random(2);
    Vec3s start(mass.size());
    for (std::size_t i = 0; i < mass.size(); ++i)
      for (int c = 0; c < 3; ++c) start[i][c] = 0.01 * is_free[i][c] * random.uniform(-1, 1);
    Motion a{Vec3s(mass.size(), Vec3::Zero()), start};
    Integrator integrator(mass, is_free);
    NodalLoads loads;
    loads.gravity = Vec3(0, 0, -9.81);
    Vec3s force_a(mass.size()), force_b(mass.size());
    for (int n = 0; n < 500; ++n) {
      assembled.evaluate(a.displacement, force_a);
      integrator.advance(a, force_a, assembled.reference, loads, 0, {dt, dt}, 1e9);
    }
    std::uint64_t hash = 0;
    for (const int threads : {1, 2, 3}) {
      Team team(threads);
      IncrementalForce incremental(grid, {}, initial, false);
      Integrator other(mass, is_free);
      Motion b{Vec3s(mass.size(), Vec3::Zero()), start};
      for (int n = 0; n < 500; ++n) {
        // At n = 0 no way has been gone yet.
        incremental.advance(b.displacement, n > 0 ? b.velocity : Vec3s(mass.size(), Vec3::Zero()), dt, force_b, team);
        other.advance(b, force_b, assembled.reference, loads, 0, {dt, dt}, 1e9);
        other.set_elastic(incremental.work());
      }
      const double error = largest_difference(a.displacement, b.displacement).norm() / largest(a.displacement);
      const double energy =
          std::abs(other.ledger().elastic - integrator.ledger().elastic) / std::abs(integrator.ledger().elastic);
      INFO("kind " << static_cast<int>(kind) << ", " << threads << " threads: displacement " << error << ", energy "
                   << energy);
      CHECK(error < 1e-11);
      CHECK(energy < 1e-10);
      Hash h;
      h.add(std::span<const Vec3>(b.displacement));
      if (hash == 0) hash = h.value();
      CHECK(h.value() == hash);
    }
  }
}

TEST_CASE("a stressed block turned by a right angle keeps its stress in its own axes") {
  // Stress diag(-1, -2, -3) kPa turned about z by 90 degrees in 90, 180 and 360 steps: xx and yy change places. The turn
  // of a step by an angle a is exact for tan(a/2): its error is of the third order in a, so the sum falls with the square.
  for (const ZoneKind kind : zone_kinds) {
    std::vector<double> errors;
    for (const int steps : {90, 180, 360}) {
      Grid grid = brick(1, 1, 1, 2, 2, 2, test_material, kind);
      InitialState initial;
      initial.stress.assign(grid.zone_count(), Vec3(-1e3, -2e3, -3e3).asDiagonal());
      initial.displacement.assign(grid.node_count(), Vec3::Zero());
      IncrementalForce force(grid, {}, initial, true);
      Vec3s u(grid.node_count(), Vec3::Zero()), v(grid.node_count()), f(grid.node_count());
      for (int n = 1; n <= steps; ++n) {
        const Mat3 turn = Eigen::AngleAxisd(0.5 * pi * n / steps, Vec3::UnitZ()).toRotationMatrix();
        for (std::size_t i = 0; i < u.size(); ++i) {
          const Vec3 now = turn * grid.node[i] - grid.node[i];
          v[i] = now - u[i], u[i] = now;
        }
        force.advance(u, v, 1, f);
      }
      const Mat3 expected = Vec3(-2e3, -1e3, -3e3).asDiagonal();
      errors.push_back((force.zone_stress(3) - expected).norm() / expected.norm());
      INFO("kind " << static_cast<int>(kind) << ", work " << force.work());
      CHECK(std::abs(force.work()) < 1e-6 * 3e3);  // of a volume of 1 m3: a rotation does none
    }
    INFO("kind " << static_cast<int>(kind) << ": " << errors[0] << " " << errors[1] << " " << errors[2]);
    CHECK(errors[0] < 1e-3);
    CHECK(std::log2(errors[0] / errors[1]) > 1.9);
    CHECK(std::log2(errors[1] / errors[2]) > 1.9);
  }
}

TEST_CASE("simple shear follows the rate that the zones integrate") {
  // x += g y: the spin is g'/2 and the stress rate that of Jaumann: tau = G sin g, sigma_x = -sigma_y = G (1 - cos g).
  // (Beyond g = pi/2 the known weakness of that rate: ground does not shear that far here.)
  for (const ZoneKind kind : zone_kinds) {
    Grid grid = brick(1, 1, 1, 2, 2, 2, test_material, kind);
    InitialState initial;
    initial.displacement.assign(grid.node_count(), Vec3::Zero());
    IncrementalForce force(grid, {}, initial, true);
    const int steps = 400;
    const double last = 1;
    Vec3s u(grid.node_count(), Vec3::Zero()), v(grid.node_count()), f(grid.node_count());
    for (int n = 1; n <= steps; ++n) {
      for (std::size_t i = 0; i < u.size(); ++i) {
        const Vec3 now(last * n / steps * grid.node[i].y(), 0, 0);
        v[i] = now - u[i], u[i] = now;
      }
      force.advance(u, v, 1, f);
    }
    const Mat3 s = force.zone_stress(0) / test_moduli.shear;
    INFO("kind " << static_cast<int>(kind) << ": tau/G " << s(0, 1) << " exact " << std::sin(last) << ", sigma_x/G "
                 << s(0, 0) << " exact " << 1 - std::cos(last));
    CHECK(s(0, 1) == Approx(std::sin(last)).epsilon(1e-5));
    CHECK(s(0, 0) == Approx(1 - std::cos(last)).epsilon(1e-5));
    CHECK(s(1, 1) == Approx(-(1 - std::cos(last))).epsilon(1e-5));
  }
}

TEST_CASE("another law is another function") {
  // Shear strain far beyond yield: the shear stress stays at k, and the work goes on as k times the strain.
  Grid grid = brick(1, 1, 1, 2, 2, 2);
  InitialState initial;
  initial.displacement.assign(grid.node_count(), Vec3::Zero());
  IncrementalForce force(grid, {}, initial, false, cut_deviator);
  Vec3s u(grid.node_count(), Vec3::Zero()), v(grid.node_count()), f(grid.node_count());
  const int steps = 1000;
  const double last = 0.001;
  for (int n = 1; n <= steps; ++n) {
    for (std::size_t i = 0; i < u.size(); ++i) v[i] = Vec3(last / steps * grid.node[i].y(), 0, 0), u[i] += v[i];
    force.advance(u, v, 1, f);
  }
  const double elastic_strain = yield / test_moduli.shear;
  CHECK(force.zone_stress(0)(0, 1) == Approx(yield).epsilon(1e-9));
  CHECK(force.work() == Approx(yield * (last - 0.5 * elastic_strain)).epsilon(1e-4));
}

TEST_CASE("a zone turned inside out is named, and large strain asks for the incremental route") {
  Grid grid = brick(1, 1, 1, 2, 2, 2);
  InitialState initial;
  initial.displacement.assign(grid.node_count(), Vec3::Zero());
  IncrementalForce force(grid, {}, initial, true);
  Vec3s u(grid.node_count(), Vec3::Zero()), f(grid.node_count());
  u.back() = Vec3(-2, -2, -2);
  CHECK_THROWS_WITH(force.advance(u, u, 1, f), Catch::Contains("turned inside out"));
  CHECK_THROWS_WITH(read_settings(parse_scene("continuum { block { } large_strain: true }", "t")),
                    Catch::Contains("route: INCREMENTAL"));
}

}  // namespace lockstep::continuum
