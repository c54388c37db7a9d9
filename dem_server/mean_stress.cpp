#include "dem_server/mean_stress.hpp"

namespace lockstep::dem {

double deviator_of(const Voigt& s) {
  const double p = pressure_of(s);
  const Vec3 normal(s[0] + p, s[1] + p, s[2] + p);
  return std::sqrt(1.5 * (normal.squaredNorm() + 2 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5])));
}

void StressField::add(const ContactView& contact, const Particles& particles) {
  for_each_arm(contact, particles, [&](const Vec3& begin, const Vec3& end) {
    const Mat3 carried = contact.force_on_a * (end - begin).transpose();
    grid_.for_each_piece(begin, end, [&](std::size_t cell, double share) { sum_[cell] += share * carried; });
  });
  grid_.for_each_piece(contact.point, contact.point, [&](std::size_t cell, double) { ++contacts_[cell]; });
}

}  // namespace lockstep::dem
