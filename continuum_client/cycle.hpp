// One step of the coupled ground: what it works on, and its phases. cycle.cpp is the list of them; read that first.
//
// On entry: u and the interface's positions x at t_n, velocities at t_(n-1/2), f_int and forces of t_(n-1).
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "common/coupled_ledger.hpp"
#include "common/coupled_limit.hpp"
#include "common/parallel.hpp"
#include "common/profile.hpp"
#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/incremental_force.hpp"
#include "continuum_client/integrator.hpp"
#include "continuum_client/interface_surface.hpp"
#include "continuum_client/internal_force.hpp"
#include "continuum_client/yielding_zones.hpp"
#include "protocol/session.hpp"

namespace lockstep::continuum {

enum class Phase { SendVelocities, InternalForces, ReceiveForces, Ledger, Advance, Output, Count };
inline constexpr const char* phase_names[] = {"send_velocities", "internal_forces", "wait_for_forces",
                                              "ledger",          "advance",         "output"};

// What is left of the deleted zones' reaction: share * offset, offset = f_A - f_D(0).
struct Baseline {
  Vec3s offset;      // per interface node [N]
  double share = 0;  // 1 - s
  Vec3s force;       // share * offset, of this step [N]
};

// Keeps the step below every limit known; it never grows again. The grains' limits come with their forces.
struct StepGuard {
  CoupledLimit limits;
  double fraction = 0;     // fidelity.step_fraction [-]
  bool is_strict = false;  // a smaller step ends the run
  int cuts = 0;
  double told_limit = 0;   // of the grains, the last that came [s]
  double logged_step = 0;  // at the last line about a cut [s]

  double wanted() const { return fraction * limits.limit(); }  // [s]
};

class CoupledGround {
 public:
  // ------------------------------------------------------------------ the phases of cycle(), in its order
  // Paper step 5: v(n-1/2) of the interface and the step from n to n+1.
  void send_velocities(protocol::Session& peer);
  // f_int(n) = f0 + K u(n), and what zones that yield have beside it.
  void compute_internal_forces();
  // Tractions on the surface at t_n.
  void load_surface();
  // Paper step 6: F(n) of the contacts, and the grains' limits.
  void receive_forces(protocol::Session& peer);
  // What the contacts did to both sides, and their energies. NumericalError where those are not what works explain.
  void book_exchange();
  // What is left of the deleted zones.
  void fade_baseline();
  // Paper step 7: v(n+1/2), u(n+1) and x(n+1). NumericalError naming the node if a velocity runs away.
  void advance();
  // The step from n+1 on; n := n+1.
  void guard_step();

  // Stress of a zone now, by either route; `initial` is the state that displacements start from [Pa].
  Mat3 zone_stress(const InitialState& initial, std::size_t z) const;
  // Mean strain of a zone since the reference state, of the same points as its stress: stress = initial + law(strain). With
  // large strain it is the sum of the increments, turned with the zone as the stress is; the incremental route has it after
  // incremental->keep_strain().
  Mat3 zone_strain(std::size_t z) const;

  // Forces of the last step's n, which are still there [N]. All on a node but supports and dashpots: weight, loads, contacts,
  // baseline, Rayleigh's part that goes with stiffness, less f_int.
  Vec3 nodal_force(std::size_t node) const;
  Vec3 unbalanced_force(std::size_t node) const;  // in its free directions
  // Of the supports on the ground: what holds the others, and kept_reaction. Dashpots of quiet boundaries are not in it.
  Vec3 support_force(std::size_t node) const;

  // ------------------------------------------------------------------ what they work on
  Grid grid;
  InternalForce internal_force;
  std::unique_ptr<IncrementalForce> incremental;  // in its place, where the scene says so
  std::unique_ptr<YieldingZones> yielding;        // beside it, where materials yield
  Integrator integrator{{}, {}};
  Motion motion;
  Vec3s internal;               // f_int(n) [N]
  Vec3 gravity = Vec3::Zero();  // acceleration [m/s2]
  Vec3s reaction_load;          // of released supports, per node; empty: none was released [N]
  Vec3s kept_reaction;  // the same, without the weights that scaled masses put there; empty: none, or nobody asks [N]
  // Full forces of the scene's tractions, per node, and what is applied of them beside the reactions [N].
  std::vector<SurfaceLoad> loads;
  std::vector<Vec3s> load_force;
  Vec3s boundary_load;
  std::vector<double> load_shares;  // that boundary_load holds [-]
  // Rayleigh's b [s], f_int of the last step and the force -b K v(n-1/2) = -b (f_int(n) - f_int(n-1)) / dt [N].
  double stiffness_damping = 0;
  Vec3s last_internal, viscous;
  InterfaceSurface interface;
  Baseline baseline;
  StepGuard guard;
  std::optional<CoupledLedger> coupled;  // unless the scene does without
  Vec3s contact_offset;                  // per interface node: where contacts see it, less its position [m]

  std::uint64_t step = 0;     // n
  double time = 0;            // t_n since the first coupled step [s]
  StepSizes step_sizes;       // into and out of n
  double damping = 0;         // of the stage [-]
  double velocity_limit = 0;  // P-wave speed: faster nodes have strains near 1 [m/s]
  std::uint32_t hash_interval = 1;
  protocol::Stage stage = protocol::Stage::Apply;

  StepSums sums;                  // of the last step
  protocol::Velocities outgoing;  // velocity: v(n-1/2) of the interface; its memory is reused
  protocol::Forces incoming;      // F(n)
  Team* team = &Team::alone();
  Profile<Phase> profile;
};

// One step, from n to n+1.
void cycle(CoupledGround& ground, protocol::Session& peer);

}  // namespace lockstep::continuum
