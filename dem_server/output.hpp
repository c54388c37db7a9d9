// What dem_server leaves in the run's folder:
//   dem_history.csv                        one row every output.history_interval steps, forces averaged over them
//   dem_interface.csv                      what the interface does to both sides (common/coupled_ledger.hpp)
//   wall_history.csv                       the same rows for the walls of `wall` blocks
//   particles_NNNN.vtp, contacts_NNNN.vtp  snapshots, with particles.pvd and contacts.pvd over time
//   dem_summary.json                       stages, guarantees, shares of time
// What the block `measure` adds to these stands in observers.hpp.
#pragma once
#include <filesystem>
#include <memory>
#include <optional>

#include "common/coupled_ledger.hpp"
#include "common/results.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/observers.hpp"
#include "dem_server/settings.hpp"
#include "dem_server/wall_history.hpp"

namespace lockstep::dem {

class Output {
 public:
  // Nothing is written when `folder` is empty. `settings` must outlive this.
  Output(const Settings& settings, std::filesystem::path folder);

  // Takes part in the averages; writes a row when one is due. `s_over_d` is 0 without a pile.
  void record(const Model& model, double s_over_d, double unbalanced_ratio);
  // A row of dem_interface.csv: what the interface did to both sides.
  void record_interface(const CoupledLedger& ledger);
  // Particles and contacts, at most once per step.
  void snapshot(const Model& model, const Settings& settings);
  void summary(const Json& summary);

  // Mean over the last row's steps [Pa], [N].
  double tip_resistance() const { return tip_resistance_; }
  double shaft_force() const { return shaft_force_; }
  double measuring_seconds() const { return observers_ ? observers_->seconds() : 0.0; }  // [s]

 private:
  std::filesystem::path folder_;
  std::uint32_t interval_;
  std::unique_ptr<History> history_, interface_history_;
  WallHistory wall_history_;
  std::unique_ptr<Observers> observers_;  // none unless the scene asks
  bool splits_energies_ = false;
  std::optional<Series> particle_series_, contact_series_;
  int snapshots_ = 0;
  std::optional<std::uint64_t> last_snapshot_step_;
  std::uint32_t samples_ = 0;
  double tip_sum_ = 0, shaft_sum_ = 0;
  Vec3 interface_sum_ = Vec3::Zero();
  double tip_resistance_ = 0, shaft_force_ = 0;
};

// Contacts of grains with grains and facets that touch, in the last cycle.
std::uint64_t touching_contacts(const Model& model);

// Mean unbalanced force of the bodies over the mean contact force, of the last cycle; 0 without bodies, 1 without
// contacts.
double unbalanced_ratio(const Model& model);

}  // namespace lockstep::dem
