// The grains' side of a session, stage by stage, and grains alone (design of the seven steps: protocol/README.md).
#pragma once
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/coupled_ledger.hpp"
#include "common/scene.hpp"
#include "common/vectors.hpp"
#include "dem_server/ledger.hpp"
#include "protocol/channel.hpp"

namespace lockstep::dem {

struct Settings;

struct RunOptions {
  std::filesystem::path results;  // folder; empty: nothing is written
  std::string record_path;        // recording of every frame; empty: none
  bool prints_progress = false;   // "@progress" lines
  std::filesystem::path packing;  // balanced packing: taken from this file, or written to it; empty: made and not kept
  int threads = 1;                // from Apply on
  bool watches_shivering = true;  // false: for who judges by himself whether a packing rests (reversal.hpp)
  int balance_threads = 1;        // while the peer waits: stage Balance; no bit depends on either
};

// Of a `wall` block at the end.
struct WallReport {
  Vec3 force = Vec3::Zero();  // on the wall [N]
  double pressure = 0;        // on its servo's area; 0 without a servo [Pa]
};

// What a run came to, for tests and for main's last words.
struct RunReport {
  std::uint64_t steps = 0;
  double time = 0;                  // since the start of Apply [s]
  std::uint64_t state_hash = 0;     // of the whole state of the grains at the end
  std::uint64_t position_hash = 0;  // of the interface nodes as the grains hold them
  std::size_t grains = 0;
  double ring_mismatch = 0;    // at the end of Balance, worst side ring or tip, over its tolerance [-]
  double bottom_mismatch = 0;  // at the end of Balance: bottom less weight and tip, over its tolerance [-]
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
  bool is_interrupted = false;  // by the user of either side
  std::string end;              // the continuum's words
};

// InputError when the scene has a continuum and no peer, or a peer and no continuum.
void check_company(const Settings& settings, bool has_peer, const SceneFile& scene);

// Runs the session over `channel` to its end; without a channel a scene that has grains alone: Balance, then Penetrate.
// InputError as check_company()'s. Throws the kinds of common/checks.hpp; the peer has been told why by
// then.
RunReport run_grains(const SceneFile& scene, std::unique_ptr<protocol::Channel> channel, const RunOptions& options);

}  // namespace lockstep::dem
