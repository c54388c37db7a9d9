// Mohr-Coulomb: how much shear stress soil bears, and how its volume changes where it yields. Perfectly plastic.
//
// With principal stresses s1 >= s2 >= s3, tension positive, friction angle phi, cohesion c and dilation angle psi:
//   F = (1 + sin phi) s1 - (1 - sin phi) s3 - 2 c cos phi <= 0
//   G = (1 + sin psi) s1 - (1 - sin psi) s3,   plastic strain = lambda dG/dsigma
// Tension ends at the cone's apex, s = c / tan phi. A trial stress beyond F goes back along D dG/dsigma onto the plane; where
// two planes meet, onto their edge; beyond the edges, to the apex (de Souza Neto, Peric & Owen, Computational Methods for
// Plasticity, 2008, section 8.2.2).
#pragma once
#include "common/vectors.hpp"

namespace lockstep::continuum {

struct ElasticModuli;

struct MohrCoulomb {
  double friction_sine = 0;  // sin phi, 0 .. < 1 [-]
  double dilation_sine = 0;  // sin psi, 0 .. sin phi [-]
  double strength = 0;       // c cos phi: what pure shear without mean stress bears [Pa]
  double apex = 0;           // c / tan phi: largest mean stress, infinite without friction [Pa]
};
// Angles 0 .. < pi/2 [rad], c [Pa]. Friction and cohesion must not both be zero: nothing would be borne.
MohrCoulomb mohr_coulomb(double friction_angle, double dilation_angle, double cohesion);

// F over 2: how far the largest shear stress lies beyond what the soil bears; negative within [Pa].
double yield_excess(const MohrCoulomb& law, const Mat3& stress);

// The stress on the surface that the elastic trial stress goes back to; `trial` where it does not yield [Pa].
Mat3 yielded_stress(const MohrCoulomb& law, const ElasticModuli& moduli, const Mat3& trial);

}  // namespace lockstep::continuum
