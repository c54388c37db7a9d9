// The phases that cycle.cpp lists.
#include <spdlog/spdlog.h>

#include <algorithm>
#include <limits>
#include <utility>

#include "common/checks.hpp"
#include "continuum_client/constants.hpp"
#include "continuum_client/cycle.hpp"
#include "continuum_client/timestep.hpp"

namespace lockstep::continuum {

void CoupledGround::send_velocities(protocol::Session& peer) {
  const auto scope = profile.measure(Phase::SendVelocities);
  const Ledger& ledger = integrator.ledger();
  outgoing.step = step;
  outgoing.stage = stage;
  outgoing.time_step = step_sizes.out_of;
  outgoing.unbalanced_ratio = sums.unbalanced_ratio();
  outgoing.position_hash = step % hash_interval == 0 ? interface.position_hash() : 0;
  outgoing.energies.kinetic = ledger.kinetic;
  outgoing.energies.elastic = ledger.elastic;
  outgoing.energies.gravity_work = ledger.work.gravity;
  outgoing.energies.damped = ledger.work.damped;
  outgoing.energies.friction = ledger.work.yielded;
  outgoing.energies.boundary_work = ledger.work.boundary + ledger.work.baseline + ledger.work.step_change;
  outgoing.energies.interface_work = ledger.work.interface;
  peer.send(outgoing);
}

void CoupledGround::compute_internal_forces() {
  const auto scope = profile.measure(Phase::InternalForces);
  if (stiffness_damping > 0) std::swap(internal, last_internal);
  if (incremental)
    incremental->advance(motion.displacement, motion.velocity, step_sizes.into, internal, *team);
  else
    internal_force.evaluate(motion.displacement, internal, *team);
  if (yielding) yielding->advance(motion.displacement, internal, *team);
  if (stiffness_damping == 0) return;
  // u(n) = u(n-1) + v(n-1/2) dt: the difference of two products is the product that damping needs.
  const double share = -stiffness_damping / step_sizes.into;
  viscous.resize(internal.size());
  for (std::size_t i = 0; i < internal.size(); ++i) viscous[i] = share * (internal[i] - last_internal[i]);
}

void CoupledGround::load_surface() {
  if (loads.empty()) return;
  std::vector<double> shares;
  for (const SurfaceLoad& load : loads) shares.push_back(load_share(load, time));
  if (shares == load_shares) return;
  load_shares = shares;
  boundary_load.assign(grid.node_count(), Vec3::Zero());
  if (!reaction_load.empty()) boundary_load = reaction_load;
  for (std::size_t l = 0; l < loads.size(); ++l)
    for (std::size_t i = 0; i < boundary_load.size(); ++i) boundary_load[i] += shares[l] * load_force[l][i];
}

void CoupledGround::receive_forces(protocol::Session& peer) {
  const auto scope = profile.measure(Phase::ReceiveForces);
  peer.receive(incoming);
}

void CoupledGround::book_exchange() {
  if (!coupled) return;
  const auto scope = profile.measure(Phase::Ledger);
  InterfaceSums contacts;
  for (const Vec3& f : incoming.force) contacts.nodes_force += f;
  contacts.nodes_moment = moment_of(interface.position, incoming.force) + moment_of(contact_offset, incoming.force);
  contacts.particles_force = incoming.particle_force, contacts.particles_moment = incoming.particle_moment;
  coupled->book_interface(step, time, step_sizes.velocity_step(), contacts);
  if (!incoming.energies) return;
  coupled->book_energies(*incoming.energies, outgoing.energies);
  if (const std::string words = coupled->alarm(); !words.empty()) throw NumericalError(words);
}

void CoupledGround::fade_baseline() {
  for (std::size_t i = 0; i < baseline.force.size(); ++i) baseline.force[i] = baseline.share * baseline.offset[i];
}

void CoupledGround::advance() {
  const auto scope = profile.measure(Phase::Advance);
  const NodalLoads forces{
      gravity, loads.empty() ? reaction_load : boundary_load, interface.node, incoming.force, baseline.force, viscous};
  sums = integrator.advance(motion, internal, internal_force.reference, forces, damping, step_sizes, velocity_limit,
                            *team);
  if (incremental) integrator.set_elastic(incremental->work());
  if (yielding) integrator.book_yielding(yielding->energy(), yielding->dissipated());
  if (sums.runaway_node >= 0) {
    const Vec3& x = grid.node[sums.runaway_node];
    throw NumericalError(
        fmt::format("step {}: node {} of the ground at ({:.4g}, {:.4g}, {:.4g}) m runs away (its velocity is not "
                    "finite or above the P-wave speed, "
                    "{:.4g} m/s); the time step is {:.4g} s, limited by the {}: lower fidelity.step_fraction ({:.3g})",
                    step, sums.runaway_node, x.x(), x.y(), x.z(), velocity_limit, step_sizes.out_of,
                    guard.limits.limited_by(), guard.fraction));
  }
  gather_interface(interface, motion.velocity, outgoing.velocity);
  interface.advance(outgoing.velocity, step_sizes.out_of);
}

Mat3 CoupledGround::zone_stress(const InitialState& initial, std::size_t z) const {
  if (incremental) return incremental->zone_stress(z);
  const Mat3 elastic = initial.zone_stress(grid, z) + continuum::zone_stress(grid.geometry(z), grid.moduli(z),
                                                                             gather(motion.displacement, grid.zone[z]));
  return yielding ? Mat3(elastic + yielding->plastic_stress(z)) : elastic;
}

Mat3 CoupledGround::zone_strain(std::size_t z) const {
  if (incremental) return incremental->zone_strain(z);
  return continuum::zone_strain(grid.geometry(z), gather(motion.displacement, grid.zone[z]));
}

Vec3 CoupledGround::nodal_force(std::size_t node) const {
  Vec3 force = integrator.mass()[node] * gravity - internal[node];
  const Vec3s& boundary = boundary_load.empty() ? reaction_load : boundary_load;
  if (!boundary.empty()) force += boundary[node];
  if (!viscous.empty()) force += viscous[node];
  const auto at = std::lower_bound(interface.node.begin(), interface.node.end(), static_cast<std::int32_t>(node));
  if (at == interface.node.end() || *at != static_cast<std::int32_t>(node)) return force;
  const auto k = static_cast<std::size_t>(at - interface.node.begin());
  if (!incoming.force.empty()) force += incoming.force[k];
  if (!baseline.force.empty()) force += baseline.force[k];
  return force;
}

Vec3 CoupledGround::unbalanced_force(std::size_t node) const {
  return nodal_force(node).cwiseProduct(integrator.is_free()[node]);
}

Vec3 CoupledGround::support_force(std::size_t node) const {
  const Vec3 held = nodal_force(node).cwiseProduct(integrator.is_free()[node] - Vec3::Ones());
  return kept_reaction.empty() ? held : Vec3(held + kept_reaction[node]);
}

void CoupledGround::guard_step() {
  if (!incoming.node_stiffness.empty()) guard.limits.set_contacts(incoming.node_stiffness);
  if (incoming.stable_step != guard.told_limit) {
    guard.told_limit = incoming.stable_step;
    guard.limits.set_grains(incoming.stable_step, incoming.limited_by);
  }
  time += step_sizes.out_of;
  ++step;
  step_sizes.into = step_sizes.out_of;
  const double wanted = guard.wanted();
  if (wanted >= step_sizes.out_of) return;
  const std::string why = fmt::format("limited by {} (zones {:.4g} s, with contacts {:.4g} s, grains {:.4g} s)",
                                      guard.limits.culprit(interface.position), guard.limits.zones_limit(),
                                      guard.limits.interface_limit(), guard.limits.grains_limit());
  if (guard.is_strict)
    throw NumericalError(fmt::format(
        "step {}: {:.4g} s, {:.3g} of the stable step, is all that is left of the {:.4g} s in use, and "
        "coupling.when_limit_drops is STOP: {}; or lower fidelity.step_fraction, which leaves room for new contacts",
        step, wanted, guard.fraction, step_sizes.out_of, why));
  ++guard.cuts;
  step_sizes.out_of = wanted;
  if (wanted < (1 - logged_step_drop) * guard.logged_step) {
    spdlog::info("step {}: time step cut to {:.4g} s, {}", step, wanted, why);
    guard.logged_step = wanted;
  }
}

}  // namespace lockstep::continuum
