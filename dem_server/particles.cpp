#include "dem_server/particles.hpp"

#include <algorithm>
#include <utility>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

namespace {

// What stands behind the last record.
constexpr SphereRecord nowhere = {far_away, far_away, far_away, 0};
constexpr MotionRecord nothing = {0, 0, 0, 0, 0, 0, 0, 1};

Quat quaternion(const AttitudeRecord& a) { return {a.qw, a.qx, a.qy, a.qz}; }

// Puts `value` before the record behind the last.
template <class Record>
void push(LargeArray<Record>& records, const Record& value) {
  records.insert(records.end() - 1, value);
}

}  // namespace

Particles::Particles() : bodies_{nowhere}, motion_{nothing}, loads_{LoadRecord{}} {}

Quat Particles::orientation(std::size_t b) const { return has_clumps() ? quaternion(attitudes_[b]) : Quat::Identity(); }

void Particles::set_orientation(std::size_t b, const Quat& attitude) {
  if (!has_clumps()) return;
  AttitudeRecord& a = attitudes_[b];
  a.qx = attitude.x(), a.qy = attitude.y(), a.qz = attitude.z(), a.qw = attitude.w();
}

Vec3 Particles::inertia(std::size_t b) const {
  const double mass_radius_square = mass(b) * (equivalent_radius(b) * equivalent_radius(b));
  return mass_radius_square * shape(b).inertia_per_mass;
}

const ClumpTemplate& Particles::shape(std::size_t b) const {
  static const ClumpTemplate sphere = unit_sphere();
  return has_clumps() ? shapes_[shape_number_[b]] : sphere;
}

Vec3 Particles::pebble_offset(std::size_t p) const {
  if (!has_clumps()) return Vec3::Zero();
  const auto b = static_cast<std::size_t>(pebble_body_[p]);
  return equivalent_radius(b) * shape(b).pebble_center[p - static_cast<std::size_t>(pebble_begin_[b])];
}

void Particles::reserve(std::size_t bodies, std::size_t pebbles) {
  bodies_.reserve(bodies + 1), motion_.reserve(bodies + 1), loads_.reserve(bodies + 1);
  if (pebbles == 0) return;
  attitudes_.reserve(bodies), shape_number_.reserve(bodies), pebble_begin_.reserve(bodies + 2);
  pebbles_.reserve(pebbles + 1), pebble_body_.reserve(pebbles + 1);
}

void Particles::reserve_copies(const Particles& from, std::size_t bodies) {
  reserve(bodies, from.has_clumps() ? bodies * from.pebble_count() / std::max<std::size_t>(from.body_count(), 1) : 0);
}

void Particles::become_clumps() {
  if (has_clumps()) return;
  const std::size_t count = body_count();
  pebble_begin_.resize(count + 2);
  for (std::size_t b = 0; b < count + 2; ++b) pebble_begin_[b] = static_cast<std::int32_t>(b);
  pebble_begin_[count + 1] = static_cast<std::int32_t>(count);
  pebble_body_.resize(count + 1);
  for (std::size_t p = 0; p <= count; ++p) pebble_body_[p] = static_cast<std::int32_t>(p);
  attitudes_.assign(count, {0, 0, 0, 1});
  if (count > 0) shape_number_.assign(count, shapes_.number_of(unit_sphere()));
  pebbles_ = bodies_;
}

std::int32_t Particles::add(const ClumpTemplate& shape, double radius, double density, const Vec3& center,
                            const Quat& attitude) {
  LOCKSTEP_ASSERT(radius > 0 && density > 0, "radius {}, density {}", radius, density);
  forget_twists();
  if (!shape.is_sphere()) become_clumps();
  const auto body = static_cast<std::int32_t>(body_count());
  const double mass = density * 4.0 / 3.0 * pi * radius * radius * radius;
  push(bodies_, {center.x(), center.y(), center.z(), radius});
  push(motion_, {0, 0, 0, radius, 0, 0, 0, mass});
  push(loads_, LoadRecord{});
  if (!has_clumps()) return body;

  const Quat unit = attitude.normalized();
  attitudes_.push_back({unit.x(), unit.y(), unit.z(), unit.w()});
  shape_number_.push_back(shapes_.number_of(shape));
  for (std::size_t p = 0; p < shape.pebble_center.size(); ++p) {
    push(pebbles_, nowhere);  // placed below
    pebble_body_.insert(pebble_body_.end() - 1, body);
  }
  pebble_body_.back() = body + 1;
  const auto count = static_cast<std::int32_t>(pebble_count());
  pebble_begin_.back() = count;
  pebble_begin_.push_back(count);
  place_pebbles(static_cast<std::size_t>(body));
  return body;
}

void Particles::place_pebbles(std::size_t b) {
  ++placements_;
  if (!has_clumps()) return;
  const Mat3 rotation = orientation(b).toRotationMatrix();
  const Vec3 center = std::as_const(*this).position(b);
  const double radius = equivalent_radius(b);
  const ClumpTemplate& own = shape(b);
  SphereRecord* pebble = &pebbles_[pebble_begin(b)];
  for (std::size_t k = 0; k < own.pebble_center.size(); ++k) {
    const Vec3 at = center + rotation * (radius * own.pebble_center[k]);
    pebble[k] = {at.x(), at.y(), at.z(), radius * own.pebble_radius[k]};
  }
}

void Particles::place_pebbles() {
  for (std::size_t b = 0; b < body_count(); ++b) place_pebbles(b);
}

void Particles::room_for_twists() {
  twists_.resize(has_clumps() ? bodies_.size() : 0);
  if (has_clumps()) twists_.back() = TwistRecord{};
}

void Particles::want_twists(TwistMaker make, Team& team) {
  if (!has_clumps() || has_twists_) return;
  room_for_twists();
  team.run([&](int thread) {
    const auto [begin, end] = share_of(body_count(), thread, team.size());
    make(bodies_.data(), motion_.data(), twists_.data(), static_cast<std::int32_t>(begin),
         static_cast<std::int32_t>(end));
  });
  has_twists_ = true;
}

void Particles::scale_mass(std::size_t b, double factor) {
  forget_twists();
  motion_[b].mass *= factor;
}

void Particles::scale(std::size_t b, double factor) {
  bodies_[b].radius *= factor;
  motion_[b].radius = bodies_[b].radius;
  scale_mass(b, factor * factor * factor);
  place_pebbles(b);
}

void Particles::scale_all(double factor) {
  if (factor > 1) {
    double largest = 0;
    for (std::size_t p = 0; p < pebble_count(); ++p) largest = std::max(largest, pebble_radius(p));
    growth_ += (factor - 1) * largest;
  }
  for (std::size_t b = 0; b < body_count(); ++b) scale(b, factor);
}

void Particles::append_copy(const Particles& from, std::size_t b, const Vec3& shift) {
  forget_twists();
  if (from.has_clumps()) become_clumps();
  const auto body = static_cast<std::int32_t>(body_count());
  const auto moved = [&](const SphereRecord& r) -> SphereRecord {
    return {r.x + shift.x(), r.y + shift.y(), r.z + shift.z(), r.radius};
  };
  push(bodies_, moved(from.bodies_[b]));
  push(motion_, from.motion_[b]);
  push(loads_, LoadRecord{});
  if (!has_clumps()) return;
  const Quat attitude = from.orientation(b);
  attitudes_.push_back({attitude.x(), attitude.y(), attitude.z(), attitude.w()});
  shape_number_.push_back(shapes_.number_of(from.shape(b)));
  for (std::int32_t p = from.pebble_begin(b); p < from.pebble_end(b); ++p) {
    push(pebbles_, moved(from.pebbles()[p]));
    pebble_body_.insert(pebble_body_.end() - 1, body);
  }
  pebble_body_.back() = body + 1;
  pebble_begin_.back() = static_cast<std::int32_t>(pebble_count());
  pebble_begin_.push_back(pebble_begin_.back());
}

void Particles::keep_only(const std::vector<char>& keep) {
  LOCKSTEP_ASSERT(keep.size() == body_count(), "{} marks for {} bodies", keep.size(), body_count());
  std::vector<std::int32_t> order;
  for (std::size_t b = 0; b < keep.size(); ++b)
    if (keep[b]) order.push_back(static_cast<std::int32_t>(b));
  reorder(order);
}

void Particles::reorder(const std::vector<std::int32_t>& order) {
  Particles next;
  const std::size_t count = order.size();
  next.bodies_.resize(count + 1, nowhere), next.motion_.resize(count + 1, nothing), next.loads_.resize(count + 1);
  next.bodies_[0] = nowhere, next.motion_[0] = nothing;
  for (std::size_t to = 0; to < count; ++to) {
    const std::int32_t from = order[to];
    next.bodies_[to] = bodies_[from], next.motion_[to] = motion_[from], next.loads_[to] = loads_[from];
  }
  next.bodies_[count] = nowhere, next.motion_[count] = nothing, next.loads_[count] = LoadRecord{};
  if (has_clumps()) {
    std::size_t pebbles = 0;
    for (const std::int32_t b : order) pebbles += static_cast<std::size_t>(pebble_end(b) - pebble_begin(b));
    next.reserve(count, pebbles);
    for (std::size_t to = 0; to < count; ++to) {
      const std::int32_t from = order[to];
      next.attitudes_.push_back(attitudes_[from]);
      next.shape_number_.push_back(shape_number_[from]);
      next.pebble_begin_.push_back(static_cast<std::int32_t>(next.pebbles_.size()));
      for (std::int32_t p = pebble_begin(from); p < pebble_end(from); ++p) {
        next.pebbles_.push_back(pebbles_[p]);
        next.pebble_body_.push_back(static_cast<std::int32_t>(to));
      }
    }
    next.pebble_begin_.insert(next.pebble_begin_.end(), 2, static_cast<std::int32_t>(next.pebbles_.size()));
    next.pebbles_.push_back(nowhere);
    next.shapes_ = std::move(shapes_);
    next.pebble_body_.push_back(static_cast<std::int32_t>(count));
  }
  *this = std::move(next);
}

void Particles::set_loads(std::size_t b, const Vec3& force, const Vec3& torque) {
  loads_[b] = LoadRecord{};
  add_force(b, std::as_const(*this).position(b), force);
  View(&loads_[b].mx) += torque;
}

void Particles::clear_forces() { std::fill(loads_.begin(), loads_.end(), LoadRecord{}); }

double Particles::smallest_radius() const {
  double least = body_count() > 0 ? equivalent_radius(0) : 0.0;
  for (std::size_t b = 0; b < body_count(); ++b) least = std::min(least, equivalent_radius(b));
  return least;
}

double Particles::largest_radius() const {
  double largest = 0;
  for (std::size_t b = 0; b < body_count(); ++b) largest = std::max(largest, equivalent_radius(b));
  return largest;
}

double Particles::mean_radius() const {
  double sum = 0;
  for (std::size_t b = 0; b < body_count(); ++b) sum += equivalent_radius(b);
  return body_count() > 0 ? sum / static_cast<double>(body_count()) : 0.0;
}

double Particles::lightest() const {
  double least = body_count() > 0 ? mass(0) : 0.0;
  for (std::size_t b = 0; b < body_count(); ++b) least = std::min(least, mass(b));
  return least;
}

double Particles::total_mass() const {
  double sum = 0;
  for (std::size_t b = 0; b < body_count(); ++b) sum += mass(b);
  return sum;
}

void Particles::hash(Hash& h) const {
  h.add(static_cast<std::uint64_t>(body_count()));
  for (std::size_t b = 0; b < body_count(); ++b) {
    h.add(position(b)), h.add(velocity(b)), h.add(spin(b));
    h.add(equivalent_radius(b)), h.add(mass(b));
  }
  if (!has_clumps()) return;
  for (std::size_t b = 0; b < body_count(); ++b) {
    const AttitudeRecord& a = attitudes_[b];
    h.add(Vec3(a.qx, a.qy, a.qz)), h.add(a.qw), h.add(inertia(b));
  }
  h.add(static_cast<std::uint64_t>(pebble_count()));
  for (std::size_t p = 0; p < pebble_count(); ++p) h.add(pebble_radius(p)), h.add(pebble_center(p));
}

std::size_t Particles::memory() const {
  const auto bytes = [](const auto& records) { return records.capacity() * sizeof(records[0]); };
  return bytes(bodies_) + bytes(motion_) + bytes(loads_) + bytes(attitudes_) + bytes(shape_number_) +
         bytes(pebble_begin_) + bytes(pebbles_) + bytes(pebble_body_) + bytes(twists_);
}

}  // namespace lockstep::dem
