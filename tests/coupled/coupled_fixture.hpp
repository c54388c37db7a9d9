// Scenes of the tree, with both solvers in this process.
#pragma once
#include <spdlog/spdlog.h>

#include <filesystem>
#include <string>
#include <vector>

#include "common/scene.hpp"
#include "tools/in_process.hpp"

namespace lockstep::coupled {

inline std::filesystem::path scenario(const std::string& name) {
  return std::filesystem::path(SOURCE_DIR) / "scenarios" / name / "scene.txt";
}

inline Reports run_in_process(const SceneFile& scene) {
  spdlog::set_level(spdlog::level::warn);
  return run_both(scene);
}

inline Reports run_in_process(const std::string& name, const std::vector<std::string>& overrides = {}) {
  return run_in_process(read_scene(scenario(name), overrides));
}

}  // namespace lockstep::coupled
