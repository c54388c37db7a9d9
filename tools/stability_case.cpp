#include "tools/stability_case.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "common/checks.hpp"

namespace lockstep {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint64_t walk = 3000;         // exchanges that the assembled step is walked for
constexpr std::uint64_t shortest_run = 300;  // exchanges
constexpr double longest_run = 3;  // onsets: from a thousand times the start's energy to what preloads hold and beyond

constexpr double packing_fraction = 0.9;  // of the step that makes the packing
constexpr double restless = 0.02;         // unbalanced ratio

// The number in "step N: ...", wherever it stands in the words.
std::uint64_t step_in(const std::string& words) {
  const std::size_t at = words.find("step ");
  return at == std::string::npos ? 0 : std::strtoull(words.c_str() + at + 5, nullptr, 10);
}

struct Failure {
  ExitCode code = ExitCode::Success;
  std::string words;
};
Failure failure_of(const std::exception_ptr& thrown) {
  if (!thrown) return {};
  try {
    std::rethrow_exception(thrown);
  } catch (const Error& e) {
    return {e.code(), e.what()};
  }
}

}  // namespace

const char* name_of(Class c) {
  switch (c) {
    case Class::StableAsPredicted:
      return "stable as predicted";
    case Class::StableBeyond:
      return "stable beyond";
    case Class::Caught:
      return "unstable and caught";
    case Class::Missed:
      return "unstable and missed";
    case Class::WrongWithin:
      return "wrong within the limit";
    case Class::StoppedForNothing:
      return "stable but stopped";
    case Class::TooSlow:
      return "too slow to show";
  }
  return "";
}

Class Point::verdict() const {
  if (is_within()) return truth == Truth::Unstable || is_stopped ? Class::WrongWithin : Class::StableAsPredicted;
  if (truth == Truth::Unstable) return is_stopped ? Class::Caught : Class::Missed;
  if (truth == Truth::TooSlow) return is_stopped ? Class::Caught : Class::TooSlow;
  return is_stopped ? Class::StoppedForNothing : Class::StableBeyond;
}

Ending run_to_end(const SceneFile& scene, const dem::RunOptions& options) {
  Outcome o = try_both(scene, options);
  Ending e;
  e.reports = std::move(o.reports);
  const Failure grains = failure_of(o.grains_failed), zones = failure_of(o.zones_failed);
  if (grains.code == ExitCode::Success && zones.code == ExitCode::Success) return e;
  for (const auto& [failure, thrown] : {std::pair(&grains, &o.grains_failed), std::pair(&zones, &o.zones_failed)}) {
    if (failure->code == ExitCode::Success || failure->words.starts_with("peer gave up")) continue;
    if (failure->code != ExitCode::Numerical) std::rethrow_exception(*thrown);
    if (e.is_stopped && step_in(failure->words) > e.at_step) continue;
    e.is_stopped = true, e.words = failure->words, e.at_step = step_in(failure->words);
  }
  if (!e.is_stopped) throw InternalError("a side gave up and neither says why: " + grains.words + "; " + zones.words);
  return e;
}

double predicted_limit(const CoupledBar& bar) { return run_to_end(bar.scene(1, 0)).reports.zones.first_time_step; }

void measure_bar(Point& p, const CoupledBar& bar, double predicted) {
  const auto begin = Clock::now();
  const BarCase& c = bar.setting();
  p.contrast = c.contrast, p.mass_ratio = c.mass_ratio, p.columns = c.columns;
  p.damping = c.damping, p.exchange_interval = c.exchange_interval;
  p.predicted = predicted;
  // With several steps to an exchange the highest frequency does not tell the limit.
  p.exact = c.exchange_interval == 1 ? bar.exact_limit() : 0.0;
  p.time_step = p.asked * (p.is_of_exact ? p.exact : p.predicted);
  const CoupledBar::Growth growth = bar.growth(p.time_step, walk);
  p.onset = growth.onset;
  if (!p.radius_is_of_walk()) {
    p.radius = bar.spectral_radius(p.time_step);
    p.truth = p.radius > 1 ? Truth::Unstable : Truth::Stable;
    p.evidence = "spectral radius";
  } else {
    p.radius = growth.rate;
    p.truth = growth.grows ? Truth::Unstable : growth.is_bounded ? Truth::Stable : Truth::TooSlow;
    p.evidence = "assembled step";
  }
  if (p.truth == Truth::Unstable && p.onset == 0) p.truth = Truth::TooSlow;
  p.steps =
      std::max(shortest_run, static_cast<std::uint64_t>(longest_run * static_cast<double>(p.onset)) + shortest_run);
  const Ending e = run_to_end(bar.scene(p.time_step / p.predicted, (static_cast<double>(p.steps) - 0.5) * p.time_step));
  p.is_stopped = e.is_stopped, p.at_step = e.at_step, p.words = e.words;
  if (p.truth == Truth::Unstable && p.radius_is_of_walk() && !e.is_stopped) {
    // Local damping is not linear: just above the limit the phases decide whether a mode grows, and they differ in the last digits.
    const double moves = std::abs(e.reports.grains.energies.kinetic) + std::abs(e.reports.zones.ledger.kinetic);
    if (moves < bar.start_energy()) {
      p.truth = Truth::Stable;
      p.evidence = fmt::format("the walk grows, the run itself ends with {:.1e} of the start's energy",
                               moves / bar.start_energy());
    }
  }
  p.seconds = std::chrono::duration<double>(Clock::now() - begin).count();
}

// ------------------------------------------------------------------------------------------------ scenes

namespace {

std::string scene_text(Scene scene, double damping, double step_fraction) {
  std::string text =
      "continuum {\n"
      "  youngs_modulus: 44.3e6 poisson_ratio: 0.3 density: 1630\n"
      "  block { width_x: 0.3 width_y: 0.3 height: 0.3 zones_x: 3 zones_y: 3 zones_z: 3 }\n"
      "  initial_supports: ROLLERS supports: ROLLERS\n"
      "}\n"
      "balance { servo: NONE ";
  if (scene == Scene::Packing)
    text +=
        "tolerance: 3e-3 }\n"
        "grains {\n"
        "  density: 2650 contact_modulus: 94e6 stiffness_ratio: 8 friction: 0.7 interface_friction: 1\n"
        "  pebbles: 3 elongation: 1.5\n"
        "  packing {\n"
        "    count: 200 porosity: 0.37 bulk_density: AS_PACKED cube_grains: 200\n"
        "    box { width_x: 0.3 width_y: 0.3 bottom: 0 fill_height: 0.3 }\n"
        "  }\n"
        "}\n";
  else
    // Flies in at 1 m/s: straight down under a weight that brings it back again and again, or at a slant with spin.
    text += fmt::format(
        "max_cycles: 0 }}\n"
        "gravity: {}\n"
        "grains {{\n"
        "  density: 2650 contact_modulus: 94e6 friction: 0.5 interface_friction: 0.5\n"
        "  grain {{ center {{ x: 0.013 y: -0.021 z: 0.0505 }} radius: 0.05 velocity {{ x: {} z: -1 }} spin {{ y: {} }} "
        "}}\n"
        "}}\n",
        scene == Scene::Bounce ? 200 : 0, scene == Scene::Bounce ? 0.0 : 0.7, scene == Scene::Bounce ? 0 : 4);
  const double duration = scene == Scene::Packing ? 0.15 : scene == Scene::Bounce ? 0.1 : 0.01;
  return text + fmt::format(
                    "apply {{ max_steps: 0 }}\n"
                    "run {{ duration: {} damping: {} continuum_damping: {} }}\n"
                    "fidelity {{ step_fraction: {} }}\n"
                    "coupling {{ peer_timeout: 600 }}\n",
                    duration, damping, damping, step_fraction);
}

SceneFile scene_file(Scene scene, double damping, double step_fraction) {
  return parse_scene(scene_text(scene, damping, step_fraction), "scene of the stability map");
}

// Without what gravity gave.
double energy_of(const Reports& r) {
  const dem::GrainEnergies& grains = r.grains.energies;
  const continuum::Ledger& zones = r.zones.ledger;
  return grains.kinetic + grains.elastic - grains.gravity_work + zones.kinetic + zones.elastic - zones.work.gravity;
}

}  // namespace

void measure_scene(Point& p, Scene scene, const std::filesystem::path& packing) {
  const auto begin = Clock::now();
  dem::RunOptions options;
  if (scene == Scene::Packing) {
    options.packing = packing;
    // Made once, by steps as they should be; those that are asked for count from Apply on.
    if (!std::filesystem::exists(packing)) run_to_end(scene_file(scene, p.damping, packing_fraction), options);
  }
  const Ending quarter = run_to_end(scene_file(scene, p.damping, 0.25 * p.asked), options);
  if (quarter.is_stopped)
    throw NumericalError("a quarter of " + std::to_string(p.asked) +
                         " of the limit does not run either: " + quarter.words);
  const Reports& right = quarter.reports;
  p.predicted = right.zones.first_time_step / (0.25 * p.asked);
  p.time_step = p.asked * p.predicted;
  const Ending run = run_to_end(scene_file(scene, p.damping, p.asked), options);
  p.is_stopped = run.is_stopped, p.at_step = run.at_step, p.words = run.words;
  p.steps = right.zones.steps / 4;
  Ending unwatched = run;
  if (run.is_stopped) {
    options.watches_shivering = false;
    SceneFile file = scene_file(scene, p.damping, p.asked);
    file.scene.mutable_coupling()->set_ledger(false);
    unwatched = run_to_end(file, options);
  }
  const Reports& seen = unwatched.reports;
  if (unwatched.is_stopped) {
    p.truth = Truth::Unstable;
    p.evidence = "breaks down at step " + std::to_string(unwatched.at_step);
  } else if (scene == Scene::Packing) {
    const double ratio = seen.grains.unbalanced_ratio, at_rest = right.grains.unbalanced_ratio;
    const double settlement = seen.zones.settlement / right.zones.settlement - 1;
    const double contacts = static_cast<double>(seen.grains.contacts) / static_cast<double>(right.grains.contacts) - 1;
    const bool is_restless = ratio > restless && ratio > 5 * at_rest;
    p.truth = is_restless || std::abs(settlement) > 0.1 || std::abs(contacts) > 0.1 ? Truth::Unstable : Truth::Stable;
    p.evidence = fmt::format("unbalanced ratio {:.1e} ({:.1e} at a quarter), settlement {:+.1f} %, contacts {:+.1f} %",
                             ratio, at_rest, 100 * settlement, 100 * contacts);
  } else {
    const double start = right.grains.start_energies.kinetic;
    const double gained = (energy_of(seen) - energy_of(right)) / start;
    p.truth = gained > 1 ? Truth::Unstable : Truth::Stable;
    p.evidence = fmt::format("energy {:+.3f} of the start's against the quarter step", gained);
  }
  p.seconds = std::chrono::duration<double>(Clock::now() - begin).count();
}

}  // namespace lockstep
