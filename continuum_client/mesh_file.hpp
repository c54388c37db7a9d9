// The ground's mesh from a file: reads it, refuses what is wrong with it by zone, place and remedy, and makes of the rest a Grid
// as the built-in meshes are.
//
// What is refused: nodes in one place (unless merge_distance is given), zones with a node twice, zones twice, zones that are
// turned inside out, flat or warped (constants.hpp has the limits), faces of three zones, bodies that hang together with
// nothing, nodes on another zone's face or edge, and an outer boundary that is no brick with a free top. Zones that are all
// mirrored, as a left-handed writer gives them, are turned round, and nodes of no zone are dropped, with a line in the log.
//
// The interface: faces between the discrete domain and the rest; without a discrete domain the named surfaces, or the top.
// A facet whose normal, into the grains, is nearer to the vertical is of the bottom (ring -1); the others are of the side,
// and those that hang together by upright edges are a ring.
#pragma once
#include "continuum_client/grid.hpp"
#include "continuum_client/settings.hpp"

namespace lockstep::continuum {

// One material a region, 0 elsewhere. IoError if the file cannot be read; InputError with the file, or the key.
Grid build_from_file(const FileMeshSettings& settings);

}  // namespace lockstep::continuum
