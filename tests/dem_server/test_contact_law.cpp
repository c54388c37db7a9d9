#include <catch2/catch.hpp>

#include "common/checks.hpp"
#include "dem_server/contact_law.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

const Vec3 along_x(1, 0, 0);

ContactMaterial material() {
  ContactMaterial m;
  m.normal_stiffness = 1e6;
  m.shear_stiffness = 5e5;
  m.friction = 0.5;
  return m;
}

}  // namespace

TEST_CASE("the normal force is stiffness times overlap and pushes A away from B") {
  ContactHistory history;
  const ContactResult r = contact_force(material(), along_x, 1e-4, Vec3::Zero(), 1e-5, history);
  CHECK(r.force_on_a == Vec3(-100, 0, 0));
  CHECK(r.normal_force == 100);
  CHECK(history.normal == along_x);
}

TEST_CASE("the shear spring drags A along with B, from the first step of touch on") {
  // Three steps of 1 m/s for 1e-5 s: 3e-5 m of shear, 15 N, below the limit of 50 N. Paper eqs 8-10.
  ContactHistory history;
  ContactResult r;
  for (int k = 0; k < 3; ++k) r = contact_force(material(), along_x, 1e-4, Vec3(0.3, 0, 1), 1e-5, history);
  CHECK(r.force_on_a.z() == Approx(15).epsilon(1e-14));
  CHECK(r.force_on_a.x() == -100);
  CHECK(r.slip_work == 0);
}

TEST_CASE("slip caps the spring at friction times normal force, keeps its direction and books the work") {
  // One step would stretch the spring to k_s V dt = 5e5 * 2 * 1e-4 = 100 N; the limit is 50 N. The slip distance is
  // (100 - 50)/k_s = 1e-4 m under the mean of 0 N before and 50 N after: 2.5e-3 J. A second step slides by V dt = 2e-4
  // m under 50 N: 1e-2 J. Paper eq. 11.
  ContactHistory history;
  const Vec3 direction(0, 0.6, 0.8);
  const ContactResult r = contact_force(material(), along_x, 1e-4, 2 * direction, 1e-4, history);
  CHECK((history.spring - 50 * direction).norm() < 1e-12);
  CHECK((r.force_on_a - (50 * direction - 100 * along_x)).norm() < 1e-12);
  CHECK(r.slip_work == Approx(2.5e-3).epsilon(1e-14));
  const ContactResult next = contact_force(material(), along_x, 1e-4, 2 * direction, 1e-4, history);
  CHECK(next.slip_work == Approx(1e-2).epsilon(1e-13));
}

TEST_CASE("a contact that lets go forgets its spring") {
  ContactHistory history;
  contact_force(material(), along_x, 1e-4, Vec3(0, 1, 0), 1e-5, history);
  const ContactResult r = contact_force(material(), along_x, 0, Vec3(0, 1, 0), 1e-5, history);
  CHECK(r.force_on_a == Vec3::Zero());
  CHECK(history.spring == Vec3::Zero());
  CHECK(history.normal == Vec3::Zero());
}

TEST_CASE("the spring turns with the normal and keeps its length") {
  // The normal turns by a full circle about z in 1000 steps; the spring starts along y and must come back to y, with
  // its part along z unturned.
  ContactHistory history;
  history.normal = along_x;
  history.spring = Vec3(0, 3, 4);
  for (int k = 1; k <= 1000; ++k) {
    const double angle = 2 * pi * k / 1000;
    const Vec3 normal(std::cos(angle), std::sin(angle), 0);
    contact_force(material(), normal, 1e-4, Vec3::Zero(), 1e-5, history);
    if (k == 250) CHECK((history.spring - Vec3(-3, 0, 4)).norm() < 1e-12);
  }
  const double error = (history.spring - Vec3(0, 3, 4)).norm();
  CAPTURE(error, history.spring.norm() - 5);
  CHECK(error < 1e-11);
}

TEST_CASE("a normal that flips over in one step leaves a finite force") {
  ContactHistory history;
  history.normal = along_x;
  history.spring = Vec3(0, 3, 0);
  const ContactResult r = contact_force(material(), -along_x, 1e-4, Vec3::Zero(), 1e-5, history);
  CHECK(r.force_on_a.allFinite());
}

TEST_CASE("dashpots never pull and never break the friction limit") {
  ContactMaterial m = material();
  m.normal_dashpot = 1000;
  m.shear_dashpot = 1000;
  ContactHistory history;
  const ContactResult parting = contact_force(m, along_x, 1e-4, Vec3(1, 0, 0), 1e-9, history);
  CHECK(parting.normal_force == 0);
  CHECK(parting.force_on_a == Vec3::Zero());
  history = ContactHistory{};
  const ContactResult shearing = contact_force(m, along_x, 1e-4, Vec3(0, 10, 0), 1e-9, history);
  CHECK(shearing.force_on_a.y() == Approx(50).epsilon(1e-12));
  CHECK(shearing.dashpot_power >= 0);
}

TEST_CASE("the damping ratio makes a linear pair part at the asked share of its speed") {
  // m x'' = max(0, k u + c u') solved with a fine explicit midpoint rule, an independent path to e.
  for (const double restitution : {0.9, 0.5, 0.2, 0.05}) {
    const double zeta = damping_ratio(restitution), k = 1, mass = 1, c = 2 * zeta * std::sqrt(k * mass);
    double u = 0, v = 1;
    const double dt = 1e-4;
    const auto force = [&](double overlap, double speed) { return std::max(0.0, k * overlap + c * speed); };
    do {
      const double middle_u = u + 0.5 * dt * v, middle_v = v - 0.5 * dt * force(u, v) / mass;
      u += dt * middle_v;
      v -= dt * force(middle_u, middle_v) / mass;
    } while (u > 0);
    const double error = -v / restitution - 1;
    CAPTURE(restitution, zeta, error);
    CHECK(std::abs(error) < 1e-3);
  }
  CHECK(damping_ratio(1) == 0);
  CHECK_THROWS_AS(damping_ratio(0), InputError);
  CHECK_THROWS_AS(damping_ratio(1.5), InputError);
}
