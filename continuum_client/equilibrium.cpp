#include "continuum_client/equilibrium.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/checks.hpp"
#include "continuum_client/constants.hpp"
#include "continuum_client/integrator.hpp"
#include "continuum_client/timestep.hpp"

namespace lockstep::continuum {
namespace {

double dot(const Vec3s& a, const Vec3s& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i].dot(b[i]);
  return sum;
}

}  // namespace

SolveReport solve_static(const StiffnessMatrix& stiffness, const Vec3s& is_free, const Vec3s& force, Vec3s& u,
                         const ProgressCallback& progress) {
  const std::size_t count = is_free.size();
  u.assign(count, Vec3::Zero());
  // Diagonal blocks with held components replaced by one, so that they can be inverted.
  std::vector<Mat3> inverse(count);
  for (std::size_t i = 0; i < count; ++i) {
    Mat3 d = is_free[i].asDiagonal() * stiffness.diagonal(i) * is_free[i].asDiagonal();
    for (int c = 0; c < 3; ++c)
      if (is_free[i][c] == 0) d(c, c) = 1;
    inverse[i] = d.inverse();
  }
  StiffnessProduct product(stiffness);
  Vec3s r(count), z(count), p(count), kp(count);
  for (std::size_t i = 0; i < count; ++i) r[i] = force[i].cwiseProduct(is_free[i]);
  const double load = std::sqrt(dot(r, r));
  SolveReport report;
  if (!(load > 0)) return report;
  report.relative_residual = 1;
  double rounding = 0;  // of the products' sums, relative to the load
  const int patience = std::max(solver_patience, static_cast<int>(std::sqrt(static_cast<double>(count))));
  const int most = solver_iterations_per_node * static_cast<int>(count) + patience;

  // Rounds, each from the true residual of the last: the residual of the recurrence drifts from it, and directions lose
  // their conjugacy, on flat zones above all.
  while (report.iterations < most) {
    const double before = report.relative_residual;
    double rz = 0, gained = 0, best = std::numeric_limits<double>::infinity();
    for (int since_best = 0; since_best < patience && report.iterations < most; ++report.iterations) {
      for (std::size_t i = 0; i < count; ++i) z[i] = (inverse[i] * r[i]).cwiseProduct(is_free[i]);
      const double rz_new = dot(r, z), b = rz > 0 ? rz_new / rz : 0.0;
      rz = rz_new;
      for (std::size_t i = 0; i < count; ++i) p[i] = b > 0 ? Vec3(z[i] + b * p[i]) : z[i];
      product.evaluate(p, {}, kp);
      double pkp = 0;
      for (std::size_t i = 0; i < count; ++i) kp[i] = kp[i].cwiseProduct(is_free[i]), pkp += p[i].dot(kp[i]);
      if (!(pkp > 0)) break;
      const double a = rz / pkp;
      for (std::size_t i = 0; i < count; ++i) u[i] += a * p[i], r[i] -= a * kp[i];
      const double residual = std::sqrt(dot(r, r)) / load;
      if (residual < solver_tolerance) break;
      // The residual may rise for hundreds of iterations while the energy still falls.
      gained += a * rz;
      since_best = residual < best || a * rz > solver_least_gain * gained ? 0 : since_best + 1;
      best = std::min(best, residual);
      if (progress)
        progress(fmt::format("solving for the initial stress, residual {:.1e}", residual),
                 std::clamp(std::log(residual) / std::log(solver_tolerance), 0.0, 1.0));
    }
    product.evaluate(u, {}, kp);
    for (std::size_t i = 0; i < count; ++i) r[i] = (force[i] - kp[i]).cwiseProduct(is_free[i]);
    report.relative_residual = std::sqrt(dot(r, r)) / load;
    // Forces of slender zones cancel to a small rest: what rounding leaves of them is the best that can be had.
    double cancelled = 0;
    for (std::size_t i = 0; i < count; ++i)
      cancelled += (stiffness.diagonal(i).norm() * u[i]).cwiseProduct(is_free[i]).squaredNorm();
    rounding = std::numeric_limits<double>::epsilon() * std::sqrt(cancelled) / load;
    // Round-off allows no more once a round does not even halve it.
    if (report.relative_residual < solver_tolerance || !(report.relative_residual < 0.5 * before)) break;
  }
  if (!(report.relative_residual < std::max(solver_acceptance, solver_rounding * rounding)))
    throw NumericalError(
        fmt::format("the ground under gravity finds no equilibrium (residual {:.2e} of the load after {} iterations): "
                    "are the supports of continuum.initial_supports enough to carry it?",
                    report.relative_residual, report.iterations));
  return report;
}

EquilibriumReport reach_equilibrium(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                                    const Vec3s& is_free, const Vec3& gravity, const EquilibriumSettings& settings,
                                    Vec3s& displacement, const ProgressCallback& progress, const Vec3s& prescribed) {
  EquilibriumReport report;
  Vec3s weight(mass.size()), load(mass.size());
  double all = 0, left = 0;
  for (std::size_t i = 0; i < mass.size(); ++i) {
    load[i] = weight[i] = mass[i] * gravity;
    all += weight[i].squaredNorm();
    if (!prescribed.empty()) load[i] -= prescribed[i];
    left += load[i].cwiseProduct(is_free[i]).squaredNorm();
  }
  // What prescribed stresses leave of round-off is no load to solve for.
  displacement.assign(mass.size(), Vec3::Zero());
  if (settings.is_solved && left > solver_tolerance * solver_tolerance * all)
    report.solve = solve_static(stiffness, is_free, load, displacement, progress);
  const std::vector<double> inertia = settings.scales_density ? scaled_masses(stiffness, mass, is_free) : mass;
  report.time_step =
      settings.step_fraction * stable_step(frequency_squared_bound(stiffness, inertia, is_free), settings.damping);
  if (!std::isfinite(report.time_step)) return report;  // nothing can move

  const Vec3s solution = displacement;
  Integrator integrator(inertia, is_free);
  Motion motion{displacement, Vec3s(mass.size(), Vec3::Zero())};
  const Vec3s nothing(mass.size(), Vec3::Zero());
  NodalLoads loads;
  loads.reaction = weight;  // not of the integrator's masses, which may be scaled
  Vec3s internal(mass.size());
  StiffnessProduct product(stiffness);
  const double no_limit = std::numeric_limits<double>::max();
  const std::uint32_t fewest = settings.is_solved ? proof_cycles : 1;
  const double tolerance = settings.tolerance;
  do {
    product.evaluate(motion.displacement, prescribed, internal);
    const StepSums sums = integrator.advance(motion, internal, nothing, loads, settings.damping,
                                             {report.time_step, report.time_step}, no_limit);
    report.unbalanced_ratio = sums.unbalanced_ratio();
    ++report.cycles;
    if (progress) progress(fmt::format("cycling to equilibrium, ratio {:.1e}", report.unbalanced_ratio), 1.0);
  } while ((report.cycles < fewest || report.unbalanced_ratio > tolerance) && report.cycles < settings.max_cycles);
  if (!(report.unbalanced_ratio <= tolerance))
    throw NumericalError(fmt::format(
        "InitialStress: unbalanced ratio {:.3g} after {} cycles, above continuum.equilibrium_tolerance {:.3g}; "
        "raise continuum.equilibrium_max_cycles or lower fidelity.step_fraction",
        report.unbalanced_ratio, report.cycles, tolerance));
  double largest = 0, moved = 0;
  for (std::size_t i = 0; i < mass.size(); ++i) {
    largest = std::max(largest, solution[i].norm());
    moved = std::max(moved, (motion.displacement[i] - solution[i]).norm());
  }
  report.drift = largest > 0 ? moved / largest : 0;
  displacement = motion.displacement;
  return report;
}

}  // namespace lockstep::continuum
