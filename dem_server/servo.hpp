// The boundary while the packing is balanced (stage 2): side rings that move radially, and a pile tip that moves
// vertically, until each carries the mean traction handed over by the continuum.
//
//   pressure of a ring   p = -sum(F . n) / A      F on the continuum, n into the grains
//   velocity along n     v = g (p_target - p)     g = c A / (K N dt), K N the stiffness of the ring's N contacts, so
//   that one
//                                                 step closes at most the fraction c of the error (c > 1 chatters)
//
// A node moves with the mean of its rings. The bottom stays: with smooth sides its force is weight plus tip force
// whatever it does, so a servo there would only drift; that balance is checked instead.
#pragma once
#include <span>
#include <vector>

#include "dem_server/cycle.hpp"

namespace lockstep::dem {

struct ServoSettings {
  double closing = 0.2;     // c
  double top_speed = 0.05;  // [m/s]
  double max_travel = 0;    // of a ring along its normal [m]
  double averaging = 200;   // steps over which pressures and velocities are averaged for reports and for the end test
};

// A group of facets that is compared, and on the sides moved, as a whole.
struct Ring {
  std::int32_t id = 0;  // negative: bottom
  std::vector<std::int32_t> facets;
  double area = 0;           // [m2]
  double center_z = 0;       // [m]
  double target = 0;         // mean pressure handed over [Pa]
  double pressure = 0;       // averaged [Pa]
  double velocity = 0;       // along the normal, this step [m/s]
  double mean_velocity = 0;  // averaged [m/s]
  bool is_at_end = false;    // its travel is used up: it can do no more
  double travel = 0;         // along the normal [m]
  bool is_side() const { return id >= 0; }
};

class Servo : public Boundary {
 public:
  static constexpr double pressure_floor = 500;  // of every comparison of pressures, beside a share of them [Pa]

  // `ring` and `traction` per facet as in InitialStress; `tip_target` is the mean vertical pressure at the tip's depth
  // [Pa].
  Servo(const Model& model, std::span<const std::int32_t> ring, std::span<const Vec3> traction, double tip_target,
        const ServoSettings& settings);

  bool move_facets(Model& model) override;
  void take_forces(Model& model) override;

  double time_step = 0;   // of the next cycles [s]
  bool is_active = true;  // false: everything is held
  const std::vector<Ring>& rings() const { return rings_; }
  double tip_pressure() const { return tip_pressure_; }  // averaged [Pa]
  double tip_target() const { return tip_target_; }      // [Pa]
  double fastest() const;                                // averaged, rings and tip [m/s]
  // Largest |p - target| / (relative * target + 500 Pa) over side rings and tip; at most 1 when matched.
  double worst_mismatch(double relative) const;
  // The same, leaving out rings at the end of their travel.
  double worst_movable_mismatch(double relative) const;

 private:
  double mismatch(const Ring& ring, double relative) const;
  double tip_mismatch(double relative) const;

  ServoSettings settings_;
  std::vector<Ring> rings_;
  std::vector<Vec3> node_normal_;                      // horizontal, into the grains; zero off the sides
  std::vector<std::vector<std::int32_t>> node_rings_;  // side rings that meet at a node
  Vec3s node_velocity_;                                // [m/s]
  double tip_target_ = 0;                              // [Pa]
  double tip_pressure_ = 0;                            // [Pa]
  double tip_velocity_ = 0;                            // [m/s]
  double mean_tip_velocity_ = 0;                       // [m/s]
  bool has_pressures_ = false;
};

}  // namespace lockstep::dem
