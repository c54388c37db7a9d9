#include "continuum_client/grid_builder.hpp"

#include <algorithm>
#include <cmath>
#include <set>

#include "common/checks.hpp"
#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/constants.hpp"
#include "continuum_client/mesh_file.hpp"

namespace lockstep::continuum {
namespace {

// Positions 0 .. 1 of count + 1 points whose spacing grows by `growth` from one to the next:
// t_i = (growth^i - 1) / (growth^count - 1).
std::vector<double> graded(int count, double growth) {
  std::vector<double> t(count + 1);
  double spacing = 1;
  for (int i = 1; i <= count; ++i, spacing *= growth) t[i] = t[i - 1] + spacing;
  const double length = t[count];
  for (double& value : t) value /= length;
  t[count] = 1;
  return t;
}

void check_growth(const std::string& where, const std::string& growth_key, const std::string& count_key, double growth,
                  int count) {
  const double ratio = std::pow(growth, count - 1);
  if (!(ratio <= largest_size_ratio))
    throw InputError(
        fmt::format("{}: {} {:.4g} over {} {} makes the last zone {:.3g} times as large as the first (at most {:.0g}); "
                    "lower either",
                    where, growth_key, growth, count_key, count, ratio, largest_size_ratio));
}

// A horizontal plane of quadrilaterals that is extruded into zones.
struct Plane {
  std::vector<Eigen::Vector2d> point;
  std::vector<std::array<std::int32_t, 4>> quad;  // counter-clockwise seen from above
  std::vector<char> is_inside;                    // per quad: inside the hole
  std::vector<std::int32_t> circle;               // points on the hole's rim, counter-clockwise
};

Plane cylinder_plane(const CylinderMesh& m) {
  const int around = m.zones_around, side = around / 4, rings = std::max(1, side / core_zones_per_ring);
  const double radius = m.hole_diameter / 2, half_core = core_half_side * radius;
  Plane p;
  // The core: (side + 1)^2 points, row by row.
  for (int j = 0; j <= side; ++j)
    for (int i = 0; i <= side; ++i)
      p.point.emplace_back(half_core * (2.0 * i / side - 1), half_core * (2.0 * j / side - 1));
  for (int j = 0; j < side; ++j)
    for (int i = 0; i < side; ++i) {
      const int a = j * (side + 1) + i;
      p.quad.push_back({a, a + 1, a + side + 2, a + side + 1});
      p.is_inside.push_back(1);
    }
  // Its rim, counter-clockwise from the corner at -135 degrees.
  std::vector<std::int32_t> inner;
  for (int k = 0; k < around; ++k) {
    const int edge = k / side, step = k % side;
    const int i = edge == 0 ? step : edge == 1 ? side : edge == 2 ? side - step : 0;
    const int j = edge == 0 ? 0 : edge == 1 ? step : edge == 2 ? side : side - step;
    inner.push_back(j * (side + 1) + i);
  }
  // Layers of `around` quads, each from the last rim to the next.
  const auto add_layer = [&](const std::vector<Eigen::Vector2d>& next, bool is_inside) {
    const auto first = static_cast<std::int32_t>(p.point.size());
    std::vector<std::int32_t> outer;
    for (int k = 0; k < around; ++k) outer.push_back(first + k);
    p.point.insert(p.point.end(), next.begin(), next.end());
    for (int k = 0; k < around; ++k) {
      const int l = (k + 1) % around;
      p.quad.push_back({inner[k], outer[k], outer[l], inner[l]});
      p.is_inside.push_back(is_inside ? 1 : 0);
    }
    inner = std::move(outer);
  };
  // Circle and square are met by the same rays. One side is computed and turned by right angles, so that the mesh has
  // its fourfold symmetry to the last bit.
  std::vector<Eigen::Vector2d> core_rim, on_circle, on_square;
  for (int k = 0; k < around; ++k) {
    core_rim.push_back(p.point[inner[k]]);
    const int edge = k / side, step = k % side;
    const double from_middle =
        (pi / 4) * (2.0 * step / side - 1);  // angle from the middle of the edge, -45 .. 45 degrees
    const double s = std::sin(from_middle), c = std::cos(from_middle);
    const double t = step == 0 ? -1.0 : std::tan(from_middle);
    const auto turned = [&](double along, double out) {
      switch (edge) {
        case 0:
          return Eigen::Vector2d(along, -out);
        case 1:
          return Eigen::Vector2d(out, along);
        case 2:
          return Eigen::Vector2d(-along, out);
        default:
          return Eigen::Vector2d(-out, -along);
      }
    };
    on_circle.push_back(radius * turned(s, c));
    on_square.push_back(m.width / 2 * turned(t, 1));
  }
  const auto between = [&](const std::vector<Eigen::Vector2d>& a, const std::vector<Eigen::Vector2d>& b, double t) {
    std::vector<Eigen::Vector2d> layer;
    for (int k = 0; k < around; ++k) layer.push_back(t == 1 ? b[k] : Eigen::Vector2d((1 - t) * a[k] + t * b[k]));
    return layer;
  };
  for (int l = 1; l <= rings; ++l) add_layer(between(core_rim, on_circle, static_cast<double>(l) / rings), true);
  p.circle = inner;
  const std::vector<double> radial = graded(m.zones_radial, m.radial_growth);
  for (int l = 1; l <= m.zones_radial; ++l) add_layer(between(on_circle, on_square, radial[l]), false);
  return p;
}

// Columns of zones over each quad of the plane, and of nodes over each of its points, upwards.
void extrude(const Plane& plane, const std::vector<double>& height, Grid& grid) {
  const auto levels = static_cast<std::int32_t>(height.size());
  for (const auto& xy : plane.point)
    for (double z : height) grid.node.emplace_back(xy.x(), xy.y(), z);
  for (const auto& q : plane.quad)
    for (std::int32_t l = 0; l + 1 < levels; ++l) {
      std::array<std::int32_t, 8> zone;
      for (int c = 0; c < 4; ++c) zone[c] = q[c] * levels + l, zone[c + 4] = zone[c] + 1;
      grid.zone.push_back(zone);
      grid.level.push_back(l);
      grid.material.push_back(0);
    }
}

void add_horizontal_facet(const std::array<std::int32_t, 4>& quad, int level, int levels, Grid& grid) {
  std::array<std::int32_t, 4> facet;
  for (int c = 0; c < 4; ++c) facet[c] = quad[c] * levels + level;
  grid.facet.push_back(facet);
  grid.ring.push_back(-1);
}

// A zone is of the lowest layer whose top is above its centre.
void take_layers(const std::vector<Layer>& layers, Grid& grid) {
  if (layers.empty()) return;
  std::set<double> levels;
  for (const Vec3& x : grid.node) levels.insert(x.z());
  const double tolerance = layer_tolerance * grid.depth();
  for (const Layer& layer : layers) {
    const auto above = levels.lower_bound(layer.top);
    double nearest = above == levels.end() ? *levels.rbegin() : *above;
    if (above != levels.begin() && layer.top - *std::prev(above) < std::abs(nearest - layer.top))
      nearest = *std::prev(above);
    if (std::abs(nearest - layer.top) > tolerance && layer.top < grid.high.z())
      throw InputError(
          fmt::format("{}: its top at {} m lies inside zones; the nearest level of the mesh is at {:.6g} m",
                      layer.where, layer.top, nearest));
    if (layer.top <= grid.low.z() + tolerance)
      throw InputError(fmt::format("{}: its top at {} m is not above the bottom of the ground at {} m", layer.where,
                                   layer.top, grid.low.z()));
  }
  for (std::size_t z = 0; z < grid.zone_count(); ++z)
    for (const Layer& layer : layers)
      if (grid.zone_center(z).z() < layer.top) grid.material[z] = layer.material;
}

// A mesh from a file may have a level and zones that reach through it elsewhere.
void check_layers_cut_no_zone(const std::vector<Layer>& layers, const Grid& grid) {
  const double tolerance = layer_tolerance * grid.depth();
  for (const Layer& layer : layers)
    for (std::size_t z = 0; z < grid.zone_count(); ++z) {
      double low = grid.high.z(), high = grid.low.z();
      for (const Vec3& x : grid.corners(z)) low = std::min(low, x.z()), high = std::max(high, x.z());
      if (low > layer.top - tolerance || high < layer.top + tolerance) continue;
      const Vec3 c = grid.zone_center(z);
      throw InputError(
          fmt::format("{}: its top at {} m lies inside the zone around ({:.4g}, {:.4g}, {:.4g}) m; put the layers into "
                      "groups of the mesh and give continuum.mesh_file.region instead",
                      layer.where, layer.top, c.x(), c.y(), c.z()));
    }
}

void check_top_is_level(const FileMeshSettings& m, const Grid& grid) {
  const double tolerance = plane_tolerance * (grid.high - grid.low).maxCoeff();
  for (const OuterFace& face : outer_faces(grid, {})) {
    const auto is_in_plane = [&](int axis, double plane) {
      return std::all_of(face.node.begin(), face.node.end(),
                         [&](std::int32_t n) { return std::abs(grid.node[n][axis] - plane) <= tolerance; });
    };
    bool is_of_box = is_in_plane(2, grid.high.z());
    for (int axis = 0; axis < 3; ++axis)
      is_of_box |= is_in_plane(axis, grid.low[axis]) || is_in_plane(axis, grid.high[axis]);
    if (is_of_box) continue;
    const Vec3& x = grid.node[face.node[0]];
    throw InputError(
        fmt::format("{}: continuum.initial_stress takes the weight above from a level top, but an outer face at "
                    "({:.4g}, {:.4g}, {:.4g}) m is on none of the six planes of a brick; leave initial_stress out",
                    m.where, x.x(), x.y(), x.z()));
  }
}

}  // namespace

Grid build_block(const BlockMesh& m) {
  Grid g;
  Plane plane;
  for (int j = 0; j <= m.zones_y; ++j)
    for (int i = 0; i <= m.zones_x; ++i)
      plane.point.emplace_back(m.width_x * (static_cast<double>(i) / m.zones_x - 0.5),
                               m.width_y * (static_cast<double>(j) / m.zones_y - 0.5));
  for (int j = 0; j < m.zones_y; ++j)
    for (int i = 0; i < m.zones_x; ++i) {
      const int a = j * (m.zones_x + 1) + i;
      plane.quad.push_back({a, a + 1, a + m.zones_x + 2, a + m.zones_x + 1});
    }
  std::vector<double> height;
  for (int l = 0; l <= m.zones_z; ++l) height.push_back(m.top_z - m.height * (1 - static_cast<double>(l) / m.zones_z));
  extrude(plane, height, g);
  g.in_discrete_domain.assign(g.zone_count(), 0);
  for (const auto& q : plane.quad) add_horizontal_facet(q, m.zones_z, m.zones_z + 1, g);
  g.low = g.node.front(), g.high = g.node.back();
  check_zones(g, m.where);
  return g;
}

Grid build_cylinder_in_brick(const CylinderMesh& m) {
  check_growth(m.where, "radial_growth", "zones_radial", m.radial_growth, m.zones_radial);
  check_growth(m.where, "depth_growth", "zones_below", m.depth_growth, m.zones_below);
  Grid g;
  const Plane plane = cylinder_plane(m);
  std::vector<double> height;  // from the bottom up
  const std::vector<double> below = graded(m.zones_below, m.depth_growth);
  for (int l = m.zones_below; l > 0; --l) height.push_back(-m.hole_depth - (m.depth - m.hole_depth) * below[l]);
  for (int l = m.zones_hole_depth; l >= 0; --l) height.push_back(-m.hole_depth * l / m.zones_hole_depth);
  extrude(plane, height, g);

  const auto column = static_cast<std::size_t>(m.zones_below + m.zones_hole_depth);
  for (std::size_t z = 0; z < g.zone_count(); ++z)
    g.in_discrete_domain.push_back(g.level[z] >= m.zones_below && plane.is_inside[z / column] ? 1 : 0);

  // Side rings from the top down. Seen from the axis the circle runs against the facets' first direction: with xi
  // clockwise about z and eta upwards, xi x eta points to the axis, into the grains.
  const int levels = m.zones_below + m.zones_hole_depth + 1;
  for (int ring = 0; ring < m.zones_hole_depth; ++ring) {
    const std::int32_t lower = m.zones_below + m.zones_hole_depth - 1 - ring, upper = lower + 1;
    for (int k = 0; k < m.zones_around; ++k) {
      const std::int32_t a = plane.circle[k] * levels, b = plane.circle[(k + 1) % m.zones_around] * levels;
      g.facet.push_back({b + lower, a + lower, a + upper, b + upper});
      g.ring.push_back(ring);
    }
  }
  for (std::size_t q = 0; q < plane.quad.size(); ++q)
    if (plane.is_inside[q]) add_horizontal_facet(plane.quad[q], m.zones_below, levels, g);
  g.low = Vec3(-m.width / 2, -m.width / 2, -m.depth), g.high = Vec3(m.width / 2, m.width / 2, 0);
  check_zones(g, m.where);
  return g;
}

Grid build_grid(const Settings& settings) {
  Grid grid;
  if (const auto* block = std::get_if<BlockMesh>(&settings.mesh)) grid = build_block(*block);
  if (const auto* cylinder = std::get_if<CylinderMesh>(&settings.mesh)) grid = build_cylinder_in_brick(*cylinder);
  const auto* file = std::get_if<FileMeshSettings>(&settings.mesh);
  if (file) grid = build_from_file(*file);
  grid.zone_kind = settings.zone_kind;
  grid.materials = settings.materials;
  take_layers(settings.layers, grid);
  if (file) {
    check_layers_cut_no_zone(settings.layers, grid);
    if (settings.k0) check_top_is_level(*file, grid);
    check_zones(grid, file->where,
                "smooth the mesh there, or take zone_kind: B_BAR or ONE_POINT if it is MIXED_DISCRETIZATION");
  }
  return grid;
}

}  // namespace lockstep::continuum
