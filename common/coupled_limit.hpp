// The stable step of zones and grains with the contacts between them: one rule that both sides of a coupled run hold, from
// what they tell each other.
//
// Leap-frog is stable for omega_max dt <= 2, omega_max^2 the largest eigenvalue of M^-1 K. Local damping adds alpha |F|
// against the motion; in the highest mode, which turns sign at each step, that makes the force (1 + alpha) F, so the limit
// shrinks to 2 / omega_max / sqrt(1 + alpha). Contacts at the interface add stiffness to nodes. With C the contacts'
// stiffness and a, b the two sides' motion at the contact, each holds, for any t > 0,
//   1/2 C (a - b)^2 <= (1 + t) 1/2 C a^2 + (1 + 1/t) 1/2 C b^2,
// and with bilinear weights w that sum to one b^2 <= sum w u^2. So grains and zones come apart:
//   omega^2 <= max(G + t g, Z + z / t),   G: grains alone, facets as rigid walls;   g: contacts with facets alone, the largest grain
//                                         Z = omega_c^2 + z: zones with contacts,   z = max over nodes of sum(k w) / m
// t = 1 is the zones' own rule, omega_c^2 + 2 z, which is enough wherever G + g lies below it. Elsewhere the grains answer for
// both, with the best t, where both are equal: the larger eigenvalue of [[G, sqrt(g z)], [sqrt(g z), Z]]. G alone is not
// enough: a sphere of half the mass of a soft ground's node has 1.5 k / m, and G = k / m. The step of both is the smaller of the two
// limits.
//
// With n steps of the grains to one of the zones (exchange interval) the grains tell n times their own limit, and the zones
// must keep to half of theirs: forces that are a mean over the interval come half of it late, which takes damping away.
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/vectors.hpp"

namespace lockstep {

// 2 / sqrt(omega^2) / sqrt(1 + damping); infinite for omega^2 = 0 [s]. With stiffness-proportional damping b [s], whose
// force at n is made of the velocity at n-1/2, the highest mode's v+ = v- - dt (omega^2 u + b omega^2 v-) is stable up to
//   dt = 2 / omega (sqrt(1 + xi^2) - xi),  xi = b omega / 2,
// where the roots of z^2 - (2 - omega^2 dt^2 - b omega^2 dt) z + 1 - b omega^2 dt reach z = -1:
// omega^2 dt^2 + 2 b omega^2 dt = 4.
double stable_step(double frequency_squared, double damping, double stiffness_damping = 0);

// What the ground says of itself once, at Excavate.
struct GroundStiffness {
  double frequency_squared = 0;   // omega_c^2 of the zones alone, with its margin; 0: nothing moves, or not told [1/s2]
  std::vector<double> node_mass;  // per interface node; 0: held; empty: not told [kg]
  double damping = 0;             // the largest local damping that the coupled stages use [-]
  double stiffness_damping = 0;   // Rayleigh's b [s]
};

class CoupledLimit {
 public:
  CoupledLimit() = default;
  CoupledLimit(GroundStiffness ground, std::uint32_t exchange_interval = 1);

  // What grains on this ground have for omega^2, from theirs with facets as rigid walls (G above) and that of the contacts with
  // facets alone (g) [1/s2]. Uses what set_contacts() was told last. G itself where the zones' rule covers the rest.
  double grains_on_ground(double own, double touching) const;

  // sum(k w) per interface node [N/m].
  void set_contacts(const std::vector<double>& node_stiffness);
  // The grains' own limit per exchange, damping included; 0: none [s]. Which of them sets it, in words.
  void set_grains(double limit, std::string culprit = {});

  double zones_limit() const { return zones_; }            // of the zones alone [s]
  double interface_limit() const { return interface_; }    // of the zones with the contacts on them [s]
  double grains_limit() const { return grains_; }          // infinite: none [s]
  double limit() const;                                    // the smallest [s]
  std::int64_t worst_node() const { return worst_node_; }  // whose contacts set interface_limit(); -1: none does

  // "zones", "zones with contacts" or "grains".
  const char* limited_by() const;
  // The same with the node or grain, and the knob that would raise it. `nodes`: positions of the interface [m].
  std::string culprit(const Vec3s& nodes) const;

 private:
  double share() const { return exchange_interval_ > 1 ? 0.5 : 1.0; }  // of the zones' limits, see above

  GroundStiffness ground_;
  std::uint32_t exchange_interval_ = 1;
  double zones_ = 0, interface_ = 0, grains_ = 0;
  std::int64_t worst_node_ = -1;
  double worst_stiffness_ = 0;  // of that node [N/m]
  double contacts_ = 0;         // z: its stiffness over its mass [1/s2]
  std::string grains_culprit_;
};

}  // namespace lockstep
