#include "common/shape_functions.hpp"

#include <array>
#include <catch2/catch.hpp>
#include <cmath>

#include "common/random.hpp"

namespace {

using namespace lockstep;

constexpr double round_off = 1e-15;  // a few rounding errors of numbers of order one

Vec3 random_point(Random& random) { return {random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)}; }

FacetCorners random_facet(Random& random) {
  return {random_point(random), random_point(random), random_point(random), random_point(random)};
}

}  // namespace

TEST_CASE("Bilinear weights sum to one and have the point as their mean") {
  Random random(1);
  double worst = 0;
  for (int i = 0; i < 1000; ++i) {
    const double xi = random.uniform(-1, 1), eta = random.uniform(-1, 1);
    const auto n = bilinear_weights(xi, eta);
    worst = std::max(worst, std::abs(n[0] + n[1] + n[2] + n[3] - 1));
    // Nodes at (-1,-1), (1,-1), (1,1), (-1,1): the weights reproduce any linear field, here xi and eta themselves.
    worst = std::max(worst, std::abs(-n[0] + n[1] + n[2] - n[3] - xi));
    worst = std::max(worst, std::abs(-n[0] - n[1] + n[2] + n[3] - eta));
  }
  CAPTURE(worst);
  CHECK(worst < 4 * round_off);
}

TEST_CASE("A weight is one at its own node and zero at the others") {
  const std::array<std::array<double, 2>, 4> nodes = {{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}};
  for (std::size_t i = 0; i < 4; ++i) {
    const auto n = bilinear_weights(nodes[i][0], nodes[i][1]);
    for (std::size_t j = 0; j < 4; ++j) CHECK(n[j] == (i == j ? 1.0 : 0.0));
  }
}

TEST_CASE("Facet tangents are the derivatives of the interpolated position") {
  // Along xi alone the position is linear, so that a difference quotient over any step is exact.
  Random random(2);
  double worst = 0;
  for (int i = 0; i < 100; ++i) {
    const FacetCorners x = random_facet(random);
    const double xi = random.uniform(-1, 1), eta = random.uniform(-1, 1);
    const Vec3 along_xi = 0.5 * (interpolate(bilinear_weights(1, eta), x) - interpolate(bilinear_weights(-1, eta), x));
    const Vec3 along_eta = 0.5 * (interpolate(bilinear_weights(xi, 1), x) - interpolate(bilinear_weights(xi, -1), x));
    worst = std::max(worst, (along_xi - facet_tangent_xi(x, eta)).norm());
    worst = std::max(worst, (along_eta - facet_tangent_eta(x, xi)).norm());
  }
  CAPTURE(worst);
  CHECK(worst < 4 * round_off);
}

TEST_CASE("The area vector of a warped facet is the integral of its normal") {
  // dx/dxi x dx/deta is bilinear in (xi, eta) plus terms that 2 x 2 Gauss points integrate exactly.
  Random random(3);
  const double g = 1 / std::sqrt(3.0);
  double worst = 0;
  for (int i = 0; i < 100; ++i) {
    const FacetCorners x = random_facet(random);
    Vec3 integral = Vec3::Zero();
    for (double xi : {-g, g})
      for (double eta : {-g, g}) integral += facet_tangent_xi(x, eta).cross(facet_tangent_eta(x, xi));
    worst = std::max(worst, (integral - facet_area_vector(x)).norm());
  }
  CAPTURE(worst);
  CHECK(worst < 10 * round_off);
  CHECK(facet_area_vector({Vec3(0, 0, 0), Vec3(2, 0, 0), Vec3(2, 3, 0), Vec3(0, 3, 0)}) == Vec3(0, 0, 6));
}
