// Isotropic linear elasticity, split into volume and shape as mixed discretization needs it. Tension positive.
#pragma once
#include <cmath>
#include <optional>

#include "common/vectors.hpp"
#include "continuum_client/yield_law.hpp"

namespace lockstep::continuum {

struct ElasticModuli {
  double shear = 0;  // G [Pa]
  double bulk = 0;   // K [Pa]

  // Of plane P-waves, M = K + 4 G / 3 [Pa].
  double constrained() const { return bulk + 4.0 / 3.0 * shear; }
};

struct Material {
  ElasticModuli moduli;
  double density = 0;                         // [kg/m3]
  std::optional<MohrCoulomb> yield_law = {};  // without: elastic whatever the stress
};

// G = E / (2 (1 + nu)), K = E / (3 (1 - 2 nu)). The paper's Table 2 lists the two with their names swapped.
inline ElasticModuli elastic_moduli(double youngs_modulus, double poisson_ratio) {
  return {youngs_modulus / (2 * (1 + poisson_ratio)), youngs_modulus / (3 * (1 - 2 * poisson_ratio))};
}

inline double p_wave_speed(const ElasticModuli& moduli, double density) {
  return std::sqrt(moduli.constrained() / density);
}
inline double s_wave_speed(const ElasticModuli& moduli, double density) { return std::sqrt(moduli.shear / density); }

// sigma = 2 G (e - tr(e) I / 3) + K theta I: the shape part from `strain`, the volume part from `dilatation` theta,
// which mixed discretization averages over more than the tetrahedron that `strain` belongs to. [Pa]
inline Mat3 elastic_stress(const ElasticModuli& moduli, const Mat3& strain, double dilatation) {
  const double isotropic = moduli.bulk * dilatation - 2.0 / 3.0 * moduli.shear * strain.trace();
  return 2 * moduli.shear * strain + isotropic * Mat3::Identity();
}

inline Voigt to_voigt(const Mat3& s) {
  Voigt v;
  v << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(2, 0);
  return v;
}

inline Mat3 from_voigt(const Voigt& v) {
  Mat3 s;
  s << v[0], v[3], v[5], v[3], v[1], v[4], v[5], v[4], v[2];
  return s;
}

}  // namespace lockstep::continuum
