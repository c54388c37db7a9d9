// Waves at the interface of grains and zones: the exact discrete answer by itself, and the coupled program against it.
#include <catch2/catch.hpp>
#include <cmath>

#include "tests/coupled/coupled_fixture.hpp"
#include "tools/reflection_case.hpp"

namespace lockstep::coupled {

namespace {

// Amplitude of a matched wave from the grains, or of one with another ratio of impedances.
double amplitude(const ReflectionCase& c) { return std::sqrt(exact_reflection(c).at_center.reflected); }

void check_case(const ReflectionCase& c) {
  spdlog::set_level(spdlog::level::warn);
  const ReflectionResult r = measure_reflection(c);
  const double measured = std::sqrt(std::max(0.0, r.measured.reflected)), exact = std::sqrt(r.exact.reflected);
  const double off_transmitted = std::sqrt(r.measured.transmitted) - std::sqrt(r.exact.transmitted);
  CAPTURE(c.grains_per_zone, c.zones_per_wave, c.impedance_ratio, r.angle, measured, exact, measured - exact,
          off_transmitted, r.created, r.steps, r.grains, r.zones, r.seconds);
  CHECK(std::abs(measured - exact) < 0.005);
  CHECK(std::abs(off_transmitted) < 0.005);
  CHECK(std::abs(r.created) < 1e-3);
}

}  // namespace

TEST_CASE("the exact answer at an interface loses no energy") {
  // Nothing damps: what comes in is reflected or passed on, for any wave, size of zones, angle and impedance.
  double worst = 0;
  for (const WaveKind kind : {WaveKind::Pressure, WaveKind::Shear, WaveKind::Oblique})
    for (const Side from : {Side::Grains, Side::Zones})
      for (const int size : {1, 2, 3})
        for (const double ratio : {0.25, 1.0, 4.0})
          for (const double wave : {4.0, 6.0, 20.0, 100.0}) {
            const ReflectionResult r = exact_reflection({.kind = kind,
                                                         .from = from,
                                                         .grains_per_zone = size,
                                                         .zones_per_wave = wave,
                                                         .impedance_ratio = ratio,
                                                         .angle = pi / 4});
            worst = std::max(worst, std::abs(r.at_center.reflected + r.at_center.transmitted - 1));
          }
  CAPTURE(worst);
  CHECK(worst < 1e-12);
}

TEST_CASE("the exact answer has the limits of a continuum and of equal lattices") {
  // Long waves see impedances alone, |R| = |Z - 1| / (Z + 1).
  for (const double z : {0.25, 0.5, 0.8, 2.0, 4.0}) {
    const double r = amplitude({.zones_per_wave = 1000, .impedance_ratio = z});
    CAPTURE(z, r, r - std::abs(z - 1) / (z + 1));
    CHECK(std::abs(r - std::abs(z - 1) / (z + 1)) < 1e-4);
  }
  // Zones of the grains' size, mass and stiffness go on as the lattice does, but for the interface: in place of a spring
  // k between two masses stand half a mass, a spring 2 k and half a pitch. Its static defect: none; so |R| falls as the
  // square of d/lambda, 4 times for twice the wave.
  const double once = amplitude({.zones_per_wave = 100}), twice = amplitude({.zones_per_wave = 200});
  CAPTURE(once, twice, once / twice);
  CHECK(once / twice == Approx(4).epsilon(0.02));
  // Waves that zones cannot carry, sin(pi d / lambda) > d / h, come back whole: 3 zones of 3 grains, sin 20 deg = 0.342.
  CHECK(amplitude({.grains_per_zone = 3, .zones_per_wave = 3}) == Approx(1).epsilon(1e-12));
}

TEST_CASE("the exact answer is that of two equations solved by hand") {
  // One column, p = 0. Grains u_j = exp(-i s j d) + R exp(i s j d), zones w_l = T exp(i r l h), k_c = 2 k. Row 0 of the
  // grains, -m W^2 u_0 = k (u_1 - u_0) + k_c (w_0 - u_0), is linear in R and T, and so is -M/2 W^2 w_0 = K (w_1 - w_0) +
  // k_c (u_0 - w_0); K the stiffness of a zone. Solved by Cramer's rule, with u_1 written out instead of the
  // continuation to u_-1 that interface_waves.cpp uses.
  using Complex = std::complex<double>;
  double worst = 0;
  for (const int size : {1, 2, 3})
    for (const double wave : {4.0, 6.0, 10.0, 40.0}) {
      const ReflectionCase c{.grains_per_zone = size, .zones_per_wave = wave, .impedance_ratio = 0.7};
      const InterfaceModel m = interface_model(c);
      const double sd = 2 * pi / (wave * size), k = m.spring, kc = 2 * k, stiffness = m.layer_own;
      const double squared = 4 * k / m.mass * std::sin(sd / 2) * std::sin(sd / 2);
      const double rh = 2 * std::asin(std::sqrt(m.row_mass * squared / (4 * stiffness)));
      const Complex up = std::polar(1.0, sd), down = std::polar(1.0, rh);
      const Complex a11 = -m.mass * squared - k * (up - 1.0) + kc, a12 = -kc;
      const Complex a21 = -kc, a22 = -0.5 * m.row_mass * squared - stiffness * (down - 1.0) + kc;
      const Complex b1 = m.mass * squared + k * (std::conj(up) - 1.0) - kc, b2 = kc;
      const Complex r = (b1 * a22 - a12 * b2) / (a11 * a22 - a12 * a21);
      worst = std::max(worst, std::abs(std::norm(r) - exact_reflection(c).at_center.reflected));
    }
  CAPTURE(worst);
  CHECK(worst < 1e-12);
}

TEST_CASE("a packet of pressure comes back from the interface as the discrete equations say") {
  for (const Side from : {Side::Grains, Side::Zones})
    for (const int size : {1, 3})
      for (const double wave : {6.0, 10.0, 20.0}) {
        CAPTURE(from == Side::Grains);
        check_case({.from = from, .grains_per_zone = size, .zones_per_wave = wave});
      }
}

TEST_CASE("a hump comes back from the interface as the discrete equations say") {
  for (const Side from : {Side::Grains, Side::Zones}) {
    CAPTURE(from == Side::Grains);
    check_case({.from = from, .grains_per_zone = 2, .zones_per_wave = 12, .is_hump = true});
  }
}

TEST_CASE("unequal impedances reflect as the discrete equations say") {
  for (const double ratio : {0.25, 4.0}) check_case({.zones_per_wave = 10, .impedance_ratio = ratio});
}

TEST_CASE("a packet of shear comes back from the interface as the discrete equations say") {
  for (const Side from : {Side::Grains, Side::Zones}) {
    CAPTURE(from == Side::Grains);
    check_case({.kind = WaveKind::Shear, .from = from, .grains_per_zone = 2, .zones_per_wave = 10});
  }
}

TEST_CASE("an oblique packet comes back from the interface as the discrete equations say") {
  for (const Side from : {Side::Grains, Side::Zones}) {
    CAPTURE(from == Side::Grains);
    check_case({.kind = WaveKind::Oblique, .from = from, .grains_per_zone = 2, .zones_per_wave = 6, .angle = pi / 4});
  }
}

}  // namespace lockstep::coupled
