// Who touches whom, and in which directions: coordination number, rattlers, fabric tensor of contact normals.
#pragma once
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "dem_server/contact_law.hpp"

namespace lockstep::dem {

// Bodies with fewer partners carry nothing when nothing pulls (Thornton, Geotechnique 50, 2000). Two partners do hold
// a clump, since each can touch it in several points.
inline constexpr std::size_t least_partners = 2;

// Number of partners, body by body.
class PartnerCounts {
 public:
  explicit PartnerCounts(std::vector<std::size_t> counts) : counts_(std::move(counts)) {}
  std::size_t bodies() const { return counts_.size(); }
  std::size_t operator[](std::size_t body) const { return counts_[body]; }
  // Mean of all bodies: the coordination number [-].
  double mean() const { return mechanical_mean(0); }
  // Mean of the bodies that are no rattlers [-]: (2 N_c - N_1) / (N - N_0 - N_1) for `least` 2.
  double mechanical_mean(std::size_t least = least_partners) const;
  // Bodies with fewer than `least` partners.
  std::size_t rattlers(std::size_t least = least_partners) const;
  // Entry k: bodies with k partners.
  std::vector<std::size_t> distribution() const;
  // Of those bodies only that `is_counted` accepts, by index.
  template <class Filter>
  PartnerCounts of(Filter&& is_counted) const {
    std::vector<std::size_t> part;
    for (std::size_t b = 0; b < counts_.size(); ++b)
      if (is_counted(b)) part.push_back(counts_[b]);
    return PartnerCounts(std::move(part));
  }

 private:
  std::vector<std::size_t> counts_;
};

// Finds each body's partners: a pair of bodies counts once however many pebbles touch; each contact with a wall, the
// pile or a facet is a partner of its own.
class Coordination {
 public:
  explicit Coordination(std::size_t bodies) : bodies_(bodies) {}
  void add(const ContactView& contact);
  PartnerCounts partners() const;
  std::size_t partners_of(std::int32_t body) const;  // needs no memory for the others
  double mean() const { return partners().mean(); }

 private:
  std::size_t bodies_;
  std::vector<std::int32_t> walls_;                           // a body once for each contact with one
  std::vector<std::pair<std::int32_t, std::int32_t>> pairs_;  // a pair once for each of its contacts
};

// Mean of n (x) n over contact normals, of the pairs of grains: trace 1, I/3 when no direction is preferred. Walls
// leave no mark, since their normals are the wall's.
class Fabric {
 public:
  void add(const ContactView& contact);
  std::size_t contacts() const { return contacts_; }
  Voigt tensor() const;  // I/3 without contacts [-]
  // sqrt(3/2 D:D) with D the tensor less I/3: 0 when no direction is preferred, 1 when all normals are parallel.
  double deviator() const;
  // sqrt(3/2 a_ij a_ij) of the second-order density of normals E(n) = (1 + a_ij n_i n_j) / (4 pi) (Rothenburg and
  // Bathurst, Geotechnique 39, 1989): a_ij = 15/2 D_ij, so 15/2 of the deviator.
  double anisotropy() const;

 private:
  std::size_t contacts_ = 0;
  Mat3 sum_ = Mat3::Zero();
};

}  // namespace lockstep::dem
