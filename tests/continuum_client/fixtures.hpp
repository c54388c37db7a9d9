// Small worlds for the tests of the ground.
#pragma once
#include <functional>
#include <vector>

#include "common/checks.hpp"
#include "common/hash.hpp"
#include "common/random.hpp"
#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/equilibrium.hpp"
#include "continuum_client/grid_builder.hpp"
#include "continuum_client/integrator.hpp"
#include "continuum_client/interface_surface.hpp"
#include "continuum_client/internal_force.hpp"
#include "continuum_client/timestep.hpp"

namespace lockstep::continuum {

inline const double test_density = 1630;  // [kg/m3]
inline const ElasticModuli test_moduli = elastic_moduli(44.3e6, 0.3);

inline constexpr ZoneKind zone_kinds[] = {ZoneKind::MixedDiscretization, ZoneKind::BBar, ZoneKind::OnePoint};

inline const Material test_material = {test_moduli, test_density};

inline Grid of_one_material(Grid grid, const Material& material) {
  grid.materials = {material};
  return grid;
}

inline Grid brick(double x, double y, double z, int nx, int ny, int nz, const Material& material = test_material,
                  ZoneKind kind = ZoneKind::MixedDiscretization) {
  BlockMesh m;
  m.width_x = x, m.width_y = y, m.height = z, m.top_z = 0;
  m.zones_x = nx, m.zones_y = ny, m.zones_z = nz;
  m.where = "test";
  Grid grid = of_one_material(build_block(m), material);
  grid.zone_kind = kind;
  return grid;
}

// Moves each node by up to `share` of `size` in each direction: faces warp too.
inline void distort(Grid& grid, double size, double share) {
  Random random(3);
  for (Vec3& x : grid.node)
    for (int c = 0; c < 3; ++c) x[c] += share * size * random.uniform(-1, 1);
}

inline CylinderMesh small_cylinder_mesh() {
  CylinderMesh m;
  m.width = 3, m.depth = 4, m.hole_diameter = 0.875, m.hole_depth = 2.5;
  m.zones_around = 16, m.zones_radial = 5, m.zones_hole_depth = 6, m.zones_below = 3;
  m.radial_growth = 1.3, m.depth_growth = 1.1;
  m.where = "test";
  return m;
}

inline Grid small_cylinder() { return of_one_material(build_cylinder_in_brick(small_cylinder_mesh()), test_material); }

inline Vec3s weights(const std::vector<double>& mass, double gravity) {
  Vec3s load(mass.size(), Vec3::Zero());
  for (std::size_t i = 0; i < mass.size(); ++i) load[i].z() = -mass[i] * gravity;
  return load;
}

// A quarter of a thick cylinder between the radii a and b around z, one layer of zones held in plane strain, `zones` along the
// radius (ratio of sizes constant) and around.
struct QuarterRing {
  Grid grid;
  Vec3s is_free, inner_pressure;          // per node; force of a pressure of 1 Pa on the inside [N]
  std::vector<std::size_t> inner, outer;  // nodes
};

inline QuarterRing quarter_ring(double a, double b, int zones, const Material& material, ZoneKind kind) {
  const double thickness = 0.25;
  QuarterRing ring{brick(b - a, 1, thickness, zones, zones, 1, material, kind), {}, {}, {}, {}};
  ring.is_free.assign(ring.grid.node_count(), Vec3::Ones());
  ring.inner_pressure.assign(ring.grid.node_count(), Vec3::Zero());
  for (int k = 0; k <= 1; ++k)
    for (int j = 0; j <= zones; ++j)
      for (int i = 0; i <= zones; ++i) {
        const auto n = static_cast<std::size_t>((j * (zones + 1) + i) * 2 + k);
        const double r = a * std::pow(b / a, static_cast<double>(i) / zones), angle = 0.5 * pi * j / zones;
        ring.grid.node[n].x() = j == zones ? 0 : r * std::cos(angle);
        ring.grid.node[n].y() = j == 0 ? 0 : r * std::sin(angle);
        ring.is_free[n].z() = 0;
        if (j == 0) ring.is_free[n].y() = 0;
        if (j == zones) ring.is_free[n].x() = 0;
        if (i == zones) ring.outer.push_back(n);
        if (i > 0) continue;
        ring.inner.push_back(n);
        // On the chords on either side.
        const double half_angle = 0.25 * pi / zones, chord = 2 * a * std::sin(half_angle);
        for (int side : {-1, 1})
          if (j + side >= 0 && j + side <= zones)
            ring.inner_pressure[n] += 0.25 * chord * thickness *
                                      Vec3(std::cos(angle + side * half_angle), std::sin(angle + side * half_angle), 0);
      }
  return ring;
}

// Mean radial displacement of some of its nodes [m].
inline double mean_radial(const QuarterRing& ring, const std::vector<std::size_t>& nodes, const Vec3s& u) {
  double sum = 0;
  for (const std::size_t n : nodes) sum += u[n].head<2>().dot(ring.grid.node[n].head<2>().normalized());
  return sum / static_cast<double>(nodes.size());
}

// Without any load or support the ground moves freely.
struct FreeRun {
  Grid grid;
  StiffnessMatrix stiffness;
  InternalForce force;
  Integrator integrator;
  Motion motion;
  Vec3s internal;

  FreeRun(Grid g, const Vec3s& is_free)
      : grid(std::move(g)),
        stiffness(assemble_stiffness(grid)),
        force(stiffness),
        integrator(lumped_masses(grid), is_free),
        motion{Vec3s(grid.node_count(), Vec3::Zero()), Vec3s(grid.node_count(), Vec3::Zero())},
        internal(grid.node_count()) {}

  StepSums step(double dt, double damping, double velocity_limit = 1e300) {
    force.evaluate(motion.displacement, internal);
    return integrator.advance(motion, internal, force.reference, {}, damping, {dt, dt}, velocity_limit);
  }
};

}  // namespace lockstep::continuum
