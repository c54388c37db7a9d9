// Attempts to break the grains: sizes 1 : 20, one grain or none, grains far away or nowhere, the softest and stiffest
// contacts, a pile rammed through a packing, a million spheres.
#include <sys/resource.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <chrono>
#include <cmath>
#include <iostream>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "dem_server/cycle.hpp"
#include "tests/dem_server/free_grains.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

constexpr double density = 2650;  // [kg/m3]

Vec3 random_vector(Random& random, double size) {
  return size * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
}

bool is_finite(const Particles& p) {
  bool finite = true;
  for (std::size_t b = 0; b < p.body_count(); ++b)
    finite = finite && p.position(b).allFinite() && p.velocity(b).allFinite() && p.spin(b).allFinite() &&
             p.orientation(b).coeffs().allFinite();
  return finite;
}

// Partners of each pebble by a search of all pairs, and by cells: where they differ.
int differences(const Particles& p, double reach) {
  NeighborSearch search;
  search.sort(p, reach, {});
  std::vector<std::int32_t> found, truth;
  int different = 0;
  const auto count = static_cast<std::int32_t>(p.pebble_count());
  for (std::int32_t i = 0; i < count; ++i) {
    search.partners_after(p, i, found);
    truth.clear();
    for (std::int32_t j = i + 1; j < count; ++j) {
      const double range = p.pebble_radius(i) + p.pebble_radius(j) + reach;
      const Vec3 d = p.pebble_center(j) - p.pebble_center(i);
      if (p.pebble_body(i) != p.pebble_body(j) && d.squaredNorm() < range * range) truth.push_back(j);
    }
    different += found != truth;
  }
  return different;
}

}  // namespace

TEST_CASE("cells find what a search of all pairs finds, sizes 1 : 20, spheres and clumps, close or scattered") {
  Random random(21);
  for (const int pebbles : {1, 3})
    for (const double box : {0.5, 3.0, 40.0})
      for (const double reach : {0.001, 0.1}) {
        Particles p;
        const ClumpTemplate shape = make_clump(pebbles, 1.5);
        // As many of each size class by volume would be all small ones; radii are drawn log-uniform from 1 to 20.
        for (int k = 0; k < 400; ++k)
          p.add(shape, 0.005 * std::pow(20.0, random.uniform()), density, random_vector(random, box),
                random.rotation());
        CAPTURE(pebbles, box, reach);
        CHECK(differences(p, reach) == 0);
      }
}

TEST_CASE("cells find what a search of all pairs finds on lines, planes, points, and with a grain far away") {
  Random random(22);
  for (const double thickness : {0.0, 1e-20, 1e-6})
    for (const int dimensions : {0, 1, 2})
      for (const double far : {0.0, 100.0, 1e9}) {
        Particles p;
        for (int k = 0; k < 200; ++k) {
          Vec3 at = random_vector(random, 1);
          for (int d = dimensions; d < 3; ++d) at[d] *= thickness;
          p.add(make_clump(1, 1), random.uniform(0.02, 0.1), density, at, Quat::Identity());
        }
        if (far > 0) p.add(make_clump(1, 1), 0.05, density, Vec3(0, 0, far), Quat::Identity());
        CAPTURE(thickness, dimensions, far);
        CHECK(differences(p, 0.01) == 0);
      }
}

TEST_CASE("grains that flew off in two directions cost no memory beyond their own") {
  // Three directions wide or one, cells are bounded by 4 a pebble; a flat scatter must be, too. 64 more are allowed to
  // any grid.
  for (const double far : {1e3, 1e5, 1e7}) {
    Particles p;
    for (const Vec3& at : {Vec3(0, 0, 0), Vec3(far, far, 0), Vec3(0.09, 0, 0)})
      p.add(make_clump(1, 1), 0.05, density, at, Quat::Identity());
    NeighborSearch search;
    search.sort(p, 0.01, {});
    CAPTURE(far, search.memory());
    CHECK(search.memory() < 4096);
    CHECK(differences(p, 0.01) == 0);
  }
}

TEST_CASE("sizes 1 : 20 pour and come to rest on a floor, on their own weight to a percent") {
  // One sphere of 0.1 m among 300 of 0.005 to 0.02 m. At rest the floor carries the weight; the sum over the last four thousand steps
  // is compared, since single steps still ring.
  Model model(2.5e-4);
  Random random(23);
  model.material.contact_modulus = 2e6;
  model.material.friction = 0.5;
  model.material.damping_ratio = damping_ratio(0.3);
  model.gravity = Vec3(0, 0, -9.81);
  model.damping = 0.3;
  const double half = 0.16;
  model.walls = Walls(std::vector<PlaneSettings>{{Vec3::Zero(), Vec3::UnitZ(), Vec3::Zero()},
                                                 {Vec3(-half, 0, 0), Vec3::UnitX(), Vec3::Zero()},
                                                 {Vec3(half, 0, 0), -Vec3::UnitX(), Vec3::Zero()},
                                                 {Vec3(0, -half, 0), Vec3::UnitY(), Vec3::Zero()},
                                                 {Vec3(0, half, 0), -Vec3::UnitY(), Vec3::Zero()}},
                      0.5);
  const ClumpTemplate sphere = make_clump(1, 1), clump = make_clump(3, 1.5);
  model.particles.add(sphere, 0.1, density, Vec3(0, 0, 0.12), Quat::Identity());
  for (int k = 0; k < 343; ++k) {
    const Vec3 at = 0.045 * (Vec3(k % 7, k / 7 % 7, k / 49) - Vec3(3, 3, -0.5));
    if ((at - Vec3(0, 0, 0.12)).norm() < 0.13) continue;
    model.particles.add(k % 2 ? clump : sphere, 0.005 * std::pow(4.0, random.uniform()), density, at,
                        random.rotation());
  }
  // k of the smallest with the largest, on the smallest's mass: the fastest of all.
  const double lightest = model.particles.lightest();
  Held boundary(0.3 * std::sqrt(lightest / model.material.normal_stiffness(0.1, 0.005)));
  double carried = 0, largest_overlap = 0;
  const int steps = 40000, last = 4000;
  for (int k = 0; k < steps; ++k) {
    cycle(model, boundary);
    largest_overlap = std::max(largest_overlap, model.pair_totals.largest_overlap_ratio);
    if (k >= steps - last) carried -= model.walls.totals()[0].force.z() / last;
  }
  const double weight = 9.81 * model.particles.total_mass();
  const double error = carried / weight - 1;
  CAPTURE(model.particles.body_count(), model.time, carried, weight, error, largest_overlap, model.motion.largest_speed,
          model.contacts.refreshes(), model.contacts.rebuilds());
  CHECK(is_finite(model.particles));
  CHECK(model.pair_totals.active > 100);
  CHECK(std::abs(error) < 0.01);
  CHECK(largest_overlap < 0.3);
}

TEST_CASE("none, one and two grains step like many, with any number of threads") {
  for (const int threads : {1, 4})
    for (const int count : {0, 1, 2})
      for (const int pebbles : {1, 3}) {
        Model model(0.002, threads);
        model.gravity = Vec3(0, 0, -10);
        for (int k = 0; k < count; ++k)
          model.particles.add(make_clump(pebbles, 1.5), 0.03, density, Vec3(k, 0, 0), Quat::Identity());
        Held boundary(1e-3);
        for (int k = 0; k < 30; ++k) REQUIRE(cycle(model, boundary));
        CAPTURE(threads, count, pebbles);
        CHECK(model.pair_totals.active == 0);
        // v = g t: the first kick has half a step, none having led to t_0.
        for (int k = 0; k < count; ++k)
          CHECK(std::as_const(model.particles).velocity(k).z() == Approx(-10 * 29.5e-3).epsilon(1e-12));
        CHECK(model.contacts.springs().empty());
        CHECK(std::isfinite(model.ledger.residual()));
      }
}

TEST_CASE("grains with one centre push each other apart and stay finite, spheres and clumps, at rest and in flight") {
  for (const int pebbles : {1, 3})
    for (const double speed : {0.0, 1.0})
      for (const double friction : {0.0, 0.5, 1e3}) {
        FreeGrains world(0.002);
        world.material.contact_modulus = 1e6;
        world.material.friction = friction;
        const ClumpTemplate shape = make_clump(pebbles, 1.5);
        const double size = 0.03;
        for (int k = 0; k < 2; ++k) {
          const std::int32_t b = world.particles.add(shape, size, density, Vec3::Zero(), Quat::Identity());
          world.particles.velocity(b) = k * Vec3(speed, 0.5 * speed, 0);
        }
        double slip = 0, start = 0, largest = 0;
        for (int k = 0; k < 3000; ++k) {
          world.step(1e-5);
          if (k == 0) start = world.energy();
          slip += world.totals.slip_work;
          largest = std::max(largest, world.energy());
        }
        CAPTURE(pebbles, speed, friction, start, largest, slip, world.energy());
        CHECK(is_finite(world.particles));
        CHECK((world.particles.position(1) - world.particles.position(0)).norm() > size);
        CHECK(largest < 1.5 * start);
        CHECK(std::abs(slip) < 1.5 * start);
      }
}

TEST_CASE("a loaded spring whose pair comes together in one place stays within friction and books no absurd work") {
  // The normal of such a pair is made up. Whatever the turn makes of the old spring, Coulomb bounds the new one, and slip cannot
  // take out more than the spring held and the step did.
  for (const double distance : {1e-3, 1e-6, 1e-9, 1e-15, 0.0}) {
    FreeGrains world(0.002);
    world.material.contact_modulus = 1e6;
    world.material.friction = 0.5;
    const double size = 0.03, dt = 1e-5;
    world.sphere(Vec3::Zero(), size);
    world.sphere(Vec3(0, 0, distance), size);
    world.particles.velocity(1) = Vec3(1, 0, 0);
    const Vec3 spring(0, 10, 10);
    world.contacts.restore(world.particles, {{0, 1, spring}});
    world.contacts.update(world.particles);
    const ContactTotals totals = world.contacts.compute(world.particles, world.material, dt);
    const double normal = 1e6 * 2 * size * (2 * size), shear = 1e6 * 2 * size / world.material.stiffness_ratio;
    const double held = spring.squaredNorm() / (2 * shear), done = (spring.norm() + normal) * 1.0 * dt;  // [J]
    const Vec3 force = world.particles.force(0);
    CAPTURE(distance, totals.slip_work, totals.shear_energy, held, done, force.transpose());
    CHECK(force.allFinite());
    CHECK(force.norm() < 1.2 * normal);
    CHECK(std::isfinite(totals.slip_work));
    CHECK(std::abs(totals.slip_work) <= 2 * (held + done));
  }
}

TEST_CASE("a grain far outside flies on, and one that is nowhere is named") {
  const auto crowd = [](int pebbles) {
    FreeGrains world(0.002);
    world.gravity = Vec3(0, 0, -10);
    for (int k = 0; k < 300; ++k)
      world.particles.add(make_clump(pebbles, 1.5), 0.03, density, 0.08 * Vec3(k % 7, k / 7 % 7, k / 49),
                          Quat::Identity());
    return world;
  };
  for (const int pebbles : {1, 3}) {
    for (const double far : {1e3, 1e6, 1e9, 1e12}) {
      FreeGrains world = crowd(pebbles);
      world.particles.position(123) = Vec3(far, 0.1, 0.1);
      world.particles.place_pebbles();
      for (int k = 0; k < 10; ++k) world.step(1e-4);
      CAPTURE(pebbles, far);
      CHECK(is_finite(world.particles));
      CHECK(std::as_const(world.particles).position(123).x() == far);
    }
    constexpr double no_numbers[] = {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(),
                                     -std::numeric_limits<double>::infinity()};
    for (const double nowhere : no_numbers)
      for (const int axis : {0, 1, 2})
        for (const bool has_stepped : {false, true}) {
          FreeGrains world = crowd(pebbles);
          if (has_stepped) world.step(1e-4);
          world.particles.position(257)[axis] = nowhere;
          world.particles.place_pebbles();
          CAPTURE(pebbles, nowhere, axis, has_stepped);
          CHECK_THROWS_AS(world.step(1e-4), NumericalError);
          CHECK_THROWS_WITH(world.step(1e-4), Catch::Contains("grain 257"));
        }
  }
}

TEST_CASE("a velocity or a spin that is no number stops the cycle at once with the grain's name") {
  for (const int pebbles : {1, 3}) {
    const auto crowd = [&](double spacing) {
      auto model = std::make_unique<Model>(0.002, 2);
      for (int k = 0; k < 600; ++k)
        model->particles.add(make_clump(pebbles, 1.5), 0.03, density, spacing * Vec3(k % 9, k / 9 % 9, k / 81),
                             Quat::Identity());
      return model;
    };
    CAPTURE(pebbles);
    const double nan = std::numeric_limits<double>::quiet_NaN();
    Held boundary(1e-4);
    const auto apart = crowd(0.12), touching = crowd(0.0599);
    for (Model* model : {apart.get(), touching.get()}) cycle(*model, boundary);
    const auto spinning = crowd(0.12);
    cycle(*spinning, boundary);
    apart->particles.velocity(411).z() = nan;
    CHECK_THROWS_WITH(cycle(*apart, boundary), Catch::Contains("grain 411"));
    spinning->particles.spin(411).z() = nan;
    CHECK_THROWS_WITH(cycle(*spinning, boundary), Catch::Contains("grain 411"));
    touching->particles.spin(411).z() = nan;
    CHECK_THROWS_AS(cycle(*touching, boundary), NumericalError);
  }
}

TEST_CASE("contacts of 1e3 and 1e11 N/m bounce alike, with friction 0 and 1e3") {
  // Scaled by its own period the bounce is the same: at k = 1e3 N/m the two meet at 1e-4 of the speed, for an equal depth. The
  // spheres meet off centre, spinning.
  const double size = 0.03, mass = density * 4.0 / 3.0 * pi * size * size * size;
  for (const int pebbles : {1, 3})
    for (const double friction : {0.0, 1e3}) {
      std::vector<double> kept, turned;
      for (const double k : {1e3, 1e11}) {
        FreeGrains world(0.002);
        world.material.contact_modulus = k / (2 * size);
        world.material.friction = friction;
        const double rate = std::sqrt(k / mass), speed = 0.02 * size * rate;
        const ClumpTemplate shape = make_clump(pebbles, 1.5);
        world.particles.add(shape, size, density, Vec3::Zero(), Quat(0.9, 0.1, -0.3, 0.2).normalized());
        world.particles.add(shape, size, density, Vec3(2.6 * size, 0.9 * size, 0.4 * size),
                            Quat(0.8, -0.2, 0.1, 0.4).normalized());
        world.particles.velocity(0).x() = speed;
        world.particles.velocity(1).x() = -speed;
        world.particles.spin(0) = 0.3 * speed / size * Vec3(1, -2, 0.5);
        const double start = world.particles.mass(0) * speed * speed;
        const Vec3 momentum = world.momentum();
        std::int64_t touches = 0;
        for (int step = 0; step < 5000; ++step) {
          world.step(0.02 / rate);
          touches += world.totals.active;
        }
        REQUIRE(touches > 0);
        CHECK(is_finite(world.particles));
        CHECK((world.momentum() - momentum).norm() < 1e-12 * world.particles.mass(0) * speed);
        kept.push_back((world.energy() + world.slip_work) / start);
        turned.push_back(world.particles.spin(1).norm() * size / speed);
      }
      CAPTURE(pebbles, friction, kept, turned);
      CHECK(kept[0] == Approx(kept[1]).epsilon(1e-9));
      CHECK(turned[0] == Approx(turned[1]).epsilon(1e-6).margin(1e-9));
      CHECK(turned[0] > (pebbles == 1 && friction == 0 ? -1 : 1e-3));
    }
}

TEST_CASE("a pile rammed through a packing at 100 m/s is an error in words, or a state without NaN") {
  for (const int threads : {1, 3})
    for (const double speed : {100.0, 1e4}) {
      Model model(0.001, threads);
      const ClumpTemplate sphere = make_clump(1, 1), clump = make_clump(3, 1.5);
      for (int k = 0; k < 512; ++k)
        model.particles.add(k % 2 ? clump : sphere, 0.029, density,
                            0.06 * (Vec3(k % 8, k / 8 % 8, k / 64) - Vec3(3.5, 3.5, 7.5)),
                            Quat(Eigen::AngleAxisd(k, Vec3(1, 2, 3).normalized())));
      model.material.friction = 0.7;
      model.material.damping_ratio = damping_ratio(0.5);
      model.pile.emplace(PileShape{0.125}, 0.0, 1.0);
      model.pile->set_velocity(-speed);
      Held boundary(1e-5);
      std::string words;
      int steps = 0;
      try {
        for (; steps < 400; ++steps) cycle(model, boundary);
      } catch (const NumericalError& error) {
        words = error.what();
      }
      CAPTURE(threads, speed, steps, words, model.pile_totals.tip.max_overlap, model.motion.largest_speed);
      CHECK(is_finite(model.particles));
      if (words.empty()) {
        CHECK(steps == 400);
        CHECK(std::isfinite(model.ledger.residual()));
      } else {
        CHECK_THAT(words, Catch::Contains("grain "));
        CHECK_THAT(words, Catch::Contains("m/s"));
        CHECK(speed >= 100);
      }
    }
}

TEST_CASE("a million spheres on a lattice fit and step", "[.big]") {
  // Spheres in touch: three contacts each, and an outer list of about as many.
  constexpr int edge = 100;
  constexpr double size = 0.01, most_bytes = 600;
  const auto clock = [] { return std::chrono::steady_clock::now(); };
  const auto seconds = [](auto from, auto to) { return std::chrono::duration<double>(to - from).count(); };
  const auto start = clock();
  Model model(0.05 * size, 2);
  const ClumpTemplate sphere = make_clump(1, 1);
  for (int k = 0; k < edge * edge * edge; ++k)
    model.particles.add(sphere, size, density, 1.999 * size * Vec3(k % edge, k / edge % edge, k / (edge * edge)),
                        Quat::Identity());
  model.gravity = Vec3(0, 0, -9.81);
  const double mass = model.particles.mass(0), stiffness = model.material.normal_stiffness(size, size);
  Held boundary(0.1 * std::sqrt(mass / stiffness));
  const auto added = clock();
  cycle(model, boundary);
  const auto first = clock();
  for (int k = 0; k < 3; ++k) cycle(model, boundary);
  const auto end = clock();
  const double count = static_cast<double>(model.particles.body_count());
  const double particles = static_cast<double>(model.particles.memory()) / count,
               contacts = static_cast<double>(model.contacts.memory()) / count;
  rusage use{};
  getrusage(RUSAGE_SELF, &use);
  std::cout << "adding " << seconds(start, added) << " s, first step (lists) " << seconds(added, first) << " s, a step "
            << seconds(first, end) / 3 << " s, " << particles << " + " << contacts << " bytes a sphere, peak "
            << static_cast<double>(use.ru_maxrss) / 1024 << " MiB\n";
  CAPTURE(particles, contacts, model.pair_totals.active);
  CHECK(model.pair_totals.active == 3LL * edge * edge * (edge - 1));
  CHECK(particles + contacts < most_bytes);
  CHECK(is_finite(model.particles));
}
