// Contacts between grains: pairs of pebbles of different bodies, their springs, and the forces they put on the bodies.
//
//   cells ----> outer list (skin 6 s) ----> inner list (skin s) ----> forces, once a step
//        rare                     cheap, in order        every entry owns its spring; about 9 of 10 entries touch
//
// Both lists are half lists sorted by pebble pair (i, j), and the forces are added in that order: bits do not depend on
// the skin, nor on when a list was renewed. Springs are carried from list to list by merging the two sorted lists.
//
// When a list is renewed. Each body has a reach u_b: how far any of its pebbles has moved or grown since the list was
// made. A pair cannot close a gap of s before u_a + u_b > s, so the sum of the two largest u of all bodies is the test.
// It is exact travel and not a sum of speeds: a rattler that flies to and fro in its cage renews the list no more than
// its cage is wide.
//
// Rejected: one record per contact gathered by body (1.7 times slower, facts of the kernel study), a list walked twice
// (both bodies; same), structure-of-arrays (no faster for pairs). What a pair needs of its two sides stands in two
// 64-byte records each; loads are summed in a third.
//
// Periodic cell: pairs carry the whole cells between their images; bodies are never moved back into the cell.
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/hash.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/neighbor_search.hpp"
#include "dem_server/particles.hpp"

namespace lockstep::dem {

// Of one call of compute, that is of one step.
struct ContactTotals {
  std::int64_t active = 0;           // touching pairs of pebbles
  double normal_force = 0;           // sum of |F_n| [N]
  double contact_force = 0;          // sum of |F| [N]
  double elastic_energy = 0;         // in all springs, at t_n [J]
  double slip_work = 0;              // taken out by sliding in this step [J]
  double dashpot_work = 0;           // taken out by dashpots in this step [J]
  double largest_overlap_ratio = 0;  // overlap over the smaller equivalent radius [-]
};

class PairContacts {
 public:
  // `skin` of the inner list [m], about 0.05 of a radius. With `period` the cell is 0..period and images interact.
  explicit PairContacts(double skin, std::optional<Vec3> period = {});

  // Takes over positions and velocities, and renews the lists if the grains have moved too far. Call it once a step,
  // before compute, with pebble centres placed. NumericalError when a position is not finite.
  void update(const Particles& particles);

  // Contact forces at t_n, added to `particles.force` and `.torque`. `time_step` is the step that led to t_n [s].
  ContactTotals compute(Particles& particles, const GrainMaterial& material, double time_step);

  // Visits each touching pair, as of the last compute, in order. With a periodic cell `point` lies beside body A.
  template <class Visitor>
  void for_each_contact(Visitor&& visit) const {
    for (std::size_t k = 0; k < pairs_.size(); ++k)
      if (history_[k].normal != Vec3::Zero()) visit(view(k));
  }

  // From the centre of mass of A to that of B's image, for the contact `k` of the list: what mean stress needs in a
  // periodic cell, where the bodies' positions alone do not say which image touches.
  template <class Visitor>
  void for_each_branch(Visitor&& visit) const {
    for (std::size_t k = 0; k < pairs_.size(); ++k)
      if (history_[k].normal != Vec3::Zero()) visit(view(k), branch(k));
  }

  // Springs and normals of touching pairs.
  void hash(Hash& h) const;
  // Contacts as they are carried across a restart: the touching pairs and what they remember, in order.
  struct Spring {
    std::int32_t i, j;  // pebbles
    ContactHistory history;
  };
  std::vector<Spring> springs() const;
  // Lists are made anew at the next update, which keeps these springs (pairs that are out of reach are dropped).
  void restore(const std::vector<Spring>& springs);
  // Forgets springs and lists: after bodies were added, removed or renumbered.
  void clear_history();

  std::int64_t rebuilds() const { return rebuilds_; }    // of the outer list, from cells
  std::int64_t refreshes() const { return refreshes_; }  // of the inner list, from the outer one
  std::size_t entries() const { return pairs_.size(); }  // of the inner list

 private:
  struct alignas(64) PebbleRecord {
    double x, y, z, radius;            // [m]
    double lever_x, lever_y, lever_z;  // from the body's centre of mass [m]
    double unused;
  };
  struct alignas(64) BodyRecord {
    double vx, vy, vz;         // [m/s]
    double wx, wy, wz;         // [rad/s]
    double equivalent_radius;  // [m]
    double mass;               // [kg]
  };
  struct alignas(64) Load {
    double fx, fy, fz, tx, ty, tz, unused_0, unused_1;  // [N], [N m]
  };
  // Where a list found a pebble.
  struct Mark {
    double x, y, z, radius;  // [m]
  };
  struct Travel {
    double largest = 0, second = 0;  // of all bodies, since the list was made [m]
    double sum() const { return largest + second; }
  };

  void load(const Particles& particles);
  Travel travel_since(const std::vector<Mark>& marks, const Particles& particles) const;
  void rebuild_outer(const Particles& particles);
  void refresh_inner();
  template <bool is_periodic, bool has_dashpot>
  ContactTotals compute_pairs(double time_step);
  ContactView view(std::size_t k) const;
  Vec3 center_to_center(std::size_t k) const;
  Vec3 branch(std::size_t k) const;
  ContactMaterial pair_material(const PebblePair& pair) const;

  double skin_;
  std::optional<Vec3> period_;
  GrainMaterial material_;
  bool has_lists_ = false;
  std::int64_t rebuilds_ = 0, refreshes_ = 0;

  NeighborSearch search_;
  std::vector<PebblePair> outer_;
  std::vector<Mark> outer_marks_, inner_marks_;

  // The inner list, entry by entry.
  std::vector<PebblePair> pairs_;
  std::vector<ContactHistory> history_;
  std::vector<std::array<std::int16_t, 3>> image_;  // whole cells added to x_j - x_i; empty without a period
  std::vector<PebblePair> next_pairs_;
  std::vector<ContactHistory> next_history_;

  // State at t_n as of the last update.
  std::vector<PebbleRecord> pebbles_;
  std::vector<BodyRecord> bodies_;
  std::vector<Load> loads_;
};

}  // namespace lockstep::dem
