// Reading, checking and listing scenes. The schema, with unit, range and default of each key, is scene.proto.
#pragma once
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "common/scene.pb.h"

namespace lockstep {

struct SceneFile {
  std::filesystem::path path;
  scene::Scene scene;
  std::string digest;  // of the scene's content, whatever its comments and layout; both sides compare it

  // "scenarios/x/scene.txt:12: continuum.poisson_ratio": file, line if known, and key, for messages.
  std::string where(const std::string& key) const;
  // A file that the scene names: relative paths begin in the scene file's folder.
  std::filesystem::path resolve(const std::string& file) const;
  std::vector<std::pair<std::string, int>> key_lines;  // key path -> line, 1-based
};

// Reads a scene. `path` may be a file or a folder that holds scene.txt. `overrides` are "key=value" with dotted keys
// ("fidelity.pile_velocity=0.3"). Throws IoError when the file cannot be read, InputError with file, line, key, value,
// range and remedy when it is wrong.
SceneFile read_scene(const std::filesystem::path& path, const std::vector<std::string>& overrides = {});

// The same from text; `name` stands in messages.
SceneFile parse_scene(const std::string& text, const std::filesystem::path& name,
                      const std::vector<std::string>& overrides = {});

// All keys with unit, default, range and effect, one a line.
std::string list_keys();

// Version of this build, for manifests and handshakes.
std::string lockstep_version();

}  // namespace lockstep
