// Energy and momentum of the grains, booked once a cycle.
//
// Energy at t_n, with leap-frog's own kinetic energy 1/2 m v(n-1/2).v(n+1/2), for which the work of a force over the
// interval from n-1 to n is 1/2 (F(n-1) + F(n)).(x(n) - x(n-1)):
//   kinetic + elastic = start + work of gravity, pile, walls and interface - damped - slid - dashpots
// What does not balance is `residual`. The interface's work from n-1 to n is booked at n, one exchange late, since the
// velocities v(n-1/2) arrive then.
//
// Elastic energy is only summed with Detail::All, works from Detail::Works on: what does not balance is known at the
// steps of the first kind, and holds all steps between.
//
// Momentum from n-1/2 to n+1/2: the change over the step is the sum of all outer forces and local damping, to
// round-off; it catches what smooth curves hide (a shaft that drags the wrong way looks plausible).
#pragma once
#include "common/vectors.hpp"

namespace lockstep::dem {

struct Model;

struct GrainEnergies {  // [J]
  double kinetic = 0;
  double elastic = 0;
  double gravity_work = 0;
  double boundary_work = 0;  // pile and walls
  double interface_work = 0;
  double damped = 0;
  double friction = 0;
  double dashpots = 0;
};

class Ledger {
 public:
  // False: only the energies that stand are looked at, no works are summed and nothing is balanced.
  bool is_kept = true;

  // Called by cycle() after the bodies have moved, before step and time are counted on.
  void book(const Model& model);
  // Starts all sums anew at the next booking.
  void restart() {
    const bool kept = is_kept;
    *this = Ledger();
    is_kept = kept;
  }

  const GrainEnergies& energies() const { return now_; }
  // Kinetic and elastic, at the first booking.
  const GrainEnergies& start() const { return start_; }
  double residual() const { return residual_; }  // at t_n [J]
  double work_done() const {
    return work_done_;
  }  // sum of |work| of gravity, boundary and interface, and of what was lost [J]
  double residual_fraction() const { return work_done_ > 0 ? residual_ / work_done_ : 0.0; }
  // Vertical balance of the last step: pile + walls + weight + interface + damping - inertia [N], and the largest so
  // far over the largest of its terms so far [-]. Scenes with held bodies have no such balance: zero.
  double vertical_imbalance() const { return imbalance_; }
  double worst_vertical_imbalance() const { return largest_term_ > 0 ? worst_imbalance_ / largest_term_ : 0.0; }
  // Largest |sum of forces on particles + sum of nodal forces| over the largest sum [-].
  double worst_action_reaction() const { return largest_reaction_ > 0 ? worst_reaction_ / largest_reaction_ : 0.0; }

 private:
  void book_stored(const Model& model);
  void book_energy(const Model& model);
  void book_momentum(const Model& model);

  GrainEnergies now_;
  GrainEnergies start_;
  double start_balance_ = 0;  // [J]
  bool has_start_ = false;
  double residual_ = 0, work_done_ = 0;                            // [J]
  double imbalance_ = 0, worst_imbalance_ = 0, largest_term_ = 0;  // [N]
  double worst_reaction_ = 0, largest_reaction_ = 0;               // [N]
  double last_gravity_ = 0, last_damped_ = 0, last_boundary_ = 0;  // works of the last step, half of them booked [J]
  Vec3s last_nodal_force_;                                         // [N]
  bool has_last_ = false;
};

}  // namespace lockstep::dem
