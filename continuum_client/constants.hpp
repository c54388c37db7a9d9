// Numerical constants of the continuum client, each with its reason. What a user may want to turn is in the scene
// instead.
#pragma once
#include <cstddef>
#include <cstdint>

namespace lockstep::continuum {

// Lanczos products for the highest frequency of M^-1 K. The estimate rises towards the truth from below; 40 products
// leave far less than the margin on meshes of 50,000 nodes.
inline constexpr int frequency_products = 40;
// The estimate of omega_max is multiplied by this before it bounds the step.
inline constexpr double frequency_margin = 1.01;
// Of the start vector of that iteration: any vector that is not orthogonal to the highest mode will do, the same each
// time.
inline constexpr std::uint64_t frequency_seed = 20;

// The conjugate gradients that find the elastic state under gravity stop at this residual, relative to the load: low
// enough that what is left over on the opened boundary after Excavate is round-off.
inline constexpr double solver_tolerance = 1e-13;
// A residual that round-off keeps above solver_tolerance is accepted below this one.
inline constexpr double solver_acceptance = 1e-9;
// Or below this many times the rounding of one product per node: sums have some eighty of them.
inline constexpr double solver_rounding = 32;
// An iteration that lowers the energy by this share of what all have gained is progress too.
inline constexpr double solver_least_gain = 1e-12;
// Iterations without a lower residual or such a gain after which a round of conjugate gradients has given all it can (and at least the
// square root of the number of nodes).
inline constexpr int solver_patience = 200;
// Most iterations per degree of freedom's square root would do; this many per node is a sure sign of a broken mesh.
inline constexpr int solver_iterations_per_node = 4;
// Cycles after the solution that prove that explicit time stepping finds the same equilibrium and stays there.
inline constexpr std::uint32_t proof_cycles = 100;

// A grown node stiffness or a shrunken limit of the grains is logged again once the step has fallen by this share.
inline constexpr double logged_step_drop = 0.05;

// Largest over smallest zone size along one direction: beyond, a growth key was mistyped.
inline constexpr double largest_size_ratio = 1e4;
// Half side of the square core of the mesh inside the hole over the hole's radius: its corners then stand at 0.71 R,
// and zones of the core and of the ring around it are of like size.
inline constexpr double core_half_side = 0.5;
// Zones along a side of the core per ring of zones around it (and at least one ring): see core_half_side.
inline constexpr int core_zones_per_ring = 4;

// kappa of one-point zones (zone_kinematics.hpp).
inline constexpr double hourglass_share = 0.1;

// Zones whose corners agree to this share of their diagonal are translates of each other: round-off of their coordinates is
// some thousand times smaller in a model a thousand zones wide.
inline constexpr double congruence_tolerance = 1e-12;

// A layer's top that agrees with a level to this share of the ground's depth is that level.
inline constexpr double layer_tolerance = 1e-6;

// Limits of zones from files. Scaled Jacobian: at a corner the volume of the three edges' directions, 1 for right angles and 0
// for a flat corner; strains, and with them the stable step, go with its inverse. Knupp, SIAM J. Sci. Comput. 23 (2001);
// Verdict (Sandia report 2007-1751) calls 0.5 and more good. At 0.1 two edges meet at 6 or 174 degrees. Less than flat_corner
// is round-off of coordinates written with six digits.
inline constexpr double least_scaled_jacobian = 0.1;
inline constexpr double flat_corner = 1e-5;
// Between a corner's normal and the mean one of its face, as a cosine: at 60 degrees a face is nearer to a saddle than to the
// bilinear patch that grains roll on, and one of its two diagonals is a crease.
inline constexpr double least_face_cosine = 0.5;
// Nodes nearer than this share of the model's size are in one place; nodes nearer to a face than this share of the face lie on it.
inline constexpr double coincidence_tolerance = 1e-9;
inline constexpr double hanging_tolerance = 1e-6;
// Of a kind of fault in a mesh file so many are named, and the rest counted.
inline constexpr std::size_t named_faults = 5;
// The hole that a scene gives agrees with that of the mesh file to this share of its diameter.
inline constexpr double hole_tolerance = 1e-3;

// Positions that agree to this share of the model's size lie in one support plane.
inline constexpr double plane_tolerance = 1e-9;

// An initial stress beyond the yield surface by less than this share of itself is round-off of the solver that found it.
inline constexpr double yield_tolerance = 1e-6;

// Newton's iteration for the place of a point in a zone: it doubles its digits with each step, so that after one of this size
// nothing but round-off is left; a point that leads it so far from the cube -1 .. 1 is in another zone.
inline constexpr int most_newton_steps = 30;
inline constexpr double newton_tolerance = 1e-8;  // half sides
inline constexpr double newton_reach = 10;        // half sides

// Between lines of progress, and between looks at the clock in InitialStress.
inline constexpr double progress_seconds = 0.5;  // [s]

}  // namespace lockstep::continuum
