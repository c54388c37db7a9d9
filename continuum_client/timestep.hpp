// The largest stable time step of the explicit scheme.
//
// Leap-frog is stable for omega_max dt <= 2, omega_max^2 the largest eigenvalue of M^-1 K on the free components. Local
// damping adds alpha |F| against the motion; in the highest mode, which turns sign at each step, that makes the force
// (1 + alpha) F, so the limit shrinks:
//   dt = 2 / omega_max / sqrt(1 + alpha)
// Contacts at the interface add stiffness to nodes. With C the contacts' stiffness, ||C|| <= max(k_n, k_s), and
// bilinear weights w that sum to one, the block maximum norm of M^-1 C is at most max over nodes of 2 sum(k w) / m, and
// over grains of a like sum, which is the grains' own limit. So omega^2 <= omega_c^2 + max_nodes 2 sum(k w) / m.
#pragma once
#include <span>
#include <vector>

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

// max over nodes of 2 sum(k w) / m [1/s2]. `node` are the grid nodes of the interface, `node_stiffness` their sum(k w)
// [N/m]; nodes with no free component do not count.
double contact_frequency_squared(std::span<const std::int32_t> node, std::span<const double> node_stiffness,
                                 const std::vector<double>& mass, const Vec3s& is_free);

// 2 / sqrt(omega^2) / sqrt(1 + damping); infinite for omega^2 = 0 [s]. With stiffness-proportional damping b [s], whose
// force at n is made of the velocity at n-1/2, the highest mode's v+ = v- - dt (omega^2 u + b omega^2 v-) is stable up to
//   dt = 2 / omega (sqrt(1 + xi^2) - xi),  xi = b omega / 2,
// where the roots of z^2 - (2 - omega^2 dt^2 - b omega^2 dt) z + 1 - b omega^2 dt reach z = -1:
// omega^2 dt^2 + 2 b omega^2 dt = 4.
double stable_step(double frequency_squared, double damping, double stiffness_damping = 0);

}  // namespace lockstep::continuum
