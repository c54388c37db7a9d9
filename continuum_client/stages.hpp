// The continuum's side of a whole session: the paper's procedure (section 2.2.3) as stages, in order.
//
//   Hello -> InitialStress (paper step 1) -> Balance (the grains', 2) -> Excavate (3) -> Apply (4) -> Penetrate (5 to
//   7) -> Finish
//
// A scene without grains is a single process: InitialStress, then the ground alone for run.duration.
#pragma once
#include <filesystem>
#include <memory>
#include <string>

#include "common/scene.hpp"
#include "continuum_client/report.hpp"
#include "protocol/channel.hpp"

namespace lockstep::continuum {

struct RunOptions {
  std::string record_path;       // every frame is recorded there if not empty
  bool prints_progress = false;  // "@progress" lines
  int threads = 1;               // the results do not depend on it
};

// Runs a session over `channel`; null for a scene without grains. `results_folder` may be empty: then no file is
// written. Throws the errors of common/checks.hpp, after the peer has been told. A run that the user interrupts returns
// with is_interrupted set once it has stepped, and throws Interrupted before that.
RunReport run_continuum(const SceneFile& scene, const std::filesystem::path& results_folder,
                        std::unique_ptr<protocol::Channel> channel, const RunOptions& options);

}  // namespace lockstep::continuum
