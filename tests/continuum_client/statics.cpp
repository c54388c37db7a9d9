// Known static answers: what the explicit scheme comes to rest at, K u = f.
#include <Eigen/SparseCholesky>
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <vector>

#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

// Solves K u = f by factors. K of a slender bar of nearly constant volume is conditioned too badly for solve_static,
// whose residual rises for hundreds of iterations before it falls; the zone is on trial here, not the solver.
Vec3s solve_by_factors(const StiffnessMatrix& k, const Vec3s& is_free, const Vec3s& f) {
  const int count = static_cast<int>(k.node_count());
  std::vector<Eigen::Triplet<double>> entry;  // upper half, one on the diagonal of what is held
  const auto add_block = [&](int row, int column, const Mat3& block) {
    for (int i = 0; i < 3; ++i)
      for (int j = row == column ? i : 0; j < 3; ++j) {
        const bool both_free = is_free[row][i] != 0 && is_free[column][j] != 0;
        const bool is_diagonal = row == column && i == j;
        if (both_free || is_diagonal) entry.emplace_back(3 * row + i, 3 * column + j, both_free ? block(i, j) : 1.0);
      }
  };
  for (int row = 0; row < count; ++row)
    for (std::int64_t b = k.row_begin[row]; b < k.row_begin[row + 1]; ++b) add_block(row, k.column[b], k.block[b]);
  Eigen::SparseMatrix<double> matrix(3 * count, 3 * count);
  matrix.setFromTriplets(entry.begin(), entry.end());
  Eigen::VectorXd load(3 * count);
  for (int i = 0; i < count; ++i) load.segment<3>(3 * i) = f[i].cwiseProduct(is_free[i]);
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>, Eigen::Upper> factors(matrix);
  const Eigen::VectorXd solution = factors.solve(load);
  Vec3s u(count);
  for (int i = 0; i < count; ++i) u[i] = solution.segment<3>(3 * i);
  return u;
}

// Tip deflection of a cantilever (length 10, square section 1, cubes as zones) over Timoshenko's beam.
double cantilever(ZoneKind kind, int zones_through_depth, double nu) {
  const int n = zones_through_depth;
  const double length = 10, e = 44.3e6, load = 1;
  const ElasticModuli moduli = elastic_moduli(e, nu);
  const Grid grid = brick(length, 1, 1, 10 * n, n, n, {moduli, test_density}, kind);
  Vec3s is_free(grid.node_count(), Vec3::Ones()), f(grid.node_count(), Vec3::Zero());
  for (std::size_t i = 0; i < grid.node_count(); ++i) {
    const Vec3& x = grid.node[i];
    if (x.x() < grid.low.x() + 1e-9) is_free[i].setZero();
    if (x.x() > grid.high.x() - 1e-9) {
      // Bilinear shares of a uniform shear traction.
      const bool edge_y = std::abs(x.y()) > 0.5 - 1e-9, edge_z = x.z() > -1e-9 || x.z() < -1 + 1e-9;
      f[i].z() = load / (n * n) * (edge_y ? 0.5 : 1) * (edge_z ? 0.5 : 1);
    }
  }
  const Vec3s u = solve_by_factors(assemble_stiffness(grid), is_free, f);
  double tip = 0;
  int count = 0;
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    if (grid.node[i].x() > grid.high.x() - 1e-9) tip += u[i].z(), ++count;
  const double inertia = 1.0 / 12, shear_area = 5.0 / 6;
  const double exact = load * std::pow(length, 3) / (3 * e * inertia) + load * length / (shear_area * moduli.shear);
  return tip / count / exact;
}

// A quarter of a thick cylinder, a = 1, b = 4, in plane strain under inner pressure: inner displacement over Lame's
//   u(a) = (1 + nu) p a / E ((1 - 2 nu) a^2 + b^2) / (b^2 - a^2).
double thick_cylinder(ZoneKind kind, int radial, double nu) {
  const double a = 1, b = 4, e = 44.3e6;
  const QuarterRing ring = quarter_ring(a, b, radial, {elastic_moduli(e, nu), test_density}, kind);
  Vec3s u;
  solve_static(assemble_stiffness(ring.grid), ring.is_free, ring.inner_pressure, u, {});
  const double exact = (1 + nu) * a / e * ((1 - 2 * nu) * a * a + b * b) / (b * b - a * a);
  return mean_radial(ring, ring.inner, u) / exact;
}

}  // namespace

// What an independent implementation of the three kinds gives for the same meshes; see the folder's README.
struct Known {
  ZoneKind kind;
  double nu;
  std::array<double, 3> share;  // of the exact displacement, by mesh
};

TEST_CASE("a cantilever is as stiff as each kind of zone makes it") {
  // 1, 2 and 4 zones through the depth. Mixed discretization comes from below, slowly; B-bar and one point from above
  // where one layer bends: one point has next to nothing against bending then, its hourglass stiffness alone. nu = 0.499
  // (K = 500 G) changes little: bending is left free (plain tetrahedra: .08, .26, .48).
  const Known known[] = {{ZoneKind::MixedDiscretization, 0.3, {0.46, 0.74, 0.91}},
                         {ZoneKind::MixedDiscretization, 0.499, {0.53, 0.73, 0.89}},
                         {ZoneKind::BBar, 0.3, {1.20, 0.98, 0.99}},
                         {ZoneKind::BBar, 0.499, {1.38, 0.94, 0.97}},
                         {ZoneKind::OnePoint, 0.3, {23, 1.30, 1.06}},
                         {ZoneKind::OnePoint, 0.499, {26, 1.29, 1.04}}};
  for (const Known& k : known)
    for (int mesh = 0; mesh < 3; ++mesh) {
      const double share = cantilever(k.kind, 1 << mesh, k.nu);
      INFO("kind " << static_cast<int>(k.kind) << ", nu " << k.nu << ", " << (1 << mesh) << " zones: " << share);
      CHECK(share == Approx(k.share[static_cast<std::size_t>(mesh)]).epsilon(0.04));
    }
}

TEST_CASE("a thick cylinder meets Lame's solution, and nu near a half does not lock it") {
  // 6, 12 and 24 zones from wall to wall (plain tetrahedra at nu = 0.499: .18 and .47).
  const Known known[] = {{ZoneKind::MixedDiscretization, 0.3, {0.968, 0.994}},
                         {ZoneKind::MixedDiscretization, 0.499, {0.967, 0.994}},
                         {ZoneKind::MixedDiscretization, 0.4999, {0.967, 0.994}},
                         {ZoneKind::BBar, 0.3, {0.989, 0.997}},
                         {ZoneKind::BBar, 0.499, {0.988, 0.997}},
                         {ZoneKind::BBar, 0.4999, {0.988, 0.997}},
                         {ZoneKind::OnePoint, 0.3, {0.999, 1.0}},
                         {ZoneKind::OnePoint, 0.499, {0.999, 1.0}},
                         {ZoneKind::OnePoint, 0.4999, {0.999, 1.0}}};
  for (const Known& k : known) {
    const double coarse = thick_cylinder(k.kind, 6, k.nu), fine = thick_cylinder(k.kind, 12, k.nu);
    const double finest = thick_cylinder(k.kind, 24, k.nu);
    const double order = std::log2(std::abs(1 - fine) / std::abs(1 - finest));
    INFO("kind " << static_cast<int>(k.kind) << ", nu " << k.nu << ": " << coarse << " " << fine << " " << finest
                 << ", order " << order);
    CHECK(coarse == Approx(k.share[0]).margin(0.012));
    CHECK(fine == Approx(k.share[1]).margin(0.004));
    CHECK(order > 1.8);
  }
}

TEST_CASE("a column under its own weight is exact at its nodes, for any aspect of its zones") {
  // u(z) = -rho g (H s - s^2 / 2) / M with s the height over the bottom, sigma_v = rho g z, K0 = nu / (1 - nu).
  const double gravity = 9.81, height = 9;
  for (const ZoneKind kind : zone_kinds)
    for (double width : {0.36 * 2, 72.0, 0.0072}) {  // aspects 1, 100 and 1/50 with 25 zones of 0.36 m
      const Grid grid = brick(width, width, height, 2, 2, 25, test_material, kind);
      const std::vector<double> mass = lumped_masses(grid);
      const Vec3s is_free = free_components(grid, Supports::Rollers, mass);
      const StiffnessMatrix k = assemble_stiffness(grid);
      Vec3s u;
      const EquilibriumReport report =
          reach_equilibrium(k, mass, is_free, Vec3(0, 0, -gravity), {0.7, 1e-8, 1000, 0.9}, u, {});
      const double m = test_moduli.constrained(), largest = test_density * gravity * height * height / 2 / m;
      double error = 0, stress_error = 0, k0_error = 0;
      for (std::size_t i = 0; i < u.size(); ++i) {
        const double s = grid.node[i].z() + height;
        error = std::max(error,
                         (u[i] - Vec3(0, 0, -test_density * gravity * (height * s - s * s / 2) / m)).norm() / largest);
      }
      for (std::size_t z = 0; z < grid.zone_count(); ++z) {
        const Mat3 s = zone_stress(grid.geometry(z), test_moduli, gather(u, grid.zone[z]));
        const double exact = test_density * gravity * grid.zone_center(z).z();
        stress_error = std::max(stress_error, std::abs(s(2, 2) - exact) / (test_density * gravity * height));
        k0_error = std::max(k0_error, std::abs(s(0, 0) / s(2, 2) - 0.3 / 0.7));
      }
      INFO("kind " << static_cast<int>(kind) << ", width " << width << ": displacement error " << error
                   << ", stress error " << stress_error << ", K0 error " << k0_error << ", solver iterations "
                   << report.solve.iterations << ", ratio after " << report.cycles << " cycles "
                   << report.unbalanced_ratio << ", drift " << report.drift);
      // Slender zones: their shear stiffness across cancels to the weight of a sliver, and rounding with it.
      CHECK(error < 1e-9);
      CHECK(stress_error < 1e-9);
      CHECK(k0_error < 1e-8);
      CHECK(report.drift < 1e-10);
    }
}

TEST_CASE("a ground without enough support to carry it is an error in words") {
  const Grid grid = brick(1, 1, 1, 2, 2, 2);
  const std::vector<double> mass = lumped_masses(grid);
  const Vec3s nowhere_held(grid.node_count(), Vec3::Ones());
  Vec3s u;
  CHECK_THROWS_AS(solve_static(assemble_stiffness(grid), nowhere_held, weights(mass, 9.81), u, {}), NumericalError);
}

}  // namespace lockstep::continuum
