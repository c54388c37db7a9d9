// The wave packet that a scene starts with (common/scene.proto, Packet): one function for both sides.
#pragma once
#include <cmath>

#include "common/scene.pb.h"
#include "common/vectors.hpp"

namespace lockstep {

// Velocity at the start of what stands at `x` [m/s].
inline Vec3 packet_velocity(const scene::Packet& packet, const Vec3& x) {
  const double along = x.z() - packet.center().z(), across = x.x() - packet.center().x();
  const double place = along / packet.length();
  if (std::abs(place) >= 0.5) return Vec3::Zero();
  double height = 0.5 * (1 + std::cos(2 * pi * place));
  if (packet.wavelength() > 0) height *= std::cos(2 * pi * along / packet.wavelength());
  if (packet.wavelength_across() > 0) height *= std::cos(2 * pi * across / packet.wavelength_across());
  return height * Vec3(packet.velocity().x(), packet.velocity().y(), packet.velocity().z());
}

}  // namespace lockstep
