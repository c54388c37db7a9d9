#include <catch2/catch.hpp>

#include "common/random.hpp"
#include "dem_server/timestep.hpp"
#include "tests/dem_server/cubes.hpp"
#include "tests/dem_server/free_grains.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

ContactView wall_contact(const Particles& p, std::int32_t body, const Vec3& normal, double k_n, double k_s) {
  ContactView c;
  c.body_a = body;
  c.normal = normal;
  c.point = p.position(body) + p.equivalent_radius(body) * normal;
  c.normal_stiffness = k_n;
  c.shear_stiffness = k_s;
  return c;
}

// Touching equal spheres on a periodic n^3 cubic lattice with a little overlap.
FreeGrains lattice(int n, double r) {
  const double d = 2 * r * (1 - 1e-4);
  FreeGrains world(0.1 * r, Vec3(n * d, n * d, n * d));
  for (int k = 0; k < n * n * n; ++k) world.sphere(Vec3(k % n + 0.5, k / n % n + 0.5, k / (n * n) + 0.5) * d, r);
  return world;
}

StiffnessSum assembled(FreeGrains& world) {
  world.particles.clear_forces();
  world.contacts.update(world.particles);
  world.contacts.compute(world.particles, world.material, 1e-6);
  StiffnessSum sum;
  sum.reset(world.particles.body_count());
  world.contacts.for_each_branch(
      world.particles, [&](const ContactView& c, const Vec3& branch) { sum.add(c, world.particles, branch); });
  return sum;
}

double power_step(FreeGrains& world, int products) {
  std::vector<ContactView> contacts;
  Vec3s branches;
  world.contacts.for_each_branch(world.particles, [&](const ContactView& c, const Vec3& branch) {
    contacts.push_back(c);
    branches.push_back(branch);
  });
  return critical_step_power(contacts, world.particles, 0, products, branches);
}

// Ratio of kinetic energy after `steps` to before, of a slightly shaken lattice.
double growth(double r, double dt, int steps) {
  FreeGrains world = lattice(4, r);
  Random random(3);
  const auto square_speeds = [&] {
    double sum = 0;
    for (std::size_t b = 0; b < world.particles.body_count(); ++b) sum += world.particles.velocity(b).squaredNorm();
    return sum;
  };
  for (std::size_t b = 0; b < world.particles.body_count(); ++b)
    world.particles.velocity(b) = 1e-6 * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  const double start = square_speeds();
  for (int k = 0; k < steps; ++k) world.step(dt);
  return square_speeds() / start;
}

}  // namespace

TEST_CASE("one sphere on one spring: the exact limit, at most 6 % below it") {
  // Normal spring: omega^2 = k_n/m. Shear spring at distance r: omega^2 = k_s (1/m + r^2/I) = 3.5 k_s/m.
  Particles p;
  p.add(make_clump(1, 1), 0.03, 2650, Vec3::Zero(), Quat::Identity());
  for (const auto& [k_n, k_s] : {std::pair{1e6, 1e5}, std::pair{1e6, 1e6}}) {
    StiffnessSum sum;
    sum.reset(1);
    sum.add(wall_contact(p, 0, Vec3(0, 0, -1), k_n, k_s), p);
    const double exact = 2 / std::sqrt(std::max(k_n, 3.5 * k_s) / p.mass(0));
    std::int32_t worst = -1;
    const double bound = sum.stable_step(0, &worst);
    CAPTURE(k_s, bound / exact);
    CHECK(bound <= exact * (1 + 1e-12));
    CHECK(bound > 0.94 * exact);
    CHECK(worst == 0);
    CHECK(sum.stable_step(0.7) == Approx(bound / std::sqrt(1.7)));
  }
}

TEST_CASE("bodies in several parts, on several threads, have the bound of one part to the bit") {
  // A pair across a border is given to both its parts, as the lists of PairContacts do. The grains stand on a wall that
  // is added afterwards, by body.
  FreeGrains world = lattice(6, 0.03);
  world.particles.clear_forces();
  world.contacts.update(world.particles);
  world.contacts.compute(world.particles, world.material, 1e-6);
  const Particles& p = world.particles;
  std::vector<ContactView> pairs;  // those whose positions say which image touches
  world.contacts.for_each_branch(p, [&](const ContactView& c, const Vec3& branch) {
    if (branch.isApprox(p.position(c.body_b) - p.position(c.body_a))) pairs.push_back(c);
  });
  REQUIRE(pairs.size() == 3 * 5 * 36);
  const auto walls_of = [&](StiffnessSum& sum) {
    for (std::int32_t b = 0; b < 36; ++b) sum.add(wall_contact(p, b, Vec3(0, 0, -1), 1e6 * (1 + b), 1e5), p);
  };
  StiffnessSum whole;
  whole.reset(p.body_count());
  for (const ContactView& c : pairs) whole.add(c, p);
  walls_of(whole);
  std::int32_t worst = -1;
  const double bound = whole.stable_step(0.2, &worst);
  REQUIRE(std::isfinite(bound));

  StiffnessSum parted;
  for (const Partition& partition :
       {Partition{{0, 216}}, Partition{{0, 100, 216}}, Partition{{0, 0, 7, 36, 36, 111, 215, 216}}}) {
    Team team(3);
    parted.reset(partition);
    team.run_parts(partition.size(), [&](int part) {
      const std::int32_t begin = partition.body_begin[static_cast<std::size_t>(part)],
                         end = partition.body_begin[static_cast<std::size_t>(part) + 1];
      const auto is_own = [&](std::int32_t b) { return b >= begin && b < end; };
      for (const ContactView& c : pairs)
        if (is_own(c.body_a) || is_own(c.body_b)) parted.add_to_part(part, c, p);
    });
    walls_of(parted);
    std::int32_t named = -1;
    CHECK(parted.stable_step(0.2, &named, team) == bound);
    CHECK(named == worst);
  }
}

TEST_CASE("contacts with walls alone: the body that they hold most") {
  // One spring k_n along x on each of bodies 0 and 2, two on body 1: omega^2 = 2 k_n/m; the bound is at most 12 % above.
  Particles p;
  for (int b = 0; b < 3; ++b) p.add(make_clump(1, 1), 0.03, 2650, Vec3(b, 0, 0), Quat::Identity());
  std::vector<ContactView> contacts;
  CHECK(largest_wall_frequency_squared(contacts, p) == 0);
  for (const std::int32_t b : {0, 1, 1, 2}) contacts.push_back(wall_contact(p, b, Vec3(1, 0, 0), 1e6, 0));
  const double exact = 2 * 1e6 / p.mass(1), found = largest_wall_frequency_squared(contacts, p);
  CAPTURE(found / exact - 1);
  CHECK(found >= exact * (1 - 1e-12));
  CHECK(found < 1.12 * exact);
}

TEST_CASE("without contacts no step is too long") {
  StiffnessSum sum;
  sum.reset(3);
  CHECK(std::isinf(sum.stable_step(0)));
  CHECK(std::isinf(critical_step_power({}, Particles{}, 0)));
}

TEST_CASE("the body with the stiffest support is named") {
  Particles p;
  for (int b = 0; b < 3; ++b) p.add(make_clump(3, 1.5), 0.03, 2650, Vec3(b, 0, 0), Quat::Identity());
  StiffnessSum sum;
  sum.reset(3);
  for (int b = 0; b < 3; ++b) sum.add(wall_contact(p, b, Vec3(0, 0, -1), b == 1 ? 4e6 : 1e6, 1e5), p);
  std::int32_t worst = -1;
  sum.stable_step(0, &worst);
  CHECK(worst == 1);
}

TEST_CASE("the bound and the estimate stand right of the exact limit of a cubic lattice") {
  // Stiffness ratio 8. The lattice's modes at the corner of the Brillouin zone, all neighbours in antiphase:
  //   translation: omega^2 = 4 (k_n + 2 k_s)/m;   rotation about an axis, neighbours counter-rotating: the contact
  //   points of
  // the four neighbours across the axis do not slip; in phase they slip: omega^2 = 4 * 4 k_s r^2 / I = 16 * 2.5 k_s / m
  // (four contacts, each slipping by 2 r theta, work 1/2 k_s (2 r theta)^2 shared by two). With k_s = k_n/8:
  //   translation 5 k_n/m, rotation 5 k_n/m: the limit is 2/sqrt(5 k_n/m).
  const double r = 0.03;
  FreeGrains world = lattice(4, r);
  const double mass = world.particles.mass(0), k_n = 94e6 * 2 * r;
  const double exact = 2 / std::sqrt(5 * k_n / mass);
  const double bound = assembled(world).stable_step(0);
  const double estimate = power_step(world, 200) / power_margin;
  const double below = growth(r, 0.995 * exact, 1500), above = growth(r, 1.02 * exact, 1500);
  const double at_bound = growth(r, bound, 1500);
  CAPTURE(bound / exact, estimate / exact, below, above, at_bound);
  CHECK(bound < exact);
  CHECK(bound > 0.55 * exact);
  CHECK(estimate / exact == Approx(1).margin(0.01));
  CHECK(at_bound < 10);
  CHECK(below < 1000);
  CHECK(above > 1e6);
}

TEST_CASE("a chain of spheres: the estimate meets omega = 2 sqrt(k/m), the bound stays below") {
  // Periodic chain, no shear: sum over contacts of a^2 on the diagonal is 2 k/m, off it 2 k/m: Gershgorin is exact
  // here, 4 k/m.
  const double r = 0.03;
  FreeGrains world(0.003, Vec3(8 * 2 * r * (1 - 1e-4), 1, 1));
  for (int k = 0; k < 8; ++k) world.sphere(Vec3((2 * k + 1) * r * (1 - 1e-4), 0.5, 0.5), r);
  world.material.stiffness_ratio = 1e6;
  const double exact = std::sqrt(world.particles.mass(0) / (94e6 * 2 * r));
  const double bound = assembled(world).stable_step(0), estimate = power_step(world, 200) / power_margin;
  CAPTURE(bound / exact, estimate / exact);
  CHECK(bound <= exact * (1 + 1e-12));
  CHECK(bound > 0.93 * exact);
  CHECK(estimate / exact == Approx(1).margin(1e-3));
}

TEST_CASE("in a dense packing of clumps the bound is safe and the estimate close") {
  CubeRequest request;
  request.grains = 150;
  request.porosity = 0.44;
  const Cube cube = first_cube(request);
  FreeGrains world(0.0015, cube.period);
  world.particles = cube.particles;
  world.particles.scale_all(1.001);
  std::int32_t worst = -1;
  const double bound = assembled(world).stable_step(0, &worst);
  const double truth = power_step(world, 3000) / power_margin, estimate = power_step(world, power_products);
  const double t0 = std::sqrt(world.particles.lightest() / (94e6 * 2 * 0.024));
  CAPTURE(bound / truth, estimate / truth, truth / t0, worst);
  CHECK(bound < truth);
  CHECK(bound > 0.5 * truth);
  CHECK(estimate < truth);
  CHECK(estimate > 0.9 * truth);
}
