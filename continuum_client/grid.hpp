// The ground: nodes, 8-node zones with their kind and materials, and the facets of the future interface with the grains.
//
// Nodes and zones are numbered column by column, upwards in each: neighbouring nodes of a column have the same neighbours one
// level up, and often the same stiffness, which the product with the assembled operator lives on. A zone's nodes are those of zone_kinematics.hpp: bottom
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
  std::vector<char> in_discrete_domain;  // per zone: deleted at Excavate
  ZoneKind zone_kind = ZoneKind::MixedDiscretization;
  std::vector<Material> materials;                 // at least one
  std::vector<std::int32_t> material;              // per zone: index into materials
  std::vector<std::int32_t> level;                 // per zone: from the bottom up
  std::vector<std::array<std::int32_t, 4>> facet;  // interface, grid nodes, normal into the grains
  std::vector<std::int32_t> ring;                  // per facet: 0 at the top and down; -1: bottom group
  Vec3 low = Vec3::Zero(), high = Vec3::Zero();    // corners of the whole brick [m]

  std::size_t node_count() const { return node.size(); }
  std::size_t zone_count() const { return zone.size(); }
  double depth() const { return high.z() - low.z(); }  // [m]

  ZoneVectors corners(std::size_t z) const;
  ZoneGeometry geometry(std::size_t z) const { return zone_geometry(zone_kind, corners(z)); }
  const Material& material_of(std::size_t z) const { return materials[material[z]]; }
  const ElasticModuli& moduli(std::size_t z) const { return material_of(z).moduli; }
  Vec3 zone_center(std::size_t z) const;
};

// The values of a nodal field at a zone's nodes.
ZoneVectors gather(const Vec3s& field, const std::array<std::int32_t, 8>& nodes);

// Zones that are left once the discrete domain is taken out, in order; node numbers stay.
std::vector<char> zones_outside_discrete_domain(const Grid& grid);

// Mean density of the zones of the discrete domain, by volume; without any the first material's [kg/m3].
double replaced_density(const Grid& grid);
// The largest P-wave speed of its materials [m/s].
double fastest_wave(const Grid& grid);

// For each zone one that is its translate, to 1e-12 of its size, and of its material: the lowest of its column from which
// all are alike. Zones share the representative's matrices, so that levels of equal height have equal ones to the last bit.
std::vector<std::int32_t> representative_zones(const Grid& grid);

// Throws InputError with `where` and the remedy if a zone is turned inside out or flat, as its kind sees it.
void check_zones(const Grid& grid, const std::string& where,
                 const std::string& remedy = "use fewer zones or growth nearer to 1");

}  // namespace lockstep::continuum
