#include "dem_server/fabric.hpp"

#include <algorithm>
#include <cmath>

namespace lockstep::dem {

double PartnerCounts::mechanical_mean(std::size_t least) const {
  std::size_t sum = 0, bodies = 0;
  for (const std::size_t n : counts_)
    if (n >= least) sum += n, ++bodies;
  return bodies ? static_cast<double>(sum) / static_cast<double>(bodies) : 0.0;
}

std::size_t PartnerCounts::rattlers(std::size_t least) const {
  return static_cast<std::size_t>(
      std::count_if(counts_.begin(), counts_.end(), [&](std::size_t n) { return n < least; }));
}

std::vector<std::size_t> PartnerCounts::distribution() const {
  std::vector<std::size_t> bodies;
  for (const std::size_t n : counts_) {
    if (n >= bodies.size()) bodies.resize(n + 1, 0);
    ++bodies[n];
  }
  return bodies;
}

void Coordination::add(const ContactView& c) {
  if (c.body_b >= 0)
    pairs_.emplace_back(std::min(c.body_a, c.body_b), std::max(c.body_a, c.body_b));
  else
    walls_.push_back(c.body_a);
}

PartnerCounts Coordination::partners() const {
  auto pairs = pairs_;
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  std::vector<std::size_t> counts(bodies_, 0);
  for (const std::int32_t body : walls_) ++counts[static_cast<std::size_t>(body)];
  for (const auto& [a, b] : pairs) ++counts[static_cast<std::size_t>(a)], ++counts[static_cast<std::size_t>(b)];
  return PartnerCounts(std::move(counts));
}

std::size_t Coordination::partners_of(std::int32_t body) const {
  std::vector<std::int32_t> others;
  for (const auto& [a, b] : pairs_)
    if (a == body || b == body) others.push_back(a == body ? b : a);
  std::sort(others.begin(), others.end());
  const auto distinct = std::unique(others.begin(), others.end()) - others.begin();
  return static_cast<std::size_t>(distinct + std::count(walls_.begin(), walls_.end(), body));
}

void Fabric::add(const ContactView& c) {
  if (c.body_b < 0) return;
  sum_ += c.normal * c.normal.transpose();
  ++contacts_;
}

Voigt Fabric::tensor() const {
  const Mat3 f = contacts_ ? Mat3(sum_ / static_cast<double>(contacts_)) : Mat3(Mat3::Identity() / 3);
  Voigt v;
  v << f(0, 0), f(1, 1), f(2, 2), f(0, 1), f(1, 2), f(2, 0);
  return v;
}

double Fabric::deviator() const {
  const Voigt f = tensor();
  const double third = (f[0] + f[1] + f[2]) / 3;
  const Vec3 d(f[0] - third, f[1] - third, f[2] - third);
  return std::sqrt(1.5 * (d.squaredNorm() + 2 * (f[3] * f[3] + f[4] * f[4] + f[5] * f[5])));
}

double Fabric::anisotropy() const {
  constexpr double second_order = 15.0 / 2;
  return second_order * deviator();
}

}  // namespace lockstep::dem
