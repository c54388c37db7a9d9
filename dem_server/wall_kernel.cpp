#include "dem_server/wall_kernel.hpp"

#include "dem_server/lanes.hpp"

namespace lockstep::dem {

namespace {

static_assert(block == wall_block);

constexpr int candidates_ahead = 24;    // whose pebbles are fetched
constexpr int touches_ahead = 16;       // whose bodies are fetched
constexpr double smallest_turn = 1e-9;  // as in contact_law.hpp
constexpr WallSpring no_spring{};

LOCKSTEP_INLINE Lanes3 vector(const double* v) { return {lanes(v[0]), lanes(v[1]), lanes(v[2])}; }
LOCKSTEP_INLINE Lanes3 operator-(const Lanes3& a) { return {-a.x, -a.y, -a.z}; }
LOCKSTEP_INLINE Lanes3 over(const Lanes3& a, Lanes s) { return {a.x / s, a.y / s, a.z / s}; }

// ---------------------------------------------------------------------------------------------------- what touches

// Shapes in their own frame: distance of a point, and the unit normal towards it.
struct Closest {
  Lanes distance;
  Lanes3 normal;
};

LOCKSTEP_INLINE Closest closest(const PlaneFace& plane, const Lanes3& x) {
  const Lanes3 normal = vector(plane.normal);
  return {dot(x - vector(plane.point), normal), normal};
}

LOCKSTEP_INLINE Closest closest(const CylinderFace& cylinder, const Lanes3& x) {
  const Lanes3 axis = vector(cylinder.axis), from_point = x - vector(cylinder.point);
  const Lanes3 across = from_point - dot(from_point, axis) * axis;
  const Lanes r = square_root(dot(across, across));
  const Lanes3 radial = select(r > lanes(0), over(across, r), vector(cylinder.across));
  const Lanes outside = lanes(cylinder.outside);
  return {outside * (r - cylinder.radius), outside * radial};
}

template <class Face>
std::int32_t touch(const GrainRecords& g, const ShapeFrame& frame, const Face& face, const std::int32_t* candidates,
                   std::int32_t count, WallTouch* touches) {
  const Lanes3 center = vector(frame.center);
  const Lanes3 rows_of_turn[3] = {vector(frame.turn[0]), vector(frame.turn[1]), vector(frame.turn[2])};
  std::int32_t touching = 0;
  for (std::int32_t k = 0; k < count; k += width) {
    const int filled = count - k < width ? count - k : width;
    for (int l = 0; l < width; ++l)
      __builtin_prefetch(
          &g.pebbles[candidates[k + l + candidates_ahead < count ? k + l + candidates_ahead : count - 1]]);
    Row rows[width];
    for (int l = 0; l < width; ++l) rows[l] = row(&g.pebbles[candidates[k + (l < filled ? l : 0)]].x);
    const Lanes4 pebble = transpose(rows);
    const Lanes3 d = xyz(pebble) - center;
    const Lanes3 local = d.x * rows_of_turn[0] + d.y * rows_of_turn[1] + d.z * rows_of_turn[2];
    const Closest at = closest(face, local);
    const unsigned touches_now = bits(at.distance < pebble.w);
    if (touches_now == 0) continue;
    transpose({dot(rows_of_turn[0], at.normal), dot(rows_of_turn[1], at.normal), dot(rows_of_turn[2], at.normal),
               pebble.w - at.distance},
              rows);
    for (int l = 0; l < filled; ++l) {
      WallTouch& next = touches[touching];
      *reinterpret_cast<Row*>(&next.nx) = rows[l];
      next.pebble = candidates[k + l];
      touching += touches_now >> l & 1;
    }
  }
  return touching;
}

// ----------------------------------------------------------------------------------------------------------- press

template <bool has_clumps, bool has_dashpot>
void press(const GrainRecords& g, const WallLaw& law, const WallMotion& motion, const SurfaceVelocity* surface,
           const WallTouch* touches, std::int32_t count, const WallSpring* last_step, WallSpring* springs,
           WallPress* presses) {
  const Lanes zero{}, one = lanes(1), half = lanes(0.5), dt = lanes(law.time_step);
  const Lanes3 wall_velocity = vector(motion.velocity), wall_spin = vector(motion.spin),
               wall_center = vector(motion.center);
  for (std::int32_t k = 0; k < count; k += width) {
    const int filled = count - k < width ? count - k : width;
    const WallTouch* at[width];
    for (int l = 0; l < width; ++l) {
      at[l] = &touches[k + (l < filled ? l : 0)];
      const WallTouch& later = touches[k + l + touches_ahead < count ? k + l + touches_ahead : count - 1];
      if constexpr (has_clumps)
        __builtin_prefetch(&g.twists[later.body]);
      else
        __builtin_prefetch(&g.motion[later.body]);
      __builtin_prefetch(&g.loads[later.body], 1);
    }

    // Places and velocities.
    Row rows[width];
    const auto gather = [&](auto&& record) {
      for (int l = 0; l < width; ++l) rows[l] = row(record(l));
      return transpose(rows);
    };
    const auto heir = [&](int l) -> const WallSpring& {
      return at[l]->heir_of >= 0 ? last_step[at[l]->heir_of] : no_spring;
    };
    const Lanes4 touching = gather([&](int l) { return &at[l]->nx; });
    const Lanes4 pebble = gather([&](int l) { return &g.pebbles[at[l]->pebble].x; });
    const auto records = [&] {
      if constexpr (has_clumps)
        return g.twists;
      else
        return g.motion;
    }();
    const Lanes4 v = gather([&](int l) { return &records[at[l]->body].vx; });
    const Lanes4 w = gather([&](int l) { return &records[at[l]->body].wx; });
    const Lanes radius = has_clumps ? w.w : v.w, mass = has_clumps ? v.w : w.w;
    const Lanes3 last_spring = xyz(gather([&](int l) { return &heir(l).sx; }));
    const Lanes3 last_normal = xyz(gather([&](int l) { return &heir(l).nx; }));
    const Lanes3 normal = -xyz(touching);
    const Lanes overlap = touching.w;
    const Lanes3 point = xyz(pebble) + (pebble.w - half * overlap) * normal;  // eq. 1
    const Lanes3 arm = has_clumps ? point : point - xyz(pebble);              // from where the records' velocity is
    Lanes3 at_wall = wall_velocity + cross(wall_spin, point - wall_center);
    if (surface) at_wall = at_wall + xyz(gather([&](int l) { return &surface[at[l] - touches].x; }));
    const Lanes3 approach = at_wall - (xyz(v) + cross(xyz(w), arm));  // eq. 4

    // The law, as contact_force().
    const Lanes normal_stiffness = law.contact_modulus * (radius + radius);
    const Lanes shear_stiffness = normal_stiffness / law.stiffness_ratio;
    const Lanes normal_velocity = dot(approach, normal);
    const Lanes3 shear_velocity = approach - normal_velocity * normal;
    const Lanes elastic_force = normal_stiffness * overlap;
    Lanes normal_force = elastic_force, dashpot_work = zero;
    if constexpr (has_dashpot) {
      const Lanes dashpot = (2 * law.damping_ratio) * square_root(normal_stiffness * mass);
      normal_force = larger(elastic_force - dashpot * normal_velocity, zero);
      dashpot_work = -(normal_force - elastic_force) * normal_velocity * dt;
    }
    const Lanes turn = larger(one + dot(last_normal, normal), lanes(smallest_turn));
    const Lanes3 turned = last_spring - (dot(normal, last_spring) / turn) * (last_normal + normal);
    const Lanes3 grown = turned + (shear_stiffness * dt) * shear_velocity;
    const Lanes limit = law.friction * normal_force;
    const Lanes square = dot(grown, grown);
    const Mask slides = square > limit * limit;
    Lanes3 spring = grown;
    Lanes slip_work = zero;
    if (any(slides)) {
      const Lanes kept = limit / square_root(square);
      spring = select(slides, kept * grown, grown);
      const Lanes slip = half * (one - kept) * dot(turned + kept * grown, grown) / shear_stiffness;
      slip_work = select(slides & (shear_stiffness > zero), slip, zero);
    }
    const Lanes3 force = spring - normal_force * normal;
    const Lanes shear_energy = select(shear_stiffness > zero, dot(spring, spring) / shear_stiffness, zero);
    const Lanes energy = half * (normal_stiffness * overlap * overlap + shear_energy);

    // What the wall's sums, the next step and observers read.
    // By memcpy, since some rows have integers in them.
    const auto scatter = [&](const Lanes4& values, auto&& record) {
      transpose(values, rows);
      for (int l = 0; l < width; ++l) __builtin_memcpy(record(l), &rows[l], sizeof(Row));
    };
    scatter({force.x, force.y, force.z, normal_force}, [&](int l) { return &presses[k + l].fx; });
    scatter({energy, slip_work, dashpot_work, dot(force, at_wall)},
            [&](int l) { return &presses[k + l].elastic_energy; });
    scatter({point.x, point.y, point.z, overlap}, [&](int l) { return &presses[k + l].x; });
    scatter({normal_stiffness, shear_stiffness, overlap / pebble.w, zero},
            [&](int l) { return &presses[k + l].normal_stiffness; });
    scatter({spring.x, spring.y, spring.z, zero}, [&](int l) { return &springs[k + l].sx; });
    scatter({normal.x, normal.y, normal.z, zero}, [&](int l) { return &springs[k + l].nx; });
    for (int l = 0; l < width; ++l) {
      WallSpring& kept = springs[k + l];
      kept.pebble = at[l]->pebble, kept.part = at[l]->part, kept.body = at[l]->body;
      presses[k + l].part = at[l]->part;
    }
    Row moments[width];
    transpose({force.x, force.y, force.z, zero}, rows);
    const Lanes3 moment = cross(point, force);
    transpose({moment.x, moment.y, moment.z, zero}, moments);
    for (int l = 0; l < filled; ++l) {
      add_row(&g.loads[at[l]->body].fx, rows[l]);
      add_row(&g.loads[at[l]->body].mx, moments[l]);
    }
  }
}

void press_any(const GrainRecords& g, const WallLaw& law, const WallMotion& motion, const SurfaceVelocity* surface,
               const WallTouch* touches, std::int32_t count, const WallSpring* last_step, WallSpring* springs,
               WallPress* presses) {
  const bool has_dashpot = law.damping_ratio > 0;
  const bool has_clumps = g.twists != nullptr;
  const auto kernel = has_clumps ? (has_dashpot ? press<true, true> : press<true, false>)
                                 : (has_dashpot ? press<false, true> : press<false, false>);
  kernel(g, law, motion, surface, touches, count, last_step, springs, presses);
}

// ------------------------------------------------------------------------------------------------------------ sums

// By rows, one contact after the other: sums of lanes would depend on which contacts fall together.
void add_up(const WallPress* presses, std::int32_t count, const double* center, WallSums& sums) {
  const auto yzx = [](Row a) { return __builtin_shufflevector(a, a, 1, 2, 0, 3); };
  const auto zxy = [](Row a) { return __builtin_shufflevector(a, a, 2, 0, 1, 3); };
  const Row c = {center[0], center[1], center[2], 0};
  Row forces = row(&sums.fx), moments = row(&sums.mx), works = row(&sums.elastic_energy);
  double stiffness = sums.normal_stiffness, ratio = sums.largest_overlap_ratio;
  for (std::int32_t i = 0; i < count; ++i) {
    const WallPress& p = presses[i];
    const Row f = row(&p.fx), arm = row(&p.x) - c;
    forces += f;
    moments += yzx(arm) * zxy(f) - zxy(arm) * yzx(f);
    works += row(&p.elastic_energy);
    stiffness += p.normal_stiffness;
    ratio = p.overlap_ratio > ratio ? p.overlap_ratio : ratio;
  }
  *reinterpret_cast<Row*>(&sums.fx) = forces;
  *reinterpret_cast<Row*>(&sums.mx) = moments;
  *reinterpret_cast<Row*>(&sums.elastic_energy) = works;
  sums.normal_stiffness = stiffness, sums.largest_overlap_ratio = ratio;
  sums.contacts += count;
}

}  // namespace

WallKernels LOCKSTEP_WALL_KERNEL() { return {touch<PlaneFace>, touch<CylinderFace>, press_any, add_up, make_twists}; }

}  // namespace lockstep::dem
