// The whole model under gravity, brought to equilibrium (paper step 1).
//
// The state sought solves K u = m g. It is found by conjugate gradients and then handed to the explicit cycle, which
// has to agree that it is in equilibrium. Cycling alone from rest, as the paper's code does, creeps there in as many
// periods of the whole brick as local damping needs (thousands of steps for each digit of the unbalanced ratio, minutes
// for 20,000 zones); it would end in the same state, since the material has no memory.
#pragma once
#include <cstdint>
#include <functional>
#include <string>

#include "common/vectors.hpp"
#include "continuum_client/internal_force.hpp"

namespace lockstep::continuum {

// Called now and then with a text and a fraction of the whole.
using ProgressCallback = std::function<void(const std::string& text, double fraction)>;

struct SolveReport {
  int iterations = 0;
  double relative_residual = 0;  // |f - K u| / |f| over free components [-]
};

// Solves K u = f on the free components, u = 0 on the others. Conjugate gradients with the inverse diagonal blocks as
// preconditioner; works for bricks that may drift sideways too, as long as nothing pushes them. NumericalError if it
// stalls.
SolveReport solve_static(const StiffnessMatrix& stiffness, const Vec3s& is_free, const Vec3s& force,
                         Vec3s& displacement, const ProgressCallback& progress);

struct EquilibriumSettings {
  double damping = 0.7;     // local [-]
  double tolerance = 1e-6;  // unbalanced ratio [-]
  std::uint32_t max_cycles = 200000;
  double step_fraction = 0.9;   // of the stable step [-]
  bool is_solved = true;        // by conjugate gradients first; cycles from rest otherwise
  bool scales_density = false;  // cycles with scaled_masses() (timestep.hpp)
};

struct EquilibriumReport {
  SolveReport solve;
  std::uint32_t cycles = 0;
  double unbalanced_ratio = 0;  // after the cycles [-]
  double drift = 0;             // largest displacement of a node since the solution over the largest displacement [-]
  double time_step = 0;         // [s]
};

// Fills `displacement` with the equilibrium under the acceleration `gravity` [m/s2], beside the internal forces
// `prescribed` of stresses that are there from the start (empty: none). Cycles until the unbalanced ratio is below the
// tolerance, after a solution at least constants' proof_cycles; NumericalError after max_cycles.
EquilibriumReport reach_equilibrium(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                                    const Vec3s& is_free, const Vec3& gravity, const EquilibriumSettings& settings,
                                    Vec3s& displacement, const ProgressCallback& progress,
                                    const Vec3s& prescribed = {});

}  // namespace lockstep::continuum
