// Stage Balance without a session: what ends it, and what it comes to where the answer is known.
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>

#include "common/checks.hpp"
#include "common/log.hpp"
#include "dem_server/balance.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/make_model.hpp"
#include "dem_server/watch.hpp"

namespace lockstep::dem {
namespace {

using Catch::Contains;

// One sphere of 30 mm, `height` above a floor, as stage Balance finds it.
struct SphereOnFloor {
  Settings settings;
  Assembly assembly;
  HandedOver ground;
  std::unique_ptr<Model> model;

  explicit SphereOnFloor(double height, const std::string& balance = "") {
    spdlog::set_level(spdlog::level::off);
    settings = make_settings(parse_scene(
        fmt::format("gravity: 9.81 grains {{ density: 2650 contact_modulus: 94e6 "
                    "grain {{ center {{ z: {} }} radius: 0.03 }} }} wall {{ plane {{ normal {{ z: 1 }} }} }} "
                    "run {{ duration: 0.1 }} balance {{ {} }}",
                    0.03 + height, balance),
        "a scene"));
    assembly = assemble(settings, 0, [](std::string_view, double) {});
    model = make_model(settings, assembly, ground, 1);
  }
  ~SphereOnFloor() { spdlog::set_level(spdlog::level::warn); }
};

double weight_of_sphere() { return 2650 * 4.0 / 3.0 * pi * std::pow(0.03, 3) * 9.81; }

// A packing that rests by a wide margin.
RestFigures resting() {
  RestFigures f;
  f.unbalanced_ratio = 1e-6;
  f.is_servo_active = true;
  return f;
}

std::string complaint_of(const Watch& watch, const Model& model) {
  try {
    watch.look(model);
  } catch (const NumericalError& error) {
    return error.what();
  }
  return "no complaint";
}

}  // namespace

TEST_CASE("The bottom's mismatch is its error over the share of the load and 0.5 kPa") {
  // 12 kN carried, of 8 + 2.5 kN: 1.5 kN too much. 2 % of 10.5 kN and 500 Pa x 2 m2 are 210 + 1000 N.
  const BottomBalance b{12e3, 8e3, 2.5e3, 2.0};
  CHECK(b.error() == Approx(1500));
  CHECK(b.mismatch(0.02) == Approx(1500.0 / 1210.0));
  CHECK(BottomBalance{10.5e3, 8e3, 2.5e3, 2.0}.mismatch(0.02) == 0);
}

TEST_CASE("A packing rests when every one of its figures says so") {
  BalanceSettings settings;
  settings.tolerance = 1e-3, settings.servo_tolerance = 1e-4, settings.traction_tolerance = 0.02;
  CHECK(is_at_rest(resting(), settings));
  const auto broken = [&](auto&& change) {
    RestFigures f = resting();
    change(f);
    return f;
  };
  const RestFigures moving = broken([](RestFigures& f) { f.unbalanced_ratio = 1.1e-3; });
  const RestFigures pressed = broken([](RestFigures& f) { f.wall_error = 0.021; });
  const RestFigures by_servo[] = {
      broken([](RestFigures& f) { f.is_servo_active = false; }), broken([](RestFigures& f) { f.servo_speed = 1.1e-4; }),
      broken([](RestFigures& f) { f.ring_mismatch = 1.1; }), broken([](RestFigures& f) { f.bottom_mismatch = 1.1; })};
  CHECK(!is_at_rest(moving, settings));
  CHECK(!is_at_rest(pressed, settings));
  for (const RestFigures& f : by_servo) CHECK(!is_at_rest(f, settings));
  settings.servo = false;  // then nobody asks for what the servo does
  CHECK(!is_at_rest(moving, settings));
  CHECK(!is_at_rest(pressed, settings));
  for (const RestFigures& f : by_servo) CHECK(is_at_rest(f, settings));
}

TEST_CASE("A sphere at rest is balanced at the first look after the cycles that gravity gets") {
  // It lies where k_n U = m g, so that nothing is let go and nothing falls: a single cycle of relaxing, and then the looks at
  // cycles 0, 50, ... up to the first beyond settle_cycles, 1,050. The floor carries the weight to the tolerance of the balance.
  const double weight = weight_of_sphere();
  const double overlap = weight / (94e6 * 2 * 0.03);
  SphereOnFloor s(-overlap, "tolerance: 1e-6");
  s.settings.balance.servo = true;  // it has nothing to move, but the bottom is compared with the weight
  int looks = 0;
  double last = 0;
  BalanceCalls calls;
  calls.look = [&](double, double fraction) { ++looks, last = fraction; };
  const BalanceFigures figures = balance_packing(*s.model, s.assembly, s.settings, s.ground, calls);
  const std::uint64_t first_look = (settle_cycles / heartbeat_interval + 1) * heartbeat_interval;
  CAPTURE(overlap, figures.cycles, looks, figures.unbalanced_ratio, figures.bottom_force, weight);
  CHECK(figures.cycles == 1 + first_look + 1);
  CHECK(looks == static_cast<int>(first_look / heartbeat_interval) + 1);
  CHECK(last == 1.0);
  CHECK(figures.unbalanced_ratio < 1e-6);
  CHECK(figures.weight == Approx(weight).epsilon(1e-12));
  CHECK(figures.bottom_force == Approx(weight).epsilon(2e-6));
  CHECK(figures.tip_force == 0);
}

TEST_CASE("A packing that still falls when its cycles are over is refused") {
  SphereOnFloor s(1.0, "max_cycles: 100");
  CHECK_THROWS_WITH(balance_packing(*s.model, s.assembly, s.settings, s.ground),
                    Contains("balance.max_cycles = 100") && Contains("still falls"));
}

TEST_CASE("What is watched is told with its reason; overlaps only once the packing is made") {
  SphereOnFloor s(0.001);
  Model& m = *s.model;
  const Watch watch(m, s.settings, true);
  CHECK(complaint_of(watch, m) == "no complaint");
  // 0.031 m from the origin; alone it may fly for 0.1 s besides: 0.031 + 0.5 x 9.81 x 0.01 = 0.080 m, of which three.
  m.particles.position(0).z() = 0.24;
  CHECK(complaint_of(watch, m) == "no complaint");
  m.particles.position(0).z() = 0.25;
  CHECK_THAT(complaint_of(watch, m), Contains("grain 0 has left the scene"));
  m.particles.position(0).z() = 0.031;
  m.pair_totals.largest_overlap_ratio = 0.91;
  CHECK_THAT(complaint_of(watch, m), Contains("an overlap of 0.91 R is no contact any more"));
  CHECK_NOTHROW(watch.look_at_packing(m));
  m.motion.translation_energy = std::numeric_limits<double>::infinity();
  CHECK_THAT(complaint_of(watch, m), Contains("kinetic energy is not finite"));
}

TEST_CASE("A watched run goes back to a sound state that is old enough") {
  // Free fall by leap-frog, whose first step adds g dt to no velocity: z(n) = z0 - g dt^2 (1 + 2 + ... + n).
  SphereOnFloor s(100.0);
  Model& m = *s.model;
  Watch watch(m, s.settings, true);
  const double dt = 1e-4, z0 = 100.03;
  Held held(dt);
  m.damping = 0;
  m.last_time_step = dt;
  for (int n = 1; n <= 550; ++n) {
    cycle(m, held);
    if (n == 400 || n == 500) watch.keep_good_state(m);
  }
  watch.return_to_good_state(m);  // failed at 550: the state of 500 is too young
  CHECK(m.step == 400);
  CHECK(m.time == Approx(400 * dt));
  CHECK(std::as_const(m.particles).position(0).z() == Approx(z0 - 9.81 * dt * dt * 400 * 401 / 2).epsilon(1e-12));
}

}  // namespace lockstep::dem
