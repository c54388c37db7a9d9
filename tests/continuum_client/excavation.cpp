// The mesh around the hole, what the deleted zones did to it, and the scene keys that shape it.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>

#include "common/shape_functions.hpp"
#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

struct Ground {
  Grid grid = small_cylinder();
  InterfaceSurface surface = interface_surface(grid);
  std::vector<double> mass = lumped_masses(grid);
  Vec3s is_free = free_components(grid, Supports::Rollers, mass);
  Vec3s u;
  double gravity = 9.81;

  Ground() {
    reach_equilibrium(assemble_stiffness(grid), mass, is_free, Vec3(0, 0, -gravity), {0.7, 1e-6, 1000, 0.9}, u, {});
  }
  Vec3s reaction() const { return discrete_domain_reaction(grid, surface, gravity, InitialState(u)); }
};

}  // namespace

TEST_CASE("facets point into the grains and close the hole") {
  const Ground g;
  const CylinderMesh m = small_cylinder_mesh();
  double side = 0, bottom = 0;
  int rings = 0;
  for (std::size_t f = 0; f < g.surface.facet_count(); ++f) {
    const FacetCorners x = g.surface.corners(f);
    const Vec3 area = facet_area_vector(x), center = interpolate(bilinear_weights(0, 0), x);
    if (g.surface.ring[f] < 0) {
      CHECK(area.normalized().z() == Approx(1));
      CHECK(center.z() == Approx(-m.hole_depth));
      bottom += area.norm();
    } else {
      CHECK(area.normalized().dot(-Vec3(center.x(), center.y(), 0).normalized()) == Approx(1));
      side += area.norm();
      rings = std::max(rings, g.surface.ring[f] + 1);
    }
    if (g.surface.ring[f] == 0) CHECK(center.z() == Approx(-0.5 * m.hole_depth / m.zones_hole_depth));
  }
  // A regular polygon of 16 sides in a circle of radius R: 16 chords 2 R sin(pi/16), area 8 R^2 sin(pi/8).
  const double r = m.hole_diameter / 2;
  CHECK(rings == m.zones_hole_depth);
  CHECK(side == Approx(16 * 2 * r * std::sin(pi / 16) * m.hole_depth).epsilon(1e-12));
  CHECK(bottom == Approx(8 * r * r * std::sin(pi / 8)).epsilon(1e-12));
}

TEST_CASE("no interface position is minus zero, whose bits adding nothing would change") {
  for (const Vec3& x : interface_surface(small_cylinder()).position)
    for (int c = 0; c < 3; ++c) CHECK_FALSE((x[c] == 0 && std::signbit(x[c])));
}

TEST_CASE("the mesh fills the brick once, and the discrete domain the hole") {
  const Grid grid = small_cylinder();
  const CylinderMesh m = small_cylinder_mesh();
  double volume = 0, inside = 0;
  std::size_t left = 0;
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    const double v = grid.geometry(z).zone_volume();
    volume += v;
    if (grid.in_discrete_domain[z])
      inside += v;
    else
      ++left;
  }
  const double r = m.hole_diameter / 2;
  CHECK(volume == Approx(m.width * m.width * m.depth).epsilon(1e-12));
  CHECK(inside == Approx(8 * r * r * std::sin(pi / 8) * m.hole_depth).epsilon(1e-12));
  // a r h + (a r + (a/4)^2 + a g) b with a 16, r 5, h 6, b 3, g 1: see grid_builder.hpp.
  CHECK(left == 16 * 5 * 6 + (16 * 5 + 16 + 16) * 3);
}

TEST_CASE("counts of 32 x 15 x 38 and 5 levels below leave the paper's 21,280 zones") {
  CylinderMesh m;
  m.width = 6.25, m.depth = 9, m.hole_diameter = 0.875, m.hole_depth = 7.2, m.radial_growth = 1.12, m.depth_growth = 1,
  m.where = "test";
  m.zones_around = 32, m.zones_radial = 15, m.zones_hole_depth = 38, m.zones_below = 5;
  const Grid grid = build_cylinder_in_brick(m);
  const std::vector<char> is_left = zones_outside_discrete_domain(grid);
  CHECK(std::count(is_left.begin(), is_left.end(), 1) == 21280);
}

TEST_CASE("the ground is in equilibrium with its zones deleted and their reaction in place") {
  const Ground g;
  const std::vector<char> is_left = zones_outside_discrete_domain(g.grid);
  const std::vector<double> mass = lumped_masses(g.grid, is_left);
  const Vec3s after = free_components(g.grid, Supports::AllFixed, mass);
  Vec3s f(g.grid.node_count());
  assemble_stiffness(g.grid, is_left).multiply(g.u, f);
  for (std::size_t i = 0; i < f.size(); ++i) f[i] = Vec3(0, 0, -mass[i] * g.gravity) - f[i];
  const Vec3s reaction = g.reaction();
  double open = 0, worst = 0, scale = 0;
  for (std::size_t i = 0; i < f.size(); ++i) open = std::max(open, f[i].cwiseProduct(after[i]).norm());
  for (std::size_t k = 0; k < reaction.size(); ++k)
    f[g.surface.node[k]] += reaction[k], scale = std::max(scale, reaction[k].norm());
  for (std::size_t i = 0; i < f.size(); ++i) worst = std::max(worst, f[i].cwiseProduct(after[i]).norm());
  INFO("unbalanced over largest reaction: " << worst / scale << "; with the hole left open: " << open / scale);
  CHECK(worst / scale < 1e-10);
  CHECK(open / scale > 0.5);
}

TEST_CASE("the deleted zones' reaction is their weight, and its traction the earth pressure") {
  const Ground g;
  const Vec3s reaction = g.reaction();
  Vec3 total = Vec3::Zero();
  for (const Vec3& f : reaction) total += f;
  double deleted = 0;
  for (std::size_t z = 0; z < g.grid.zone_count(); ++z)
    if (g.grid.in_discrete_domain[z]) deleted += test_density * g.grid.geometry(z).zone_volume();
  // The column in the hole stands on the zones below it; rollers on the sides leave no shear on its own sides.
  INFO("sum of reactions over weight: " << total.transpose() / (deleted * g.gravity));
  CHECK((total + Vec3(0, 0, deleted * g.gravity)).norm() / (deleted * g.gravity) < 1e-9);

  const std::vector<Voigt> stress = facet_stress(g.grid, g.surface, InitialState(g.u));
  const Vec3s traction = facet_traction(g.surface, stress, reaction);
  Vec3 lumped = Vec3::Zero();
  double worst_ring = 0, worst_bottom = 0, worst_stress = 0;
  const CylinderMesh m = small_cylinder_mesh();
  std::vector<double> ring_force(m.zones_hole_depth, 0.0), ring_area(m.zones_hole_depth, 0.0);
  for (std::size_t f = 0; f < g.surface.facet_count(); ++f) {
    const FacetCorners x = g.surface.corners(f);
    const Vec3 area = facet_area_vector(x);
    const double z = interpolate(bilinear_weights(0, 0), x).z(), vertical = test_density * g.gravity * z;
    lumped += traction[f] * area.norm();
    worst_stress = std::max(worst_stress, std::abs(stress[f][0] / (0.3 / 0.7 * stress[f][2]) - 1));
    // Pressure is negative stress: sigma n . n = K0 rho g z on the sides, rho g z at the bottom.
    if (g.surface.ring[f] < 0) {
      worst_bottom = std::max(worst_bottom, std::abs(traction[f].z() / vertical - 1));
    } else {
      ring_force[g.surface.ring[f]] += traction[f].dot(area);
      ring_area[g.surface.ring[f]] += area.norm();
    }
  }
  for (int ring = 0; ring < m.zones_hole_depth; ++ring) {
    const double z = -(ring + 0.5) * m.hole_depth / m.zones_hole_depth;
    worst_ring = std::max(
        worst_ring, std::abs(ring_force[ring] / ring_area[ring] / (0.3 / 0.7 * test_density * g.gravity * z) - 1));
  }
  INFO("traction against rho g z K0, worst ring " << worst_ring << ", worst bottom facet " << worst_bottom
                                                  << ", sum against f_A " << (lumped - total).norm() / total.norm());
  CHECK((lumped - total).norm() / total.norm() < 1e-12);
  CHECK(worst_stress < 1e-7);
  CHECK(worst_ring < 0.05);
  CHECK(worst_bottom < 0.05);

  const std::vector<LevelStress> profile = discrete_domain_profile(g.grid, InitialState(g.u));
  REQUIRE(profile.size() == 6);
  for (std::size_t l = 0; l < profile.size(); ++l) {
    if (l > 0) CHECK(profile[l].z > profile[l - 1].z);
    CHECK(profile[l].vertical == Approx(test_density * g.gravity * profile[l].z).epsilon(1e-8));
    CHECK(profile[l].horizontal == Approx(0.3 / 0.7 * profile[l].vertical).epsilon(1e-7));
  }
}

TEST_CASE("deleting zones leaves the stiffness of the others and no trace of the deleted") {
  const Grid grid = small_cylinder();
  const std::vector<char> is_left = zones_outside_discrete_domain(grid);
  const StiffnessMatrix all = assemble_stiffness(grid), left = assemble_stiffness(grid, is_left);
  std::vector<char> is_deleted = is_left;
  for (char& c : is_deleted) c = !c;
  const StiffnessMatrix deleted = assemble_stiffness(grid, is_deleted);
  Random random(4);
  Vec3s u(grid.node_count()), f(u.size()), g(u.size()), h(u.size());
  for (Vec3& v : u) v = Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  all.multiply(u, f), left.multiply(u, g), deleted.multiply(u, h);
  double error = 0, scale = 0;
  for (std::size_t i = 0; i < u.size(); ++i)
    error = std::max(error, (f[i] - g[i] - h[i]).norm()), scale = std::max(scale, f[i].norm());
  CHECK(error / scale < 1e-14);
  const std::vector<double> mass = lumped_masses(grid, is_left);
  for (std::size_t i = 0; i < u.size(); ++i)
    if (mass[i] == 0) CHECK(left.row_begin[i] == left.row_begin[i + 1]);
}

TEST_CASE("zones that are deleted and added back give the operator of before, to the last bit") {
  // Each state is assembled from the zones that are there, in their order: nothing remembers the one before.
  const Grid cylinder = small_cylinder();
  const std::vector<char> is_left = zones_outside_discrete_domain(cylinder), all(cylinder.zone_count(), 1);
  Random random(6);
  Vec3s u(cylinder.node_count());
  for (Vec3& v : u) v = Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  const auto hash_of = [&](const Grid& grid, const std::vector<char>& is_included) {
    const StiffnessMatrix k = assemble_stiffness(grid, is_included);
    Hash h;
    for (const std::int64_t begin : k.row_begin) h.add(static_cast<std::uint64_t>(begin));
    for (const std::int32_t column : k.column) h.add(static_cast<std::uint64_t>(column));
    for (const Mat3& block : k.block) h.add(std::span<const double>(block.data(), 9));
    h.add(std::span<const double>(lumped_masses(grid, is_included)));
    Vec3s f(u.size());
    k.multiply(u, f);
    h.add(std::span<const Vec3>(f));
    InternalForce force(StiffnessProduct(k, grid, is_included));
    force.reference = f;
    force.evaluate(u, f);
    h.add(std::span<const Vec3>(f));
    return h.value();
  };
  for (const ZoneKind kind : zone_kinds)
    for (const double share : {0.0, 0.1}) {  // of distortion: rows shared along columns, and none
      Grid grid = cylinder;
      grid.zone_kind = kind;
      distort(grid, 0.1, share);
      const std::uint64_t before = hash_of(grid, all), without = hash_of(grid, is_left), after = hash_of(grid, all);
      CAPTURE(static_cast<int>(kind), share, before, without, after);
      CHECK(without != before);
      CHECK(after == before);
      CHECK(hash_of(grid, is_left) == without);
      CHECK(hash_of(grid, {}) == before);
    }
}

TEST_CASE("a support that is taken away stays as its reaction") {
  // A column between rollers is let go at its sides: with the reactions kept, nothing moves.
  const Grid grid = brick(1, 1, 2, 2, 2, 4);
  const std::vector<double> mass = lumped_masses(grid);
  const Vec3s before = free_components(grid, Supports::Rollers, mass),
              after = free_components(grid, Supports::BottomFixed, mass);
  const StiffnessMatrix k = assemble_stiffness(grid);
  const Vec3s load = weights(mass, 9.81);
  Vec3s u, f;
  solve_static(k, before, load, u, {});
  f.resize(u.size());
  k.multiply(u, f);
  const Vec3s reaction = released_reactions(before, after, f, load);
  double with = 0, without = 0;
  for (std::size_t i = 0; i < u.size(); ++i) {
    with = std::max(with, (load[i] + reaction[i] - f[i]).cwiseProduct(after[i]).norm());
    without = std::max(without, (load[i] - f[i]).cwiseProduct(after[i]).norm());
  }
  INFO("unbalanced with reactions over without " << with / without);
  CHECK(with / without < 1e-9);
}

TEST_CASE("mistyped meshes are refused with their keys") {
  const auto error_of = [](const std::string& mesh) {
    try {
      build_grid(read_settings(parse_scene("continuum { " + mesh + " }", "test.txt")));
    } catch (const InputError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  using Catch::Matchers::Contains;
  CHECK_THAT(error_of("cylinder_in_brick { zones_around: 12 }"), Contains("zones_around") && Contains("multiple of 8"));
  CHECK_THAT(error_of("cylinder_in_brick { hole_diameter: 7 }"), Contains("hole_diameter") && Contains("6.25"));
  CHECK_THAT(error_of("cylinder_in_brick { hole_depth: 9 }"), Contains("hole_depth"));
  CHECK_THAT(error_of("cylinder_in_brick { radial_growth: 3 }"), Contains("radial_growth"));
  CHECK_THAT(error_of("cylinder_in_brick { depth_growth: 3 zones_below: 20 }"), Contains("depth_growth"));
  CHECK_THAT(error_of(""), Contains("cylinder_in_brick") && Contains("block"));
  CHECK_THROWS_AS(read_settings(parse_scene("grains { grain { } }", "test.txt")), InputError);
}

TEST_CASE("refinement multiplies counts and keeps the size distribution") {
  const auto settings = [](const std::string& more) {
    return std::get<CylinderMesh>(
        read_settings(
            parse_scene("continuum { cylinder_in_brick { } } fidelity { mesh_refinement: " + more + " }", "test.txt"))
            .mesh);
  };
  const CylinderMesh half = settings("0.5"), twice = settings("2");
  CHECK(half.zones_around == 16);
  CHECK(half.zones_radial == 9);
  CHECK(twice.zones_hole_depth == 70);
  CHECK(std::pow(twice.radial_growth, twice.zones_radial) == Approx(std::pow(1.12, 18)).epsilon(1e-12));
}

}  // namespace lockstep::continuum
