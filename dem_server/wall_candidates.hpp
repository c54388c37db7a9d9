// Which pebbles a wall looks at: those that could touch it before its list is made anew.
//
// travel.hpp says how far pebble p may stray from its mark until the pair lists are renewed: limit(p). A wall's points
// move too; a list bears `allowance` of that. So the gap between wall and pebble falls by less than limit + allowance
// while the list lives, and a pebble whose gap is wider is left out and costs nothing. The result does not depend on
// the lists. Without marks nothing is known of the next step, and a list is made for each.
#pragma once
#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/checks.hpp"
#include "common/parallel.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/travel.hpp"

namespace lockstep::dem {

// A list bears this much travel of its wall, over the mean radius: at 0.1 a wall that moves by 1e-5 R a step asks for a
// list each 10,000 steps and has few pebbles too many.
inline constexpr double wall_allowance = 0.1;

struct PebbleRange {
  std::int32_t begin = 0, end = 0;
};

// The pebbles of the bodies of one of partition.parts(threads) parts.
inline PebbleRange pebbles_of_part(const Particles& particles, const Partition& partition, int threads, int part) {
  const auto k = static_cast<std::size_t>(part);
  if (partition.size() > 0)
    return {particles.pebble_begin(static_cast<std::size_t>(partition.body_begin[k])),
            particles.pebble_begin(static_cast<std::size_t>(partition.body_begin[k + 1]))};
  const auto [first, last] = share_of(particles.body_count(), part, threads);
  return {particles.pebble_begin(first), particles.pebble_begin(last)};
}

// A sphere around each so many pebbles, one after the other, and all that they reach: what keeps clear of it keeps clear of
// them. Neighbours in the list are neighbours in space, so that a wall looks at few groups' pebbles.
inline constexpr std::size_t pebble_group = 64;
inline std::vector<SphereRecord> groups_of(const Particles& particles, const TravelLimits& limits) {
  std::vector<SphereRecord> groups;
  const std::size_t pebbles = particles.pebble_count();
  const SphereRecord* at = limits.marks ? limits.marks : particles.pebbles();
  for (std::size_t first = 0; first < pebbles; first += pebble_group) {
    Vec3 low = Vec3(&at[first].x), high = low;
    double reach = 0;
    for (std::size_t p = first; p < std::min(first + pebble_group, pebbles); ++p) {
      low = low.cwiseMin(Vec3(&at[p].x)), high = high.cwiseMax(Vec3(&at[p].x));
      reach = std::max(reach, particles.pebble_radius(p) + (limits.marks ? limits.limit(p) : 0));
    }
    const Vec3 center = 0.5 * (low + high);
    groups.push_back({center.x(), center.y(), center.z(), 0.5 * (high - low).norm() + reach});
  }
  return groups;
}

class WallCandidates {
 public:
  // Whether the list still holds for these limits and so many pebbles.
  bool is_fresh(const TravelLimits& limits, std::size_t pebbles) const {
    return is_known_ && limits.marks && limits.renewal == renewal_ && pebbles == pebble_count_ && way_ <= allowance_;
  }
  // The wall's points have moved by no more than this [m].
  void wall_moved(double way) { way_ += way; }
  void forget() { is_known_ = false; }

  // Lists anew. could_touch(pebble, center, reach, extra) says whether a sphere of radius `reach` around `center` meets
  // the wall and may add what else it found to `extra`. `allowance` [m]. With `groups`, groups_of() these limits, pebbles
  // of a group whose sphere does not meet the wall are not asked for.
  template <class CouldTouch>
  void renew(const Particles& particles, const TravelLimits& limits, double allowance, Team& team,
             const Partition& partition, CouldTouch&& could_touch, const std::vector<SphereRecord>& groups = {}) {
    parts_.resize(static_cast<std::size_t>(partition.parts(team.size())));
    team.run_parts(partition.parts(team.size()), [&](int k) {
      Part& part = parts_[static_cast<std::size_t>(k)];
      part.pebbles.clear(), part.extra_end.clear(), part.extra.clear();
      const PebbleRange range = pebbles_of_part(particles, partition, team.size(), k);
      std::int32_t clear_until = range.begin;
      for (std::int32_t p = range.begin; p < range.end; ++p) {
        const auto i = static_cast<std::size_t>(p);
        if (!groups.empty() && (p == range.begin || i % pebble_group == 0)) {
          const SphereRecord& group = groups[i / pebble_group];
          const double reach = group.radius + (limits.marks ? allowance : 0);
          std::vector<std::int32_t> unused;
          if (!could_touch(i, Vec3(group.x, group.y, group.z), reach, unused))
            clear_until = static_cast<std::int32_t>((i / pebble_group + 1) * pebble_group);
        }
        if (p < clear_until) continue;
        const SphereRecord& at = limits.marks ? limits.marks[i] : particles.pebbles()[i];
        const double reach = particles.pebble_radius(i) + (limits.marks ? limits.limit(i) + allowance : 0);
        if (!could_touch(i, Vec3(at.x, at.y, at.z), reach, part.extra)) continue;
        part.pebbles.push_back(p);
        part.extra_end.push_back(static_cast<std::int32_t>(part.extra.size()));
      }
    });
    pebbles_.clear(), extra_begin_.assign(1, 0), extra_.clear();
    for (const Part& part : parts_) {
      const auto before = static_cast<std::int32_t>(extra_.size());
      pebbles_.insert(pebbles_.end(), part.pebbles.begin(), part.pebbles.end());
      for (const std::int32_t end : part.extra_end) extra_begin_.push_back(before + end);
      extra_.insert(extra_.end(), part.extra.begin(), part.extra.end());
    }
    is_known_ = true;
    renewal_ = limits.renewal;
    pebble_count_ = particles.pebble_count();
    allowance_ = allowance;
    way_ = 0;
    ++renewals_;
  }

  std::size_t size() const { return pebbles_.size(); }
  std::int32_t pebble(std::size_t i) const { return pebbles_[i]; }  // rising
  const std::int32_t* pebbles() const { return pebbles_.data(); }
  // The candidates that are pebbles of `range`: first, and one behind the last.
  std::pair<std::size_t, std::size_t> within(const PebbleRange& range) const {
    const auto place = [&](std::int32_t p) {
      return static_cast<std::size_t>(std::lower_bound(pebbles_.begin(), pebbles_.end(), p) - pebbles_.begin());
    };
    return {place(range.begin), place(range.end)};
  }
  // What could_touch added for candidate i: a mesh's triangles, an interface's facets.
  const std::int32_t* extra(std::size_t i) const { return extra_.data() + extra_begin_[i]; }
  std::size_t extra_count(std::size_t i) const {
    return static_cast<std::size_t>(extra_begin_[i + 1] - extra_begin_[i]);
  }
  // That of candidates before i, counted; and all of it, candidate by candidate.
  std::int32_t extra_begin(std::size_t i) const { return extra_begin_[i]; }
  const std::vector<std::int32_t>& extras() const { return extra_; }
  std::uint64_t renewals() const { return renewals_; }

 private:
  struct Part {
    std::vector<std::int32_t> pebbles, extra_end, extra;
  };
  std::vector<std::int32_t> pebbles_;
  std::vector<std::int32_t> extra_begin_ = {0}, extra_;
  std::vector<Part> parts_;
  bool is_known_ = false;
  std::uint64_t renewal_ = 0;
  std::size_t pebble_count_ = 0;
  double allowance_ = 0, way_ = 0;  // [m]
  std::uint64_t renewals_ = 0;
};

}  // namespace lockstep::dem
