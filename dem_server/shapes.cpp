#include "dem_server/shapes.hpp"

#include <algorithm>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

namespace {

bool is_same(const ClumpTemplate& a, const ClumpTemplate& b) {
  return a.inertia_per_mass == b.inertia_per_mass && a.pebble_radius == b.pebble_radius &&
         a.pebble_center == b.pebble_center;
}

}  // namespace

bool ClumpTemplate::is_sphere() const {
  return pebble_center.size() == 1 && pebble_center[0].isZero(0) && inertia_per_mass == Vec3::Constant(sphere_inertia);
}

ClumpTemplate unit_sphere() { return {{Vec3::Zero()}, {1.0}, Vec3::Constant(sphere_inertia), 1.0}; }

std::int32_t ShapeTable::number_of(const ClumpTemplate& shape) {
  for (std::size_t k = shapes_.size(); k-- > 0;)  // the last first: crowds are made one shape after the other
    if (is_same(shape, shapes_[k])) return static_cast<std::int32_t>(k);
  LOCKSTEP_ASSERT(!shape.pebble_center.empty() && shape.pebble_center.size() == shape.pebble_radius.size(),
                  "{} centres and {} radii of pebbles", shape.pebble_center.size(), shape.pebble_radius.size());
  LOCKSTEP_ASSERT(shape.inertia_per_mass.minCoeff() > 0, "a shape without inertia");
  const Vec3& i = shape.inertia_per_mass;
  ShapeRecord record = {i.x(), i.y(), i.z(), shape.is_sphere() ? 0.0 : 1.0, 1 / i.x(), 1 / i.y(), 1 / i.z(), 0, 0, 0};
  record.first_pebble = static_cast<std::int32_t>(pebbles_.size());
  record.pebbles = static_cast<std::int32_t>(shape.pebble_center.size());
  for (std::size_t p = 0; p < shape.pebble_center.size(); ++p) {
    const Vec3& center = shape.pebble_center[p];
    pebbles_.push_back({center.x(), center.y(), center.z(), shape.pebble_radius[p]});
    record.farthest_square = std::max(record.farthest_square, center.squaredNorm());
    are_rows_ = are_rows_ && center.y() == 0 && center.z() == 0;
  }
  records_.push_back(record);
  shapes_.push_back(shape);
  return static_cast<std::int32_t>(shapes_.size()) - 1;
}

}  // namespace lockstep::dem
