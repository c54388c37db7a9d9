#include "tools/interface_waves.hpp"

#include <Eigen/Dense>
#include <cmath>

#include "common/vectors.hpp"

namespace lockstep {

namespace {

using Complex = std::complex<double>;

double squared_sine(double x) { return std::sin(x) * std::sin(x); }

// exp(i s) for cos s = c of the wave that leaves the interface: fading where |c| > 1; else with s of the sign that gives
// the group velocity that sign, sin s > 0 where W rises with s.
Complex leaving(double c, bool rises) {
  if (std::abs(c) > 1) return c - std::copysign(std::sqrt(c * c - 1), c);
  return {c, std::copysign(std::sqrt(1 - c * c), rises ? 1.0 : -1.0)};
}

}  // namespace

double InterfaceModel::frequency_squared(Side side, double wave_number) const {
  if (side == Side::Grains)
    return 4 / mass *
           (spring * squared_sine(0.5 * wave_number * pitch) +
            side_spring * squared_sine(0.5 * wave_number_across * pitch));
  return 2 / row_mass * (layer_own + layer_next * std::cos(wave_number * height));
}

double InterfaceModel::group_velocity(Side side, double wave_number) const {
  const double frequency = std::sqrt(frequency_squared(side, wave_number));  // 2 W dW/ds = d(W^2)/ds
  if (side == Side::Grains) return spring * pitch * std::sin(wave_number * pitch) / (mass * frequency);
  return -layer_next * height * std::sin(wave_number * height) / (row_mass * frequency);
}

EnergyShares energy_shares(const InterfaceModel& m, Side from, double wave_number) {
  const int n = m.columns;
  const double squared = m.frequency_squared(from, wave_number);  // W^2
  const double phase = m.wave_number_across * m.pitch * n;        // p h
  std::vector<Complex> up(n);                                     // exp(i s d) of the grains' waves
  std::vector<double> across(n);                                  // their q d
  for (int k = 0; k < n; ++k) {
    across[k] = (phase + 2 * pi * k) / n;
    up[k] = leaving(1 - (m.mass * squared - 4 * m.side_spring * squared_sine(0.5 * across[k])) / (2 * m.spring), true);
  }
  const Complex down = leaving((m.row_mass * squared - 2 * m.layer_own) / (2 * m.layer_next), m.layer_next < 0);

  // Unknowns: amplitudes of the n waves that leave upwards, then that of the one that leaves downwards.
  Eigen::MatrixXcd matrix = Eigen::MatrixXcd::Zero(n + 1, n + 1);
  Eigen::VectorXcd incident = Eigen::VectorXcd::Zero(n + 1);
  double weights = 0;
  for (int i = 0; i < n; ++i) {
    const double e = (i + 0.5) / n;
    const Complex s = 1 - e + e * std::polar(1.0, phase);
    weights += std::norm(s);
    for (int k = 0; k < n; ++k) {
      const Complex shape = std::polar(1.0, across[k] * (i + 0.5));
      matrix(i, k) = shape * (m.spring * (1.0 / up[k] - 1.0) + m.contact);
      matrix(n, k) -= m.contact * std::conj(s) * shape;
    }
    matrix(i, n) = -m.contact * s;
    if (from == Side::Zones) {
      incident[i] = m.contact * s;
    } else {
      const Complex shape = std::polar(1.0, across[0] * (i + 0.5));
      incident[i] = -shape * (m.spring * (up[0] - 1.0) + m.contact);
      incident[n] += m.contact * std::conj(s) * shape;
    }
  }
  const Complex node = -0.5 * m.row_mass * squared + m.layer_own + m.contact * weights;
  matrix(n, n) = node + m.layer_next * down;
  if (from == Side::Zones) incident[n] = -(node + m.layer_next * std::conj(down));
  const Eigen::VectorXcd out = matrix.fullPivLu().solve(incident);

  double flux_up = 0;
  for (int k = 0; k < n; ++k)
    if (std::abs(std::abs(up[k]) - 1) < 1e-12) flux_up += n * m.spring * up[k].imag() * std::norm(out[k]);
  const double flux_down = std::abs(std::abs(down) - 1) < 1e-12 ? -m.layer_next * down.imag() * std::norm(out[n]) : 0.0;
  if (from == Side::Grains) {
    const double in = n * m.spring * up[0].imag();
    return {flux_up / in, flux_down / in};
  }
  const double in = -m.layer_next * down.imag();
  return {flux_down / in, flux_up / in};
}

EnergyShares energy_shares(const InterfaceModel& m, Side from, const std::vector<double>& velocity) {
  const double spacing = from == Side::Grains ? m.pitch : m.height;
  // Steps of the wave number that resolve the spectrum of something so long twice over.
  const int steps = 4 * static_cast<int>(velocity.size());
  EnergyShares sum;
  double energy = 0;
  for (int k = 0; k < steps; ++k) {
    const double turn = pi * (k + 0.5) / steps;  // wave number times spacing
    const Complex rotation = std::polar(1.0, -turn);
    Complex amplitude = 0, factor = 1;
    for (const double v : velocity) amplitude += v * factor, factor *= rotation;
    const double share = std::norm(amplitude);
    const EnergyShares one = energy_shares(m, from, turn / spacing);
    sum.reflected += share * one.reflected;
    sum.transmitted += share * one.transmitted;
    energy += share;
  }
  return {sum.reflected / energy, sum.transmitted / energy};
}

}  // namespace lockstep
