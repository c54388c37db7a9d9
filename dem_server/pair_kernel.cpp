#include "dem_server/pair_kernel.hpp"

#include "dem_server/lanes.hpp"

namespace lockstep::dem {

namespace {

static_assert(block == tile_size);

constexpr std::size_t prefetch_tiles = 4;  // ahead: 32 entries; 64 measured alike, fewer leave 100,000 grains waiting
constexpr double deepest_turn = 0.9;       // overlap over r_i + r_j beyond which a spring does not turn
constexpr double least_square = 1e-300;    // [m2], [N2], [N/m]: keeps 0/0 out

struct Sums {
  Sum8 slip_work, dashpot_work, active, normal_force, contact_force, normal_energy, shear_energy, overlap_ratio;
  Sum8 virial_x, virial_y, virial_z;
};

// Takes sign bits of the first three: x_j - x_i, and R_i + R_j beside it, are one addition of records.
LOCKSTEP_INLINE Row minus_place(Row r) { return r * Row{-1, -1, -1, 1}; }

LOCKSTEP_INLINE void fetch_ahead(const PairState& s, const PairTile& pairs, const BodyTile* bodies) {
  for (int l = 0; l < block; ++l) {
    const std::int32_t b = bodies ? bodies->b[l] : pairs.j[l];
    __builtin_prefetch(&s.pebbles[pairs.j[l]]);
    if (bodies) __builtin_prefetch(&s.bodies[b]);
    __builtin_prefetch(&s.motion[b]);
    __builtin_prefetch(&s.loads[b], 1);
  }
}

// What the places of `width` entries say.
struct Geometry {
  Lanes3 normal;
  Lanes inverse;  // of the distance [1/m]
  Lanes overlap;  // [m]
  Lanes reach;    // r_i + r_j [m]
  Mask touches;
};

template <bool is_periodic>
LOCKSTEP_INLINE Geometry geometry(const PairState& state, const PairStretch& stretch, std::size_t tile, int begin) {
  const PairTile& pairs = stretch.pairs[tile];
  Row rows[width];
  for (int l = 0; l < width; ++l)
    rows[l] = minus_place(row(&state.pebbles[pairs.i[begin + l]].x)) + row(&state.pebbles[pairs.j[begin + l]].x);
  const Lanes4 gap = transpose(rows);
  Lanes3 d = {gap.x, gap.y, gap.z};
  if constexpr (is_periodic) {
    const ShiftTile& shift = stretch.shifts[tile];
    d = d + Lanes3{load(shift.x + begin), load(shift.y + begin), load(shift.z + begin)};
  }
  const Lanes zero{}, one = lanes(1);
  const Lanes square = dot(d, d);
  const Mask touches = square < gap.w * gap.w;
  const Lanes distance = square_root(larger(square, lanes(least_square)));
  const Lanes inverse = one / distance;
  Lanes3 normal = inverse * d;
  // Centres in one place have no direction between them: up is as good as any.
  normal.z = select(square > zero, normal.z, one);
  return {normal, inverse, gap.w - distance, gap.w, touches};
}

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
//   loads           force and moment about each centre of mass       (eq. 12)
// Entries that do not touch go along with zero force: nine of ten touch. The geometry of the next entries is begun
// before the law of these: their roots and divisions take as long as all the rest and can be under way meanwhile.
template <bool has_clumps, bool has_friction, bool has_dashpot, bool is_periodic, Detail detail, bool is_bounded>
void run(const PairState& state, const PairStretch& stretch, const PairLaw& law, PairSums& sums) {
  constexpr bool has_works = detail != Detail::Forces, is_measured = detail == Detail::All;
  constexpr std::size_t steps_a_tile = block / width;
  if (stretch.tiles == 0) return;
  Sums sum;
  LoadRecord scrap{};
  const Lanes zero{}, one = lanes(1), half = lanes(0.5), least = lanes(least_square),
                      half_step = lanes(0.5 * law.time_step);
  // By arithmetic: with a branch a tile takes 1.3 times as long as in a kernel without bounds, so 1.1 times.
  const auto bodies = static_cast<std::uint32_t>(state.end_body - state.first_body);
  const std::ptrdiff_t to_scrap = reinterpret_cast<char*>(&scrap) - reinterpret_cast<char*>(state.loads);
  const auto target = [&](std::int32_t body) -> LoadRecord* {
    if constexpr (!is_bounded) return &state.loads[body];
    const std::ptrdiff_t is_outside = static_cast<std::uint32_t>(body - state.first_body) < bodies ? 0 : -1;
    const auto place = static_cast<std::ptrdiff_t>(sizeof(LoadRecord)) * body;
    return reinterpret_cast<LoadRecord*>(reinterpret_cast<char*>(state.loads) +
                                         (place ^ ((place ^ to_scrap) & is_outside)));
  };
  Geometry next = geometry<is_periodic>(state, stretch, 0, 0);
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
        next = geometry<is_periodic>(state, stretch, next_tile, is_last_part ? 0 : begin + width);
      }
      const Lanes3& normal = now.normal;
      const std::int32_t *i = pairs.i + begin, *j = pairs.j + begin;
      const std::int32_t* a = has_clumps ? stretch.bodies[tile].a + begin : i;
      const std::int32_t* b = has_clumps ? stretch.bodies[tile].b + begin : j;
      Row rows[width];

      // Velocities and levers.
      for (int l = 0; l < width; ++l) rows[l] = row(&state.motion[b[l]].vx) - row(&state.motion[a[l]].vx);
      const Lanes4 dv = transpose(rows);
      for (int l = 0; l < width; ++l) rows[l] = row(&state.motion[a[l]].wx);
      const Lanes4 wa = transpose(rows);
      for (int l = 0; l < width; ++l) rows[l] = row(&state.motion[b[l]].wx);
      const Lanes4 wb = transpose(rows);
      Lanes radii;  // sum of the equivalent radii
      Lanes3 lever_a{}, lever_b{};
      Lanes3 centers = {dv.x, dv.y, dv.z};  // velocity of pebble j less that of i
      Lanes arm_a, arm_b;
      Lanes3 branch = (now.reach - now.overlap) * normal;  // from body to body; only a periodic cell asks for it
      if constexpr (has_clumps) {
        // From the centres of the bodies to those of their pebbles; the row's fourth is r less R_eq.
        for (int l = 0; l < width; ++l) rows[l] = row(&state.pebbles[i[l]].x) - row(&state.bodies[a[l]].x);
        const Lanes4 out_a = transpose(rows);
        for (int l = 0; l < width; ++l) rows[l] = row(&state.pebbles[j[l]].x) - row(&state.bodies[b[l]].x);
        const Lanes4 out_b = transpose(rows);
        radii = now.reach - (out_a.w + out_b.w);
        const Lanes difference = (dv.w + out_b.w) - out_a.w;  // r_j - r_i
        const Lanes radius_i = half * (now.reach - difference);
        arm_a = radius_i - half * now.overlap;
        arm_b = (radius_i + difference) - half * now.overlap;
        lever_a = Lanes3{out_a.x, out_a.y, out_a.z} + arm_a * normal;
        lever_b = Lanes3{out_b.x, out_b.y, out_b.z} - arm_b * normal;
        branch = branch + Lanes3{out_a.x, out_a.y, out_a.z} - Lanes3{out_b.x, out_b.y, out_b.z};
        centers = centers + cross({wb.x, wb.y, wb.z}, {out_b.x, out_b.y, out_b.z}) -
                  cross({wa.x, wa.y, wa.z}, {out_a.x, out_a.y, out_a.z});
      } else {
        radii = now.reach;
        const Lanes radius_i = half * (now.reach - dv.w);
        arm_a = radius_i - half * now.overlap;
        arm_b = (radius_i + dv.w) - half * now.overlap;
      }

      if constexpr (is_periodic)
        centers =
            centers + Lanes3{law.strain_rate_x * branch.x, law.strain_rate_y * branch.y, law.strain_rate_z * branch.z};

      // The law.
      const Lanes normal_velocity = dot(centers, normal);
      const Lanes stiffness = law.contact_modulus * radii;
      const Lanes elastic_force = stiffness * now.overlap;
      Lanes normal_force = elastic_force;
      if constexpr (has_dashpot) {
        // c = 2 zeta sqrt(k m_eff); the total never pulls.
        const Lanes mass = wa.w * wb.w / (wa.w + wb.w);
        const Lanes dashpot = (2 * law.damping_ratio) * square_root(stiffness * mass);
        normal_force = larger(zero, elastic_force - dashpot * normal_velocity);
        if constexpr (has_works) {
          const Lanes power = (elastic_force - normal_force) * normal_velocity;
          sum.dashpot_work.add(begin, select(now.touches, power * law.time_step, zero));
        }
      }
      normal_force = select(now.touches, normal_force, zero);
      Lanes3 force = -normal_force * normal;
      if constexpr (has_friction) {
        SpringTile& springs = stretch.springs[tile];
        const Lanes3 old = {load(springs.x + begin), load(springs.y + begin), load(springs.z + begin)};
        const Lanes3 across = centers - normal_velocity * normal;
        // Centres that nearly meet turn by any angle: their spring is only projected.
        const Lanes half_turn = select(now.overlap < deepest_turn * now.reach, half_step * now.inverse, zero);
        const Lanes3 rolled = arm_a * Lanes3{wa.x, wa.y, wa.z} + arm_b * Lanes3{wb.x, wb.y, wb.z};
        const Lanes3 shear_velocity = across - cross(rolled, normal);
        const Lanes3 turned = old - dot(old, normal) * (normal - half_turn * across);
        const Lanes shear_stiffness = law.shear_share * stiffness;
        const Lanes3 spring = turned + (shear_stiffness * law.time_step) * shear_velocity;
        const Lanes limit = law.friction * normal_force;
        const Lanes length_square = dot(spring, spring);
        const Mask slides = now.touches & (length_square > limit * limit);
        // In a packing at rest few contacts slide: a guess that none of these does keeps root and quotient off the path
        // from velocities to loads.
        Lanes kept = select(now.touches, one, zero);
        if (any(slides)) kept = select(slides, limit / square_root(larger(length_square, least)), kept);
        const Lanes3 cut = kept * spring;
        force = force + cut;
        store(springs.x + begin, cut.x);
        store(springs.y + begin, cut.y);
        store(springs.z + begin, cut.z);
        if constexpr (has_works) {
          // Slip: what the cut takes from the spring, over k_s, at the mean of the forces before and after.
          const Lanes slip = half * (one - kept) * dot(turned + cut, spring) / larger(shear_stiffness, least);
          sum.slip_work.add(begin, select(slides, slip, zero));
        }
        if constexpr (is_measured) sum.shear_energy.add(begin, half * dot(cut, cut) / larger(shear_stiffness, least));
      }
      if constexpr (is_measured) {
        const Lanes smaller_radius = half * (radii - larger(dv.w, -dv.w));
        sum.active.add(begin, select(now.touches, one, zero));
        sum.normal_force.add(begin, normal_force);
        sum.contact_force.add(begin, square_root(dot(force, force)));
        sum.normal_energy.add(begin, select(now.touches, half * elastic_force * now.overlap, zero));
        sum.overlap_ratio.raise(begin, select(now.touches, now.overlap / smaller_radius, zero));
        if constexpr (is_periodic) {
          sum.virial_x.add(begin, select(now.touches, force.x * branch.x, zero));
          sum.virial_y.add(begin, select(now.touches, force.y * branch.y, zero));
          sum.virial_z.add(begin, select(now.touches, force.z * branch.z, zero));
        }
      }

      // Loads, in the order of the list.
      Lanes3 torque_a, torque_b;
      if constexpr (has_clumps) {
        torque_a = cross(lever_a, force);
        torque_b = cross(lever_b, force);  // of the force on A; B gets the opposite
      } else {
        const Lanes3 moment = cross(normal, force);
        torque_a = arm_a * moment;
        torque_b = -arm_b * moment;
      }
      LoadRecord *on_a[width], *on_b[width];
      for (int l = 0; l < width; ++l) on_a[l] = target(a[l]), on_b[l] = target(b[l]);
      add_loads({force.x, force.y, force.z, zero}, {torque_a.x, torque_a.y, torque_a.z, zero},
                {torque_b.x, torque_b.y, torque_b.z, zero}, on_a, on_b);
    }
  }
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
PairKernel choose(const PairKernelTraits& t) {
  return t.is_bounded ? run<has_clumps, has_friction, has_dashpot, is_periodic, detail, true>
                      : run<has_clumps, has_friction, has_dashpot, is_periodic, detail, false>;
}

template <bool has_clumps, bool has_friction, bool has_dashpot>
PairKernel choose(const PairKernelTraits& t) {
  if (t.detail == Detail::Forces) return choose<has_clumps, has_friction, has_dashpot, false, Detail::Forces>(t);
  if (t.detail == Detail::Works) return choose<has_clumps, has_friction, has_dashpot, false, Detail::Works>(t);
  return choose<has_clumps, has_friction, has_dashpot, false, Detail::All>(t);
}

// A periodic cell is for preparing packings: it has one kernel for all.
template <bool has_clumps>
PairKernel choose(const PairKernelTraits& t) {
  if (t.is_periodic) return choose<has_clumps, true, true, true, Detail::All>(t);
  if (t.has_friction) return t.has_dashpot ? choose<has_clumps, true, true>(t) : choose<has_clumps, true, false>(t);
  return t.has_dashpot ? choose<has_clumps, false, true>(t) : choose<has_clumps, false, false>(t);
}

}  // namespace

PairKernel LOCKSTEP_PAIR_KERNEL(const PairKernelTraits& traits) {
  return traits.has_clumps ? choose<true>(traits) : choose<false>(traits);
}

}  // namespace lockstep::dem
