#include <catch2/catch.hpp>

#include "dem_server/clumps.hpp"
#include "dem_server/mean_stress.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

// Unit spheres' lattice, one apart, each contact with the force that a uniform stress puts on its face: -p_i e_i on A
// where A presses against B along i.
struct Lattice {
  Particles particles;
  std::vector<ContactView> contacts;

  Lattice(const std::array<int, 3>& count, const Vec3& pressure) {
    for (int k = 0; k < count[2]; ++k)
      for (int j = 0; j < count[1]; ++j)
        for (int i = 0; i < count[0]; ++i) {
          const int body = (k * count[1] + j) * count[0] + i;
          particles.add(make_clump(1, 1), 0.5, 1000, Vec3(i, j, k), Quat::Identity());
          const std::array<int, 3> at = {i, j, k}, next = {1, count[0], count[0] * count[1]};
          for (int axis = 0; axis < 3; ++axis)
            if (at[axis] + 1 < count[axis]) contacts.push_back(touch(body, body + next[axis], axis, at, pressure));
        }
  }

  static ContactView touch(int a, int b, int axis, const std::array<int, 3>& at, const Vec3& pressure) {
    ContactView c;
    c.body_a = a, c.body_b = b;
    c.normal = Vec3::Unit(axis);
    c.point = Vec3(at[0], at[1], at[2]) + 0.5 * c.normal;
    c.force_on_a = -pressure[axis] * c.normal;
    return c;
  }
};

}  // namespace

TEST_CASE("a chain under a force carries it in every region it runs through, wherever the region begins") {
  // Force F over the section: sigma_zz = -F / A, in boxes that cut grains and contacts anywhere; in a ball of radius r
  // around the chain -F 2 r / V.
  const double force = 30;
  const Lattice chain({1, 1, 12}, Vec3(0, 0, force));
  for (const double low : {2.0, 2.13, 2.5, 2.77})
    for (const double height : {0.2, 1.0, 3.4}) {
      MeanStress stress(Box{Vec3(-1, -1, low), Vec3(1, 1, low + height)});
      for (const ContactView& c : chain.contacts) stress.add(c, chain.particles);
      const double error = stress.stress()[2] + force / 4;
      CAPTURE(low, height, error);
      CHECK(std::abs(error) < 1e-13);
      CHECK(stress.stress()[0] == 0);
      CHECK(stress.pressure() == Approx(force / 12));
    }
  const Ball ball{Vec3(0, 0, 5.3), 1.7};
  MeanStress stress(ball);
  for (const ContactView& c : chain.contacts) stress.add(c, chain.particles);
  CHECK(stress.stress()[2] == Approx(-force * 2 * ball.radius / ball.volume()));
}

TEST_CASE("each cell of a pressed lattice has the stress that presses it") {
  // One contact a period along each axis: sigma_ii = -p_i exactly, in cells that begin anywhere.
  const Vec3 pressure(10, 20, 35);
  const Lattice lattice({7, 7, 7}, pressure);
  const Vec3 low(1.37, 1.5, 1.81);
  const CellGrid grid(Box{low, low + Vec3(3, 3, 2)}, 1);
  StressField field(grid);
  for (const ContactView& c : lattice.contacts) field.add(c, lattice.particles);
  double worst = 0;
  for (std::size_t cell = 0; cell < grid.size(); ++cell) {
    const Voigt s = field.stress(cell);
    for (int axis = 0; axis < 3; ++axis) worst = std::max(worst, std::abs(s[axis] + pressure[axis]));
    worst = std::max(worst, s.tail<3>().cwiseAbs().maxCoeff());
    CHECK(field.contacts(cell) == 3);
  }
  CAPTURE(worst);
  CHECK(worst < 1e-12);
  CHECK(field.stress(0, 0.5)[0] == Approx(-20));  // half of the cell is no room
}

TEST_CASE("the cells of a grid sum up to the box, shear and walls included") {
  Lattice lattice({4, 4, 4}, Vec3(5, 6, 7));
  for (std::size_t n = 0; n < lattice.contacts.size(); ++n) {
    ContactView& c = lattice.contacts[n];
    c.force_on_a += c.normal.cross(Vec3(1.0, -2.0, 0.1 * static_cast<double>(n)));
  }
  ContactView wall;  // below the first grain: the force goes from its centre down to the contact point
  wall.body_a = 0, wall.normal = -Vec3::UnitZ(), wall.point = Vec3(0, 0, -0.49), wall.force_on_a = Vec3(1, 2, 50);
  lattice.contacts.push_back(wall);
  const Box box{Vec3(-0.6, -0.7, -0.8), Vec3(2.2, 2.3, 2.4)};
  MeanStress whole(box);
  const CellGrid grid(box, 0.7);
  StressField field(grid);
  for (const ContactView& c : lattice.contacts) whole.add(c, lattice.particles), field.add(c, lattice.particles);
  Voigt sum = Voigt::Zero();
  for (std::size_t cell = 0; cell < grid.size(); ++cell) sum += field.stress(cell) / static_cast<double>(grid.size());
  const double error = (sum - whole.stress()).norm() / whole.stress().norm();
  CAPTURE(error);
  CHECK(error < 1e-13);

  MeanStress below(Box{Vec3(-1, -1, -0.45), Vec3(1, 1, -0.05)});
  below.add(wall, lattice.particles);
  // 0.4 of the 0.49 m to the wall lie in the region: f (x) l = (1, 2, 50) (x) (0, 0, -0.4), volume 1.6.
  const Voigt s = below.stress();
  CHECK(s[2] == Approx(-50 * 0.4 / 1.6));
  CHECK(s[5] == Approx(-0.5 * 1 * 0.4 / 1.6));
  CHECK(s[4] == Approx(-0.5 * 2 * 0.4 / 1.6));
}

TEST_CASE("pressure and deviator are those of a triaxial test") {
  Voigt s;
  s << -100, -100, -300, 0, 0, 0;
  CHECK(pressure_of(s) == Approx(500.0 / 3));
  CHECK(deviator_of(s) == Approx(200));
  s << 0, 0, 0, 10, 0, 0;  // pure shear: sqrt(3) tau
  CHECK(deviator_of(s) == Approx(10 * std::sqrt(3.0)));
}
