#include "common/packet.hpp"

#include <catch2/catch.hpp>
#include <cmath>

namespace lockstep {

TEST_CASE("A packet is a cosine under a hump along z, and another over x") {
  // (1 + cos(2 pi a / L)) / 2 cos(2 pi a / l) cos(2 pi b / w) at a = z - 3, b = x - 0.5, L = 4, l = 2, w = 8.
  scene::Packet p;
  p.mutable_velocity()->set_y(0.1);
  p.mutable_center()->set_x(0.5);
  p.mutable_center()->set_z(3);
  p.set_length(4);
  CHECK(packet_velocity(p, {0.5, 9, 3}) == Vec3(0, 0.1, 0));
  CHECK(packet_velocity(p, {0.5, 0, 4}).y() == Approx(0.05));  // a = L/4: half the peak
  CHECK(packet_velocity(p, {0.5, 0, 5}) == Vec3::Zero());
  CHECK(packet_velocity(p, {0.5, 0, -8}) == Vec3::Zero());
  p.set_wavelength(2);
  CHECK(packet_velocity(p, {0.5, 0, 4}).y() == Approx(-0.05));  // and half a wave
  p.set_wavelength_across(8);
  CHECK(packet_velocity(p, {1.5, 0, 4}).y() == Approx(-0.05 / std::sqrt(2.0)));
  CHECK(std::abs(packet_velocity(p, {2.5, 0, 4}).y()) < 1e-17);
}

}  // namespace lockstep
