// How far pebbles may move before candidate lists are made anew, and which bodies belong to which thread.
#pragma once
#include <cstdint>
#include <limits>
#include <vector>

#include "dem_server/records.hpp"

namespace lockstep::dem {

// PairContacts renews its lists before any pebble has moved farther than its limit from its mark. Walls, pile and facets
// make their own candidate lists when `renewal` has changed: until it changes again, pebble p stays within limit(p) of
// mark p, and its radius grows by no more than `growth_limit`.
struct TravelLimits {
  std::uint64_t renewal = 0;  // counts up with each renewal
  const SphereRecord* marks =
      nullptr;              // per pebble: centre at the renewal, and in `radius` the limit [m]; null: unknown
  double growth_limit = 0;  // [m]
  double limit(std::size_t p) const {
    return marks ? marks[p].radius + growth_limit : std::numeric_limits<double>::infinity();
  }
};

// Bodies of part p: body_begin[p] .. body_begin[p+1]-1. A part is what one thread works on at a time; which bodies are in
// which part decides speed alone.
struct Partition {
  std::vector<std::int32_t> body_begin;
  int size() const { return body_begin.empty() ? 0 : static_cast<int>(body_begin.size()) - 1; }
  // Without parts, a thread's equal share is one.
  int parts(int threads) const { return size() > 0 ? size() : threads; }
};

}  // namespace lockstep::dem
