// What the continuum client needs of a scene, in plain numbers. Defaults, units and ranges of all keys:
// common/scene.proto.
#pragma once
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "common/scene.hpp"
#include "common/vectors.hpp"
#include "continuum_client/elastic_law.hpp"
#include "continuum_client/equilibrium.hpp"
#include "continuum_client/zone_kinematics.hpp"

namespace lockstep::continuum {

// Counts are those after fidelity.mesh_refinement; growth is its root, so that sizes keep their distribution.
struct CylinderMesh {
  double width = 0, depth = 0;               // [m]
  double hole_diameter = 0, hole_depth = 0;  // [m]
  int zones_around = 0, zones_radial = 0, zones_hole_depth = 0, zones_below = 0;
  double radial_growth = 1, depth_growth = 1;  // [-]
  std::string where;                           // "scene.txt: continuum.cylinder_in_brick", for messages
};

struct BlockMesh {
  double width_x = 0, width_y = 0, height = 0, top_z = 0;  // [m]
  int zones_x = 0, zones_y = 0, zones_z = 0;
  std::string where;
};

// Zones from a file, as they are there.
struct FileMeshSettings {
  struct Region {
    std::string name;           // of a group of zones
    std::int32_t material = 0;  // of Settings::materials
  };
  struct Hole {
    double diameter = 0, depth = 0;  // [m]
  };
  std::filesystem::path path;
  double scale = 1;
  Vec3 shift = Vec3::Zero();                 // [m]
  double merge_distance = 0;                 // 0: nodes in one place are an error [m]
  std::string cell_array;                    // of VTK files
  std::vector<std::string> discrete_domain;  // groups of zones
  std::vector<std::string> interface;        // groups of faces; empty: the top
  std::vector<Region> regions;
  bool has_free_faces = false;  // beside the top
  std::optional<Hole> hole;
  std::string where;  // "scene.txt: continuum.mesh_file", for messages
};

enum class Supports { AllFixed, Rollers, BottomFixed, BottomRoller, Quiet, QuietSides };

// From z = top down to the next layer's top or the bottom.
struct Layer {
  double top = 0;             // [m]
  std::int32_t material = 0;  // of Settings::materials
  std::string where;          // for messages
};

// A traction on the faces of the surface whose centres lie in a box; smooth ramps.
struct SurfaceLoad {
  Vec3 low, high;       // [m]
  Vec3 traction;        // on the ground [Pa]
  double ramp = 0;      // [s]
  double duration = 0;  // of the full traction; 0: for ever [s]
  std::string where;    // for messages
};

// What is written beside displacement, velocity and stress; places in the mesh before it moved. `where` is for messages.
struct PointResult {
  std::string name;
  Vec3 at;  // [m]
  std::string where;
};
struct SectionResult {
  std::string name;
  Vec3 point, normal;  // [m], [-]
  std::string where;
};
struct LineResult {
  std::string name;
  Vec3 begin, end;  // [m]
  int points = 2;
  std::string where;
};
struct ResultSettings {
  bool strain = false, unbalanced_force = false, reactions = false;  // of the zones' files
  std::vector<PointResult> points;
  std::vector<SectionResult> sections;
  std::vector<LineResult> lines;

  bool needs_strain() const { return strain || !points.empty() || !sections.empty() || !lines.empty(); }
};

struct Settings {
  std::string title;
  std::variant<BlockMesh, CylinderMesh, FileMeshSettings> mesh;
  ZoneKind zone_kind = ZoneKind::MixedDiscretization;
  std::vector<Material> materials;  // the scene's own first, then those of its layers or regions
  bool is_incremental = false, has_large_strain = false;
  std::vector<Layer> layers;     // from the highest down
  std::optional<double> k0;      // prescribed initial stress [-]
  double mass_damping = 0;       // Rayleigh's a [1/s]
  double stiffness_damping = 0;  // and b [s]
  std::vector<SurfaceLoad> loads;
  double gravity = 0;  // downwards [m/s2]
  Supports initial_supports = Supports::Rollers;
  Supports supports = Supports::AllFixed;
  Vec3 is_free_direction = Vec3::Ones();  // 0: no node moves there
  std::optional<scene::Packet> packet;    // velocities at the start

  EquilibriumSettings equilibrium;

  bool holds_baseline = false;          // Apply: the offset stays for ever
  double ramp_transits = 0;             // [P-wave transits of the depth]
  double apply_damping = 0;             // [-]
  double apply_tolerance = 0;           // [-]
  std::uint32_t apply_max_steps = 0;    // 0: no Apply stage
  double run_damping = 0;               // [-]
  double duration = 0;                  // of scenes without a pile [s]
  double run_tolerance = 0;             // of the ground alone, unbalanced ratio [-]
  bool scales_density = false;          // of the ground alone
  double step_fraction = 0;             // [-]
  bool is_step_strict = false;          // a limit that falls below the step ends the run
  std::uint32_t exchange_interval = 1;  // steps of the grains to one of the ground
  bool keeps_ledger = true;             // of both sides together
  double stop_if_energy_error = 0;      // of the work done; 0: never [-]

  bool has_grains = false;
  bool has_pile = false;
  double pile_velocity = 0, pile_diameter = 0, pile_speed_ramp = 0;  // [m/s], [m], [s]

  double peer_timeout = 0;  // [s]
  std::uint32_t hash_interval = 1;
  std::uint32_t history_interval = 1;
  double snapshot_interval = 0;  // [S/D] with a pile, [s] else; 0: first and last only
  bool writes_zones = true;
  ResultSettings results;

  bool may_yield() const;  // any of the materials
  // The larger of the dampings that the coupled stages use: the step is held for it.
  double largest_damping() const;
};

// Throws InputError with file, key and remedy where keys contradict each other.
Settings read_settings(const SceneFile& scene);

}  // namespace lockstep::continuum
