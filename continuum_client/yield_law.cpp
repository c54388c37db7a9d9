#include "continuum_client/yield_law.hpp"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>

#include "continuum_client/elastic_law.hpp"

namespace lockstep::continuum {
namespace {

using PrincipalAxes = Eigen::SelfAdjointEigenSolver<Mat3>;  // values rise

// One of the planes, between the principal stresses `high` >= `low`, numbered as the solver does: 0 lowest, 2 highest.
struct YieldPlane {
  int high, low;

  double excess(const MohrCoulomb& law, const Vec3& s) const {
    return (1 + law.friction_sine) * s[high] - (1 - law.friction_sine) * s[low] - 2 * law.strength;
  }
  // dF/ds with the friction's sine, dG/ds with the dilation's.
  Vec3 normal(double sine) const {
    Vec3 n = Vec3::Zero();
    n[high] = 1 + sine, n[low] = -(1 - sine);
    return n;
  }
};

// D dG/dsigma of a plane.
Vec3 way_back(const YieldPlane& plane, const MohrCoulomb& law, const ElasticModuli& moduli) {
  const Vec3 flow = plane.normal(law.dilation_sine);
  return 2 * moduli.shear * flow + Vec3::Constant((moduli.bulk - 2.0 / 3 * moduli.shear) * flow.sum());
}

Vec3 onto_plane(const YieldPlane& plane, const MohrCoulomb& law, const ElasticModuli& moduli, const Vec3& trial) {
  const Vec3 way = way_back(plane, law, moduli);
  return trial - plane.excess(law, trial) / plane.normal(law.friction_sine).dot(way) * way;
}

// On both planes: excess(trial) = N_p . (lambda_a way_a + lambda_b way_b) for each plane p.
Vec3 onto_edge(const YieldPlane& a, const YieldPlane& b, const MohrCoulomb& law, const ElasticModuli& moduli,
               const Vec3& trial) {
  const Vec3 way_a = way_back(a, law, moduli), way_b = way_back(b, law, moduli);
  const Vec3 normal_a = a.normal(law.friction_sine), normal_b = b.normal(law.friction_sine);
  const double aa = normal_a.dot(way_a), ab = normal_a.dot(way_b), ba = normal_b.dot(way_a), bb = normal_b.dot(way_b);
  const double excess_a = a.excess(law, trial), excess_b = b.excess(law, trial), determinant = aa * bb - ab * ba;
  return trial - (excess_a * bb - excess_b * ab) / determinant * way_a -
         (excess_b * aa - excess_a * ba) / determinant * way_b;
}

Vec3 principal_yield(const MohrCoulomb& law, const ElasticModuli& moduli, const Vec3& trial) {
  constexpr YieldPlane main{2, 0}, lower{1, 0}, upper{2, 1};
  const Vec3 on_main = onto_plane(main, law, moduli, trial);
  if (on_main[2] >= on_main[1] && on_main[1] >= on_main[0]) return on_main;
  // Which of the main plane's two edges: seen along the way back, the trial stress lies on one side or the other.
  const double sine = law.dilation_sine;
  const bool is_upper = (1 - sine) * trial[2] - 2 * trial[1] + (1 + sine) * trial[0] > 0;
  const Vec3 on_edge = onto_edge(main, is_upper ? upper : lower, law, moduli, trial);
  if (is_upper ? on_edge[2] >= on_edge[1] : on_edge[1] >= on_edge[0]) return on_edge;
  return Vec3::Constant(law.apex);
}

}  // namespace

MohrCoulomb mohr_coulomb(double friction_angle, double dilation_angle, double cohesion) {
  const double infinite = std::numeric_limits<double>::infinity();
  return {std::sin(friction_angle), std::sin(dilation_angle), cohesion * std::cos(friction_angle),
          friction_angle > 0 ? cohesion / std::tan(friction_angle) : infinite};
}

double yield_excess(const MohrCoulomb& law, const Mat3& stress) {
  const PrincipalAxes axes(stress, Eigen::EigenvaluesOnly);
  return 0.5 * YieldPlane{2, 0}.excess(law, axes.eigenvalues());
}

Mat3 yielded_stress(const MohrCoulomb& law, const ElasticModuli& moduli, const Mat3& trial) {
  PrincipalAxes axes;
  axes.computeDirect(trial);
  const Vec3 principal = axes.eigenvalues();
  if (!(YieldPlane{2, 0}.excess(law, principal) > 0)) return trial;
  const Vec3 change = principal_yield(law, moduli, principal) - principal;
  return trial + axes.eigenvectors() * change.asDiagonal() * axes.eigenvectors().transpose();
}

}  // namespace lockstep::continuum
