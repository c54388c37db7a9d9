// Contacts between grains: pairs of pebbles of different bodies, their springs, and the forces they put on the bodies.
//
//   cells ----> outer list (skin 6 s) ----> inner list (skin up to s) ----> forces, once a step
//        rare                     cheap, in order              every entry owns its spring; most entries touch
//
// Both lists are half lists sorted by pebble pair (i, j), and the forces are added in that order: bits do not depend on
// the skin, nor on when a list was renewed. Springs are carried from list to list by merging the two sorted lists.
//
// CHUNKS. The lists are cut into chunks of chunk_bodies bodies (those of i), filled up to whole tiles of eight entries.
// A chunk is what a thread works on, and what sums are taken over: neither depends on how many threads there are.
//
// THREADS work on parts: ranges of chunks and with them their bodies, a few for each thread, taken by who is free. A contact
// across a border of parts is computed for both, each adding the load of its own body: the upper one from a copy of the
// entry in its `border`, before its own chunks, which keeps the order of the list for each body. So nothing is shared
// while forces are summed, and any number of threads gives the same bits.
//
// WHEN A LIST IS RENEWED. Each pebble has a limit h: how far it may move from where the list found it. A pair that is not
// in the inner list has a gap of at least h_i + h_j, so both may go so far. What a pebble used of its last limit tells
// what it needs next: beside a pile grains move much faster than farther off, and one limit for all would fill the list
// with pairs that do not touch (2.3 entries a contact instead of 1.4 in the paper's case at S/D = 0.05). Half the skin is
// the widest limit. A pebble that has used that up while all others have hardly moved, a rattler flying in its cage, would
// renew the list again and again; such a pebble gets all its outer partners into the inner list, and in exchange a limit
// of what the outer skin leaves. When it has used that up, it alone is listed anew in the outer list. The first list knows
// nothing of its pebbles: it has the widest limit for all and is renewed soon. Displacements are exact travel, not sums of
// speeds. The skin follows the motion: lists that do not last get a wider one, lists that last for long a tighter one;
// only counts of steps decide, so that a run repeats itself.
//
// Rejected: one record per contact gathered by body (1.7 times slower), a list walked twice (both bodies; same),
// structure-of-arrays (no faster for pairs).
//
// Periodic cell: pairs carry the shift between their images; bodies are never moved back into the cell.
// A cell that strains carries the bodies and the marks along: travel is measured relative to it, and what the strain takes
// from the gaps counts as growth of the pebbles.
#pragma once
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/hash.hpp"
#include "common/instructions.hpp"
#include "common/parallel.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/neighbor_search.hpp"
#include "dem_server/pair_kernel.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/travel.hpp"

namespace lockstep::dem {

// Of one call of compute, that is of one step: the works from Detail::Works on, the rest with Detail::All.
struct ContactTotals {
  double slip_work = 0;              // taken out by sliding in this step [J]
  double dashpot_work = 0;           // taken out by dashpots in this step [J]
  std::int64_t active = 0;           // touching pairs of pebbles
  double normal_force = 0;           // sum of |F_n| [N]
  double contact_force = 0;          // sum of |F| [N]
  double normal_energy = 0;          // elastic, in normal springs, at t_n [J]
  double shear_energy = 0;           // elastic, in shear springs, at t_n [J]
  double largest_overlap_ratio = 0;  // overlap over the smaller equivalent radius [-]
  Vec3 virial = Vec3::Zero();        // sum of force on A times branch to B, by component; periodic cells only [J]
  double elastic_energy() const { return normal_energy + shear_energy; }
};

class PairContacts {
 public:
  // `skin` of the inner list to begin with [m], about 0.03 of a radius; it stays within skin_range of that. With `period` the cell is 0..period and images interact.
  explicit PairContacts(double skin, std::optional<Vec3> period = {},
                        InstructionSet instructions = best_instructions());

  // Renews the lists if the grains have moved too far. Call it once a step, before anything is computed, with pebble
  // centres placed. `ways`, per chunk of chunk_bodies, is how far pebbles have gone at most since the last call
  // (MotionTotals), by motion alone: chunks that cannot have come to a limit are not looked at. Without it all are.
  // NumericalError when a position is not finite.
  void update(const Particles& particles, Team& team = Team::alone(), std::span<const double> ways = {});

  // Contact forces at t_n, added to the loads of `particles`. `time_step` is the step that led to t_n [s].
  ContactTotals compute(Particles& particles, const GrainMaterial& material, double time_step,
                        Detail detail = Detail::All, Team& team = Team::alone());

  // The cell of a periodic crowd strains at `rate` along x, y, z for `time_step`, and the bodies, whose velocities are those
  // relative to the cell, are carried along. Call it once a step, after integrate(); the next compute() knows the rate.
  void strain(Particles& particles, const Vec3& rate, double time_step);
  const std::optional<Vec3>& period() const { return period_; }  // [m]

  // How far pebbles may go before the next renewal, and which parts bodies are in until then.
  TravelLimits limits() const;
  const Partition& partition() const { return partition_; }

  // Visits each pair that overlaps at the present positions, in order. With a periodic cell `point` lies beside body A.
  template <class Visitor>
  void for_each_contact(const Particles& particles, Visitor&& visit) const {
    for_each_branch(particles, [&](const ContactView& contact, const Vec3&) { visit(contact); });
  }
  // With the branch from the centre of mass of A to that of B's image: in a periodic cell positions alone do not say
  // which image touches.
  template <class Visitor>
  void for_each_branch(const Particles& particles, Visitor&& visit) const {
    for (const Chunk& chunk : chunks_) visit_chunk(particles, chunk, visit);
  }
  // Those of some bodies alone, `is_wanted` per body: entries of others are passed over before their places are read.
  template <class Visitor>
  void for_each_contact_of(const Particles& particles, const std::vector<char>& is_wanted, Visitor&& visit) const {
    const auto is_wanted_pebble = [&](std::int32_t p) { return is_wanted[particles.pebble_body(p)] != 0; };
    for (const Chunk& chunk : chunks_)
      for (std::size_t k = 0; k < chunk.count; ++k) {
        const PairTile& tile = chunk.pairs[k / tile_size];
        if (!is_wanted_pebble(tile.i[k % tile_size]) && !is_wanted_pebble(tile.j[k % tile_size])) continue;
        if (const Entry entry = entry_of(particles, chunk, k); entry.contact.overlap > 0) visit(entry.contact);
      }
  }
  // Those of the bodies of a part (partition()), each body's in the order of the list. A contact across a border is in two.
  template <class Visitor>
  void for_each_contact_of_part(const Particles& particles, int part, Visitor&& visit) const {
    const auto p = static_cast<std::size_t>(part);
    const auto visit_contact = [&](const ContactView& contact, const Vec3&) { visit(contact); };
    visit_chunk(particles, borders_[p], visit_contact);
    for (std::size_t c = part_chunk_[p]; c < part_chunk_[p + 1]; ++c) visit_chunk(particles, chunks_[c], visit_contact);
  }

  // Springs of the pairs that have one.
  void hash(Hash& h) const;
  // Contacts as they are carried across a restart: the pairs that hold a spring, in order.
  struct Spring {
    std::int32_t i, j;  // pebbles
    Vec3 force;         // on A [N]
  };
  std::vector<Spring> springs() const;
  // Lists are made anew at the next update, which keeps these springs (pairs that are out of reach are dropped).
  void restore(const Particles& particles, const std::vector<Spring>& springs);
  // Forgets springs and lists: after bodies were added, removed or renumbered.
  void clear_history();

  std::int64_t rebuilds() const { return rebuilds_; }    // of the outer list, from cells
  std::int64_t refreshes() const { return refreshes_; }  // of the inner list, from the outer one
  std::size_t memory() const;                            // [bytes]
  InstructionSet instructions() const { return instructions_; }

 private:
  // A stretch of the inner list, in tiles.
  struct Chunk {
    std::vector<PairTile> pairs;
    std::vector<BodyTile> bodies;     // empty for spheres
    std::vector<ShiftTile> shifts;    // empty without a period
    std::vector<SpringTile> springs;  // empty without friction
    std::size_t count = 0;            // of entries; the last tile may hold more
    std::int32_t last_body = -1;      // the largest B
  };
  // A stretch of the outer list: partners of the pebbles of a chunk's bodies.
  struct OuterChunk {
    std::vector<std::int32_t> begin;  // one more than pebbles
    std::vector<std::int32_t> partners;
  };
  struct Entry {
    ContactView contact;
    Vec3 branch;
  };
  class Writer;

  template <class Visitor>
  void visit_chunk(const Particles& particles, const Chunk& chunk, Visitor&& visit) const {
    for (std::size_t k = 0; k < chunk.count; ++k)
      if (const Entry entry = entry_of(particles, chunk, k); entry.contact.overlap > 0)
        visit(entry.contact, entry.branch);
  }
  double used_up(const Particles& particles) const;  // of each pebble's limit by growth and strain, inner list [m]
  double outer_used_up(const Particles& particles) const;  // [m]
  bool has_left(const Particles& particles, Team& team, std::span<const double> ways);
  double slack(const Particles& particles, std::size_t chunk, double used) const;
  void renew_outer(const Particles& particles, double ended_skin, Team& team);
  void list_anew(const Particles& particles, const std::vector<std::int32_t>& strays);
  void adapt_skin();
  void rebuild_outer(const Particles& particles, Team& team);
  void refresh_inner(const Particles& particles, double ended_skin, int ended_age, Team& team);
  Vec3 shift_between(const Particles& particles, std::int32_t i, std::int32_t j) const;
  std::span<const std::int32_t> near_partners(const Particles& particles, std::int32_t i, const std::int32_t* partners,
                                              std::span<std::int32_t> near) const;
  void fill_chunk(const Particles& particles, std::size_t chunk, Chunk& scratch);
  void fill_border(const Particles& particles, int part);
  void share_out(const Particles& particles, int parts);
  static int parts_for(const Team& team);
  Entry entry_of(const Particles& particles, const Chunk& chunk, std::size_t k) const;
  std::size_t chunk_count(const Particles& particles) const;
  std::int32_t chunk_body(const Particles& particles, std::size_t chunk) const;
  std::int32_t chunk_pebble(const Particles& particles, std::size_t chunk) const;

  double first_skin_;                // [m]
  double skin_;                      // of the present inner list [m]
  double outer_reach_ = 0;           // largest gap that the outer list took [m]
  int age_ = 0;                      // of the inner list, in updates
  bool are_limits_guesses_ = false;  // of the first list, that no other came before
  std::optional<Vec3> period_;
  InstructionSet instructions_;
  GrainMaterial material_;
  bool has_lists_ = false;
  std::int64_t rebuilds_ = 0, refreshes_ = 0;

  NeighborSearch search_;
  std::vector<OuterChunk> outer_;
  LargeArray<SphereRecord> outer_marks_;  // per pebble: centre when the outer list was made, or when it was listed anew
  std::vector<std::int32_t> relisted_;    // the pebbles that were, since
  LargeArray<SphereRecord> marks_;        // per pebble: centre at the last renewal, and its limit
  std::vector<double> slack_;             // per chunk: no pebble goes beyond its limit within this way from here [m]
  double slack_use_ = 0;                  // used_up() when it was found [m]
  std::uint64_t placements_ = 0;          // of the pebbles then
  std::vector<double> reach_;  // per pebble: radius and limit; far for one that gets all its outer partners [m]
  double outer_growth_ = 0, growth_ = 0;       // Particles::growth() then [m]
  double outer_strain_ = 0, strain_mark_ = 0;  // strained_ then
  Vec3 strain_rate_ = Vec3::Zero();            // in the step that led to t_n [1/s]
  double strained_ = 0;                        // sum of the cell's largest strain increments, whatever their sign
  double half_reach_ = 0;                      // half the largest distance of a pair in the outer list [m]

  std::vector<Chunk> chunks_;
  std::vector<PairSums> sums_;           // per chunk
  std::vector<Chunk> borders_;           // per part
  std::vector<Chunk> scratch_;           // per thread
  std::vector<std::size_t> part_chunk_;  // first chunk of each part, and one more
  Partition partition_;
};

}  // namespace lockstep::dem
