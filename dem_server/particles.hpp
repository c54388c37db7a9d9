// The grains: rigid bodies (clumps of pebbles; a sphere is a clump of one), as aligned records.
//
// Time levels on entry to a cycle: position, orientation and pebble centres at t_n, velocity and spin at t_{n-1/2}.
// Body functions take a body's index, pebble functions a pebble's; the pebbles of body b are pebble_begin(b) ..
// pebble_end(b) - 1.
//
// What a contact gathers of a body stands in whole cache lines: 32 bytes of place, 64 of motion, 64 of loads. A crowd
// of spheres has nothing else: its bodies are its pebbles, it keeps neither attitudes nor shapes. The first clump that
// is added brings those arrays. Moments and the pebbles' places within a body follow from its size and shape: no body has
// its own.
//
//   SphereRecord  x y z R         32 B   per body (R_eq), and per pebble where there are clumps
//   MotionRecord  v R w m         64 B   per body
//   LoadRecord    F . M .         64 B   per body, about the origin
//   AttitudeRecord  q             32 B   per body where there are clumps
//   TwistRecord   v m w R         64 B   per body where there are clumps, of its point at the origin
//
// Behind the last body and the last pebble stands one more record each, far away and without size: list entries that
// only fill up a block of entries point there.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/hash.hpp"
#include "common/huge_pages.hpp"
#include "common/parallel.hpp"
#include "common/vectors.hpp"
#include "dem_server/records.hpp"
#include "dem_server/shapes.hpp"

namespace lockstep::dem {

class Particles {
 public:
  using View = Eigen::Map<Vec3>;

  Particles();

  std::size_t body_count() const { return bodies_.size() - 1; }
  std::size_t pebble_count() const { return has_clumps() ? pebbles_.size() - 1 : body_count(); }
  // False: every body is a sphere, and pebble p is body p.
  bool has_clumps() const { return !pebbles_.empty(); }

  // ---- of a body. The views are of the records: they end with the next add() or keep_only().
  Vec3 position(std::size_t b) const { return {bodies_[b].x, bodies_[b].y, bodies_[b].z}; }  // of mass centre, t_n [m]
  View position(std::size_t b) { return forget_twists(), View(&bodies_[b].x); }
  double equivalent_radius(std::size_t b) const { return bodies_[b].radius; }  // of the sphere of this volume [m]
  Vec3 velocity(std::size_t b) const { return {motion_[b].vx, motion_[b].vy, motion_[b].vz}; }  // t_{n-1/2} [m/s]
  View velocity(std::size_t b) { return forget_twists(), View(&motion_[b].vx); }
  Vec3 spin(std::size_t b) const { return {motion_[b].wx, motion_[b].wy, motion_[b].wz}; }  // world, t_{n-1/2} [rad/s]
  View spin(std::size_t b) { return forget_twists(), View(&motion_[b].wx); }
  double mass(std::size_t b) const { return motion_[b].mass; }  // [kg]
  // Sum of contact forces at t_n, gravity not included [N], their moment about the origin and their torque about the centre
  // of mass, world frame [N m].
  Vec3 force(std::size_t b) const { return {loads_[b].fx, loads_[b].fy, loads_[b].fz}; }
  Vec3 moment(std::size_t b) const { return {loads_[b].mx, loads_[b].my, loads_[b].mz}; }
  Vec3 torque(std::size_t b) const { return moment(b) - position(b).cross(force(b)); }
  void set_loads(std::size_t b, const Vec3& force, const Vec3& torque);
  // Body frame -> world, t_n. A sphere has none to lose: identity.
  Quat orientation(std::size_t b) const;
  // Principal moments, body frame [kg m2].
  Vec3 inertia(std::size_t b) const;
  const ClumpTemplate& shape(std::size_t b) const;

  // ---- of a pebble
  std::int32_t pebble_begin(std::size_t b) const {
    return has_clumps() ? pebble_begin_[b] : static_cast<std::int32_t>(b);
  }
  std::int32_t pebble_end(std::size_t b) const { return pebble_begin(b + 1); }
  std::int32_t pebble_body(std::size_t p) const {
    return has_clumps() ? pebble_body_[p] : static_cast<std::int32_t>(p);
  }
  Vec3 pebble_center(std::size_t p) const {
    return {pebbles()[p].x, pebbles()[p].y, pebbles()[p].z};
  }                                                                          // world, t_n [m]
  double pebble_radius(std::size_t p) const { return pebbles()[p].radius; }  // [m]
  Vec3 pebble_offset(std::size_t p) const;                                   // from the centre of mass, body frame [m]

  // Room for so many, `pebbles` of clumps: arrays that grow by themselves leave twice as much memory behind.
  void reserve(std::size_t bodies, std::size_t pebbles = 0);
  void reserve_copies(const Particles& from, std::size_t bodies);
  // What the first clump does as well: from now on bodies have attitudes, shapes and pebbles of their own.
  void become_clumps();
  // Adds a body at rest and returns its index.
  std::int32_t add(const ClumpTemplate& shape, double radius, double density, const Vec3& center, const Quat& attitude);
  void set_orientation(std::size_t b, const Quat& attitude);
  // Density by a factor: mass, and with it inertia.
  void scale_mass(std::size_t b, double factor);
  // Multiplies every length of a body by `factor`, or of all bodies; density is kept.
  void scale(std::size_t b, double factor);
  void scale_all(double factor);
  // Sum of what scale_all has added to the largest pebble's radius: lists must allow for it [m].
  double growth() const { return growth_; }
  // Counts the calls that put pebbles of clumps to places that no motion led to.
  std::uint64_t placements() const { return placements_; }
  // Pebble centres from the body's pose; needed after positions or orientations were set from outside.
  void place_pebbles(std::size_t b);
  void place_pebbles();
  // A copy of body b of another crowd, at rest or not as it is there, without loads.
  void append_copy(const Particles& from, std::size_t b, const Vec3& shift);
  // Keeps only the bodies for which keep[b] is true, in order.
  void keep_only(const std::vector<char>& keep);
  // Puts the bodies in the order old = order[new].
  void reorder(const std::vector<std::int32_t>& order);

  // Velocity of the material point of `body` at `point`.
  Vec3 velocity_at(std::size_t body, const Vec3& point) const {
    return velocity(body) + spin(body).cross(point - position(body));
  }
  void add_force(std::size_t body, const Vec3& at, const Vec3& f) {
    View(&loads_[body].fx) += f;
    View(&loads_[body].mx) += at.cross(f);
  }
  void clear_forces();

  // Of all bodies: equivalent radii [m], masses [kg]. Zero without bodies.
  double smallest_radius() const;
  double largest_radius() const;
  double mean_radius() const;
  double lightest() const;
  double total_mass() const;
  void hash(Hash& h) const;
  // Of all arrays [bytes].
  std::size_t memory() const;

  // ---- the records, for kernels
  const SphereRecord* bodies() const { return bodies_.data(); }
  SphereRecord* bodies() { return forget_twists(), bodies_.data(); }
  const SphereRecord* pebbles() const { return has_clumps() ? pebbles_.data() : bodies_.data(); }
  SphereRecord* pebbles() { return has_clumps() ? pebbles_.data() : bodies(); }
  const MotionRecord* motion() const { return motion_.data(); }
  MotionRecord* motion() { return forget_twists(), motion_.data(); }
  const LoadRecord* loads() const { return loads_.data(); }
  LoadRecord* loads() { return loads_.data(); }
  // Of clumps only.
  AttitudeRecord* attitudes() { return attitudes_.data(); }
  const ShapeTable& shapes() const { return shapes_; }
  const std::int32_t* shape_numbers() const { return shape_number_.data(); }
  // What contacts read of the clumps' motion, one a body and one behind. integrate() leaves those of the positions at t_n and
  // velocities at t_{n-1/2}; whoever asks for bodies or motion in order to change them takes them away, and the next contacts
  // have them made anew.
  bool has_twists() const { return has_twists_; }
  void want_twists(TwistMaker make, Team& team);
  TwistRecord* twists() { return twists_.data(); }
  const TwistRecord* twists() const { return twists_.data(); }
  void room_for_twists();
  void twists_are_made() { has_twists_ = true; }
  const std::int32_t* pebble_begins() const { return pebble_begin_.data(); }
  const std::int32_t* pebble_bodies() const { return pebble_body_.data(); }

 private:
  void forget_twists() { has_twists_ = false; }

  // One entry a body, and one behind the last.
  LargeArray<SphereRecord> bodies_;
  LargeArray<MotionRecord> motion_;
  LargeArray<LoadRecord> loads_;
  // Only where there are clumps.
  LargeArray<AttitudeRecord> attitudes_;    // one entry a body
  std::vector<std::int32_t> shape_number_;  // one entry a body
  std::vector<std::int32_t> pebble_begin_;  // one more than bodies, and one behind
  ShapeTable shapes_;
  // Only where there are clumps, one entry a pebble and one behind the last.
  LargeArray<SphereRecord> pebbles_;
  std::vector<std::int32_t> pebble_body_;
  LargeArray<TwistRecord> twists_;
  bool has_twists_ = false;
  double growth_ = 0;  // [m]
  std::uint64_t placements_ = 0;
};

}  // namespace lockstep::dem
