// The model of a scene: its grains with all that is around them, at rest.
#pragma once
#include <memory>

#include "dem_server/balance.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/packing.hpp"
#include "dem_server/settings.hpp"

namespace lockstep::dem {

// Takes the grains out of `assembly`. Walls are held; of the `threads` the model uses those that pay.
std::unique_ptr<Model> make_model(const Settings& settings, Assembly& assembly, const HandedOver& ground, int threads);

// Friction between grains, and that of interface, walls and pile as a share of the scene's.
void set_friction(Model& model, const Settings& settings, double grain, double share);

}  // namespace lockstep::dem
