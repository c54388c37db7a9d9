// Grains alone: nobody moves facets, since there are none, and the grains hold their own step.
#pragma once
#include <limits>

#include "dem_server/course.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/settings.hpp"

namespace lockstep::dem {

class NoPeer : public Boundary {
 public:
  NoPeer(Course& course, const Settings& settings) : course_(course), settings_(settings) {}

  bool move_facets(Model& model) override;
  void take_forces(Model&) override {}

 private:
  // As in a coupled run the step is cut when contacts ask for it, and never grows.
  void renew_step(Model& model);

  Course& course_;
  const Settings& settings_;
  double time_step_ = std::numeric_limits<double>::infinity();  // of the next steps [s]
  double told_ = std::numeric_limits<double>::infinity();       // as last logged [s]
};

}  // namespace lockstep::dem
