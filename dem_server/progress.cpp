#include "dem_server/progress.hpp"

#include "common/log.hpp"

namespace lockstep::dem {

bool ProgressLines::is_due() {
  constexpr double interval = 0.5;  // [s]
  if (!is_wanted_ || (has_shown_ && since_last_.seconds() < interval)) return false;
  has_shown_ = true;
  since_last_.restart();
  return true;
}

void ProgressLines::show_packing(double fraction) {
  if (is_due()) print_progress(fmt::format("side=grains stage=Balance fraction={:.3f}", fraction));
}

void ProgressLines::show(std::string_view stage, const Model& m, double unbalanced_ratio, std::string_view more) {
  if (!is_due()) return;
  const double waiting = m.profile.seconds(Phase::WaitForPeer), total = m.profile.total();
  print_progress(fmt::format("side=grains stage={} step={} time={:.6g} unbalanced={:.3e} wait={:.3f}{}{}", stage,
                             m.step, m.time, unbalanced_ratio, total > 0 ? waiting / total : 0.0,
                             more.empty() ? "" : " ", more));
}

}  // namespace lockstep::dem
