// How the contact forces are shared out: their distribution about the mean, the strong ones, and how much of the
// friction they use. Of the pairs of grains; a histogram is a list of bins with the counts in them.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "dem_server/contact_law.hpp"

namespace lockstep::dem {

// Of one contact, pressing positive [N].
inline double normal_force_of(const ContactView& c) { return -c.force_on_a.dot(c.normal); }
inline Vec3 shear_force_of(const ContactView& c) { return c.force_on_a + normal_force_of(c) * c.normal; }

// |F_s| / (mu F_n), 1 when sliding [-]. Zero where friction cannot hold anything.
double mobilisation_of(const ContactView& contact, double friction);

struct Histogram {
  double bin_width = 0;
  std::vector<std::size_t> counts;  // of [n w, (n + 1) w)
  std::size_t total() const;
  // Share of the values in bin n over the bin's width: the bins' areas sum to 1. Zero without values.
  double density(std::size_t n) const;
};

struct ForceNetwork {
  std::size_t contacts = 0;       // that press
  double mean_normal_force = 0;   // of these [N]
  double strong_share = 0;        // of the contacts: those above the mean [-]
  double strong_force_share = 0;  // of the sum of normal forces: what these carry [-]
  double largest_over_mean = 0;   // [-]
  double mean_mobilisation = 0;   // [-]
  double sliding_share = 0;       // of the contacts: those with 0.99 of their friction used, or more [-]
  Histogram normal_force;         // F_n over its mean, bins of 0.1 (wider where there
                                  // would be more than 1000)
  Histogram mobilisation;         // twenty bins from 0 to 1, sliding ones in the last
};

// `friction` is that of the contacts. Contacts with walls, and such that do not press, are left out.
ForceNetwork force_network(std::span<const ContactView> contacts, double friction);

}  // namespace lockstep::dem
