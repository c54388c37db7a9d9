// What a run leaves behind: a report for whoever called, and the files of the results folder.
#pragma once
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/results.hpp"
#include "continuum_client/cycle.hpp"
#include "continuum_client/equilibrium.hpp"
#include "continuum_client/initial_stress.hpp"
#include "continuum_client/observers.hpp"
#include "continuum_client/settings.hpp"

namespace lockstep::continuum {

struct StageReport {
  std::string name;         // as in protocol::Stage
  double seconds = 0;       // wall clock [s]
  std::string achievement;  // one line
};

// The hand-off: how much the interface moved while the contacts took over from the deleted zones.
struct JumpReport {
  double largest = 0;            // displacement of an interface node during Apply [m]
  double mean = 0;               // [m]
  double largest_in_facets = 0;  // over the mean facet size [-]
  double stress = 0;             // largest change of a stress component of a zone during Apply [Pa]
  double stress_fraction = 0;    // of the largest handed-over component; 0 where there was none [-]
  double force_difference = 0;   // |sum f_A - sum f_D(0)| / |sum of |f_A|| [-]
  double apply_ratio_zones = 0;  // unbalanced ratios at the end of Apply [-]
  double apply_ratio_grains = 0;
  std::uint64_t apply_steps = 0;
  bool apply_converged = true;
};

struct RunReport {
  std::vector<StageReport> stages;
  std::uint64_t zones = 0, zones_deleted = 0, nodes = 0, interface_nodes = 0, facets = 0;
  EquilibriumReport equilibrium;
  double bottom_vertical_stress = 0;  // sigma_zz of the lowest zones, mean [Pa]
  double k0 = 0;                      // horizontal over vertical stress, mean over the model [-]
  double excavation_residual = 0;     // worst unbalanced nodal force over the largest force of the baseline [-]
  JumpReport jump;

  std::uint64_t steps = 0;                         // of Apply and Penetrate
  double time = 0;                                 // coupled [s]
  double first_time_step = 0, last_time_step = 0;  // [s]
  std::string step_limited_by;
  int step_cuts = 0;
  Ledger ledger;
  std::optional<CoupledLedger> coupled;       // of both sides together
  std::optional<std::int64_t> zones_yielded;  // ever; without: no material yields
  std::int64_t zones_yielding = 0;            // in the last step
  double ledger_residual_fraction = 0;        // of the sum of all work and energy, moduli [-]
  double settlement = 0;                      // of the interface, mean of -u_z over its area, at the end [m]
  double largest_displacement = 0;            // of any node at the end, reference state at Excavate [m]
  double largest_strain_measure = 0;          // largest |u| over the mean facet size, to judge small strain by [-]

  std::vector<double> phase_seconds;  // by Phase [s]
  double seconds = 0;                 // of the whole run [s]
  double seconds_waiting = 0;         // for the peer, all stages [s]
  std::uint64_t bytes_sent = 0, bytes_received = 0;
  std::uint64_t state_hash = 0;     // of all displacements and velocities at the end
  std::uint64_t position_hash = 0;  // of the interface at the end
  bool is_interrupted = false;
  std::string finish_text;
};

// Writes into the results folder; does nothing without one.
class ResultFiles {
 public:
  ResultFiles(const std::filesystem::path& folder, const Settings& settings);

  bool is_active() const { return !folder_.empty(); }
  // Looks up the scene's points, sections and lines in the zones with is_left, which stay. InputError for places outside.
  void find_places(const Grid& grid, const std::vector<char>& is_left);
  // `initial` is the state that displacements start from. Steps rise from row to row: nothing for one that has its row, nor
  // for one that a run that failed went back to.
  void add_history(const CoupledGround& ground, const InitialState& initial);
  // Zones with is_left, sections and lines; not twice for one step.
  void add_snapshot(const CoupledGround& ground, const InitialState& initial, const std::vector<char>& is_left);
  void write_interface(const CoupledGround& ground, const Vec3s& traction);
  void write_summary(const RunReport& report, const std::string& title);

 private:
  // Displacement, velocity, stress and change of vertical stress since Excavate; strain and forces where they are asked for.
  void write_zones(const CoupledGround& ground, const InitialState& initial, const std::vector<char>& is_left);

  std::filesystem::path folder_;
  bool writes_zones_ = true;
  ResultSettings results_;
  std::unique_ptr<History> history_, coupled_history_;
  std::unique_ptr<Series> series_;
  std::optional<Observers> observers_;
  int snapshots_ = 0;
  std::uint64_t last_step_ = 0;  // of a snapshot
  std::uint64_t last_row_ = 0;   // step of the history's
};

}  // namespace lockstep::continuum
