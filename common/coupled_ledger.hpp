// What the interface does to force, moment, impulse, work and energy: booked at each exchange, by both sides alike, from
// numbers that both have. A coupling that is exact leaves nothing over in any line.
//
// Time levels. The interface's sums are those of t_n. The energies at hand in exchange n are both sides' of t_(n-1): they
// can only be known once v(n-1/2) is. They are booked where both are given, which need not be each exchange: works are
// sums over all steps on either side, so that a booking after many steps closes as well as one after each.
//
// When a step is too large, the scheme's own energy balance closes all the same (its quadratic invariant is kept, stable or
// not): the highest mode has a kinetic energy 1/2 m v(n-1/2) v(n+1/2) that falls below zero without end while the elastic
// energy rises. So the sign that something is wrong is |kinetic energy| beyond what can have been put in. Strain energy of the
// start explains as much as has been seen to come out of it: what a preload holds and keeps may be a million times what moves,
// and motion that is far less than that still counts.
//
// Contacts that open bound what grows: then it rattles, and each contact that closes for one step or two makes energy or
// loses it. That does not balance, and where it comes to half of all the energy that there can be, the run is over too.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "common/energies.hpp"
#include "common/results.hpp"
#include "common/vectors.hpp"

namespace lockstep {

// Of the contacts at the interface, at t_n. Moments are about the origin.
struct InterfaceSums {
  Vec3 nodes_force = Vec3::Zero();       // on the continuum [N]
  Vec3 particles_force = Vec3::Zero();   // on the grains [N]
  Vec3 nodes_moment = Vec3::Zero();      // of the nodal forces, at the places where contacts see the nodes [N m]
  Vec3 particles_moment = Vec3::Zero();  // of the forces on the grains, at the contact points [N m]
};

// Sum of x_j x F_j over nodes.
Vec3 moment_of(const Vec3s& position, const Vec3s& force);

class CoupledLedger {
 public:
  // `stop_at`: residual over work done that stops the run; 0: never.
  explicit CoupledLedger(double stop_at = 0) : stop_at_(stop_at) {}

  // The contacts of t_n act on both sides from t_n - dt/2 to t_n + dt/2.
  void book_interface(std::uint64_t step, double time, double dt, const InterfaceSums& sums);
  // Both sides' at one and the same time.
  void book_energies(const Energies& grains, const Energies& zones);

  // Why the run must end: the residual beyond stop_at or half of all energy, or kinetic energy that work does not explain.
  // Empty: it may go on.
  std::string alarm() const;

  bool has_energies() const { return has_energies_; }
  double residual() const { return residual_; }    // of both sides together, since the first booking [J]
  double work_done() const { return work_done_; }  // energy at the first booking and sum of |work| and losses since [J]
  double residual_fraction() const { return work_done_ > 0 ? residual_ / work_done_ : 0.0; }
  double interface_gap() const { return gap_; }     // works of the interface on both sides, added [J]
  double worst_force_gap() const;                   // |action + reaction| over the largest reaction [-]
  double worst_moment_gap() const;                  // the same of moments, over the largest moment [-]
  const Vec3& impulse() const { return impulse_; }  // on the nodes, sum of F dt [N s]

  static std::vector<std::string> columns();
  std::vector<double> row() const;
  Json summary() const;

 private:
  double stop_at_;
  std::uint64_t step_ = 0;
  double time_ = 0;  // [s]
  InterfaceSums sums_;
  Vec3 impulse_ = Vec3::Zero();                 // [N s]
  double force_gap_ = 0, largest_force_ = 0;    // worst, largest [N]
  double moment_gap_ = 0, largest_moment_ = 0;  // worst, largest [N m]
  bool has_energies_ = false;
  Energies grains_, zones_;                        // last booked
  double start_ = 0;                               // balance of both at the first booking [J]
  double residual_ = 0, work_done_ = 0, gap_ = 0;  // [J]
  double worst_residual_ = 0;                      // |residual| over work done [-]
  // Of both sides, at the first booking [J]; the outer work is that of gravity and boundaries.
  double start_kinetic_ = 0, start_elastic_ = 0, start_outer_ = 0;
  double put_in_ = 0;  // the most that outer work was seen to have added since: what swings to and fro counts once [J]
  double strained_ = 0;  // its moduli, added [J]
  double released_ = 0;  // the most that it was seen to have fallen by [J]
};

}  // namespace lockstep
