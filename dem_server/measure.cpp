#include "dem_server/measure.hpp"

#include <limits>

namespace lockstep::dem {

double unbalanced_ratio(double unbalanced_force_sum, std::size_t bodies, double contact_force_sum,
                        std::int64_t contacts) {
  if (bodies == 0 || unbalanced_force_sum == 0) return 0;
  if (contacts == 0 || contact_force_sum == 0) return std::numeric_limits<double>::infinity();
  return unbalanced_force_sum / static_cast<double>(bodies) / (contact_force_sum / static_cast<double>(contacts));
}

// 1/2 m v.v and 1/2 w.I w, the latter in the body frame where I is diagonal.
KineticEnergies kinetic_energies(const Particles& particles) {
  KineticEnergies sum;
  for (std::size_t b = 0; b < particles.body_count(); ++b) {
    const Vec3 spin = particles.orientation(b).conjugate() * particles.spin(b);
    sum.translational += 0.5 * particles.mass(b) * particles.velocity(b).squaredNorm();
    sum.rotational += 0.5 * spin.dot(particles.inertia(b).cwiseProduct(spin));
  }
  return sum;
}

void ElasticEnergies::add(const ContactView& c) {
  normal += 0.5 * c.normal_stiffness * c.overlap * c.overlap;
  if (c.shear_stiffness > 0) shear += 0.5 * shear_force_of(c).squaredNorm() / c.shear_stiffness;
}

}  // namespace lockstep::dem
