// Rigid walls of any shape (wall_shapes.hpp, triangle_mesh.hpp), and the pile (paper, section 2.3: a rigid wall pushed
// down at constant velocity). A is the grain, B the wall.
//
//   k_n = E* 2 R_eq   the wall counts as a grain of the same size    V = v_wall - v_grain at the contact point (eq. 4)
//   x_C = x_B + (R - U/2) n                                          (eq. 1, n towards the wall)
//
// MOTION. A wall is a rigid body with a centre c: a point x of it moves with v + w x (x - c), and c moves with v. A
// spin that turns a shape in itself (a drum about its axis, a table about its normal) leaves its geometry untouched, bit
// for bit. A servo adds a speed s of the surface towards the grains: a plane moves along its normal, a cylinder changes
// its radius, a cone or a mesh moves along the servo's direction d. With the direction d(x) in which the surface moves,
//
//   pressure  p = sum F_grain . d / A          speed  s = c A (p_target - p) / (K dt),   |s| <= top speed,
//
// K the stiffness of the wall's contacts, at least that of one, so that a step closes at most the share c of the error
// (as the rings' servo does).
//
// SIGNS. Forces in totals act ON THE WALL: grains below the pile's tip push it up, tip_force.z() > 0; a shaft that moves
// down drags grains down and is pushed up itself. Reversing V for the shaft gives a smooth and plausible tip curve, so
// the tests hold the sign of the shaft's force and the balance of all forces.
//
// WORK of a wall on the grains over the step that led to t_n, as leap-frog has it: 1/2 (F(n-1) + F(n)) . v(n-1/2) dt,
// with moments and servo likewise. For planes it is exact, so the ledger closes however a servo's speed jumps.
//
// THREADS. A thread presses the pebbles of its own bodies, walls in order and pebbles in order (wall_contacts.hpp), and adds
// the forces to these alone; totals are then added up by one, in order of walls and pebbles. The bits are those of one thread.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "common/hash.hpp"
#include "common/parallel.hpp"
#include "common/vectors.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/travel.hpp"
#include "dem_server/triangle_mesh.hpp"
#include "dem_server/wall_candidates.hpp"
#include "dem_server/wall_contacts.hpp"
#include "dem_server/wall_shapes.hpp"

namespace lockstep::dem {

// -------------------------------------------------------------------------------------------------------- walls

struct WallServoSettings {
  double pressure = 0;            // to hold [Pa]
  double area = 0;                // that it counts for; 0: the shape's own, see Walls::area [m2]
  double top_speed = 0.05;        // [m/s]; too fast a wall hits its grains, too slow a one takes long
  double closing = 0.2;           // c, share of the error that one step closes; above 1 it chatters
  Vec3 direction = Vec3::Zero();  // of cones and meshes, towards the grains
  bool balance_only = false;      // rests once Walls::end_balance() is called
};

struct MeshShape {
  std::shared_ptr<const TriangleMesh> mesh;
  Vec3 shift = Vec3::Zero();  // of its corners [m]
};

using WallShape = std::variant<PlaneShape, CylinderShape, FrustumShape, MeshShape>;

struct WallSettings {
  std::string name;  // in messages and results; empty: "wall K"
  WallShape shape;
  Vec3 velocity = Vec3::Zero();    // t_{n-1/2} [m/s]
  Vec3 spin = Vec3::Zero();        // t_{n-1/2}, world [rad/s]
  double speed_ramp = 0;           // from rest to the velocity [s]
  std::optional<Vec3> center;      // of the spin, t_n; else the shape's own point, a mesh's origin [m]
  std::optional<double> friction;  // else the one that Walls is given
  std::optional<WallServoSettings> servo;
};

// InputError, in words that begin with `where`, for a servo of walls[index] without what its shape needs. The direction is made
// unit.
void check_servo(std::vector<WallSettings>& walls, std::size_t index, const std::string& where);

// A plane that may slide and move, and no more.
struct PlaneSettings {
  Vec3 point = Vec3::Zero();     // any point of the plane, t_n [m]
  Vec3 normal = Vec3::UnitZ();   // unit, to the side of the grains
  Vec3 velocity = Vec3::Zero();  // t_{n-1/2} [m/s]
};

WallSettings plane_wall(const PlaneSettings& plane);

// Where a wall is and how it moves.
struct WallState {
  Vec3 center = Vec3::Zero();        // t_n [m]
  Quat attitude = Quat::Identity();  // start -> t_n
  Vec3 velocity = Vec3::Zero();      // t_{n-1/2} [m/s]
  Vec3 spin = Vec3::Zero();          // t_{n-1/2} [rad/s]
  double servo_speed = 0;            // of the surface towards the grains, t_{n-1/2} [m/s]
  double servo_way = 0;              // that the servo has moved it, towards the grains [m]
  Vec3 last_force = Vec3::Zero();    // on the grains at the last step, for its work [N]
  Vec3 last_torque = Vec3::Zero();   // [N m]
  double last_pressing = 0;          // [N]
};

class Walls {
 public:
  Walls() = default;
  // InputError for a shape without a surface, or a servo without what it needs. `friction` is that of walls without
  // their own.
  explicit Walls(std::vector<WallSettings> walls, double friction = 0);
  // Planes alone.
  explicit Walls(const std::vector<PlaneSettings>& planes, double friction = 0);

  std::size_t size() const { return walls_.size(); }
  const std::string& name(std::size_t wall) const { return walls_[wall].name; }
  void set_friction(double friction);  // of all [-]
  // Of all, as a share of their own: 0 while a packing is made.
  void set_friction_share(double share) { friction_share_ = share; }
  double friction(std::size_t wall) const { return friction_share_ * walls_[wall].friction; }  // [-]
  double friction() const { return friction_share_ * common_friction_; }  // of walls without their own [-]
  void set_velocity(std::size_t wall, const Vec3& velocity);              // without a ramp [m/s]
  void set_spin(std::size_t wall, const Vec3& spin);                      // [rad/s]
  // False: walls stand still and servos rest, whatever their velocities. Contacts then see no velocity.
  void set_moving(bool velocities, bool servos);
  // Servos that are for stage Balance alone rest from now on.
  void end_balance();
  const WallState& state(std::size_t wall) const { return walls_[wall].state; }
  const Vec3& center(std::size_t wall) const { return walls_[wall].state.center; }  // t_n [m]
  // Those that are planes, as they stand and move at t_n.
  std::vector<PlaneSettings> planes() const;

  // Contacts at t_n: adds force and torque to the bodies. `dt` is the step over which springs have grown [s]. The
  // walls' friction replaces the material's.
  WallTotals compute(Particles& particles, const GrainMaterial& material, double dt, const TravelLimits& limits = {},
                     Team& team = Team::alone(), const Partition& partition = {},
                     const WallKernels& kernels = wall_kernels(best_instructions()));
  // Servos choose their speeds from the last compute(), then x += v dt.
  void advance(double dt);

  // Whether x lies behind a wall, where grains cannot be: planes, endless cylinders and solid bodies. Thin shells (tubes and
  // funnels with the grains inside, meshes) have grains on both sides.
  bool is_behind(const Vec3& x) const;
  // Per wall, of the last compute().
  const std::vector<WallTotals>& totals() const { return totals_; }
  bool has_servo(std::size_t wall) const { return walls_[wall].servo.has_value(); }
  // That the servo counts for [m2]. Where none is given: of a tube its side, of which planes across the axis cut off what
  // lies behind them; of a plane the cross-section of the cylinder that it lies across.
  double area(std::size_t wall) const;
  std::optional<double> radius(std::size_t wall) const;  // of cylinders, t_n [m]
  double pressure(std::size_t wall) const;               // on its servo's area, of the last compute() [Pa]
  // Largest |p - target| / target over all servos that work; 0 without.
  double worst_servo_error() const;
  std::vector<WallContact> contacts() const { return contacts_.all(); }  // by wall, then pebble
  template <class Visitor>
  void for_each_contact(Visitor&& visit) const {
    contacts_.for_each_contact([&](const WallContact& contact) { visit(contact.view()); });
  }
  // Pebbles that the last compute() looked at, over all walls, and how often lists were made.
  std::size_t candidates() const;
  std::uint64_t renewals() const;

  void hash(Hash& h) const;
  // Forgets the springs and the lists; needed after pebbles were renumbered.
  void clear_history();
  // Springs of an earlier run, as contacts() gave them, and walls where they stood: the next compute() carries on from
  // there.
  std::vector<WallState> states() const;
  void restore(const std::vector<WallState>& states, const std::vector<WallContact>& contacts);

 private:
  struct Wall {
    std::string name;
    WallShape start;  // in coordinates about the centre
    WallShape shape;  // the same with the servo's way
    bool turns_in_itself = false;
    double friction = 0;  // [-]
    std::optional<WallServoSettings> servo;
    bool servo_rests = false;
    Vec3 full_velocity = Vec3::Zero();  // at the ramp's end [m/s]
    double speed_ramp = 0;              // [s]
    double time_on_ramp = 0;            // [s]
    WallState state;
    WallCandidates candidates;
    double lever = 0;  // farthest that a pebble can be from the centre [m]
  };
  // Of a thread.
  struct MeshScratch {
    TriangleMesh::Scratch scratch;
    std::vector<MeshContact> found;
  };

  Vec3 velocity_of(const Wall& wall) const { return velocities_count_ ? wall.state.velocity : Vec3(Vec3::Zero()); }
  Vec3 spin_of(const Wall& wall) const { return velocities_count_ ? wall.state.spin : Vec3(Vec3::Zero()); }
  bool is_moving(const Wall& wall) const;
  double length_between_planes(const Wall& wall, const FrustumShape& tube) const;
  void renew_candidates(const Particles& particles, const TravelLimits& limits, Team& team, const Partition& partition);
  template <class Shape>
  void find_touches(const Wall& wall, std::int32_t index, const Shape& shape, const PebbleRange& range,
                    const WallKernels& kernels, Particles& particles, MeshScratch& mesh,
                    WallContacts::Part& part) const;
  template <class Shape>
  void add_servo_speed(const Wall& wall, const Shape& shape, const Particles& particles,
                       WallContacts::Part& part) const;
  void add_up(std::size_t wall, double dt, const WallKernels& kernels);
  void apply_servo_way(Wall& wall);

  std::vector<Wall> walls_;
  double common_friction_ = 0;
  double friction_share_ = 1;
  bool velocities_count_ = true;
  bool servos_count_ = true;
  double largest_radius_ = 0;         // of the grains, when lists were last made [m]
  double one_contact_stiffness_ = 0;  // of the largest grain [N/m]
  WallContacts contacts_;
  std::vector<WallTotals> totals_;
  std::vector<MeshScratch> mesh_scratch_;
};

// --------------------------------------------------------------------------------------------------------- pile
//
//                 |     |                The pile is a body of revolution about x = y = 0. In the half plane (r, z)
//           shaft |     | shaft          its surface is one straight piece from the axis to the rim (a flat face, or
//                 |     |                a cone) and one from the rim upwards without end. A centre outside has its
//   face -->      +-----+  <-- rim       closest point on either or on their common end, the rim; a centre inside,
//                  \   /                 which only a deep overlap gives, is pushed out through the nearer piece.
//             cone  \ /                  Face, cone and rim are the tip.

enum class PileTip { Flat, Cone };

struct PileShape {
  double radius = 0.125;  // D/2 [m]
  PileTip tip = PileTip::Flat;
  double cone_angle = pi / 3;  // apex angle of a cone [rad]
};

// Face is the flat face or the cone; it and the rim make up the tip.
enum class PilePart : std::int32_t { Face, Rim, Shaft };

// Where a point stands to the pile.
struct PilePoint {
  PilePart part = PilePart::Face;
  double distance = 0;                  // from the surface; negative inside [m]
  Vec3 outward_normal = Vec3::UnitZ();  // unit, along the line to the closest point
};

struct PileTotals {
  WallTotals tip;  // face, or cone, and rim
  WallTotals shaft;
  Vec3 tip_force = Vec3::Zero();     // on the pile [N]; tip resistance is tip_force.z() / tip_area()
  Vec3 shaft_force = Vec3::Zero();   // on the pile [N]
  double tip_stiffness = 0;          // sum of k_n over the tip's contacts [N/m]
  double one_contact_stiffness = 0;  // k_n of the largest grain against the pile [N/m]
  WallTotals all() const;
};

class Pile {
 public:
  // `tip_z` is the lowest point, the apex of a cone [m]. InputError for a radius or angle out of range.
  Pile(const PileShape& shape, double tip_z, double friction = 0);

  void set_friction(double friction) { friction_ = friction; }  // [-]; zero while the packing is balanced
  double friction() const { return friction_; }
  void set_velocity(double velocity) { velocity_ = velocity; }  // along z, t_{n-1/2}; negative is down [m/s]
  double velocity() const { return velocity_; }
  double tip_z() const { return tip_z_; }                                 // t_n [m]
  double tip_area() const { return pi * shape_.radius * shape_.radius; }  // [m2]
  const PileShape& shape() const { return shape_; }
  // Lower end of the shaft. [m]
  double rim_z() const { return tip_z_ + cone_height_; }

  PilePoint closest(const Vec3& point) const;

  // As for Walls; the pile's friction replaces the material's.
  PileTotals compute(Particles& particles, const GrainMaterial& material, double dt, const TravelLimits& limits = {},
                     Team& team = Team::alone(), const Partition& partition = {},
                     const WallKernels& kernels = wall_kernels(best_instructions()));
  // tip_z += v dt.
  void advance(double dt);

  std::vector<WallContact> contacts() const { return contacts_.all(); }  // by pebble
  template <class Visitor>
  void for_each_contact(Visitor&& visit) const {
    contacts_.for_each_contact([&](const WallContact& contact) { visit(contact.view()); });
  }
  std::size_t candidates() const { return candidates_.size(); }  // pebbles that the last compute() looked at
  std::uint64_t renewals() const { return candidates_.renewals(); }

  void hash(Hash& h) const;
  void clear_history();
  void restore(double tip_z, double velocity, const std::vector<WallContact>& contacts);

 private:
  PileShape shape_;
  double cone_height_ = 0;  // 0 for a flat tip [m]
  double face_r_ = 1;       // unit vector along the face, from the axis to the rim, in (r, z)
  double face_z_ = 0;
  double face_length_ = 0;     // [m]
  double largest_radius_ = 0;  // of the grains, when the list was last made [m]
  double tip_z_ = 0;           // [m]
  double velocity_ = 0;        // [m/s]
  double friction_ = 0;        // [-]
  WallCandidates candidates_;
  WallContacts contacts_;
};

}  // namespace lockstep::dem
