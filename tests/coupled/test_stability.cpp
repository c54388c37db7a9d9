// The coupled step at its limit: the assembled step of a short bar against the two programs, and points of the stability map.
#include <catch2/catch.hpp>
#include <cmath>

#include "tests/coupled/coupled_fixture.hpp"
#include "tools/stability_case.hpp"

namespace lockstep::coupled {
namespace {

struct Quiet {
  Quiet() { spdlog::set_level(spdlog::level::off); }
  ~Quiet() { spdlog::set_level(spdlog::level::warn); }
};

Point measured(const BarCase& c, double asked, bool is_of_exact) {
  const Quiet quiet;
  const CoupledBar bar(c);
  Point p;
  p.asked = asked, p.is_of_exact = is_of_exact;
  measure_bar(p, bar, predicted_limit(bar));
  return p;
}

}  // namespace

TEST_CASE("both programs move a short bar as its assembled step does") {
  // What the assembled step leaves out is the preload's geometric stiffness, which is in proportion to the overlap d: a facet
  // that tilts by u / h moves its contact by R u / h, and with it the preload k d from node to node. So a tenth of the preload
  // leaves a tenth of the difference; it adds up in phases, at 40 steps to some hundred times R d k / (h^2 E) of u.
  const Quiet quiet;
  for (const bool has_weight : {false, true})
    for (const std::uint32_t interval : {1U, 5U})
      for (const double contrast : {0.1, 10.0}) {
        double difference[2] = {};
        for (const bool is_small : {false, true}) {
          const CoupledBar bar({.contrast = contrast,
                                .damping = interval > 1 ? 0.3 : 0.0,
                                .exchange_interval = interval,
                                .preload = is_small ? 1e-6 : 1e-5,
                                .has_weight = has_weight});
          const double step = 0.9 * predicted_limit(bar);
          constexpr std::uint64_t steps = 40;
          const Ending e = run_to_end(bar.scene(0.9, (steps - 0.5) * step));
          REQUIRE(!e.is_stopped);
          CHECK(e.reports.zones.steps + 1 >= steps);
          const CoupledBar::State s = bar.state_after(step, e.reports.zones.steps);
          const double own = s.q.head(bar.nodes()).cwiseAbs().maxCoeff();
          difference[is_small] = std::abs(e.reports.zones.largest_displacement / own - 1);
        }
        INFO("contrast " << contrast << ", interval " << interval << (has_weight ? ", weight" : ", packet")
                         << ": off by " << difference[0] << ", with a tenth of the preload " << difference[1]);
        // Damping turns with the sign of velocities: those about zero fall either way, whatever the preload.
        CHECK(difference[1] < (interval > 1 ? 1e-4 : 3e-5));
        if (interval == 1) CHECK(difference[1] < 0.2 * difference[0] + 1e-6);
      }
}

TEST_CASE("the exact limit of the bar is where its assembled step begins to grow") {
  for (const double contrast : {1e-2, 1.0, 1e2}) {
    const CoupledBar bar({.contrast = contrast});
    const CoupledBar::Growth below = bar.growth(0.99 * bar.exact_limit(), 2000);
    const CoupledBar::Growth above = bar.growth(1.01 * bar.exact_limit(), 2000);
    const double radius = bar.spectral_radius(1.01 * bar.exact_limit());
    INFO("contrast " << contrast << ": growth " << below.rate << " below, " << above.rate
                     << " above, where the spectral radius is " << radius);
    CHECK(!below.grows);
    CHECK(above.grows);
    CHECK(above.rate == Approx(radius).epsilon(0.05));
  }
}

TEST_CASE("the predicted limit is never above the exact one, whatever the contrast of stiffness and mass") {
  const Quiet quiet;
  double least = 1e300, most = 0;
  for (const int columns : {1, 3})
    for (int stiffness = -4; stiffness <= 4; stiffness += 2)
      for (int mass = -4; mass <= 4; ++mass) {
        const CoupledBar bar(
            {.contrast = std::pow(10, stiffness), .mass_ratio = std::pow(10, mass), .columns = columns, .spheres = 2});
        const double ratio = bar.exact_limit() / predicted_limit(bar);
        CAPTURE(columns, stiffness, mass, ratio);
        CHECK(ratio >= 1 - 1e-9);
        least = std::min(least, ratio), most = std::max(most, ratio);
      }
  INFO("exact over predicted limit from " << least << " to " << most);
  CHECK(least < 1.01);  // it is met where one side rules
}

TEST_CASE("points of the stability map: stable within the limit, caught beyond it") {
  for (const auto& [contrast, mass_ratio] : {std::pair(1.0, 1e2), {1e2, 1e-2}, {1e4, 1.0}, {1e-2, 1.0}}) {
    const Point within = measured({.contrast = contrast, .mass_ratio = mass_ratio}, 1, false);
    const Point beyond = measured({.contrast = contrast, .mass_ratio = mass_ratio}, 1.05, true);
    const Point damped = measured({.contrast = contrast, .mass_ratio = mass_ratio, .damping = 0.5}, 1.1, true);
    INFO("contrast " << contrast << ", mass ratio " << mass_ratio << ": " << within.words << "; " << beyond.words
                     << "; " << damped.words);
    CHECK(within.verdict() == Class::StableAsPredicted);
    CHECK(beyond.verdict() == Class::Caught);
    CHECK(damped.verdict() == Class::Caught);
  }
}

}  // namespace lockstep::coupled
