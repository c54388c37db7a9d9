#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/particles.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

struct Moments {
  double volume = 0;
  Vec3 first = Vec3::Zero();
  Vec3 inertia = Vec3::Zero();
};

// Midpoint sums over a lattice of points: an independent way to the union's moments.
Moments sampled(const ClumpTemplate& shape, int points) {
  Moments m;
  const double h = 2 * shape.bounding_radius / points;
  for (int i = 0; i < points; ++i)
    for (int j = 0; j < points; ++j)
      for (int k = 0; k < points; ++k) {
        const Vec3 x = Vec3(i + 0.5, j + 0.5, k + 0.5) * h - Vec3::Constant(shape.bounding_radius);
        bool is_inside = false;
        for (std::size_t p = 0; p < shape.pebble_center.size() && !is_inside; ++p)
          is_inside = (x - shape.pebble_center[p]).squaredNorm() < shape.pebble_radius[p] * shape.pebble_radius[p];
        if (!is_inside) continue;
        const double v = h * h * h;
        m.volume += v;
        m.first += v * x;
        m.inertia += v * (Vec3::Constant(x.squaredNorm()) - x.cwiseProduct(x));
      }
  return m;
}

}  // namespace

TEST_CASE("one pebble, or no elongation, is the unit sphere") {
  for (const auto& [pebbles, elongation] : {std::pair{1, 1.5}, std::pair{5, 1.0}}) {
    const ClumpTemplate s = make_clump(pebbles, elongation);
    REQUIRE(s.pebble_center.size() == 1);
    CHECK(s.pebble_radius[0] == 1);
    CHECK(s.pebble_center[0].norm() == 0);
    CHECK(s.inertia_per_mass == Vec3(0.4, 0.4, 0.4));
    CHECK(s.bounding_radius == 1);
  }
}

TEST_CASE("the union of a row has the volume, centre and inertia that sampling finds, for every number of pebbles") {
  // A point of the lattice counts once however many pebbles it lies in. The error is that of the cells that the surface
  // cuts, 6 / 160 of all; where surface and planes of the lattice are parallel they err together, which leaves 1e-3.
  for (const double elongation : {1.5, 2.0})
    for (int pebbles = 2; pebbles <= most_pebbles; ++pebbles) {
      const ClumpTemplate shape = make_clump(pebbles, elongation);
      REQUIRE(shape.pebble_center.size() == static_cast<std::size_t>(pebbles));
      const Moments m = sampled(shape, 160);
      const double volume_error = m.volume / (4.0 / 3.0 * pi) - 1;
      const Vec3 inertia_error = m.inertia.cwiseQuotient(m.volume * shape.inertia_per_mass) - Vec3::Ones();
      INFO("pebbles " << pebbles << ", elongation " << elongation << ": volume " << volume_error << ", centre "
                      << m.first.norm() << ", inertia " << inertia_error.transpose());
      CHECK(std::abs(volume_error) < 1e-3);
      CHECK(m.first.norm() < 1e-10);
      CHECK(inertia_error.cwiseAbs().maxCoeff() < 2e-3);
    }
}

TEST_CASE("a clump has the mass of the sphere that it replaces, and less than its pebbles together") {
  for (int pebbles = 1; pebbles <= most_pebbles; ++pebbles) {
    const ClumpTemplate shape = make_clump(pebbles, 1.5);
    Particles one;
    one.add(shape, 0.03, 2650, Vec3::Zero(), Quat::Identity());
    const double sphere_mass = 2650 * 4.0 / 3.0 * pi * 0.03 * 0.03 * 0.03;
    double pebble_sum = 0;  // of the volumes, over that of the sphere
    for (const double r : shape.pebble_radius) pebble_sum += r * r * r;
    CAPTURE(pebbles, one.mass(0) / sphere_mass - 1, pebble_sum);
    CHECK(std::abs(one.mass(0) / sphere_mass - 1) < 1e-14);
    CHECK((pebbles == 1 ? pebble_sum == 1 : pebble_sum > 1.1));
    // Three moments of a body: none exceeds the sum of the others, and the long axis has the least.
    const Vec3 i = shape.inertia_per_mass;
    CHECK(i.x() <= i.y());
    CHECK(i.y() == i.z());
    CHECK(i.y() < i.x() + i.z());
  }
}

TEST_CASE("rows of even and odd counts approach their ellipsoid steadily") {
  // The union lies inside the ellipsoid A = 1.5, B = 1 of volume 4/3 pi A B^2, and fills it the better the more pebbles
  // stand in the row. The outermost pebble has the tip's radius of curvature B^2/A and touches the tip: centre + radius
  // = A. So the shape's scale 1/B gives both.
  double last_fill = 0;
  for (int pebbles = 3; pebbles <= most_pebbles; ++pebbles) {
    const ClumpTemplate shape = make_clump(pebbles, 1.5);
    const double half_length = shape.pebble_center.back().x() + shape.pebble_radius.back();  // A [R_eq]
    const double half_width = half_length / 1.5;                                             // B [R_eq]
    const double fill = 1 / (1.5 * half_width * half_width * half_width);                    // of volumes
    double worst = 0;  // by which a pebble's surface leaves the ellipsoid [B]
    for (std::size_t p = 0; p < shape.pebble_center.size(); ++p)
      for (int k = 0; k <= 200; ++k) {
        const double angle = pi * k / 200;
        const double x = (shape.pebble_center[p].x() + shape.pebble_radius[p] * std::cos(angle)) / half_length;
        const double y = shape.pebble_radius[p] * std::sin(angle) / half_width;
        worst = std::max(worst, std::hypot(x, y) - 1);
      }
    CAPTURE(pebbles, fill, worst);
    CHECK(shape.pebble_radius.back() / half_width == Approx(1 / 1.5).epsilon(1e-12));
    CHECK(worst < 1e-12);
    CHECK(fill > last_fill);
    CHECK(fill < 1);
    last_fill = fill;
  }
}

TEST_CASE("two pebbles match the closed form of two spheres less their lens") {
  // Spheres r = 1 at +-c, c = e - 1 = 0.5. Half of the union is the sphere's part u = x - c from -c to r:
  //   V/2   = pi [r^2 u - u^3/3],  I_x/2 = pi/2 [r^4 u - 2 r^2 u^3/3 + u^5/5],
  //   integral of x^2 over V/2 = pi [ (r^2 - u^2)(u + c)^2 ] integrated = pi [c^2 (r^2 u - u^3/3) + c (r^2 u^2 - u^4/2)
  //                              + r^2 u^3/3 - u^5/5],  I_y = I_x/2 + that integral.
  const double c = 0.5;
  const auto volume_at = [&](double u) { return pi * (u - u * u * u / 3); };
  const auto axial_at = [&](double u) { return 0.5 * pi * (u - 2 * u * u * u / 3 + std::pow(u, 5) / 5); };
  const auto second_at = [&](double u) {
    return pi * (c * c * (u - u * u * u / 3) + c * (u * u - std::pow(u, 4) / 2) + u * u * u / 3 - std::pow(u, 5) / 5);
  };
  const double volume = 2 * (volume_at(1) - volume_at(-c)), axial = 2 * (axial_at(1) - axial_at(-c));
  const double lateral = 0.5 * axial + 2 * (second_at(1) - second_at(-c));
  const double lens = pi * (4 + 2 * c) * (2 - 2 * c) * (2 - 2 * c) / 12;
  REQUIRE(volume == Approx(8.0 / 3.0 * pi - lens).epsilon(1e-14));

  const double scale = std::cbrt(4.0 / 3.0 * pi / volume);
  const ClumpTemplate shape = make_clump(2, 1.5);
  const double axial_error = shape.inertia_per_mass.x() / (scale * scale * axial / volume) - 1;
  const double lateral_error = shape.inertia_per_mass.y() / (scale * scale * lateral / volume) - 1;
  const double radius_error = shape.pebble_radius[0] / scale - 1;
  CAPTURE(axial_error, lateral_error, radius_error);
  CHECK(std::abs(axial_error) < 1e-14);
  CHECK(std::abs(lateral_error) < 1e-14);
  CHECK(std::abs(radius_error) < 1e-14);
  CHECK(shape.inertia_per_mass.z() == shape.inertia_per_mass.y());
}

TEST_CASE("rows fill their ellipsoid as the calibration's clumps did") {
  // Volume of the union over that of the 1.5:1 ellipsoid: 0.844, 0.961, 0.990 for 3, 5, 9 pebbles; pebbles' sum over
  // union: 1.26, 2.21, 4.19. In units of R_eq the ellipsoid's half width B is the middle pebble's radius.
  const std::vector<std::array<double, 3>> known = {{3, 0.844, 1.26}, {5, 0.961, 2.21}, {9, 0.990, 4.19}};
  for (const auto& [pebbles, fill, sum] : known) {
    const ClumpTemplate shape = make_clump(static_cast<int>(pebbles), 1.5);
    const double half_width = shape.pebble_radius[shape.pebble_radius.size() / 2];
    double pebble_sum = 0;
    for (double r : shape.pebble_radius) pebble_sum += r * r * r;
    CAPTURE(pebbles, 1 / (1.5 * half_width * half_width * half_width), pebble_sum);
    CHECK(1 / (1.5 * half_width * half_width * half_width) == Approx(fill).margin(0.0006));
    CHECK(pebble_sum == Approx(sum).margin(0.006));
    CHECK(shape.bounding_radius == Approx(1.5 * half_width).epsilon(1e-12));
  }
}

TEST_CASE("shapes that cannot be made are refused with the key's name") {
  CHECK_THROWS_AS(make_clump(0, 1.5), InputError);
  CHECK_THROWS_WITH(make_clump(10, 1.5), Catch::Contains("grains.pebbles = 10") && Catch::Contains("[1, 9]"));
  CHECK_THROWS_WITH(make_clump(3, 2.5), Catch::Contains("grains.elongation = 2.5"));
}
