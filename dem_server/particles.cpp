#include "dem_server/particles.hpp"

#include <algorithm>

#include "common/checks.hpp"

namespace lockstep::dem {

std::int32_t Particles::add(const ClumpTemplate& shape, double radius, double density, const Vec3& center,
                            const Quat& attitude) {
  LOCKSTEP_ASSERT(radius > 0 && density > 0, "radius {}, density {}", radius, density);
  const auto body = static_cast<std::int32_t>(body_count());
  position.push_back(center);
  orientation.push_back(attitude.normalized());
  velocity.push_back(Vec3::Zero());
  spin.push_back(Vec3::Zero());
  mass.push_back(density * 4.0 / 3.0 * pi * radius * radius * radius);
  equivalent_radius.push_back(radius);
  inertia.push_back(mass.back() * radius * radius * shape.inertia_per_mass);
  force.push_back(Vec3::Zero());
  torque.push_back(Vec3::Zero());
  for (std::size_t p = 0; p < shape.pebble_center.size(); ++p) {
    pebble_body.push_back(body);
    pebble_offset.push_back(radius * shape.pebble_center[p]);
    pebble_radius.push_back(radius * shape.pebble_radius[p]);
    pebble_center.push_back(center);
  }
  pebble_begin.push_back(static_cast<std::int32_t>(pebble_count()));
  place_pebbles(body);
  return body;
}

void Particles::place_pebbles(std::int32_t body) {
  const std::int32_t begin = pebble_begin[body], end = pebble_begin[body + 1];
  if (end - begin == 1 && pebble_offset[begin].isZero(0)) {
    pebble_center[begin] = position[body];
    return;
  }
  place_pebbles(body, orientation[body].toRotationMatrix());
}

void Particles::place_pebbles() {
  for (std::size_t b = 0; b < body_count(); ++b) place_pebbles(static_cast<std::int32_t>(b));
}

void Particles::scale(std::int32_t body, double factor) {
  const double factor3 = factor * factor * factor;
  equivalent_radius[body] *= factor;
  mass[body] *= factor3;
  inertia[body] *= factor3 * factor * factor;
  for (std::int32_t p = pebble_begin[body]; p < pebble_begin[body + 1]; ++p) {
    pebble_offset[p] *= factor;
    pebble_radius[p] *= factor;
  }
  place_pebbles(body);
}

void Particles::keep_only(const std::vector<char>& keep) {
  LOCKSTEP_ASSERT(keep.size() == body_count(), "{} marks for {} bodies", keep.size(), body_count());
  std::size_t to = 0;
  std::int32_t pebble_to = 0;
  for (std::size_t b = 0; b < keep.size(); ++b) {
    const std::int32_t begin = pebble_begin[b], end = pebble_begin[b + 1];
    if (!keep[b]) continue;
    position[to] = position[b], orientation[to] = orientation[b], velocity[to] = velocity[b], spin[to] = spin[b];
    mass[to] = mass[b], equivalent_radius[to] = equivalent_radius[b], inertia[to] = inertia[b];
    force[to] = force[b], torque[to] = torque[b];
    pebble_begin[to] = pebble_to;  // to <= b, and pebble_begin[b] was read above
    for (std::int32_t p = begin; p < end; ++p, ++pebble_to) {
      pebble_body[pebble_to] = static_cast<std::int32_t>(to);
      pebble_offset[pebble_to] = pebble_offset[p];
      pebble_radius[pebble_to] = pebble_radius[p];
      pebble_center[pebble_to] = pebble_center[p];
    }
    ++to;
  }
  pebble_begin[to] = pebble_to;
  position.resize(to), orientation.resize(to), velocity.resize(to), spin.resize(to), mass.resize(to);
  equivalent_radius.resize(to), inertia.resize(to), force.resize(to), torque.resize(to);
  pebble_begin.resize(to + 1);
  const auto pebbles = static_cast<std::size_t>(pebble_to);
  pebble_body.resize(pebbles), pebble_offset.resize(pebbles), pebble_radius.resize(pebbles);
  pebble_center.resize(pebbles);
}

void Particles::clear_forces() {
  std::fill(force.begin(), force.end(), Vec3::Zero());
  std::fill(torque.begin(), torque.end(), Vec3::Zero());
}

void Particles::hash(Hash& h) const {
  h.add(static_cast<std::uint64_t>(body_count()));
  h.add(std::span<const Vec3>(position));
  for (const Quat& q : orientation) h.add(q.w()), h.add(Vec3(q.vec()));
  h.add(std::span<const Vec3>(velocity));
  h.add(std::span<const Vec3>(spin));
  h.add(std::span<const double>(mass));
  h.add(std::span<const Vec3>(inertia));
  h.add(static_cast<std::uint64_t>(pebble_count()));
  h.add(std::span<const double>(pebble_radius));
  h.add(std::span<const Vec3>(pebble_center));
}

}  // namespace lockstep::dem
