// What is measured on the grains: porosity, coordination, mean stress, unbalanced ratio.
#pragma once
#include <functional>
#include <optional>

#include "dem_server/contact_law.hpp"
#include "dem_server/particles.hpp"

namespace lockstep::dem {

struct Box {
  Vec3 low = Vec3::Zero(), high = Vec3::Zero();  // [m]
  bool contains(const Vec3& x) const { return (x.array() >= low.array()).all() && (x.array() < high.array()).all(); }
  double volume() const { return (high - low).prod(); }
};

struct Ball {
  Vec3 center = Vec3::Zero();  // [m]
  double radius = 0;           // [m]
  bool contains(const Vec3& x) const { return (x - center).squaredNorm() < radius * radius; }
};

// Share of the region that no pebble covers, overlaps counted once [-]: a cubic lattice of points at `spacing` [m] in
// the region's bounding box, each inside or outside. A spacing of R/8 gives 0.002 on 100 grains. InputError if the
// region holds no point.
double porosity(const Particles& particles, const Box& region, double spacing);
double porosity(const Particles& particles, const Ball& region, double spacing);
// In the part of the box that `is_inside` accepts (a ring, a wedge, a sleeve).
double porosity(const Particles& particles, const Box& bounds, double spacing,
                const std::function<bool(const Vec3&)>& is_inside);

// Volume of the bodies' shapes: mass over density is what a scene knows; equivalent radius is what a body knows [m3].
double solid_volume(const Particles& particles);

// Mean stress of a region, tension positive (Love, Weber): sigma = 1/V sum over contacts of f_A (x) l, symmetrised,
// where f_A is the force on A and l goes from the centre of A to that of B, or to the contact point where B is no
// grain. A contact belongs to the region that holds its point.
class MeanStress {
 public:
  explicit MeanStress(const Box& region) : region_(region) {}
  void add(const ContactView& contact, const Particles& particles);
  // In a periodic cell: `branch` is l.
  void add(const ContactView& contact, const Vec3& branch);
  Voigt stress() const;     // [Pa]
  double pressure() const;  // minus a third of the trace [Pa]

 private:
  Box region_;
  Mat3 sum_ = Mat3::Zero();  // [N m]
};

// Mean number of neighbours a body touches [-]: a pair of bodies counts once however many pebbles touch; walls count.
class Coordination {
 public:
  explicit Coordination(std::size_t bodies) : partners_(bodies) {}
  void add(const ContactView& contact);
  double mean() const;
  // Bodies with fewer than `least` partners.
  std::size_t rattlers(std::size_t least = 3) const;
  std::size_t partners(std::int32_t body) const { return count(partners_[body]); }

 private:
  static std::size_t count(std::vector<std::int32_t> partners);
  std::vector<std::vector<std::int32_t>> partners_;
};

// Mean unbalanced force of the bodies over the mean contact force [-]; infinite when bodies are out of balance and
// nothing touches, zero when neither is.
double unbalanced_ratio(double unbalanced_force_sum, std::size_t bodies, double contact_force_sum,
                        std::int64_t contacts);

}  // namespace lockstep::dem
