// Walls in a scene: its keys, what is refused, and walls in the cycle with its ledger.
#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "common/checks.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/settings.hpp"
#include "tests/dem_server/spheres_at_walls.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

Settings settings_of(const std::string& blocks) {
  return make_settings(parse_scene("grains { wall_friction: 0.3 grain { radius: 0.03 } }\n" + blocks, "a scene"));
}

std::string complaint_about(const std::string& blocks) {
  try {
    settings_of(blocks);
  } catch (const Error& error) {
    return error.what();
  }
  return "no complaint";
}

}  // namespace

TEST_CASE("A scene's wall blocks become walls of each shape, and plane blocks stay planes") {
  const std::filesystem::path folder = std::filesystem::temp_directory_path() / "lockstep_wall_scene";
  std::filesystem::create_directories(folder);
  std::ofstream(folder / "tetra.stl")
      << "solid t\n"
         "facet normal 0 0 0 outer loop vertex 0 0 0 vertex 1000 0 0 vertex 0 1000 0 endloop endfacet\n"
         "facet normal 0 0 0 outer loop vertex 0 0 0 vertex 0 1000 0 vertex 0 0 1000 endloop endfacet\n"
         "endsolid t\n";
  std::ofstream(folder / "scene.txt")
      << "grains { wall_friction: 0.3 grain { radius: 0.03 } }\n"
         "plane { point { z: -1 } normal { z: 2 } }\n"
         "wall { name: \"lid\" plane { point { z: 1 } normal { z: -5 } } servo { pressure: 1000 area: 2 } }\n"
         "wall { cylinder { axis { y: 3 } radius: 0.5 } spin { y: 1 } friction: 0.9 }\n"
         "wall { cylinder { axis { z: 1 } radius: 0.5 length: 2 side: OUTSIDE } velocity { x: 0.1 } }\n"
         "wall { cone { axis { z: 1 } begin_radius: 0.1 end_radius: 0.4 length: 0.5 } }\n"
         "wall { mesh { file: \"tetra.stl\" scale: 0.001 shift { z: 0.25 } } spin_center { x: 1 } spin { z: 2 } }\n";
  const Settings s = make_settings(read_scene(folder));
  std::filesystem::remove_all(folder);

  REQUIRE(s.walls.size() == 5);
  REQUIRE(s.planes.size() == 1);
  const auto& lid = std::get<PlaneShape>(s.walls[0].shape);
  CHECK(s.walls[0].name == "lid");
  CHECK(lid.normal == -Vec3::UnitZ());
  CHECK(s.walls[0].servo->pressure == 1000);
  CHECK(s.walls[0].servo->area == 2);
  const auto& drum = std::get<CylinderShape>(s.walls[1].shape);
  CHECK(drum.axis == Vec3::UnitY());
  CHECK(drum.side == Side::Inside);
  CHECK(s.walls[1].friction == 0.9);
  CHECK(s.walls[1].spin == Vec3::UnitY());
  const auto& rod = std::get<FrustumShape>(s.walls[2].shape);
  CHECK(rod.is_cylinder());
  CHECK(rod.side == Side::Outside);
  CHECK(s.walls[2].velocity == Vec3(0.1, 0, 0));
  CHECK(std::get<FrustumShape>(s.walls[3].shape).end_radius == 0.4);
  const auto& mesh = std::get<MeshShape>(s.walls[4].shape);
  CHECK(mesh.mesh->triangle_count() == 2);
  CHECK(mesh.mesh->corner_count() == 4);
  CHECK(mesh.mesh->high() == Vec3(1, 1, 1.25));
  CHECK(s.walls[4].center == Vec3(1, 0, 0));

  const Walls walls(s.all_walls(), s.wall_friction);
  REQUIRE(walls.size() == 6);
  CHECK(walls.name(1) == "wall 2");
  CHECK(walls.center(5) == Vec3(0, 0, -1));
  REQUIRE(walls.planes().size() == 2);
  CHECK(walls.planes()[1].normal == Vec3::UnitZ());
  CHECK(walls.friction(0) == 0.3);
  CHECK(walls.friction(1) == 0.9);
}

TEST_CASE("A wall that cannot be is refused with its file, line, key, value and a remedy") {
  using Catch::Contains;
  CHECK_THAT(complaint_about("wall { }"),
             Contains("a scene:2: wall[0]") && Contains("no shape") && Contains("give one of"));
  CHECK_THAT(complaint_about("wall { cylinder { radius: 1 } }"),
             Contains("a scene:2: wall[0].cylinder.axis = 0 0 0") && Contains("give the direction"));
  CHECK_THAT(complaint_about("wall { cone { axis { z: 1 } } }"), Contains("wall[0].cone.") && Contains("no surface"));
  CHECK_THAT(complaint_about("wall { cylinder { axis { z: 1 } radius: -1 } }"),
             Contains("radius = -1") && Contains("out of range"));
  CHECK_THAT(complaint_about("wall { plane { normal { z: 1 } } servo { pressure: 1 } }"),
             Contains("wall[0].servo.area = 0 m2") && Contains("give the area"));
  CHECK_THAT(complaint_about("wall { cone { axis { z: 1 } end_radius: 1 } servo { pressure: 1 area: 1 } }"),
             Contains("wall[0].servo.direction"));
  CHECK_THAT(complaint_about("wall { plane { normal { z: 1 } } servo { } }"), Contains("servo.pressure is missing"));
  CHECK_THAT(complaint_about("wall { mesh { } }"), Contains("mesh.file is missing"));
  CHECK_THAT(complaint_about("wall { mesh { file: \"no_such.stl\" } }"), Contains("no_such.stl: cannot read the mesh"));
  CHECK_THAT(complaint_about("wall { plane { normal { z: 1 } } friction: -1 }"), Contains("wall[0].friction = -1"));
  CHECK_THAT(complaint_about("wall { plain { } }"), Contains("plain"));
}

TEST_CASE("The ledger closes over walls that move, turn and press") {
  // 216 spheres with friction in a turning drum under gravity, on a floor that rises, below a lid with a servo. Normal
  // springs balance exactly; friction and the drum's curvature to second order in the step: a step of a quarter must
  // leave less than a quarter of the error.
  const auto residual = [](double fraction) {
    Model m(0.002);
    m.gravity = {0, 0, -standard_gravity};
    m.material = grain();
    m.material.friction = 0.5;
    Random random(12);
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j)
        for (int k = 0; k < 6; ++k) {
          const Vec3 x = 2.02 * R * Vec3(i - 2.5, j - 2.5, k + 0.6);
          if (std::hypot(x.x(), x.y()) > 0.19) continue;
          m.particles.add(unit_sphere(), R, sphere_density, x, Quat::Identity());
          m.particles.velocity(m.particles.body_count() - 1) =
              0.2 * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
        }
    WallSettings drum = wall(CylinderShape{Vec3::Zero(), Vec3::UnitZ(), 0.22, Side::Inside});
    drum.spin = Vec3(0, 0, 3);
    WallSettings lid = wall(PlaneShape{Vec3(0, 0, 0.39), -Vec3::UnitZ()});
    lid.servo = WallServoSettings{2e4, 0.15, 0.3, 0.2, Vec3::Zero()};
    m.walls = Walls(std::vector<WallSettings>{drum, wall(PlaneShape{}, {0.05, 0, 0.1}), lid}, 0.4);
    const double dt = fraction / std::sqrt(2 * k_n() / m.particles.mass(0));
    Held held(dt);
    const double duration = 0.1;  // [s]
    double highest = 0;           // of the lid [Pa]
    while (m.time < duration) {
      cycle(m, held);
      highest = std::max(highest, m.walls.pressure(2));
    }
    INFO("step " << dt << " s: residual over work " << m.ledger.residual_fraction() << ", walls' work "
                 << m.ledger.energies().boundary_work << " J, lid at most at " << highest
                 << " Pa, worst vertical imbalance " << m.ledger.worst_vertical_imbalance());
    CHECK(highest > 1e4);
    CHECK(m.ledger.energies().boundary_work != 0);
    CHECK(m.ledger.worst_vertical_imbalance() < 1e-12);
    return std::abs(m.ledger.residual_fraction());
  };
  const double coarse = residual(0.2), fine = residual(0.05);
  CAPTURE(coarse, fine);
  CHECK(fine < coarse / 4);
  CHECK(fine < 0.005);
}
