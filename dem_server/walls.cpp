#include "dem_server/walls.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "common/checks.hpp"

namespace lockstep::dem {

namespace {

// A pebble whose gap is more than this times R goes to sleep.
constexpr double sleeping_gap = 0.2;

// A contact of the last step with the same pebble and the same key continues in this one.
struct Springs {
  const std::vector<WallContact>& previous;
  std::size_t next = 0;

  // Called with rising pebbles.
  template <class IsSame>
  ContactHistory of(std::int32_t pebble, IsSame&& is_same) {
    while (next < previous.size() && previous[next].pebble < pebble) ++next;
    for (std::size_t i = next; i < previous.size() && previous[i].pebble == pebble; ++i)
      if (is_same(previous[i])) return previous[i].history;
    return {};
  }
};

// Presses pebble against a rigid wall: `outward` is the wall's normal, towards the grain.
WallContact press(Particles& particles, std::int32_t pebble, std::int32_t part, const Vec3& outward, double overlap,
                  const Vec3& wall_velocity, const GrainMaterial& material, double friction, double dt,
                  const ContactHistory& history, WallTotals& totals) {
  WallContact contact;
  contact.pebble = pebble;
  contact.body = particles.pebble_body(pebble);
  contact.part = part;
  contact.overlap = overlap;
  contact.history = history;

  const double radius = particles.equivalent_radius(contact.body);
  ContactMaterial law;
  law.normal_stiffness = material.normal_stiffness(radius, radius);
  law.shear_stiffness = law.normal_stiffness / material.stiffness_ratio;
  law.friction = friction;
  law.normal_dashpot = 2 * material.damping_ratio * std::sqrt(law.normal_stiffness * particles.mass(contact.body));
  contact.normal_stiffness = law.normal_stiffness;
  contact.shear_stiffness = law.shear_stiffness;

  const Vec3 normal = -outward;  // from grain to wall
  contact.point =
      particles.pebble_center(pebble) + (particles.pebble_radius(pebble) - 0.5 * overlap) * normal;  // eq. 1
  const Vec3 approach = wall_velocity - particles.velocity_at(contact.body, contact.point);          // eq. 4
  const ContactResult result = contact_force(law, normal, overlap, approach, dt, contact.history);
  contact.force = result.force_on_a;
  particles.add_force(contact.body, contact.point, contact.force);

  ++totals.contacts;
  totals.force -= contact.force;
  totals.normal_force += result.normal_force;
  totals.stiffness += law.normal_stiffness;
  totals.elastic_energy += contact_energy(law, overlap, contact.history);
  totals.slip_work += result.slip_work;
  totals.dashpot_work += result.dashpot_power * dt;
  totals.power += contact.force.dot(wall_velocity);
  totals.max_overlap = std::max(totals.max_overlap, overlap / particles.pebble_radius(pebble));
  return contact;
}

void add_contacts(Hash& h, const std::vector<WallContact>& contacts) {
  for (const WallContact& contact : contacts) {
    h.add(static_cast<std::uint64_t>(contact.pebble));
    h.add(static_cast<std::uint64_t>(contact.part));
    h.add(contact.history.spring);
    h.add(contact.history.normal);
  }
}

}  // namespace

WallTotals& WallTotals::operator+=(const WallTotals& other) {
  contacts += other.contacts;
  force += other.force;
  normal_force += other.normal_force;
  stiffness += other.stiffness;
  elastic_energy += other.elastic_energy;
  slip_work += other.slip_work;
  dashpot_work += other.dashpot_work;
  power += other.power;
  max_overlap = std::max(max_overlap, other.max_overlap);
  return *this;
}

// ------------------------------------------------------------------------------------------------------- planes

Planes::Planes(std::vector<PlaneSettings> planes, double friction) : planes_(std::move(planes)), friction_(friction) {
  for (PlaneSettings& plane : planes_) {
    if (!(plane.normal.norm() > 0))
      throw InputError("plane.normal = 0 0 0 has no direction; give the side where the grains are");
    plane.normal.normalize();
  }
  totals_.resize(planes_.size());
}

WallTotals Planes::compute(Particles& particles, const GrainMaterial& material, double dt) {
  WallTotals all;
  if (planes_.empty()) return all;
  std::fill(totals_.begin(), totals_.end(), WallTotals{});
  std::swap(contacts_, previous_);
  contacts_.clear();
  Springs springs{previous_};
  sleeping_.fit(particles.pebble_count());

  for (std::size_t p = 0; p < particles.pebble_count(); ++p) {
    const Vec3& center = particles.pebble_center(p);
    const double radius = particles.pebble_radius(p);
    if (sleeping_.sleeps(p, center, radius, travel_)) continue;
    double gap = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < planes_.size(); ++k) {
      const PlaneSettings& plane = planes_[k];
      const double distance = (center - plane.point).dot(plane.normal);
      gap = std::min(gap, distance - radius);
      if (distance >= radius) continue;
      const auto id = static_cast<std::int32_t>(p);
      const auto part = static_cast<std::int32_t>(k);
      const ContactHistory history = springs.of(id, [&](const WallContact& c) { return c.part == part; });
      contacts_.push_back(press(particles, id, part, plane.normal, radius - distance, plane.velocity, material,
                                friction_, dt, history, totals_[k]));
    }
    if (gap > sleeping_gap * radius)
      sleeping_.put_to_sleep(p, center, radius, travel_, gap);
    else
      sleeping_.keep_awake(p);
  }
  for (const WallTotals& totals : totals_) all += totals;
  return all;
}

void Planes::advance(double dt) {
  double fastest = 0;
  for (PlaneSettings& plane : planes_) {
    plane.point += plane.velocity * dt;
    fastest = std::max(fastest, plane.velocity.norm());
  }
  travel_ += fastest * std::abs(dt);
}

void Planes::hash(Hash& h) const {
  for (const PlaneSettings& plane : planes_) h.add(plane.point), h.add(plane.normal), h.add(plane.velocity);
  add_contacts(h, contacts_);
}

void Planes::clear_history() {
  contacts_.clear();
  sleeping_.wake_all();
}

void Planes::restore(std::vector<PlaneSettings> planes, std::vector<WallContact> contacts) {
  planes_ = std::move(planes);
  totals_.assign(planes_.size(), WallTotals{});
  contacts_ = std::move(contacts);
  sleeping_.wake_all();
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

PileTotals Pile::compute(Particles& particles, const GrainMaterial& material, double dt) {
  PileTotals totals;
  std::swap(contacts_, previous_);
  contacts_.clear();
  Springs springs{previous_};
  sleeping_.fit(particles.pebble_count());
  const Vec3 velocity(0, 0, velocity_);

  for (std::size_t p = 0; p < particles.pebble_count(); ++p) {
    const Vec3& center = particles.pebble_center(p);
    const double radius = particles.pebble_radius(p);
    if (sleeping_.sleeps(p, center, radius, travel_)) continue;
    const PilePoint at = closest(center);
    const double gap = at.distance - radius;
    if (gap < 0) {
      // The pile is one convex body: the spring goes with the pebble from face to rim to shaft. A pebble that is pushed
      // out through another surface than before starts with a new one.
      const auto id = static_cast<std::int32_t>(p);
      const ContactHistory history =
          springs.of(id, [&](const WallContact& c) { return c.history.normal.dot(at.outward_normal) < 0; });
      const bool is_shaft = at.part == PilePart::Shaft;
      contacts_.push_back(press(particles, id, static_cast<std::int32_t>(at.part), at.outward_normal, -gap, velocity,
                                material, friction_, dt, history, is_shaft ? totals.shaft : totals.tip));
    }
    if (gap > sleeping_gap * radius)
      sleeping_.put_to_sleep(p, center, radius, travel_, gap);
    else
      sleeping_.keep_awake(p);
  }
  totals.tip_force = totals.tip.force;
  totals.shaft_force = totals.shaft.force;
  totals.tip_stiffness = totals.tip.stiffness;
  const double largest = particles.largest_radius();
  totals.one_contact_stiffness = material.normal_stiffness(largest, largest);
  return totals;
}

void Pile::advance(double dt) {
  tip_z_ += velocity_ * dt;
  travel_ += std::abs(velocity_ * dt);
}

void Pile::hash(Hash& h) const {
  h.add(tip_z_);
  h.add(velocity_);
  add_contacts(h, contacts_);
}

void Pile::clear_history() {
  contacts_.clear();
  sleeping_.wake_all();
}

void Pile::restore(double tip_z, double velocity, std::vector<WallContact> contacts) {
  tip_z_ = tip_z;
  velocity_ = velocity;
  contacts_ = std::move(contacts);
  sleeping_.wake_all();
}

}  // namespace lockstep::dem
