#include "dem_server/measure.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/checks.hpp"

namespace lockstep::dem {

double porosity(const Particles& particles, const Box& bounds, double spacing,
                const std::function<bool(const Vec3&)>& is_inside) {
  std::array<std::int64_t, 3> count;
  for (int k = 0; k < 3; ++k) {
    const double points = std::floor((bounds.high[k] - bounds.low[k]) / spacing);
    if (!(points >= 1 && points < 1e5))
      throw InputError(
          fmt::format("porosity region of {:.3g} m with points {:.3g} m apart: needs 1 to 100000 points a side",
                      bounds.high[k] - bounds.low[k], spacing));
    count[k] = static_cast<std::int64_t>(points);
  }
  // Points stand in the middle of equal bricks that fill the bounds.
  Vec3 brick;
  for (int k = 0; k < 3; ++k) brick[k] = (bounds.high[k] - bounds.low[k]) / static_cast<double>(count[k]);
  const auto place = [&](std::int64_t i, std::int64_t j, std::int64_t k) -> Vec3 {
    return bounds.low + brick.cwiseProduct(Vec3(static_cast<double>(i) + 0.5, static_cast<double>(j) + 0.5,
                                                static_cast<double>(k) + 0.5));
  };

  // Each pebble marks the points in it; a point marked twice is one point.
  std::vector<char> is_solid(static_cast<std::size_t>(count[0] * count[1] * count[2]), 0);
  for (std::size_t p = 0; p < particles.pebble_count(); ++p) {
    const Vec3& center = particles.pebble_center[p];
    const double radius = particles.pebble_radius[p];
    std::array<std::int64_t, 3> first, last;
    bool is_near = true;
    for (int k = 0; k < 3; ++k) {
      const double low = (center[k] - radius - bounds.low[k]) / brick[k] - 0.5;
      const double high = (center[k] + radius - bounds.low[k]) / brick[k] - 0.5;
      is_near = is_near && high >= 0 && low <= static_cast<double>(count[k] - 1);
      if (!is_near) break;
      first[k] = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil(low)));
      last[k] = std::min<std::int64_t>(count[k] - 1, static_cast<std::int64_t>(std::floor(high)));
    }
    if (!is_near) continue;
    for (std::int64_t k = first[2]; k <= last[2]; ++k)
      for (std::int64_t j = first[1]; j <= last[1]; ++j)
        for (std::int64_t i = first[0]; i <= last[0]; ++i)
          if ((place(i, j, k) - center).squaredNorm() < radius * radius)
            is_solid[static_cast<std::size_t>((k * count[1] + j) * count[0] + i)] = 1;
  }

  std::int64_t inside = 0, solid = 0;
  for (std::int64_t k = 0; k < count[2]; ++k)
    for (std::int64_t j = 0; j < count[1]; ++j)
      for (std::int64_t i = 0; i < count[0]; ++i)
        if (is_inside(place(i, j, k))) {
          ++inside;
          solid += is_solid[static_cast<std::size_t>((k * count[1] + j) * count[0] + i)];
        }
  if (inside == 0)
    throw InputError(
        fmt::format("porosity region holds none of the points {:.3g} m apart: lower the spacing", spacing));
  return 1 - static_cast<double>(solid) / static_cast<double>(inside);
}

double porosity(const Particles& particles, const Box& region, double spacing) {
  return porosity(particles, region, spacing, [](const Vec3&) { return true; });
}

double porosity(const Particles& particles, const Ball& region, double spacing) {
  const Vec3 half = Vec3::Constant(region.radius);
  return porosity(particles, Box{region.center - half, region.center + half}, spacing,
                  [&](const Vec3& x) { return region.contains(x); });
}

double solid_volume(const Particles& particles) {
  double sum = 0;
  for (const double r : particles.equivalent_radius) sum += r * r * r;
  return 4.0 / 3.0 * pi * sum;
}

void MeanStress::add(const ContactView& contact, const Particles& particles) {
  const Vec3 end = contact.body_b >= 0 ? particles.position[contact.body_b] : contact.point;
  add(contact, Vec3(end - particles.position[contact.body_a]));
}

void MeanStress::add(const ContactView& contact, const Vec3& branch) {
  if (region_.contains(contact.point)) sum_ += contact.force_on_a * branch.transpose();
}

Voigt MeanStress::stress() const {
  const Mat3 s = (0.5 / region_.volume()) * (sum_ + sum_.transpose());
  Voigt v;
  v << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(2, 0);
  return v;
}

double MeanStress::pressure() const { return -sum_.trace() / (3 * region_.volume()); }

void Coordination::add(const ContactView& contact) {
  // A wall is a partner of its own at each contact: numbers below -1 are never a body's.
  if (contact.body_b >= 0) {
    partners_[contact.body_a].push_back(contact.body_b);
    partners_[contact.body_b].push_back(contact.body_a);
  } else {
    partners_[contact.body_a].push_back(-1 - static_cast<std::int32_t>(partners_[contact.body_a].size()));
  }
}

std::size_t Coordination::count(std::vector<std::int32_t> partners) {
  std::sort(partners.begin(), partners.end());
  return static_cast<std::size_t>(std::unique(partners.begin(), partners.end()) - partners.begin());
}

double Coordination::mean() const {
  std::size_t sum = 0;
  for (const auto& partners : partners_) sum += count(partners);
  return partners_.empty() ? 0.0 : static_cast<double>(sum) / static_cast<double>(partners_.size());
}

std::size_t Coordination::rattlers(std::size_t least) const {
  std::size_t sum = 0;
  for (const auto& partners : partners_) sum += count(partners) < least ? 1 : 0;
  return sum;
}

double unbalanced_ratio(double unbalanced_force_sum, std::size_t bodies, double contact_force_sum,
                        std::int64_t contacts) {
  if (bodies == 0 || unbalanced_force_sum == 0) return 0;
  if (contacts == 0 || contact_force_sum == 0) return std::numeric_limits<double>::infinity();
  return unbalanced_force_sum / static_cast<double>(bodies) / (contact_force_sum / static_cast<double>(contacts));
}

}  // namespace lockstep::dem
