#include "dem_server/wall_contacts.hpp"

#include <algorithm>

namespace lockstep::dem {

namespace {

// A contact goes on with the spring of the last step's contact of the same pebble whose normal is the most similar, if
// their angle's cosine is above this: less than the angle between the two contacts of a right-angled corner.
constexpr double least_similarity = 0.5;

// Contacts of the last step with one surface, [begin, end) of all, by pebble. A spring is handed on once.
class Heritage {
 public:
  Heritage(const std::vector<WallSpring>& last, std::size_t begin, std::size_t end, std::int32_t first_pebble)
      : last_(last), end_(end) {
    const auto from = last.begin() + static_cast<std::ptrdiff_t>(begin);
    const auto to = last.begin() + static_cast<std::ptrdiff_t>(end);
    next_ = static_cast<std::size_t>(
        std::lower_bound(from, to, first_pebble, [](const WallSpring& s, std::int32_t p) { return s.pebble < p; }) -
        last.begin());
  }
  // Whose spring a touch goes on with, -1 for none. Called with rising pebbles.
  std::int32_t of(const WallTouch& touch) {
    while (next_ < end_ && last_[next_].pebble < touch.pebble) ++next_, taken_ = 0;
    double most_similar = least_similarity;
    std::size_t heir_of = end_;
    for (std::size_t i = next_; i < end_ && last_[i].pebble == touch.pebble; ++i) {
      const WallSpring& s = last_[i];
      const double similarity = -(s.nx * touch.nx + s.ny * touch.ny + s.nz * touch.nz);
      if (similarity <= most_similar || (i - next_ < mask_bits && taken_ >> (i - next_) & 1)) continue;
      most_similar = similarity;
      heir_of = i;
    }
    if (heir_of == end_) return -1;
    if (heir_of - next_ < mask_bits) taken_ |= std::uint64_t{1} << (heir_of - next_);
    return static_cast<std::int32_t>(heir_of);
  }

 private:
  static constexpr std::size_t mask_bits = 64;
  const std::vector<WallSpring>& last_;
  std::size_t next_ = 0, end_ = 0;
  std::uint64_t taken_ = 0;  // of the present pebble's contacts
};

template <class T>
T* with_room(std::vector<T>& values, std::size_t count) {
  if (values.size() < count) values.resize(std::max(count, 2 * values.size()));
  return values.data();
}

}  // namespace

WallKernels wall_kernels(InstructionSet instructions) { return LOCKSTEP_KERNEL_FOR(instructions, wall_kernel)(); }

WallTotals totals_of(const WallSums& sums) {
  WallTotals totals;
  totals.contacts = static_cast<std::size_t>(sums.contacts);
  totals.force = -Vec3(sums.fx, sums.fy, sums.fz);
  totals.torque = -Vec3(sums.mx, sums.my, sums.mz);
  totals.normal_force = sums.normal_force;
  totals.stiffness = sums.normal_stiffness;
  totals.elastic_energy = sums.elastic_energy;
  totals.slip_work = sums.slip_work;
  totals.dashpot_work = sums.dashpot_work;
  totals.power = sums.power;
  totals.max_overlap = sums.largest_overlap_ratio;
  return totals;
}

WallTotals& WallTotals::operator+=(const WallTotals& other) {
  contacts += other.contacts;
  force += other.force;
  normal_force += other.normal_force;
  stiffness += other.stiffness;
  elastic_energy += other.elastic_energy;
  slip_work += other.slip_work;
  dashpot_work += other.dashpot_work;
  power += other.power;
  work += other.work;
  max_overlap = std::max(max_overlap, other.max_overlap);
  return *this;
}

// ---------------------------------------------------------------------------------------------------------- a step

WallTouch* WallContacts::Part::room(std::size_t touches) { return with_room(touches_, touches + wall_block); }

void WallContacts::Part::set_touches(std::int32_t count, std::int32_t part) {
  touch_count_ = count;
  for (std::int32_t i = 0; i < count; ++i) touches_[static_cast<std::size_t>(i)].part = part;
}

void WallContacts::Part::add_touch(std::int32_t pebble, const Vec3& outward, double overlap, std::int32_t part) {
  WallTouch& touch = room(static_cast<std::size_t>(touch_count_) + 1)[touch_count_];
  ++touch_count_;
  touch.nx = outward.x(), touch.ny = outward.y(), touch.nz = outward.z();
  touch.overlap = overlap;
  touch.pebble = pebble;
  touch.part = part;
}

void WallContacts::begin(std::size_t surfaces, int parts) {
  std::swap(springs_, last_springs_);
  std::swap(surface_end_, last_surface_end_);
  last_surface_end_.resize(surfaces, last_surface_end_.empty() ? 0 : last_surface_end_.back());
  surfaces_ = surfaces;
  parts_.resize(static_cast<std::size_t>(parts));
  for (Part& part : parts_) part.contact_count_ = 0, part.touch_count_ = 0, part.surface_end_.clear();
}

void WallContacts::press(Part& part, std::size_t index, std::int32_t first_pebble, const WallKernels& kernels,
                         Particles& particles, const WallLaw& law, const WallMotion& motion) const {
  if (part.touch_count_ > 0) {
    Heritage heritage(last_springs_, index > 0 ? last_surface_end_[index - 1] : 0, last_surface_end_[index],
                      first_pebble);
    for (std::int32_t i = 0; i < part.touch_count_; ++i) {
      WallTouch& touch = part.touches_[static_cast<std::size_t>(i)];
      touch.heir_of = heritage.of(touch);
      touch.body = touch.heir_of >= 0 ? last_springs_[static_cast<std::size_t>(touch.heir_of)].body
                                      : particles.pebble_body(static_cast<std::size_t>(touch.pebble));
    }
    const std::size_t before = part.contact_count_;
    part.contact_count_ += static_cast<std::size_t>(part.touch_count_);
    WallSpring* springs = with_room(part.springs_, part.contact_count_ + wall_block) + before;
    WallPress* presses = with_room(part.presses_, part.contact_count_ + wall_block) + before;
    kernels.press(records_of(particles), law, motion,
                  part.surface_velocity_.empty() ? nullptr : part.surface_velocity_.data(), part.touches_.data(),
                  part.touch_count_, last_springs_.data(), springs, presses);
    part.touch_count_ = 0;
    part.surface_velocity_.clear();
  }
  part.surface_end_.push_back(part.contact_count_);
}

void WallContacts::end() {
  surface_end_.clear();
  for (Part& part : parts_) part.surface_end_.resize(surfaces_, part.contact_count_);  // where nothing was near
  if (parts_.size() == 1) {
    std::swap(springs_, parts_[0].springs_);
    surface_end_ = parts_[0].surface_end_;
    return;
  }
  springs_.clear();
  for (std::size_t k = 0; k < surfaces_; ++k) {
    for (const Part& part : parts_) {
      const auto begin = static_cast<std::ptrdiff_t>(k > 0 ? part.surface_end_[k - 1] : 0);
      const auto end = static_cast<std::ptrdiff_t>(part.surface_end_[k]);
      springs_.insert(springs_.end(), part.springs_.begin() + begin, part.springs_.begin() + end);
    }
    surface_end_.push_back(springs_.size());
  }
}

WallTotals WallContacts::totals(std::size_t surface, const Vec3& center, const WallKernels& kernels) const {
  WallSums sums;
  for (const Part& part : parts_) {
    const std::size_t begin = surface > 0 ? part.surface_end_[surface - 1] : 0, end = part.surface_end_[surface];
    kernels.add_up(part.presses_.data() + begin, static_cast<std::int32_t>(end - begin), center.data(), sums);
  }
  return totals_of(sums);
}

// -------------------------------------------------------------------------------------------------- seen and stored

WallContact WallContacts::whole(const WallSpring& s, const WallPress& p) {
  WallContact contact;
  contact.pebble = s.pebble;
  contact.body = s.body;
  contact.part = s.part;
  contact.point = Vec3(p.x, p.y, p.z);
  contact.overlap = p.overlap;
  contact.normal_stiffness = p.normal_stiffness;
  contact.shear_stiffness = p.shear_stiffness;
  contact.force = Vec3(p.fx, p.fy, p.fz);
  contact.history.spring = Vec3(s.sx, s.sy, s.sz);
  contact.history.normal = Vec3(s.nx, s.ny, s.nz);
  return contact;
}

std::vector<WallContact> WallContacts::all() const {
  std::vector<WallContact> contacts;
  for_each_contact([&](const WallContact& contact) { contacts.push_back(contact); });
  return contacts;
}

void WallContacts::hash(Hash& h) const {
  for (std::size_t i = 0; i < size(); ++i) {
    const WallSpring& s = springs_[i];
    h.add(static_cast<std::uint64_t>(s.pebble));
    h.add(static_cast<std::uint64_t>(s.part));
    h.add(Vec3(s.sx, s.sy, s.sz));
    h.add(Vec3(s.nx, s.ny, s.nz));
  }
}

void WallContacts::clear() { restore(surfaces_, {}); }

void WallContacts::restore(std::size_t surfaces, const std::vector<WallContact>& contacts) {
  springs_.clear(), surface_end_.clear();
  surfaces_ = surfaces;
  parts_.assign(1, Part{});
  Part& part = parts_[0];
  for (const WallContact& c : contacts) {
    WallSpring spring{};
    spring.sx = c.history.spring.x(), spring.sy = c.history.spring.y(), spring.sz = c.history.spring.z();
    spring.nx = c.history.normal.x(), spring.ny = c.history.normal.y(), spring.nz = c.history.normal.z();
    spring.pebble = c.pebble, spring.body = c.body, spring.part = c.part;
    WallPress press{};
    press.fx = c.force.x(), press.fy = c.force.y(), press.fz = c.force.z();
    press.x = c.point.x(), press.y = c.point.y(), press.z = c.point.z();
    press.overlap = c.overlap;
    press.normal_stiffness = c.normal_stiffness, press.shear_stiffness = c.shear_stiffness;
    press.part = c.part;
    springs_.push_back(spring);
    part.presses_.push_back(press);
  }
  part.contact_count_ = springs_.size();
  std::size_t next = 0;
  for (std::size_t k = 0; k < surfaces; ++k) {
    // Where there are several surfaces, a contact's part is the surface.
    while (next < springs_.size() && (surfaces == 1 || springs_[next].part <= static_cast<std::int32_t>(k))) ++next;
    surface_end_.push_back(next);
  }
  part.surface_end_ = surface_end_;
}

}  // namespace lockstep::dem
