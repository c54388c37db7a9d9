// The grains' side of a session, stage by stage, and grains alone (design of the seven steps: protocol/README.md).
#pragma once
#include <filesystem>
#include <memory>
#include <string>

#include "common/scene.hpp"
#include "dem_server/report.hpp"
#include "dem_server/settings.hpp"
#include "protocol/channel.hpp"

namespace lockstep::dem {

struct RunOptions {
  std::filesystem::path results;  // folder; empty: nothing is written
  std::string record_path;        // recording of every frame; empty: none
  bool prints_progress = false;   // "@progress" lines
  std::filesystem::path packing;  // balanced packing: taken from this file, or written to it; empty: made and not kept
  int threads = 1;                // from Apply on
  bool watches_shivering = true;  // false: for who judges by himself whether a packing rests (reversal.hpp)
  int balance_threads = 1;        // while the peer waits: stage Balance; no bit depends on either
};

// InputError when the scene has a continuum and no peer, or a peer and no continuum.
void check_company(const Settings& settings, bool has_peer, const SceneFile& scene);

// Runs the session over `channel` to its end; without a channel a scene that has grains alone: Balance, then Penetrate.
// InputError as check_company()'s. Throws the kinds of common/checks.hpp; the peer has been told why by
// then.
RunReport run_grains(const SceneFile& scene, std::unique_ptr<protocol::Channel> channel, const RunOptions& options);

}  // namespace lockstep::dem
