// Which zones meet at which faces.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

namespace lockstep::continuum {

using ZoneNodes = std::array<std::int32_t, 8>;

struct ZoneFace {
  std::array<std::int32_t, 4> key;  // its nodes, rising
  std::int32_t zone;
  std::int32_t face;  // of zone_faces
};

// Nodes of a face, seen from outside counter-clockwise.
std::array<std::int32_t, 4> face_nodes(const ZoneNodes& zone, int face);

// The six faces of each zone with is_included[z] (empty: all), sorted: those of one place stand together, by zone.
std::vector<ZoneFace> sorted_faces(const std::vector<ZoneNodes>& zones, const std::vector<char>& is_included = {});

// Calls visit(first, count) for each place.
template <class Visit>
void for_each_place(const std::vector<ZoneFace>& faces, const Visit& visit) {
  for (std::size_t i = 0; i < faces.size();) {
    std::size_t end = i + 1;
    while (end < faces.size() && faces[end].key == faces[i].key) ++end;
    visit(&faces[i], end - i);
    i = end;
  }
}

// Which things hang together, by joining two at a time.
class Bodies {
 public:
  explicit Bodies(std::size_t count);
  void join(std::int32_t a, std::int32_t b);
  std::int32_t root(std::int32_t a);  // the lowest of a's body

 private:
  std::vector<std::int32_t> parent_;
};

}  // namespace lockstep::continuum
