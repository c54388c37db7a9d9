#include "continuum_client/mesh_numbering.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "continuum_client/zone_topology.hpp"

namespace lockstep::continuum {
namespace {

constexpr int bottom_face = 0, top_face = 1;

// Zones' corners face by face along -z, z, -y, x, y, -x of the cube: the axis that a face stands across, and its end.
constexpr int face_axis[6] = {2, 2, 1, 0, 1, 0};
constexpr int face_end[6] = {-1, 1, -1, 1, 1, -1};

int across(int corner, int axis) {
  for (int other = 0; other < 8; ++other) {
    bool is_it = true;
    for (int c = 0; c < 3; ++c) is_it &= node_at[other][c] == (c == axis ? -1 : 1) * node_at[corner][c];
    if (is_it) return other;
  }
  return corner;
}

// The zone with the most upright of its directions as its third, pointing up.
ZoneNodes turned_upright(const Vec3s& node, const ZoneNodes& zone) {
  int top = top_face;
  double best = -2;
  for (int f = 0; f < 6; ++f) {
    Vec3 along = Vec3::Zero();
    for (int a = 0; a < 8; ++a) along += face_end[f] * node_at[a][face_axis[f]] * node[zone[a]];
    const double upright = along.z() / along.norm();
    if (upright > best) best = upright, top = f;
  }
  ZoneNodes turned;
  for (int c = 0; c < 4; ++c) {
    const int corner = zone_faces[top][c];
    turned[c + 4] = zone[corner], turned[c] = zone[across(corner, face_axis[top])];
  }
  return turned;
}

bool is_before(const Vec3& a, const Vec3& b) {
  return std::lexicographical_compare(a.data(), a.data() + 3, b.data(), b.data() + 3);
}

// Chains of things of which each has at most one above and one below, from their lowest up; closed ones are cut.
std::vector<std::vector<std::int32_t>> chains(const std::vector<std::int32_t>& above,
                                              const std::vector<std::int32_t>& below) {
  std::vector<std::vector<std::int32_t>> all;
  std::vector<char> is_taken(above.size(), 0);
  const auto follow = [&](std::int32_t first) {
    std::vector<std::int32_t> chain;
    for (std::int32_t i = first; i >= 0 && !is_taken[i]; i = above[i]) chain.push_back(i), is_taken[i] = 1;
    all.push_back(std::move(chain));
  };
  const auto count = static_cast<std::int32_t>(above.size());
  for (std::int32_t i = 0; i < count; ++i)
    if (below[i] < 0) follow(i);
  for (std::int32_t i = 0; i < count; ++i)
    if (!is_taken[i]) follow(i);
  return all;
}

// Cuthill & McKee: breadth first from an outermost one, neighbours with few neighbours first; ties by number.
std::vector<std::int32_t> walk(const std::vector<std::vector<std::int32_t>>& neighbours) {
  const std::size_t count = neighbours.size();
  std::vector<std::int32_t> order, seen_in(count, -1);
  std::int32_t round = 0;
  std::vector<char> is_done(count, 0);
  const auto degree = [&](std::int32_t i) { return neighbours[i].size(); };
  const auto from = [&](std::int32_t first) {
    std::vector<std::int32_t> queue = {first};
    seen_in[first] = round;
    for (std::size_t at = 0; at < queue.size(); ++at) {
      std::vector<std::int32_t> next;
      for (const std::int32_t n : neighbours[queue[at]])
        if (seen_in[n] != round) seen_in[n] = round, next.push_back(n);
      std::sort(next.begin(), next.end(),
                [&](std::int32_t a, std::int32_t b) { return degree(a) != degree(b) ? degree(a) < degree(b) : a < b; });
      queue.insert(queue.end(), next.begin(), next.end());
    }
    ++round;
    return queue;
  };
  constexpr int looks_outwards = 2;  // each from the end of the last: near enough to the longest way across
  for (std::size_t i = 0; i < count; ++i) {
    if (is_done[i]) continue;
    auto first = static_cast<std::int32_t>(i);
    for (int look = 0; look < looks_outwards; ++look) first = from(first).back();
    for (const std::int32_t n : from(first)) order.push_back(n), is_done[n] = 1;
  }
  return order;
}

// Zones beside each other have one level. Where that would put a zone and the one on it into the same level, there are no
// levels to speak of, and bands of equal height stand in for them.
std::vector<std::int32_t> levels_of(const Vec3s& node, const std::vector<ZoneNodes>& zones,
                                    const std::vector<std::int32_t>& above, const std::vector<ZoneFace>& faces,
                                    std::int32_t longest_column) {
  Bodies bodies(zones.size());
  for_each_place(faces, [&](const ZoneFace* face, std::size_t count) {
    if (count == 2 && face[0].face > top_face && face[1].face > top_face) bodies.join(face[0].zone, face[1].zone);
  });
  std::vector<double> height(zones.size(), 0);
  for (std::size_t z = 0; z < zones.size(); ++z)
    for (const std::int32_t n : zones[z]) height[z] += node[n].z() / 8;
  std::map<std::int32_t, std::pair<double, double>> sum_and_count;
  bool has_levels = true;
  for (std::size_t z = 0; z < zones.size(); ++z) {
    auto& [sum, count] = sum_and_count[bodies.root(static_cast<std::int32_t>(z))];
    sum += height[z], ++count;
    if (above[z] >= 0 && bodies.root(above[z]) == bodies.root(static_cast<std::int32_t>(z))) has_levels = false;
  }
  std::vector<std::int32_t> level(zones.size());
  if (has_levels && sum_and_count.size() <= static_cast<std::size_t>(longest_column)) {
    std::vector<std::pair<double, std::int32_t>> by_height;
    for (const auto& [body, mean] : sum_and_count) by_height.emplace_back(mean.first / mean.second, body);
    std::sort(by_height.begin(), by_height.end());
    std::map<std::int32_t, std::int32_t> number;
    for (const auto& [z, body] : by_height) number.emplace(body, static_cast<std::int32_t>(number.size()));
    for (std::size_t z = 0; z < zones.size(); ++z) level[z] = number[bodies.root(static_cast<std::int32_t>(z))];
    return level;
  }
  const auto [low, high] = std::minmax_element(height.begin(), height.end());
  const double band = (*high - *low) / std::max(1, longest_column - 1);
  for (std::size_t z = 0; z < zones.size(); ++z)
    level[z] = band > 0 ? static_cast<std::int32_t>(std::lround((height[z] - *low) / band)) : 0;
  return level;
}

}  // namespace

ColumnOrder order_by_columns(const Vec3s& node, const std::vector<ZoneNodes>& zones) {
  std::vector<ZoneNodes> upright;
  for (const ZoneNodes& zone : zones) upright.push_back(turned_upright(node, zone));

  // Columns of nodes, by the position of their lowest.
  std::vector<std::int32_t> node_above(node.size(), -1), node_below(node.size(), -1);
  for (const ZoneNodes& zone : upright)
    for (int c = 0; c < 4; ++c) {
      const std::int32_t lower = zone[c], upper = zone[c + 4];
      if (node_above[lower] < 0 && node_below[upper] < 0) node_above[lower] = upper, node_below[upper] = lower;
    }
  std::vector<std::vector<std::int32_t>> column = chains(node_above, node_below);
  std::sort(column.begin(), column.end(), [&](const auto& a, const auto& b) {
    return is_before(node[a.front()], node[b.front()]) ||
           (!is_before(node[b.front()], node[a.front()]) && a.front() < b.front());
  });
  std::vector<std::int32_t> column_of(node.size());
  for (std::size_t c = 0; c < column.size(); ++c)
    for (const std::int32_t n : column[c]) column_of[n] = static_cast<std::int32_t>(c);
  std::vector<std::vector<std::int32_t>> neighbours(column.size());
  for (const ZoneNodes& zone : upright)
    for (const std::int32_t a : zone)
      for (const std::int32_t b : zone)
        if (column_of[a] != column_of[b]) neighbours[column_of[a]].push_back(column_of[b]);
  for (auto& list : neighbours) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }

  ColumnOrder order;
  std::vector<std::int32_t> new_node(node.size());
  for (const std::int32_t c : walk(neighbours))
    for (const std::int32_t n : column[c]) {
      new_node[n] = static_cast<std::int32_t>(order.node.size());
      order.node.push_back(n);
    }

  // Zones in new numbers, their first corner the lowest of the bottom's.
  for (ZoneNodes& zone : upright) {
    for (std::int32_t& n : zone) n = new_node[n];
    const auto first = std::min_element(zone.begin(), zone.begin() + 4) - zone.begin();
    std::rotate(zone.begin(), zone.begin() + first, zone.begin() + 4);
    std::rotate(zone.begin() + 4, zone.begin() + 4 + first, zone.end());
  }
  const std::vector<ZoneFace> faces = sorted_faces(upright);
  std::vector<std::int32_t> above(zones.size(), -1), below(zones.size(), -1);
  for_each_place(faces, [&](const ZoneFace* face, std::size_t count) {
    if (count != 2) return;
    const ZoneFace& a = face[0].face == top_face ? face[0] : face[1];
    const ZoneFace& b = face[0].face == top_face ? face[1] : face[0];
    if (a.face == top_face && b.face == bottom_face) above[a.zone] = b.zone, below[b.zone] = a.zone;
  });
  std::vector<std::vector<std::int32_t>> columns = chains(above, below);
  std::sort(columns.begin(), columns.end(),
            [&](const auto& a, const auto& b) { return upright[a.front()] < upright[b.front()]; });
  for (const auto& chain : columns) {
    order.longest_column = std::max(order.longest_column, static_cast<std::int32_t>(chain.size()));
    order.zone.insert(order.zone.end(), chain.begin(), chain.end());
  }
  Vec3s new_position;
  for (const std::int32_t n : order.node) new_position.push_back(node[n]);
  const std::vector<std::int32_t> level = levels_of(new_position, upright, above, faces, order.longest_column);
  for (const std::int32_t z : order.zone) order.zones.push_back(upright[z]), order.level.push_back(level[z]);
  return order;
}

}  // namespace lockstep::continuum
