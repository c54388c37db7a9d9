// Internal nodal forces from stresses that are stored and updated, for what the assembled operator cannot hold: large strain,
// and laws whose stress depends on the way it was reached.
//
// Per step and strain point (zone_kinematics.hpp), from du = v(n-1/2) dt:
//   small strain    de = sym(sum_a du_a (x) g_a) with the reference shape; sigma <- law(sigma, de, dtheta)
//   large strain    gradients g of the shape half way, x(n) - du/2: de = sym(grad du), w = skw(grad du). The stress is
//                   turned half way by Q = (1 - w/4)^-1 (1 + w/4), meets the law there, and is turned by Q again (after
//                   Hughes & Winget, Int. J. Numer. Methods Eng. 15, 1980): second order in the step. A rigid rotation
//                   gives de = 0; forces act on the shape at n
//   f_a = sum V sigma g_a, and the hourglass forces of one-point zones, which are stored and turned likewise.
// The law sees the volume's change of its group, dtheta, beside the strain increment of its point.
//
// `work` is the sum of (f(n-1) + f(n)) . du / 2: what the zones have taken up. For an elastic law it is their energy, to
// round-off at small strain and to second order in dt at large; the ledger closes either way.
//
// For linear scenes this gives the numbers of f0 + K u to round-off, at some forty times the cost (README.md). Local damping
// turns with the sign of a velocity and makes more of that round-off: runs with it agree to 1e-4.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "common/parallel.hpp"
#include "common/vectors.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/initial_stress.hpp"

namespace lockstep::continuum {

// The stress at the end of an increment: `stress` is that at its start, turned with the material; `strain` and
// `dilatation` (of the group) are increments [Pa], [-].
using ConstitutiveLaw = Mat3 (*)(const ElasticModuli& moduli, const Mat3& stress, const Mat3& strain,
                                 double dilatation);

// sigma + 2 G de' + K dtheta I.
Mat3 linear_elastic(const ElasticModuli& moduli, const Mat3& stress, const Mat3& strain, double dilatation);

class IncrementalForce {
 public:
  // Zones with is_included[z] (empty: all), in the state `initial`, whose displacements are taken as small.
  IncrementalForce(const Grid& grid, const std::vector<char>& is_included, const InitialState& initial,
                   bool has_large_strain, ConstitutiveLaw law = linear_elastic);

  // Takes the state from n-1 to n: displacements u(n), velocities v(n-1/2), the step between them, and fills f(n).
  // NumericalError naming a zone that has turned inside out.
  void advance(const Vec3s& displacement, const Vec3s& velocity, double time_step, Vec3s& force,
               Team& team = Team::alone());

  // Adds strain up beside the stress, from zero now on and turned as the stress is: 720 bytes a zone.
  void keep_strain();

  Mat3 zone_stress(std::size_t z) const;  // mean of its points [Pa]
  Mat3 zone_strain(std::size_t z) const;  // mean of its points, after keep_strain() [-]
  double work() const { return work_; }   // [J]
  std::size_t bytes() const;              // what a step walks of it

 private:
  using PointTensors = std::array<Mat3, ZoneGeometry::most_points>;
  struct ZoneState {
    PointTensors stress;                                 // per point [Pa]
    std::array<Vec3, ZoneGeometry::patterns> hourglass;  // C q [N]
  };
  // A corner of a zone, by node: forces are gathered in this order whatever the threads do.
  struct Corner {
    std::int32_t zone, corner;
  };

  Mat3 mean(std::size_t z, const PointTensors& values) const;
  ZoneGeometry shape(std::size_t k, const Vec3s& displacement, const Vec3s* increment, double share) const;
  void deform(ZoneState& state, const ZoneGeometry& geometry, const ElasticModuli& moduli, const ZoneVectors& increment,
              bool turns, PointTensors* total_strain) const;
  ZoneVectors force_of(const ZoneState& state, const ZoneGeometry& geometry) const;
  void gather_forces(Vec3s& force, Team& team) const;

  const Grid& grid_;
  bool has_large_strain_ = false;
  ConstitutiveLaw law_;
  std::vector<std::int32_t> zone_;  // included ones
  std::vector<std::int32_t> representative_;
  std::vector<std::int32_t> place_;  // per grid zone: where it is in zone_, or -1
  std::vector<ZoneState> state_;
  std::vector<PointTensors> strain_;  // per included zone and point; empty: not kept [-]
  std::vector<ZoneVectors> zone_force_;
  std::vector<std::size_t> corner_begin_;  // per node and one more
  std::vector<Corner> corner_;
  Vec3s last_force_;
  double work_ = 0;
};

}  // namespace lockstep::continuum
