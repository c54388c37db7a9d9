// The mesh: nodes, 8-node zones, and the facets of the future interface with the grains. Pure geometry.
//
// Nodes are numbered along the structured directions, horizontal plane by plane from the bottom up, so that the product
// with the assembled stiffness walks memory nearly in order. A zone's nodes are those of zone_kinematics.hpp: bottom
// face counter- clockwise seen from above, then the top face.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/vectors.hpp"
#include "continuum_client/zone_kinematics.hpp"

namespace lockstep::continuum {

struct Grid {
  Vec3s node;  // reference positions [m]
  std::vector<std::array<std::int32_t, 8>> zone;
  std::vector<char> in_discrete_domain;            // per zone: deleted at Excavate
  std::vector<std::int32_t> level;                 // per zone: from the bottom up
  std::vector<std::array<std::int32_t, 4>> facet;  // interface, grid nodes, normal into the grains
  std::vector<std::int32_t> ring;                  // per facet: 0 at the top and down; -1: bottom group
  Vec3 low = Vec3::Zero(), high = Vec3::Zero();    // corners of the whole brick [m]

  std::size_t node_count() const { return node.size(); }
  std::size_t zone_count() const { return zone.size(); }
  double depth() const { return high.z() - low.z(); }  // [m]

  ZoneVectors corners(std::size_t z) const;
  ZoneGeometry geometry(std::size_t z) const { return zone_geometry(corners(z)); }
  Vec3 zone_center(std::size_t z) const;
};

// The values of a nodal field at a zone's nodes.
ZoneVectors gather(const Vec3s& field, const std::array<std::int32_t, 8>& nodes);

// Zones that are left once the discrete domain is taken out, in order; node numbers stay.
std::vector<char> zones_outside_discrete_domain(const Grid& grid);

// Throws InputError with `where` if a zone is turned inside out or flat.
void check_zones(const Grid& grid, const std::string& where);

}  // namespace lockstep::continuum
