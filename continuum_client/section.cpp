#include "continuum_client/section.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/constants.hpp"
#include "continuum_client/zone_topology.hpp"

namespace lockstep::continuum {
namespace {

class Cutter {
 public:
  Cutter(const Grid& grid, const Vec3& point, const Vec3& normal) : grid_(grid), height_(grid.node_count()) {
    const Vec3 unit = normal.normalized();
    const double tolerance = plane_tolerance * (grid.high - grid.low).maxCoeff();
    for (std::size_t i = 0; i < height_.size(); ++i) {
      height_[i] = unit.dot(grid.node[i] - point);
      if (std::abs(height_[i]) <= tolerance) height_[i] = 0;
    }
  }

  void cut(std::size_t z) {
    const auto& nodes = grid_.zone[z];
    bool has_above = false, has_below = false;
    for (const std::int32_t n : nodes) (is_above(n) ? has_above : has_below) = true;
    if (!has_above || !has_below) return;
    // For each edge that goes down in a face the edge that came up before it, both by (corner above, corner below).
    using Edge = std::pair<int, int>;
    std::map<Edge, Edge> next;
    for (const auto& face : zone_faces)
      for (int down = 0; down < 4; ++down) {
        if (!is_above(nodes[face[down]]) || is_above(nodes[face[(down + 1) % 4]])) continue;
        int up = down;  // the first corner of the run
        while (is_above(nodes[face[(up + 3) % 4]])) up = (up + 3) % 4;
        next[{face[down], face[(down + 1) % 4]}] = {face[up], face[(up + 3) % 4]};
      }
    while (!next.empty()) {
      std::vector<std::int32_t> loop;
      for (auto at = next.begin(); at != next.end();) {
        loop.push_back(point_on(nodes[at->first.first], nodes[at->first.second]));
        const Edge following = at->second;
        next.erase(at);
        at = next.find(following);
      }
      add(std::move(loop), z);
    }
  }

  // Of a zone above the plane that stands on it.
  void add_face(const OuterFace& face) {
    const auto& nodes = grid_.zone[face.zone];
    const bool stands = std::all_of(face.node.begin(), face.node.end(), [&](auto n) { return height_[n] == 0; }) &&
                        std::all_of(nodes.begin(), nodes.end(), [&](auto n) { return is_above(n); });
    if (!stands) return;
    // From outside the face is seen from below.
    add({point_on(face.node[3], face.node[3]), point_on(face.node[2], face.node[2]),
         point_on(face.node[1], face.node[1]), point_on(face.node[0], face.node[0])},
        static_cast<std::size_t>(face.zone));
  }

  bool meets_nodes() const { return std::count(height_.begin(), height_.end(), 0.0) > 0; }

  Section section;

 private:
  bool is_above(std::int32_t node) const { return height_[node] >= 0; }

  // Between a node above and one below; zones that share the edge share the point.
  std::int32_t point_on(std::int32_t above, std::int32_t below) {
    if (height_[above] == 0) below = above;
    const auto [place, is_new] = number_.try_emplace({above, below}, static_cast<std::int32_t>(section.point.size()));
    if (is_new)
      section.point.push_back(
          {above, below, above == below ? 0.0 : height_[above] / (height_[above] - height_[below])});
    return place->second;
  }

  // Without points that come twice in a row; what is left of a plane that only touches a zone is no polygon.
  void add(std::vector<std::int32_t> loop, std::size_t z) {
    loop.erase(std::unique(loop.begin(), loop.end()), loop.end());
    while (loop.size() > 1 && loop.front() == loop.back()) loop.pop_back();
    if (loop.size() < 3) return;
    section.polygon.push_back(std::move(loop));
    section.zone.push_back(static_cast<std::int32_t>(z));
  }

  const Grid& grid_;
  std::vector<double> height_;  // of nodes above the plane [m]
  std::map<std::pair<std::int32_t, std::int32_t>, std::int32_t> number_;
};

}  // namespace

Section cut_zones(const Grid& grid, const std::vector<char>& is_included, const Vec3& point, const Vec3& normal) {
  Cutter cutter(grid, point, normal);
  for (std::size_t z = 0; z < grid.zone_count(); ++z)
    if (is_included.empty() || is_included[z]) cutter.cut(z);
  if (cutter.meets_nodes())
    for (const OuterFace& face : outer_faces(grid, is_included)) cutter.add_face(face);
  return std::move(cutter.section);
}

}  // namespace lockstep::continuum
