// What dem_server needs to know of a scene, as plain structs. Meaning, unit, default and range of each value stand
// beside its key in common/scene.proto; settings.cpp fills these from there. What several keys decide together is
// settled here: pebbles and radii after `fidelity`, the container from hole or box, the larger of the dampings for the
// time step.
#pragma once
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/scene.hpp"
#include "common/vectors.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/regions.hpp"
#include "dem_server/walls.hpp"

namespace lockstep::dem {

// Where the packing stands: a vertical cylinder around x = y = 0, or a box. Open at the top unless it has a lid; the
// bottom is the interface, or in a scene of grains alone a plane. It is what the packing is made in: walls with servos
// move on.
struct Container {
  enum class Kind { Cylinder, Box } kind = Kind::Cylinder;
  double radius = 0;             // cylinder [m]
  double half_x = 0;             // box [m]
  double half_y = 0;             // box [m]
  double bottom = 0;             // [m]
  double top = 0;                // fill level [m]
  bool has_lid = false;          // a plane at the fill level
  double cross_section() const;  // [m2]
  double surface() const;        // sides, bottom and top [m2]
  double volume() const;         // [m3]
  // Distance of a point inside to the nearest side, bottom or lid; negative outside. A top without lid does not count. [m]
  double depth_inside(const Vec3& point) const;
};

struct PackingSettings {
  std::uint32_t count = 0;  // 0: radius decides
  double radius = 0;        // mean equivalent radius [m]
  double radius_ratio = 1;  // largest over smallest
  double porosity = 0;      // bulk
  bool match_continuum_density = true;
  std::uint32_t cube_grains = 0;
  double cube_pressure = 0;  // [Pa]
  Container container;
};

struct LatticeSettings {
  std::uint32_t count_x = 1, count_y = 1, count_z = 1;
  double radius = 0;   // [m]
  double overlap = 0;  // [m]
  double bottom = 0;   // [m]
  bool fix_top = false;
  double pulse_velocity = 0;  // [m/s]
  double pulse_length = 0;    // [m]
  double pulse_center = 0;    // [m]
  double side_overlap = 0;    // [m]
  bool holds_spins = false;
};

struct GrainSettings {
  Vec3 center, velocity, spin;  // [m], [m/s], [rad/s]
  double radius = 0;            // equivalent [m]
  bool is_clump = false;
};

struct PileSettings {
  PileShape shape;
  double embedment = 0;    // L [m]
  double friction = 0;     // from Apply on
  double penetration = 0;  // S at the end [m]
  double velocity = 0;     // [m/s]
  double speed_ramp = 0;   // [s]
};

struct BalanceSettings {
  bool servo = true;
  double damping = 0;
  double tolerance = 0;
  double servo_tolerance = 0;     // [m/s]
  double traction_tolerance = 0;  // relative
  double max_servo_travel = 0;    // [mean R]
  std::uint32_t max_cycles = 0;
  double friction = 0;  // between grains [-]
};

struct BallSettings {
  Ball ball;
  bool follows_pile = false;
};

struct GridSettings {
  double cell = 0;           // [mean equivalent diameters]
  std::optional<Box> box;    // none: the packing
  std::uint32_t points = 0;  // a mean equivalent diameter
  std::string where;         // file and key, for messages
};

struct TrackedSettings {
  std::optional<std::uint32_t> grain;  // none: the nearest to
  Vec3 near = Vec3::Zero();            // [m]
  std::string where;                   // file and key, for messages
};

// From Apply on; nothing unless the scene asks.
struct MeasureSettings {
  std::uint32_t interval = 0;  // steps
  std::vector<BallSettings> balls;
  std::vector<GridSettings> grids;
  std::vector<TrackedSettings> tracked;
  bool fabric = false;
  bool force_network = false;
  bool energy_by_kind = false;  // in Output's history
  // Whether Observers have anything to do.
  bool is_any() const { return !balls.empty() || !grids.empty() || !tracked.empty() || fabric || force_network; }
};

// Keys of a scene and their values, in words.
using SceneKeys = std::vector<std::pair<std::string, std::string>>;

struct Settings {
  std::string title;
  bool is_alone = false;  // no continuum: a single process
  double gravity = 0;     // downwards [m/s2]
  std::uint64_t seed = 1;

  GrainMaterial material;
  double density = 0;  // of the solid [kg/m3]
  double interface_friction = 0;
  double wall_friction = 0;
  double facet_stiffness_factor = 1;
  int pebbles = 1;
  double elongation = 1;

  std::optional<PackingSettings> packing;
  std::optional<LatticeSettings> lattice;
  std::optional<scene::Packet> packet;  // velocities at the start
  std::vector<GrainSettings> grains;
  std::optional<PileSettings> pile;
  std::vector<PlaneSettings> planes;            // of `plane` blocks, and the sides of a box
  std::vector<WallSettings> walls;              // of `wall` blocks, each with a name; meshes are read already
  std::vector<WallSettings> all_walls() const;  // walls, then planes

  BalanceSettings balance;
  double apply_damping = 0;
  bool has_apply = true;
  double run_damping = 0;
  double run_duration = 0;  // of grains alone without a pile [s]
  double step_damping = 0;  // the largest that the coupled run will see: the time step is held for it

  double step_fraction = 0.9;           // of the stable step
  std::uint32_t exchange_interval = 1;  // steps to one of the ground
  bool transfers_moment = false;        // to the interface's nodes
  bool keeps_ledger = true;
  double stop_if_energy_error = 0;      // of the work done; 0: never
  double peer_timeout = 60;             // [s]
  std::uint32_t history_interval = 20;  // steps
  double snapshot_interval = 0;         // S/D, or seconds without a pile
  bool write_particles = true;
  bool write_contacts = true;
  MeasureSettings measure;

  SceneKeys packing_keys;  // what stage Balance depends on, beside the ground
};

// Throws InputError for what the ranges of single keys cannot catch.
Settings make_settings(const SceneFile& scene);

}  // namespace lockstep::dem
