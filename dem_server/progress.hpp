// The lines "@progress ..." that tools/run reads, two a second at most.
#pragma once
#include <string>
#include <string_view>

#include "common/stopwatch.hpp"
#include "dem_server/cycle.hpp"

namespace lockstep::dem {

class ProgressLines {
 public:
  explicit ProgressLines(bool is_wanted) : is_wanted_(is_wanted) {}

  // `fraction` of the stage.
  void show_packing(double fraction);
  // `more`: what the stage knows beside, as "key=value ...".
  void show(std::string_view stage, const Model& model, double unbalanced_ratio, std::string_view more);

 private:
  bool is_due();  // a line is wanted now, and no other for a while

  bool is_wanted_;
  bool has_shown_ = false;
  Stopwatch since_last_;
};

}  // namespace lockstep::dem
