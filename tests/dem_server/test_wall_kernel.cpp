// Contacts with walls eight at a time against contact_force() and the shapes' closest(), contact by contact: what both say
// is the same arithmetic in the same order, so bits must agree, for every instruction set and whatever contacts fall
// together.
#include <algorithm>
#include <catch2/catch.hpp>

#include "common/random.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/wall_contacts.hpp"
#include "dem_server/wall_shapes.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

constexpr double time_step = 1e-5;  // [s]

Vec3 any_vector(Random& random, double size) {
  return {random.uniform(-size, size), random.uniform(-size, size), random.uniform(-size, size)};
}

// A crowd of bodies with one pebble each: spheres, or clumps whose pebbles are `lever` off their centres.
struct Crowd {
  std::vector<SphereRecord> pebbles;
  std::vector<MotionRecord> motion;
  std::vector<TwistRecord> twists;  // of clumps
  std::vector<LoadRecord> loads;

  Crowd(Random& random, std::size_t count, double lever) {
    loads.resize(count);
    for (std::size_t b = 0; b < count; ++b) {
      const Vec3 x = any_vector(random, 1), c = x + any_vector(random, lever);
      const Vec3 v = any_vector(random, 1), w = any_vector(random, 20);
      const double radius = random.uniform(0.02, 0.03), mass = random.uniform(0.1, 0.2);
      pebbles.push_back({x.x(), x.y(), x.z(), radius});
      motion.push_back({v.x(), v.y(), v.z(), lever > 0 ? 1.3 * radius : radius, w.x(), w.y(), w.z(), mass});
      const Vec3 at_origin = v - w.cross(c);
      if (lever > 0)
        twists.push_back({at_origin.x(), at_origin.y(), at_origin.z(), mass, w.x(), w.y(), w.z(), 1.3 * radius});
    }
  }
  GrainRecords records() {
    return {pebbles.data(), motion.data(), twists.empty() ? nullptr : twists.data(), loads.data()};
  }
};

struct Case {
  double lever, damping_ratio;
  bool has_surface;
};

Vec3 first(const double& x) { return Vec3(&x); }

}  // namespace

TEST_CASE("Contacts with walls in lanes have the bits of the law, one by one") {
  for (const InstructionSet set : known_instructions())
    for (const Case c : {Case{0, 0, false}, Case{0, 0.3, true}, Case{0.01, 0, true}, Case{0.01, 0.3, false}})
      for (const int count : {1, 7, 8, 21}) {
        CAPTURE(name_of(set), c.lever, c.damping_ratio, c.has_surface, count);
        Random random(17);
        const WallKernels kernels = wall_kernels(set);
        Crowd crowd(random, 9, c.lever);  // fewer than contacts: some bodies have several
        const GrainRecords g = crowd.records();
        const WallLaw law{9e6, 8, 0.5, c.damping_ratio, time_step};
        const WallMotion motion{{0.3, -0.2, 0.1}, {0.3, 2, -1}, {0.1, 0.2, 0.3}};

        std::vector<WallTouch> touches(static_cast<std::size_t>(count + wall_block));
        std::vector<SurfaceVelocity> surface(touches.size());
        std::vector<WallSpring> last, springs(touches.size());
        std::vector<WallPress> presses(touches.size());
        for (int k = 0; k < count; ++k) {
          const Vec3 outward = any_vector(random, 1).normalized();
          const Vec3 own = any_vector(random, 0.5);
          WallTouch& t = touches[static_cast<std::size_t>(k)];
          t = {outward.x(), outward.y(), outward.z(), random.uniform(0, 1e-4), k % 9, k % 9, k % 3, -1};
          surface[static_cast<std::size_t>(k)] = {own.x(), own.y(), own.z(), 0};
          if (k % 4 == 3) continue;  // a new contact
          // That of the last step lay a little otherwise; limits of friction are 0 to 27 N, so some slide.
          const Vec3 normal = (any_vector(random, 1e-3) - outward).normalized();
          Vec3 spring = any_vector(random, 15);
          spring -= normal.dot(spring) * normal;
          t.heir_of = static_cast<std::int32_t>(last.size());
          last.push_back(
              {spring.x(), spring.y(), spring.z(), k % 9, k % 3, normal.x(), normal.y(), normal.z(), k % 9, 0});
        }
        kernels.press(g, law, motion, c.has_surface ? surface.data() : nullptr, touches.data(), count, last.data(),
                      springs.data(), presses.data());
        WallSums sums;
        const Vec3 center(0.1, 0.2, 0.3);
        kernels.add_up(presses.data(), count, center.data(), sums);

        std::vector<Vec3> force(9, Vec3::Zero()), moment(9, Vec3::Zero());
        Vec3 all_forces = Vec3::Zero(), all_moments = Vec3::Zero();
        double all_slip = 0, all_energy = 0;
        int sliding = 0;
        for (int k = 0; k < count; ++k) {
          CAPTURE(k);
          const WallTouch& t = touches[static_cast<std::size_t>(k)];
          const WallPress& press = presses[static_cast<std::size_t>(k)];
          const WallSpring& spring = springs[static_cast<std::size_t>(k)];
          const auto b = static_cast<std::size_t>(t.body);
          const SphereRecord& pebble = g.pebbles[b];
          const double radius = g.motion[b].radius;
          ContactMaterial m;
          m.normal_stiffness = law.contact_modulus * (radius + radius);
          m.shear_stiffness = m.normal_stiffness / law.stiffness_ratio;
          m.friction = law.friction;
          m.normal_dashpot = 2 * law.damping_ratio * std::sqrt(m.normal_stiffness * g.motion[b].mass);
          const Vec3 normal = -first(t.nx);
          const Vec3 point = first(pebble.x) + (pebble.radius - 0.5 * t.overlap) * normal;
          Vec3 of_wall = first(motion.velocity[0]) + first(motion.spin[0]).cross(point - first(motion.center[0]));
          if (c.has_surface) of_wall += first(surface[static_cast<std::size_t>(k)].x);
          const Vec3 spin = first(g.motion[b].wx);
          const Vec3 of_grain = g.twists ? first(g.twists[b].vx) + spin.cross(point)
                                         : first(g.motion[b].vx) + spin.cross(point - first(pebble.x));
          const Vec3 approach = of_wall - of_grain;
          ContactHistory history;
          if (t.heir_of >= 0) {
            const WallSpring& heir = last[static_cast<std::size_t>(t.heir_of)];
            history = {first(heir.sx), first(heir.nx)};
          }
          const ContactResult result = contact_force(m, normal, t.overlap, approach, time_step, history);

          CHECK(first(press.fx) == result.force_on_a);
          CHECK(press.normal_force == result.normal_force);
          CHECK(press.slip_work == result.slip_work);
          CHECK(press.dashpot_work == result.dashpot_power * time_step);
          CHECK(press.elastic_energy == contact_energy(m, t.overlap, history));
          CHECK(press.power == result.force_on_a.dot(of_wall));
          CHECK(first(press.x) == point);
          CHECK(press.overlap == t.overlap);
          CHECK(press.normal_stiffness == m.normal_stiffness);
          CHECK(press.shear_stiffness == m.shear_stiffness);
          CHECK(press.overlap_ratio == t.overlap / pebble.radius);
          CHECK(first(spring.sx) == history.spring);
          CHECK(first(spring.nx) == history.normal);
          CHECK((spring.pebble == t.pebble && spring.body == t.body && spring.part == t.part && press.part == t.part));
          force[b] += result.force_on_a;
          moment[b] += point.cross(result.force_on_a);
          all_forces += result.force_on_a;
          all_moments += (point - center).cross(result.force_on_a);
          all_slip += result.slip_work, all_energy += press.elastic_energy;
          sliding += result.slip_work > 0;
        }
        if (count == 21) CHECK((sliding > 2 && sliding < 19));
        for (std::size_t b = 0; b < 9; ++b) {
          CHECK(first(crowd.loads[b].fx) == force[b]);
          CHECK(first(crowd.loads[b].mx) == moment[b]);
        }
        CHECK(first(sums.fx) == all_forces);
        CHECK(first(sums.mx) == all_moments);
        CHECK(sums.slip_work == all_slip);
        CHECK(sums.elastic_energy == all_energy);
        CHECK(sums.contacts == count);
      }
}

// In a wall's own frame the kernel and the shape do the same; turned, a product of matrix and vector is added up in another
// order, so normals may differ by 2 units in the last place of 1 and distances by that of a coordinate, 4e-16 m.
TEST_CASE("Planes and cylinders in lanes are touched by those pebbles that their shapes say") {
  const PlaneShape plane{Vec3(0.1, -0.2, 0.1), Vec3(1, -2, 3).normalized()};
  const CylinderShape inside{Vec3(0.1, 0.1, 0), Vec3(0, 0, 1), 0.9, Side::Inside};
  const CylinderShape outside{Vec3(0, 0.1, 0.2), Vec3(1, 1, 0).normalized(), 0.4, Side::Outside};
  PlaneFace plane_face;
  const auto copy = [](const Vec3& v, double* to) { std::copy_n(v.data(), 3, to); };
  copy(plane.point, plane_face.point), copy(plane.normal, plane_face.normal);
  const auto face_of = [&](const CylinderShape& s) {
    CylinderFace face;
    copy(s.point, face.point), copy(s.axis, face.axis), copy(s.axis.unitOrthogonal(), face.across);
    face.radius = s.radius, face.outside = s.side == Side::Outside ? 1 : -1;
    return face;
  };
  double worst = 0;
  for (const InstructionSet set : known_instructions())
    for (const bool is_turned : {false, true}) {
      const Quat attitude = is_turned ? Quat(0.9, 0.1, -0.3, 0.2).normalized() : Quat::Identity();
      const Mat3 turn = attitude.toRotationMatrix();
      const Vec3 center(0.05, 0.02, -0.1);
      ShapeFrame frame;
      copy(center, frame.center);
      for (int i = 0; i < 3; ++i) copy(turn.row(i).transpose(), frame.turn[i]);

      Random random(5);
      Crowd crowd(random, 1000, 0);
      for (SphereRecord& p : crowd.pebbles) p.radius *= 5;
      // One on the outer cylinder's axis, which has no direction.
      if (!is_turned) {
        const Vec3 on_axis = center + outside.point;
        crowd.pebbles[3] = {on_axis.x(), on_axis.y(), on_axis.z(), 0.1};
      }
      std::vector<std::int32_t> candidates;
      for (std::int32_t p = 0; p < 1000; p += 1 + p % 3) candidates.push_back(p);
      const auto n = static_cast<std::int32_t>(candidates.size());
      const auto compare = [&](const auto& shape, auto&& kernel, const auto& face) {
        std::vector<WallTouch> touches(candidates.size() + wall_block);
        const std::int32_t count = kernel(crowd.records(), frame, face, candidates.data(), n, touches.data());
        std::int32_t k = 0;
        for (const std::int32_t p : candidates) {
          const SphereRecord& pebble = crowd.pebbles[static_cast<std::size_t>(p)];
          const WallPoint at = shape.closest(turn.transpose() * (first(pebble.x) - center));
          if (at.distance >= pebble.radius) continue;
          CAPTURE(name_of(set), is_turned, p);
          REQUIRE(k < count);
          const WallTouch& touch = touches[static_cast<std::size_t>(k++)];
          REQUIRE(touch.pebble == p);
          const double off = std::max((first(touch.nx) - turn * at.normal).cwiseAbs().maxCoeff(),
                                      std::abs(touch.overlap - (pebble.radius - at.distance)));
          worst = std::max(worst, off);
          CHECK(off <= (is_turned ? 4 * 2.3e-16 : 0.0));
        }
        CHECK(k == count);
        CHECK((count > 50 && count < n));
      };
      compare(plane, wall_kernels(set).touch_plane, plane_face);
      compare(inside, wall_kernels(set).touch_cylinder, face_of(inside));
      compare(outside, wall_kernels(set).touch_cylinder, face_of(outside));
    }
  CAPTURE(worst);
  CHECK(worst > 0);  // turned ones were looked at
}
