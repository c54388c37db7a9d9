#include "dem_server/walls.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/checks.hpp"

namespace lockstep::dem {

namespace {

// A spin along an axis through the centre turns a shape about that axis in itself: sine of the angle between them, and
// distance of the centre from the axis [m], that count as none.
constexpr double parallel = 1e-12;
constexpr double on_axis = 1e-9;

// A plane lies across an axis when the sine between its normal and the axis is below this.
constexpr double across = 1e-9;

WallLaw law_of(const GrainMaterial& material, double friction, double dt) {
  return {material.contact_modulus, material.stiffness_ratio, friction, material.damping_ratio, dt};
}

// Shapes as the kernels know them.
ShapeFrame frame_of(const WallState& state) {
  ShapeFrame frame{};
  const Mat3 turn = state.attitude.toRotationMatrix();
  for (int i = 0; i < 3; ++i) {
    frame.center[i] = state.center[i];
    for (int j = 0; j < 3; ++j) frame.turn[i][j] = turn(i, j);
  }
  return frame;
}

void copy(const Vec3& from, double* to) { std::copy_n(from.data(), 3, to); }

PlaneFace face_of(const PlaneShape& s) {
  PlaneFace face{};
  copy(s.point, face.point), copy(s.normal, face.normal);
  return face;
}

CylinderFace face_of(const CylinderShape& s) {
  CylinderFace face{};
  copy(s.point, face.point), copy(s.axis, face.axis), copy(s.axis.unitOrthogonal(), face.across);
  face.radius = s.radius;
  face.outside = s.side == Side::Outside ? 1 : -1;
  return face;
}

template <class Shape>
constexpr bool has_kernel = std::is_same_v<Shape, PlaneShape> || std::is_same_v<Shape, CylinderShape>;
auto touch_kernel(const WallKernels& kernels, const PlaneShape&) { return kernels.touch_plane; }
auto touch_kernel(const WallKernels& kernels, const CylinderShape&) { return kernels.touch_cylinder; }

WallMotion motion_of(const Vec3& center, const Vec3& velocity, const Vec3& spin) {
  WallMotion motion{};
  copy(center, motion.center), copy(velocity, motion.velocity), copy(spin, motion.spin);
  return motion;
}

}  // namespace

// ------------------------------------------------------------------------------------------- shapes, seen by a wall

namespace {

Vec3 own_point(const PlaneShape& s) { return s.point; }
Vec3 own_point(const CylinderShape& s) { return s.point; }
Vec3 own_point(const FrustumShape& s) { return s.point; }
Vec3 own_point(const MeshShape&) { return Vec3::Zero(); }

void shift_by(PlaneShape& s, const Vec3& way) { s.point += way; }
void shift_by(CylinderShape& s, const Vec3& way) { s.point += way; }
void shift_by(FrustumShape& s, const Vec3& way) { s.point += way; }
void shift_by(MeshShape& s, const Vec3& way) { s.shift += way; }

void check(MeshShape& shape, const std::string& where) {
  if (!shape.mesh) throw InputError(fmt::format("{}mesh has no surface; give its file", where));
}

// Whether a spin about the origin turns the shape in itself.
bool turns_in_itself(const Vec3& axis, const Vec3& point, const Vec3& spin) {
  return axis.cross(spin).norm() <= parallel * spin.norm() && axis.cross(point).norm() <= on_axis;
}
bool turns_in_itself(const PlaneShape& s, const Vec3& spin) {
  return s.normal.cross(spin).norm() <= parallel * spin.norm();
}
bool turns_in_itself(const CylinderShape& s, const Vec3& spin) { return turns_in_itself(s.axis, s.point, spin); }
bool turns_in_itself(const FrustumShape& s, const Vec3& spin) { return turns_in_itself(s.axis, s.point, spin); }
bool turns_in_itself(const MeshShape&, const Vec3& spin) { return spin.isZero(0); }

// How fast the surface comes nearer to anything when all of it moves at `velocity` (in the shape's frame) [m/s].
double closing_speed(const PlaneShape& s, const Vec3& velocity) { return std::abs(velocity.dot(s.normal)); }
double closing_speed(const CylinderShape& s, const Vec3& velocity) { return velocity.cross(s.axis).norm(); }
double closing_speed(const FrustumShape&, const Vec3& velocity) { return velocity.norm(); }
double closing_speed(const MeshShape&, const Vec3& velocity) { return velocity.norm(); }

// Whether the servo moves the radius.
bool has_servo_radius(const CylinderShape&) { return true; }
bool has_servo_radius(const FrustumShape& s) { return s.is_cylinder(); }
template <class Shape>
bool has_servo_radius(const Shape&) {
  return false;
}

// Direction, towards the grains, in which a servo moves the surface at x.
Vec3 servo_direction(const PlaneShape& s, const WallServoSettings&, const Vec3&) { return s.normal; }
Vec3 servo_direction(const CylinderShape& s, const WallServoSettings&, const Vec3& x) {
  const Vec3 radial = radial_direction(s.point, s.axis, x);
  return s.side == Side::Inside ? Vec3(-radial) : radial;
}
Vec3 servo_direction(const FrustumShape& s, const WallServoSettings& servo, const Vec3& x) {
  if (!s.is_cylinder()) return servo.direction;
  const Vec3 radial = radial_direction(s.point, s.axis, x);
  return s.side == Side::Inside ? Vec3(-radial) : radial;
}
Vec3 servo_direction(const MeshShape&, const WallServoSettings& servo, const Vec3&) { return servo.direction; }

void grow(CylinderShape& s, double way) { s.radius += s.side == Side::Inside ? -way : way; }
void grow(FrustumShape& s, double way) {
  const double change = s.side == Side::Inside ? -way : way;
  s.begin_radius += change, s.end_radius += change;
}

// Axis, of any length, and radius of a cylinder with the grains inside.
struct InnerCylinder {
  Vec3 axis;
  double radius;  // [m]
};
std::optional<InnerCylinder> inner_cylinder(const WallShape& shape) {
  if (const auto* s = std::get_if<CylinderShape>(&shape); s && s->side == Side::Inside)
    return InnerCylinder{s->axis, s->radius};
  if (const auto* s = std::get_if<FrustumShape>(&shape); s && s->side == Side::Inside && s->is_cylinder())
    return InnerCylinder{s->axis, s->begin_radius};
  return {};
}

bool lies_across(const Vec3& normal, const Vec3& axis) {
  return normal.cross(axis).norm() <= across * normal.norm() * axis.norm();
}

template <class... Visitors>
struct Overloaded : Visitors... {
  using Visitors::operator()...;
};
template <class... Visitors>
Overloaded(Visitors...) -> Overloaded<Visitors...>;

}  // namespace

void check_servo(std::vector<WallSettings>& walls, std::size_t index, const std::string& where) {
  const WallShape& shape = walls[index].shape;
  WallServoSettings& servo = *walls[index].servo;
  const auto* plane = std::get_if<PlaneShape>(&shape);
  const bool has_direction = plane || std::visit([](const auto& s) { return has_servo_radius(s); }, shape);
  if (!has_direction) {
    if (!(servo.direction.norm() > 0))
      throw InputError(
          fmt::format("{}servo.direction = 0 0 0 has no direction; a cone or mesh moves along it, towards the grains: "
                      "give it",
                      where));
    servo.direction.normalize();
  }
  const auto* frustum = std::get_if<FrustumShape>(&shape);
  const bool has_area = (frustum && frustum->is_cylinder()) ||
                        (plane && std::any_of(walls.begin(), walls.end(), [&](const WallSettings& other) {
                           const auto inner = inner_cylinder(other.shape);
                           return inner && lies_across(plane->normal, inner->axis);
                         }));
  if (!(servo.area > 0) && !has_area)
    throw InputError(
        fmt::format("{}servo.area = {} m2 must be positive: only a cylinder with a length, and a plane across a "
                    "cylinder, have an area of their own; give the area that the pressure acts on",
                    where, servo.area));
  if (!(servo.pressure >= 0))
    throw InputError(fmt::format("{}servo.pressure = {} Pa is out of range; walls press, so it must not be negative",
                                 where, servo.pressure));
}

WallSettings plane_wall(const PlaneSettings& plane) {
  WallSettings wall;
  wall.shape = PlaneShape{plane.point, plane.normal};
  wall.velocity = plane.velocity;
  return wall;
}

// -------------------------------------------------------------------------------------------------------- walls

Walls::Walls(const std::vector<PlaneSettings>& planes, double friction)
    : Walls(
          [&] {
            std::vector<WallSettings> walls;
            for (const PlaneSettings& plane : planes) walls.push_back(plane_wall(plane));
            return walls;
          }(),
          friction) {}

Walls::Walls(std::vector<WallSettings> walls, double friction) : common_friction_(friction) {
  for (std::size_t k = 0; k < walls.size(); ++k)
    if (walls[k].servo)
      check_servo(walls, k, (walls[k].name.empty() ? fmt::format("wall {}", k + 1) : walls[k].name) + ": ");
  for (WallSettings& from : walls) {
    Wall wall;
    wall.name = from.name.empty() ? fmt::format("wall {}", walls_.size() + 1) : from.name;
    const std::string where = wall.name + ": ";
    std::visit([&](auto& shape) { check(shape, where); }, from.shape);
    wall.servo = from.servo;
    wall.friction = from.friction.value_or(friction);
    wall.state.center =
        from.center ? *from.center : std::visit([](const auto& shape) { return own_point(shape); }, from.shape);
    wall.full_velocity = from.velocity;
    wall.speed_ramp = from.speed_ramp;
    if (!(from.speed_ramp > 0)) wall.state.velocity = from.velocity;
    wall.start = std::move(from.shape);
    std::visit([&](auto& shape) { shift_by(shape, -wall.state.center); }, wall.start);
    wall.shape = wall.start;
    walls_.push_back(std::move(wall));
    set_spin(walls_.size() - 1, from.spin);
  }
  totals_.resize(walls_.size());
}

void Walls::set_friction(double friction) {
  common_friction_ = friction;
  for (Wall& wall : walls_) wall.friction = friction;
}

std::vector<PlaneSettings> Walls::planes() const {
  std::vector<PlaneSettings> planes;
  for (const Wall& wall : walls_)
    if (const auto* plane = std::get_if<PlaneShape>(&wall.shape))
      planes.push_back({wall.state.center + wall.state.attitude * plane->point, wall.state.attitude * plane->normal,
                        wall.state.velocity});
  return planes;
}

void Walls::set_velocity(std::size_t wall, const Vec3& velocity) {
  walls_[wall].state.velocity = walls_[wall].full_velocity = velocity;
  walls_[wall].speed_ramp = 0;
}

void Walls::set_spin(std::size_t k, const Vec3& spin) {
  Wall& wall = walls_[k];
  wall.state.spin = spin;
  const Vec3 local = wall.state.attitude.conjugate() * spin;
  wall.turns_in_itself = std::visit([&](const auto& shape) { return turns_in_itself(shape, local); }, wall.shape);
  wall.candidates.forget();  // its lever may not be known
}

void Walls::set_moving(bool velocities, bool servos) {
  velocities_count_ = velocities;
  servos_count_ = servos;
  if (!servos)
    for (Wall& wall : walls_) wall.state.servo_speed = 0;
}

void Walls::end_balance() {
  for (Wall& wall : walls_)
    if (wall.servo && wall.servo->balance_only) {
      wall.servo_rests = true;
      wall.state.servo_speed = 0;
    }
}

bool Walls::is_behind(const Vec3& x) const {
  return std::any_of(walls_.begin(), walls_.end(), [&](const Wall& wall) {
    const Vec3 local = wall.state.attitude.conjugate() * (x - wall.state.center);
    return std::visit(Overloaded{[](const MeshShape&) { return false; },
                                 // A shell's distance is never negative.
                                 [&](const auto& shape) { return shape.closest(local).distance < 0; }},
                      wall.shape);
  });
}

bool Walls::is_moving(const Wall& wall) const {
  return (velocities_count_ && !wall.full_velocity.isZero(0)) || !spin_of(wall).isZero(0) ||
         (servos_count_ && wall.servo && !wall.servo_rests);
}

void Walls::renew_candidates(const Particles& particles, const TravelLimits& limits, Team& team,
                             const Partition& partition) {
  double allowance = 0;
  std::vector<SphereRecord> groups;
  for (Wall& wall : walls_) {
    if (wall.candidates.is_fresh(limits, particles.pebble_count())) continue;
    if (groups.empty()) groups = groups_of(particles, limits);
    if (allowance == 0) {  // not yet looked up
      allowance = wall_allowance * particles.mean_radius();
      largest_radius_ = particles.largest_radius();
    }
    const WallState& state = wall.state;
    const Mat3 to_local = state.attitude.toRotationMatrix().transpose();
    const double allowed = is_moving(wall) ? allowance : 0.0;
    std::visit(Overloaded{[&](const MeshShape& shape) {
                            wall.candidates.renew(
                                particles, limits, allowed, team, partition,
                                [&](std::size_t, const Vec3& x, double reach, std::vector<std::int32_t>& triangles) {
                                  const std::size_t before = triangles.size();
                                  shape.mesh->list_near(to_local * (x - state.center) - shape.shift, reach, triangles);
                                  return triangles.size() > before;
                                });
                          },
                          [&](const auto& shape) {
                            wall.candidates.renew(
                                particles, limits, allowed, team, partition,
                                [&](std::size_t, const Vec3& x, double reach, std::vector<std::int32_t>&) {
                                  return shape.closest(to_local * (x - state.center)).distance < reach;
                                },
                                groups);
                          }},
               wall.shape);
    if (spin_of(wall).isZero(0) || wall.turns_in_itself) continue;
    wall.lever = 0;
    for (std::size_t p = 0; p < particles.pebble_count() && limits.marks; ++p) {
      const SphereRecord& at = limits.marks[p];
      wall.lever = std::max(wall.lever, (Vec3(at.x, at.y, at.z) - state.center).norm() + limits.limit(p) + allowance);
    }
  }
}

// The pebbles of `range` that touch a wall.
template <class Shape>
void Walls::find_touches(const Wall& wall, std::int32_t index, const Shape& shape, const PebbleRange& range,
                         const WallKernels& kernels, Particles& particles, MeshScratch& mesh,
                         WallContacts::Part& part) const {
  const WallState& state = wall.state;
  const auto [first, last] = wall.candidates.within(range);
  if (first == last) return;
  if constexpr (has_kernel<Shape>) {
    const std::int32_t touching = touch_kernel(kernels, shape)(
        records_of(particles), frame_of(state), face_of(shape), wall.candidates.pebbles() + first,
        static_cast<std::int32_t>(last - first), part.room(last - first));
    part.set_touches(touching, index);
  } else {
    const Mat3 turn = state.attitude.toRotationMatrix(), to_local = turn.transpose();
    for (std::size_t i = first; i < last; ++i) {
      const std::int32_t p = wall.candidates.pebble(i);
      const double radius = particles.pebble_radius(p);
      const Vec3 local = to_local * (particles.pebble_center(p) - state.center);
      if constexpr (std::is_same_v<Shape, MeshShape>) {
        shape.mesh->touch(local - shape.shift, radius, wall.candidates.extra(i), wall.candidates.extra_count(i),
                          mesh.scratch, mesh.found);
        for (const MeshContact& found : mesh.found) part.add_touch(p, turn * found.normal, found.overlap, index);
      } else {
        const WallPoint at = shape.closest(local);
        if (at.distance < radius) part.add_touch(p, turn * at.normal, radius - at.distance, index);
      }
    }
  }
}

// The speed that a servo gives the surface at each touch.
template <class Shape>
void Walls::add_servo_speed(const Wall& wall, const Shape& shape, const Particles& particles,
                            WallContacts::Part& part) const {
  const WallState& state = wall.state;
  const Mat3 turn = state.attitude.toRotationMatrix(), to_local = turn.transpose();
  for (const WallTouch& touch : part) {
    const Vec3 normal(-touch.nx, -touch.ny, -touch.nz);
    const Vec3 point =
        particles.pebble_center(touch.pebble) + (particles.pebble_radius(touch.pebble) - 0.5 * touch.overlap) * normal;
    const Vec3 direction = servo_direction(shape, *wall.servo, to_local * (point - state.center));
    part.add_surface_velocity(state.servo_speed * (turn * direction));
  }
}

void Walls::add_up(std::size_t k, double dt, const WallKernels& kernels) {
  Wall& wall = walls_[k];
  WallState& state = wall.state;
  WallTotals& totals = totals_[k];
  totals = contacts_.totals(k, state.center, kernels);
  if (wall.servo) {
    const Mat3 turn = state.attitude.toRotationMatrix(), to_local = turn.transpose();
    std::visit(
        [&](const auto& shape) {
          contacts_.for_each(k, [&](const WallPress& c) {
            const Vec3 point(c.x, c.y, c.z), force(c.fx, c.fy, c.fz);
            totals.pressing += force.dot(turn * servo_direction(shape, *wall.servo, to_local * (point - state.center)));
          });
        },
        wall.shape);
  }
  totals.work = 0.5 * dt *
                ((state.last_force - totals.force).dot(velocity_of(wall)) +
                 (state.last_torque - totals.torque).dot(spin_of(wall)) +
                 (state.last_pressing + totals.pressing) * state.servo_speed);
  state.last_force = -totals.force;
  state.last_torque = -totals.torque;
  state.last_pressing = totals.pressing;
}

WallTotals Walls::compute(Particles& particles, const GrainMaterial& material, double dt, const TravelLimits& limits,
                          Team& team, const Partition& partition, const WallKernels& kernels) {
  WallTotals all;
  if (walls_.empty()) return all;
  particles.want_twists(kernels.make_twists, team);
  renew_candidates(particles, limits, team, partition);
  one_contact_stiffness_ = material.normal_stiffness(largest_radius_, largest_radius_);
  const int parts = partition.parts(team.size());
  contacts_.begin(walls_.size(), parts);
  mesh_scratch_.resize(static_cast<std::size_t>(parts));
  if (candidates() > 0)
    team.run_parts(parts, [&](int p) {
      const PebbleRange range = pebbles_of_part(particles, partition, team.size(), p);
      WallContacts::Part& part = contacts_.part(p);
      for (std::size_t k = 0; k < walls_.size(); ++k) {
        const Wall& wall = walls_[k];
        const WallMotion motion = motion_of(wall.state.center, velocity_of(wall), spin_of(wall));
        std::visit(
            [&](const auto& shape) {
              find_touches(wall, static_cast<std::int32_t>(k), shape, range, kernels, particles,
                           mesh_scratch_[static_cast<std::size_t>(p)], part);
              if (wall.state.servo_speed != 0) add_servo_speed(wall, shape, particles, part);
            },
            wall.shape);
        contacts_.press(part, k, range.begin, kernels, particles, law_of(material, friction(k), dt), motion);
        if (parts == 1) add_up(k, dt, kernels);  // as long as the caches have its contacts
      }
    });
  contacts_.end();
  for (std::size_t k = 0; k < walls_.size(); ++k) {
    if (parts > 1 || candidates() == 0) add_up(k, dt, kernels);
    all += totals_[k];
  }
  return all;
}

void Walls::apply_servo_way(Wall& wall) {
  const double way = wall.state.servo_way;
  wall.shape = wall.start;
  std::visit(Overloaded{[&](PlaneShape& s) { s.point += way * s.normal; }, [&](CylinderShape& s) { grow(s, way); },
                        [&](FrustumShape& s) {
                          if (s.is_cylinder())
                            grow(s, way);
                          else
                            s.point += way * wall.servo->direction;
                        },
                        [&](MeshShape& s) { s.shift += way * wall.servo->direction; }},
             wall.shape);
}

void Walls::advance(double dt) {
  for (std::size_t k = 0; k < walls_.size(); ++k) {
    Wall& wall = walls_[k];
    WallState& state = wall.state;
    if (wall.servo && servos_count_ && !wall.servo_rests && dt > 0) {
      const WallServoSettings& servo = *wall.servo;
      const double stiffness = std::max(totals_[k].stiffness, one_contact_stiffness_);
      const double missing = servo.pressure * area(k) - totals_[k].pressing;  // [N]
      state.servo_speed =
          stiffness > 0 ? std::clamp(servo.closing * missing / (stiffness * dt), -servo.top_speed, servo.top_speed) : 0;
      state.servo_way += state.servo_speed * dt;
      apply_servo_way(wall);
    }
    if (wall.speed_ramp > 0 && velocities_count_) {
      wall.time_on_ramp += dt;
      state.velocity = std::min(1.0, wall.time_on_ramp / wall.speed_ramp) * wall.full_velocity;
    }
    const Vec3 velocity = velocity_of(wall), spin = spin_of(wall);
    state.center += velocity * dt;
    double way = std::abs(state.servo_speed * dt);
    if (!wall.turns_in_itself && !spin.isZero(0)) {
      const double angle = spin.norm() * dt;
      state.attitude = (Quat(Eigen::AngleAxisd(angle, spin.normalized())) * state.attitude).normalized();
      way += std::abs(angle) * wall.lever + velocity.norm() * std::abs(dt);
    } else {
      const Vec3 local = state.attitude.conjugate() * velocity;
      way += std::visit([&](const auto& s) { return closing_speed(s, local); }, wall.shape) * std::abs(dt);
    }
    wall.candidates.wall_moved(way);
  }
}

// Of the part of a tube's axis that lies on the grains' side of all planes across it [m].
double Walls::length_between_planes(const Wall& wall, const FrustumShape& tube) const {
  const Vec3 axis = wall.state.attitude * tube.axis;
  const Vec3 begin = wall.state.center + wall.state.attitude * tube.point;
  double low = 0, high = tube.length;
  for (const Wall& other : walls_) {
    const auto* plane = std::get_if<PlaneShape>(&other.shape);
    if (!plane) continue;
    const Vec3 normal = other.state.attitude * plane->normal;
    if (!lies_across(normal, axis)) continue;
    const double at = (other.state.center + other.state.attitude * plane->point - begin).dot(axis);
    if (normal.dot(axis) > 0)
      low = std::max(low, at);
    else
      high = std::min(high, at);
  }
  return std::max(0.0, high - low);
}

std::optional<double> Walls::radius(std::size_t k) const {
  if (const auto* cylinder = std::get_if<CylinderShape>(&walls_[k].shape)) return cylinder->radius;
  const auto* tube = std::get_if<FrustumShape>(&walls_[k].shape);
  if (tube && tube->is_cylinder()) return tube->begin_radius;
  return {};
}

double Walls::area(std::size_t k) const {
  const Wall& wall = walls_[k];
  const double given = wall.servo ? wall.servo->area : 0.0;
  if (const auto* frustum = std::get_if<FrustumShape>(&wall.shape)) {
    if (!(given > 0)) return frustum->side_area() * length_between_planes(wall, *frustum) / frustum->length;
    return frustum->is_cylinder() ? given * frustum->begin_radius / std::get<FrustumShape>(wall.start).begin_radius
                                  : given;
  }
  if (const auto* cylinder = std::get_if<CylinderShape>(&wall.shape))
    return given * cylinder->radius / std::get<CylinderShape>(wall.start).radius;
  const auto* plane = std::get_if<PlaneShape>(&wall.shape);
  if (given > 0 || !plane) return given;
  for (const Wall& other : walls_)
    if (const auto inner = inner_cylinder(other.shape);
        inner && lies_across(wall.state.attitude * plane->normal, other.state.attitude * inner->axis))
      return pi * inner->radius * inner->radius;
  return 0;
}

double Walls::pressure(std::size_t k) const { return area(k) > 0 ? totals_[k].pressing / area(k) : 0.0; }

double Walls::worst_servo_error() const {
  double worst = 0;
  for (std::size_t k = 0; k < walls_.size(); ++k)
    if (walls_[k].servo && !walls_[k].servo_rests && walls_[k].servo->pressure > 0)
      worst = std::max(worst, std::abs(pressure(k) / walls_[k].servo->pressure - 1));
  return worst;
}

std::size_t Walls::candidates() const {
  std::size_t sum = 0;
  for (const Wall& wall : walls_) sum += wall.candidates.size();
  return sum;
}

std::uint64_t Walls::renewals() const {
  std::uint64_t sum = 0;
  for (const Wall& wall : walls_) sum += wall.candidates.renewals();
  return sum;
}

void Walls::hash(Hash& h) const {
  for (const Wall& wall : walls_) {
    const WallState& s = wall.state;
    h.add(s.center), h.add(s.velocity), h.add(s.spin);
    for (const double q : {s.attitude.x(), s.attitude.y(), s.attitude.z(), s.attitude.w()}) h.add(q);
    h.add(s.servo_speed), h.add(s.servo_way);
  }
  contacts_.hash(h);
}

void Walls::clear_history() {
  contacts_.clear();
  for (Wall& wall : walls_) wall.candidates.forget();
}

std::vector<WallState> Walls::states() const {
  std::vector<WallState> states;
  for (const Wall& wall : walls_) states.push_back(wall.state);
  return states;
}

void Walls::restore(const std::vector<WallState>& states, const std::vector<WallContact>& contacts) {
  if (states.size() != walls_.size())
    throw InputError(fmt::format("the state of {} walls does not fit a scene of {}; give that scene's", states.size(),
                                 walls_.size()));
  contacts_.restore(walls_.size(), contacts);
  for (std::size_t k = 0; k < walls_.size(); ++k) {
    Wall& wall = walls_[k];
    wall.state = states[k];
    apply_servo_way(wall);
    set_spin(k, wall.state.spin);
    totals_[k] = WallTotals{};
  }
}

// --------------------------------------------------------------------------------------------------------- pile

WallTotals PileTotals::all() const {
  WallTotals sum = tip;
  sum += shaft;
  return sum;
}

Pile::Pile(const PileShape& shape, double tip_z, double friction) : shape_(shape), tip_z_(tip_z), friction_(friction) {
  if (!(shape.radius > 0)) throw InputError(fmt::format("pile radius = {} m; it must be positive", shape.radius));
  if (shape.tip == PileTip::Cone) {
    if (!(shape.cone_angle > 0 && shape.cone_angle < pi))
      throw InputError(fmt::format("cone angle = {} rad; it must lie between 0 and pi", shape.cone_angle));
    cone_height_ = shape.radius / std::tan(0.5 * shape.cone_angle);
  }
  face_length_ = std::hypot(shape.radius, cone_height_);
  face_r_ = shape.radius / face_length_;
  face_z_ = cone_height_ / face_length_;
}

PilePoint Pile::closest(const Vec3& point) const {
  const double r = std::hypot(point.x(), point.y());
  // On the axis every direction is as good as any other.
  const Vec3 radial = r > 0 ? Vec3(point.x() / r, point.y() / r, 0) : Vec3(1, 0, 0);
  const double above_tip = point.z() - tip_z_;

  // Along the face from the axis to the rim, and off it: outward normal (face_z, -face_r) in (r, z).
  const double along = r * face_r_ + above_tip * face_z_;
  const double off_face = r * face_z_ - above_tip * face_r_;
  const double off_shaft = r - shape_.radius;
  const double above_rim = above_tip - cone_height_;
  const Vec3 face_normal = face_z_ * radial - face_r_ * Vec3::UnitZ();

  // Inside a convex body the nearer piece is where the distances off its line are the smaller; outside, the closest
  // point is on the piece whose span it lies over, else on the common end, or on a cone's apex.
  if (off_face <= 0 && off_shaft <= 0) {
    if (off_face >= off_shaft) return {PilePart::Face, off_face, face_normal};
    return {PilePart::Shaft, off_shaft, radial};
  }
  if (above_rim >= 0) return {PilePart::Shaft, off_shaft, radial};
  if (along >= face_length_) {
    const double distance = std::hypot(off_shaft, above_rim);
    return {PilePart::Rim, distance, (off_shaft / distance) * radial + (above_rim / distance) * Vec3::UnitZ()};
  }
  if (along <= 0 && cone_height_ > 0) {
    const double distance = std::hypot(r, above_tip);
    return {PilePart::Face, distance, (r / distance) * radial + (above_tip / distance) * Vec3::UnitZ()};
  }
  return {PilePart::Face, off_face, face_normal};
}

// The pile is one convex body: the spring goes with the pebble from face to rim to shaft. A pebble that is pushed out
// through another surface than before starts with a new one.
PileTotals Pile::compute(Particles& particles, const GrainMaterial& material, double dt, const TravelLimits& limits,
                         Team& team, const Partition& partition, const WallKernels& kernels) {
  particles.want_twists(kernels.make_twists, team);
  if (!candidates_.is_fresh(limits, particles.pebble_count())) {
    largest_radius_ = particles.largest_radius();
    const double allowance = velocity_ != 0 ? wall_allowance * particles.mean_radius() : 0.0;
    candidates_.renew(
        particles, limits, allowance, team, partition,
        [&](std::size_t, const Vec3& x, double reach, std::vector<std::int32_t>&) {
          const double beside = shape_.radius + reach;  // nearly all pebbles are farther off
          return x.z() > tip_z_ - reach && x.head<2>().squaredNorm() < beside * beside && closest(x).distance < reach;
        },
        groups_of(particles, limits));
  }
  const int parts = partition.parts(team.size());
  contacts_.begin(1, parts);
  if (candidates_.size() > 0)
    team.run_parts(parts, [&](int k) {
      WallContacts::Part& part = contacts_.part(k);
      const PebbleRange range = pebbles_of_part(particles, partition, team.size(), k);
      const auto [first, last] = candidates_.within(range);
      for (std::size_t i = first; i < last; ++i) {
        const std::int32_t p = candidates_.pebble(i);
        const PilePoint at = closest(particles.pebble_center(p));
        const double overlap = particles.pebble_radius(p) - at.distance;
        if (overlap > 0) part.add_touch(p, at.outward_normal, overlap, static_cast<std::int32_t>(at.part));
      }
      contacts_.press(part, 0, range.begin, kernels, particles, law_of(material, friction_, dt),
                      motion_of(Vec3::Zero(), {0, 0, velocity_}, Vec3::Zero()));
    });
  contacts_.end();

  WallSums tip, shaft;
  const Vec3 axis = Vec3::Zero();
  contacts_.for_each(0, [&](const WallPress& contact) {
    const bool is_shaft = contact.part == static_cast<std::int32_t>(PilePart::Shaft);
    kernels.add_up(&contact, 1, axis.data(), is_shaft ? shaft : tip);
  });
  PileTotals totals;
  totals.tip = totals_of(tip), totals.shaft = totals_of(shaft);
  totals.tip_force = totals.tip.force;
  totals.shaft_force = totals.shaft.force;
  totals.tip_stiffness = totals.tip.stiffness;
  totals.one_contact_stiffness = material.normal_stiffness(largest_radius_, largest_radius_);
  return totals;
}

void Pile::advance(double dt) {
  tip_z_ += velocity_ * dt;
  candidates_.wall_moved(std::abs(velocity_ * dt));
}

void Pile::hash(Hash& h) const {
  h.add(tip_z_);
  h.add(velocity_);
  contacts_.hash(h);
}

void Pile::clear_history() {
  contacts_.clear();
  candidates_.forget();
}

void Pile::restore(double tip_z, double velocity, const std::vector<WallContact>& contacts) {
  tip_z_ = tip_z;
  velocity_ = velocity;
  contacts_.restore(1, contacts);
  candidates_.forget();
}

}  // namespace lockstep::dem
