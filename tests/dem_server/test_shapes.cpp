// The table of shapes: each once, whoever brings it, and what kernels read of it.
#include "dem_server/shapes.hpp"

#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "dem_server/clumps.hpp"

using namespace lockstep;
using namespace lockstep::dem;

TEST_CASE("A shape is kept once, and one that differs in a single number is another") {
  ShapeTable table;
  const ClumpTemplate clump = make_clump(3, 1.5);
  CHECK(table.number_of(clump) == 0);
  CHECK(table.number_of(make_clump(1, 1)) == 1);
  CHECK(table.number_of(make_clump(5, 1.5)) == 2);
  CHECK(table.number_of(make_clump(3, 1.5)) == 0);
  ClumpTemplate other = clump;
  other.pebble_center[2].z() += 1e-9;
  CHECK(table.number_of(other) == 3);
  other = clump;
  other.pebble_radius[1] += 1e-9;
  CHECK(table.number_of(other) == 4);
  other = clump;
  other.inertia_per_mass.y() += 1e-9;
  CHECK(table.number_of(other) == 5);
  CHECK(table.size() == 6);
  CHECK(table[2].pebble_center.size() == 5);
  CHECK_THROWS_AS(table.number_of(ClumpTemplate{}), InternalError);  // neither pebbles nor moments
}

TEST_CASE("Records of shapes: moments and their inverses, the farthest pebble, the place of the pebbles among all") {
  ShapeTable table;
  const ClumpTemplate clump = make_clump(3, 1.5);
  table.number_of(make_clump(1, 1));
  table.number_of(clump);
  const ShapeRecord sphere = table.records()[0], record = table.records()[1];
  CHECK(sphere.is_clump == 0);
  CHECK(sphere.farthest_square == 0);
  CHECK(sphere.i2 == 0.4);
  CHECK(record.is_clump == 1);
  CHECK(record.first_pebble == 1);
  CHECK(record.pebbles == 3);
  CHECK(Vec3(record.i1, record.i2, record.i3) == clump.inertia_per_mass);
  CHECK(record.over_i1 * record.i1 == Approx(1).epsilon(1e-15));
  CHECK(record.over_i3 * record.i3 == Approx(1).epsilon(1e-15));
  CHECK(record.farthest_square == clump.pebble_center[0].squaredNorm());
  CHECK(table.pebbles()[3].x == clump.pebble_center[2].x());
  CHECK(table.pebbles()[3].radius == clump.pebble_radius[2]);
}

TEST_CASE("Shapes are rows until one has a pebble off the first axis") {
  ShapeTable table;
  CHECK(table.are_rows());
  for (const int pebbles : {1, 2, 9}) table.number_of(make_clump(pebbles, 1.5));
  CHECK(table.are_rows());
  ClumpTemplate bent = make_clump(3, 1.5);
  bent.pebble_center[0].y() = 0.1;
  table.number_of(bent);
  CHECK(!table.are_rows());
}
