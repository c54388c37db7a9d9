// What the two sides say to each other, as plain structs: the physics sees these and never the generated protobuf
// classes (codec.cpp translates). SI units throughout. Nodes and facets are named by their position in InitialStress's
// lists: that order is fixed there for the whole session and no ids travel later.
//
// Signs. A facet's node order gives the continuum's outward normal, which points into the grains. Tractions and nodal
// forces on the wire are those that act ON the continuum: grains at rest on a floor with normal +z send negative z.
// Time levels. x(n) and F(n) at t_n, v(n-1/2) half a step before.
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "common/coupled_limit.hpp"
#include "common/energies.hpp"
#include "common/vectors.hpp"

namespace lockstep::protocol {

inline constexpr std::uint32_t version_major = 1;
inline constexpr std::uint32_t version_minor = 1;

enum class Role : std::uint8_t { Continuum, Grains };

// The stages of a session, named after the paper's seven steps (section 2.2.3). Velocities, Forces and Advance are one
// stage of the session, since the paper's steps 5 to 7 repeat each time step.
enum class Stage : std::uint8_t { Hello, InitialStress, Balance, Excavate, Apply, Penetrate, Finished, Aborted };

struct Hello {
  std::uint32_t major = version_major;
  std::uint32_t minor = version_minor;
  Role role = Role::Continuum;
  std::string solver;  // name of the program
  std::string solver_version;
  std::vector<std::string> capabilities;  // "checkpoint", "progress", ...
  std::string scene_digest;               // hex; empty for a solver that does not read our scene files
  std::uint64_t resume_step = 0;  // of the checkpoint that this side resumes from; the first Velocities bears it
};

struct StressProfilePoint {
  double z = 0;           // [m]
  double vertical = 0;    // [Pa], tension positive, as sigma_zz
  double horizontal = 0;  // [Pa]
};

// Step 1, continuum -> grains: the interface and the stress that the deleted ground will have carried.
struct InitialStress {
  Vec3s nodes;  // [m], reference positions x(0)
  std::vector<std::array<std::int32_t, 4>> facets;
  std::vector<std::int32_t> ring;           // per facet: facets of one ring share a servo; negative: bottom group
  Vec3s traction;                           // per facet, on the continuum [Pa]
  std::vector<Voigt> stress;                // per facet, xx yy zz xy yz zx, tension positive [Pa]
  std::vector<StressProfilePoint> profile;  // inside the discrete domain, by rising z
  Vec3 gravity = Vec3::Zero();              // [m/s2]
  double bulk_density = 0;                  // of the ground that the grains replace [kg/m3]
  double unbalanced_ratio = 0;              // reached by the continuum [-]
};

// Step 2, grains -> continuum: what the packing reached.
struct Balance {
  Vec3s traction;               // per facet, on the continuum [Pa]
  double porosity = 0;          // bulk [-]
  double unbalanced_ratio = 0;  // [-]
  std::uint64_t particles = 0;
  std::uint64_t contacts = 0;
};

// Step 3, continuum -> grains: the zones are gone.
struct ContinuumExcavated {
  std::uint64_t zones_deleted = 0;
  double residual_ratio = 0;        // worst |m a| / |f| after putting the baseline in place of the zones [-]
  double stable_step = 0;           // of the zones alone, damping included [s]
  std::uint64_t position_hash = 0;  // of the interface nodes
  GroundStiffness stiffness;        // with which the grains hold the coupled limit too
};

// Step 3, grains -> continuum: the facets are the boundary.
struct GrainsExcavated {
  Vec3s offset;                        // per node: contact geometry = continuum position + offset [m]
  double stable_step = 0;              // of the grains alone, damping included [s]
  std::vector<double> node_stiffness;  // per node: sum over contacts of k w [N/m]
  Vec3s nodal_force;                   // per node: F(0) with zero velocities, to compare with the baseline [N]
  std::uint64_t position_hash = 0;     // of the continuum's positions as the grains hold them
  std::string limited_by;              // which grain sets stable_step, for messages
};

// Step 5, continuum -> grains.
struct Velocities {
  std::uint64_t step = 0;           // n
  Stage stage = Stage::Apply;       // Apply or Penetrate
  double time_step = 0;             // from n to n+1 [s]
  Vec3s velocity;                   // per node, v(n-1/2) [m/s]
  double unbalanced_ratio = 0;      // of the zones, latest known [-]
  std::uint64_t position_hash = 0;  // of x(n), every few steps, else 0
  Energies energies;                // of the zones, one exchange late
};

// Step 6, grains -> continuum.
struct Forces {
  std::uint64_t step = 0;               // n, as in the Velocities that it answers
  Vec3s force;                          // per node, F(n) on the continuum [N]
  double stable_step = 0;               // the grains' own limit, damping included [s]
  std::vector<double> node_stiffness;   // per node [N/m]; empty unless one has grown by a tenth
  double unbalanced_ratio = 0;          // of the grains, latest known [-]
  bool is_done = false;                 // the pile has reached its depth, or the grains' part of the scene is over
  std::optional<Energies> energies;     // of the grains at t_(n-1), where they were summed up
  Vec3 particle_force = Vec3::Zero();   // sum of the interface's forces on the particles: minus the sum of force [N]
  double neglected_moment = 0;          // sum of |F_s| U/2, which eq. 13 drops [N m]
  Vec3 particle_moment = Vec3::Zero();  // of the interface's forces on the particles, about the origin [N m]
  std::string limited_by;               // which grain set stable_step, when that has fallen
};

// Heartbeat during long stages, so that slow is not taken for dead. Either side, any stage after Hello.
struct Progress {
  std::string text;
  double fraction = 0;  // of the stage, 0 to 1
};

struct CheckpointRequest {
  std::uint64_t step = 0;
  std::string name;
};
struct CheckpointCommit {
  std::uint64_t step = 0;
  std::uint64_t state_hash = 0;
};

// The continuum client ends the session when both sides are done; the grains answer with the same.
struct Finish {
  std::uint64_t step = 0;
  std::string text;
  bool is_interrupted = false;  // the sender's user ended the run early
};

// The last words of a side that gives up.
struct Abort {
  std::int32_t exit_code = 5;
  std::string reason;
};

// In the order of the frame's type byte.
using Message = std::variant<Hello, InitialStress, Balance, ContinuumExcavated, GrainsExcavated, Velocities, Forces,
                             Progress, CheckpointRequest, CheckpointCommit, Finish, Abort>;

}  // namespace lockstep::protocol
