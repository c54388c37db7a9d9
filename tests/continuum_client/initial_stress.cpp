// Layers and the prescribed initial stress.
#include "continuum_client/initial_stress.hpp"

#include <catch2/catch.hpp>

#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

Settings scene(const std::string& ground) {
  return read_settings(parse_scene("continuum { " + ground + " }", "test.txt"));
}

const std::string layered_block =
    "youngs_modulus: 4.43e6 block { width_x: 2 width_y: 2 height: 4 zones_x: 2 zones_y: 2 zones_z: 8 } "
    "layer { top: -1 youngs_modulus: 4.43e7 density: 2000 } "
    "layer { top: -2.5 youngs_modulus: 4.43e12 density: 1800 poisson_ratio: 0.2 } ";

}  // namespace

TEST_CASE("a layered column settles layer by layer, with a contrast of a million too") {
  // u(z) adds up -integral of sigma_v / M over the layers below: sigma_v = -integral of rho g above, linear in each
  // layer, so that a layer of height h with stresses p at its top and q at its bottom shortens by (p + q) h / 2 M. At
  // nodes that is exact.
  for (const ZoneKind kind : zone_kinds)
    for (const double gravity : {0.0, 9.81, 981.0}) {
      const Settings s = scene(layered_block);
      Grid grid = build_grid(s);
      grid.zone_kind = kind;
      REQUIRE(s.materials.size() == 3);
      CHECK(s.materials[2].moduli.constrained() / s.materials[0].moduli.constrained() > 5e5);
      const std::vector<double> mass = lumped_masses(grid);
      const Vec3s is_free = free_components(grid, Supports::Rollers, mass);
      Vec3s u;
      reach_equilibrium(assemble_stiffness(grid), mass, is_free, Vec3(0, 0, -gravity), {0.7, 1e-8, 1000, 0.9}, u, {});
      const double height[3] = {1, 1.5, 1.5};
      double top_stress = 0, exact = 0, surface = 0;
      for (int l = 0; l < 3; ++l) {
        const Material& m = s.materials[static_cast<std::size_t>(l)];
        const double bottom_stress = top_stress - m.density * gravity * height[l];
        exact += 0.5 * (top_stress + bottom_stress) * height[l] / m.moduli.constrained();
        top_stress = bottom_stress;
      }
      for (std::size_t i = 0; i < u.size(); ++i)
        if (grid.node[i].z() == 0) surface = u[i].z();
      INFO("kind " << static_cast<int>(kind) << ", g " << gravity << ": settlement " << -surface << " m, exact "
                   << -exact);
      CHECK(surface == Approx(exact).epsilon(1e-8).margin(1e-15));
    }
}

TEST_CASE("layers that the mesh does not know are errors in words") {
  const std::string mesh = "block { height: 4 zones_z: 8 } ";
  CHECK_THROWS_WITH(build_grid(scene(mesh + "layer { top: -1.2 }")),
                    Catch::Contains("nearest level of the mesh is at -1 m"));
  CHECK_THROWS_WITH(build_grid(scene(mesh + "layer { top: -4 }")), Catch::Contains("not above the bottom"));
  CHECK_THROWS_WITH(scene(mesh + "layer { top: -1 } layer { top: -1 }"), Catch::Contains("two layers"));
  CHECK_THROWS_WITH(
      read_settings(parse_scene("continuum { dynamic: true " + mesh + "} run { continuum_damping: 0.1 }", "t")),
      Catch::Contains("eats waves"));
  CHECK_THROWS_WITH(scene(mesh + "load { low { x: 1 } high { x: 0 } }"), Catch::Contains("is empty"));
}

TEST_CASE("prescribed stress balances gravity on horizontal layers with nothing to solve") {
  const Settings s = scene(layered_block + "initial_stress { k0: 0.7 }");
  const Grid grid = build_grid(s);
  const std::vector<double> mass = lumped_masses(grid);
  const Vec3s is_free = free_components(grid, Supports::Rollers, mass);
  InitialState state;
  state.stress = stress_by_depth(grid, s.layers, *s.k0, 9.81);
  const EquilibriumReport report =
      reach_equilibrium(assemble_stiffness(grid), mass, is_free, Vec3(0, 0, -9.81), {0.7, 1e-8, 1000, 0.9},
                        state.displacement, {}, prescribed_force(grid, state));
  double moved = 0;
  for (const Vec3& u : state.displacement) moved = std::max(moved, u.norm());
  // The lowest zone, centre 3.75 m deep: 1 m of the ground's own 1630, 1.5 m of 2000 and 1.25 m of 1800 kg/m3.
  const Mat3 lowest = state.zone_stress(grid, 0);
  INFO("moved " << moved << " m, ratio " << report.unbalanced_ratio);
  CHECK(report.solve.iterations == 0);
  CHECK(moved < 1e-15);
  CHECK(report.unbalanced_ratio < 1e-12);
  CHECK(lowest(2, 2) == Approx(-9.81 * (1630 + 1.5 * 2000 + 1.25 * 1800)));
  CHECK(lowest(0, 0) == Approx(0.7 * lowest(2, 2)));
}

TEST_CASE("the hand-off of a prescribed stress leaves round-off, on distorted zones too") {
  // K0 = 0.5 where the elastic ground would have 0.43: zones deleted, f_A in place, nothing moves.
  for (const ZoneKind kind : zone_kinds)
    for (const double distortion : {0.0, 0.02}) {
      Grid grid = small_cylinder();
      grid.zone_kind = kind;
      Random random(4);
      for (Vec3& x : grid.node)
        if (x.z() > grid.low.z() + 1e-9 && x.z() < -1e-9 && std::abs(x.x()) < 1.4 && std::abs(x.y()) < 1.4)
          for (int c = 0; c < 3; ++c) x[c] += distortion * random.uniform(-1, 1);
      const std::vector<double> all = lumped_masses(grid);
      InitialState state;
      state.stress = stress_by_depth(grid, {}, 0.5, 9.81);
      reach_equilibrium(assemble_stiffness(grid), all, free_components(grid, Supports::Rollers, all), Vec3(0, 0, -9.81),
                        {0.7, 1e-8, 1000, 0.9}, state.displacement, {}, prescribed_force(grid, state));
      const std::vector<char> is_left = zones_outside_discrete_domain(grid);
      const InterfaceSurface surface = interface_surface(grid);
      const Vec3s reaction = discrete_domain_reaction(grid, surface, 9.81, state);
      const std::vector<double> mass = lumped_masses(grid, is_left);
      const Vec3s is_free = free_components(grid, Supports::Rollers, mass);
      Vec3s internal(mass.size());
      assemble_stiffness(grid, is_left).multiply(state.displacement, internal);
      const Vec3s prescribed = prescribed_force(grid, state, is_left);
      Vec3s left(mass.size());
      for (std::size_t i = 0; i < mass.size(); ++i) left[i] = Vec3(0, 0, -9.81 * mass[i]) - internal[i] - prescribed[i];
      for (std::size_t k = 0; k < reaction.size(); ++k) left[static_cast<std::size_t>(surface.node[k])] += reaction[k];
      double worst = 0, scale = 0;
      for (std::size_t i = 0; i < left.size(); ++i) worst = std::max(worst, left[i].cwiseProduct(is_free[i]).norm());
      for (const Vec3& f : reaction) scale = std::max(scale, f.norm());
      INFO("kind " << static_cast<int>(kind) << ", distortion " << distortion << ": residual " << worst / scale);
      CHECK(worst / scale < 1e-11);
    }
}

}  // namespace lockstep::continuum
