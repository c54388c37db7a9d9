// The highest frequency of the zones, omega_max^2 the largest eigenvalue of M^-1 K on the free components, from which
// common/coupled_limit.hpp makes the stable step.
#pragma once
#include <vector>

#include "common/coupled_limit.hpp"
#include "common/vectors.hpp"
#include "continuum_client/internal_force.hpp"

namespace lockstep::continuum {

// Largest eigenvalue of M^-1 K on the components that are free, by Lanczos from a fixed start vector: an estimate from
// below, within a part in a thousand for meshes of engineering [1/s2]. Zero if nothing is free.
double lanczos_frequency_squared(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                                 const Vec3s& is_free, int products);

// Its rigorous bound from above: max over nodes of sum_j ||K_ij|| / m_i, spectral norms of blocks, held components
// taken out (block Gershgorin) [1/s2].
double gershgorin_frequency_squared(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                                    const Vec3s& is_free);

// Masses for motion that does not count, only the rest that it ends in: each node as light as the bound above lets it be
// for the step of the most critical node, m_i = sum_j ||K_ij|| / omega^2 with omega^2 that of the real masses. Stiff or
// small zones set the real step for all; with these masses every node uses it, and waves cross large zones in as few steps
// as small ones. Nodes that nothing stiffens keep theirs [kg].
std::vector<double> scaled_masses(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                                  const Vec3s& is_free);

// What the client uses: Lanczos with a margin, or Gershgorin where that is lower [1/s2].
double frequency_squared_bound(const StiffnessMatrix& stiffness, const std::vector<double>& mass, const Vec3s& is_free);

}  // namespace lockstep::continuum
