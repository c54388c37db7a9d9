#include "dem_server/clumps.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

namespace {

// Squared radius of the union's cross-section at x: the largest of the pebbles' r^2 - (x - c)^2, or zero.
double squared_profile(const std::vector<double>& center, const std::vector<double>& radius, double x) {
  double largest = 0;
  for (std::size_t p = 0; p < center.size(); ++p)
    largest = std::max(largest, radius[p] * radius[p] - (x - center[p]) * (x - center[p]));
  return largest;
}

}  // namespace

ClumpTemplate row_of_pebbles(const std::vector<double>& center, const std::vector<double>& radius) {
  LOCKSTEP_ASSERT(!center.empty() && center.size() == radius.size(), "a row needs a radius per pebble");
  // Between two neighbouring marks (ends of pebbles, and where the spheres of two pebbles cross) the profile belongs to
  // one pebble, so y^2 is a quadratic and every integrand below a polynomial of degree 4 at most: three Gauss points
  // are exact.
  std::vector<double> mark;
  for (std::size_t p = 0; p < center.size(); ++p) {
    mark.push_back(center[p] - radius[p]);
    mark.push_back(center[p] + radius[p]);
    for (std::size_t q = 0; q < p; ++q)
      if (center[p] != center[q])
        mark.push_back(0.5 * (center[p] + center[q]) +
                       0.5 * (radius[p] * radius[p] - radius[q] * radius[q]) / (center[q] - center[p]));
  }
  std::sort(mark.begin(), mark.end());

  const std::array<double, 3> gauss_point = {-std::sqrt(0.6), 0, std::sqrt(0.6)};
  const std::array<double, 3> gauss_weight = {5.0 / 9, 8.0 / 9, 5.0 / 9};
  double volume = 0, axial = 0, lateral = 0;  // V, integrals of the moments about x and about y
  for (std::size_t k = 0; k + 1 < mark.size(); ++k) {
    const double half = 0.5 * (mark[k + 1] - mark[k]), middle = 0.5 * (mark[k + 1] + mark[k]);
    for (int g = 0; g < 3; ++g) {
      const double x = middle + half * gauss_point[g], w = half * gauss_weight[g];
      const double y2 = squared_profile(center, radius, x);
      volume += w * pi * y2;                                   // disc of radius y
      axial += w * 0.5 * pi * y2 * y2;                         // its polar moment
      lateral += w * (0.25 * pi * y2 * y2 + pi * y2 * x * x);  // its diametral moment, moved to x = 0
    }
  }

  const double scale = std::cbrt(4.0 / 3.0 * pi / volume);
  ClumpTemplate shape;
  shape.bounding_radius = 0;
  for (std::size_t p = 0; p < center.size(); ++p) {
    shape.pebble_center.emplace_back(scale * center[p], 0, 0);
    shape.pebble_radius.push_back(scale * radius[p]);
    shape.bounding_radius = std::max(shape.bounding_radius, scale * (std::abs(center[p]) + radius[p]));
  }
  const double lateral_per_mass = scale * scale * lateral / volume;
  shape.inertia_per_mass = Vec3(scale * scale * axial / volume, lateral_per_mass, lateral_per_mass);
  return shape;
}

ClumpTemplate make_clump(int pebbles, double elongation) {
  if (pebbles < 1 || pebbles > most_pebbles)
    throw InputError(fmt::format("grains.pebbles = {}: must lie in [1, {}]", pebbles, most_pebbles));
  if (!(elongation >= 1 && elongation <= 2))
    throw InputError(fmt::format("grains.elongation = {}: must lie in [1, 2]", elongation));
  if (pebbles == 1 || elongation == 1) return unit_sphere();
  // Half axes A = elongation, B = 1.
  if (pebbles == 2) return row_of_pebbles({1 - elongation, elongation - 1}, {1, 1});
  const double outermost = elongation - 1 / elongation;  // A - B^2/A
  std::vector<double> center, radius;
  for (int p = 0; p < pebbles; ++p) {
    const double c = outermost * (2.0 * p / (pebbles - 1) - 1);
    center.push_back(c);
    // Distance from (c, 0) to the ellipse: (B^2 - r^2) / B^2 = c^2 / (A^2 - B^2) while the foot lies on the flank.
    radius.push_back(std::sqrt(1 - c * c / (elongation * elongation - 1)));
  }
  return row_of_pebbles(center, radius);
}

}  // namespace lockstep::dem
