#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/porosity.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

// Equal spheres on a cubic lattice, `apart` from each other, with their contacts.
struct CubicPacking {
  Particles particles;
  std::vector<ContactView> contacts;

  CubicPacking(int side, double radius, double apart) {
    for (int k = 0; k < side; ++k)
      for (int j = 0; j < side; ++j)
        for (int i = 0; i < side; ++i)
          particles.add(make_clump(1, 1), radius, 1000, apart * Vec3(i, j, k), Quat::Identity());
    const std::array<int, 3> next = {1, side, side * side};
    for (int k = 0; k < side; ++k)
      for (int j = 0; j < side; ++j)
        for (int i = 0; i < side; ++i)
          for (int axis = 0; axis < 3; ++axis) {
            if (std::array{i, j, k}[axis] + 1 == side || 2 * radius <= apart) continue;
            ContactView c;
            c.body_a = (k * side + j) * side + i;
            c.body_b = c.body_a + next[axis];
            c.overlap = 2 * radius - apart;
            c.normal = Vec3::Unit(axis);
            c.point = apart * (Vec3(i, j, k) + 0.5 * c.normal);
            contacts.push_back(c);
          }
  }
};

// Whole periods inside the packing, from a place that has nothing to do with the lattice.
Box periods(double apart, int count) {
  const Vec3 low = apart * Vec3(0.87, 1.13, 1.41);
  return {low, low + Vec3::Constant(apart * count)};
}

double worst_error(const std::vector<RegionSolid>& solid, double porosity) {
  double worst = 0;
  for (const RegionSolid& s : solid) worst = std::max(worst, std::abs(s.porosity() - porosity));
  return worst;
}

}  // namespace

TEST_CASE("each cell of a cubic packing has the porosity of its period, to round-off") {
  // Touching spheres: 1 - pi/6. Overlapping ones: three lenses a sphere count once.
  for (const double overlap : {0.0, 0.02, 0.1}) {
    const double radius = 0.5, apart = 2 * radius - overlap;
    const CubicPacking packing(6, radius, apart);
    const double exact = 1 - (4.0 / 3.0 * pi * radius * radius * radius - 3 * shared_volume(radius, radius, overlap)) /
                                 (apart * apart * apart);
    const CellGrid grid(periods(apart, 3), apart);
    const double error = worst_error(solid_shares(packing.particles, packing.contacts, grid, apart / 4, Room()), exact);
    CAPTURE(overlap, exact, error);
    CHECK(error < 1e-12);
  }
}

TEST_CASE("a ball of spheres is exact where the sphere's part is a known lens") {
  // The ball's rim goes through the centres of two spheres that it otherwise leaves alone.
  Particles p;
  for (const double x : {-1.0, 1.0}) p.add(make_clump(1, 1), 1, 1000, Vec3(x, 0, 0), Quat::Identity());
  const Ball ball{Vec3::Zero(), 1};
  const RegionSolid solid = solid_share(p, {}, ball, 0.05, Room());
  // Unit spheres a unit apart share 5 pi / 12.
  const double error = solid.porosity() - (1 - 2 * (5 * pi / 12) / ball.volume());
  CAPTURE(error);
  CHECK(std::abs(error) < 1e-14);
  CHECK(solid.room == 1);
}

TEST_CASE("where the room ends inside a cell, porosity is that of the room's part") {
  // The room ends at the height of a layer's centres, half a period into each cell: the half cell has a period's
  // porosity. Counted by points, 64 a period; all cells see the same points, so that nothing averages out.
  const CubicPacking packing(6, 0.5, 1);
  const Box bounds{Vec3(1.37, 1.73, 2.5), Vec3(3.37, 3.73, 3.5)};
  const auto solid =
      solid_shares(packing.particles, {}, CellGrid(bounds, 1), 1.0 / 64, [](const Vec3& x) { return x.z() < 3; });
  const double error = worst_error(solid, 1 - pi / 6);
  CAPTURE(error);
  CHECK(solid.size() == 4);
  for (const RegionSolid& s : solid) CHECK(s.room == 0.5);
  CHECK(error < 2e-3);
  const auto nowhere = solid_shares(packing.particles, {}, CellGrid(bounds, 1), 0.1, [](const Vec3&) { return false; });
  CHECK(nowhere[0].room == 0);
  CHECK(solid_share(packing.particles, {}, Ball{Vec3(2, 2, 2), 0.6}, 0.02, [](const Vec3& x) {
          return x.x() < 2;
        }).room == Approx(0.5));
}

TEST_CASE("points in cells err by 0.2 h^2 sqrt(S) / V, against the exact volume of spheres") {
  // A random sphere's points: the error's standard deviation goes as the number of surface bricks' square root times
  // a brick's volume, h^3 sqrt(S / h^2) = h^2 sqrt(S). The law is the claim: order 2, and the factor.
  Random random(5);
  const double radius = 0.35, cell = 3;
  const Box box{Vec3::Zero(), Vec3::Constant(cell)};
  std::array<double, 2> deviation{};
  constexpr int trials = 100;
  for (int trial = 0; trial < trials; ++trial) {
    Particles p;
    // One sphere in each unit cube, anywhere in it as long as they cannot overlap.
    for (int n = 0; n < 125; ++n) {
      const Vec3 shift(random.uniform(), random.uniform(), random.uniform());
      p.add(make_clump(1, 1), radius, 1000,
            Vec3(n % 5, n / 5 % 5, n / 25) - Vec3::Constant(1) + (1 - 2 * radius) * shift, Quat::Identity());
    }
    const double exact = 1 - solid_of_spheres(p, {}, box) / box.volume();
    for (int level = 0; level < 2; ++level) {
      const double error = porosity(p, box, 1.0 / (8 << level)) - exact;
      deviation[level] += error * error / trials;
    }
  }
  const double surface = 27 * 4 * pi * radius * radius;
  const double coarse = std::sqrt(deviation[0]), fine = std::sqrt(deviation[1]);
  const double order = std::log2(coarse / fine), factor = coarse * box.volume() / (std::sqrt(surface) / 64);
  CAPTURE(coarse, fine, order, factor);
  CHECK(order > 1.6);
  CHECK(order < 2.6);
  CHECK(factor > 0.1);
  CHECK(factor < 0.4);
}

TEST_CASE("clumps are counted by points, a union once") {
  // The union has the equivalent sphere's volume.
  Particles p;
  p.add(make_clump(3, 1.5), 0.3, 1000, Vec3(0.5, 0.5, 0.5), Quat(Eigen::AngleAxisd(0.4, Vec3::UnitZ())));
  const CellGrid one(Box{Vec3::Zero(), Vec3::Ones()}, 1);
  const double error = solid_shares(p, {}, one, 0.01, Room())[0].solid - 4.0 / 3.0 * pi * 0.027;
  CAPTURE(error);
  CHECK(std::abs(error) < 2e-4);
}
