// Stages Apply and Penetrate (paper steps 4 to 7), whoever says how long a step is: the peer (exchange.hpp) or the grains
// themselves (alone.hpp). Where the pile is, what a step sums up, and what is recorded and watched after it.
#pragma once
#include "dem_server/cycle.hpp"
#include "dem_server/output.hpp"
#include "dem_server/progress.hpp"
#include "dem_server/report.hpp"
#include "dem_server/settings.hpp"
#include "dem_server/watch.hpp"

namespace lockstep::dem {

class Course {
 public:
  // All of them outlive this.
  Course(Model& model, const Settings& settings, Output& output, Watch& watch, ProgressLines& progress,
         StageRecord& stages)
      : model_(model), settings_(settings), output_(output), watch_(watch), progress_(progress), stages_(stages) {}

  void begin_apply();        // friction of walls and pile on; time, steps and ledger from zero
  void begin_penetration();  // S = 0: walls and pile move
  void finish();

  // Of the next step: the pile's speed, and what is summed up: what histories, alarms and `is_booked` ask for.
  void prepare_step(bool is_booked);
  // After it: alarms, histories, snapshots.
  void record_step();
  // The pile is there, or the user has had enough.
  bool is_over() const;

  bool is_penetrating() const { return part_ == Part::Penetrate; }
  double time() const { return model_.time - penetration_begin_; }  // since S = 0 [s]
  double pile_start() const { return pile_start_; }                 // the tip's z at S = 0; 0 before Apply [m]
  double penetration() const;                                       // S; 0 before Apply [m]
  double s_over_d() const;
  double unbalanced_ratio() const { return ratio_; }    // of the grains, the latest that was summed up [-]
  std::uint64_t contacts() const { return contacts_; }  // that touch, likewise

 private:
  void show_progress();
  void snapshot_if_due();

  Model& model_;
  const Settings& settings_;
  Output& output_;
  Watch& watch_;
  ProgressLines& progress_;
  StageRecord& stages_;

  enum class Part { Before, Apply, Penetrate } part_ = Part::Before;
  double pile_start_ = 0;
  double penetration_begin_ = 0;  // time at S = 0 [s]
  double next_snapshot_ = 0;      // S/D or seconds
  double ratio_ = 1;
  std::uint64_t contacts_ = 0;
};

}  // namespace lockstep::dem
