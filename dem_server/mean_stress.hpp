// Mean stress of a region, tension positive (Love, Weber), and what a stress is worth.
//
// A contact's force goes through the grains from centre to centre: from A's centre to the contact point and on to B's,
// or to the wall, pile or facet and out. The stress that this carries is the force along that way,
//   sigma = 1/V sum over contacts of f_A (x) l,      f_A on A, l the way from A towards B,
// and a region has of it what lies in it (Goldhirsch, Granular Matter 12, 2010, for a region in place of his smooth
// weight). So neighbouring regions share a contact by length, the regions of a grid sum up to the whole, and a chain
// under a force F has F over the section in each region it runs through, wherever the region begins. Rejected: giving
// the whole contact to the region that holds its point, which errs by a contact at each border.
//
// The tensor is made symmetric: grains in motion, or with torques not at rest, have a little that is not.
#pragma once
#include <vector>

#include "dem_server/contact_law.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/regions.hpp"

namespace lockstep::dem {

// Symmetric part of sum over volume [Pa].
inline Voigt stress_of(const Mat3& sum, double volume) {
  const Mat3 s = (0.5 / volume) * (sum + sum.transpose());
  Voigt v;
  v << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(2, 0);
  return v;
}

// Minus a third of the trace [Pa].
inline double pressure_of(const Voigt& s) { return -(s[0] + s[1] + s[2]) / 3; }

// q = sqrt(3 J2): the difference of the two stresses of a triaxial test [Pa].
double deviator_of(const Voigt& stress);

// Visits the straight pieces (begin, end) of the way that a contact's force takes, from A on.
template <class Visitor>
void for_each_arm(const ContactView& contact, const Particles& particles, Visitor&& visit) {
  visit(particles.position(contact.body_a), contact.point);
  if (contact.body_b >= 0) visit(contact.point, particles.position(contact.body_b));
}

// Of a Box or a Ball.
template <class Region>
class MeanStress {
 public:
  explicit MeanStress(const Region& region) : region_(region) {}
  void add(const ContactView& contact, const Particles& particles) {
    for_each_arm(contact, particles, [&](const Vec3& begin, const Vec3& end) {
      if (const double share = region_.share_of_line(begin, end); share > 0)
        sum_ += share * contact.force_on_a * (end - begin).transpose();
    });
  }
  // In a periodic cell that is the region: `branch` is l from A to B's image.
  void add(const ContactView& contact, const Vec3& branch) {
    if (region_.contains(contact.point)) sum_ += contact.force_on_a * branch.transpose();
  }
  // `room`: share of the region that grains could fill.
  Voigt stress(double room = 1) const { return stress_of(sum_, room * region_.volume()); }  // [Pa]
  double pressure() const { return pressure_of(stress()); }                                 // [Pa]

 private:
  Region region_;
  Mat3 sum_ = Mat3::Zero();  // [N m]
};

// Of each cell of a grid.
class StressField {
 public:
  explicit StressField(const CellGrid& grid)
      : grid_(grid), sum_(grid.size(), Mat3::Zero()), contacts_(grid.size(), 0) {}
  void add(const ContactView& contact, const Particles& particles);
  Voigt stress(std::size_t cell, double room = 1) const { return stress_of(sum_[cell], room * grid_.cell_volume()); }
  // Contact points in the cell.
  std::size_t contacts(std::size_t cell) const { return contacts_[cell]; }

 private:
  CellGrid grid_;
  std::vector<Mat3> sum_;  // [N m]
  std::vector<std::size_t> contacts_;
};

}  // namespace lockstep::dem
