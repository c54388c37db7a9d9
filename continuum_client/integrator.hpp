// The equation of motion of the nodes, integrated by leap-frog with local damping, and its energy ledger.
//
//   m a = F + F_d,  F = f_ext + f_interface - f_int(u(n)),  F_d = -alpha |F| sgn(v(n-1/2))  by component (paper eqs 14,
//   17) v(n+1/2) = v(n-1/2) + a (dt_old + dt_new) / 2 u(n+1)   = u(n) + v(n+1/2) dt_new
// dt_old led from n-1 to n and dt_new leads from n to n+1.
//
// Energies at n. Kinetic energy is taken as 1/2 m v(n-1/2) . v(n+1/2), not from either velocity alone: with the work of
// a force F from n to n+1 booked as 1/2 (F(n) + F(n+1)) . (u(n+1) - u(n)), the sum of kinetic energy and 1/2 u(n) . K
// u(n) then changes by exactly the work of the other forces. Proof for one node without them: the change of kinetic
// energy from n to n+1 is
//   m/2 v(n+1/2) . (v(n+3/2) - v(n-1/2)) = -dt/2 v(n+1/2) . K (u(n+1) + u(n)) = -1/2 (u(n+1) - u(n)) . K (u(n+1) +
//   u(n)),
// minus the change of elastic energy since K is symmetric. So the ledger closes to round-off, and its residual shows
// errors, not the scheme. F(n) does half of its work on each side of n.
//
// Where dt changes at n, kinetic energy at n is m/2 v(n-1/2) . (v(n-1/2) + a dt_old) seen from before and
// m/2 v(n+1/2) . (v(n+1/2) - a dt_new) seen from after (both are the product above for one dt). They differ by
//   m a^2 (dt_old - dt_new) (dt_old + dt_new) / 8,
// which changing the step gives to the motion; it has its own line.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/instructions.hpp"
#include "common/parallel.hpp"
#include "common/vectors.hpp"
#include "continuum_client/node_kernel.hpp"

namespace lockstep::continuum {

// On entry to a cycle: displacement at n, velocity at n-1/2.
struct Motion {
  Vec3s displacement;  // from the reference state [m]
  Vec3s velocity;      // [m/s]
};

// Work since the start of the ledger, up to n [J].
struct Work {
  double gravity = 0;
  double boundary = 0;     // of constant loads that stand in for released supports
  double interface = 0;    // of the grains' contact forces
  double baseline = 0;     // of what is left of the deleted zones' reaction, an external load while it fades out
  double damped = 0;       // taken out by local damping
  double yielded = 0;      // taken out by zones that yield
  double step_change = 0;  // by changing the time step, see the head of this file
};

struct Ledger {
  Work work;           // up to n
  double start = 0;    // kinetic energy at n = 0 [J]
  double kinetic = 0;  // at n [J]
  double elastic = 0;  // at n, from the reference state: u . (f0 + K u / 2) [J]

  // Kinetic plus elastic energy less that of the start and all work done: a constant, zero for a ledger that starts in
  // the reference state [J].
  double residual() const {
    return kinetic + elastic - start - work.gravity - work.boundary - work.interface - work.baseline -
           work.step_change + work.damped + work.yielded;
  }
};

struct StepSizes {
  double into = 0;    // dt_old [s]
  double out_of = 0;  // dt_new [s]
  double velocity_step() const { return 0.5 * (into + out_of); }
};

// Forces of step n besides the internal ones [N].
struct NodalLoads {
  Vec3 gravity = Vec3::Zero();                        // acceleration [m/s2]
  std::span<const Vec3> reaction = {};                // constant, of released supports, per grid node; empty: none
  std::span<const std::int32_t> interface_node = {};  // rising
  std::span<const Vec3> interface_force = {};         // of contacts, per interface node
  std::span<const Vec3> baseline_force = {};          // per interface node
  std::span<const Vec3> viscous = {};                 // booked as damping, per grid node; empty: none
};

// Sums over nodes, in the order of nodes.
struct StepSums {
  double unbalanced = 0;  // of |F| over free components [N]
  double internal = 0;    // of |f_int| [N]
  // Index of the first node whose velocity is not finite or above `velocity_limit`, or -1.
  std::int64_t runaway_node = -1;

  // Mean unbalanced over mean internal nodal force; zero where there is no force at all [-].
  double unbalanced_ratio() const { return internal > 0 ? unbalanced / internal : (unbalanced > 0 ? 1.0 : 0.0); }
};

// Advances velocity to n+1/2 and displacement to n+1, and `ledger` to n (then it stays there until the next call).
// `internal` and `reference` are f_int(n) and f0. One walk over the nodes with little memory touched: it lies between
// the grains' forces and the next message. `mass` 0 or is_free 0: held.
//
// `dashpot` is a viscosity c per node and component [N s/m], empty for none. Its force -c (v(n-1/2) + v(n+1/2)) / 2 is at
// n, and what it takes in a step is c |v(n-1/2) + v(n+1/2)|^2 dt / 4 >= 0 whatever dt: the stable step stays as it is.
//   v(n+1/2) = ((1 - k) v(n-1/2) + F dt / m) / (1 + k),  k = c dt / 2 m
//
// Sums are made in chunks of nodes that do not depend on the number of threads.
class Integrator {
 public:
  Integrator(std::vector<double> mass, Vec3s is_free, Vec3s dashpot = {},
             InstructionSet instructions = best_instructions());

  StepSums advance(Motion& motion, const Vec3s& internal, const Vec3s& reference, const NodalLoads& loads,
                   double damping, StepSizes steps, double velocity_limit, Team& team = Team::alone());

  const std::vector<double>& mass() const { return mass_; }
  const Vec3s& is_free() const { return is_free_; }
  const Ledger& ledger() const { return ledger_; }
  // Elastic energy at n where u . (f0 + K u / 2) is not it [J].
  void set_elastic(double energy) { ledger_.elastic = energy; }
  // Of zones that yield (yielding_zones.hpp), at n: what the elastic energy has beside u . (f0 + f_int) / 2, and what they
  // have dissipated [J].
  void book_yielding(double energy, double dissipated) {
    ledger_.elastic += energy;
    ledger_.work.yielded = dissipated;
  }
  // Starts the ledger anew, at a motion from the reference state where no force acts yet.
  void start_ledger(const Motion& motion);

 private:
  std::vector<double> mass_;  // [kg]
  Vec3s is_free_;             // 1 or 0 by component
  Vec3s mobility_;            // is_free / m [1/kg]
  Vec3s dashpot_;             // [N s/m]
  Vec3s applied_;             // forces at the interface's nodes, zero elsewhere [N]
  NodeKernel kernel_;
  std::vector<NodeSums> sums_;  // per chunk
  Ledger ledger_;
  Work rest_;  // the second half of the last step's work, not yet booked
};

}  // namespace lockstep::continuum
