#include "continuum_client/zone_kinematics.hpp"

#include <Eigen/Dense>
#include <catch2/catch.hpp>

#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

Mat3 some_gradient() {
  Mat3 a;
  a << 1e-3, 4e-4, -2e-4, 3e-4, -5e-4, 6e-4, -1e-4, 2e-4, 7e-4;
  return a;
}

}  // namespace

TEST_CASE("distorted and warped zones pass the patch test to round-off") {
  // A linear field has one stress everywhere, and in equilibrium no force is left on any inner node, whatever the
  // zones' shapes.
  for (const ZoneKind kind : zone_kinds) {
    Grid grid = brick(1, 1, 1, 4, 4, 4, test_material, kind);
    distort(grid, 0.25, 0.2);
    check_zones(grid, "test");
    const Mat3 a = some_gradient();
    Vec3s u, f(grid.node_count());
    for (const Vec3& x : grid.node) u.push_back(a * x);
    assemble_stiffness(grid).multiply(u, f);
    double inner = 0, outer = 0;
    for (int k = 0; k <= 4; ++k)
      for (int j = 0; j <= 4; ++j)
        for (int i = 0; i <= 4; ++i) {
          const bool is_inner = i > 0 && i < 4 && j > 0 && j < 4 && k > 0 && k < 4;
          const double force = f[(j * 5 + i) * 5 + k].norm();
          (is_inner ? inner : outer) = std::max(is_inner ? inner : outer, force);
        }
    const Mat3 strain = 0.5 * (a + a.transpose());
    const Mat3 exact = elastic_stress(test_moduli, strain, strain.trace());
    double stress_error = 0;
    for (std::size_t z = 0; z < grid.zone_count(); ++z)
      stress_error =
          std::max(stress_error,
                   (zone_stress(grid.geometry(z), test_moduli, gather(u, grid.zone[z])) - exact).norm() / exact.norm());
    INFO("kind " << static_cast<int>(kind) << ": force left on inner nodes over boundary force " << inner / outer
                 << ", stress error " << stress_error);
    CHECK(inner / outer < 2e-14);
    CHECK(stress_error < 1e-13);
  }
}

TEST_CASE("the patch test's displacements come back from boundary values alone") {
  // K u = 0 inside with u = A x on the boundary has the one solution u = A x.
  for (const ZoneKind kind : zone_kinds) {
    Grid grid = brick(1, 1, 1, 3, 3, 3, test_material, kind);
    distort(grid, 1.0 / 3, 0.2);
    const StiffnessMatrix k = assemble_stiffness(grid);
    const Mat3 a = some_gradient();
    Vec3s is_free(grid.node_count(), Vec3::Zero()), boundary(grid.node_count(), Vec3::Zero()), f(grid.node_count()), u;
    for (int l = 0; l <= 3; ++l)
      for (int j = 0; j <= 3; ++j)
        for (int i = 0; i <= 3; ++i) {
          const int n = (j * 4 + i) * 4 + l;
          if (i > 0 && i < 3 && j > 0 && j < 3 && l > 0 && l < 3)
            is_free[n].setOnes();
          else
            boundary[n] = a * grid.node[n];
        }
    k.multiply(boundary, f);
    for (Vec3& v : f) v = -v;
    solve_static(k, is_free, f, u, {});
    double error = 0;
    for (std::size_t i = 0; i < u.size(); ++i)
      if (is_free[i].x() > 0) error = std::max(error, (u[i] - a * grid.node[i]).norm() / (a * grid.node[i]).norm());
    INFO("kind " << static_cast<int>(kind) << ": displacement error " << error);
    CHECK(error < 1e-11);
  }
}

TEST_CASE("a zone has six motions without force and no more") {
  // Three translations and three rotations; a seventh would be an hourglass.
  for (const ZoneKind kind : zone_kinds) {
    Grid grid = brick(1, 1.3, 0.7, 1, 1, 1, test_material, kind);
    distort(grid, 1, 0.1);
    const ZoneMatrix k = zone_stiffness(grid.geometry(0), test_moduli);
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver{Eigen::MatrixXd(k)};
    const auto values = solver.eigenvalues();
    INFO("kind " << static_cast<int>(kind) << ": sixth " << values[5] / values[23] << ", seventh "
                 << values[6] / values[23]);
    CHECK(values[5] / values[23] < 1e-14);
    CHECK(values[0] / values[23] > -1e-14);
    // One point sees no bending: a tenth of the stiffness of shear holds it (zone_kinematics.hpp).
    CHECK(values[6] / values[23] > (kind == ZoneKind::OnePoint ? 1e-3 : 1e-2));
  }
}

TEST_CASE("the stiffness matrix is the kernel's, and volumes fill the zone") {
  for (const ZoneKind kind : zone_kinds) {
    Grid grid = brick(1, 1, 1, 1, 1, 1, test_material, kind);
    distort(grid, 1, 0.1);
    const ZoneGeometry geometry = grid.geometry(0);
    Random random(8);
    ZoneVectors u;
    Eigen::Matrix<double, 24, 1> column;
    for (int i = 0; i < 24; ++i) u[i / 3][i % 3] = column[i] = random.uniform(-1, 1);
    const ZoneVectors f = zone_force(geometry, test_moduli, u);
    const Eigen::Matrix<double, 24, 1> g = zone_stiffness(geometry, test_moduli) * column;
    double error = 0, scale = 0, volume = 0;
    for (int a = 0; a < 8; ++a)
      error = std::max(error, (f[a] - g.segment<3>(3 * a)).norm()), scale = std::max(scale, f[a].norm());
    for (double v : geometry.nodal_volume) {
      CHECK(v > 0);
      volume += v;
    }
    // The divergence theorem: the zone's volume is a third of the flux of x through its six bilinear faces, which eight
    // Gauss points integrate exactly; two overlays of plane faces have the mean of both diagonals, the same number.
    const double exact = zone_geometry(ZoneKind::BBar, grid.corners(0)).zone_volume();
    INFO("kind " << static_cast<int>(kind) << ": error " << error / scale);
    CHECK(error / scale < 1e-14);
    CHECK(volume == Approx(exact).epsilon(1e-14));
    CHECK(geometry.zone_volume() == Approx(exact).epsilon(1e-14));
    // One stress throughout does the work of its nodal forces: sum f . u = V sigma : e for the mean strain.
    const Mat3 stress = some_gradient() + some_gradient().transpose();
    const ZoneVectors of_stress = zone_force_of_stress(geometry, stress);
    double work = 0;
    for (int a = 0; a < 8; ++a) work += of_stress[a].dot(u[a]);
    CHECK(work == Approx(exact * (stress * zone_strain(geometry, u)).trace()).epsilon(1e-12));
  }
}

TEST_CASE("shear and bulk modulus are those of E and nu, not as the paper's table has them swapped") {
  // E 44.3 MPa, nu 0.3: G = 44.3 / 2.6, K = 44.3 / 1.2 MPa.
  CHECK(test_moduli.shear == Approx(17.0385e6).epsilon(1e-5));
  CHECK(test_moduli.bulk == Approx(36.9167e6).epsilon(1e-5));
}

}  // namespace lockstep::continuum
