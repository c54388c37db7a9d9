#include <catch2/catch.hpp>

#include "dem_server/clumps.hpp"
#include "dem_server/particles.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

Particles three_bodies() {
  Particles p;
  p.add(make_clump(3, 1.5), 0.03, 2650, Vec3(0.1, 0.2, 0.3), Quat(Eigen::AngleAxisd(pi / 2, Vec3::UnitZ())));
  p.add(make_clump(1, 1), 0.02, 2000, Vec3(1, 0, 0), Quat::Identity());
  p.add(make_clump(5, 1.2), 0.025, 2650, Vec3(0, 1, 0), Quat(0.5, 0.5, 0.5, 0.5));
  return p;
}

}  // namespace

TEST_CASE("a clump weighs what its equivalent sphere weighs") {
  const Particles p = three_bodies();
  CHECK(p.mass[0] == Approx(2650 * 4.0 / 3.0 * pi * 0.03 * 0.03 * 0.03).epsilon(1e-15));
  CHECK(p.inertia[1].x() == Approx(0.4 * p.mass[1] * 0.02 * 0.02).epsilon(1e-15));
  CHECK(p.pebble_count() == 9);
  CHECK(p.pebble_begin == std::vector<std::int32_t>{0, 3, 4, 9});
}

TEST_CASE("pebbles stand where the attitude puts them") {
  // A quarter turn about z takes the row's axis from x to y.
  const Particles p = three_bodies();
  const Vec3 end = p.pebble_center[2] - p.position[0];
  CHECK(std::abs(end.x()) < 1e-17);
  CHECK(end.y() == Approx(p.pebble_offset[2].x()).epsilon(1e-14));
  CHECK(p.pebble_center[3] == p.position[1]);
}

TEST_CASE("scaling a body keeps its density and shape") {
  Particles p = three_bodies();
  const Particles before = p;
  p.scale(0, 1.1);
  CHECK(p.mass[0] == Approx(before.mass[0] * std::pow(1.1, 3)).epsilon(1e-14));
  CHECK(p.inertia[0].y() == Approx(before.inertia[0].y() * std::pow(1.1, 5)).epsilon(1e-14));
  CHECK(p.pebble_radius[1] == Approx(before.pebble_radius[1] * 1.1).epsilon(1e-14));
  CHECK((p.pebble_center[0] - p.position[0]).norm() == Approx(1.1 * before.pebble_offset[0].norm()).epsilon(1e-14));
  CHECK(p.mass[1] == before.mass[1]);
}

TEST_CASE("dropping a body renumbers the pebbles of those behind it and keeps the rest to the bit") {
  Particles p = three_bodies();
  const Particles before = p;
  p.keep_only({1, 0, 1});
  REQUIRE(p.body_count() == 2);
  CHECK(p.pebble_begin == std::vector<std::int32_t>{0, 3, 8});
  CHECK(p.pebble_body == std::vector<std::int32_t>{0, 0, 0, 1, 1, 1, 1, 1});
  CHECK(p.position[1] == before.position[2]);
  CHECK(p.mass[1] == before.mass[2]);
  for (int k = 0; k < 5; ++k) {
    CHECK(p.pebble_center[3 + k] == before.pebble_center[4 + k]);
    CHECK(p.pebble_radius[3 + k] == before.pebble_radius[4 + k]);
  }
  p.keep_only({0, 0});
  CHECK(p.body_count() == 0);
  CHECK(p.pebble_count() == 0);
}

TEST_CASE("a force off the centre is a force and its moment") {
  Particles p = three_bodies();
  p.add_force(1, Vec3(1, 0.01, 0), Vec3(5, 0, 0));
  CHECK(p.force[1] == Vec3(5, 0, 0));
  CHECK((p.torque[1] - Vec3(0, 0, -0.05)).norm() < 1e-16);
  p.spin[1] = Vec3(0, 0, 2);
  p.velocity[1] = Vec3(0, 1, 0);
  CHECK((p.velocity_at(1, Vec3(1.5, 0, 0)) - Vec3(0, 2, 0)).norm() < 1e-15);
}

TEST_CASE("the hash sees one bit of one coordinate") {
  Particles p = three_bodies();
  Hash before, after;
  p.hash(before);
  p.position[2].y() = std::nextafter(p.position[2].y(), 2.0);
  p.hash(after);
  CHECK(before.value() != after.value());
}
