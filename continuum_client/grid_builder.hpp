// Makes the two meshes that scenes can ask for without a file (mesh_file.hpp has the third).
//
// cylinder_in_brick, a plane of it:
//
//   +-----------+   From the circle to the square run straight rays, one per node of the circle, at equal angles; along
//   a ray
//   |\   |   / |   zone sizes grow by radial_growth away from the hole. Inside the circle stand a square core of
//   |  .---.   |   (zones_around/4)^2 zones and rings of zones_around zones around it: no zone has an angle near 180
//   degrees,
//   |-( [ ] )--|   as it would with a core alone. The planes repeat from the bottom to the top, so the mesh inside the
//   hole |  '---'   |   goes on below it; the part beside the grains is flagged and deleted at Excavate.
//   +-----------+
//
// Zones left after Excavate, with a around, r radial, h levels beside the hole, b below and g = max(1, a/16) rings
// inside:
//   a r h + (a r + (a/4)^2 + a g) b
// Rejected: a wedge mesh with the axis as a line of collapsed zones, whose tetrahedra on the axis set the time step.
#pragma once
#include "continuum_client/grid.hpp"
#include "continuum_client/settings.hpp"

namespace lockstep::continuum {

// A regular brick; the interface is its whole top and nothing is deleted.
Grid build_block(const BlockMesh& mesh);

// A brick around a cylinder of zones that is flagged as the discrete domain.
Grid build_cylinder_in_brick(const CylinderMesh& mesh);

// The one that the settings hold, checked; InputError names the keys.
Grid build_grid(const Settings& settings);

}  // namespace lockstep::continuum
