// The motion of a stretch of nodes over one step, eight at a time (integrator.hpp has the equations). Compiled once for
// each instruction set, with the same bits.
#pragma once
#include <cstdint>

namespace lockstep::continuum {

// Three doubles a node where nothing else is said.
struct NodeArrays {
  double* displacement;     // at n, then at n+1
  double* velocity;         // at n-1/2, then at n+1/2
  const double* internal;   // f_int(n)
  const double* reference;  // f0
  const double* mobility;   // 1/m of free components, 0 of held ones
  const double* mass;       // one a node
  const double* applied;    // forces of the interface; null: none
  const double* reaction;   // of released supports; null: none
  const double* viscous;    // forces that count as damping; null: none
  const double* dashpot;    // c; null: none
};

struct NodeStep {
  double gravity[3];
  double damping;                      // alpha
  double velocity_step, into, out_of;  // [s]
  double square_limit;                 // of speeds [m2/s2]
};

struct NodeSums {
  double unbalanced = 0, internal = 0;           // [N]
  double elastic = 0, kinetic = 0;               // [J]
  double jolt = 0;                               // sum of m |v(n+1/2) - v(n-1/2)|^2
  double gravity_before = 0, gravity_after = 0;  // power with the velocity before and after [W]
  double reaction_before = 0, reaction_after = 0;
  double damped_before = 0, damped_after = 0;
  double runaways = 0;  // not zero if a node is faster than the limit or not finite
};

// Nodes begin .. end, a multiple of eight of them. `sums` is overwritten.
using NodeKernel = void (*)(const NodeArrays&, const NodeStep&, std::int64_t begin, std::int64_t end, NodeSums& sums);

NodeKernel node_kernel_generic();
NodeKernel node_kernel_avx2();
NodeKernel node_kernel_avx512();

}  // namespace lockstep::continuum
