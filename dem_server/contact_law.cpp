#include "dem_server/contact_law.hpp"

#include "common/checks.hpp"

namespace lockstep::dem {

namespace {

// -ln e of a pair with a share `zeta` of critical damping: rises from 0 without bound, through 2 at zeta = 1.
double logarithmic_loss(double zeta) {
  if (zeta < 1) return 2 * zeta * std::acos(zeta) / std::sqrt((1 - zeta) * (1 + zeta));
  if (zeta > 1) return 2 * zeta * std::acosh(zeta) / std::sqrt((zeta - 1) * (zeta + 1));
  return 2;
}

}  // namespace

double damping_ratio(double restitution) {
  constexpr double least_restitution = 0.001;
  if (!(restitution >= least_restitution && restitution <= 1))
    throw InputError(
        fmt::format("grains.restitution = {}: must lie in [{}, 1]; 1 has no dashpot", restitution, least_restitution));
  if (restitution == 1) return 0;
  const double loss = -std::log(restitution);
  double low = 0, high = 100;  // loss(100) = 10.6 > -ln 0.001
  for (int halving = 0; halving < 80; ++halving) {
    const double middle = 0.5 * (low + high);
    (logarithmic_loss(middle) < loss ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

}  // namespace lockstep::dem
