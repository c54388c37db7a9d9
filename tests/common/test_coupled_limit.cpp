// The coupled stable step against the exact one of the smallest coupled system: a node of mass M on a spring K, and a grain
// of mass m behind a contact k on it.
//   M a = -K u - k (u - x),  m a = -k (x - u)
//   omega^2: eigenvalues of [[(K + k) / M, -k / M], [-k / m, k / m]], by the trace T and the determinant D:
//   omega^2 = T / 2 + sqrt(T^2 / 4 - D),  T = (K + k) / M + k / m,  D = K k / (M m)
#include <catch2/catch.hpp>
#include <cmath>

#include "common/coupled_limit.hpp"

namespace lockstep {
namespace {

double largest_frequency_squared(double node_spring, double node_mass, double contact, double grain_mass) {
  const double trace = (node_spring + contact) / node_mass + contact / grain_mass;
  const double determinant = node_spring * contact / (node_mass * grain_mass);
  return 0.5 * trace + std::sqrt(0.25 * trace * trace - determinant);
}

}  // namespace

TEST_CASE("the coupled limit is safe for any contrast of stiffness and mass, and near the truth where it counts") {
  // The grain alone on a rigid facet has k / m.
  double worst = 0, best = 1e300;
  for (int stiffness = -8; stiffness <= 8; ++stiffness)
    for (int mass = -8; mass <= 8; ++mass) {
      const double contact = std::pow(10, 0.5 * stiffness), grain = std::pow(10, 0.5 * mass);
      CoupledLimit limit({1.0, {1.0}, 0, 0});
      limit.set_contacts({contact});
      limit.set_grains(stable_step(limit.grains_on_ground(contact / grain, contact / grain), 0));
      const double exact = stable_step(largest_frequency_squared(1, 1, contact, grain), 0);
      CAPTURE(contact, grain, limit.limit(), exact);
      CHECK(limit.limit() <= exact * (1 + 1e-14));
      worst = std::max(worst, exact / limit.limit()), best = std::min(best, exact / limit.limit());
    }
  INFO("true over coupled limit from " << best << " to " << worst);
  CHECK(worst < std::sqrt(2.0) * 1.001);  // the zones' rule counts contacts twice
}

TEST_CASE("a limit of the grains that takes the ground for rigid is too long beside soft zones") {
  // K -> 0, M = 2 m: omega^2 = k (1/m + 1/M) = 1.5 k / m, where the rigid ground has k / m and the zones' rule 2 k / M = k / m.
  const double contact = 1, grain = 1, node = 2, spring = 1e-6;
  CoupledLimit limit({spring / node, {node}, 0, 0});
  limit.set_contacts({contact});
  limit.set_grains(stable_step(contact / grain, 0));
  const double exact = stable_step(largest_frequency_squared(spring, node, contact, grain), 0);
  INFO("rigid " << limit.limit() / exact << " of the exact limit");
  CHECK(limit.limit() / exact == Approx(std::sqrt(1.5)).epsilon(1e-5));
  limit.set_grains(stable_step(limit.grains_on_ground(contact / grain, contact / grain), 0));
  INFO("on the ground " << limit.limit() / exact);
  // [[1, 1/sqrt(2)], [1/sqrt(2), 1/2]] k / m has the eigenvalues 0 and 1.5: exact.
  CHECK(limit.limit() / exact == Approx(1).epsilon(1e-5));
  CHECK(limit.limit() <= exact);
}

TEST_CASE("a guard that does not know of contacts would let the coupled system blow up") {
  const double exact = stable_step(largest_frequency_squared(1, 1, 100, 1e4), 0);
  CoupledLimit blind({1.0, {1.0}, 0, 0});
  blind.set_grains(stable_step(100 / 1e4, 0));
  CHECK(blind.limit() > 5 * exact);
}

TEST_CASE("the coupled limit names what sets it") {
  CoupledLimit limit({1.0, {1.0, 0.0, 2.0}, 0.7, 0});
  CHECK(limit.limit() == Approx(2 / std::sqrt(1.7)).epsilon(1e-15));
  CHECK(std::string(limit.limited_by()) == "zones");
  const Vec3s nodes = {{0, 0, 0}, {1, 0, 0}, {2, 0, -3}};
  limit.set_contacts({1.0, 1e9, 3.0});  // the second is held
  CHECK(limit.worst_node() == 2);
  CHECK(limit.interface_limit() == Approx(2 / std::sqrt(4.0 * 1.7)).epsilon(1e-15));
  CHECK_THAT(limit.culprit(nodes),
             Catch::Contains("node 2 at (2, 0, -3) m") && Catch::Contains("facet_stiffness_factor"));
  limit.set_grains(0.1, "grain 17 at (0, 0, 1) m");
  CHECK(std::string(limit.limited_by()) == "grains");
  CHECK_THAT(limit.culprit(nodes), Catch::Contains("grain 17") && Catch::Contains("contact_modulus"));
  limit.set_grains(0);
  CHECK(std::string(limit.limited_by()) == "zones with contacts");
}

TEST_CASE("a peer that tells nothing of its zones sets no limit") {
  CoupledLimit limit;
  CHECK(limit.limit() == 0);
  limit = CoupledLimit(GroundStiffness{});
  limit.set_contacts({1e6, 1e6});
  CHECK(std::isinf(limit.limit()));
}

}  // namespace lockstep
