// A block on a slope: two pebbles in a row, lying along the line of steepest descent. The plane stays horizontal and
// gravity tilts: g (sin theta, 0, -cos theta).
//
//      __  __             Each pebble touches the plane once, at (-+c, -h) from the centre of mass, with the same
//     /  \/  \            k_n and k_s. S = m g sin theta pulls down the slope, N = m g cos theta presses.
//    ( -c  +c ) --> x     Friction acts h below the centre of mass, so weight shifts to the front:
//     \__/\__/              N_rear = N/2 - S h/(2c),  N_front = N/2 + S h/(2c);
//   ====o===o=======      the block pitches forward by phi = (N_front - N_rear) / (2 c k_n) = S h / (2 c^2 k_n), and the
//                         contact points move by h phi less than the centre of mass.
#include <catch2/catch.hpp>
#include <cmath>

#include "dem_server/clumps.hpp"
#include "dem_server/integrator.hpp"
#include "dem_server/walls.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

constexpr double radius = 0.03;            // R_eq [m]
constexpr double friction = 0.3;           // mu
constexpr double standard_gravity = 9.81;  // [m/s2]
constexpr double settling_damping = 0.7;

struct Slope {
  Particles block;
  GrainMaterial material;
  Walls plane;
  MotionTotals motion;
  WallTotals contacts;
  Vec3 gravity;
  double dt = 0;                                                    // [s]
  double slip_work = 0, dashpot_work = 0;                           // up to t_n [J]
  Vec3 position = Vec3::Zero();                                     // of the centre of mass at t_n [m]
  double lever = 0, height = 0, normal_k = 0, shear_k = 0;          // c, h [m], k_n, k_s [N/m]
  double weight() const { return block.mass(0) * gravity.norm(); }  // [N]

  // Kinetic and elastic, at t_n [J].
  double energy() const { return motion.kinetic_energy() + contacts.elastic_energy; }

  // On the level ground, as deep in it as its weight asks for.
  Slope() : plane({{Vec3::Zero(), Vec3::UnitZ(), Vec3::Zero()}}, friction), gravity(0, 0, -standard_gravity) {
    material.damping_ratio = damping_ratio(0.5);
    block.add(row_of_pebbles({-1, 1}, {1, 1}), radius, 2650, Vec3::Zero(), Quat::Identity());
    normal_k = material.normal_stiffness(radius, radius);
    shear_k = normal_k / material.stiffness_ratio;
    const double overlap = weight() / (2 * normal_k);
    lever = block.pebble_offset(1).x();
    height = block.pebble_radius(0) - overlap / 2;  // contacts are in the middle of the overlap
    block.position(0).z() = block.pebble_radius(0) - overlap;
    block.place_pebbles();
    dt = 0.1 * std::sqrt(block.mass(0) / (2 * normal_k));
  }

  void step(double damping) {
    block.clear_forces();
    contacts = plane.compute(block, material, dt);
    slip_work += contacts.slip_work;
    dashpot_work += contacts.dashpot_work;
    position = block.position(0);
    motion = integrate(block, gravity, dt, dt, damping);
  }

  // Turns gravity smoothly to `theta` within half a second, hundreds of periods of the springs, and for as long lets the block come
  // to rest if it will.
  void tilt(double theta) {
    const int steps = static_cast<int>(0.5 / dt);
    for (int i = 0; i < 2 * steps; ++i) {
      const double s = std::min(1.0, static_cast<double>(i) / steps), now = theta * s * s * (3 - 2 * s);
      gravity = standard_gravity * Vec3(std::sin(now), 0, -std::cos(now));
      step(settling_damping);
    }
  }
};

}  // namespace

TEST_CASE("A block rests on a slope less steep than its friction, moved by its springs' give alone") {
  // Both contacts stick while S/2 < mu N_rear, that is tan theta < mu / (1 + mu h/c); then
  //   x = S / (2 k_s) + h phi.
  // Beyond, the rear one slides in its place at mu N_rear, the front one holds the rest until S = mu N:
  //   x = (S - mu N_rear) / k_s + h phi.
  // The stuck state has no memory; the rear contact, once it slides, remembers the little unrest that tilting makes
  // (4e-5 of x).
  for (double share : {0.5, 0.7, 0.9, 0.99}) {
    Slope slope;
    const double theta = std::atan(share * friction);
    slope.tilt(theta);
    const double pull = slope.weight() * std::sin(theta), press = slope.weight() * std::cos(theta);
    const double rear = press / 2 - pull * slope.height / (2 * slope.lever);
    const double pitch = pull * slope.height / (2 * slope.lever * slope.lever * slope.normal_k);
    const bool sticks = pull / 2 < friction * rear;
    const double expected = (sticks ? pull / 2 : pull - friction * rear) / slope.shear_k + slope.height * pitch;
    const double error = slope.block.position(0).x() / expected - 1;
    const double held = (slope.contacts.force - slope.block.mass(0) * slope.gravity).norm() / slope.weight();
    const double speed = slope.block.velocity(0).norm();
    INFO("tan theta / mu " << share << ": moved " << slope.block.position(0).x() << " m, expected " << expected
                           << " m, error " << error << "; speed " << speed
                           << " m/s, the slope bears its weight but for " << held << "; slip work " << slope.slip_work
                           << " J");
    REQUIRE(slope.contacts.contacts == 2);
    CHECK(sticks == (share < 0.75));
    CHECK(std::abs(error) < (sticks ? 1e-6 : 1e-3));
    CHECK(held < 1e-6);
    CHECK(speed < 1e-9);
    CHECK((slope.slip_work == 0) == sticks);
  }
}

TEST_CASE("A block slides down a steeper slope at g (sin theta - mu cos theta), its friction's work mu N a path") {
  // Once pressing is steady the cut spring is mu N_i in each contact at each step: the leap-frog's velocity grows by
  // a dt, slip takes mu N (x(n) - x(n-1)) out, and with kinetic energy m v(n-1/2) . v(n+1/2) / 2 the work of constant
  // forces is booked exactly. None of it has an error of the step's size, so the tolerance is round-off.
  for (double share : {1.01, 1.5, 3.0}) {
    Slope slope;
    const double theta = std::atan(share * friction);
    slope.tilt(theta);
    const int steps = 20000;  // a third of a second: to let the unrest of the tilting die away, and to measure
    for (int i = 0; i < steps; ++i) slope.step(0);
    const Slope before = slope;
    for (int i = 0; i < steps; ++i) slope.step(0);

    const double acceleration = (slope.block.velocity(0).x() - before.block.velocity(0).x()) / (steps * slope.dt);
    const double expected = standard_gravity * (std::sin(theta) - friction * std::cos(theta));
    const double error = acceleration / expected - 1;

    const double path = slope.position.x() - before.position.x();
    const double friction_work = friction * slope.weight() * std::cos(theta) * path;
    const double slip_work = slope.slip_work - before.slip_work;
    const double work_error = slip_work / friction_work - 1;

    const double fallen = slope.block.mass(0) * slope.gravity.dot(slope.position - before.position);
    const double lost = slip_work + slope.dashpot_work - before.dashpot_work;
    const double missing = (fallen - (slope.energy() - before.energy()) - lost) / fallen;
    INFO("tan theta / mu " << share << ": acceleration " << acceleration << " m/s2, expected " << expected << ", error "
                           << error << "; path " << path << " m, friction's work " << friction_work << " J, error "
                           << work_error << "; share of gravity's work missing " << missing);
    REQUIRE(slope.contacts.contacts == 2);
    CHECK(std::abs(error) < 1e-9);
    CHECK(std::abs(work_error) < 1e-9);
    CHECK(std::abs(missing) < 1e-9);
  }
}
