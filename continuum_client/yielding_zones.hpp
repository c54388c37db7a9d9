// Zones that yield, beside the assembled operator: f = f0 + K u + sum over zones of the integral of B^T p.
//
// A zone yields by its mean stress sigma = sigma0 + D e + p, e the mean strain since the reference state. Where the law says
// that it lies beyond the yield surface (yield_law.hpp) it goes back there, and p = -D e_plastic keeps the difference. What the
// zone's strain has beside its mean (bending, hourglass patterns) stays elastic, as the assembled K has it: one-point
// integration of the plastic part, with elastic stabilization. Zones that never yield add nothing, and scenes without such
// materials have none of this.
//
// K bounds the stable step as before: plastic strain only softens.
//
// Energies. Elastic is (e - e_p) : D (e - e_p) / 2 + sigma0 : (e - e_p) instead of the same with e, so in sum
//   E = u . (f0 + K u / 2) + sum V (p : e + p : D^-1 p / 2 + sigma0 : D^-1 p).
// Of the zones' work (f(n-1) + f(n)) . du / 2 a step dissipates V de_p : (sigma(n-1) + sigma(n)) / 2, and E takes the rest, to
// round-off (write out both with p = -D e_p): the ledger of integrator.hpp goes on closing.
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/instructions.hpp"
#include "common/parallel.hpp"
#include "common/vectors.hpp"
#include "continuum_client/elastic_law.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/initial_stress.hpp"
#include "continuum_client/partial_forces.hpp"
#include "continuum_client/yield_kernel.hpp"
#include "continuum_client/zone_blocks.hpp"

namespace lockstep::continuum {

struct YieldingMaterial {
  MohrCoulomb law;
  ElasticModuli moduli;
};

class YieldingZones {
 public:
  // Of the zones with is_included[z] (empty: all) whose material yields, from the state `initial` on.
  YieldingZones(const Grid& grid, const std::vector<char>& is_included, const InitialState& initial,
                InstructionSet instructions = best_instructions());

  // From the state of n-1 to that of n: displacements u(n); adds to f(n) = f0 + K u(n), which then is the internal force.
  void advance(const Vec3s& displacement, Vec3s& force, Team& team = Team::alone());

  // Stress less the elastic law's, -D times the plastic strain; zero for zones that do not yield [Pa].
  Mat3 plastic_stress(std::size_t z) const;
  Mat3 plastic_strain(std::size_t z) const;                 // [-]
  double energy() const { return sums_.energy; }            // E less u . (f0 + f) / 2 [J]
  double dissipated() const { return dissipated_; }         // since the reference state [J]
  std::int64_t yielding() const { return sums_.yielding; }  // zones, in the last step
  std::int64_t yielded() const;                             // zones, ever
  std::size_t zone_count() const;                           // that may yield

 private:
  StiffnessKernel node_kernel_{};
  YieldKernel kernel_ = nullptr;
  ZoneBlocks blocks_;
  std::vector<YieldBlock> states_;
  std::vector<YieldingMaterial> materials_;  // of the grid, those that do not yield among them
  std::vector<std::int64_t> place_;          // per zone of the grid: 8 times block plus lane, or -1
  PartialForces partial_;
  NodeComponents x_, u_;
  std::vector<YieldSums> part_sums_;  // per range
  YieldSums sums_;
  double dissipated_ = 0;
};

// Throws InputError with `where` and the remedy if a zone's initial stress lies beyond what it bears.
void check_initial_yield(const Grid& grid, const std::vector<char>& is_included, const InitialState& initial,
                         const std::string& where);

}  // namespace lockstep::continuum
