// Internal nodal forces of elastic ground, f_int = f0 + K u, with K assembled once.
//
// Zones are linear and small strain, so what they exert on nodes is a fixed linear map, assembled into 3 x 3 blocks, upper
// half only. How it is multiplied, and what was rejected: stiffness_product.hpp.
//
// f0 is the internal force of the reference state: after InitialStress the displacements u0 that gravity caused are
// taken into f0 = K u0 and u starts again from zero. Deleting zones assembles K and f0 again from the ones that are
// left, which leaves no trace of the others (subtracting them would leave their round-off).
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/vectors.hpp"
#include "continuum_client/elastic_law.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/stiffness_product.hpp"

namespace lockstep::continuum {

// Symmetric, 3 x 3 blocks, rows of nodes. Row i holds its diagonal block first and then those with column > i, rising;
// nodes without zones have no blocks. The lower half is the transpose.
struct StiffnessMatrix {
  std::vector<std::int64_t> row_begin = {0};  // per node and one more
  std::vector<std::int32_t> column;           // per block
  std::vector<Mat3> block;                    // [N/m]

  std::size_t node_count() const { return row_begin.size() - 1; }

  // f = K u, one fixed order of summation. Both of length node_count().
  void multiply(const Vec3s& u, Vec3s& f) const;
  // Diagonal block of a node; zero if it has no zones.
  Mat3 diagonal(std::size_t node) const;
};

// From the zones with is_included[z]; an empty list includes all.
StiffnessMatrix assemble_stiffness(const Grid& grid, const std::vector<char>& is_included = {});

// Lumped nodal masses of the same zones [kg].
std::vector<double> lumped_masses(const Grid& grid, const std::vector<char>& is_included = {});

// f = f0 + K u.
class InternalForce {
 public:
  InternalForce() = default;
  explicit InternalForce(const StiffnessMatrix& stiffness, InstructionSet instructions = best_instructions());
  explicit InternalForce(StiffnessProduct product);

  Vec3s reference;  // f0 per node, zero at first [N]

  void evaluate(const Vec3s& u, Vec3s& f, Team& team = Team::alone()) { product_.evaluate(u, reference, f, team); }
  const StiffnessProduct& product() const { return product_; }

 private:
  StiffnessProduct product_;
};

}  // namespace lockstep::continuum
