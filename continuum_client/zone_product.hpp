// f = reference + K u zone by zone, without an assembled K (zone_kernel.hpp).
#pragma once
#include <cstdint>
#include <vector>

#include "common/instructions.hpp"
#include "common/parallel.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/partial_forces.hpp"
#include "continuum_client/zone_blocks.hpp"
#include "continuum_client/zone_kernel.hpp"

namespace lockstep::continuum {

class ZoneProduct {
 public:
  ZoneProduct() = default;
  // Of the zones with is_included[z]; an empty list includes all. InternalError for a kind without kernel.
  ZoneProduct(const Grid& grid, const std::vector<char>& is_included,
              InstructionSet instructions = best_instructions());

  // One-point zones have: those of the other kinds cost more to make anew than the assembled operator to read.
  static bool has_kernel(ZoneKind kind);
  // Cycles of a product, roughly, as stiffness_product.cpp counts them for rows.
  static double cost(const Grid& grid, const std::vector<char>& is_included);

  // f[3 i ..] = reference[3 i ..] + (K u)_i for all nodes. `u` by component, eight entries more than nodes.
  void evaluate(const Components& u, const double* reference, double* f, Team& team = Team::alone());

  std::size_t bytes() const;  // that a product reads besides u

 private:
  StiffnessKernel node_kernel_{};
  ZoneKernel kernel_ = nullptr;
  ZoneBlocks blocks_;
  std::vector<double> moduli_;  // per block: eight shear, eight bulk [Pa]
  PartialForces partial_;
  NodeComponents x_;  // reference positions [m]
};

}  // namespace lockstep::continuum
