#include "dem_server/ledger.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dem_server/cycle.hpp"

namespace lockstep::dem {

void Ledger::book(const Model& m) {
  if (!is_kept) {
    book_stored(m);
    return;
  }
  book_energy(m);
  book_momentum(m);
  has_last_ = true;
}

void Ledger::book_stored(const Model& m) {
  now_.kinetic = m.motion.kinetic_energy();
  if (m.detail != Detail::All) return;
  now_.elastic = m.pair_totals.elastic_energy() + m.facet_totals.elastic_energy + m.wall_totals.elastic_energy;
  if (m.pile) now_.elastic += m.pile_totals.all().elastic_energy;
}

void Ledger::book_energy(const Model& m) {
  book_stored(m);
  // Works of step n are centred on t_n: half of each belongs to the interval before it and half to the one after.
  const double gravity = m.motion.gravity_work;
  const double damped = m.motion.damped_work;
  double boundary = 0;
  double friction = m.pair_totals.slip_work + m.facet_totals.slip_work + m.wall_totals.slip_work;
  double dashpots = m.pair_totals.dashpot_work + m.facet_totals.dashpot_work + m.wall_totals.dashpot_work;
  if (m.pile) {
    const WallTotals pile = m.pile_totals.all();
    boundary += pile.power * m.last_time_step;
    friction += pile.slip_work;
    dashpots += pile.dashpot_work;
  }

  const Vec3s& force = m.facets.nodal_force();
  if (has_last_) {
    double interface = 0;  // on the grains: minus that on the nodes
    const Vec3s& velocity = m.facets.velocity();
    for (std::size_t j = 0; j < force.size(); ++j)
      interface -= 0.5 * (last_nodal_force_[j] + force[j]).dot(velocity[j]) * m.last_time_step;
    now_.gravity_work += 0.5 * (last_gravity_ + gravity);
    now_.damped += 0.5 * (last_damped_ + damped);
    now_.boundary_work += 0.5 * (last_boundary_ + boundary) + m.wall_totals.work;
    now_.interface_work += interface;
    now_.friction += friction;
    now_.dashpots += dashpots;
    work_done_ += std::abs(0.5 * (last_gravity_ + gravity)) + std::abs(0.5 * (last_boundary_ + boundary)) +
                  std::abs(m.wall_totals.work) + std::abs(interface) + friction + dashpots +
                  0.5 * (last_damped_ + damped);
  }
  last_gravity_ = gravity;
  last_damped_ = damped;
  last_boundary_ = boundary;
  last_nodal_force_ = force;
  if (m.detail != Detail::All) return;
  const double balance =
      now_.kinetic + now_.elastic -
      (now_.gravity_work + now_.boundary_work + now_.interface_work - now_.damped - now_.friction - now_.dashpots);
  if (!std::exchange(has_start_, true)) start_ = now_, start_balance_ = balance;
  residual_ = balance - start_balance_;
}

void Ledger::book_momentum(const Model& m) {
  const Vec3 reaction = m.facet_totals.particle_force;
  Vec3 action = Vec3::Zero();
  for (const Vec3& f : m.facets.nodal_force()) action += f;
  worst_reaction_ = std::max(worst_reaction_, (reaction + action).norm());
  largest_reaction_ = std::max(largest_reaction_, reaction.norm());

  if (!m.is_fixed.empty()) return;
  const double weight = m.motion.moving_mass * m.gravity.z();
  const double interval = 0.5 * (m.last_time_step + m.time_step);
  const double inertia = interval > 0 ? m.motion.momentum_change.z() / interval : 0.0;
  double walls = -m.wall_totals.force.z();
  if (m.pile) walls -= m.pile_totals.tip_force.z() + m.pile_totals.shaft_force.z();
  imbalance_ = walls + weight + reaction.z() + m.motion.damping_force.z() - inertia;
  worst_imbalance_ = std::max(worst_imbalance_, std::abs(imbalance_));
  for (const double term : {walls, weight, reaction.z(), m.motion.damping_force.z(), inertia})
    largest_term_ = std::max(largest_term_, std::abs(term));
}

}  // namespace lockstep::dem
