#include "continuum_client/zone_adjacency.hpp"

#include <algorithm>
#include <numeric>
#include <tuple>

#include "continuum_client/zone_topology.hpp"

namespace lockstep::continuum {

std::array<std::int32_t, 4> face_nodes(const ZoneNodes& zone, int face) {
  std::array<std::int32_t, 4> nodes;
  for (int c = 0; c < 4; ++c) nodes[c] = zone[zone_faces[face][c]];
  return nodes;
}

std::vector<ZoneFace> sorted_faces(const std::vector<ZoneNodes>& zones, const std::vector<char>& is_included) {
  std::vector<ZoneFace> faces;
  faces.reserve(6 * zones.size());
  for (std::size_t z = 0; z < zones.size(); ++z) {
    if (!is_included.empty() && !is_included[z]) continue;
    for (int f = 0; f < 6; ++f) {
      ZoneFace face{face_nodes(zones[z], f), static_cast<std::int32_t>(z), f};
      std::sort(face.key.begin(), face.key.end());
      faces.push_back(face);
    }
  }
  std::sort(faces.begin(), faces.end(), [](const ZoneFace& a, const ZoneFace& b) {
    return std::tie(a.key, a.zone, a.face) < std::tie(b.key, b.zone, b.face);
  });
  return faces;
}

Bodies::Bodies(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), 0); }

std::int32_t Bodies::root(std::int32_t a) {
  while (parent_[a] != a) a = parent_[a] = parent_[parent_[a]];
  return a;
}

void Bodies::join(std::int32_t a, std::int32_t b) {
  a = root(a), b = root(b);
  parent_[std::max(a, b)] = std::min(a, b);
}

}  // namespace lockstep::continuum
