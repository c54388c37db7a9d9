#include "dem_server/reversal.hpp"

#include <algorithm>

namespace lockstep::dem {

void Reversal::observe(std::uint64_t step, const Particles& p) {
  const std::uint64_t left = (reversal_interval - step % reversal_interval) % reversal_interval;
  const std::size_t count = p.body_count();
  if (left == 2) {
    before_.resize(count), change_.clear();
    for (std::size_t b = 0; b < count; ++b) before_[b] = p.velocity(b);
  } else if (left == 1 && before_.size() == count) {
    change_.resize(count);
    for (std::size_t b = 0; b < count; ++b) change_[b] = p.velocity(b) - before_[b], before_[b] = p.velocity(b);
  } else if (left == 0 && count > 0 && change_.size() == count) {
    double turned = 0, all = 0;
    for (std::size_t b = 0; b < count; ++b) {
      const Vec3 change = p.velocity(b) - before_[b];
      turned -= p.mass(b) * change.dot(change_[b]);
      all += 0.5 * p.mass(b) * (change.squaredNorm() + change_[b].squaredNorm());
    }
    change_.clear();
    add(all > 0 ? turned / all : -1.0, all);
  }
}

void Reversal::add(double share, double strength) {
  const int now = looks_ % reversal_looks, first = (looks_ + 1) % reversal_looks;
  last_[now] = share, strength_[now] = strength;
  is_dying_ = strength < dying_share * strength_[first];
  looks_ = looks_ + 1 < 2 * reversal_looks ? looks_ + 1 : reversal_looks;
  mean_ = 0;
  for (const double look : last_) mean_ += look / reversal_looks;
}

}  // namespace lockstep::dem
