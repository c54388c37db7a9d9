#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/measure.hpp"

using namespace lockstep;
using namespace lockstep::dem;

TEST_CASE("one sphere in a box leaves the porosity of its volume") {
  Particles p;
  p.add(make_clump(1, 1), 0.4, 1000, Vec3(0.5, 0.5, 0.5), Quat::Identity());
  const double exact = 1 - 4.0 / 3.0 * pi * 0.064;
  const double error = porosity(p, Box{Vec3::Zero(), Vec3::Ones()}, 0.01) - exact;
  CAPTURE(error);
  CHECK(std::abs(error) < 1e-3);
}

TEST_CASE("overlaps of pebbles and of bodies count once") {
  // A clump's union has the equivalent sphere's volume whatever its pebbles sum up to; a second copy in its place adds
  // nothing.
  Particles p;
  p.add(make_clump(5, 1.5), 0.3, 1000, Vec3(0.5, 0.5, 0.5), Quat(Eigen::AngleAxisd(0.4, Vec3::UnitZ())));
  const Box box{Vec3::Zero(), Vec3::Ones()};
  const double one = porosity(p, box, 0.01);
  p.add(make_clump(5, 1.5), 0.3, 1000, Vec3(0.5, 0.5, 0.5), Quat(Eigen::AngleAxisd(0.4, Vec3::UnitZ())));
  const double error = one - (1 - 4.0 / 3.0 * pi * 0.027);
  CAPTURE(error);
  CHECK(std::abs(error) < 1e-3);
  CHECK(porosity(p, box, 0.01) == one);
}

TEST_CASE("a ball inside a grain is solid and one beside it is void") {
  Particles p;
  p.add(make_clump(1, 1), 0.4, 1000, Vec3(0.5, 0.5, 0.5), Quat::Identity());
  CHECK(porosity(p, Ball{Vec3(0.5, 0.5, 0.5), 0.2}, 0.02) == 0);
  CHECK(porosity(p, Ball{Vec3(2, 0.5, 0.5), 0.2}, 0.02) == 1);
  CHECK_THROWS_AS(porosity(p, Ball{Vec3(2, 0.5, 0.5), 0.2}, 1.0), InputError);
}

TEST_CASE("mean stress of a squeezed pair and of a weight on a wall is force times branch over volume") {
  Particles p;
  p.add(make_clump(1, 1), 0.5, 1000, Vec3(0.5, 0.5, 0.5), Quat::Identity());
  p.add(make_clump(1, 1), 0.5, 1000, Vec3(1.5, 0.5, 0.5), Quat::Identity());
  MeanStress stress(Box{Vec3::Zero(), Vec3(2, 1, 1)});
  ContactView pair;
  pair.body_a = 0, pair.body_b = 1;
  pair.point = Vec3(1, 0.5, 0.5), pair.normal = Vec3(1, 0, 0);
  pair.force_on_a = Vec3(-10, 4, 0);
  stress.add(pair, p);
  ContactView wall;
  wall.body_a = 0;
  wall.point = Vec3(0.5, 0.5, 0), wall.normal = Vec3(0, 0, -1);
  wall.force_on_a = Vec3(0, 0, 6);
  stress.add(wall, p);
  // xx: -10 * 1 / 2; xy: half of 4 * 1 / 2; zz: 6 * (-0.5) / 2.
  const Voigt s = stress.stress();
  CHECK(s[0] == Approx(-5));
  CHECK(s[3] == Approx(1));
  CHECK(s[2] == Approx(-1.5));
  CHECK(stress.pressure() == Approx(6.5 / 3));
  // A contact whose way lies outside adds nothing.
  p.add(make_clump(1, 1), 0.5, 1000, Vec3(5, 0.5, 0.5), Quat::Identity());
  p.add(make_clump(1, 1), 0.5, 1000, Vec3(6, 0.5, 0.5), Quat::Identity());
  ContactView outside = pair;
  outside.body_a = 2, outside.body_b = 3;
  outside.point = Vec3(5.5, 0.5, 0.5);
  stress.add(outside, p);
  CHECK(stress.stress() == s);
}

TEST_CASE("coordination counts partners, not pebble contacts") {
  Coordination c(4);
  ContactView v;
  v.body_a = 0, v.body_b = 1;
  c.add(v);
  c.add(v);
  v.body_b = 2;
  c.add(v);
  v.body_b = -1;
  c.add(v);
  const PartnerCounts partners = c.partners();
  CHECK(partners[0] == 3);
  CHECK(partners[1] == 1);
  CHECK(partners.mean() == Approx(5.0 / 4));
  CHECK(partners.rattlers(3) == 3);
}

TEST_CASE("the unbalanced ratio is mean force per body over mean force per contact") {
  CHECK(unbalanced_ratio(10, 5, 200, 10) == Approx(0.1));
  CHECK(unbalanced_ratio(0, 5, 0, 0) == 0);
  CHECK(std::isinf(unbalanced_ratio(1, 5, 0, 0)));
  CHECK(unbalanced_ratio(0, 0, 0, 0) == 0);
}

TEST_CASE("energies by kind are those of velocity and spin, and of the two springs") {
  // A clump spins about its own long axis, which lies along y after a quarter turn: 1/2 I_long w^2 with that one moment.
  Particles p;
  const Quat quarter(Eigen::AngleAxisd(pi / 2, Vec3::UnitZ()));
  const auto b = p.add(make_clump(3, 1.5), 0.3, 1000, Vec3::Zero(), quarter);
  p.spin(b) = Vec3(0, 4, 0);
  p.velocity(b) = Vec3(1, 2, 3);
  const KineticEnergies k = kinetic_energies(p);
  CHECK(k.translational == Approx(0.5 * p.mass(b) * 14));
  CHECK(k.rotational == Approx(0.5 * p.inertia(b).x() * 16));
  CHECK(p.inertia(b).x() < 0.9 * p.inertia(b).y());

  ContactView c;
  c.normal = Vec3::UnitZ(), c.overlap = 0.01, c.normal_stiffness = 2e4, c.shear_stiffness = 5e3;
  c.force_on_a = Vec3(30, 40, -2e4 * 0.01);
  ElasticEnergies e;
  e.add(c);
  CHECK(e.normal == Approx(0.5 * 2e4 * 1e-4));
  CHECK(e.shear == Approx(0.5 * 2500 / 5e3));
}
