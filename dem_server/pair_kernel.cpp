#include "dem_server/pair_kernel.hpp"

#include "dem_server/lanes.hpp"

namespace lockstep::dem {

namespace {

static_assert(block == tile_size);

constexpr std::size_t prefetch_tiles = 4;  // ahead: 32 entries; 64 measured alike, fewer leave 100,000 grains waiting
constexpr double deepest_turn = 0.9;       // overlap over r_i + r_j beyond which a spring does not turn
constexpr double least = 1e-300;           // [m2], [N2], [N/m]: keeps 0/0 out

struct Sums {
  Sum8 slip_work, dashpot_work, active, normal_force, contact_force, normal_energy, shear_energy, overlap_ratio;
  Sum8 virial_x, virial_y, virial_z;
};

LOCKSTEP_INLINE void fetch_ahead(const PairState& s, const PairTile& pairs, const BodyTile* bodies) {
  for (int l = 0; l < block; ++l) {
    const std::int32_t b = bodies ? bodies->b[l] : pairs.j[l];
    __builtin_prefetch(&s.pebbles[pairs.j[l]]);
    if (bodies)
      __builtin_prefetch(&s.twists[b]);
    else
      __builtin_prefetch(&s.motion[b]);
    __builtin_prefetch(&s.loads[b], 1);
  }
}

// What the places of `width` entries say.
struct Geometry {
  Lanes3 normal;
  Lanes3 point;         // middle of the overlap, x_i + (r_i - U/2) n [m]
  Lanes arm_i, arm_j;   // from the pebbles' centres to there [m]
  Lanes overlap;        // U [m]
  Lanes step_over_two;  // dt / 2 d, d the distance of the centres; zero where a spring does not turn [s/m]
  Lanes3 shift;         // of B's image; only a periodic cell asks for it [m]
};

template <bool is_periodic>
LOCKSTEP_INLINE Geometry geometry(const PairState& state, const PairStretch& stretch, std::size_t tile, int begin,
                                  Lanes half_step) {
  const PairTile& pairs = stretch.pairs[tile];
  const Lanes zero{}, one = lanes(1), half = lanes(0.5);
  Row rows[width];
  for (int l = 0; l < width; ++l) rows[l] = row(&state.pebbles[pairs.i[begin + l]].x);
  const Lanes4 i = transpose(rows);
  for (int l = 0; l < width; ++l) rows[l] = row(&state.pebbles[pairs.j[begin + l]].x);
  const Lanes4 j = transpose(rows);
  Geometry g{};
  Lanes3 d = xyz(j) - xyz(i);
  if constexpr (is_periodic) {
    const ShiftTile& shift = stretch.shifts[tile];
    g.shift = {load(shift.x + begin), load(shift.y + begin), load(shift.z + begin)};
    d = d + g.shift;
  }
  const Lanes reach = i.w + j.w, square = fused_dot(d, d);
  const Lanes distance = square_root(larger(square, lanes(least)));
  const Lanes inverse = one / distance;
  g.normal = inverse * d;
  // Centres in one place have no direction between them: up is as good as any.
  g.normal.z = select(square > zero, g.normal.z, one);
  g.overlap = reach - distance;
  g.arm_i = multiply_add(-half, g.overlap, i.w);
  g.arm_j = multiply_add(-half, g.overlap, j.w);
  g.point = multiply_add(g.arm_i, g.normal, xyz(i));
  // Centres that nearly meet turn by any angle: their spring is only projected.
  g.step_over_two = select(g.overlap < deepest_turn * reach, half_step * inverse, zero);
  return g;
}

// What `width` contacts put on their bodies, not yet added.
struct Wrenches {
  Lanes3 force;  // on A [N]
  Lanes3 point, shift;
  const std::int32_t *a, *b;
};

// Bodies of a periodic cell that strains at rate L (diagonal) have their own velocities beside the cell's: those of A and of
// B's image differ by L times the branch between their centres as well.
//
// For each entry: distance, and if the pebbles overlap
//   contact point   x_i + (r_i - U/2) n, the middle of the overlap, the same for both bodies
//   V               velocity of B there less that of A               (paper eq. 4)
//   the law         contact_law.hpp                                  (eqs 3, 8-11)
//   the turn        with n0 = n - delta the law's s - (n0 + n) (n . s)/(1 + n0 . n) is s - (n - delta_t/2) (n . s) but for
//                   terms of delta^3, delta_t being what delta has across n. In leap-frog the pebbles were dt V apart a
//                   step ago: delta_t = dt V_t / d, V the velocity of one centre to the other. No normal is stored.
//   loads           force, and its moment about the origin           (eq. 12)
// Entries that do not touch go along with zero force: nine of ten touch.
//
// Three groups of entries are under way at a time: the places of the next, the law of these, the loads of the last. In one
// group each of these waits for the one before, longer than it works.
template <bool has_clumps, bool has_friction, bool has_dashpot, bool is_periodic, Detail detail, bool is_bounded>
void run(const PairState& state, const PairStretch& stretch, const PairLaw& law, PairSums& sums) {
  constexpr bool has_works = detail != Detail::Forces, is_measured = detail == Detail::All;
  constexpr std::size_t steps_a_tile = block / width;
  if (stretch.tiles == 0) return;
  Sums sum;
  LoadRecord scrap{};
  const Lanes zero{}, one = lanes(1), half = lanes(0.5), tiny = lanes(least), half_step = lanes(0.5 * law.time_step);
  // By arithmetic: with a branch a tile takes 1.3 times as long as in a kernel without bounds, so 1.1 times.
  const auto bodies = static_cast<std::uint32_t>(state.end_body - state.first_body);
  const std::ptrdiff_t to_scrap = reinterpret_cast<char*>(&scrap) - reinterpret_cast<char*>(state.loads);
  const auto bounded_target = [&](std::int32_t body) {
    const std::ptrdiff_t is_outside = static_cast<std::uint32_t>(body - state.first_body) < bodies ? 0 : -1;
    const auto place = static_cast<std::ptrdiff_t>(sizeof(LoadRecord)) * body;
    return reinterpret_cast<LoadRecord*>(reinterpret_cast<char*>(state.loads) +
                                         (place ^ ((place ^ to_scrap) & is_outside)));
  };
  // In the order of the list.
  const auto deliver = [&](const Wrenches& w, auto&& target) {
    const Lanes3 on_a = fused_cross(w.point, w.force);
    const Lanes3 off_b = is_periodic ? fused_cross(w.point - w.shift, w.force) : on_a;
    LoadRecord *loads_a[width], *loads_b[width];
    for (int l = 0; l < width; ++l) loads_a[l] = target(w.a[l]), loads_b[l] = target(w.b[l]);
    add_loads({w.force.x, w.force.y, w.force.z, zero}, {on_a.x, on_a.y, on_a.z, zero},
              {off_b.x, off_b.y, off_b.z, zero}, loads_a, loads_b);
  };
  const auto free_target = [&](std::int32_t body) { return &state.loads[body]; };
  const auto deliver_inside = [&](const Wrenches& w, bool is_last_tile) {
    if (is_bounded || is_last_tile)
      deliver(w, bounded_target);
    else
      deliver(w, free_target);
  };
  Geometry next = geometry<is_periodic>(state, stretch, 0, 0, half_step);
  const Lanes3 none = {zero, zero, zero};
  // Nothing on the first body.
  std::int32_t first[width];
  for (int l = 0; l < width; ++l) first[l] = has_clumps ? stretch.bodies[0].a[0] : stretch.pairs[0].i[0];
  Wrenches last = {none, none, none, first, first};
  for (std::size_t tile = 0; tile < stretch.tiles; ++tile) {
    const PairTile& pairs = stretch.pairs[tile];
    const std::size_t ahead = tile + prefetch_tiles < stretch.tiles ? tile + prefetch_tiles : stretch.tiles - 1;
    fetch_ahead(state, stretch.pairs[ahead], has_clumps ? &stretch.bodies[ahead] : nullptr);

    for (std::size_t part = 0; part < steps_a_tile; ++part) {
      const int begin = static_cast<int>(part) * width;
      const Geometry now = next;
      {
        const bool is_last_part = part + 1 == steps_a_tile;
        const std::size_t next_tile = is_last_part && tile + 1 < stretch.tiles ? tile + 1 : tile;
        next = geometry<is_periodic>(state, stretch, next_tile, is_last_part ? 0 : begin + width, half_step);
      }
      deliver_inside(last, part > 0 && tile + 1 == stretch.tiles);
      const Lanes3& normal = now.normal;
      const Mask touches = now.overlap > zero;
      const std::int32_t* a = has_clumps ? stretch.bodies[tile].a + begin : pairs.i + begin;
      const std::int32_t* b = has_clumps ? stretch.bodies[tile].b + begin : pairs.j + begin;
      const auto gather = [&](auto&& row_of) {
        Row rows[width];
        for (int l = 0; l < width; ++l) rows[l] = row_of(l);
        return transpose(rows);
      };

      // Velocities: of B less those of A, at the origin for clumps, of the centres for spheres.
      const auto records = [&] {
        if constexpr (has_clumps)
          return state.twists;
        else
          return state.motion;
      }();
      const Lanes4 dv = gather([&](int l) { return row(&records[b[l]].vx) - row(&records[a[l]].vx); });
      const Lanes4 wa = gather([&](int l) { return row(&records[a[l]].wx); });
      const Lanes4 wb = gather([&](int l) { return row(&records[b[l]].wx); });
      Lanes3 velocity = xyz(dv);
      if constexpr (has_clumps) velocity = cross_add(xyz(wb) - xyz(wa), now.point, velocity);
      Lanes3 branch = none;  // from body to body
      if constexpr (is_periodic) {
        branch =
            xyz(gather([&](int l) { return row(&state.bodies[b[l]].x) - row(&state.bodies[a[l]].x); })) + now.shift;
        if constexpr (has_clumps) velocity = velocity - cross(xyz(wb), now.shift);
        velocity =
            velocity + Lanes3{law.strain_rate_x * branch.x, law.strain_rate_y * branch.y, law.strain_rate_z * branch.z};
      }

      // The law.
      const Lanes normal_velocity = fused_dot(velocity, normal);
      const Lanes radii =
          has_clumps ? wa.w + wb.w : now.arm_i + now.arm_j + now.overlap;  // sum of the equivalent radii
      const Lanes stiffness = law.contact_modulus * radii;
      const Lanes elastic_force = stiffness * now.overlap;
      Lanes normal_force = elastic_force;
      if constexpr (has_dashpot) {
        // c = 2 zeta sqrt(k m_eff); the total never pulls.
        Lanes mass_a = wa.w, mass_b = wb.w;
        if constexpr (has_clumps) {
          mass_a = gather([&](int l) { return row(&state.twists[a[l]].vx); }).w;
          mass_b = mass_a + dv.w;
        }
        const Lanes mass = mass_a * mass_b / (mass_a + mass_b);
        const Lanes dashpot = (2 * law.damping_ratio) * square_root(stiffness * mass);
        normal_force = larger(zero, elastic_force - dashpot * normal_velocity);
        if constexpr (has_works) {
          const Lanes power = (elastic_force - normal_force) * normal_velocity;
          sum.dashpot_work.add(begin, select(touches, power * law.time_step, zero));
        }
      }
      normal_force = select(touches, normal_force, zero);
      Lanes3 force = -normal_force * normal;
      if constexpr (has_friction) {
        SpringTile& springs = stretch.springs[tile];
        const Lanes3 old = {load(springs.x + begin), load(springs.y + begin), load(springs.z + begin)};
        // `across`: of the centres, `shear_velocity`: at the contact.
        const Lanes3 rolled = multiply_add(now.arm_j, xyz(wb), now.arm_i * xyz(wa));
        Lanes3 across = multiply_add(-normal_velocity, normal, velocity), shear_velocity = across;
        if constexpr (has_clumps)
          across = cross_add(rolled, normal, shear_velocity);
        else
          shear_velocity = cross_add(normal, rolled, across);
        const Lanes3 turned =
            multiply_add(-fused_dot(old, normal), multiply_add(-now.step_over_two, across, normal), old);
        const Lanes shear_stiffness = law.shear_share * stiffness;
        const Lanes3 spring = multiply_add(shear_stiffness * law.time_step, shear_velocity, turned);
        const Lanes limit = law.friction * normal_force;
        const Lanes length_square = fused_dot(spring, spring);
        const Mask slides = touches & (length_square > limit * limit);
        // In a packing at rest few contacts slide: a guess that none of these does keeps root and quotient off the path
        // from velocities to loads.
        Lanes kept = select(touches, one, zero);
        if (any(slides)) [[unlikely]] {
          kept = select(slides, limit / square_root(larger(length_square, tiny)), kept);
          if constexpr (has_works) {
            // Slip: what the cut takes from the spring, over k_s, at the mean of the forces before and after.
            const Lanes slip =
                half * (one - kept) * dot(turned + kept * spring, spring) / larger(shear_stiffness, tiny);
            sum.slip_work.add(begin, select(slides, slip, zero));
          }
        }
        const Lanes3 cut = kept * spring;
        force = multiply_add(-normal_force, normal, cut);
        store(springs.x + begin, cut.x);
        store(springs.y + begin, cut.y);
        store(springs.z + begin, cut.z);
        if constexpr (is_measured) sum.shear_energy.add(begin, half * dot(cut, cut) / larger(shear_stiffness, tiny));
      }
      if constexpr (is_measured) {
        const Lanes difference = has_clumps ? wb.w - wa.w : dv.w;
        const Lanes smaller_radius = half * (radii - larger(difference, -difference));
        sum.active.add(begin, select(touches, one, zero));
        sum.normal_force.add(begin, normal_force);
        sum.contact_force.add(begin, square_root(dot(force, force)));
        sum.normal_energy.add(begin, select(touches, half * elastic_force * now.overlap, zero));
        sum.overlap_ratio.raise(begin, select(touches, now.overlap / smaller_radius, zero));
        if constexpr (is_periodic) {
          sum.virial_x.add(begin, select(touches, force.x * branch.x, zero));
          sum.virial_y.add(begin, select(touches, force.y * branch.y, zero));
          sum.virial_z.add(begin, select(touches, force.z * branch.z, zero));
        }
      }
      last = {force, now.point, now.shift, a, b};
    }
  }
  deliver(last, bounded_target);
  if constexpr (has_works) {
    sums.slip_work += sum.slip_work.total();
    sums.dashpot_work += sum.dashpot_work.total();
  }
  if constexpr (is_measured) {
    sums.active += sum.active.total();
    sums.normal_force += sum.normal_force.total();
    sums.contact_force += sum.contact_force.total();
    sums.normal_energy += sum.normal_energy.total();
    sums.shear_energy += sum.shear_energy.total();
    const double ratio = sum.overlap_ratio.largest();
    if (ratio > sums.largest_overlap_ratio) sums.largest_overlap_ratio = ratio;
    if constexpr (is_periodic) {
      sums.virial_x += sum.virial_x.total();
      sums.virial_y += sum.virial_y.total();
      sums.virial_z += sum.virial_z.total();
    }
  }
}

template <bool has_clumps, bool has_friction, bool has_dashpot, bool is_periodic, Detail detail>
PairKernels kernels() {
  return {run<has_clumps, has_friction, has_dashpot, is_periodic, detail, false>,
          run<has_clumps, has_friction, has_dashpot, is_periodic, detail, true>, make_twists};
}

template <bool has_clumps, bool has_friction, bool has_dashpot>
PairKernels choose(const PairKernelTraits& t) {
  if (t.detail == Detail::Forces) return kernels<has_clumps, has_friction, has_dashpot, false, Detail::Forces>();
  if (t.detail == Detail::Works) return kernels<has_clumps, has_friction, has_dashpot, false, Detail::Works>();
  return kernels<has_clumps, has_friction, has_dashpot, false, Detail::All>();
}

// A periodic cell is for preparing packings: it has one kernel for all.
template <bool has_clumps>
PairKernels choose(const PairKernelTraits& t) {
  if (t.is_periodic) return kernels<has_clumps, true, true, true, Detail::All>();
  if (t.has_friction) return t.has_dashpot ? choose<has_clumps, true, true>(t) : choose<has_clumps, true, false>(t);
  return t.has_dashpot ? choose<has_clumps, false, true>(t) : choose<has_clumps, false, false>(t);
}

}  // namespace

PairKernels LOCKSTEP_PAIR_KERNEL(const PairKernelTraits& traits) {
  return traits.has_clumps ? choose<true>(traits) : choose<false>(traits);
}

}  // namespace lockstep::dem
