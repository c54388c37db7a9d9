#include "dem_server/contacts.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

namespace {

// Entries of the inner list that are worked on together; the next block is fetched meanwhile.
constexpr std::size_t pair_block = prefetch_distance;

}  // namespace

PairContacts::PairContacts(double skin, std::optional<Vec3> period) : skin_(skin), period_(period) {
  LOCKSTEP_ASSERT(skin > 0, "skin {}", skin);
}

void PairContacts::load(const Particles& particles) {
  const std::size_t bodies = particles.body_count();
  bodies_.resize(bodies);
  loads_.resize(bodies);
  pebbles_.resize(particles.pebble_count());
  for (std::size_t b = 0; b < bodies; ++b) {
    const Vec3 &v = particles.velocity[b], &w = particles.spin[b], &x = particles.position[b];
    bodies_[b] = {v.x(), v.y(), v.z(), w.x(), w.y(), w.z(), particles.equivalent_radius[b], particles.mass[b]};
    for (std::int32_t p = particles.pebble_begin[b]; p < particles.pebble_begin[b + 1]; ++p) {
      const Vec3& c = particles.pebble_center[p];
      pebbles_[p] = {c.x(), c.y(), c.z(), particles.pebble_radius[p], c.x() - x.x(), c.y() - x.y(), c.z() - x.z(), 0};
    }
  }
}

PairContacts::Travel PairContacts::travel_since(const std::vector<Mark>& marks, const Particles& particles) const {
  Travel travel;
  double all = 0;  // NaN or infinite as soon as one pebble is
  for (std::size_t b = 0; b < bodies_.size(); ++b) {
    double square = 0, growth = 0;
    for (std::int32_t p = particles.pebble_begin[b]; p < particles.pebble_begin[b + 1]; ++p) {
      const PebbleRecord& now = pebbles_[p];
      const Mark& then = marks[p];
      const double x = now.x - then.x, y = now.y - then.y, z = now.z - then.z;
      square = std::max(x * x + y * y + z * z, square);
      growth = std::max(growth, now.radius - then.radius);
      all += x + y + z;
    }
    // The root is taken only of bodies that matter.
    const double room = travel.second - growth;
    if (room < 0 || square > room * room) {
      const double reach = std::sqrt(square) + growth;
      if (reach > travel.largest) {
        travel.second = travel.largest;
        travel.largest = reach;
      } else {
        travel.second = std::max(travel.second, reach);
      }
    }
  }
  if (!std::isfinite(all)) travel.largest = std::numeric_limits<double>::infinity();
  return travel;
}

void PairContacts::update(const Particles& particles) {
  load(particles);
  const bool is_same_crowd = has_lists_ && outer_marks_.size() == pebbles_.size();
  LOCKSTEP_ASSERT(is_same_crowd || !has_lists_, "pebbles were added or removed without clear_history");
  if (!has_lists_) {
    rebuild_outer(particles);
    refresh_inner();
  } else if (!(travel_since(inner_marks_, particles).sum() <= skin_)) {
    // The inner list takes every pair with a gap below the skin: none of them may be missing from the outer list.
    if (!(travel_since(outer_marks_, particles).sum() <= (outer_skin_factor - 1) * skin_)) rebuild_outer(particles);
    refresh_inner();
  }
}

void PairContacts::rebuild_outer(const Particles& particles) {
  search_.find(particles, outer_skin_factor * skin_, period_, outer_);
  outer_marks_.resize(pebbles_.size());
  for (std::size_t p = 0; p < pebbles_.size(); ++p)
    outer_marks_[p] = {pebbles_[p].x, pebbles_[p].y, pebbles_[p].z, pebbles_[p].radius};
  has_lists_ = true;
  ++rebuilds_;
}

void PairContacts::refresh_inner() {
  next_pairs_.clear();
  next_history_.clear();
  if (period_) image_.clear();
  std::size_t old = 0;  // walks the present list along with the outer one: both are sorted by (i, j)
  for (const PebblePair& pair : outer_) {
    const PebbleRecord &i = pebbles_[pair.i], &j = pebbles_[pair.j];
    Vec3 d(j.x - i.x, j.y - i.y, j.z - i.z);
    std::array<std::int16_t, 3> image = {0, 0, 0};
    if (period_) {
      image = nearest_image(d, *period_);
      for (int k = 0; k < 3; ++k) d[k] += image[k] * (*period_)[k];
    }
    const double range = i.radius + j.radius + skin_;
    if (!(d.squaredNorm() < range * range)) continue;
    while (old < pairs_.size() && (pairs_[old].i < pair.i || (pairs_[old].i == pair.i && pairs_[old].j < pair.j)))
      ++old;
    const bool is_known = old < pairs_.size() && pairs_[old].i == pair.i && pairs_[old].j == pair.j;
    next_pairs_.push_back(pair);
    next_history_.push_back(is_known ? history_[old] : ContactHistory{});
    if (period_) image_.push_back(image);
  }
  pairs_.swap(next_pairs_);
  history_.swap(next_history_);
  inner_marks_.resize(pebbles_.size());
  for (std::size_t p = 0; p < pebbles_.size(); ++p)
    inner_marks_[p] = {pebbles_[p].x, pebbles_[p].y, pebbles_[p].z, pebbles_[p].radius};
  ++refreshes_;
}

// For each entry of the inner list: distance, and if the pebbles overlap
//   contact point   x_i + (r_i - U/2) n, the middle of the overlap, the same for both bodies
//   V               velocity of B there less that of A               (paper eq. 4)
//   the law         contact_law.hpp                                  (eqs 3, 8-11)
//   loads           force and moment about each centre of mass       (eq. 12)
// Block by block: which entries touch, without a branch to mispredict; their distances, all roots and divisions under
// way at once; then the contacts one after the other. Flattened, since the law as a call costs a fifth of the loop.
template <bool is_periodic, bool has_dashpot>
[[gnu::flatten]] ContactTotals PairContacts::compute_pairs(double time_step) {
  ContactTotals totals;
  const std::size_t count = pairs_.size();
  const Vec3 period = is_periodic ? *period_ : Vec3::Zero();
  const double shear_share = 1 / material_.stiffness_ratio;
  double energy = 0;  // twice the elastic energy
  std::array<std::size_t, pair_block> touching, parted;
  std::array<Vec3, pair_block> apart;  // x_j - x_i of those that touch
  std::array<double, pair_block> distances, inverses;
  for (std::size_t begin = 0; begin < count; begin += pair_block) {
    std::size_t touching_count = 0, parted_count = 0;
    for (std::size_t k = begin; k < std::min(begin + pair_block, count); ++k) {
      const PebblePair& ahead = pairs_[std::min(k + pair_block, count - 1)];
      __builtin_prefetch(&pebbles_[ahead.j]);
      __builtin_prefetch(&bodies_[ahead.b]);
      __builtin_prefetch(&loads_[ahead.b], 1);
      const PebbleRecord &pi = pebbles_[pairs_[k].i], &pj = pebbles_[pairs_[k].j];
      Vec3 d(pj.x - pi.x, pj.y - pi.y, pj.z - pi.z);
      if constexpr (is_periodic)
        for (int axis = 0; axis < 3; ++axis) d[axis] += image_[k][axis] * period[axis];
      const double reach = pi.radius + pj.radius, square = d.squaredNorm();
      const bool is_touching = square < reach * reach;
      apart[touching_count] = d;
      distances[touching_count] = square;
      touching[touching_count] = parted[parted_count] = k;
      touching_count += is_touching;
      parted_count += !is_touching;
    }
    for (std::size_t n = 0; n < parted_count; ++n) history_[parted[n]] = ContactHistory{};
    for (std::size_t n = 0; n < touching_count; ++n) {
      distances[n] = std::sqrt(distances[n]);
      inverses[n] = 1 / distances[n];
    }

    for (std::size_t n = 0; n < touching_count; ++n) {
      const PebblePair& pair = pairs_[touching[n]];
      const PebbleRecord &pi = pebbles_[pair.i], &pj = pebbles_[pair.j];
      ContactHistory& history = history_[touching[n]];
      const double overlap = pi.radius + pj.radius - distances[n];
      const Vec3 normal = apart[n] * inverses[n];

      const BodyRecord &a = bodies_[pair.a], &b = bodies_[pair.b];
      const double arm_i = pi.radius - 0.5 * overlap, arm_j = pj.radius - 0.5 * overlap;
      const Vec3 lever_a = Vec3(pi.lever_x, pi.lever_y, pi.lever_z) + arm_i * normal;
      const Vec3 lever_b = Vec3(pj.lever_x, pj.lever_y, pj.lever_z) - arm_j * normal;
      const Vec3 relative_velocity = Vec3(b.vx - a.vx, b.vy - a.vy, b.vz - a.vz) +
                                     Vec3(b.wx, b.wy, b.wz).cross(lever_b) - Vec3(a.wx, a.wy, a.wz).cross(lever_a);

      ContactMaterial pair_material;
      pair_material.normal_stiffness = material_.normal_stiffness(a.equivalent_radius, b.equivalent_radius);
      pair_material.shear_stiffness = pair_material.normal_stiffness * shear_share;
      pair_material.friction = material_.friction;
      if constexpr (has_dashpot)
        pair_material.normal_dashpot =
            pair_dashpot(material_.damping_ratio, pair_material.normal_stiffness, a.mass, b.mass);
      const ContactResult result = contact_force(pair_material, normal, overlap, relative_velocity, time_step, history);

      const Vec3& force = result.force_on_a;
      const Vec3 torque_a = lever_a.cross(force), torque_b = lever_b.cross(force);
      Load& on_a = loads_[pair.a];
      on_a.fx += force.x(), on_a.fy += force.y(), on_a.fz += force.z();
      on_a.tx += torque_a.x(), on_a.ty += torque_a.y(), on_a.tz += torque_a.z();
      Load& on_b = loads_[pair.b];
      on_b.fx -= force.x(), on_b.fy -= force.y(), on_b.fz -= force.z();
      on_b.tx -= torque_b.x(), on_b.ty -= torque_b.y(), on_b.tz -= torque_b.z();

      ++totals.active;
      totals.normal_force += result.normal_force;
      totals.contact_force += force.norm();
      energy += pair_material.normal_stiffness * overlap * overlap +
                history.spring.squaredNorm() / pair_material.shear_stiffness;
      totals.slip_work += result.slip_work;
      if constexpr (has_dashpot) totals.dashpot_work += result.dashpot_power * time_step;
      const double smaller = std::min(a.equivalent_radius, b.equivalent_radius);
      if (overlap > totals.largest_overlap_ratio * smaller) totals.largest_overlap_ratio = overlap / smaller;
    }
  }
  totals.elastic_energy = 0.5 * energy;
  return totals;
}

ContactTotals PairContacts::compute(Particles& particles, const GrainMaterial& material, double time_step) {
  LOCKSTEP_ASSERT(bodies_.size() == particles.body_count(), "compute without update");
  material_ = material;
  std::fill(loads_.begin(), loads_.end(), Load{});
  const bool has_dashpot = material.damping_ratio > 0;
  ContactTotals totals;
  if (period_)
    totals = has_dashpot ? compute_pairs<true, true>(time_step) : compute_pairs<true, false>(time_step);
  else
    totals = has_dashpot ? compute_pairs<false, true>(time_step) : compute_pairs<false, false>(time_step);
  for (std::size_t b = 0; b < loads_.size(); ++b) {
    const Load& l = loads_[b];
    particles.force[b] += Vec3(l.fx, l.fy, l.fz);
    particles.torque[b] += Vec3(l.tx, l.ty, l.tz);
  }
  return totals;
}

Vec3 PairContacts::center_to_center(std::size_t k) const {
  const PebbleRecord &i = pebbles_[pairs_[k].i], &j = pebbles_[pairs_[k].j];
  Vec3 d(j.x - i.x, j.y - i.y, j.z - i.z);
  if (period_)
    for (int axis = 0; axis < 3; ++axis) d[axis] += image_[k][axis] * (*period_)[axis];
  return d;
}

Vec3 PairContacts::branch(std::size_t k) const {
  const PebbleRecord &i = pebbles_[pairs_[k].i], &j = pebbles_[pairs_[k].j];
  return center_to_center(k) + Vec3(i.lever_x - j.lever_x, i.lever_y - j.lever_y, i.lever_z - j.lever_z);
}

ContactView PairContacts::view(std::size_t k) const {
  const PebblePair& pair = pairs_[k];
  const PebbleRecord &pi = pebbles_[pair.i], &pj = pebbles_[pair.j];
  const BodyRecord &a = bodies_[pair.a], &b = bodies_[pair.b];
  ContactView v;
  v.body_a = pair.a;
  v.body_b = pair.b;
  v.normal = history_[k].normal;
  v.overlap = pi.radius + pj.radius - center_to_center(k).norm();
  const double arm_i = pi.radius - 0.5 * v.overlap, arm_j = pj.radius - 0.5 * v.overlap;
  v.point = Vec3(pi.x, pi.y, pi.z) + arm_i * v.normal;
  v.normal_stiffness = material_.normal_stiffness(a.equivalent_radius, b.equivalent_radius);
  v.shear_stiffness = v.normal_stiffness / material_.stiffness_ratio;
  double normal_force = v.normal_stiffness * v.overlap;
  if (material_.damping_ratio > 0) {
    const Vec3 lever_a = Vec3(pi.lever_x, pi.lever_y, pi.lever_z) + arm_i * v.normal;
    const Vec3 lever_b = Vec3(pj.lever_x, pj.lever_y, pj.lever_z) - arm_j * v.normal;
    const Vec3 relative_velocity = Vec3(b.vx - a.vx, b.vy - a.vy, b.vz - a.vz) + Vec3(b.wx, b.wy, b.wz).cross(lever_b) -
                                   Vec3(a.wx, a.wy, a.wz).cross(lever_a);
    const double dashpot = pair_dashpot(material_.damping_ratio, v.normal_stiffness, a.mass, b.mass);
    normal_force = std::max(0.0, normal_force - dashpot * relative_velocity.dot(v.normal));
  }
  v.force_on_a = history_[k].spring - normal_force * v.normal;
  return v;
}

void PairContacts::hash(Hash& h) const {
  for (std::size_t k = 0; k < pairs_.size(); ++k)
    if (history_[k].normal != Vec3::Zero()) {
      h.add(static_cast<std::uint64_t>(pairs_[k].i));
      h.add(static_cast<std::uint64_t>(pairs_[k].j));
      h.add(history_[k].spring);
      h.add(history_[k].normal);
    }
}

std::vector<PairContacts::Spring> PairContacts::springs() const {
  std::vector<Spring> all;
  for (std::size_t k = 0; k < pairs_.size(); ++k)
    if (history_[k].normal != Vec3::Zero()) all.push_back({pairs_[k].i, pairs_[k].j, history_[k]});
  return all;
}

void PairContacts::restore(const std::vector<Spring>& springs) {
  clear_history();
  for (const Spring& s : springs) {
    pairs_.push_back({s.i, s.j, -1, -1});  // only (i, j) is read when the next list takes the history over
    history_.push_back(s.history);
  }
}

void PairContacts::clear_history() {
  pairs_.clear();
  history_.clear();
  image_.clear();
  outer_.clear();
  has_lists_ = false;
}

}  // namespace lockstep::dem
