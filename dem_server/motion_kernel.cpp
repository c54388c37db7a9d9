#include "dem_server/motion_kernel.hpp"

#include "dem_server/constants.hpp"
#include "dem_server/lanes.hpp"

namespace lockstep::dem {

namespace {

constexpr double largest_square = 1e300;  // [rad2/s2]: more is no number

struct Sums {
  Sum8 translation, rotation, gravity_work, damped_work, contact_work, unbalanced, mass, square;
  Sum8 damping_force[3], momentum[3], momentum_change[3];
  Sum8 turn_square;  // of clumps' pebbles about their centres [m2]
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
  LOCKSTEP_INLINE Lanes3 to_world(const Lanes3& v) const { return multiply_add(v.z, z, multiply_add(v.y, y, v.x * x)); }
  LOCKSTEP_INLINE Lanes3 to_body(const Lanes3& v) const { return {fused_dot(x, v), fused_dot(y, v), fused_dot(z, v)}; }
};

// Of a unit quaternion (x, y, z, w).
LOCKSTEP_INLINE Rotation rotation_of(const Lanes4& q) {
  const Lanes tx = q.x + q.x, ty = q.y + q.y, tz = q.z + q.z;
  const Lanes wx = tx * q.w, wy = ty * q.w, wz = tz * q.w;
  const Lanes no_xx = multiply_add(-tx, q.x, lanes(1)), no_yy = multiply_add(-ty, q.y, lanes(1));
  return {{multiply_add(-tz, q.z, no_yy), multiply_add(tx, q.y, wz), multiply_add(tx, q.z, -wy)},
          {multiply_add(tx, q.y, -wz), multiply_add(-tz, q.z, no_xx), multiply_add(ty, q.z, wx)},
          {multiply_add(tx, q.z, wy), multiply_add(ty, q.z, -wx), multiply_add(-ty, q.y, no_xx)}};
}

// 1/(1 + u) and 1/sqrt(1 + u): a body turns by little in a step, and where |u| is below this four terms of a series are as good
// as a quotient, of which a group of bodies would wait for one after the other. Lane by lane: what else is in a group makes no
// difference to the bits. The fifth terms, u^4 and 35/128 u^4, are below 2^-56.
constexpr double small = 0x1p-14;
LOCKSTEP_INLINE Lanes inverse_of_one_plus(Lanes u) {
  const Lanes one = lanes(1), series = multiply_add(-u, multiply_add(-u, one - u, one), one);
  const Mask is_large = ~(larger(u, -u) <= small);
  if (!any(is_large)) [[likely]]
    return series;
  return select(is_large, one / (one + u), series);
}
LOCKSTEP_INLINE Lanes inverse_root_of_one_plus(Lanes u) {
  const Lanes one = lanes(1);
  const Lanes series =
      multiply_add(u, multiply_add(u, multiply_add(u, lanes(-5.0 / 16), lanes(3.0 / 8)), lanes(-0.5)), one);
  const Mask is_large = ~(larger(u, -u) <= small);
  if (!any(is_large)) [[likely]]
    return series;
  return select(is_large, one / square_root(one + u), series);
}

// Turns the body about its own axis `k` by Cayley's map: `turn` is multiplied by (1, angle/2) from the right, and the
// body-frame momentum p turns the other way. i, j, k are cyclic; `v` is the quaternion's vector.
LOCKSTEP_INLINE void turn_about_axis(Lanes angle, Lanes& w, Lanes& v_i, Lanes& v_j, Lanes& v_k, Lanes& p_i,
                                     Lanes& p_j) {
  const Lanes t = 0.5 * angle, one = lanes(1);
  const Lanes w0 = w, i0 = v_i, j0 = v_j, k0 = v_k;
  w = multiply_add(-t, k0, w0);
  v_k = multiply_add(t, w0, k0);
  v_i = multiply_add(t, j0, i0);
  v_j = multiply_add(-t, i0, j0);
  const Lanes scale = inverse_of_one_plus(t * t);
  const Lanes cosine = multiply_add(-t, t, one) * scale, sine = (t + t) * scale;
  const Lanes pi0 = p_i, pj0 = p_j;
  p_i = multiply_add(sine, pj0, cosine * pi0);
  p_j = multiply_add(-sine, pi0, cosine * pj0);
}

// Torque-free turn for `dt` with the angular momentum held; `p` is it in body axes, before and after, and `mobility`
// has 1/I. The turn about the momentum leaves p as it is. Quaternions are composed without regard to their lengths, and
// the product is made unit. `turn_square` is how far a point at unit distance goes, squared.
LOCKSTEP_INLINE Lanes4 turned_freely(const Lanes4& q, Lanes3& p, const Lanes3& mobility, Mask is_axisymmetric,
                                     double dt, Lanes& turn_square) {
  Lanes w = lanes(1);
  const Lanes about_momentum = (0.5 * dt) * mobility.y;
  Lanes3 v = about_momentum * p;
  const Lanes rate_1 = mobility.x - mobility.y, rate_3 = mobility.z - mobility.y;
  const Lanes half = select(is_axisymmetric, lanes(dt), lanes(0.5 * dt));
  turn_about_axis(half * rate_1 * p.x, w, v.y, v.z, v.x, p.y, p.z);
  if (any(~is_axisymmetric)) {
    turn_about_axis(select(is_axisymmetric, lanes(0), dt * rate_3 * p.z), w, v.x, v.y, v.z, p.x, p.y);
    turn_about_axis(select(is_axisymmetric, lanes(0), half * rate_1 * p.x), w, v.y, v.z, v.x, p.y, p.z);
  }
  const Lanes3 a = {q.x, q.y, q.z};
  const Lanes3 r = cross_add(a, v, multiply_add(q.w, v, w * a));
  const Lanes r_w = multiply_add(q.w, w, -fused_dot(a, v));
  const Lanes scale = inverse_root_of_one_plus(multiply_add(r_w, r_w, fused_dot(r, r)) - 1);
  // A point at unit distance goes 2 sin(angle/2), and the sine is |v| over the length of (v, w), which is that of r.
  turn_square = 4 * fused_dot(v, v) * (scale * scale);
  return {scale * r.x, scale * r.y, scale * r.z, scale * r_w};
}

// What the shapes of `width` bodies say. `one` is that of all of them, or null.
struct Shapes {
  Lanes4 inertia;  // principal moments [m R_eq^2], and whether it is a clump
  Lanes4 inverse;  // of these moments, and the square of the farthest pebble's distance [R_eq^2]
  const ShapeRecord* one;
};

template <bool is_whole>
LOCKSTEP_INLINE Shapes shapes_of(const MotionStretch& s, std::int32_t first, int count) {
  const std::int32_t* numbers = s.shape_numbers + first;
  std::int32_t differences = 0;
  if (is_whole)
    for (int l = 1; l < width; ++l) differences |= numbers[l] ^ numbers[0];
  if (is_whole && differences == 0) {
    const ShapeRecord& shape = s.shapes[numbers[0]];
    return {{lanes(shape.i1), lanes(shape.i2), lanes(shape.i3), lanes(shape.is_clump)},
            {lanes(shape.over_i1), lanes(shape.over_i2), lanes(shape.over_i3), lanes(shape.farthest_square)},
            &shape};
  }
  Row moments[width], inverses[width];
  for (int l = 0; l < width; ++l) {
    const ShapeRecord& shape = s.shapes[numbers[l < count ? l : 0]];
    moments[l] = row(&shape.i1), inverses[l] = row(&shape.over_i1);
  }
  return {transpose(moments), transpose(inverses), nullptr};
}

// `count` bodies whose pebbles are not yet placed.
struct Poses {
  Rotation rotation;
  Lanes3 center;
  Lanes radius;
  const ShapeRecord* shape;  // of all of them, or null
  std::int32_t first;
  int count = 0;
};

// The k-th pebbles of all bodies together; one that has fewer places its last again.
template <bool is_whole>
LOCKSTEP_INLINE void place_pebbles(const MotionStretch& s, const Poses& poses) {
  const std::int32_t* begins = s.pebble_begin + poses.first;
  const Rotation& turned = poses.rotation;
  Row rows[width];
  const auto placed = [&](const Lanes4& pebble) {
    Lanes3 at = multiply_add(poses.radius * pebble.x, turned.x, poses.center);
    if (!s.are_rows)
      at = multiply_add(poses.radius * pebble.z, turned.z, multiply_add(poses.radius * pebble.y, turned.y, at));
    transpose({at.x, at.y, at.z, poses.radius * pebble.w}, rows);
  };
  const auto store_row = [&](std::int32_t pebble, int l) { *reinterpret_cast<Row*>(&s.pebbles[pebble].x) = rows[l]; };
  if (is_whole && poses.shape) {
    const std::int32_t pebbles = poses.shape->pebbles;
    const SphereRecord* shape = s.shape_pebbles + poses.shape->first_pebble;
    for (std::int32_t k = 0; k < pebbles; ++k) {
      placed({lanes(shape[k].x), lanes(shape[k].y), lanes(shape[k].z), lanes(shape[k].radius)});
      for (int l = 0; l < width; ++l) store_row(begins[0] + l * pebbles + k, l);
    }
    return;
  }
  const ShapeRecord* shapes[width];
  std::int32_t most = 0;
  for (int l = 0; l < width; ++l) {
    shapes[l] = &s.shapes[s.shape_numbers[poses.first + (l < poses.count ? l : 0)]];
    most = shapes[l]->pebbles > most ? shapes[l]->pebbles : most;
  }
  for (std::int32_t k = 0; k < most; ++k) {
    const auto of = [&](int l) { return k < shapes[l]->pebbles ? k : shapes[l]->pebbles - 1; };
    for (int l = 0; l < width; ++l) rows[l] = row(&s.shape_pebbles[shapes[l]->first_pebble + of(l)].x);
    placed(transpose(rows));
    for (int l = 0; l < poses.count; ++l) store_row(begins[l] + of(l), l);
  }
}

// `width` bodies from `first` on, in the lanes that begin at `begin`; fewer, `count`, at the end of a stretch. Pebbles are
// those of the group before, `poses`: their placing is work for while this group's roots and quotients are under way.
template <bool has_clumps, Detail detail, bool is_whole>
LOCKSTEP_INLINE void move(const MotionStretch& s, const MotionStep& step, std::int32_t first, int count, int begin,
                          Poses& poses, Sums& sum, Mask& too_fast) {
  constexpr bool has_works = detail != Detail::Forces;
  // Stands in where a group of eight has fewer bodies.
  SphereRecord no_body = {0, 0, 0, 1};
  MotionRecord no_motion = {0, 0, 0, 1, 0, 0, 0, 0};
  LoadRecord no_load{};
  AttitudeRecord no_attitude = {0, 0, 0, 1};
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
  for (int l = 0; l < width; ++l) rows[l] = row(&of(s.loads, no_load, l)->mx);
  const Lanes4 moment = transpose(rows);

  Mask moves = Mask{} - 1;
  if (!is_whole)
    for (int l = count; l < width; ++l) moves[l] = 0;
  if (s.is_fixed)
    for (int l = 0; l < count; ++l) moves[l] = s.is_fixed[first + l] ? 0 : -1;
  const Lanes mass = select(moves, w.w, zero);
  const Lanes radius_square = place.w * place.w;
  Shapes shapes{};
  Lanes inverse = zero;  // 1/(m R^2): one division for what takes four
  Lanes mobility;        // 1/m
  if constexpr (has_clumps) {
    shapes = shapes_of<is_whole>(s, first, count);
    inverse = one / (w.w * radius_square);
    mobility = inverse * radius_square;
  } else {
    mobility = one / w.w;
  }
  mobility = select(moves, mobility, zero);

  // Translation.
  const Lanes3 before = {v.x, v.y, v.z}, force = {f.x, f.y, f.z};
  const Lanes3 gravity = {lanes(step.gravity[0]), lanes(step.gravity[1]), lanes(step.gravity[2])};
  const Lanes3 unbalanced = select(moves, multiply_add(mass, gravity, force), none);
  const Lanes3 force_damping = damping_part(unbalanced, before, step.damping);
  const Lanes3 after = select(moves, multiply_add(dt * mobility, unbalanced + force_damping, before), none);
  const Lanes3 center = {place.x, place.y, place.z};
  const Lanes3 position = multiply_add(lanes(step.next_step), after, center);
  const Lanes3 mean = lanes(0.5) * (before + after);
  const Lanes square = fused_dot(after, after);
  sum.square.raise(begin, square);
  too_fast |= ~(square <= fastest_square * radius_square);
  if constexpr (has_works) {
    sum.translation.add(begin, 0.5 * mass * dot(before, after));
    sum.gravity_work.add(begin, dt * dot(mass * gravity, mean));
    sum.unbalanced.add(begin, square_root(dot(unbalanced, unbalanced)));
    sum.mass.add(begin, mass);
    add(sum.damping_force, begin, force_damping);
    add(sum.momentum, begin, mass * after);
    add(sum.momentum_change, begin, mass * (after - before));
  }

  // Rotation.
  // About the centre of mass: loads are about the origin.
  const Lanes3 spin = {w.x, w.y, w.z};
  const Lanes3 pure_torque = select(moves, cross_add(force, center, {moment.x, moment.y, moment.z}), none);
  const Lanes3 torque_damping = damping_part(pure_torque, spin, step.damping);
  const Lanes3 torque = pure_torque + torque_damping;
  Lanes3 next_spin = spin, middle = spin;  // the second: mean of the spins before and after, at the attitude of t_n
  Lanes rotation_energy = zero;
  const auto as_sphere = [&] {
    const Lanes square_radius = sphere_inertia * radius_square;  // of gyration
    next_spin = multiply_add(dt * (mobility / square_radius), torque, spin);
    middle = lanes(0.5) * (spin + next_spin);
    rotation_energy = 0.5 * (mass * square_radius) * fused_dot(spin, next_spin);
  };
  Rotation rotation;
  if constexpr (has_clumps) {
    for (int l = 0; l < width; ++l) rows[l] = row(&of(s.attitudes, no_attitude, l)->qx);
    const Lanes4 q = transpose(rows);
    const Mask is_clump = shapes.inertia.w != zero;
    if (any(~is_clump)) as_sphere();
    // In body axes: spin, momentum p.
    const Rotation at = rotation_of(q);
    const Lanes3 own_spin = at.to_body(spin), own_torque = at.to_body(torque);
    const auto each = [](const Lanes3& a, const Lanes3& b) -> Lanes3 { return {a.x * b.x, a.y * b.y, a.z * b.z}; };
    const Lanes3 inertia = (w.w * radius_square) * xyz(shapes.inertia), own_mobility = inverse * xyz(shapes.inverse);
    Lanes3 p = multiply_add(lanes(dt), own_torque, each(inertia, own_spin));
    const auto spin_of = [&](const Lanes3& momentum) { return each(own_mobility, momentum); };
    middle = select(is_clump, at.to_world(lanes(0.5) * (own_spin + spin_of(p))), middle);
    rotation_energy = select(is_clump, 0.5 * fused_dot(own_spin, p), rotation_energy);
    const Mask turns = is_clump & moves;
    Lanes turn_square;
    const Lanes4 turned =
        turned_freely(q, p, own_mobility, shapes.inertia.z == shapes.inertia.y, step.next_step, turn_square);
    const Lanes4 attitude = {select(turns, turned.x, q.x), select(turns, turned.y, q.y), select(turns, turned.z, q.z),
                             select(turns, turned.w, q.w)};
    sum.turn_square.raise(begin, select(turns, turn_square * (radius_square * shapes.inverse.w), zero));
    if (poses.count > 0) place_pebbles<true>(s, poses);
    rotation = rotation_of(attitude);
    next_spin = select(is_clump, rotation.to_world(spin_of(p)), next_spin);
    transpose(attitude, rows);
    for (int l = 0; l < count; ++l) *reinterpret_cast<Row*>(&s.attitudes[first + l].qx) = rows[l];
  } else {
    as_sphere();
  }
  next_spin = select(moves, next_spin, none);
  too_fast |= ~(fused_dot(next_spin, next_spin) <= largest_square);  // a spin that is no number
  if constexpr (has_works) {
    sum.rotation.add(begin, select(moves, rotation_energy, zero));
    sum.contact_work.add(begin, select(moves, dt * (dot(force, mean) + dot(pure_torque, middle)), zero));
    sum.damped_work.add(begin, select(moves, -dt * (dot(force_damping, mean) + dot(torque_damping, middle)), zero));
  }

  transpose({position.x, position.y, position.z, place.w}, rows);
  for (int l = 0; l < count; ++l) *reinterpret_cast<Row*>(&s.bodies[first + l].x) = rows[l];
  if constexpr (has_clumps) {
    poses.rotation = rotation;
    poses.center = position;
    poses.radius = place.w;
    poses.shape = shapes.one;
    poses.first = first;
    poses.count = count;
  }
  store_records({after.x, after.y, after.z, v.w}, {next_spin.x, next_spin.y, next_spin.z, w.w}, s.motion + first,
                count);
  if constexpr (has_clumps) {
    const Lanes3 at_origin = cross_add(position, next_spin, after);
    store_records({at_origin.x, at_origin.y, at_origin.z, w.w}, {next_spin.x, next_spin.y, next_spin.z, place.w},
                  s.twists + first, count);
  }
  for (int l = 0; l < count; ++l) s.loads[first + l] = LoadRecord{};
}

template <bool has_clumps, Detail detail>
void run(const MotionStretch& s, const MotionStep& step, MotionSums& sums) {
  constexpr bool has_works = detail != Detail::Forces;
  Sums sum;
  Mask too_fast{};
  Poses poses;
  std::int32_t first = s.begin;
  int begin = 0;
  for (; first + width <= s.end; first += width, begin = (begin + width) % block)
    move<has_clumps, detail, true>(s, step, first, width, begin, poses, sum, too_fast);
  if (first < s.end) move<has_clumps, detail, false>(s, step, first, s.end - first, begin, poses, sum, too_fast);
  if (has_clumps && poses.count > 0) place_pebbles<false>(s, poses);
  sums.too_fast = any(too_fast) ? 1 : 0;
  sums.largest_square = sum.square.largest();
  sums.way = step.next_step * __builtin_sqrt(sums.largest_square) + __builtin_sqrt(sum.turn_square.largest());
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
