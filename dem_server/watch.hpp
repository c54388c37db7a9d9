// What shows that a run has gone wrong, and the sound states that it goes back to then.
#pragma once
#include "common/good_states.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/packing_file.hpp"
#include "dem_server/reversal.hpp"
#include "dem_server/settings.hpp"

namespace lockstep::dem {

class Watch {
 public:
  // `start`: the model as it was made, which says how wide the scene is.
  Watch(const Model& start, const Settings& settings, bool watches_shivering);

  // Every few cycles: NumericalError with the reason and the remedy. In a packing in the making overlaps may be large.
  void look_at_packing(const Model& model) const;
  void look(const Model& model) const;
  // After each step. `unbalanced_ratio` is the latest that is known.
  void look_for_shivering(const Model& model, double unbalanced_ratio);

  // Once the model has passed look().
  void keep_good_state(const Model& model);
  // Brings the newest state back that the failure had not reached yet, if there is one.
  void return_to_good_state(Model& model);

 private:
  void check_motion(const Model& model) const;
  void check_overlap(const Model& model) const;
  void warn_of_tunnelling(const Model& model) const;

  const Settings& settings_;
  bool watches_shivering_;
  double reach_ = 0;  // of grains and interface from the origin [m]
  Reversal reversal_;
  GoodStates<PackingState> good_states_;
};

}  // namespace lockstep::dem
