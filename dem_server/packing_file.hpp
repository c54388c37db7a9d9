// A balanced packing in a file: what a run of stage Balance made, for other runs to begin with.
//
//   offset  bytes
//    0       8     "LKPACK" 13 10: a transfer as text changes it
//    8       8     version of the format
//   16       8     length of the content [bytes]
//   24       8     hash of the content (common/hash.hpp over its words of 8 bytes, the last filled up with zeros)
//   32             content, in words of 8 bytes, little-endian: sections in the order of BalancedPacking
//
// The file holds everything that decides the future: a run that takes it has the same bits from Apply on as the run
// that wrote it, whatever the number of threads. It also holds what it was made for, so that it is only taken by a scene
// that it fits: the keys of the scene that stage Balance depends on, in words, and the interface and the stress that the
// ground handed over. What only matters later (velocity and friction of the pile, friction of interface and walls,
// damping, time step, outputs) is not compared.
#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dem_server/balance.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/packing.hpp"

namespace lockstep::dem {

// The grains and all that has a memory of them, between two steps.
struct PackingState {
  Particles particles;
  std::vector<char> is_fixed;
  std::vector<PairContacts::Spring> springs;
  FacetState facets;
  std::vector<WallState> walls;
  std::vector<WallContact> wall_contacts;
  bool has_pile = false;
  double tip_z = 0;  // [m]
  std::vector<WallContact> pile_contacts;
};

struct BalancedPacking {
  SceneKeys keys;  // Settings::packing_keys of the scene that it was made for
  HandedOver ground;
  Assembly assembly;  // without particles and marks: those are in `state`
  BalanceFigures figures;
  PackingState state;
};

PackingState state_of(const Model& model);
// Puts the state into a model made for the scene; velocities of walls stay the scene's. Forces are up to date after the
// next evaluate_forces().
void restore(Model& model, const PackingState& state);

// Written under another name and renamed. IoError with the system's reason.
void write_packing(const std::filesystem::path& path, const BalancedPacking& packing);
// IoError when the file cannot be read, is cut off or damaged; InputError when it is no packing or of another version.
BalancedPacking read_packing(const std::filesystem::path& path);

// What the path promises, before anything is computed: the packing in it, checked against the scene's keys; none when
// there is no file yet, but one can be written there.
std::optional<BalancedPacking> open_packing(const std::filesystem::path& path, const SceneKeys& keys);

// InputError that names the first thing that differs, with both values and the remedy.
void check_fits(const SceneKeys& packing, const SceneKeys& scene, const std::filesystem::path& path);
void check_fits(const HandedOver& packing, const HandedOver& ground, const std::filesystem::path& path);

}  // namespace lockstep::dem
