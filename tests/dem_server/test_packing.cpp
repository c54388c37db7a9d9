// Packings cut to their container, and the keys of a scene that a balanced packing depends on.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>

#include "common/checks.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/packing.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

const std::string scene_text = R"(
  continuum { cylinder_in_brick { hole_depth: 2 depth: 4 } }
  grains { packing { count: 900 porosity: 0.43 cube_grains: 150 } }
  pile { embedment: 0.8 penetration: 0.1 }
  wall { plane { point { z: -5 } normal { z: 1 } } velocity { x: 1 } friction: 0.2 })";

Settings settings_of(const std::vector<std::string>& overrides = {}) {
  return make_settings(parse_scene(scene_text, "packing", overrides));
}

}  // namespace

TEST_CASE("a cut packing has its count, its place and the weight of the ground it replaces") {
  const Settings settings = settings_of();
  const Assembly a = assemble(settings, 1630, [](std::string_view, double) {});
  const Particles& p = a.particles;
  const Container& c = settings.packing->container;
  const double room = c.volume() - pi * 0.125 * 0.125 * 0.8;  // container less the embedded pile [m3]
  const double weight_error = p.total_mass() / (1630 * room) - 1;
  CAPTURE(p.body_count(), weight_error, a.cube_porosity);
  CHECK(std::abs(static_cast<double>(p.body_count()) - 900) <= 9);
  CHECK(std::abs(weight_error) < 1e-12);
  for (std::size_t b = 0; b < p.body_count(); ++b) {
    const Vec3 x = p.position(b);
    CHECK(c.depth_inside(x) > 0.4 * p.equivalent_radius(b));
    CHECK(x.z() <= c.top);
    CHECK((std::hypot(x.x(), x.y()) > 0.125 || x.z() < -0.8));
  }
}

TEST_CASE("threads are taken where they have something to do") {
  CHECK(worthwhile_threads(1000, 8) == 1);
  CHECK(worthwhile_threads(26700, 2) == 2);
  CHECK(worthwhile_threads(26700, 16) == 6);
  CHECK(worthwhile_threads(200000, 16) == 16);
  CHECK(worthwhile_threads(0, 1) == 1);
}

TEST_CASE("what stage Balance depends on is among the packing's keys, and what comes later is not") {
  const SceneKeys keys = settings_of().packing_keys;
  for (const char* change : {"seed=2",
                             "gravity=5",
                             "grains.density=2600",
                             "grains.contact_modulus=5e7",
                             "grains.stiffness_ratio=4",
                             "grains.friction=0.5",
                             "grains.restitution=0.9",
                             "grains.facet_stiffness_factor=3",
                             "grains.pebbles=2",
                             "grains.elongation=1.4",
                             "grains.packing.count=800",
                             "grains.packing.radius_ratio=1.5",
                             "grains.packing.porosity=0.42",
                             "grains.packing.bulk_density=AS_PACKED",
                             "grains.packing.cube_grains=200",
                             "grains.packing.cube_pressure=6e4",
                             "pile.diameter=0.2",
                             "pile.embedment=0.9",
                             "pile.tip=CONE",
                             "wall[0].plane.point.z=-6",
                             "balance.servo=NONE",
                             "balance.damping=0.6",
                             "balance.tolerance=2e-3",
                             "balance.max_servo_travel=0.1",
                             "balance.max_cycles=100",
                             "fidelity.pebbles_per_clump=2",
                             "fidelity.particle_scale=1.1"}) {
    CAPTURE(change);
    CHECK(settings_of({change}).packing_keys != keys);
  }
  for (const char* change :
       {"title=\"x\"", "pile.penetration=0.2", "pile.friction=0.5", "pile.speed_ramp=0.02",
        "grains.interface_friction=0.5", "grains.wall_friction=0.5", "wall[0].velocity.x=2", "wall[0].friction=0.3",
        "wall[0].spin.x=1", "apply.damping=0.5", "run.damping=0.1", "fidelity.step_fraction=0.5",
        "fidelity.pile_velocity=0.3", "output.history_interval=7", "coupling.hash_interval=5"}) {
    CAPTURE(change);
    CHECK(settings_of({change}).packing_keys == keys);
  }
  const auto same = std::find_if(keys.begin(), keys.end(), [](const auto& key) { return key.first == "pile.tip"; });
  REQUIRE(same != keys.end());
  CHECK(same->second == "FLAT");  // defaults stand there in words
}

TEST_CASE("a lattice has its overlaps in each direction, and spheres that do not turn if it is asked to hold them") {
  // Pitch 2 R - overlap along z, 2 R - side_overlap along x and y; the floor's share of the overlap is that of a contact
  // with twice the stiffness. Two neighbours along z sheared by v for a time t: the spring has the force k_s v t, and the
  // sphere would turn by the torque R k_s v t; held, it turns 4e-13 of that.
  const auto spin_of = [](const std::string& keys) {
    const Settings s = make_settings(parse_scene(
        "grains { stiffness_ratio: 2 friction: 1000 lattice { count_x: 2 count_z: 2 overlap: 1e-5 side_overlap: 3e-5 " +
            keys + "} }",
        "lattice"));
    const Assembly a = assemble(s, 0, [](std::string_view, double) {});
    const Particles& p = a.particles;
    CHECK(p.position(1).x() - p.position(0).x() == Approx(0.1 - 3e-5).epsilon(1e-14));
    CHECK(p.position(2).z() - p.position(0).z() == Approx(0.1 - 1e-5).epsilon(1e-14));
    CHECK(p.position(0).z() == Approx(0.05 - 0.5e-5).epsilon(1e-14));
    Model m(0.01);
    m.particles = a.particles;
    m.material = s.material;
    m.particles.velocity(2).y() = m.particles.velocity(3).y() = 1e-6;
    Held held(1e-6);
    for (int n = 0; n < 50; ++n) cycle(m, held);
    CHECK(m.particles.velocity(0).y() > 0);
    return std::abs(m.particles.spin(0).x());
  };
  const double free = spin_of(""), held = spin_of("hold_spins: true ");
  INFO("spins " << free << " and " << held << " rad/s");
  CHECK(free > 0);
  CHECK(held / free == Approx(4e-13).epsilon(0.01));
}
