#include "continuum_client/timestep.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "continuum_client/constants.hpp"

namespace lockstep::continuum {

double lanczos_frequency_squared(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                                 const Vec3s& is_free, int products) {
  // On q = M^(1/2) u the operator A = M^(-1/2) K M^(-1/2) is symmetric and has the same eigenvalues. Lanczos'
  // three-term recurrence A q_j = beta_j q_(j-1) + alpha_j q_j + beta_(j+1) q_(j+1) gives a tridiagonal matrix whose
  // largest eigenvalue rises to that of A.
  const std::size_t count = mass.size();
  Vec3s scale(count, Vec3::Zero()), q(count), last(count, Vec3::Zero()), u(count), w(count);
  StiffnessProduct product(stiffness);
  Random random(frequency_seed);
  for (std::size_t i = 0; i < count; ++i) {
    if (mass[i] > 0) scale[i] = is_free[i] / std::sqrt(mass[i]);
    for (int c = 0; c < 3; ++c) q[i][c] = is_free[i][c] * random.uniform(-1, 1);
  }
  const auto norm = [](const Vec3s& v) {
    double sum = 0;
    for (const Vec3& x : v) sum += x.squaredNorm();
    return std::sqrt(sum);
  };
  double length = norm(q);
  if (!(length > 0)) return 0;
  std::vector<double> alpha, beta;
  for (int p = 0; p < products; ++p) {
    for (std::size_t i = 0; i < count; ++i) q[i] /= length, u[i] = scale[i].cwiseProduct(q[i]);
    product.evaluate(u, {}, w);
    double a = 0;
    for (std::size_t i = 0; i < count; ++i) w[i] = scale[i].cwiseProduct(w[i]), a += q[i].dot(w[i]);
    const double b = beta.empty() ? 0.0 : beta.back();
    for (std::size_t i = 0; i < count; ++i) {
      w[i] -= a * q[i] + b * last[i];
      last[i] = q[i];
      q[i] = w[i];
    }
    alpha.push_back(a);
    length = norm(q);
    // The start vector's space is used up: the eigenvalues are exact.
    if (!(length > std::numeric_limits<double>::epsilon() * std::abs(a))) break;
    beta.push_back(length);
  }
  beta.resize(alpha.size() - 1);
  // The solver's test for a zero off-diagonal is made for entries near 1: with others it does not converge, and its
  // eigenvalues are in no order.
  const double largest = *std::max_element(alpha.begin(), alpha.end());
  if (!(largest > 0)) return 0;
  const double unit = std::ldexp(1.0, std::ilogb(largest));  // a power of two, which rounds nothing
  const auto n = static_cast<Eigen::Index>(alpha.size());
  const Eigen::VectorXd diagonal = Eigen::Map<const Eigen::VectorXd>(alpha.data(), n) / unit;
  const Eigen::VectorXd beside = Eigen::Map<const Eigen::VectorXd>(beta.data(), n - 1) / unit;
  Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver;
  solver.computeFromTridiagonal(diagonal, beside, Eigen::EigenvaluesOnly);
  LOCKSTEP_ASSERT(solver.info() == Eigen::Success, "the eigenvalues of {} products of Lanczos' were not found", n);
  return unit * solver.eigenvalues().maxCoeff();
}

namespace {

// sum_j ||K_ij|| per node [N/m].
std::vector<double> row_norms(const StiffnessMatrix& stiffness, const Vec3s& is_free) {
  const std::size_t count = stiffness.node_count();
  std::vector<double> row(count, 0.0);
  for (std::size_t i = 0; i < count; ++i)
    for (std::int64_t k = stiffness.row_begin[i]; k < stiffness.row_begin[i + 1]; ++k) {
      const std::int32_t j = stiffness.column[k];
      const Mat3 b = is_free[i].asDiagonal() * stiffness.block[k] * is_free[j].asDiagonal();
      const Mat3 square = b.transpose() * b;
      const double norm = std::sqrt(
          std::max(0.0, Eigen::SelfAdjointEigenSolver<Mat3>(square, Eigen::EigenvaluesOnly).eigenvalues()[2]));
      row[i] += norm;
      if (j != static_cast<std::int32_t>(i)) row[j] += norm;
    }
  return row;
}

double largest_ratio(const std::vector<double>& row, const std::vector<double>& mass) {
  double largest = 0;
  for (std::size_t i = 0; i < mass.size(); ++i)
    if (mass[i] > 0) largest = std::max(largest, row[i] / mass[i]);
  return largest;
}

}  // namespace

double gershgorin_frequency_squared(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                                    const Vec3s& is_free) {
  return largest_ratio(row_norms(stiffness, is_free), mass);
}

std::vector<double> scaled_masses(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                                  const Vec3s& is_free) {
  const std::vector<double> row = row_norms(stiffness, is_free);
  const double frequency_squared = largest_ratio(row, mass);
  std::vector<double> scaled = mass;
  for (std::size_t i = 0; i < mass.size(); ++i)
    if (mass[i] > 0 && row[i] > 0) scaled[i] = row[i] / frequency_squared;
  return scaled;
}

double frequency_squared_bound(const StiffnessMatrix& stiffness, const std::vector<double>& mass,
                               const Vec3s& is_free) {
  const double estimate = lanczos_frequency_squared(stiffness, mass, is_free, frequency_products);
  return std::min(estimate * frequency_margin * frequency_margin,
                  gershgorin_frequency_squared(stiffness, mass, is_free));
}

}  // namespace lockstep::continuum
