// Rigid walls: planes, and the pile (paper, section 2.3: a rigid wall pushed down at constant velocity).
//
// One contact per grain's pebble and wall, since a plane and the pile are convex: A is the grain, B the wall.
//
//                 |     |                The pile is a body of revolution about x = y = 0. In the half plane (r, z)
//           shaft |     | shaft          its surface is one straight piece from the axis to the rim (a flat face, or
//                 |     |                a cone) and one from the rim upwards without end. A centre outside has its
//   face -->      +-----+  <-- rim       closest point on either or on their common end, the rim; a centre inside,
//                  \   /                 which only a deep overlap gives, is pushed out through the nearer piece.
//             cone  \ /                  Face, cone and rim are the tip.
//
//   k_n = E* 2 R_eq   the wall counts as a grain of the same size    V = v_wall - v_grain at the contact point (eq. 4)
//   x_C = x_B + (R - U/2) n                                          (eq. 1, n towards the wall)
//
// Signs. Forces in totals act ON THE WALL: grains below the tip push it up, tip_force.z() > 0; a shaft that moves down
// drags grains down and is pushed up itself. Reversing V for the shaft gives a smooth and plausible tip curve, so the
// tests hold the sign of the shaft's force and the balance of all forces.
//
// Which pebbles to look at. A pebble whose gap to the nearest wall was g cannot touch before it and the walls have
// moved towards each other by g, so it sleeps until then and costs one comparison a step. The result does not depend on
// who sleeps.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/hash.hpp"
#include "common/vectors.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/particles.hpp"

namespace lockstep::dem {

// Remembers, per pebble, how far it may move before anything has to be looked at.
class SleepingPebbles {
 public:
  // Forgets everything, as does a changed number of pebbles.
  void wake_all() { rest_.clear(); }
  void fit(std::size_t pebbles) {
    if (rest_.size() != pebbles) rest_.assign(pebbles, Rest{});
  }
  // `travel` is a length that grows at least as fast as any point of the walls moves [m].
  bool sleeps(std::size_t pebble, const Vec3& center, double radius, double travel) const {
    const Rest& rest = rest_[pebble];
    const double slack = rest.reach - radius - travel;
    return slack > 0 && (center - rest.center).squaredNorm() < slack * slack;
  }
  // `gap` is at most the distance from the pebble's surface to the nearest wall [m].
  void put_to_sleep(std::size_t pebble, const Vec3& center, double radius, double travel, double gap) {
    rest_[pebble] = {center, gap + radius + travel};
  }
  void keep_awake(std::size_t pebble) { rest_[pebble].reach = -1; }

 private:
  struct Rest {
    Vec3 center = Vec3::Zero();  // [m]
    double reach = -1;           // gap + radius + travel when it fell asleep; negative: awake [m]
  };
  std::vector<Rest> rest_;
};

// A contact of a pebble with a wall.
struct WallContact {
  std::int32_t pebble = -1;
  std::int32_t body = -1;
  std::int32_t part = 0;        // plane's index, or PilePart
  Vec3 point = Vec3::Zero();    // middle of the overlap [m]
  double overlap = 0;           // [m]
  double normal_stiffness = 0;  // [N/m]
  double shear_stiffness = 0;   // [N/m]
  Vec3 force = Vec3::Zero();    // on the grain [N]
  ContactHistory history;

  ContactView view() const {
    return {body, -1, point, history.normal, overlap, normal_stiffness, shear_stiffness, force};
  }
};

// What the contacts with a wall, or with a part of it, add up to in one step.
struct WallTotals {
  std::size_t contacts = 0;
  Vec3 force = Vec3::Zero();  // on the wall [N]
  double normal_force = 0;    // sum of |F_n| [N]
  double stiffness = 0;       // sum of k_n [N/m]
  double elastic_energy = 0;  // [J]
  double slip_work = 0;       // taken out by sliding in this step [J]
  double dashpot_work = 0;    // taken out by dashpots in this step [J]
  double power = 0;           // of the wall on the grains, sum of F_grain . v_wall [W]
  double max_overlap = 0;     // largest U / R of a pebble

  WallTotals& operator+=(const WallTotals& other);
};

// ------------------------------------------------------------------------------------------------------- planes

struct PlaneSettings {
  Vec3 point = Vec3::Zero();     // any point of the plane, t_n [m]
  Vec3 normal = Vec3::UnitZ();   // unit, to the side of the grains
  Vec3 velocity = Vec3::Zero();  // t_{n-1/2} [m/s]
};

class Planes {
 public:
  Planes() = default;
  // InputError when a normal has no direction. Normals are made unit.
  explicit Planes(std::vector<PlaneSettings> planes, double friction = 0);

  void set_friction(double friction) { friction_ = friction; }  // [-]
  double friction() const { return friction_; }
  void set_velocity(std::size_t plane, const Vec3& velocity) { planes_[plane].velocity = velocity; }  // [m/s]
  const std::vector<PlaneSettings>& planes() const { return planes_; }
  std::size_t size() const { return planes_.size(); }

  // Contacts at t_n: adds force and torque to the bodies. `dt` is the step over which springs have grown [s]. The
  // plane's friction replaces the material's.
  WallTotals compute(Particles& particles, const GrainMaterial& material, double dt);
  // x += v dt for each plane.
  void advance(double dt);

  // Per plane, of the last compute().
  const std::vector<WallTotals>& totals() const { return totals_; }
  const std::vector<WallContact>& contacts() const { return contacts_; }
  template <class Visitor>
  void for_each_contact(Visitor&& visit) const {
    for (const WallContact& contact : contacts_) visit(contact.view());
  }

  void hash(Hash& h) const;
  // Forgets the springs; needed after pebbles were renumbered.
  void clear_history();
  // Springs of an earlier run, as contacts() gave them, and planes where they stood: the next compute() carries on from
  // there.
  void restore(std::vector<PlaneSettings> planes, std::vector<WallContact> contacts);

 private:
  std::vector<PlaneSettings> planes_;
  double friction_ = 0;  // [-]
  double travel_ = 0;    // [m]
  SleepingPebbles sleeping_;
  std::vector<WallContact> contacts_;  // by pebble, then plane
  std::vector<WallContact> previous_;
  std::vector<WallTotals> totals_;
};

// --------------------------------------------------------------------------------------------------------- pile

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

  // As for Planes; the pile's friction replaces the material's.
  PileTotals compute(Particles& particles, const GrainMaterial& material, double dt);
  // tip_z += v dt.
  void advance(double dt);

  const std::vector<WallContact>& contacts() const { return contacts_; }  // by pebble
  template <class Visitor>
  void for_each_contact(Visitor&& visit) const {
    for (const WallContact& contact : contacts_) visit(contact.view());
  }

  void hash(Hash& h) const;
  void clear_history();
  void restore(double tip_z, double velocity, std::vector<WallContact> contacts);

 private:
  PileShape shape_;
  double cone_height_ = 0;  // 0 for a flat tip [m]
  double face_r_ = 1;       // unit vector along the face, from the axis to the rim, in (r, z)
  double face_z_ = 0;
  double face_length_ = 0;  // [m]
  double tip_z_ = 0;        // [m]
  double velocity_ = 0;     // [m/s]
  double friction_ = 0;     // [-]
  double travel_ = 0;       // [m]
  SleepingPebbles sleeping_;
  std::vector<WallContact> contacts_;
  std::vector<WallContact> previous_;
};

}  // namespace lockstep::dem
