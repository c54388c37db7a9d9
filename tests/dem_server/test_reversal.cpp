// The share of accelerations that turn, for oscillators whose answer is known: a mode of leap-frog with omega dt turns its
// acceleration by the angle theta a step, cos theta = 1 - (omega dt)^2 / 2, so that the share is -cos theta in the mean
// over phases.
#include <catch2/catch.hpp>
#include <cmath>
#include <vector>

#include "dem_server/reversal.hpp"
#include "tests/dem_server/free_grains.hpp"

namespace lockstep::dem {
namespace {

// Many spheres on springs of their own to where they rest, in random phases: leap-frog of x'' = -omega^2 x - damping.
Reversal seen(double omega_dt, double damping, int steps, double start = 1e-3) {
  Particles p;
  constexpr int count = 400;
  const ClumpTemplate sphere = make_clump(1, 1);
  for (int b = 0; b < count; ++b) p.add(sphere, 0.03, 2650, Vec3(b, 0, 0), Quat::Identity());
  Vec3s x(count);
  const double theta = std::acos(std::max(-1.0, 1 - 0.5 * omega_dt * omega_dt));
  for (int b = 0; b < count; ++b) {
    const double phase = 2 * pi * b / count;
    x[b] = start * Vec3(std::cos(phase), 0, 0);
    p.velocity(b) =
        start * Vec3(std::cos(phase) - std::cos(phase - theta), 0, 0);  // x(n) - x(n-1) of the exact solution
  }
  Reversal reversal;
  for (int n = 1; n <= steps; ++n) {
    for (int b = 0; b < count; ++b) {
      double force = -omega_dt * omega_dt * x[b].x();
      force -= damping * std::abs(force) * (p.velocity(b).x() > 0 ? 1 : -1);
      p.velocity(b).x() += force;
      x[b].x() += p.velocity(b).x();
    }
    reversal.observe(static_cast<std::uint64_t>(n), p);
  }
  return reversal;
}

}  // namespace

TEST_CASE("The share of turned accelerations is (omega dt)^2 / 2 - 1 for a mode of omega") {
  for (const double omega_dt : {0.01, 0.5, 1.0, 1.5, 1.9}) {
    const double share = seen(omega_dt, 0, 100).mean_share(), expected = 0.5 * omega_dt * omega_dt - 1;
    INFO("omega dt " << omega_dt << ": " << share << ", expected " << expected);
    CHECK(share == Approx(expected).margin(1e-9));
  }
}

TEST_CASE("A damped step above its limit is told within 100 steps, a damped one below it never is") {
  // With alpha the limit of omega dt is 2 / sqrt(1 + alpha).
  for (const double alpha : {0.1, 0.3, 0.7}) {
    const double limit = 2 / std::sqrt(1 + alpha);
    const Reversal above = seen(1.02 * limit, alpha, 100), below = seen(0.7 * limit, alpha, 400);
    INFO("alpha " << alpha << ": " << above.mean_share() << " above, " << below.mean_share() << " below");
    CHECK(above.is_alarming());
    CHECK(!below.is_alarming());
  }
}

TEST_CASE("A damped mode just below its limit turns, but dies out: no alarm") {
  for (const double alpha : {0.1, 0.3, 0.7}) {
    const double limit = 2 / std::sqrt(1 + alpha);
    double share = -1;
    bool is_alarming = false;
    for (int steps = 100; steps <= 300; steps += 25) {
      const Reversal below = seen(0.97 * limit, alpha, steps);
      share = std::max(share, below.mean_share()), is_alarming |= below.is_alarming();
    }
    INFO("alpha " << alpha << ": largest share " << share);
    CHECK(share > Reversal::alarming_reversal);
    CHECK(!is_alarming);
  }
}

TEST_CASE("Nothing is said of no grains, of grains at rest, or before there were enough looks") {
  Reversal reversal;
  for (std::uint64_t n = 1; n <= 200; ++n) reversal.observe(n, Particles());
  CHECK(!reversal.is_alarming());
  CHECK(!seen(1.99, 0, 99).is_alarming());
  CHECK(!seen(1.99, 0, 200, 0.0).is_alarming());
  CHECK(seen(1.99, 0, 100).is_alarming());
}

}  // namespace lockstep::dem
