// One point of the stability map: a small scene through both solvers, what they did, and what was true.
//
// The truth does not come from the programs' alarms.
//   Bars (tools/coupled_bar.hpp): the spectral radius of the assembled step without damping, else the assembled step itself,
//     walked until growth or decay shows; where it grows and the run does not stop, the run itself must end with less than it
//     started with to be called stable. TooSlow: neither shows in the steps that are walked.
//   Packing, grain and impact: the same scene at a quarter of the step is what is right. The run at the full step is repeated with
//     its alarms off (no ledger, no watch on shivering) where they had ended it, and is unstable where
//       - it breaks down: a speed, an overlap or a number that is none;
//       - packing: at rest it is not. Its unbalanced ratio ends above 0.02 and above 5 times that of the quarter step, or the
//         settlement of the ground or the number of contacts is off by a tenth: liquefied in silence;
//       - grain and impact, without damping: energy comes from nowhere, more than doubling what the scene has.
#pragma once
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "tools/coupled_bar.hpp"
#include "tools/in_process.hpp"

namespace lockstep {

enum class Truth { Stable, Unstable, TooSlow };
enum class Class {
  StableAsPredicted,  // within the predicted limit, and stable
  StableBeyond,       // beyond it, and stable all the same
  Caught,             // unstable beyond it, and ended by an alarm
  Missed,             // unstable beyond it, and ended as if all were well
  WrongWithin,        // within it, and unstable or ended by an alarm
  StoppedForNothing,  // beyond it, stable, and ended by an alarm
  TooSlow,            // unstable beyond it by so little that the run is too short to show it
};
const char* name_of(Class c);

// How a run ended. Errors that are not numerical are thrown on: they are no answer.
struct Ending {
  Reports reports;
  bool is_stopped = false;    // by NumericalError of either side
  std::string words;          // of the side that found it
  std::uint64_t at_step = 0;  // that they name
};
Ending run_to_end(const SceneFile& scene, const dem::RunOptions& options = {});

// What both sides hold to be the limit at the start: of a run that takes no step [s].
double predicted_limit(const CoupledBar& bar);

struct Point {
  std::string group;
  // What was asked for.
  double contrast = 0, mass_ratio = 0;  // bars
  int columns = 0;
  double damping = 0;
  std::uint32_t exchange_interval = 1;
  // Of the exact limit, or of the predicted one where there is no exact one.
  double asked = 0;
  bool is_of_exact = true;
  // What came of it.
  double predicted = 0, exact = 0, time_step = 0;  // exact: 0 where none is known [s]
  double radius = 0;        // spectral, without damping; with it the growth per exchange; 0: not known
  std::uint64_t steps = 0;  // that the run was to take
  std::uint64_t onset = 0;  // step with a thousand times the start's energy by the truth; 0: none
  Truth truth = Truth::Stable;
  std::string evidence;  // in words
  bool is_stopped = false;
  std::uint64_t at_step = 0;
  std::string words;
  double seconds = 0;

  Class verdict() const;
  bool radius_is_of_walk() const { return damping > 0 || exchange_interval > 1; }
  bool is_within() const { return time_step <= predicted * (1 + 1e-12); }
};

// Runs a bar at `point.asked` and fills in the rest.
void measure_bar(Point& point, const CoupledBar& bar, double predicted);

// Scenes whose truth is the quarter step.
enum class Scene { Packing, Bounce, Impact };
// `packing`: the file that a balanced packing is kept in.
void measure_scene(Point& point, Scene scene, const std::filesystem::path& packing);

}  // namespace lockstep
