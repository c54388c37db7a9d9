// Stage Balance (paper step 2): a packing that was cut to its container is brought to rest under the stress that the ground
// handed over.
//
//   relax    what the cut left pressed into walls and pile is let go
//   grow     the grains grow into the gaps that the cut left, until the whole packing presses, and are let down
//   settle   gravity, first with everything held, then with the servo (servo.hpp), until all is at rest
//
// Friction is the preparation's in `grow` and the scene's balance.friction in `settle`, and walls, interface and pile are
// smooth: with rough ones the sides would carry the weight, as in a silo.
#pragma once
#include <array>
#include <cmath>
#include <functional>
#include <string_view>
#include <vector>

#include "common/results.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/packing.hpp"
#include "dem_server/servo.hpp"
#include "dem_server/settings.hpp"

namespace lockstep::dem {

// What the ground handed over to stage Balance.
struct HandedOver {
  Vec3s nodes;                                      // of the interface [m]
  std::vector<std::array<std::int32_t, 4>> facets;  // nodes of each
  std::vector<std::int32_t> ring;                   // per facet
  Vec3s traction;                                   // per facet, on the continuum [Pa]
  double bulk_density = 0;                          // of the ground that the grains replace [kg/m3]
  double tip_target = 0;                            // vertical pressure at the pile's tip; 0 without a pile [Pa]
};

// What stage Balance came to, for logs and summaries.
struct BalanceFigures {
  double unbalanced_ratio = 0;  // [-]
  double porosity = 0;          // bulk [-]
  std::uint64_t cycles = 0;
  bool has_servo = false;  // what follows is filled
  std::vector<Ring> rings;
  double tip_pressure = 0;     // averaged [Pa]
  double ring_mismatch = 0;    // worst side ring or tip, over its tolerance [-]
  double bottom_mismatch = 0;  // [-]
  double bottom_force = 0;     // [N]
  double weight = 0;           // of the grains [N]
  double tip_force = 0;        // of the pile on the grains [N]
};

// What the bottom carries, against what smooth sides leave it to carry.
struct BottomBalance {
  double force = 0;   // of the bottom [N]
  double weight = 0;  // of the grains [N]
  double tip = 0;     // of the pile on the grains [N]
  double area = 0;    // of the bottom [m2]
  double error() const { return force - (weight + tip); }
  // At most 1 when matched: |error| over the share of the load and 0.5 kPa.
  double mismatch(double relative) const {
    return std::abs(error()) / (relative * (weight + tip) + Servo::pressure_floor * area);
  }
};

// What the end of the stage is judged by.
struct RestFigures {
  double unbalanced_ratio = 1;  // [-]
  bool is_servo_active = false;
  double servo_speed = 0;      // fastest ring or tip [m/s]
  double ring_mismatch = 0;    // worst ring that can still move, or tip, over its tolerance [-]
  double bottom_mismatch = 0;  // over its tolerance [-]
  double wall_error = 0;       // worst servo of a wall, over its pressure [-]
};
bool is_at_rest(const RestFigures& figures, const BalanceSettings& settings);

// Whom a packing in the making lets hear of it, every few cycles.
struct BalanceCalls {
  Heartbeat beat = [](std::string_view, double) {};  // of the whole stage: what is done, and how much of it
  std::function<void(double unbalanced_ratio, double fraction)> look = [](double, double) {};  // while it settles
};

// Vertical pressure that the pile's tip is balanced to: what the ground carried at its depth; in grains alone their weight
// above it, and lids that press; 0 without a pile [Pa].
double tip_target(const Settings& settings, const Assembly& assembly, const HandedOver& ground);

// Balances the model that was made of `assembly`, whose figures keep up with the growth. NumericalError when the packing
// still falls after balance.max_cycles; a packing that is merely not as quiet as asked for is a warning.
BalanceFigures balance_packing(Model& model, Assembly& assembly, const Settings& settings, const HandedOver& ground,
                               const BalanceCalls& calls = {});

// The rings' and the tip's pressures, to the log.
void log_servo(const BalanceFigures& figures, const Model& model, double tip_target);

// For the summary.
Json balance_entry(const BalanceFigures& figures, const Model& model, const Assembly& assembly, double tip_target);

}  // namespace lockstep::dem
