#include "dem_server/watch.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/checks.hpp"
#include "common/log.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

Watch::Watch(const Model& start, const Settings& settings, bool watches_shivering)
    : settings_(settings), watches_shivering_(watches_shivering) {
  const Particles& p = start.particles;
  for (std::size_t b = 0; b < p.body_count(); ++b) reach_ = std::max(reach_, p.position(b).norm());
  for (const Vec3& x : start.facets.positions()) reach_ = std::max(reach_, x.norm());
  if (!settings.is_alone) return;
  // No ground says how wide the scene is: what flies and falls freely as long as the run lasts is still in it.
  double speed = 0;
  for (std::size_t b = 0; b < p.body_count(); ++b) speed = std::max(speed, p.velocity(b).norm());
  reach_ += settings.run_duration * (speed + 0.5 * settings.gravity * settings.run_duration);
}

void Watch::look_at_packing(const Model& m) const {
  check_motion(m);
  warn_of_tunnelling(m);
}

void Watch::look(const Model& m) const {
  check_motion(m);
  check_overlap(m);
  warn_of_tunnelling(m);
}

void Watch::check_motion(const Model& m) const {
  if (!std::isfinite(m.motion.kinetic_energy()))
    throw NumericalError(
        fmt::format("step {}: the grains' kinetic energy is not finite; the run went unstable: lower "
                    "fidelity.step_fraction (now {})",
                    m.step, settings_.step_fraction));
  for (std::size_t b = 0; b < m.particles.body_count(); ++b)
    if (const Vec3 x = m.particles.position(b); !(x.norm() < farthest * reach_))
      throw NumericalError(
          fmt::format("step {}: grain {} has left the scene (now at {:.3g} {:.3g} {:.3g} m): it went through a wall or "
                      "nothing holds it; close the scene with walls, or lower fidelity.step_fraction (now {})",
                      m.step, b, x.x(), x.y(), x.z(), settings_.step_fraction));
}

void Watch::check_overlap(const Model& m) const {
  const double overlap = std::max(m.pair_totals.largest_overlap_ratio, m.facet_totals.max_overlap);
  if (overlap > alarming_overlap)
    throw NumericalError(
        fmt::format("step {}: an overlap of {:.2f} R is no contact any more; stiffen grains.contact_modulus (now "
                    "{:.3g} Pa), slow fidelity.pile_velocity down or lower fidelity.step_fraction (now {})",
                    m.step, overlap, settings_.material.contact_modulus, settings_.step_fraction));
}

void Watch::warn_of_tunnelling(const Model& m) const {
  if (m.facets.tunnelled() > 0)
    spdlog::warn("step {}: {} pebbles have sunk more than half their radius through the interface", m.step,
                 m.facets.tunnelled());
}

void Watch::look_for_shivering(const Model& m, double unbalanced_ratio) {
  if (!watches_shivering_ || !(m.damping > 0)) return;
  reversal_.observe(m.step, m.particles);
  if (reversal_.is_alarming() && unbalanced_ratio > Reversal::least_unbalanced_ratio)
    throw NumericalError(fmt::format(
        "step {}: the grains' accelerations turn from each step to the next (share {:.2f} over {} looks, where motion "
        "that "
        "the steps follow has -0.6 and below; unbalanced ratio {:.1e}): the packing shivers instead of resting; lower "
        "fidelity.step_fraction (now {})",
        m.step, reversal_.mean_share(), Reversal::reversal_looks, unbalanced_ratio, settings_.step_fraction));
}

void Watch::keep_good_state(const Model& m) {
  look(m);
  good_states_.keep(m.step, m.time, state_of(m));
}

void Watch::return_to_good_state(Model& m) {
  const std::uint64_t failed_at = m.step;
  const auto* good = good_states_.before(failed_at, good_state_age * settings_.exchange_interval);
  if (!good) return;
  restore(m, good->state);
  m.step = good->step, m.time = good->time;
  m.detail = Detail::All;
  evaluate_forces(m);
  spdlog::error("failed at step {}; the last files show step {}, the last one known to be sound", failed_at, m.step);
}

}  // namespace lockstep::dem
