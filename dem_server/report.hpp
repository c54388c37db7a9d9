// What a run came to: a report for whoever called, and the summary in the results folder.
#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/coupled_ledger.hpp"
#include "common/results.hpp"
#include "common/scene.hpp"
#include "common/stopwatch.hpp"
#include "common/vectors.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/ledger.hpp"
#include "dem_server/packing.hpp"
#include "dem_server/settings.hpp"

namespace lockstep::dem {

// Of a `wall` block at the end.
struct WallReport {
  Vec3 force = Vec3::Zero();  // on the wall [N]
  double pressure = 0;        // on its servo's area; 0 without a servo [Pa]
};

// For tests and for main's last words.
struct RunReport {
  std::uint64_t steps = 0;
  double time = 0;                  // since the start of Apply [s]
  std::uint64_t state_hash = 0;     // of the whole state of the grains at the end
  std::uint64_t position_hash = 0;  // of the interface nodes as the grains hold them
  std::size_t grains = 0;
  double ring_mismatch = 0;    // at the end of Balance, worst side ring or tip, over its tolerance [-]
  double bottom_mismatch = 0;  // at the end of Balance: bottom less weight and tip, over its tolerance [-]
  double pile_start = 0;       // z of the tip at S = 0 [m]
  double s_over_d = 0;
  double tip_resistance = 0;             // mean of the last history row [Pa]
  double shaft_force = 0;                // [N]
  Vec3 interface_force = Vec3::Zero();   // last F(n), on the continuum [N]
  double energy_residual = 0;            // over the work done [-]
  double worst_vertical_imbalance = 0;   // over the largest term [-]
  double worst_action_reaction = 0;      // over the largest force sum [-]
  std::optional<CoupledLedger> coupled;  // of both sides together
  double unbalanced_ratio = 0;           // of the grains, the latest that was summed up [-]
  std::uint64_t contacts = 0;            // of grains with grains and facets that touch, likewise
  double kinetic_energy = 0;             // of the grains [J]
  GrainEnergies start_energies;          // kinetic and elastic, at the first step
  GrainEnergies energies;                // at the last step whose energies were summed up
  Vec3 momentum = Vec3::Zero();          // [kg m/s]
  double mass = 0;                       // of the grains [kg]
  std::vector<WallReport> walls;
  double seconds = 0;                                       // of the whole run [s]
  double measuring_seconds = 0;                             // of them in the block `measure` [s]
  std::optional<std::uint64_t> bytes_sent, bytes_received;  // none without a peer
  bool is_interrupted = false;                              // by the user of either side
  std::string end;                                          // the continuum's words
};

// Fills in what the model says of its state.
void report_state(RunReport& report, const Model& model, const Settings& settings);

// How long each stage took, and what it came to.
class StageRecord {
 public:
  void begin() { watch_.restart(); }
  double seconds() const { return watch_.seconds(); }  // of the stage so far [s]
  void end(const std::string& name, Json entry) { stages_.add(name, entry.add("seconds", seconds())); }
  const Json& entries() const { return stages_; }

 private:
  Stopwatch watch_;
  Json stages_;
};

// The summary of a run, from what its parts hold at the moment; it may have failed.
Json make_summary(const SceneFile& scene, const Settings& settings, const Assembly& assembly, const Model& model,
                  const StageRecord& stages, const RunReport& report);

}  // namespace lockstep::dem
