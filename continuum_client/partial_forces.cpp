#include "continuum_client/partial_forces.hpp"

#include <algorithm>

namespace lockstep::continuum {

PartialForces::PartialForces(const std::vector<NodeRange>& ranges) : ranges_(ranges), first_(ranges.size()) {
  constexpr std::int32_t spare = 2 * nodes_at_once;
  for (std::size_t r = 0; r < ranges.size(); ++r) {
    memory_.emplace_back(3 * static_cast<std::size_t>(ranges[r].reach - ranges[r].begin + spare), 0.0);
    std::size_t first = r;
    while (first > 0 && ranges[first - 1].reach > ranges[r].begin) --first;
    first_[r] = first;
  }
}

Components PartialForces::components(std::size_t r) {
  double* const x = memory_[r].data();
  const std::size_t stride = memory_[r].size() / 3;
  return {x, x + stride, x + 2 * stride};
}

Components PartialForces::clear(std::size_t r) {
  std::fill(memory_[r].begin(), memory_[r].end(), 0.0);
  return components(r);
}

void PartialForces::join(std::size_t r, const StiffnessKernel& kernel, const double* reference, double* f) {
  Components part[ranges_wanted + 1];
  std::int32_t begin[ranges_wanted + 1];
  // Where an earlier range ends reaching into this one, the number of parts changes.
  for (std::int32_t at = ranges_[r].begin; at < ranges_[r].end;) {
    std::int32_t stop = ranges_[r].end, parts = 0;
    for (std::size_t p = first_[r]; p <= r; ++p) {
      if (p < r && ranges_[p].reach <= at) continue;
      if (p < r) stop = std::min(stop, ranges_[p].reach);
      part[parts] = components(p);
      begin[parts++] = ranges_[p].begin;
    }
    kernel.join(reference, part, begin, parts, at, stop, f);
    at = stop;
  }
}

}  // namespace lockstep::continuum
