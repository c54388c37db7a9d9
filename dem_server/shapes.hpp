// The shapes that bodies have, each kept once: a body has its size and the number of its shape.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/vectors.hpp"
#include "dem_server/records.hpp"

namespace lockstep::dem {

// A rigid shape whose union of pebbles has the volume of the unit sphere, in its principal axes, about its centre of
// mass. clumps.hpp makes them.
struct ClumpTemplate {
  Vec3s pebble_center;                   // [R_eq]
  std::vector<double> pebble_radius;     // [R_eq]
  Vec3 inertia_per_mass = Vec3::Zero();  // principal moments / (m R_eq^2); 0.4 each for a sphere
  double bounding_radius = 1;            // [R_eq]
  bool is_sphere() const;
};

ClumpTemplate unit_sphere();

class ShapeTable {
 public:
  // The number of `shape`, which is taken in if it is not there: same pebbles and moments.
  std::int32_t number_of(const ClumpTemplate& shape);
  const ClumpTemplate& operator[](std::int32_t number) const { return shapes_[static_cast<std::size_t>(number)]; }
  std::size_t size() const { return shapes_.size(); }

  // For kernels.
  const ShapeRecord* records() const { return records_.data(); }
  const SphereRecord* pebbles() const { return pebbles_.data(); }
  bool are_rows() const { return are_rows_; }  // all pebbles stand on the first axis of their body

 private:
  std::vector<ClumpTemplate> shapes_;
  std::vector<ShapeRecord> records_;   // one a shape
  std::vector<SphereRecord> pebbles_;  // of all shapes, one after the other [R_eq]
  bool are_rows_ = true;
};

}  // namespace lockstep::dem
