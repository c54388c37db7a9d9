// Grains in a periodic cell that strains: element tests without walls. Walls let a specimen read E 10 to 25 % low, since
// grains beside them pack looser and the walls' contacts are in series with the grains'; a cell of 500 grains has none.
//
//   axis k  either strains at a given rate     L_k > 0 stretches
//           or holds a pressure by its servo   L_k = (P_k - P) / (n M dt),   M = a share of E*, n steps to close the error
//
// MOTION. A body's velocity v is the one relative to the cell: x(n+1) = (1 + L dt) (x(n) + v dt), the period likewise; bodies
// at rest in it move with the mean deformation. Contacts see the difference of both velocities (PairContacts::strain), local
// damping sees v alone, so that it does not lean against the deformation. Rejected: velocities against the ground,
// which start a wave from the cell's faces with each change of rate, and damp the deformation itself.
//
// STRESS is sum of force times branch over the cell's volume, from the kernel, without the grains' momentum flux (at rest
// nothing, at an inertial number of 1e-3 some 1e-6 of it).
#pragma once
#include <array>
#include <cstdint>
#include <functional>
#include <optional>

#include "dem_server/contacts.hpp"
#include "dem_server/generation.hpp"

namespace lockstep::dem {

class PeriodicCell {
 public:
  // What an axis does in a step: holds a pressure (compression positive), or strains at a rate.
  struct Axis {
    std::optional<double> pressure;  // [Pa]
    double rate = 0;                 // [1/s]; without a pressure
  };

  PeriodicCell(Particles grains, const Vec3& period, const GrainMaterial& material, Team& team = Team::alone());

  void set_friction(double friction) { material_.friction = friction; }
  // One time step.
  void step(const std::array<Axis, 3>& axes, double damping);

  const Particles& particles() const { return particles_; }
  Vec3 period() const { return *contacts_.period(); }               // t_n [m]
  Vec3 stress() const { return totals_.virial / period().prod(); }  // normal stresses at t_n, tension positive [Pa]
  Vec3 rate() const { return rate_; }                               // of the last step [1/s]
  double porosity() const;
  double unbalanced_ratio() const { return unbalanced_; }  // mean unbalanced over mean contact force, last step
  double coordination() const;
  double time_step() const { return time_step_; }  // of the next step; cut when contacts ask for it, never longer [s]
  std::int64_t steps() const { return steps_; }

 private:
  Particles particles_;
  PairContacts contacts_;
  GrainMaterial material_;
  Team* team_;
  void renew_step(double damping);

  double time_step_;      // of the next step [s]
  double last_step_ = 0;  // that led to t_n [s]
  ContactTotals totals_;
  Vec3 rate_ = Vec3::Zero();
  double unbalanced_ = 0;
  std::int64_t steps_ = 0;
};

// A drained triaxial test in a cell: pressed on all sides, then shortened along z while x and y hold the pressure.
struct CellTest {
  double pressure = 100e3;                     // confining [Pa]
  std::optional<double> preparation_friction;  // while pressed; none: the cube's own, at most the material's [-]
  double inertial_number = 5e-4;  // of the shortening: rate 2 R sqrt(rho / p); above 1e-3 inertia shows in the strength
  double axial_strain = 0.15;     // at the end, logarithmic, compression positive
  double preparation_damping = 0.7;      // local damping
  double damping = 0.2;                  // 0.7 adds degrees to the friction angle
  std::function<void(double)> progress;  // fraction of the strain; may be empty
};

// Where a test stands. Strains are logarithmic from the pressed state, compression positive, as are stresses.
struct CellState {
  double axial_strain = 0, radial_strain = 0, volume_strain = 0;
  double axial_stress = 0, radial_stress = 0;  // radial: mean of both [Pa]
  double porosity = 0, coordination = 0, unbalanced_ratio = 0;
};

struct CellTestResult {
  CellState pressed;       // the state that strains count from
  std::int64_t steps = 0;  // of pressing and shortening
};

// Calls `record` every so often that the first 0.1 % of strain has some fifty rows, later every 2e-4. NumericalError when
// the cell does not come to rest at the pressure.
CellTestResult run_cell_test(const Cube& cube, const GrainMaterial& material, const CellTest& test, Team& team,
                             const std::function<void(const CellState&)>& record);

}  // namespace lockstep::dem
