// The last sound states of a run, for what a run that fails shows at the end: not the wreck, but the last state before it.
#pragma once
#include <cstdint>
#include <deque>
#include <utility>

namespace lockstep {

// Exchanges between two states that are kept, and how far before the failure one must be: the alarms come within a hundred
// steps.
inline constexpr std::uint64_t good_state_interval = 500;
inline constexpr std::uint64_t good_state_age = 100;

template <class State>
class GoodStates {
 public:
  struct Entry {
    std::uint64_t step = 0;
    double time = 0;  // [s]
    State state;
  };

  // Two are enough: when the newest is too young, the one before is old.
  void keep(std::uint64_t step, double time, State state) {
    if (entries_.size() == 2) entries_.pop_front();
    entries_.push_back({step, time, std::move(state)});
  }

  // The newest one that is at least `age` steps older than the failure; null: there is none.
  Entry* before(std::uint64_t failed_at, std::uint64_t age) {
    for (auto entry = entries_.rbegin(); entry != entries_.rend(); ++entry)
      if (entry->step + age <= failed_at) return &*entry;
    return nullptr;
  }

 private:
  std::deque<Entry> entries_;  // oldest first
};

}  // namespace lockstep
