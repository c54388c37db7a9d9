#include "dem_server/make_model.hpp"

#include <utility>

#include "common/log.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

std::unique_ptr<Model> make_model(const Settings& settings, Assembly& assembly, const HandedOver& ground, int threads) {
  const double radius = assembly.mean_radius > 0 ? assembly.mean_radius : 1.0;
  const double collar = settings.pile ? 2 * settings.pile->shape.radius : 0.0;
  auto model =
      std::make_unique<Model>(list_skin * radius, worthwhile_threads(assembly.particles.body_count(), threads));
  Model& m = *model;
  m.particles = std::move(assembly.particles);
  m.is_fixed = assembly.is_fixed;
  m.gravity = {0, 0, -settings.gravity};
  m.material = settings.material;
  m.facet_material = {settings.material.contact_modulus, settings.material.stiffness_ratio, settings.interface_friction,
                      settings.material.damping_ratio,   settings.facet_stiffness_factor,   settings.transfers_moment};
  m.facets = InterfaceFacets(ground.nodes, ground.facets, collar);
  m.walls = Walls(settings.all_walls(), settings.wall_friction);
  m.walls.set_moving(false, false);
  if (settings.pile) m.pile.emplace(settings.pile->shape, -settings.pile->embedment, settings.pile->friction);
  spdlog::info(
      "packing: {} grains with {} pebbles, mean radius {:.4g} m, solid density {:.0f} kg/m3, porosity of the cube "
      "{:.3f}, overall {:.3f}",
      m.particles.body_count(), m.particles.pebble_count(), assembly.mean_radius, assembly.solid_density,
      assembly.cube_porosity, assembly.overall_porosity);
  return model;
}

void set_friction(Model& m, const Settings& settings, double grain, double share) {
  m.material.friction = grain;
  m.facet_material.friction = share * settings.interface_friction;
  m.walls.set_friction_share(share);
  if (m.pile) m.pile->set_friction(share * settings.pile->friction);
}

}  // namespace lockstep::dem
