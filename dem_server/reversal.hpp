// Whether the grains' accelerations turn from one step to the next: the sign of a step that follows the contacts no more.
//
// A packing whose step is a little too long does not explode: friction and lost contacts bound the motion, local damping takes
// what grows, and what is left is a packing that shivers, carries less and creeps ("silent liquefaction"). No number is
// infinite, and the energies balance. But the modes that grow turn sign in each step, so that successive changes of velocity are
// opposite, where those of a motion that is followed are alike:
//   share = - sum m a(n) . a(n-1) / sum m |a|^2,
// in the mean (omega dt)^2 / 2 - 1 for a mode of omega: -1 for slow motion, 1 for modes at the limit and above. Packings and
// piles within the limit show -0.99 to -0.67, packings at 1.1 to 1.5 of the bound mostly 0.4 to 0.99 (common/README.md has the table).
//
// A mode just below the limit turns too, but dies out: what counts as well is that the accelerations of the last look are not far
// below those of the first one.
//
// It says nothing where nothing is damped: there a mode near the limit may live for ever and be followed, if badly; energies
// tell of its growth (common/coupled_ledger.hpp).
#pragma once
#include <cstdint>

#include "common/vectors.hpp"
#include "dem_server/particles.hpp"

namespace lockstep::dem {

class Reversal {
 public:
  // After each step. Looks at three steps of reversal_interval, the last of which is a multiple of it.
  void observe(std::uint64_t step, const Particles& particles);
  // Mean share of the last reversal_looks looks; -1 before there were as many.
  double mean_share() const { return looks_ < reversal_looks ? -1.0 : mean_; }
  bool is_alarming() const { return mean_share() > alarming_reversal && !is_dying_; }

  static constexpr std::uint32_t reversal_interval = 25;  // steps: with the next one an alarm within 100 of the onset
  static constexpr int reversal_looks = 4;
  static constexpr double alarming_reversal = 0.25;
  // Of the first look's sum m |a|^2, 75 steps before: below it what turns is dying out.
  static constexpr double dying_share = 0.5;
  // Of mean unbalanced over mean contact force. Below it grains are at rest by any scene's measure, and local damping, whose sign
  // is that of velocities about zero, turns what little is left as it likes; shivering packings have 5e-3 and more.
  static constexpr double least_unbalanced_ratio = 1e-3;

 private:
  void add(double share, double strength);

  Vec3s before_, change_;                 // velocity two steps ago, and what the next step added [m/s]
  double last_[reversal_looks] = {};      // share
  double strength_[reversal_looks] = {};  // sum m |dv|^2 of the same looks [J]
  bool is_dying_ = false;
  int looks_ = 0;
  double mean_ = -1;
};

}  // namespace lockstep::dem
