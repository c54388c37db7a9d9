#include "continuum_client/node_kernel.hpp"

#include "common/lanes.hpp"

namespace lockstep::continuum {
namespace {

struct Sums {
  Sum8 unbalanced, internal, elastic, kinetic, jolt, gravity_before, gravity_after, reaction_before, reaction_after;
  Sum8 damped_before, damped_after;
  bool has_runaway = false;
};

// |F| against the velocity, nothing where it is zero.
LOCKSTEP_INLINE Lanes against(Lanes force, Lanes velocity, double damping) {
  const Mask sign = (Mask)(-Lanes{});  // of minus zero
  const Lanes along = (Lanes)(((Mask)force & ~sign) | ((Mask)velocity & sign));
  return select(velocity == Lanes{}, Lanes{}, -damping * along);
}

LOCKSTEP_INLINE Lanes3 times(const Lanes3& a, const Lanes3& b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
LOCKSTEP_INLINE Lanes3 over(const Lanes3& a, const Lanes3& b) { return {a.x / b.x, a.y / b.y, a.z / b.z}; }

// `width` nodes; `lane` says which of the eight partial sums are theirs.
LOCKSTEP_INLINE void advance(const NodeArrays& a, const NodeStep& step, std::int64_t i, int lane, Sums& sums) {
  const Lanes3 u = load_vectors(a.displacement + 3 * i), v = load_vectors(a.velocity + 3 * i);
  const Lanes3 internal = load_vectors(a.internal + 3 * i), mobility = load_vectors(a.mobility + 3 * i);
  const Lanes mass = loose(a.mass + i);
  const Lanes3 weight = {mass * step.gravity[0], mass * step.gravity[1], mass * step.gravity[2]};
  Lanes3 force = weight - internal;
  Lanes3 viscous = {};
  if (a.applied) force = force + load_vectors(a.applied + 3 * i);
  if (a.reaction) force = force + load_vectors(a.reaction + 3 * i);
  if (a.viscous) viscous = load_vectors(a.viscous + 3 * i), force = force + viscous;
  const Lanes nothing = {};
  force = {select(mobility.x > nothing, force.x, nothing), select(mobility.y > nothing, force.y, nothing),
           select(mobility.z > nothing, force.z, nothing)};
  Lanes3 drag = {against(force.x, v.x, step.damping), against(force.y, v.y, step.damping),
                 against(force.z, v.z, step.damping)};
  Lanes3 v_new = v + lanes(step.velocity_step) * times(mobility, force + drag);
  if (a.dashpot) {
    // v_new = ((1 - k) v + dt F / m) / (1 + k), k = c dt / 2 m: the force at n is -c (v + v_new) / 2.
    const Lanes3 c = load_vectors(a.dashpot + 3 * i), one = {lanes(1), lanes(1), lanes(1)};
    const Lanes3 k = lanes(0.5 * step.velocity_step) * times(c, mobility);
    v_new = over(v_new - times(k, v), one + k);
    drag = drag - lanes(0.5) * times(c, v + v_new);
  }
  if (a.viscous) drag = drag + viscous;

  sums.unbalanced.add(lane, square_root(dot(force, force)));
  sums.internal.add(lane, square_root(dot(internal, internal)));
  sums.elastic.add(lane, dot(u, load_vectors(a.reference + 3 * i) + internal));
  const Lanes3 change = v_new - v;
  sums.kinetic.add(lane, mass * dot(v, v + lanes(step.into / step.velocity_step) * change));
  sums.jolt.add(lane, mass * dot(change, change));
  sums.gravity_before.add(lane, dot(weight, v)), sums.gravity_after.add(lane, dot(weight, v_new));
  if (a.reaction) {
    const Lanes3 reaction = load_vectors(a.reaction + 3 * i);
    sums.reaction_before.add(lane, dot(reaction, v)), sums.reaction_after.add(lane, dot(reaction, v_new));
  }
  sums.damped_before.add(lane, -dot(drag, v)), sums.damped_after.add(lane, -dot(drag, v_new));
  // Written so that NaN counts as running away.
  sums.has_runaway |= any(~(dot(v_new, v_new) <= lanes(step.square_limit)));

  store_vectors(a.velocity + 3 * i, v_new);
  store_vectors(a.displacement + 3 * i, u + lanes(step.out_of) * v_new);
}

void advance_all(const NodeArrays& a, const NodeStep& step, std::int64_t begin, std::int64_t end, NodeSums& total) {
  Sums sums;
  for (std::int64_t i = begin; i < end; i += block)
    for (int lane = 0; lane < block; lane += width) advance(a, step, i + lane, lane, sums);
  total.unbalanced = sums.unbalanced.total(), total.internal = sums.internal.total();
  total.elastic = 0.5 * sums.elastic.total(), total.kinetic = 0.5 * sums.kinetic.total();
  total.jolt = sums.jolt.total();
  total.gravity_before = sums.gravity_before.total(), total.gravity_after = sums.gravity_after.total();
  total.reaction_before = sums.reaction_before.total(), total.reaction_after = sums.reaction_after.total();
  total.damped_before = sums.damped_before.total(), total.damped_after = sums.damped_after.total();
  total.runaways = sums.has_runaway ? 1 : 0;
}

}  // namespace

NodeKernel LOCKSTEP_NODE_KERNEL() { return advance_all; }

}  // namespace lockstep::continuum
