#include "dem_server/force_network.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace lockstep::dem {

namespace {

constexpr double force_bin = 0.1;         // of F_n over its mean: 30 bins hold 95 % of an exponential tail
constexpr double most_force_bins = 1000;  // one contact that carries everything
                                          // must not make a file of its own size
constexpr std::size_t mobilisation_bins = 20;
constexpr double slides = 0.99;  // springs are of the last step, normal forces
                                 // of the present positions: a step apart

Histogram histogram(const std::vector<double>& values, double bin_width, std::size_t bins) {
  Histogram h{bin_width, std::vector<std::size_t>(bins, 0)};
  for (const double v : values) ++h.counts[std::min(bins - 1, static_cast<std::size_t>(v / bin_width))];
  return h;
}

}  // namespace

double mobilisation_of(const ContactView& c, double friction) {
  const double limit = friction * normal_force_of(c);
  return limit > 0 ? std::min(1.0, shear_force_of(c).norm() / limit) : 0.0;
}

std::size_t Histogram::total() const { return std::accumulate(counts.begin(), counts.end(), std::size_t{0}); }

double Histogram::density(std::size_t n) const {
  const std::size_t all = total();
  return all ? static_cast<double>(counts[n]) / (static_cast<double>(all) * bin_width) : 0.0;
}

ForceNetwork force_network(std::span<const ContactView> contacts, double friction) {
  std::vector<double> force, mobilised;
  for (const ContactView& c : contacts) {
    const double normal = normal_force_of(c);
    if (c.body_b < 0 || !(normal > 0)) continue;
    force.push_back(normal);
    mobilised.push_back(mobilisation_of(c, friction));
  }
  ForceNetwork n;
  n.contacts = force.size();
  n.mobilisation = histogram(mobilised, 1.0 / mobilisation_bins, mobilisation_bins);
  if (force.empty()) {
    n.normal_force = {force_bin, {0}};
    return n;
  }
  const auto count = static_cast<double>(force.size());
  const double sum = std::accumulate(force.begin(), force.end(), 0.0);
  n.mean_normal_force = sum / count;
  std::size_t strong = 0;
  double carried = 0;
  for (double& f : force) {
    if (f > n.mean_normal_force) ++strong, carried += f;
    f /= n.mean_normal_force;
  }
  n.strong_share = static_cast<double>(strong) / count;
  n.strong_force_share = carried / sum;
  n.largest_over_mean = *std::max_element(force.begin(), force.end());
  n.mean_mobilisation = std::accumulate(mobilised.begin(), mobilised.end(), 0.0) / count;
  n.sliding_share =
      static_cast<double>(std::count_if(mobilised.begin(), mobilised.end(), [](double m) { return m >= slides; })) /
      count;
  const double width = std::max(force_bin, n.largest_over_mean / (most_force_bins - 1));
  n.normal_force = histogram(force, width, static_cast<std::size_t>(n.largest_over_mean / width) + 1);
  return n;
}

}  // namespace lockstep::dem
