#include "dem_server/exchange.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/checks.hpp"
#include "common/log.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

Exchange::Exchange(protocol::Session& session, Model& model, const Settings& settings, Course& course, Output& output,
                   Watch& watch)
    : session_(session),
      model_(model),
      settings_(settings),
      course_(course),
      output_(output),
      watch_(watch),
      parts_(settings.exchange_interval) {}

// ------------------------------------------------------------------------------------------------ the limit of the step

const StepLimit& Exchange::agree_on_step(const protocol::ContinuumExcavated& theirs) {
  const Model& m = model_;
  if (theirs.position_hash != 0 && theirs.position_hash != m.facets.position_hash())
    throw PeerError(fmt::format(
        "ContinuumExcavated.position_hash is {:016x}, but the nodes sent with InitialStress hash to {:016x}: "
        "the peer has moved its interface since",
        theirs.position_hash, m.facets.position_hash()));
  told_limit_ = CoupledLimit(theirs.stiffness, parts_);
  // A node that nothing touches yet counts as if one grain did: a first touch must not find too long a step.
  const double first_touch = m.facet_material.normal_stiffness(m.particles.largest_radius());
  told_stiffness_ = m.facets.node_stiffness();
  for (double& k : told_stiffness_) k = std::max(k, first_touch);
  told_limit_.set_contacts(told_stiffness_);
  limit_ = grains_limit();
  protocol::GrainsExcavated reply;
  reply.offset = m.facets.offsets();
  reply.node_stiffness = told_stiffness_;
  reply.stable_step = parts_ * limit_.step;
  reply.limited_by = culprit();
  told_limit_.set_grains(reply.stable_step, reply.limited_by);
  reply.nodal_force = m.facets.nodal_force();
  reply.position_hash = m.facets.position_hash();
  session_.send(reply);
  return limit_;
}

// The grains' limit on the ground as the peer described it, from the contacts of the moment.
StepLimit Exchange::grains_limit() const {
  const double damped = 1 + settings_.step_damping;
  StepLimit limit = stable_step(model_, settings_.step_damping);
  const double own = 4 / (limit.step * limit.step * damped);
  limit.step = 2 / std::sqrt(told_limit_.grains_on_ground(own, limit.touching_squared) * damped);
  return limit;
}

// Who sets the grains' limit, for messages.
std::string Exchange::culprit() const {
  if (limit_.worst_body < 0) return "the grains (a first touch of the lightest one)";
  const Vec3 x = std::as_const(model_.particles).position(limit_.worst_body);
  return fmt::format("grain {} at ({:.4g}, {:.4g}, {:.4g}) m", limit_.worst_body, x.x(), x.y(), x.z());
}

// With each answer.
void Exchange::tell_limit() {
  forces_.stable_step = parts_ * limit_.step;
  forces_.limited_by.clear();
  if (forces_.stable_step == told_limit_.grains_limit()) return;
  forces_.limited_by = culprit();
  told_limit_.set_grains(forces_.stable_step, forces_.limited_by);
}

// Node stiffness travels when one has grown by a tenth beyond what the peer knows.
void Exchange::tell_stiffness() {
  const std::vector<double>& now = model_.facets.node_stiffness();
  std::vector<double>& told = told_stiffness_;
  bool has_grown = false;
  for (std::size_t j = 0; j < now.size(); ++j) has_grown |= now[j] > stiffness_growth * told[j];
  forces_.node_stiffness.clear();
  if (!has_grown) return;
  for (std::size_t j = 0; j < now.size(); ++j) told[j] = std::max(told[j], now[j]);
  forces_.node_stiffness = told;
  told_limit_.set_contacts(told);
}

void Exchange::check_peer() const {
  const InterfaceFacets& facets = model_.facets;
  if (velocities_.position_hash != 0 && velocities_.position_hash != facets.position_hash())
    throw PeerError(
        fmt::format("Velocities({}).position_hash is {:016x}, the grains hold {:016x}: the two sides no longer agree "
                    "where the interface is; both must do x += v * time_step in double precision",
                    velocities_.step, velocities_.position_hash, facets.position_hash()));
  // A scene may ask for more than the limit, knowingly.
  const double allowed = std::max(1.0, settings_.step_fraction) * told_limit_.limit();
  if (velocities_.time_step > allowed)
    throw NumericalError(
        fmt::format("Velocities({}).time_step is {:.4e} s, but zones and grains together are stable up to {:.4e} s "
                    "(zones {:.4e} s, "
                    "with contacts {:.4e} s, grains {:.4e} s), as both sides know since Forces({}) or "
                    "GrainsExcavated; the limit is "
                    "that of {}. The peer owns the step and must keep below",
                    velocities_.step, velocities_.time_step, told_limit_.limit(), told_limit_.zones_limit(),
                    told_limit_.interface_limit(), told_limit_.grains_limit(), velocities_.step - 1,
                    told_limit_.culprit(facets.positions())));
}

// ---------------------------------------------------------------------------------------------------- steps 5 and 6

void Exchange::run() {
  if (settings_.keeps_ledger) ledger_.emplace(settings_.stop_if_energy_error);
  while (cycle(model_, *this)) {
    course_.record_step();
    take_stock();
  }
}

bool Exchange::move_facets(Model& m) {
  if (is_last_part()) {
    const auto timing = m.profile.measure(Phase::WaitForPeer);
    if (!session_.receive_or_finish(velocities_)) return false;
    exchange_parts_ = last_step_ > 0 ? parts_ : 1;
    part_ = 0;
  }
  ++part_;
  m.facets.advance_part(velocities_.velocity, last_step_, part_, exchange_parts_);
  m.time_step = (is_last_part() ? velocities_.time_step : last_step_) / parts_;
  if (is_last_part()) check_peer();
  if (velocities_.stage == protocol::Stage::Penetrate && !course_.is_penetrating()) course_.begin_penetration();
  course_.prepare_step(is_last_part() && (velocities_.step + 1) % ledger_interval == 0);
  return true;
}

void Exchange::take_forces(Model&) {
  add_forces();
  if (!is_last_part()) return;
  if (exchange_parts_ > 1) take_mean();
  forces_.step = velocities_.step;
  forces_.unbalanced_ratio = course_.unbalanced_ratio();
  tell_limit();
  forces_.is_done = course_.is_over();
  forces_.energies = energies_;
  tell_stiffness();
  session_.send(forces_);
}

// Of this step; the sum over the exchange so far where it has several.
void Exchange::add_forces() {
  const Vec3s& force = model_.facets.nodal_force();
  const FacetTotals& totals = model_.facet_totals;
  if (part_ == 1) {
    forces_.force = force;
    forces_.particle_force = totals.particle_force, forces_.particle_moment = totals.particle_moment;
    forces_.neglected_moment = totals.neglected_moment;
    return;
  }
  for (std::size_t j = 0; j < force.size(); ++j) forces_.force[j] += force[j];
  forces_.particle_force += totals.particle_force, forces_.particle_moment += totals.particle_moment;
  forces_.neglected_moment += totals.neglected_moment;
}

void Exchange::take_mean() {
  const double share = 1.0 / exchange_parts_;
  for (Vec3& f : forces_.force) f *= share;
  forces_.particle_force *= share, forces_.particle_moment *= share, forces_.neglected_moment *= share;
}

void Exchange::take_stock() {
  const Model& m = model_;
  if (m.step % limit_interval == 0) {
    const StepLimit now = grains_limit();
    if (now.step < limit_.step) limit_ = now;
  }
  if (!is_last_part()) return;
  if (ledger_) book_exchange();
  if (ledger_ && m.step % settings_.history_interval == 0) output_.record_interface(*ledger_);
  last_step_ = velocities_.time_step;
  energies_.reset();
  if (m.detail == Detail::All && settings_.keeps_ledger) {
    const GrainEnergies& e = m.ledger.energies();
    energies_ = {e.kinetic,  e.elastic,       e.gravity_work,  e.damped + e.dashpots,
                 e.friction, e.boundary_work, e.interface_work};
  }
  if ((velocities_.step + 1) % good_state_interval == 0) watch_.keep_good_state(m);
}

// Forces of this exchange, energies of the end of the last one.
void Exchange::book_exchange() {
  const InterfaceFacets& facets = model_.facets;
  InterfaceSums sums;
  for (const Vec3& f : forces_.force) sums.nodes_force += f;
  sums.nodes_moment = moment_of(facets.positions(), forces_.force) + moment_of(facets.offsets(), forces_.force);
  sums.particles_force = forces_.particle_force, sums.particles_moment = forces_.particle_moment;
  ledger_->book_interface(velocities_.step, model_.time,
                          0.5 * ((last_step_ > 0 ? last_step_ : velocities_.time_step) + velocities_.time_step), sums);
  if (!energies_) return;
  ledger_->book_energies(*energies_, velocities_.energies);
  if (const std::string words = ledger_->alarm(); !words.empty()) throw NumericalError(words);
}

}  // namespace lockstep::dem
