// A triaxial test without walls: the cube that a scene's packing is tiled from, pressed on all sides in its periodic cell,
// then shortened along z while x and y hold the pressure (dem_server/periodic_cell.hpp).
//
//   build/release/bin/triaxial_cell scenarios/triaxial --pressure 100e3 --strain 0.001 --out cell.csv
//
// The packing is the scene's; --contact-modulus, --stiffness-ratio and --friction are the test's own, so that one packing may
// be tested with many of them (tools/calibrate does). One JSON object on standard output says what was tested.
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <string>
#include <vector>

#include "common/checks.hpp"
#include "common/interrupt.hpp"
#include "common/log.hpp"
#include "common/results.hpp"
#include "common/scene.hpp"
#include "dem_server/packing.hpp"
#include "dem_server/periodic_cell.hpp"
#include "dem_server/settings.hpp"

namespace {

using namespace lockstep;

struct Options {
  std::string scene, out;
  std::vector<std::string> overrides;
  dem::CellTest test;
  double contact_modulus = 0, stiffness_ratio = 0, friction = -1;  // the scene's where they were not given
  int threads = 1;
};

void run(Options& o) {
  const SceneFile file = read_scene(o.scene, o.overrides);
  const dem::Settings settings = dem::make_settings(file);
  if (!settings.packing)
    throw InputError(fmt::format("{}: the scene has no grains.packing, so there is no cell to test; give one with it",
                                 file.path.string()));
  dem::CubeRequest request = dem::cube_request(settings, settings.packing->radius);
  request.threads = o.threads;
  request.progress = [](std::string_view, double) {
    if (interrupt_requested()) throw Interrupted("interrupted while the cube was packed");
  };
  const dem::Cube cube = dem::make_cube(request);
  dem::GrainMaterial material = settings.material;
  if (o.contact_modulus > 0) material.contact_modulus = o.contact_modulus;
  if (o.stiffness_ratio > 0) material.stiffness_ratio = o.stiffness_ratio;
  if (o.friction >= 0) material.friction = o.friction;

  History history(o.out, {"axial strain", "radial strain", "volume strain", "axial stress [Pa]", "radial stress [Pa]",
                          "porosity", "coordination", "unbalanced ratio"});
  Team team(o.threads);
  const dem::CellTestResult result = dem::run_cell_test(cube, material, o.test, team, [&](const dem::CellState& s) {
    history.add({s.axial_strain, s.radial_strain, s.volume_strain, s.axial_stress, s.radial_stress, s.porosity,
                 s.coordination, s.unbalanced_ratio});
  });
  std::printf("%s\n", Json()
                          .add("grains", static_cast<std::int64_t>(cube.particles.body_count()))
                          .add("radius_m", cube.particles.mean_radius())
                          .add("contact_modulus_pa", material.contact_modulus)
                          .add("stiffness_ratio", material.stiffness_ratio)
                          .add("friction", material.friction)
                          .add("pressure_pa", o.test.pressure)
                          .add("porosity", result.pressed.porosity)
                          .add("coordination", result.pressed.coordination)
                          .add("steps", result.steps)
                          .text()
                          .c_str());
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  CLI::App app("A triaxial test of a scene's packing in its periodic cell, without walls.");
  app.add_option("scene", o.scene, "scene file, or a folder with scene.txt")->required();
  app.add_option("--out", o.out, "CSV file of strains and stresses, compression positive")->required();
  app.add_option("--set", o.overrides, "KEY=VALUE, overrides a key of the scene")->allow_extra_args(false);
  app.add_option("--pressure", o.test.pressure, "confining [Pa]")->capture_default_str()->check(CLI::Range(1.0, 1e12));
  app.add_option("--strain", o.test.axial_strain, "axial, logarithmic, at the end")
      ->capture_default_str()
      ->check(CLI::Range(1e-6, 1.0));
  app.add_option("--inertial-number", o.test.inertial_number, "of the shortening: rate 2 R sqrt(rho/p)")
      ->capture_default_str()
      ->check(CLI::Range(1e-6, 0.1));
  app.add_option("--damping", o.test.damping, "local damping while it is shortened")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 0.95));
  app.add_option("--preparation-friction", o.test.preparation_friction,
                 "while it is pressed; left out: that it was packed with, at most that of the test")
      ->check(CLI::Range(0.0, 1e3));
  app.add_option("--contact-modulus", o.contact_modulus, "E* of the test; left out: the scene's [Pa]")
      ->check(CLI::Range(1.0, 1e13));
  app.add_option("--stiffness-ratio", o.stiffness_ratio, "k_n/k_s of the test; left out: the scene's")
      ->check(CLI::Range(0.5, 1e6));
  app.add_option("--friction", o.friction, "of the test; left out: the scene's")->check(CLI::Range(0.0, 1e3));
  app.add_option("--threads", o.threads, "the results do not depend on it")
      ->capture_default_str()
      ->check(CLI::Range(1, 256));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : static_cast<int>(ExitCode::Input);
  }
  try {
    start_log("triaxial_cell", {}, false);
    install_interrupt_handlers();
    run(o);
    return 0;
  } catch (const Error& error) {
    spdlog::error("{}", error.what());
    return static_cast<int>(error.code());
  } catch (const std::exception& error) {
    spdlog::critical("internal error: {}; please report it with the log", error.what());
    return static_cast<int>(ExitCode::Internal);
  }
}
