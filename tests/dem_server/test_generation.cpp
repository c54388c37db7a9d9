#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "dem_server/generation.hpp"
#include "dem_server/measure.hpp"
#include "tests/dem_server/free_grains.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

CubeRequest small_request() {
  CubeRequest request;
  request.grains = 150;
  request.porosity = 0.43;
  return request;
}

const Cube& small_cube() {
  static const Cube made = make_cube(small_request());
  return made;
}

std::uint64_t hash_of(const Cube& cube) {
  Hash h;
  cube.particles.hash(h);
  h.add(cube.period);
  return h.value();
}

}  // namespace

TEST_CASE("a cube has the porosity, pressure and grain sizes asked for") {
  const Cube& cube = small_cube();
  const CubeRequest request = small_request();
  const Particles& grains = cube.particles;
  const double size_ratio = grains.largest_radius() / grains.smallest_radius();
  CAPTURE(cube.porosity - request.porosity, cube.pressure, cube.preparation_friction, cube.tries, cube.steps);
  CAPTURE(grains.mean_radius() / request.radius_mean - 1, size_ratio, cube.released_porosity, cube.released_pressure);
  CHECK(std::abs(cube.porosity - request.porosity) < 0.005);
  CHECK(cube.pressure == Approx(request.pressure).epsilon(0.011));
  CHECK(cube.released_pressure < 1.1 * request.released_pressure);
  CHECK(cube.released_pressure > 0);
  CHECK(cube.released_porosity - cube.porosity < 0.004);
  CHECK(std::abs(grains.mean_radius() / request.radius_mean - 1) < 1e-12);
  CHECK(size_ratio < request.radius_ratio * 1.0001);
  CHECK(size_ratio > 0.95 * request.radius_ratio);
  for (std::size_t b = 0; b < grains.body_count(); ++b)
    CHECK(Box{Vec3::Zero(), cube.period}.contains(grains.position(b)));
}

TEST_CASE("summed porosity is the porosity that sampling finds, overlap counted once") {
  const Cube& cube = small_cube();
  const Particles block = tile(cube, Vec3::Zero(), 3 * cube.period);
  const double sampled = porosity(block, Box{cube.period, 2 * cube.period}, 0.028 / 8);
  CAPTURE(sampled - cube.released_porosity);
  CHECK(std::abs(sampled - cube.released_porosity) < 0.004);
}

TEST_CASE("the same request gives the same bits and another seed another cube") {
  const std::uint64_t hash = hash_of(small_cube());
  CubeRequest request = small_request();
  CHECK(hash_of(make_cube(request)) == hash);
  ++request.seed;
  CHECK(hash_of(make_cube(request)) != hash);
}

// Two chunks of bodies for two threads: many short steps, which a busy machine makes slow.
TEST_CASE("the number of threads changes no bit of a cube", "[.threads]") {
  CubeRequest request = small_request();
  request.grains = 300;
  const std::uint64_t hash = hash_of(make_cube(request));
  for (request.threads = 2; request.threads <= 3; ++request.threads) CHECK(hash_of(make_cube(request)) == hash);
}

TEST_CASE("seeds of small cubes meet the porosity that they promise") {
  // Cubes of 60 to 250 grains come out up to 0.02 away from the table, and differently at each try: a search that only
  // turns the friction gave up on one seed in ten. These lie in the middle and near both ends of what 3 pebbles reach.
  struct Case {
    int grains;
    double porosity;
    int seeds;
  };
  double worst = 0;
  // At 0.43 the search begins with a friction of 0.39: a cube of one try with clearly less has been compacted.
  int tries = 0, cubes = 0, compacted = 0;
  for (const Case& c : {Case{60, 0.43, 10}, Case{150, 0.345, 1}, Case{150, 0.45, 2}, Case{250, 0.40, 1}})
    for (int seed = 1; seed <= c.seeds; ++seed, ++cubes) {
      CubeRequest request;
      request.grains = c.grains, request.porosity = c.porosity, request.seed = static_cast<std::uint64_t>(seed);
      const Cube cube = make_cube(request);
      CAPTURE(c.grains, c.porosity, seed, cube.porosity, cube.tries, cube.preparation_friction);
      CHECK(std::abs(cube.porosity - c.porosity) < 0.005);
      CHECK(cube.pressure == Approx(request.pressure).epsilon(0.011));
      worst = std::max(worst, std::abs(cube.porosity - c.porosity));
      tries += cube.tries;
      compacted += c.porosity == 0.43 && cube.tries == 1 && cube.preparation_friction < 0.37;
    }
  CAPTURE(worst, tries, cubes, compacted);
  CHECK(compacted > 0);
  CHECK(tries < 6 * cubes);
}

TEST_CASE("every number of pebbles packs, and its range lies between those of its neighbours") {
  for (int pebbles = 1; pebbles <= 9; ++pebbles) {
    CubeRequest request;
    request.grains = 60, request.pebbles = pebbles, request.porosity = 0.42;
    const Cube cube = make_cube(request);
    CAPTURE(pebbles, cube.porosity, cube.preparation_friction, cube.tries);
    CHECK(std::abs(cube.porosity - 0.42) < 0.005);
    const auto in_a_clump = cube.particles.pebble_end(0) - cube.particles.pebble_begin(0);
    CHECK(in_a_clump == pebbles);
  }
  const auto low = [](int pebbles) { return reachable_porosity(pebbles, 1.5).low; };
  CHECK(low(4) == Approx(0.5 * (low(3) + low(5))).epsilon(1e-12));
  CHECK(low(6) == Approx(0.75 * low(5) + 0.25 * low(9)).epsilon(1e-12));
}

TEST_CASE("a porosity out of reach is refused at once, with key, value, range and remedy") {
  CubeRequest request;
  request.pebbles = 1;
  request.porosity = 0.30;
  bool is_started = false;
  request.progress = [&](std::string_view, double) { is_started = true; };
  CHECK_THROWS_AS(make_cube(request), InputError);
  CHECK_THROWS_WITH(make_cube(request), Catch::Contains("grains.packing.porosity = 0.3") && Catch::Contains("reach") &&
                                            Catch::Contains("clumps"));
  CHECK(!is_started);
  request.porosity = 0.5;
  CHECK_THROWS_AS(make_cube(request), InputError);
  const PorosityRange spheres = reachable_porosity(1, 1), clumps = reachable_porosity(3, 1.5);
  CHECK(clumps.low < spheres.low);
  CHECK(reachable_porosity(3, 1.0).low == spheres.low);
}

TEST_CASE("tiles fill a box with copies that fit together") {
  const Cube& cube = small_cube();
  const Vec3 low(-0.5, 0.2, 1), high = low + Vec3(2.5, 2, 1.2).cwiseProduct(cube.period);
  const Particles filled = tile(cube, low, high);
  // Solid volume per box volume is the cube's, up to grains cut at the faces.
  const double n = 1 - solid_volume(filled) / (high - low).prod();
  CAPTURE(n - cube.released_porosity, filled.body_count());
  CHECK(std::abs(n - cube.released_porosity) < 0.03);
  const Particles whole = tile(cube, low, low + 2 * cube.period);
  CHECK(whole.body_count() == 8 * cube.particles.body_count());
  // No overlap at the seams larger than in the periodic cube itself.
  PairContacts contacts(0.0015);
  Particles copy = whole;
  contacts.update(copy);
  const ContactTotals totals = contacts.compute(copy, GrainMaterial{}, 1e-6);
  PairContacts inner(0.0015, cube.period);
  Particles alone = cube.particles;
  inner.update(alone);
  const ContactTotals reference = inner.compute(alone, GrainMaterial{}, 1e-6);
  CAPTURE(totals.largest_overlap_ratio, reference.largest_overlap_ratio, totals.active, reference.active);
  CHECK(totals.largest_overlap_ratio < 1.001 * reference.largest_overlap_ratio + 1e-9);
  CHECK(totals.active > 6 * reference.active);
}
