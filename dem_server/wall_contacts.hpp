// The contacts of grains with rigid surfaces in one step: those of walls, or of the pile.
//
// Who owns the surfaces says what touches them (WallTouch: pebble, normal, overlap), surface after surface and with rising
// pebbles. Here each contact finds the spring that it goes on with, eight at a time are pressed (wall_kernel.hpp), and
// what the next step and the sums need is kept:
//
//   begin(); then a thread for each part:  part.touches -> press(), surface after surface;  then end()
//
// A part adds loads to its own bodies alone. Contacts are in the order of surfaces, parts and pebbles, that of a single
// thread, and sums are formed in that order.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/hash.hpp"
#include "common/instructions.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/wall_kernel.hpp"

namespace lockstep::dem {

// A contact of a pebble with a wall, as files and observers see it.
struct WallContact {
  std::int32_t pebble = -1;
  std::int32_t body = -1;
  std::int32_t part = 0;        // wall's index, or PilePart
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
  Vec3 force = Vec3::Zero();   // on the wall [N]
  Vec3 torque = Vec3::Zero();  // on the wall about its centre [N m]; a sum over walls has none
  double normal_force = 0;     // sum of |F_n| [N]
  double pressing = 0;         // sum of F_grain . d along the servo's direction; 0 without a servo [N]
  double stiffness = 0;        // sum of k_n [N/m]
  double elastic_energy = 0;   // [J]
  double slip_work = 0;        // taken out by sliding in this step [J]
  double dashpot_work = 0;     // taken out by dashpots in this step [J]
  double power = 0;            // of the wall on the grains, sum of F_grain . v_wall [W]
  double work = 0;             // of the wall on the grains over the step that led to t_n; not of the pile [J]
  double max_overlap = 0;      // largest U / R of a pebble

  WallTotals& operator+=(const WallTotals& other);
};

WallTotals totals_of(const WallSums& sums);

WallKernels wall_kernels(InstructionSet instructions);

inline GrainRecords records_of(Particles& particles) {
  const Particles& grains = particles;
  return {grains.pebbles(), grains.motion(), grains.has_clumps() ? grains.twists() : nullptr, particles.loads()};
}

class WallContacts {
 public:
  // What a thread finds and presses.
  class Part {
   public:
    // Room for so many touches of the next surface; that so many were written to it, with `part`.
    WallTouch* room(std::size_t touches);
    void set_touches(std::int32_t count, std::int32_t part);
    void add_touch(std::int32_t pebble, const Vec3& outward, double overlap, std::int32_t part);
    const WallTouch* begin() const { return touches_.data(); }
    const WallTouch* end() const { return touches_.data() + touch_count_; }
    // For each touch, or for none: that of the surface beside its rigid body's [m/s].
    void add_surface_velocity(const Vec3& v) { surface_velocity_.push_back({v.x(), v.y(), v.z(), 0}); }

   private:
    friend class WallContacts;
    std::vector<WallTouch> touches_;  // these three only grow
    std::vector<WallSpring> springs_;
    std::vector<WallPress> presses_;
    std::int32_t touch_count_ = 0;
    std::vector<SurfaceVelocity> surface_velocity_;
    std::size_t contact_count_ = 0;
    std::vector<std::size_t> surface_end_;  // of the contacts
  };

  // A step of so many surfaces: the contacts so far become those of the last step.
  void begin(std::size_t surfaces, int parts);
  Part& part(int k) { return parts_[static_cast<std::size_t>(k)]; }
  // The part's touches at surface `index`; none is of a pebble before `first_pebble`. Ends the surface.
  void press(Part& part, std::size_t index, std::int32_t first_pebble, const WallKernels& kernels, Particles& particles,
             const WallLaw& law, const WallMotion& motion) const;
  void end();

  std::size_t size() const { return surface_end_.empty() ? 0 : surface_end_.back(); }
  // Of the contacts with a surface that all parts have pressed; moments about `center`.
  WallTotals totals(std::size_t surface, const Vec3& center, const WallKernels& kernels) const;
  // visit(const WallPress&) for these contacts, in order.
  template <class Visit>
  void for_each(std::size_t surface, Visit&& visit) const {
    for (const Part& part : parts_)
      for (std::size_t i = surface > 0 ? part.surface_end_[surface - 1] : 0; i < part.surface_end_[surface]; ++i)
        visit(part.presses_[i]);
  }
  // visit(const WallContact&) for all, by surface, then pebble.
  template <class Visit>
  void for_each_contact(Visit&& visit) const {
    const WallSpring* spring = springs_.data();
    for (std::size_t k = 0; k < surfaces_; ++k)
      for_each(k, [&](const WallPress& press) { visit(whole(*spring++, press)); });
  }
  std::vector<WallContact> all() const;

  void hash(Hash& h) const;
  void clear();
  // Contacts of an earlier run, as all() gave them: the next step carries on from there.
  void restore(std::size_t surfaces, const std::vector<WallContact>& contacts);

 private:
  static WallContact whole(const WallSpring& spring, const WallPress& press);

  std::size_t surfaces_ = 0;
  std::vector<Part> parts_;
  // By surface, then pebble, and unused ones behind them: of this step, and of the last one.
  std::vector<WallSpring> springs_, last_springs_;
  std::vector<std::size_t> surface_end_, last_surface_end_;
};

}  // namespace lockstep::dem
