// Uniform pressure q on a square patch, |x|, |y| < b, on top of an elastic half space (t = depth below the top).
//
//        q  q  q             A quarter of a block is meshed: rollers on the two planes of symmetry through the patch's
//      | | | | | |           centre. The half space has no boundary, so the cut faces (x = L, y = L, t = L with L = 3 b)
//   ---v-v-v-v-v-v------+    move as the half space does there: Boussinesq's displacements of a point load P,
//      :        b       |      u_r = (1 + nu) P / (2 pi E) (r t / R^3 - (1 - 2 nu) r / (R (R + t)))
//      :                |      u_t = (1 + nu) P / (2 pi E) (t^2 / R^3 + 2 (1 - nu) / R),        R^2 = r^2 + t^2
//      :                | L  (Timoshenko & Goodier, Theory of Elasticity, 3rd ed., chapter 12), summed over the patch.
//      +----------------+    So block size is no source of error (at L = 5 b the same errors are left): zones are.
//
// Stress under the corner of a rectangle a x b (Newmark 1935; this form Holl 1940, in Poulos & Davis, Elastic Solutions
// for Soil and Rock Mechanics), R1^2 = a^2 + t^2, R2^2 = b^2 + t^2, R3^2 = a^2 + b^2 + t^2:
//   sigma_t = q / (2 pi) (atan(a b / (t R3)) + a b t / R3 (1 / R1^2 + 1 / R2^2))
// and under the centre of the square four times that with a = b. It follows from 3 P t^3 / (2 pi R^5) of a point load.
// Settlement of the centre (Steinbrenner 1934): u_t = (1 - nu^2) q / (pi E) times the integral of 1/r over the square,
//   8 b ln(1 + sqrt 2).
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <string>

#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

constexpr double half_side = 1, pressure = 1000;  // b [m], q [Pa]
constexpr int block_half_sides = 3;               // L / b
constexpr double youngs_modulus = 44.3e6, poisson_ratio = 0.3;
constexpr std::array<double, 4> depths = {0.5, 1, 1.5, 2};  // where zones of any mesh meet [b]

double stress_under_center(double t) {
  const double b2 = half_side * half_side, near = b2 + t * t, far = std::sqrt(2 * b2 + t * t);
  return -4 * pressure / (2 * pi) * (std::atan(b2 / (t * far)) + 2 * b2 * t / (far * near));
}

double settlement_of_center() {
  return (1 - poisson_ratio * poisson_ratio) * pressure / (pi * youngs_modulus) * 8 * half_side *
         std::log(1 + std::sqrt(2.0));
}

// Boussinesq's displacement, summed over the patch by five Gauss points in each direction: points on the cut faces are
// at least 2 b away from the patch, where that is exact to 1e-7.
Vec3 half_space_displacement(const Vec3& at) {
  const std::array<double, 5> point = {-0.906179845938664, -0.538469310105683, 0, 0.538469310105683, 0.906179845938664};
  const std::array<double, 5> weight = {0.236926885056189, 0.478628670499366, 0.568888888888889, 0.478628670499366,
                                        0.236926885056189};
  const double t = -at.z();
  Vec3 u = Vec3::Zero();
  for (int i = 0; i < 5; ++i)
    for (int j = 0; j < 5; ++j) {
      const double load = pressure * half_side * half_side * weight[i] * weight[j];
      const double dx = at.x() - half_side * point[i], dy = at.y() - half_side * point[j];
      const double distance = std::sqrt(dx * dx + dy * dy + t * t), cubed = distance * distance * distance;
      const double outward = t / cubed - (1 - 2 * poisson_ratio) / (distance * (distance + t));  // u_r / r
      const double down = t * t / cubed + 2 * (1 - poisson_ratio) / distance;
      u += (1 + poisson_ratio) * load / (2 * pi * youngs_modulus) * Vec3(outward * dx, outward * dy, -down);
    }
  return u;
}

struct Patch {
  std::array<double, depths.size()> stress_error;  // under the centre, over the exact stress there [-]
  double worst = 0;                                // of them, in size [-]
  double settlement_error = 0;                     // [-]
};

// `n` zones along b, even.
Patch loaded_patch(int n) {
  const int zones = block_half_sides * n;
  const double block = block_half_sides * half_side, h = half_side / n, tiny = 1e-9;
  const ElasticModuli moduli = elastic_moduli(youngs_modulus, poisson_ratio);
  Grid grid = brick(block, block, block, zones, zones, zones, {moduli, test_density});
  for (Vec3& x : grid.node) x += Vec3(block / 2, block / 2, 0);
  const StiffnessMatrix k = assemble_stiffness(grid);

  Vec3s is_free(grid.node_count(), Vec3::Ones()), prescribed(grid.node_count(), Vec3::Zero());
  for (std::size_t i = 0; i < grid.node_count(); ++i) {
    const Vec3& x = grid.node[i];
    if (x.x() > block - tiny || x.y() > block - tiny || x.z() < -block + tiny) {
      is_free[i].setZero();
      prescribed[i] = half_space_displacement(x);
    }
    if (x.x() < tiny) is_free[i].x() = 0;
    if (x.y() < tiny) is_free[i].y() = 0;
  }
  // u = prescribed + v with v = 0 on the cut faces: K v = f - K prescribed.
  Vec3s f(grid.node_count()), u;
  k.multiply(prescribed, f);
  for (Vec3& force : f) force = -force;
  for (const auto& facet : grid.facet) {
    const Vec3 middle = (grid.node[facet[0]] + grid.node[facet[2]]) / 2;
    if (middle.x() < half_side && middle.y() < half_side)
      for (std::int32_t node : facet) f[node].z() -= pressure * h * h / 4;
  }
  solve_static(k, is_free, f, u, {});
  for (std::size_t i = 0; i < u.size(); ++i) u[i] += prescribed[i];

  // Stress at a depth where zones meet: mean of the zones on the axis above and below it, and of their six mirror
  // images.
  const auto on_axis = [&](int level) {
    const auto z = static_cast<std::size_t>(level);
    return zone_stress(grid.geometry(z), moduli, gather(u, grid.zone[z]))(2, 2);
  };
  Patch patch;
  for (std::size_t d = 0; d < depths.size(); ++d) {
    const int below = zones - static_cast<int>(std::lround(depths[d] * n)) - 1;
    patch.stress_error[d] = 0.5 * (on_axis(below) + on_axis(below + 1)) / stress_under_center(depths[d]) - 1;
    patch.worst = std::max(patch.worst, std::abs(patch.stress_error[d]));
  }
  const auto center = static_cast<std::size_t>(zones);
  patch.settlement_error = -u[center].z() / settlement_of_center() - 1;
  return patch;
}

}  // namespace

TEST_CASE("stress under a loaded square is Boussinesq's, better by the square of the zones' size") {
  // The textbook's value one side deep, t = 2 b: a third of the pressure.
  CHECK(-stress_under_center(2 * half_side) / pressure == Approx(0.336).margin(0.0005));

  const Patch coarse = loaded_patch(2), middle = loaded_patch(4), fine = loaded_patch(8);
  std::string errors;
  for (std::size_t d = 0; d < depths.size(); ++d)
    errors += fmt::format("\nt = {} b: exact {:.2f} Pa, errors {:+.4f} {:+.4f} {:+.4f}", depths[d],
                          stress_under_center(depths[d]), coarse.stress_error[d], middle.stress_error[d],
                          fine.stress_error[d]);
  const double order = std::log2(middle.worst / fine.worst);
  const double settlement_order = std::log2(middle.settlement_error / fine.settlement_error);
  INFO("with 2, 4 and 8 zones along b:" << errors << "\nsettlement of the centre: exact " << settlement_of_center()
                                        << " m, errors " << coarse.settlement_error << " " << middle.settlement_error
                                        << " " << fine.settlement_error << "\norder of accuracy: stress " << order
                                        << ", settlement " << settlement_order);
  // With two zones along b the stress on the axis is low by an eighth: its gradient from the patch's rim is smeared over
  // a zone. Each halving leaves a quarter of that.
  CHECK(coarse.worst < 0.15);
  CHECK(middle.worst < 0.04);
  CHECK(fine.worst < 0.01);
  CHECK(order == Approx(2).margin(0.2));
  CHECK(std::abs(coarse.settlement_error) < 0.03);
  CHECK(std::abs(middle.settlement_error) < 0.008);
  CHECK(std::abs(fine.settlement_error) < 0.002);
  CHECK(settlement_order == Approx(2).margin(0.2));
}

}  // namespace lockstep::continuum
