#include "dem_server/alone.hpp"

#include "common/log.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

bool NoPeer::move_facets(Model& m) {
  const bool is_timed_out = !settings_.pile && course_.time() >= settings_.run_duration;
  if (course_.is_over() || is_timed_out) return false;
  if (m.step % limit_interval == 0) renew_step(m);
  m.time_step = time_step_;
  course_.prepare_step(false);
  return true;
}

void NoPeer::renew_step(Model& m) {
  const StepLimit limit = stable_step(m, settings_.step_damping);
  const double step = settings_.step_fraction * limit.step;
  if (step >= time_step_) return;
  if (step < told_ / stiffness_growth) {
    spdlog::info("step {}: time step {:.4e} s, {} of the limit of grain {}", m.step, step, settings_.step_fraction,
                 limit.worst_body);
    told_ = step;
  }
  time_step_ = step;
}

}  // namespace lockstep::dem
