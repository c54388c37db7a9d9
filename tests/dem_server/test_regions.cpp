#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "dem_server/regions.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

Vec3 random_point(Random& random, double low, double high) {
  const double x = random.uniform(low, high), y = random.uniform(low, high), z = random.uniform(low, high);
  return {x, y, z};
}

constexpr double unit_ball = 4.0 / 3.0 * pi;

}  // namespace

TEST_CASE("a box inside a sphere has of the sphere its own volume, wherever it lies") {
  // All eight corners are then inside the sphere: arcs, faces and turns of the corner formula must cancel to the box.
  Random random(1);
  double worst = 0;
  for (int n = 0; n < 1000; ++n) {
    const Vec3 a = random_point(random, -0.577, 0.577), b = random_point(random, -0.577, 0.577);
    const Box box{a.cwiseMin(b), a.cwiseMax(b)};
    worst = std::max(worst, std::abs(box.part_of_sphere(Vec3::Zero(), 1) - box.volume()));
  }
  CAPTURE(worst);
  CHECK(worst < 2e-14);
}

TEST_CASE("a box that one plane, or one edge along a diameter, cuts from a sphere has cap and wedge") {
  // A cap of height h has pi h^2 (3 R - h) / 3; planes x = 0 and y = 0 cut it into four.
  const double r = 0.7, height = 0.3, cap = pi * height * height * (3 * r - height) / 3;
  const Vec3 center(1, 2, 3), far = Vec3::Constant(5);
  const auto part = [&](const Vec3& low) { return Box{center + low, center + far}.part_of_sphere(center, r); };
  const double one = part(Vec3(-5, -5, r - height)) - cap, four = part(Vec3(0, 0, r - height)) - cap / 4;
  const double eighth = part(Vec3::Zero()) - unit_ball * r * r * r / 8;
  CAPTURE(one, four, eighth);
  CHECK(std::abs(one) < 1e-15);
  CHECK(std::abs(four) < 1e-15);
  CHECK(std::abs(eighth) < 1e-15);
  CHECK(part(Vec3(0.5, 0.5, 0.01)) == 0);  // the edge is sqrt(0.5) = 0.707 from the centre
}

TEST_CASE("the cells of a grid share a sphere out without rest, and none has less than nothing") {
  Random random(2);
  double worst = 0;
  for (int n = 0; n < 300; ++n) {
    const double r = random.uniform(0.05, 1.0);
    const Vec3 x = random_point(random, -0.5, 0.5);
    const CellGrid grid(Box{Vec3::Constant(-1.6), Vec3::Constant(1.7)}, random.uniform(0.2, 1.5));
    double sum = 0;
    for (int k = 0; k < grid.count()[2]; ++k)
      for (int j = 0; j < grid.count()[1]; ++j)
        for (int i = 0; i < grid.count()[0]; ++i) sum += grid.cell(i, j, k).part_of_sphere(x, r);
    worst = std::max(worst, std::abs(sum / (unit_ball * r * r * r) - 1));
  }
  CAPTURE(worst);
  CHECK(worst < 1e-12);
}

TEST_CASE("two spheres share two caps") {
  // Equal spheres, d apart: pi (4 R + d) (2 R - d)^2 / 12. One sphere across a plane-like huge one: a cap.
  const double r = 0.4, d = 0.5;
  const double equal = shared_volume(r, r, 2 * r - d) - pi * (4 * r + d) * (2 * r - d) * (2 * r - d) / 12;
  const double h = 0.1, huge = 1e4;  // the plane bends by r^2 / (2 huge) over the cap
  const double cap = shared_volume(huge, r, h) - pi * h * h * (3 * r - h) / 3;
  CAPTURE(equal, cap);
  CHECK(std::abs(equal) < 1e-16);
  CHECK(std::abs(cap) < pi * r * r * r * r / huge);
  CHECK(shared_volume(1, 0.2, 0.5) == Approx(unit_ball * 0.008));  // inside
  CHECK(shared_volume(1, 1, 0) == 0);
  CHECK(Ball{Vec3::Zero(), 1}.part_of_sphere(Vec3(1, 0, 0), 1) == Approx(5 * pi / 12));
  CHECK(Ball{Vec3::Zero(), 1}.part_of_sphere(Vec3(2.5, 0, 0), 1) == 0);
}

TEST_CASE("boxes, balls and cells share a line out by length") {
  const Box box{Vec3::Zero(), Vec3(1, 1, 1)};
  CHECK(box.share_of_line(Vec3(-1, 0.5, 0.5), Vec3(3, 0.5, 0.5)) == Approx(0.25));
  CHECK(box.share_of_line(Vec3(-1, 2, 0.5), Vec3(3, 2, 0.5)) == 0);
  CHECK(box.share_of_line(Vec3(0.2, 0.2, 0.2), Vec3(0.3, 0.4, 0.5)) == 1);
  const Ball ball{Vec3::Zero(), 1};
  // At height 0.6 the chord is 2 sqrt(1 - 0.36) = 1.6 long.
  CHECK(ball.share_of_line(Vec3(-2, 0.6, 0), Vec3(2, 0.6, 0)) == Approx(0.4));
  CHECK(ball.share_of_line(Vec3(0, 0, 0), Vec3(4, 0, 0)) == Approx(0.25));
  CHECK(ball.share_of_line(Vec3(-2, 1.1, 0), Vec3(2, 1.1, 0)) == 0);

  const CellGrid grid(Box{Vec3(-1, -2, -3), Vec3(1, 2, 3)}, 0.5);
  CHECK(grid.count() == std::array<int, 3>{4, 8, 12});
  Random random(3);
  double worst = 0;
  for (int n = 0; n < 500; ++n) {
    const Vec3 a = random_point(random, -0.99, 0.99), b = random_point(random, -0.99, 0.99);
    double sum = 0;
    std::vector<double> share(grid.size(), 0);
    grid.for_each_piece(a, b, [&](std::size_t cell, double s) { sum += s, share[cell] += s; });
    worst = std::max(worst, std::abs(sum - 1));
    for (int k = 0; k < 12; ++k)
      for (int j = 0; j < 8; ++j)
        for (int i = 0; i < 4; ++i)
          worst = std::max(worst, std::abs(share[grid.index(i, j, k)] - grid.cell(i, j, k).share_of_line(a, b)));
  }
  CAPTURE(worst);
  CHECK(worst < 1e-13);
  CHECK_THROWS_AS(CellGrid(Box{Vec3::Zero(), Vec3(1, 0, 1)}, 0.1), InputError);
  CHECK_THROWS_AS(CellGrid(Box{Vec3::Zero(), Vec3(1, 1, 1)}, 1e-9), InputError);
}
