#include "dem_server/particles.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <numeric>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "dem_server/clumps.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

using Indices = std::vector<std::int32_t>;

// A clump, a sphere, a clump.
Particles three_bodies() {
  Particles p;
  p.add(make_clump(3, 1.5), 0.03, 2650, Vec3(0.1, 0.2, 0.3), Quat(Eigen::AngleAxisd(pi / 2, Vec3::UnitZ())));
  p.add(make_clump(1, 1), 0.02, 2000, Vec3(1, 0, 0), Quat::Identity());
  p.add(make_clump(5, 1.2), 0.025, 2650, Vec3(0, 1, 0), Quat(0.5, 0.5, 0.5, 0.5));
  return p;
}

// Bodies of the pebble counts asked for, each with a place, a size, a motion and loads of its own.
Particles crowd(const std::vector<int>& pebbles, std::uint64_t seed = 1) {
  Random random(seed);
  const auto any = [&] { return Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)); };
  Particles p;
  for (const int count : pebbles) {
    const double radius = random.uniform(0.02, 0.03), density = random.uniform(2000, 3000);
    const Vec3 center = any();
    const std::int32_t b = p.add(make_clump(count, 1.5), radius, density, center, random.rotation());
    p.velocity(b) = any(), p.spin(b) = any();
    const Vec3 force = any(), torque = any();
    p.set_loads(b, force, torque);
  }
  return p;
}

const std::vector<int> spheres = {1, 1, 1, 1, 1}, clumps = {3, 5, 2, 3, 9}, mixed = {1, 3, 1, 5, 1, 2};

Indices pebble_begins(const Particles& p) {
  Indices begins;
  for (std::size_t b = 0; b <= p.body_count(); ++b) begins.push_back(p.pebble_begin(b));
  return begins;
}

Indices pebble_bodies(const Particles& p) {
  Indices bodies;
  for (std::size_t k = 0; k < p.pebble_count(); ++k) bodies.push_back(p.pebble_body(k));
  return bodies;
}

std::uint64_t hash_of(const Particles& p) {
  Hash h;
  p.hash(h);
  return h.value();
}

Vec3 sphere_moments(const Particles& p, std::size_t b) {
  return Vec3::Constant(p.mass(b) * (p.equivalent_radius(b) * p.equivalent_radius(b)) * 0.4);
}

// Body a of p is body b of q moved by `shift`, to the bit, with its pebbles; loads apart.
void check_same_body(const Particles& p, std::size_t a, const Particles& q, std::size_t b,
                     const Vec3& shift = Vec3::Zero()) {
  CAPTURE(a, b);
  CHECK(p.position(a) == q.position(b) + shift);
  CHECK(p.equivalent_radius(a) == q.equivalent_radius(b));
  CHECK(p.velocity(a) == q.velocity(b));
  CHECK(p.spin(a) == q.spin(b));
  CHECK(p.mass(a) == q.mass(b));
  CHECK(p.inertia(a) == q.inertia(b));
  CHECK(p.orientation(a).coeffs() == q.orientation(b).coeffs());
  const std::int32_t count = p.pebble_end(a) - p.pebble_begin(a);
  REQUIRE(count == q.pebble_end(b) - q.pebble_begin(b));
  for (std::int32_t k = 0; k < count; ++k) {
    const std::size_t i = p.pebble_begin(a) + k, j = q.pebble_begin(b) + k;
    CHECK(p.pebble_body(i) == static_cast<std::int32_t>(a));
    CHECK(p.pebble_center(i) == q.pebble_center(j) + shift);
    CHECK(p.pebble_radius(i) == q.pebble_radius(j));
    CHECK(p.pebble_offset(i) == q.pebble_offset(j));
  }
}

// List entries that only fill up a block point behind the last pebble and so behind the last body: what stands there
// must touch nothing and its body must be the one behind the last.
void check_end(const Particles& p) {
  const SphereRecord body = p.bodies()[p.body_count()], pebble = p.pebbles()[p.pebble_count()];
  CHECK(body.radius == 0);
  CHECK(body.x > 1e100);
  CHECK(pebble.radius == 0);
  CHECK(pebble.x > 1e100);
  CHECK(p.motion()[p.body_count()].mass == 1);  // some divide by it
  CHECK(p.motion()[p.body_count()].radius == 0);
  CHECK(p.pebble_begin(p.body_count()) == static_cast<std::int32_t>(p.pebble_count()));
  CHECK(p.pebble_body(p.pebble_count()) == static_cast<std::int32_t>(p.body_count()));
}

bool is_aligned(const void* record, std::size_t bytes) { return reinterpret_cast<std::uintptr_t>(record) % bytes == 0; }

}  // namespace

TEST_CASE("a clump weighs what its equivalent sphere weighs") {
  const Particles p = three_bodies();
  CHECK(p.mass(0) == Approx(2650 * 4.0 / 3.0 * pi * 0.03 * 0.03 * 0.03).epsilon(1e-15));
  CHECK(p.inertia(1).x() == Approx(0.4 * p.mass(1) * 0.02 * 0.02).epsilon(1e-15));
  CHECK(p.pebble_count() == 9);
  CHECK(pebble_begins(p) == Indices{0, 3, 4, 9});
}

TEST_CASE("pebbles stand where the attitude puts them") {
  // A quarter turn about z takes the row's axis from x to y.
  Particles p = three_bodies();
  const Vec3 end = p.pebble_center(2) - p.position(0);
  CHECK(std::abs(end.x()) < 1e-17);
  CHECK(end.y() == Approx(p.pebble_offset(2).x()).epsilon(1e-14));
  CHECK(p.pebble_center(3) == p.position(1));
  // And follow when it is set: a quarter turn about y takes x to -z.
  p.set_orientation(0, Quat(Eigen::AngleAxisd(pi / 2, Vec3::UnitY())));
  p.place_pebbles(0);
  CHECK((p.pebble_center(2) - p.position(0) + p.pebble_offset(2).x() * Vec3::UnitZ()).norm() < 1e-16);
}

TEST_CASE("a crowd of spheres keeps nothing but its bodies, which are its pebbles") {
  Particles p = crowd(spheres);
  CHECK(!p.has_clumps());
  CHECK(p.pebble_count() == 5);
  CHECK(p.pebbles() == p.bodies());
  CHECK(p.attitudes() == nullptr);
  CHECK(p.shape_numbers() == nullptr);
  CHECK(p.shape(3).is_sphere());
  CHECK(pebble_begins(p) == Indices{0, 1, 2, 3, 4, 5});
  CHECK(pebble_bodies(p) == Indices{0, 1, 2, 3, 4});
  for (std::size_t b = 0; b < 5; ++b) {
    CHECK(p.pebble_center(b) == p.position(b));
    CHECK(p.pebble_radius(b) == p.equivalent_radius(b));
    CHECK(p.pebble_offset(b) == Vec3::Zero());
    CHECK(p.inertia(b) == sphere_moments(p, b));
  }
  check_end(p);
  // It has no attitude to set, and a pebble moves with its body without being placed.
  const std::uint64_t before = hash_of(p);
  p.set_orientation(2, Quat(0, 1, 0, 0));
  CHECK(p.orientation(2).coeffs() == Quat::Identity().coeffs());
  CHECK(hash_of(p) == before);
  p.position(2) += Vec3(0, 0, 1);
  CHECK(p.pebble_center(2) == p.position(2));
}

TEST_CASE("one pebble is a sphere only at the centre and with three equal moments") {
  ClumpTemplate shape = make_clump(1, 1);
  CHECK(shape.is_sphere());
  for (const Vec3& moments : {Vec3(0.3, 0.4, 0.4), Vec3(0.4, 0.3, 0.4), Vec3(0.4, 0.4, 0.3)}) {
    shape.inertia_per_mass = moments;
    CHECK(!shape.is_sphere());
  }
  Particles p;
  p.add(shape, 0.03, 2650, Vec3::Zero(), Quat(0.5, 0.5, 0.5, 0.5));
  CHECK(p.has_clumps());
  CHECK((p.inertia(0) - p.mass(0) * 0.03 * 0.03 * shape.inertia_per_mass).norm() <= 1e-15 * p.inertia(0).norm());
  CHECK(p.orientation(0).coeffs() == Quat(0.5, 0.5, 0.5, 0.5).coeffs());
  shape = make_clump(1, 1);
  shape.pebble_center[0] = Vec3(0, 1e-9, 0);
  CHECK(!shape.is_sphere());
  CHECK(!make_clump(2, 1.5).is_sphere());
}

TEST_CASE("the first clump brings pebbles and attitudes to the spheres before it, and changes nothing of them") {
  const Particles before = crowd(spheres);
  Particles p = before;
  p.add(make_clump(3, 1.5), 0.03, 2650, Vec3(0.1, 0.2, 0.3), Quat(0.5, 0.5, 0.5, 0.5));
  CHECK(p.has_clumps());
  CHECK(p.pebbles() != p.bodies());
  CHECK(pebble_begins(p) == Indices{0, 1, 2, 3, 4, 5, 8});
  CHECK(pebble_bodies(p) == Indices{0, 1, 2, 3, 4, 5, 5, 5});
  for (std::size_t b = 0; b < 5; ++b) {
    check_same_body(p, b, before, b);
    CHECK(p.force(b) == before.force(b));
    CHECK(p.torque(b) == before.torque(b));
  }
  // The new one is the same as in a crowd that had clumps before.
  Particles alone;
  alone.add(make_clump(3, 1.5), 0.03, 2650, Vec3(0.1, 0.2, 0.3), Quat(0.5, 0.5, 0.5, 0.5));
  check_same_body(p, 5, alone, 0);
  check_end(p);
  // Placing and scaling finds the spheres' pebbles as it finds the clump's.
  Particles grown = p;
  grown.place_pebbles();
  for (std::size_t b = 0; b < 5; ++b) check_same_body(grown, b, before, b);
  grown.scale_all(1.1);
  for (std::size_t b = 0; b < 5; ++b) CHECK(grown.pebble_radius(b) == grown.equivalent_radius(b));
  // A sphere that comes later is one as well; shapes tell it from the clump.
  const std::int32_t last = p.add(make_clump(1, 1), 0.02, 2000, Vec3(1, 0, 0), Quat(0.5, 0.5, 0.5, 0.5));
  CHECK((p.inertia(last) - sphere_moments(p, last)).norm() <= 1e-15 * p.inertia(last).norm());
  CHECK(p.pebble_center(8) == p.position(last));
  std::vector<double> kinds;
  for (std::size_t b = 0; b < p.body_count(); ++b) kinds.push_back(p.shapes().records()[p.shape_numbers()[b]].is_clump);
  CHECK(kinds == std::vector<double>{0, 0, 0, 0, 0, 1, 0});
  CHECK(p.shapes().size() == 2);
  check_end(p);
}

TEST_CASE("records stand in cache lines of their own") {
  Particles p;
  for (const int pebbles : mixed) {
    p.add(make_clump(pebbles, 1.5), 0.03, 2650, Vec3::Zero(), Quat::Identity());
    CHECK(is_aligned(p.bodies(), 32));
    CHECK(is_aligned(p.pebbles(), 32));
    CHECK(is_aligned(p.attitudes(), 32));
    CHECK(is_aligned(p.shapes().records(), 64));
    CHECK(is_aligned(p.shapes().pebbles(), 32));
    CHECK(is_aligned(p.motion(), 64));
    CHECK(is_aligned(p.loads(), 64));
  }
  CHECK(sizeof(SphereRecord) == 32);
  CHECK(sizeof(MotionRecord) == 64);
  CHECK(sizeof(LoadRecord) == 64);
  CHECK(sizeof(AttitudeRecord) == 32);
}

TEST_CASE("spheres pay for no attitudes and no pebbles") {
  // Bytes a sphere: 32 of place, 64 of motion, 64 of loads. A clump of n: 32 of attitude, 4 of its first pebble and 4 of
  // its shape's number more, and 32 + 4 a pebble. Room that is taken ahead at most doubles them; two records behind the last are in
  // the slack.
  const int count = 1000;
  for (const int pebbles : {1, 3, 9}) {
    const double each = pebbles == 1 ? 160.0 : 160.0 + 40 + 36 * pebbles;
    const Particles p = crowd(std::vector<int>(count, pebbles));
    const double share = static_cast<double>(p.memory()) / (each * count);
    CAPTURE(pebbles, p.memory(), share);
    CHECK(share >= 1);
    CHECK(share < 2.01);
    Particles tight = p;
    tight.keep_only(std::vector<char>(count, 1));
    CAPTURE(tight.memory());
    if (pebbles == 1) CHECK(tight.memory() == 160 * (count + 1));
  }
}

TEST_CASE("a copy is the body itself, moved and without loads, among spheres and clumps alike") {
  const Vec3 shift(0.5, -2, 4);
  for (const auto& from_shapes : {spheres, clumps, mixed})
    for (const auto& to_shapes : {spheres, clumps, mixed, std::vector<int>{}}) {
      const Particles from = crowd(from_shapes, 1), before = crowd(to_shapes, 2);
      Particles to = before;
      for (std::size_t b = 0; b < from.body_count(); ++b) to.append_copy(from, b, shift);
      CAPTURE(from_shapes.size(), to_shapes.size());
      REQUIRE(to.body_count() == before.body_count() + from.body_count());
      CHECK(to.has_clumps() == (from.has_clumps() || before.has_clumps()));
      for (std::size_t b = 0; b < before.body_count(); ++b) check_same_body(to, b, before, b);
      for (std::size_t b = 0; b < from.body_count(); ++b) {
        check_same_body(to, before.body_count() + b, from, b, shift);
        CHECK(std::as_const(to).force(before.body_count() + b) == Vec3::Zero());
        CHECK(std::as_const(to).torque(before.body_count() + b) == Vec3::Zero());
      }
      check_end(to);
      if (!to.has_clumps()) continue;
      for (std::size_t b = 0; b < from.body_count(); ++b)
        CHECK(to.shape(before.body_count() + b).is_sphere() == (from_shapes[b] == 1));
    }
}

TEST_CASE("copies are bodies of their own: placing their pebbles leaves them where they are") {
  // Copied centres are shifted, placed ones are made from pose and shape: equal to round-off of the coordinates.
  Particles to;
  const Particles from = crowd(mixed);
  for (std::size_t b = 0; b < from.body_count(); ++b) to.append_copy(from, b, Vec3(1, 1, 1));
  const Particles copied = to;
  to.place_pebbles();
  double worst = 0;
  for (std::size_t k = 0; k < to.pebble_count(); ++k)
    worst = std::max({worst, (to.pebble_center(k) - copied.pebble_center(k)).norm(),
                      std::abs(to.pebble_radius(k) - copied.pebble_radius(k))});
  CAPTURE(worst);
  CHECK(worst < 1e-15);
  to.position(1) = Vec3::Zero();
  CHECK(std::as_const(copied).position(1) != Vec3::Zero());
}

TEST_CASE("reordering puts body order[k] in place k with its pebbles, motion and loads, to the bit") {
  for (const auto& shapes : {spheres, clumps, mixed}) {
    const Particles before = crowd(shapes);
    const std::size_t count = before.body_count();
    Indices order(count);  // a rotation by two and a swap: not its own inverse
    for (std::size_t k = 0; k < count; ++k) order[k] = static_cast<std::int32_t>((k + 2) % count);
    std::swap(order[0], order[1]);
    Particles p = before;
    p.reorder(order);
    REQUIRE(p.body_count() == count);
    CHECK(p.pebble_count() == before.pebble_count());
    for (std::size_t k = 0; k < count; ++k) {
      check_same_body(p, k, before, order[k]);
      CHECK(std::as_const(p).force(k) == before.force(order[k]));
      CHECK(std::as_const(p).torque(k) == before.torque(order[k]));
    }
    check_end(p);
    CHECK(hash_of(p) != hash_of(before));
    Indices back(count);
    for (std::size_t k = 0; k < count; ++k) back[order[k]] = static_cast<std::int32_t>(k);
    p.reorder(back);
    CHECK(hash_of(p) == hash_of(before));
  }
}

TEST_CASE("scaling a body keeps its density and shape") {
  Particles p = three_bodies();
  const Particles before = p;
  p.scale(0, 1.1);
  CHECK(p.mass(0) == Approx(before.mass(0) * std::pow(1.1, 3)).epsilon(1e-14));
  CHECK(p.inertia(0).y() == Approx(before.inertia(0).y() * std::pow(1.1, 5)).epsilon(1e-14));
  CHECK(p.pebble_radius(1) == Approx(before.pebble_radius(1) * 1.1).epsilon(1e-14));
  CHECK((p.pebble_center(0) - p.position(0)).norm() == Approx(1.1 * before.pebble_offset(0).norm()).epsilon(1e-14));
  CHECK(p.mass(1) == before.mass(1));
  CHECK(p.motion()[0].radius == p.bodies()[0].radius);
}

TEST_CASE("scaling all scales each, and growth is what the largest pebble has gained") {
  for (const auto& shapes : {spheres, clumps, mixed}) {
    const Particles before = crowd(shapes);
    Particles p = before, singly = before;
    double largest = 0;
    for (std::size_t k = 0; k < p.pebble_count(); ++k) largest = std::max(largest, p.pebble_radius(k));
    CHECK(p.growth() == 0);
    p.scale_all(1.1);
    for (std::size_t b = 0; b < p.body_count(); ++b) {
      singly.scale(b, 1.1);
      CHECK(p.mass(b) == Approx(before.mass(b) * std::pow(1.1, 3)).epsilon(1e-14));
      CHECK(p.inertia(b).z() == Approx(before.inertia(b).z() * std::pow(1.1, 5)).epsilon(1e-14));
      CHECK(std::as_const(p).position(b) == before.position(b));
    }
    CHECK(hash_of(p) == hash_of(singly));
    // (1.1 - 1) R, then (1.2 - 1) 1.1 R: (1.1 * 1.2 - 1) R in all. Shrinking in between takes nothing back.
    p.scale_all(1.2);
    const double error = p.growth() / (0.32 * largest) - 1;
    CAPTURE(error);
    CHECK(std::abs(error) < 1e-14);
    double most = 0;
    for (std::size_t k = 0; k < p.pebble_count(); ++k)
      most = std::max(most, p.pebble_radius(k) - before.pebble_radius(k));
    CHECK(most == Approx(p.growth()).epsilon(1e-13));
    const double grown = p.growth();
    p.scale_all(0.5);
    CHECK(p.growth() == grown);
    p.scale_all(2);
    CHECK(p.growth() == Approx(grown + 0.66 * largest).epsilon(1e-13));
  }
}

TEST_CASE("a change of density scales mass and moments and no length") {
  for (const auto& shapes : {spheres, mixed}) {
    const Particles before = crowd(shapes);
    Particles p = before;
    p.scale_mass(3, 4);
    CHECK(p.mass(3) == 4 * before.mass(3));
    CHECK((p.inertia(3) - 4 * before.inertia(3)).norm() <= 1e-15 * p.inertia(3).norm());
    CHECK(p.equivalent_radius(3) == before.equivalent_radius(3));
    CHECK(p.pebble_radius(p.pebble_begin(3)) == before.pebble_radius(before.pebble_begin(3)));
    check_same_body(p, 2, before, 2);
    check_same_body(p, 4, before, 4);
  }
}

TEST_CASE("dropping a body renumbers the pebbles of those behind it and keeps the rest to the bit") {
  Particles p = three_bodies();
  const Particles before = p;
  p.keep_only({1, 0, 1});
  REQUIRE(p.body_count() == 2);
  CHECK(pebble_begins(p) == Indices{0, 3, 8});
  CHECK(pebble_bodies(p) == Indices{0, 0, 0, 1, 1, 1, 1, 1});
  check_same_body(p, 0, before, 0);
  check_same_body(p, 1, before, 2);
  check_end(p);
  p.keep_only({0, 0});
  CHECK(p.body_count() == 0);
  CHECK(p.pebble_count() == 0);
  check_end(p);
  CHECK_THROWS_AS(p.keep_only({1}), InternalError);
}

TEST_CASE("spheres that are left of a mixed crowd are what they were, and bodies can be added to what is left") {
  for (const auto& shapes : {spheres, mixed}) {
    const Particles before = crowd(shapes);
    Particles p = before;
    std::vector<char> keep(before.body_count(), 0);
    keep[0] = keep[2] = keep[4] = 1;  // spheres in either crowd
    p.keep_only(keep);
    REQUIRE(p.body_count() == 3);
    CHECK(p.pebble_count() == 3);
    for (std::size_t b = 0; b < 3; ++b) {
      check_same_body(p, b, before, 2 * b);
      CHECK(std::as_const(p).force(b) == before.force(2 * b));
    }
    p.keep_only({0, 0, 0});
    p.add(make_clump(5, 1.2), 0.025, 2650, Vec3(0, 1, 0), Quat(0.5, 0.5, 0.5, 0.5));
    check_same_body(p, 0, three_bodies(), 2);
    check_end(p);
  }
}

TEST_CASE("sizes and masses of a crowd are those of its extreme bodies; of none they are zero") {
  const Particles p = three_bodies(), none;
  CHECK(p.smallest_radius() == 0.02);
  CHECK(p.largest_radius() == 0.03);
  CHECK(p.mean_radius() == Approx(0.025).epsilon(1e-15));
  CHECK(p.lightest() == p.mass(1));
  CHECK(p.total_mass() == Approx(p.mass(0) + p.mass(1) + p.mass(2)).epsilon(1e-15));
  CHECK(none.smallest_radius() == 0);
  CHECK(none.largest_radius() == 0);
  CHECK(none.mean_radius() == 0);
  CHECK(none.lightest() == 0);
  CHECK(none.total_mass() == 0);
  CHECK(none.pebble_count() == 0);
  check_end(none);
}

TEST_CASE("a force off the centre is a force and its moment, until the loads are cleared") {
  Particles p = three_bodies();
  p.add_force(1, Vec3(1, 0.01, 0), Vec3(5, 0, 0));
  CHECK(p.force(1) == Vec3(5, 0, 0));
  CHECK((p.torque(1) - Vec3(0, 0, -0.05)).norm() < 1e-16);
  p.spin(1) = Vec3(0, 0, 2);
  p.velocity(1) = Vec3(0, 1, 0);
  CHECK((p.velocity_at(1, Vec3(1.5, 0, 0)) - Vec3(0, 2, 0)).norm() < 1e-15);
  p.clear_forces();
  CHECK(p.force(1) == Vec3::Zero());
  CHECK(p.torque(1) == Vec3::Zero());
}

TEST_CASE("the hash sees one bit of one number of each kind") {
  for (const auto& shapes : {spheres, mixed}) {
    const Particles before = crowd(shapes);
    const std::uint64_t base = hash_of(before);
    const auto next = [](double& x) { x = std::nextafter(x, 1e9); };
    const auto changed = [&](const auto& change) {
      Particles p = before;
      change(p);
      return hash_of(p) != base;
    };
    CHECK(!changed([](Particles&) {}));
    CHECK(changed([&](Particles& p) { next(p.position(2).y()); }));
    CHECK(changed([&](Particles& p) { next(p.velocity(0).x()); }));
    CHECK(changed([&](Particles& p) { next(p.spin(4).z()); }));
    CHECK(changed([&](Particles& p) { next(p.bodies()[1].radius); }));
    CHECK(changed([&](Particles& p) { next(p.motion()[1].mass); }));
    if (!before.has_clumps()) continue;
    CHECK(changed([&](Particles& p) { next(p.attitudes()[3].qw); }));
    CHECK(changed([&](Particles& p) { next(p.attitudes()[3].qz); }));
    CHECK(changed([&](Particles& p) { p = crowd({1, 3, 1, 4, 1, 2}); }));  // one body of another shape
    CHECK(changed([&](Particles& p) { next(p.pebbles()[p.pebble_begin(3) + 1].radius); }));
    CHECK(changed([&](Particles& p) { next(p.pebbles()[p.pebble_begin(3) + 1].z); }));
  }
}
