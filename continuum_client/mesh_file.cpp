#include "continuum_client/mesh_file.hpp"

#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <unordered_map>
#include <utility>

#include "common/checks.hpp"
#include "common/shape_functions.hpp"
#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/constants.hpp"
#include "continuum_client/mesh_input.hpp"
#include "continuum_client/mesh_numbering.hpp"

namespace lockstep::continuum {
namespace {

std::string place(const Vec3& x) { return fmt::format("({:.6g}, {:.6g}, {:.6g}) m", x.x(), x.y(), x.z()); }

// Faults of one kind: a few are named, all are counted.
class Faults {
 public:
  void add(const std::string& text) {
    if (count_++ < named_faults) named_.push_back(text);
  }
  std::size_t count() const { return count_; }
  // "FILE: 17 zones WHAT: zone 3 around ..., ... and 12 more; REMEDY"
  void report(const std::string& name, const std::string& what, const std::string& remedy) const {
    if (count_ == 0) return;
    throw InputError(fmt::format("{}: {} {}: {}{}; {}", name, count_, what, fmt::join(named_, ", "),
                                 count_ > named_.size() ? fmt::format(" and {} more", count_ - named_.size()) : "",
                                 remedy));
  }

 private:
  std::size_t count_ = 0;
  std::vector<std::string> named_;
};

// Things by the cube that they are in.
class Cubes {
 public:
  Cubes(const Vec3& low, double side) : low_(low), side_(side) {}

  using Cube = std::array<std::int64_t, 3>;
  Cube cube(const Vec3& x) const {
    Cube c;
    for (int k = 0; k < 3; ++k) c[k] = static_cast<std::int64_t>(std::floor((x[k] - low_[k]) / side_));
    return c;
  }
  void add(const Vec3& x, std::int32_t thing) { things_[cube(x)].push_back(thing); }
  // The number of cubes between two corners.
  static double count(const Cube& first, const Cube& last) {
    double n = 1;
    for (int k = 0; k < 3; ++k) n *= static_cast<double>(last[k] - first[k] + 1);
    return n;
  }
  template <class Visit>
  void visit(const Cube& first, const Cube& last, const Visit& visit) const {
    for (std::int64_t i = first[0]; i <= last[0]; ++i)
      for (std::int64_t j = first[1]; j <= last[1]; ++j)
        for (std::int64_t k = first[2]; k <= last[2]; ++k)
          if (const auto found = things_.find({i, j, k}); found != things_.end())
            for (const std::int32_t thing : found->second) visit(thing);
  }

 private:
  struct CubeHash {
    std::size_t operator()(const Cube& c) const {
      std::uint64_t h = 0;
      for (const std::int64_t k : c) h = (h ^ static_cast<std::uint64_t>(k)) * 0x9e3779b97f4a7c15u, h ^= h >> 29;
      return h;
    }
  };
  Vec3 low_;
  double side_;
  std::unordered_map<Cube, std::vector<std::int32_t>, CubeHash> things_;
};

// Where a point lies on the bilinear facet next to it: within `slack` of its inside, and how far off [m].
bool lies_on(const FacetCorners& corners, const Vec3& x, double slack, double distance) {
  double xi = 0, eta = 0;
  constexpr int rounds =
      12;  // of Gauss and Newton, whose error falls to round-off in five on faces that are not refused
  const auto clamp = [](double value) { return std::clamp(value, -2.0, 2.0); };
  Vec3 off = Vec3::Zero();
  for (int round = 0; round < rounds; ++round) {
    Vec3 at = Vec3::Zero(), along_xi = Vec3::Zero(), along_eta = Vec3::Zero();
    constexpr int sign[4][2] = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};
    for (int c = 0; c < 4; ++c) {
      const double s = sign[c][0], t = sign[c][1];
      at += (1 + s * xi) * (1 + t * eta) / 4 * corners[c];
      along_xi += s * (1 + t * eta) / 4 * corners[c];
      along_eta += t * (1 + s * xi) / 4 * corners[c];
    }
    off = x - at;
    const double aa = along_xi.squaredNorm(), ab = along_xi.dot(along_eta), bb = along_eta.squaredNorm();
    const double det = aa * bb - ab * ab;
    if (!(det > 0)) return false;
    const double a = along_xi.dot(off), b = along_eta.dot(off);
    xi = clamp(xi + (bb * a - ab * b) / det), eta = clamp(eta + (aa * b - ab * a) / det);
  }
  return std::abs(xi) <= 1 + slack && std::abs(eta) <= 1 + slack && off.norm() <= distance;
}

class FileGrid {
 public:
  explicit FileGrid(const FileMeshSettings& settings)
      : settings_(settings), name_(settings.path.string()), mesh_(read_mesh(settings.path, settings.cell_array)) {}

  Grid build() {
    place_nodes();
    check_nodes_apart();
    drop_unused_nodes();
    check_zones_differ();
    check_shapes();
    check_neighbours();
    number();
    find_groups();
    find_outer_faces();
    find_interface();
    if (settings_.hole) check_hole(*settings_.hole);
    spdlog::info(
        "{}: {}, {} zones, {} nodes, {} facets of the interface; worst scaled Jacobian {:.3g}, zone {}; longest "
        "column {} zones",
        name_, mesh_.what, grid_.zone_count(), grid_.node_count(), grid_.facet.size(), worst_jacobian_, worst_zone_,
        longest_column_);
    return std::move(grid_);
  }

 private:
  // ----------------------------------------------------------------------------------------------------- checks

  Vec3 center(const FileMesh::Zone& zone) const {
    Vec3 sum = Vec3::Zero();
    for (const std::int32_t n : zone.node) sum += mesh_.node[n];
    return sum / 8;
  }
  std::string words(const FileMesh::Zone& zone) const {
    return fmt::format("zone {} around {}", zone.number, place(center(zone)));
  }
  std::string words(std::size_t z) const { return words(mesh_.zone[z]); }

  void place_nodes() {
    constexpr double largest_coordinate = 1e9;  // [m]
    for (std::size_t i = 0; i < mesh_.node.size(); ++i) {
      Vec3& x = mesh_.node[i];
      x = settings_.scale * x + settings_.shift;
      if (!(x.cwiseAbs().maxCoeff() <= largest_coordinate))
        throw InputError(fmt::format("{}: node {} lies at {}; coordinates must be within {:g} m: choose another scale",
                                     name_, mesh_.node_number[i], place(x), largest_coordinate));
    }
  }

  void find_box() {
    grid_.low = grid_.high = mesh_.node[mesh_.zone.front().node[0]];
    for (const FileMesh::Zone& zone : mesh_.zone)
      for (const std::int32_t n : zone.node)
        grid_.low = grid_.low.cwiseMin(mesh_.node[n]), grid_.high = grid_.high.cwiseMax(mesh_.node[n]);
    size_ = (grid_.high - grid_.low).maxCoeff();
    if (!(size_ > 0))
      throw InputError(
          fmt::format("{}: all its zones lie in one point, {}; write the mesh anew", name_, place(grid_.low)));
  }

  std::vector<char> used_nodes() const {
    std::vector<char> is_used(mesh_.node.size(), 0);
    for (const FileMesh::Zone& zone : mesh_.zone)
      for (const std::int32_t n : zone.node) is_used[n] = 1;
    return is_used;
  }

  // Of nodes in one place the first stands for all, where merge_distance asks for it.
  void check_nodes_apart() {
    find_box();
    const double apart = std::max(settings_.merge_distance, coincidence_tolerance * size_);
    const std::vector<char> is_used = used_nodes();
    Cubes cubes(grid_.low, apart);
    std::vector<std::int32_t> stands_for(mesh_.node.size());
    Faults faults;
    for (std::size_t i = 0; i < mesh_.node.size(); ++i) {
      stands_for[i] = static_cast<std::int32_t>(i);
      if (!is_used[i]) continue;
      Cubes::Cube first = cubes.cube(mesh_.node[i]), last = first;
      for (int k = 0; k < 3; ++k) --first[k], ++last[k];
      std::int32_t& lowest = stands_for[i];
      cubes.visit(first, last, [&](std::int32_t other) {
        if ((mesh_.node[other] - mesh_.node[i]).norm() <= apart) lowest = std::min(lowest, other);
      });
      if (lowest == static_cast<std::int32_t>(i))
        cubes.add(mesh_.node[i], lowest);
      else
        faults.add(
            fmt::format("{} and {} at {}", mesh_.node_number[lowest], mesh_.node_number[i], place(mesh_.node[i])));
    }
    if (settings_.merge_distance > 0) {
      if (faults.count() > 0)
        spdlog::info("{}: {} nodes merged into others within {:g} m", name_, faults.count(), apart);
      for (FileMesh::Zone& zone : mesh_.zone)
        for (std::int32_t& n : zone.node) n = stands_for[n];
      for (FileMesh::Face& face : mesh_.face)
        for (std::int32_t& n : face.node) n = stands_for[n];
      return;
    }
    faults.report(
        name_, "pairs of nodes are in one place, so that their zones are not joined",
        fmt::format("join them in the mesher (in Gmsh: Coherence), or give {}.merge_distance", settings_.where));
  }

  void drop_unused_nodes() {
    const std::vector<char> is_used = used_nodes();
    std::vector<std::int32_t> place_of(mesh_.node.size(), -1);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < mesh_.node.size(); ++i) {
      if (!is_used[i]) continue;
      place_of[i] = static_cast<std::int32_t>(kept);
      mesh_.node[kept] = mesh_.node[i], mesh_.node_number[kept] = mesh_.node_number[i];
      ++kept;
    }
    if (kept < mesh_.node.size())
      spdlog::info("{}: {} nodes belong to no zone and are left out", name_, mesh_.node.size() - kept);
    mesh_.node.resize(kept), mesh_.node_number.resize(kept);
    for (FileMesh::Zone& zone : mesh_.zone)
      for (std::int32_t& n : zone.node) n = place_of[n];
    std::erase_if(mesh_.face, [&](FileMesh::Face& face) {
      for (std::int32_t& n : face.node) n = place_of[n];
      return std::find(face.node.begin(), face.node.end(), -1) != face.node.end();
    });
    find_box();
  }

  void check_zones_differ() {
    std::vector<std::pair<ZoneNodes, std::size_t>> sorted;
    Faults collapsed, twice;
    for (std::size_t z = 0; z < mesh_.zone.size(); ++z) {
      ZoneNodes nodes = mesh_.zone[z].node;
      std::sort(nodes.begin(), nodes.end());
      if (std::adjacent_find(nodes.begin(), nodes.end()) != nodes.end()) collapsed.add(words(z));
      sorted.emplace_back(nodes, z);
    }
    collapsed.report(name_, "zones have a node twice (collapsed hexahedra)",
                     "zones need eight nodes: mesh without wedges and pyramids, or with a smaller merge_distance");
    std::sort(sorted.begin(), sorted.end());
    for (std::size_t i = 1; i < sorted.size(); ++i)
      if (sorted[i].first == sorted[i - 1].first)
        twice.add(fmt::format("{} and zone {}", words(sorted[i - 1].second), mesh_.zone[sorted[i].second].number));
    twice.report(name_, "zones are there twice",
                 "write each zone once; MSH 2.2 repeats the elements that are in two physical groups: write MSH 4.1");
  }

  // Per corner: the volume of the directions of its three edges.
  std::array<double, 8> scaled_jacobians(const ZoneNodes& zone) const {
    // The other ends of a corner's edges along x, y and z of the cube.
    constexpr int next[8][3] = {{1, 3, 4}, {0, 2, 5}, {3, 1, 6}, {2, 0, 7}, {5, 7, 0}, {4, 6, 1}, {7, 5, 2}, {6, 4, 3}};
    std::array<double, 8> scaled;
    for (int a = 0; a < 8; ++a) {
      std::array<Vec3, 3> edge;
      double lengths = 1;
      for (int c = 0; c < 3; ++c) {
        edge[c] = node_at[a][c] * (mesh_.node[zone[a]] - mesh_.node[zone[next[a][c]]]);
        lengths *= edge[c].norm();
      }
      scaled[a] = lengths > 0 ? edge[0].cross(edge[1]).dot(edge[2]) / lengths : 0.0;
    }
    return scaled;
  }

  void check_shapes() {
    std::size_t mirrored = 0;
    for (const FileMesh::Zone& zone : mesh_.zone) {
      const std::array<double, 8> j = scaled_jacobians(zone.node);
      mirrored += *std::max_element(j.begin(), j.end()) < 0 ? 1 : 0;
    }
    if (mirrored == mesh_.zone.size()) {
      spdlog::info("{}: all {} zones have their nodes in mirrored order; they are turned round", name_, mirrored);
      for (FileMesh::Zone& zone : mesh_.zone)
        std::swap_ranges(zone.node.begin(), zone.node.begin() + 4, zone.node.begin() + 4);
    }
    Faults inverted, flat, sharp, warped;
    for (const FileMesh::Zone& zone : mesh_.zone) {
      const std::array<double, 8> j = scaled_jacobians(zone.node);
      const double worst = *std::min_element(j.begin(), j.end());
      if (worst < worst_jacobian_) worst_jacobian_ = worst, worst_zone_ = zone.number;
      if (worst < -flat_corner) {
        inverted.add(words(zone));
      } else if (worst < flat_corner) {
        flat.add(words(zone));
      } else if (worst < least_scaled_jacobian) {
        sharp.add(fmt::format("{} ({:.3g})", words(zone), worst));
      } else if (const double cosine = worst_face_cosine(zone.node); cosine < least_face_cosine) {
        warped.add(
            fmt::format("{} ({:.0f} degrees)", words(zone), std::acos(std::clamp(cosine, -1.0, 1.0)) * 180 / pi));
      }
    }
    inverted.report(
        name_, "zones are turned inside out at a corner",
        "order their nodes as VTK's hexahedron has them, bottom face counter-clockwise seen from above and then the "
        "top face, or move nodes apart in the mesher");
    flat.report(name_, "zones are flat at a corner, or have an edge without length", "move nodes apart in the mesher");
    sharp.report(name_,
                 fmt::format("zones are too warped (smallest scaled Jacobian of a corner, 1 for a brick; at least {})",
                             least_scaled_jacobian),
                 "smooth the mesh, or use smaller zones there");
    warped.report(name_,
                  fmt::format("zones have a face that is too warped (angle between a corner's normal and the face's "
                              "mean one; at most {:.0f} degrees)",
                              std::acos(least_face_cosine) * 180 / pi),
                  "smooth the mesh, or use smaller zones there");
  }

  double worst_face_cosine(const ZoneNodes& zone) const {
    double worst = 1;
    for (int f = 0; f < 6; ++f) {
      const std::array<std::int32_t, 4> n = face_nodes(zone, f);
      const auto& x = mesh_.node;
      const Vec3 mean = (x[n[2]] - x[n[0]]).cross(x[n[3]] - x[n[1]]);
      for (int c = 0; c < 4; ++c) {
        const Vec3 normal = (x[n[(c + 1) % 4]] - x[n[c]]).cross(x[n[(c + 3) % 4]] - x[n[c]]);
        const double lengths = normal.norm() * mean.norm();
        worst = std::min(worst, lengths > 0 ? normal.dot(mean) / lengths : -1.0);
      }
    }
    return worst;
  }

  std::vector<ZoneNodes> zone_nodes() const {
    std::vector<ZoneNodes> zones;
    for (const FileMesh::Zone& zone : mesh_.zone) zones.push_back(zone.node);
    return zones;
  }

  void check_neighbours() {
    const std::vector<ZoneFace> faces = sorted_faces(zone_nodes());
    Bodies bodies(mesh_.zone.size());
    Faults shared;
    for_each_place(faces, [&](const ZoneFace* face, std::size_t count) {
      if (count > 2) {
        std::vector<std::int64_t> numbers;
        for (std::size_t i = 0; i < count; ++i) numbers.push_back(mesh_.zone[face[i].zone].number);
        shared.add(
            fmt::format("zones {} beside {}", fmt::join(numbers, ", "), words(static_cast<std::size_t>(face->zone))));
      }
      for (std::size_t i = 1; i < count; ++i) bodies.join(face[0].zone, face[i].zone);
      if (count == 1) single_faces_.push_back(*face);
    });
    shared.report(name_, "faces belong to three zones or more", "zones overlap there: mend the mesh in the mesher");
    check_hanging_nodes();
    std::map<std::int32_t, std::size_t> size;
    for (std::size_t z = 0; z < mesh_.zone.size(); ++z) ++size[bodies.root(static_cast<std::int32_t>(z))];
    const auto largest =
        std::max_element(size.begin(), size.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
    Faults loose;
    for (const auto& [root, count] : size)
      if (root != largest->first)
        loose.add(fmt::format("{} zones with {}", count, words(static_cast<std::size_t>(root))));
    loose.report(
        name_, fmt::format("bodies share no face with the other {} zones", largest->second),
        fmt::format("join them in the mesher (in Gmsh: Coherence), or give {}.merge_distance", settings_.where));
  }

  // On a face that only one zone has, nodes of other zones may lie: those meet without being joined.
  void check_hanging_nodes() {
    std::set<std::int32_t> nodes;
    double edges = 0;
    for (const ZoneFace& face : single_faces_) {
      nodes.insert(face.key.begin(), face.key.end());
      edges += std::sqrt(facet_area_vector(corners(face)).norm());
    }
    const double side = edges / static_cast<double>(std::max<std::size_t>(1, single_faces_.size()));
    if (!(side > 0)) return;
    Cubes cubes(grid_.low, side);
    for (const std::int32_t n : nodes) cubes.add(mesh_.node[n], n);
    Faults faults;
    std::set<std::int32_t> named;
    for (const ZoneFace& face : single_faces_) {
      const FacetCorners x = corners(face);
      Vec3 low = x[0], high = x[0];
      for (const Vec3& corner : x) low = low.cwiseMin(corner), high = high.cwiseMax(corner);
      const double distance = hanging_tolerance * (high - low).norm();
      const auto look = [&](std::int32_t n) {
        const Vec3& p = mesh_.node[n];
        if ((p - low).minCoeff() < -distance || (high - p).minCoeff() < -distance) return;
        if (std::binary_search(face.key.begin(), face.key.end(), n) || named.count(n)) return;
        if (!lies_on(x, p, hanging_tolerance, distance)) return;
        named.insert(n);
        faults.add(fmt::format("node {} at {} on {}", mesh_.node_number[n], place(p),
                               words(static_cast<std::size_t>(face.zone))));
      };
      const Cubes::Cube first = cubes.cube(low - Vec3::Constant(distance)),
                        last = cubes.cube(high + Vec3::Constant(distance));
      if (Cubes::count(first, last) < static_cast<double>(nodes.size()))
        cubes.visit(first, last, look);
      else
        std::for_each(nodes.begin(), nodes.end(), look);
    }
    faults.report(name_, "nodes lie on the face or edge of a zone that does not have them (hanging nodes)",
                  "zones must meet face to face: mesh both sides with the same divisions");
  }

  FacetCorners corners(const ZoneFace& face) const {
    const std::array<std::int32_t, 4> n = face_nodes(mesh_.zone[face.zone].node, face.face);
    return {mesh_.node[n[0]], mesh_.node[n[1]], mesh_.node[n[2]], mesh_.node[n[3]]};
  }

  // ------------------------------------------------------------------------------------------------------- grid

  void number() {
    ColumnOrder order = order_by_columns(mesh_.node, zone_nodes());
    std::vector<std::int32_t> new_node(mesh_.node.size());
    for (const std::int32_t n : order.node) {
      new_node[n] = static_cast<std::int32_t>(grid_.node.size());
      grid_.node.push_back(mesh_.node[n]);
    }
    for (FileMesh::Face& face : mesh_.face)
      for (std::int32_t& n : face.node) n = new_node[n];
    grid_.zone = std::move(order.zones), grid_.level = std::move(order.level);
    longest_column_ = order.longest_column;
    for (const std::int32_t z : order.zone) source_.push_back(mesh_.zone[z]);
  }

  bool answers(std::int32_t group, const std::string& word) const {
    const auto& words = mesh_.groups[group];
    return std::find(words.begin(), words.end(), word) != words.end();
  }

  // Groups that zones or faces are in, for messages.
  template <class Parts>
  std::string groups_of(const Parts& parts) const {
    std::set<std::int32_t> used;
    for (const auto& part : parts)
      if (part.group > 0) used.insert(part.group);
    std::set<std::string> words;
    for (const std::int32_t g : used) words.insert(fmt::format("{}", fmt::join(mesh_.groups[g], " = ")));
    if (words.empty())
      return mesh_.cell_arrays.empty()
                 ? "none"
                 : fmt::format("none; its cell arrays are {}", fmt::join(mesh_.cell_arrays, ", "));
    return fmt::format("{}", fmt::join(words, ", "));
  }

  template <class Parts>
  void demand_group(const std::string& word, const std::string& key, const char* what, const Parts& parts) const {
    for (const auto& part : parts)
      if (answers(part.group, word)) return;
    throw InputError(fmt::format("{}.{} names \"{}\", but {} has no {} in such a group; its groups are: {}",
                                 settings_.where, key, word, name_, what, groups_of(parts)));
  }

  void find_groups() {
    grid_.in_discrete_domain.assign(grid_.zone_count(), 0);
    grid_.material.assign(grid_.zone_count(), 0);
    for (const std::string& word : settings_.discrete_domain) demand_group(word, "discrete_domain", "zones", source_);
    for (const auto& region : settings_.regions) demand_group(region.name, "region.name", "zones", source_);
    for (std::size_t z = 0; z < grid_.zone_count(); ++z) {
      const std::int32_t group = source_[z].group;
      for (const std::string& word : settings_.discrete_domain)
        if (answers(group, word)) grid_.in_discrete_domain[z] = 1;
      const FileMeshSettings::Region* last = nullptr;
      for (const auto& region : settings_.regions) {
        if (!answers(group, region.name)) continue;
        if (last)
          throw InputError(
              fmt::format("{}.region: zone {} is in the regions \"{}\" and \"{}\"; give each zone one material",
                          settings_.where, source_[z].number, last->name, region.name));
        last = &region;
        grid_.material[z] = region.material;
      }
    }
    const auto deleted = std::count(grid_.in_discrete_domain.begin(), grid_.in_discrete_domain.end(), 1);
    if (static_cast<std::size_t>(deleted) == grid_.zone_count())
      throw InputError(fmt::format("{}.discrete_domain takes all {} zones; the ground needs some that stay",
                                   settings_.where, deleted));
  }

  enum class Side { Plane, Top, Other };

  // Sides and bottom are planes; of the rest the top looks up.
  Side side_of(const std::array<std::int32_t, 4>& face) const {
    const double tolerance = plane_tolerance * size_;
    for (int plane = 0; plane < 5; ++plane) {
      const int axis = plane / 2;
      const double at = plane % 2 == 0 ? grid_.low[axis] : grid_.high[axis];
      bool is_on = true;
      for (const std::int32_t n : face) is_on &= std::abs(grid_.node[n][axis] - at) <= tolerance;
      if (is_on) return Side::Plane;
    }
    const Vec3 area = area_vector(face);
    constexpr double upwards = 0.01;  // of the normal: walls that lean by more than half a degree are slopes
    return area.z() > upwards * area.norm() ? Side::Top : Side::Other;
  }

  Vec3 area_vector(const std::array<std::int32_t, 4>& face) const {
    return facet_area_vector({grid_.node[face[0]], grid_.node[face[1]], grid_.node[face[2]], grid_.node[face[3]]});
  }
  Vec3 middle(const std::array<std::int32_t, 4>& face) const {
    return 0.25 * (grid_.node[face[0]] + grid_.node[face[1]] + grid_.node[face[2]] + grid_.node[face[3]]);
  }

  void find_outer_faces() {
    std::set<std::array<std::int32_t, 4>> named;
    for (const std::string& word : settings_.interface) demand_group(word, "interface", "quadrilaterals", mesh_.face);
    for (FileMesh::Face& face : mesh_.face) {
      std::sort(face.node.begin(), face.node.end());
      for (const std::string& word : settings_.interface)
        if (answers(face.group, word)) named.insert(face.node);
    }
    Faults faults;
    const bool deletes = !settings_.discrete_domain.empty();
    for (const OuterFace& face : outer_faces(grid_, {})) {
      std::array<std::int32_t, 4> key = face.node;
      std::sort(key.begin(), key.end());
      const bool is_named = named.erase(key) > 0;
      const Side side = side_of(face.node);
      if (side == Side::Other && !is_named)
        faults.add(fmt::format("of zone {} at {}", source_[face.zone].number, place(middle(face.node))));
      if (is_named || (!deletes && settings_.interface.empty() && side == Side::Top)) add_facet(face.node);
    }
    if (!named.empty())
      throw InputError(
          fmt::format("{}.interface: {} of its quadrilaterals are no outer faces of a zone, such as the one at {}; "
                      "name a surface of the volume",
                      settings_.where, named.size(), place(middle(*named.begin()))));
    if (settings_.has_free_faces) return;
    faults.report(
        name_,
        fmt::format("outer faces are neither on the sides x = {:.6g}, {:.6g}, y = {:.6g}, {:.6g} m nor on the bottom "
                    "z = {:.6g} m, nor do they look up",
                    grid_.low.x(), grid_.high.x(), grid_.low.y(), grid_.high.y(), grid_.low.z()),
        fmt::format(
            "supports hold the planes of a brick alone: turn the mesh into the axes and make its sides plane to "
            "{:.0g} of its size, or give {}.free_faces: true where such faces are meant to be free",
            plane_tolerance, settings_.where));
  }

  // Its edge 0 1 is the lowest that runs across, so that the second direction of a side's facet points up.
  void add_facet(std::array<std::int32_t, 4> face) {
    const auto height = [&](int c) { return grid_.node[face[c]].z() + grid_.node[face[(c + 1) % 4]].z(); };
    int lowest = 0;
    for (int c = 1; c < 4; ++c)
      if (height(c) < height(lowest)) lowest = c;
    std::rotate(face.begin(), face.begin() + lowest, face.end());
    grid_.facet.push_back(face);
  }

  void find_interface() {
    if (!settings_.discrete_domain.empty()) {
      std::vector<std::pair<std::int32_t, std::int32_t>> place_of;
      for_each_place(sorted_faces(grid_.zone), [&](const ZoneFace* face, std::size_t count) {
        if (count != 2) return;
        for (std::size_t i = 0; i < 2; ++i)
          if (!grid_.in_discrete_domain[face[i].zone] && grid_.in_discrete_domain[face[1 - i].zone])
            place_of.emplace_back(face[i].zone, face[i].face);
      });
      std::sort(place_of.begin(), place_of.end());
      for (const auto& [zone, face] : place_of) add_facet(face_nodes(grid_.zone[zone], face));
    }
    if (grid_.facet.empty())
      throw InputError(
          fmt::format("{}: {} has no face that the grains could touch; name the discrete_domain or the interface",
                      settings_.where, name_));
    number_rings();
    // By ring from the top down, the bottom last, as the built-in meshes have them.
    std::vector<std::size_t> order(grid_.facet.size());
    for (std::size_t f = 0; f < order.size(); ++f) order[f] = f;
    const auto rank = [&](std::size_t f) {
      return grid_.ring[f] < 0 ? std::numeric_limits<std::int32_t>::max() : grid_.ring[f];
    };
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return rank(a) < rank(b); });
    const auto facet = grid_.facet;
    const auto ring = grid_.ring;
    for (std::size_t f = 0; f < order.size(); ++f) grid_.facet[f] = facet[order[f]], grid_.ring[f] = ring[order[f]];
  }

  void number_rings() {
    const std::size_t count = grid_.facet.size();
    grid_.ring.assign(count, -1);
    Bodies bodies(count);
    std::map<std::array<std::int32_t, 2>, std::int32_t> facet_at;  // by upright edge
    std::vector<char> is_side(count, 0);
    for (std::size_t f = 0; f < count; ++f) {
      const Vec3 area = area_vector(grid_.facet[f]);
      is_side[f] = area.z() <= std::hypot(area.x(), area.y()) ? 1 : 0;
      if (!is_side[f]) continue;
      for (const int c : {1, 3}) {
        std::array<std::int32_t, 2> edge = {grid_.facet[f][c], grid_.facet[f][(c + 1) % 4]};
        std::sort(edge.begin(), edge.end());
        const auto [found, is_new] = facet_at.emplace(edge, static_cast<std::int32_t>(f));
        if (!is_new) bodies.join(found->second, static_cast<std::int32_t>(f));
      }
    }
    std::map<std::int32_t, std::pair<double, double>> height;  // sum and count, by body
    for (std::size_t f = 0; f < count; ++f)
      if (is_side[f]) {
        auto& [sum, facets] = height[bodies.root(static_cast<std::int32_t>(f))];
        sum += middle(grid_.facet[f]).z(), ++facets;
      }
    std::vector<std::pair<double, std::int32_t>> from_top;
    for (const auto& [body, mean] : height) from_top.emplace_back(-mean.first / mean.second, body);
    std::sort(from_top.begin(), from_top.end());
    std::map<std::int32_t, std::int32_t> ring;
    for (const auto& [minus_height, body] : from_top) ring.emplace(body, static_cast<std::int32_t>(ring.size()));
    for (std::size_t f = 0; f < count; ++f)
      if (is_side[f]) grid_.ring[f] = ring[bodies.root(static_cast<std::int32_t>(f))];
  }

  // The grains' side packs this cylinder.
  void check_hole(const FileMeshSettings::Hole& hole) const {
    double nearest = std::numeric_limits<double>::infinity(), bottom = nearest, top = -nearest;
    for (std::size_t f = 0; f < grid_.facet.size(); ++f) {
      const Vec3 area = area_vector(grid_.facet[f]), at = middle(grid_.facet[f]);
      if (grid_.ring[f] < 0)
        bottom = std::min(bottom, at.z());
      else
        nearest = std::min(nearest, std::abs(at.dot(Vec3(area.x(), area.y(), 0).normalized())));
      for (const std::int32_t n : grid_.facet[f]) top = std::max(top, grid_.node[n].z());
    }
    const double tolerance = hole_tolerance * hole.diameter;
    const auto compare = [&](const char* what, double given, double found) {
      if (!(std::abs(given - found) <= tolerance))
        throw InputError(
            fmt::format("{}.hole: {} is {:.6g} m, but that of the interface in {} is {:.6g} m; give that one",
                        settings_.where, what, given, name_, found));
    };
    compare("diameter", hole.diameter, 2 * nearest);
    compare("depth", hole.depth, -bottom);
    if (!(std::abs(top) <= tolerance))
      throw InputError(
          fmt::format("{}.hole: it begins at z = 0, but the interface in {} reaches up to {:.6g} m; give a shift",
                      settings_.where, name_, top));
  }

  const FileMeshSettings& settings_;
  std::string name_;
  FileMesh mesh_;
  Grid grid_;
  double size_ = 0;  // [m]
  std::vector<ZoneFace> single_faces_;
  std::vector<FileMesh::Zone> source_;  // per zone of the grid
  double worst_jacobian_ = std::numeric_limits<double>::infinity();
  std::int64_t worst_zone_ = 0;
  std::int32_t longest_column_ = 0;
};

}  // namespace

Grid build_from_file(const FileMeshSettings& settings) { return FileGrid(settings).build(); }

}  // namespace lockstep::continuum
