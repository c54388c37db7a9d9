#include "dem_server/motion_kernel.hpp"

#include "dem_server/constants.hpp"
#include "dem_server/lanes.hpp"

namespace lockstep::dem {

namespace {

constexpr double largest_square = 1e300;  // [rad2/s2]: more is no number

struct Sums {
  Sum8 translation, rotation, gravity_work, damped_work, contact_work, unbalanced, mass, square;
  Sum8 damping_force[3], momentum[3], momentum_change[3];
  Row way_squares{};  // of clumps' pebbles, the largest of each component
};

LOCKSTEP_INLINE void add(Sum8* sums, int begin, const Lanes3& v) {
  sums[0].add(begin, v.x), sums[1].add(begin, v.y), sums[2].add(begin, v.z);
}

// -alpha |F| sign(v), and zero where v is.
LOCKSTEP_INLINE Lanes damping_part(Lanes force, Lanes velocity, double damping) {
  const Mask sign = (Mask)(-Lanes{});  // of minus zero
  const Lanes signed_force = (Lanes)(((Mask)force & ~sign) | ((Mask)velocity & sign));
  return select(velocity == Lanes{}, Lanes{}, -damping * signed_force);
}

LOCKSTEP_INLINE Lanes3 damping_part(const Lanes3& force, const Lanes3& velocity, double damping) {
  return {damping_part(force.x, velocity.x, damping), damping_part(force.y, velocity.y, damping),
          damping_part(force.z, velocity.z, damping)};
}

struct Rotation {  // columns: images of the body's axes
  Lanes3 x, y, z;
  LOCKSTEP_INLINE Lanes3 to_world(const Lanes3& v) const { return v.x * x + v.y * y + v.z * z; }
  LOCKSTEP_INLINE Lanes3 to_body(const Lanes3& v) const { return {dot(x, v), dot(y, v), dot(z, v)}; }
};

// Of a unit quaternion (x, y, z, w).
LOCKSTEP_INLINE Rotation rotation_of(const Lanes4& q) {
  const Lanes tx = q.x + q.x, ty = q.y + q.y, tz = q.z + q.z;
  const Lanes wx = tx * q.w, wy = ty * q.w, wz = tz * q.w, xx = tx * q.x, xy = ty * q.x, xz = tz * q.x, yy = ty * q.y,
              yz = tz * q.y, zz = tz * q.z;
  const Lanes one = lanes(1);
  return {
      {one - (yy + zz), xy + wz, xz - wy}, {xy - wz, one - (xx + zz), yz + wx}, {xz + wy, yz - wx, one - (xx + yy)}};
}

// Turns the body about its own axis `k` by Cayley's map: `turn` is multiplied by (1, angle/2) from the right, and the
// body-frame momentum p turns the other way. i, j, k are cyclic; `v` is the quaternion's vector.
LOCKSTEP_INLINE void turn_about_axis(Lanes angle, Lanes& w, Lanes& v_i, Lanes& v_j, Lanes& v_k, Lanes& p_i,
                                     Lanes& p_j) {
  const Lanes t = 0.5 * angle, one = lanes(1);
  const Lanes w0 = w, i0 = v_i, j0 = v_j, k0 = v_k;
  w = w0 - t * k0;
  v_k = k0 + t * w0;
  v_i = i0 + t * j0;
  v_j = j0 - t * i0;
  const Lanes scale = one / (one + t * t);
  const Lanes cosine = (one - t * t) * scale, sine = 2 * t * scale;
  const Lanes pi0 = p_i, pj0 = p_j;
  p_i = cosine * pi0 + sine * pj0;
  p_j = cosine * pj0 - sine * pi0;
}

// Torque-free turn for `dt` with the angular momentum held; `p` is it in body axes, before and after, and `mobility`
// has 1/I. The turn about the momentum leaves p as it is. Quaternions are composed without regard to their lengths, and
// the product is made unit.
LOCKSTEP_INLINE Lanes4 turned_freely(const Lanes4& q, Lanes3& p, const Lanes3& mobility, double dt) {
  Lanes w = lanes(1);
  const Lanes about_momentum = (0.5 * dt) * mobility.y;
  Lanes3 v = about_momentum * p;
  const Lanes rate_1 = mobility.x - mobility.y, rate_3 = mobility.z - mobility.y;
  const Mask is_axisymmetric = mobility.z == mobility.y;
  const Lanes half = select(is_axisymmetric, lanes(dt), lanes(0.5 * dt));
  turn_about_axis(half * rate_1 * p.x, w, v.y, v.z, v.x, p.y, p.z);
  if (any(~is_axisymmetric)) {
    turn_about_axis(dt * rate_3 * p.z, w, v.x, v.y, v.z, p.x, p.y);
    turn_about_axis(select(is_axisymmetric, lanes(0), half * rate_1 * p.x), w, v.y, v.z, v.x, p.y, p.z);
  }
  const Lanes4 r = {q.w * v.x + q.x * w + q.y * v.z - q.z * v.y, q.w * v.y + q.y * w + q.z * v.x - q.x * v.z,
                    q.w * v.z + q.z * w + q.x * v.y - q.y * v.x, q.w * w - q.x * v.x - q.y * v.y - q.z * v.z};
  const Lanes scale = lanes(1) / square_root(r.x * r.x + r.y * r.y + r.z * r.z + r.w * r.w);
  return {scale * r.x, scale * r.y, scale * r.z, scale * r.w};
}

// Pebbles of `count` bodies, from their centres and the images of their axes.
LOCKSTEP_INLINE void place_pebbles(const MotionStretch& s, std::int32_t first, int count, const Row* centers,
                                   const Rotation& rotation, Row& way_squares) {
  Row x[width], y[width], z[width];
  transpose({rotation.x.x, rotation.x.y, rotation.x.z, Lanes{}}, x);
  transpose({rotation.y.x, rotation.y.y, rotation.y.z, Lanes{}}, y);
  transpose({rotation.z.x, rotation.z.y, rotation.z.z, Lanes{}}, z);
  const Row place = {1, 1, 1, 0}, size = {0, 0, 0, 1};
  Row most = way_squares;
  for (int l = 0; l < count; ++l)
    for (std::int32_t p = s.pebble_begin[first + l]; p < s.pebble_begin[first + l + 1]; ++p) {
      const SphereRecord& o = s.offsets[p];
      Row& pebble = *reinterpret_cast<Row*>(&s.pebbles[p].x);
      const Row placed =
          place * centers[l] + size * row(&o.x) + spread(o.x) * x[l] + spread(o.y) * y[l] + spread(o.z) * z[l];
      const Row way = placed - pebble, squares = way * way;
      most = squares > most ? squares : most;
      pebble = placed;
    }
  way_squares = most;
}

// `width` bodies from `first` on, in the lanes that begin at `begin`; fewer, `count`, at the end of a stretch.
template <bool has_clumps, Detail detail, bool is_whole>
LOCKSTEP_INLINE void move(const MotionStretch& s, const MotionStep& step, std::int32_t first, int count, int begin,
                          Sums& sum, Mask& too_fast) {
  constexpr bool has_works = detail != Detail::Forces;
  // Stands in where a group of eight has fewer bodies.
  SphereRecord no_body = {0, 0, 0, 1};
  MotionRecord no_motion = {0, 0, 0, 1, 0, 0, 0, 0};
  LoadRecord no_load{};
  AttitudeRecord no_attitude = {0, 0, 0, 1, 1, 1, 1, 0};
  const Lanes zero{}, one = lanes(1);
  const Lanes3 none = {zero, zero, zero};
  const double dt = step.mean_step;
  const Lanes fastest_square = lanes(step.fastest * step.fastest);
  const auto of = [&](auto* records, auto& nobody, int l) {
    return is_whole || l < count ? &records[first + l] : &nobody;
  };
  Row rows[width];
  for (int l = 0; l < width; ++l) rows[l] = row(&of(s.bodies, no_body, l)->x);
  const Lanes4 place = transpose(rows);
  for (int l = 0; l < width; ++l) rows[l] = row(&of(s.motion, no_motion, l)->vx);
  const Lanes4 v = transpose(rows);
  for (int l = 0; l < width; ++l) rows[l] = row(&of(s.motion, no_motion, l)->wx);
  const Lanes4 w = transpose(rows);
  for (int l = 0; l < width; ++l) rows[l] = row(&of(s.loads, no_load, l)->fx);
  const Lanes4 f = transpose(rows);
  for (int l = 0; l < width; ++l) rows[l] = row(&of(s.loads, no_load, l)->tx);
  const Lanes4 t = transpose(rows);

  Mask moves = Mask{} - 1;
  if (!is_whole)
    for (int l = count; l < width; ++l) moves[l] = 0;
  if (s.is_fixed)
    for (int l = 0; l < count; ++l) moves[l] = s.is_fixed[first + l] ? 0 : -1;
  const Lanes mass = select(moves, w.w, zero);
  const Lanes mobility = select(moves, one / w.w, zero);

  // Translation.
  const Lanes3 before = {v.x, v.y, v.z}, force = {f.x, f.y, f.z};
  const Lanes3 weight = {mass * step.gravity[0], mass * step.gravity[1], mass * step.gravity[2]};
  const Lanes3 unbalanced = select(moves, force + weight, none);
  const Lanes3 force_damping = damping_part(unbalanced, before, step.damping);
  const Lanes3 after = select(moves, before + (dt * mobility) * (unbalanced + force_damping), none);
  const Lanes3 position = Lanes3{place.x, place.y, place.z} + lanes(step.next_step) * after;
  const Lanes3 mean = lanes(0.5) * (before + after);
  const Lanes square = dot(after, after);
  sum.square.raise(begin, square);
  too_fast |= ~(square <= fastest_square * (place.w * place.w));
  if constexpr (has_works) {
    sum.translation.add(begin, 0.5 * mass * dot(before, after));
    sum.gravity_work.add(begin, dt * dot(weight, mean));
    sum.unbalanced.add(begin, square_root(dot(unbalanced, unbalanced)));
    sum.mass.add(begin, mass);
    add(sum.damping_force, begin, force_damping);
    add(sum.momentum, begin, mass * after);
    add(sum.momentum_change, begin, mass * (after - before));
  }

  // Rotation.
  const Lanes3 spin = {w.x, w.y, w.z}, pure_torque = select(moves, {t.x, t.y, t.z}, none);
  const Lanes3 torque_damping = damping_part(pure_torque, spin, step.damping);
  const Lanes3 torque = pure_torque + torque_damping;
  const Lanes moment = sphere_inertia * mass * place.w * place.w;
  Lanes3 next_spin = spin + (dt * (mobility / (sphere_inertia * place.w * place.w))) * torque;
  Lanes3 middle = lanes(0.5) * (spin + next_spin);  // mean of the spins before and after, at the attitude of t_n
  Lanes rotation_energy = 0.5 * moment * dot(spin, next_spin);
  Rotation rotation;
  if constexpr (has_clumps) {
    for (int l = 0; l < width; ++l) rows[l] = row(&of(s.attitudes, no_attitude, l)->qx);
    const Lanes4 q = transpose(rows);
    for (int l = 0; l < width; ++l) rows[l] = row(&of(s.attitudes, no_attitude, l)->i1);
    const Lanes4 inertia = transpose(rows);
    const Mask is_clump = inertia.w != zero;
    // In body axes: spin, momentum p.
    const Rotation at = rotation_of(q);
    const Lanes3 own_mobility = {one / inertia.x, one / inertia.y, one / inertia.z};
    const Lanes3 own_spin = at.to_body(spin), own_torque = at.to_body(torque);
    Lanes3 p = Lanes3{inertia.x * own_spin.x, inertia.y * own_spin.y, inertia.z * own_spin.z} + lanes(dt) * own_torque;
    const auto spin_of = [&](const Lanes3& momentum) -> Lanes3 {
      return {own_mobility.x * momentum.x, own_mobility.y * momentum.y, own_mobility.z * momentum.z};
    };
    middle = select(is_clump, at.to_world(lanes(0.5) * (own_spin + spin_of(p))), middle);
    rotation_energy = select(is_clump, 0.5 * dot(own_spin, p), rotation_energy);
    const Mask turns = is_clump & moves;
    const Lanes4 turned = turned_freely(q, p, own_mobility, step.next_step);
    const Lanes4 attitude = {select(turns, turned.x, q.x), select(turns, turned.y, q.y), select(turns, turned.z, q.z),
                             select(turns, turned.w, q.w)};
    rotation = rotation_of(attitude);
    next_spin = select(is_clump, rotation.to_world(spin_of(p)), next_spin);
    transpose(attitude, rows);
    for (int l = 0; l < count; ++l) *reinterpret_cast<Row*>(&s.attitudes[first + l].qx) = rows[l];
  }
  next_spin = select(moves, next_spin, none);
  too_fast |= ~(dot(next_spin, next_spin) <= largest_square);  // a spin that is no number
  if constexpr (has_works) {
    sum.rotation.add(begin, select(moves, rotation_energy, zero));
    sum.contact_work.add(begin, select(moves, dt * (dot(force, mean) + dot(pure_torque, middle)), zero));
    sum.damped_work.add(begin, select(moves, -dt * (dot(force_damping, mean) + dot(torque_damping, middle)), zero));
  }

  transpose({position.x, position.y, position.z, place.w}, rows);
  for (int l = 0; l < count; ++l) *reinterpret_cast<Row*>(&s.bodies[first + l].x) = rows[l];
  if constexpr (has_clumps) place_pebbles(s, first, count, rows, rotation, sum.way_squares);
  Row spin_rows[width];
  transpose({after.x, after.y, after.z, v.w}, rows);
  transpose({next_spin.x, next_spin.y, next_spin.z, w.w}, spin_rows);
  for (int l = 0; l < count; ++l) {
    *reinterpret_cast<Row*>(&s.motion[first + l].vx) = rows[l];
    *reinterpret_cast<Row*>(&s.motion[first + l].wx) = spin_rows[l];
    s.loads[first + l] = LoadRecord{};
  }
}

template <bool has_clumps, Detail detail>
void run(const MotionStretch& s, const MotionStep& step, MotionSums& sums) {
  constexpr bool has_works = detail != Detail::Forces;
  Sums sum;
  Mask too_fast{};
  std::int32_t first = s.begin;
  int begin = 0;
  for (; first + width <= s.end; first += width, begin = (begin + width) % block)
    move<has_clumps, detail, true>(s, step, first, width, begin, sum, too_fast);
  if (first < s.end) move<has_clumps, detail, false>(s, step, first, s.end - first, begin, sum, too_fast);
  sums.too_fast = any(too_fast) ? 1 : 0;
  sums.largest_square = sum.square.largest();
  sums.way_square = has_clumps ? sum.way_squares[0] + sum.way_squares[1] + sum.way_squares[2]
                               : step.next_step * step.next_step * sums.largest_square;
  if constexpr (!has_works) return;
  sums.translation_energy = sum.translation.total();
  sums.rotation_energy = sum.rotation.total();
  sums.gravity_work = sum.gravity_work.total();
  sums.damped_work = sum.damped_work.total();
  sums.contact_work = sum.contact_work.total();
  sums.unbalanced_force = sum.unbalanced.total();
  sums.moving_mass = sum.mass.total();
  for (int k = 0; k < 3; ++k) {
    sums.damping_force[k] = sum.damping_force[k].total();
    sums.momentum[k] = sum.momentum[k].total();
    sums.momentum_change[k] = sum.momentum_change[k].total();
  }
}

}  // namespace

MotionKernel LOCKSTEP_MOTION_KERNEL(bool has_clumps, Detail detail) {
  if (detail == Detail::Forces) return has_clumps ? run<true, Detail::Forces> : run<false, Detail::Forces>;
  return has_clumps ? run<true, Detail::Works> : run<false, Detail::Works>;
}

}  // namespace lockstep::dem
