#include "dem_server/course.hpp"

#include <algorithm>

#include "common/interrupt.hpp"
#include "common/log.hpp"
#include "common/packet.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/make_model.hpp"

namespace lockstep::dem {

void Course::begin_apply() {
  part_ = Part::Apply;
  stages_.begin();
  Model& m = model_;
  m.damping = settings_.has_apply ? settings_.apply_damping : settings_.run_damping;
  m.walls.set_moving(false, true);
  m.walls.end_balance();
  set_friction(m, settings_, settings_.material.friction, 1);
  m.time = 0;
  m.step = 0;
  m.last_time_step = 0;
  m.ledger.restart();
  m.ledger.is_kept = settings_.keeps_ledger;
  if (m.pile) pile_start_ = m.pile->tip_z();
  if (settings_.packet)
    for (std::size_t b = 0; b < m.particles.body_count(); ++b)
      if (m.is_fixed.empty() || !m.is_fixed[b])
        m.particles.velocity(b) += packet_velocity(*settings_.packet, m.particles.position(b));
  output_.snapshot(m, settings_);
}

void Course::begin_penetration() {
  Model& m = model_;
  const double ratio = dem::unbalanced_ratio(m);
  spdlog::info("stage Apply (paper step 4): {} steps, {:.3g} s of ground time, unbalanced ratio {:.1e}, {:.1f} s",
               m.step, m.time, ratio, stages_.seconds());
  stages_.end("Apply", Json().add("steps", m.step).add("unbalanced_ratio", m.step ? ratio : 0.0));
  part_ = Part::Penetrate;
  stages_.begin();
  m.damping = settings_.run_damping;
  m.walls.set_moving(true, true);
  if (m.pile) pile_start_ = m.pile->tip_z();
  penetration_begin_ = m.time;
  next_snapshot_ = 0;
}

void Course::finish() {
  const Model& m = model_;
  if (is_penetrating())
    spdlog::info(
        "stage Velocities, Forces, Advance (paper steps 5 to 7): {} steps, S/D {:.3f}, tip {:.3g} MPa, shaft {:.3g} "
        "kN, "
        "{:.1f} s",
        m.step, s_over_d(), output_.tip_resistance() / 1e6, output_.shaft_force() / 1e3, stages_.seconds());
  stages_.end(is_penetrating() ? "Penetrate" : "Apply", Json().add("steps", m.step).add("s_over_d", s_over_d()));
  output_.snapshot(m, settings_);
}

void Course::prepare_step(bool is_booked) {
  Model& m = model_;
  if (is_penetrating() && m.pile) {
    const PileSettings& pile = *settings_.pile;
    m.pile->set_velocity(-pile.velocity * std::min(1.0, time() / pile.speed_ramp));
  }
  const std::uint64_t step = m.step + 1;
  const auto is_due = [&](std::uint32_t interval) { return interval > 0 && step % interval == 0; };
  const bool is_measured = is_booked || step == 1 || is_due(heartbeat_interval) || is_due(settings_.history_interval) ||
                           (settings_.measure.is_any() && is_due(settings_.measure.interval));
  m.detail = is_measured ? Detail::All : settings_.keeps_ledger ? Detail::Works : Detail::Forces;
}

void Course::record_step() {
  const Model& m = model_;
  if (m.detail == Detail::All) {
    ratio_ = dem::unbalanced_ratio(m);
    contacts_ = touching_contacts(m);
  }
  watch_.look_for_shivering(m, ratio_);
  output_.record(m, s_over_d(), ratio_);
  if (m.step % heartbeat_interval == 0) {
    watch_.look(m);
    show_progress();
  }
  if (settings_.is_alone && m.step % good_state_interval == 0) watch_.keep_good_state(m);
  snapshot_if_due();
}

void Course::snapshot_if_due() {
  if (!is_penetrating() || settings_.snapshot_interval <= 0) return;
  const double now = settings_.pile ? s_over_d() : time();
  if (now < next_snapshot_) return;
  output_.snapshot(model_, settings_);
  next_snapshot_ += settings_.snapshot_interval;
}

void Course::show_progress() {
  std::string more;
  if (settings_.pile && is_penetrating())
    more = fmt::format("fraction={:.4f} sd={:.4f} tip_kpa={:.1f}", penetration() / settings_.pile->penetration,
                       s_over_d(), output_.tip_resistance() / 1000);
  else if (settings_.is_alone && settings_.run_duration > 0)
    more = fmt::format("fraction={:.4f}", time() / settings_.run_duration);
  progress_.show(is_penetrating() ? "Penetrate" : "Apply", model_, ratio_, more);
}

bool Course::is_over() const {
  return interrupt_requested() || (settings_.pile && is_penetrating() && penetration() >= settings_.pile->penetration);
}

double Course::penetration() const {
  return part_ != Part::Before && model_.pile ? pile_start_ - model_.pile->tip_z() : 0.0;
}

double Course::s_over_d() const { return settings_.pile ? 0.5 * penetration() / settings_.pile->shape.radius : 0.0; }

}  // namespace lockstep::dem
