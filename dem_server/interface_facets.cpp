#include "dem_server/interface_facets.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "common/checks.hpp"

namespace lockstep::dem {

namespace {

// Facets within this many R of a pebble's reach are listed, so that a list lasts until its pebble has moved as far.
constexpr double skin = 0.5;
// Boxes are made anew when nodes may have moved by this share of the smallest facet.
constexpr double box_drift = 0.001;
// What rounding may take from a distance to a box, over the smallest facet.
constexpr double box_slack = 1e-9;
// Pairs whose feet are found together, and how many ahead the bodies' records are fetched: fewer and more were slower.
constexpr std::int32_t pair_block = 8, pairs_ahead = 24;
// A centre deeper than this times R behind the surface counts as tunnelled.
constexpr double tunnel_depth = 0.5;
// Closer to an edge than this times R, the direction from the edge to the centre is round-off: the facets' normals
// decide.
constexpr double edge_contact_depth = 1e-9;
// Newton's last step in (xi, eta) leaves an error of about its square.
constexpr double last_newton_step = 1e-8;
constexpr int max_newton_steps = 30;
// Minima beyond these in one concave corner of facets are contacts of their own.
constexpr std::size_t max_merged = 8;
// Normals whose Gram determinant is below this are one direction: the deeper of them says it all.
constexpr double least_turn = 1e-14;

// x(xi, eta) - center = r + b xi + c eta + e xi eta, the bilinear facet in monomials.
struct Monomials {
  Vec3 r, b, c, e;

  Monomials(const FacetCorners& x, const Vec3& center)
      : r(0.25 * (x[0] + x[1] + x[2] + x[3]) - center),
        b(0.25 * (x[1] + x[2] - x[0] - x[3])),
        c(0.25 * (x[2] + x[3] - x[0] - x[1])),
        e(0.25 * (x[0] + x[2] - x[1] - x[3])) {}

  Vec3 at(double xi, double eta) const { return r + xi * b + eta * c + (xi * eta) * e; }
};

// f = |x - c|^2 / 2: its gradient and Hessian in (xi, eta).
struct Slope {
  double g_xi, g_eta, h_xi, h_eta, h_mixed;
  bool is_convex;

  Slope(const Monomials& m, double xi, double eta) {
    const Vec3 x = m.at(xi, eta), t_xi = m.b + eta * m.e, t_eta = m.c + xi * m.e;
    g_xi = x.dot(t_xi), g_eta = x.dot(t_eta);
    h_xi = t_xi.squaredNorm(), h_eta = t_eta.squaredNorm();
    h_mixed = t_xi.dot(t_eta) + x.dot(m.e);
    is_convex = h_mixed * h_mixed < (1 - 1e-9) * h_xi * h_eta;
  }
};

struct Parameters {
  double xi = 0, eta = 0;
};

// Newton's method without bounds; false when it runs away, meets a saddle or does not settle.
bool newton(const Monomials& m, Parameters& p) {
  for (int step = 0; step < max_newton_steps; ++step) {
    const Slope s(m, p.xi, p.eta);
    if (!s.is_convex) return false;
    const double det = s.h_xi * s.h_eta - s.h_mixed * s.h_mixed;
    const double d_xi = -(s.h_eta * s.g_xi - s.h_mixed * s.g_eta) / det;
    const double d_eta = -(s.h_xi * s.g_eta - s.h_mixed * s.g_xi) / det;
    p.xi += d_xi, p.eta += d_eta;
    if (std::max(std::abs(p.xi), std::abs(p.eta)) > 1e3) return false;
    if (std::max(std::abs(d_xi), std::abs(d_eta)) < last_newton_step) return true;
  }
  return false;
}

// Goes down from a point of the boundary, inside [-1, 1]^2: Newton's direction where it leads down, else the
// gradient's, halved until f falls. Ends no higher than it began.
void descend(const Monomials& m, Parameters& p) {
  double f = 0.5 * m.at(p.xi, p.eta).squaredNorm();
  for (int step = 0; step < max_newton_steps; ++step) {
    const Slope s(m, p.xi, p.eta);
    const bool xi_is_held = (p.xi >= 1 && s.g_xi < 0) || (p.xi <= -1 && s.g_xi > 0);
    const bool eta_is_held = (p.eta >= 1 && s.g_eta < 0) || (p.eta <= -1 && s.g_eta > 0);
    double d_xi = xi_is_held ? 0 : -s.g_xi / s.h_xi, d_eta = eta_is_held ? 0 : -s.g_eta / s.h_eta;
    if (!xi_is_held && !eta_is_held && s.is_convex) {
      const double det = s.h_xi * s.h_eta - s.h_mixed * s.h_mixed;
      d_xi = -(s.h_eta * s.g_xi - s.h_mixed * s.g_eta) / det;
      d_eta = -(s.h_xi * s.g_eta - s.h_mixed * s.g_xi) / det;
    }
    if (std::max(std::abs(d_xi), std::abs(d_eta)) < 1e-15) return;
    bool has_fallen = false;
    for (double share = 1; share > 1e-9; share *= 0.5) {
      const Parameters q{std::clamp(p.xi + share * d_xi, -1.0, 1.0), std::clamp(p.eta + share * d_eta, -1.0, 1.0)};
      const double f_q = 0.5 * m.at(q.xi, q.eta).squaredNorm();
      if (f_q < f) {
        p = q, f = f_q, has_fallen = true;
        break;
      }
    }
    if (!has_fallen) return;
  }
}

FacetPoint finish(const FacetCorners& x, const Vec3& center, const Parameters& p) {
  FacetPoint out;
  out.xi = p.xi, out.eta = p.eta;
  out.weights = bilinear_weights(p.xi, p.eta);
  out.point = interpolate(out.weights, x);
  out.distance = (center - out.point).norm();
  const Vec3 normal = facet_tangent_xi(x, p.eta).cross(facet_tangent_eta(x, p.xi));
  const double area = normal.norm();
  out.facet_normal = area > 0 ? Vec3(normal / area) : facet_area_vector(x).normalized();
  const bool on_xi = std::abs(p.xi) == 1, on_eta = std::abs(p.eta) == 1;
  if (on_xi && on_eta) {
    out.feature = FacetFeature::Vertex;
    out.feature_index = p.eta < 0 ? (p.xi < 0 ? 0 : 1) : (p.xi < 0 ? 3 : 2);
  } else if (on_xi || on_eta) {
    out.feature = FacetFeature::Edge;
    out.feature_index = on_eta ? (p.eta < 0 ? 0 : 2) : (p.xi < 0 ? 3 : 1);
  }
  return out;
}

double distance(const FacetBox& box, const Vec3& point) {
  const Vec3 d = point - Vec3(box.x, box.y, box.z);
  double squared = 0;
  for (const FacetBox::Axis& axis : box.axis) {
    const double outside = std::max(0.0, std::abs(d.dot(Vec3(axis.x, axis.y, axis.z))) - axis.half);
    squared += outside * outside;
  }
  return std::sqrt(squared);
}

}  // namespace

FacetPoint closest_point(const FacetCorners& x, const Vec3& center) {
  const Monomials m(x, center);

  // Start from the parallelogram (e = 0): there f is quadratic and this is its minimum.
  Parameters p;
  const double bb = m.b.squaredNorm(), cc = m.c.squaredNorm(), bc = m.b.dot(m.c), rb = m.r.dot(m.b), rc = m.r.dot(m.c);
  const double det = bb * cc - bc * bc;
  if (det > 0) {
    p.xi = (bc * rc - cc * rb) / det;
    p.eta = (bc * rb - bb * rc) / det;
  }
  // The mixed term of the Hessian holds (x - c) . e: where its part from the warp cannot outweigh the rest, f has one
  // minimum.
  const bool may_have_several =
      m.e.squaredNorm() * (m.r.squaredNorm() + bb + cc) > 0.01 * std::min(bb, cc) * std::min(bb, cc);
  const bool has_settled = newton(m, p);
  const bool is_inside = has_settled && std::max(std::abs(p.xi), std::abs(p.eta)) < 1;
  if (is_inside && !may_have_several) return finish(x, center, p);

  // Otherwise the minimum lies on the boundary, or on another branch inside. Of a convex function it lies on an edge
  // beyond which the free minimum lies: the way from one to the other leaves the facet there.
  const bool is_convex = has_settled && !may_have_several;
  const std::array<bool, 4> is_beyond = {p.eta <= -1, p.xi >= 1, p.eta >= 1, p.xi <= -1};
  Parameters best = p;
  double best_f = is_inside ? m.at(p.xi, p.eta).squaredNorm() : std::numeric_limits<double>::infinity();
  static constexpr std::array<std::array<double, 2>, 4> corner = {{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}};
  for (int k = 0; k < 4; ++k) {
    if (is_convex && !is_beyond[k]) continue;
    const int next = (k + 1) % 4;
    const Vec3 along = x[next] - x[k];
    const double length = along.squaredNorm();
    const double t = length > 0 ? std::clamp((center - x[k]).dot(along) / length, 0.0, 1.0) : 0.0;
    const double f = (x[k] + t * along - center).squaredNorm();
    if (f < best_f) {
      best_f = f;
      const auto on_edge = [&](int i) {
        return corner[k][i] + t * (corner[next][i] - corner[k][i]);
      };  // exact at bounds
      best = {on_edge(0), on_edge(1)};
    }
  }
  if (may_have_several) descend(m, best);
  return finish(x, center, best);
}

// ---------------------------------------------------------------------------------------------------- the surface

FacetKernels facet_kernels(InstructionSet instructions) { return LOCKSTEP_KERNEL_FOR(instructions, facet_kernel)(); }

InterfaceFacets::InterfaceFacets(const Vec3s& nodes, const std::vector<std::array<std::int32_t, 4>>& facets,
                                 double collar_height, FacetKernels kernels)
    : kernels_(kernels),
      position_(nodes),
      collar_height_(collar_height),
      facet_nodes_(facets),
      real_facet_count_(facets.size()) {
  const auto node_count = static_cast<std::int32_t>(nodes.size());
  for (std::size_t f = 0; f < facets.size(); ++f) {
    for (const std::int32_t node : facets[f])
      if (node < 0 || node >= node_count)
        throw InputError(fmt::format("interface facet {}: node {} of {}; indices count from 0", f, node, node_count));
    const auto& n = facets[f];
    const FacetCorners x = {nodes[n[0]], nodes[n[1]], nodes[n[2]], nodes[n[3]]};
    if (!(facet_area_vector(x).norm() > 0))
      throw InputError(fmt::format("interface facet {} (nodes {} {} {} {}) has no area", f, n[0], n[1], n[2], n[3]));
    facets_.push_back({n, {}, static_cast<std::int32_t>(f)});
  }
  offset_.assign(nodes.size(), Vec3::Zero());
  velocity_ = offset_velocity_ = offset_;
  for (std::int32_t node = 0; node < node_count; ++node) real_node_.push_back(node);

  using Edge = std::pair<std::int32_t, std::int32_t>;
  const auto edge_of = [](const std::array<std::int32_t, 4>& n, int k) -> Edge {
    return std::minmax(n[k], n[(k + 1) % 4]);
  };
  const auto count_edges = [&] {
    std::map<Edge, int> count;
    for (const auto& n : facet_nodes_)
      for (int k = 0; k < 4; ++k) ++count[edge_of(n, k)];
    return count;
  };

  if (collar_height > 0 && !facets_.empty()) {
    double low = nodes[0].z(), top = low;
    for (const auto& n : facets)
      for (const std::int32_t node : n) {
        low = std::min(low, nodes[node].z());
        top = std::max(top, nodes[node].z());
      }
    const double top_band = top - 1e-6 * (top - low);
    const auto count = count_edges();
    std::map<std::int32_t, std::int32_t> virtual_node;
    const auto raised = [&](std::int32_t node) {
      const auto [place, is_new] = virtual_node.try_emplace(node, static_cast<std::int32_t>(real_node_.size()));
      if (is_new) real_node_.push_back(node);
      return place->second;
    };
    for (std::size_t f = 0; f < real_facet_count_; ++f)
      for (int k = 0; k < 4; ++k) {
        const std::int32_t a = facets[f][k], b = facets[f][(k + 1) % 4];
        if (count.at(edge_of(facets[f], k)) > 1 || nodes[a].z() < top_band || nodes[b].z() < top_band) continue;
        // A neighbour runs along the shared edge the other way, so that both normals point to the same side.
        const std::int32_t above_a = raised(a), above_b = raised(b);
        facet_nodes_.push_back({b, a, above_a, above_b});
        facets_.push_back({{b, a, a, b}, {}, static_cast<std::int32_t>(f)});
      }
  }

  const auto count = count_edges();
  is_open_node_.assign(real_node_.size(), 0);
  for (std::size_t f = 0; f < facets_.size(); ++f)
    for (int k = 0; k < 4; ++k) {
      const auto& n = facet_nodes_[f];
      facets_[f].is_open_edge[k] = count.at(edge_of(n, k)) == 1;
      if (facets_[f].is_open_edge[k]) is_open_node_[n[k]] = is_open_node_[n[(k + 1) % 4]] = 1;
    }

  nodes_.resize(real_node_.size());
  nodal_force_.assign(nodes.size(), Vec3::Zero());
  node_stiffness_.assign(nodes.size(), 0.0);
  facet_force_.assign(real_facet_count_, Vec3::Zero());
  facet_stiffness_.assign(real_facet_count_, 0.0);
  boxes_.resize(facets_.size());
  spheres_.resize(facets_.size());
  place_nodes();
  update_boxes();
}

// ---- motion

void InterfaceFacets::advance(std::span<const Vec3> velocity, double dt) {
  set_velocity(velocity);
  double fastest = 0;
  for (std::size_t i = 0; i < position_.size(); ++i) {
    position_[i] += velocity[i] * dt;
    fastest = std::max(fastest, velocity[i].squaredNorm());
  }
  travel_ += std::sqrt(fastest) * std::abs(dt);
  place_nodes();
}

void InterfaceFacets::advance_part(std::span<const Vec3> velocity, double dt, std::uint32_t part, std::uint32_t parts) {
  if (part == 1) base_ = position_;
  const double share = part == parts ? dt : dt * part / parts;
  position_ = base_;
  advance(velocity, share);  // counts more travel than there is, which is safe
}

void InterfaceFacets::set_velocity(std::span<const Vec3> velocity) {
  LOCKSTEP_ASSERT(velocity.size() == position_.size(), "{} velocities for {} nodes", velocity.size(), position_.size());
  velocity_.assign(velocity.begin(), velocity.end());
}

void InterfaceFacets::move_offsets(std::span<const Vec3> velocity, double dt) {
  LOCKSTEP_ASSERT(velocity.size() == position_.size(), "{} velocities for {} nodes", velocity.size(), position_.size());
  offset_velocity_.assign(velocity.begin(), velocity.end());
  double fastest = 0;
  for (std::size_t i = 0; i < offset_.size(); ++i) {
    offset_[i] += velocity[i] * dt;
    fastest = std::max(fastest, velocity[i].squaredNorm());
  }
  travel_ += std::sqrt(fastest) * std::abs(dt);
  place_nodes();
}

void InterfaceFacets::set_offsets(std::span<const Vec3> offsets) {
  LOCKSTEP_ASSERT(offsets.size() == position_.size(), "{} offsets for {} nodes", offsets.size(), position_.size());
  double farthest = 0;
  for (std::size_t i = 0; i < offset_.size(); ++i) farthest = std::max(farthest, (offsets[i] - offset_[i]).norm());
  offset_.assign(offsets.begin(), offsets.end());
  std::fill(offset_velocity_.begin(), offset_velocity_.end(), Vec3::Zero());
  travel_ += farthest;
  place_nodes();
}

void InterfaceFacets::place_nodes() {
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    const Vec3 x = position_[real_node_[i]] + offset_[real_node_[i]];
    nodes_[i].x = x.x(), nodes_[i].y = x.y(), nodes_[i].z = i < position_.size() ? x.z() : x.z() + collar_height_;
  }
}

FacetCorners InterfaceFacets::corners(std::size_t facet) const {
  const auto& n = facet_nodes_[facet];
  return {place_of(n[0]), place_of(n[1]), place_of(n[2]), place_of(n[3])};
}

std::uint64_t InterfaceFacets::position_hash() const {
  Hash h;
  h.add(std::span<const Vec3>(position_));
  return h.value();
}

// ---- which facets a pebble may touch

void InterfaceFacets::update_boxes() {
  for (std::size_t f = 0; f < facets_.size(); ++f) {
    const FacetCorners x = corners(f);
    const Vec3 center = interpolate(bilinear_weights(0, 0), x);
    // The diagonals span the plane of the mean normal; a facet lies inside the hull of its corners.
    std::array<Vec3, 3> axis;
    axis[2] = facet_area_vector(x).normalized();
    const Vec3 along = facet_tangent_xi(x, 0);
    axis[0] = (along - along.dot(axis[2]) * axis[2]).normalized();
    axis[1] = axis[2].cross(axis[0]);
    boxes_[f] = {center.x(), center.y(), center.z(), 0, {}};
    spheres_[f] = {center, 0};
    for (const Vec3& corner : x) spheres_[f].radius = std::max(spheres_[f].radius, (corner - center).norm());
    for (std::size_t k = 0; k < 3; ++k) {
      double half = 0;
      for (const Vec3& corner : x) half = std::max(half, std::abs((corner - center).dot(axis[k])));
      boxes_[f].axis[k] = {axis[k].x(), axis[k].y(), axis[k].z(), half};
    }
  }
  box_travel_ = travel_;

  smallest_ = std::numeric_limits<double>::infinity();
  for (const Sphere& sphere : spheres_) smallest_ = std::min(smallest_, sphere.radius);
}

void InterfaceFacets::list_facets(Neighborhood& near, const Vec3& center, double radius) const {
  const double drift = travel_ - box_travel_;
  const double listed = (1 + skin) * radius + drift;
  near.facets.clear();
  double nearest_unlisted = std::numeric_limits<double>::infinity();
  for (std::size_t f = 0; f < spheres_.size(); ++f) {
    const double far = nearest_unlisted + spheres_[f].radius;
    if ((center - spheres_[f].center).squaredNorm() >= far * far) continue;
    const double away = distance(boxes_[f], center);
    if (away < listed)
      near.facets.push_back(static_cast<std::int32_t>(f));
    else
      nearest_unlisted = std::min(nearest_unlisted, away);
  }
  near.center = center;
  near.reach = nearest_unlisted - drift + travel_;
}

void InterfaceFacets::renew_candidates(const Particles& particles, const TravelLimits& limits, Team& team,
                                       const Partition& partition) {
  candidates_.wall_moved(travel_ - candidate_travel_);
  candidate_travel_ = travel_;
  if (candidates_.is_fresh(limits, particles.pebble_count())) return;
  const double drift = travel_ - box_travel_;
  candidates_.renew(particles, limits, wall_allowance * particles.mean_radius(), team, partition,
                    [&](std::size_t pebble, const Vec3& center, double reach, std::vector<std::int32_t>& touchable) {
                      Neighborhood& near = neighborhoods_[pebble];
                      const double slack = near.reach - reach - travel_;
                      if (!(slack > 0 && (center - near.center).squaredNorm() < slack * slack))
                        list_facets(near, center, reach);
                      const std::size_t before = touchable.size();
                      for (const std::int32_t facet : near.facets)
                        if (distance(boxes_[facet], center) <= reach + drift) touchable.push_back(facet);
                      return touchable.size() > before;
                    });
  pair_pebble_.clear(), pair_body_.clear();
  for (std::size_t i = 0; i < candidates_.size(); ++i) {
    const std::int32_t pebble = candidates_.pebble(i);
    pair_pebble_.insert(pair_pebble_.end(), candidates_.extra_count(i), pebble);
    pair_body_.insert(pair_body_.end(), candidates_.extra_count(i), particles.pebble_body(pebble));
  }
}

// ---- where a pebble touches

bool InterfaceFacets::shares_feature(const Foot& foot, std::int32_t facet) const {
  if (foot.at.feature == FacetFeature::Face) return false;
  const auto& own = facet_nodes_[foot.facet];
  const auto& other = facet_nodes_[facet];
  const auto has = [&](std::int32_t node) { return std::find(other.begin(), other.end(), node) != other.end(); };
  const std::int32_t k = foot.at.feature_index;
  return has(own[k]) && (foot.at.feature == FacetFeature::Vertex || has(own[(k + 1) % 4]));
}

bool InterfaceFacets::is_open(const Foot& foot) const {
  const Facet& facet = facets_[foot.facet];
  return foot.at.feature == FacetFeature::Edge ? facet.is_open_edge[foot.at.feature_index]
                                               : is_open_node_[facet_nodes_[foot.facet][foot.at.feature_index]] != 0;
}

bool InterfaceFacets::are_adjacent(std::int32_t facet_a, std::int32_t facet_b) const {
  for (const std::int32_t a : facet_nodes_[facet_a])
    for (const std::int32_t b : facet_nodes_[facet_b])
      if (a == b) return true;
  return false;
}

void InterfaceFacets::set_side(Foot& foot, const Vec3& center, double radius, const std::vector<Foot>& feet) const {
  const Vec3 away = center - foot.at.point;
  if (foot.at.feature == FacetFeature::Face) {
    foot.normal = foot.at.facet_normal;
    foot.distance = away.dot(foot.normal);
    return;
  }
  // All facets that share the edge or node are among the feet: none of them is farther from the centre than it.
  Vec3 side = Vec3::Zero();
  for (const Foot& other : feet) {
    if (!shares_feature(foot, other.facet)) continue;
    double angle = 1;
    if (foot.at.feature == FacetFeature::Vertex) {
      const auto& nodes = facet_nodes_[other.facet];
      const std::int32_t node = facet_nodes_[foot.facet][foot.at.feature_index];
      const auto k = static_cast<std::size_t>(std::find(nodes.begin(), nodes.end(), node) - nodes.begin());
      const FacetCorners x = corners(other.facet);
      const Vec3 to_next = x[(k + 1) % 4] - x[k], to_last = x[(k + 3) % 4] - x[k];
      angle = std::atan2(to_next.cross(to_last).norm(), to_next.dot(to_last));
    }
    side += angle * other.at.facet_normal;
  }
  if (foot.at.distance < edge_contact_depth * radius) {
    foot.normal = side.normalized();
    foot.distance = away.dot(foot.normal);
    return;
  }
  const bool is_inside = is_open(foot) || away.dot(side) >= 0;
  foot.distance = is_inside ? foot.at.distance : -foot.at.distance;
  foot.normal = away / foot.distance;
}

// Local minima of the distance to the surface, nearest first, of a pebble in its pairs [near, end).
void InterfaceFacets::find_feet(const std::int32_t* near, const std::int32_t* end, const Vec3& center, double radius,
                                Part& part) const {
  std::vector<Foot>&feet = part.feet, &minima = part.minima;
  feet.clear();
  minima.clear();
  for (; near != end; ++near) {
    Foot foot;
    foot.facet = candidates_.extras()[static_cast<std::size_t>(*near)];
    foot.at = closest_point(corners(foot.facet), center);
    if (foot.at.distance < radius) feet.push_back(foot);
  }
  std::sort(feet.begin(), feet.end(), [](const Foot& a, const Foot& b) {
    return a.at.distance < b.at.distance || (a.at.distance == b.at.distance && a.facet < b.facet);
  });
  for (std::size_t i = 0; i < feet.size(); ++i) {
    bool is_minimum = true;
    for (std::size_t j = 0; j < i && is_minimum; ++j) is_minimum = !shares_feature(feet[i], feet[j].facet);
    if (!is_minimum) continue;
    Foot foot = feet[i];
    set_side(foot, center, radius, feet);
    if (foot.distance < 0) {
      // Behind the surface only the closest point tells the way back.
      for (std::size_t j = 0; j < i && is_minimum; ++j) is_minimum = !are_adjacent(foot.facet, feet[j].facet);
      if (!is_minimum) continue;
    }
    minima.push_back(foot);
  }
}

// Makes one contact of the minimum `seed` and of those that lie with it in a smooth concave part of the surface.
InterfaceFacets::Push InterfaceFacets::merge(Part& part, std::size_t seed, double radius) const {
  std::vector<Foot>& minima = part.minima;
  static const double cos_merge_angle = std::cos(merge_angle);
  std::array<const Foot*, max_merged> foot{};
  std::array<double, max_merged> overlap{};
  std::size_t count = 0;
  for (std::size_t i = seed; i < minima.size() && count < max_merged; ++i) {
    Foot& candidate = minima[i];
    if (candidate.is_taken) continue;
    if (i != seed && (candidate.normal.dot(minima[seed].normal) < cos_merge_angle ||
                      !are_adjacent(candidate.facet, minima[seed].facet)))
      continue;
    candidate.is_taken = true;
    overlap[count] = radius - candidate.distance;
    foot[count++] = &candidate;
  }

  // The shortest t with n_i . t >= U_i for all i is t = sum lambda_i n_i, lambda >= 0 where n_i . t = U_i, at most
  // three of them. Any such combination that fits its own U_i is no longer than t (duality), so the longest is it.
  struct Combination {
    std::array<std::size_t, 3> facet{};
    std::array<double, 3> lambda{1, 0, 0};
    std::size_t count = 1;
    double length = 0;
    Vec3 direction;
  } best;
  best.length = overlap[0];
  best.direction = foot[0]->normal;
  const auto try_push = [&](const Vec3& t, std::size_t size, const std::array<std::size_t, 3>& facet,
                            const std::array<double, 3>& lambda) {
    if (std::min({lambda[0], lambda[1], lambda[2]}) < 0) return;
    const double length = t.norm();
    if (length > best.length) best = {facet, lambda, size, length, t / length};
  };
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t j = i + 1; j < count; ++j) {
      const Vec3 &n_i = foot[i]->normal, &n_j = foot[j]->normal;
      const Vec3 cross = n_i.cross(n_j);
      const double sine = cross.squaredNorm();
      if (sine < least_turn) continue;
      const double cosine = n_i.dot(n_j);
      const double l_i = (overlap[i] - cosine * overlap[j]) / sine, l_j = (overlap[j] - cosine * overlap[i]) / sine;
      try_push(l_i * n_i + l_j * n_j, 2, {i, j, 0}, {l_i, l_j, 0});
      for (std::size_t k = j + 1; k < count; ++k) {
        const Vec3& n_k = foot[k]->normal;
        const double det = cross.dot(n_k);
        if (det * det < least_turn) continue;
        const Vec3 jk = n_j.cross(n_k), ki = n_k.cross(n_i);
        const Vec3 t = (overlap[i] * jk + overlap[j] * ki + overlap[k] * cross) / det;
        try_push(t, 3, {i, j, k}, {t.dot(jk) / det, t.dot(ki) / det, t.dot(cross) / det});
      }
    }

  const double sum = best.lambda[0] + best.lambda[1] + best.lambda[2];
  for (std::size_t s = 0; s < best.count; ++s) {
    const Foot& at = *foot[best.facet[s]];
    part.shares.push_back({at.facet, best.lambda[s] / sum, at.at.weights});
  }
  return {best.length, -best.direction, static_cast<std::int32_t>(best.count)};
}

// The spring of the contact that this one was at the last step: of the same pebble, on a facet that is the same or
// shares a node, with the most similar normal.
ContactHistory InterfaceFacets::inherited(const Toucher& pebble, std::int32_t facet, const Vec3& normal) {
  static const double least_similar = std::cos(merge_angle);
  double most_similar = least_similar;
  std::size_t heir_of = pebble.end_previous;
  for (std::size_t i = pebble.first_previous; i < pebble.end_previous; ++i) {
    if (is_inherited_[i]) continue;
    const Contact& previous = previous_[i];
    const double similarity = previous.history.normal.dot(normal);
    if (similarity <= most_similar) continue;
    const Share* share = &previous_shares_[static_cast<std::size_t>(previous.first_share)];
    const bool is_near = std::any_of(share, share + previous.share_count, [&](const Share& of_it) {
      return facet == of_it.facet || are_adjacent(facet, of_it.facet);
    });
    if (!is_near) continue;
    most_similar = similarity;
    heir_of = i;
  }
  if (heir_of == pebble.end_previous) return {};
  is_inherited_[heir_of] = 1;
  return previous_[heir_of].history;
}

// Mean, I^-1 and spin of the nodes of each real facet.
void InterfaceFacets::find_turns() {
  turns_.resize(real_facet_count_);
  for (std::size_t f = 0; f < real_facet_count_; ++f) {
    Turn& turn = turns_[f];
    turn.mean = Vec3::Zero();
    for (const std::int32_t node : facet_nodes_[f]) turn.mean += 0.25 * place_of(node);
    Mat3 spread = Mat3::Zero();
    Vec3 turning = Vec3::Zero();
    for (const std::int32_t node : facet_nodes_[f]) {
      const Vec3 r = place_of(node) - turn.mean;
      spread += r.squaredNorm() * Mat3::Identity() - r * r.transpose();
      turning += r.cross(velocity_of(node));
    }
    turn.inverse = spread.inverse();
    turn.spin = turn.inverse * turning;
  }
}

// From where eq. (13) lets the share's force act to the contact point [m].
Vec3 InterfaceFacets::lever_of(const Share& share, const Vec3& point) const {
  Vec3 lever = point;
  for (std::size_t j = 0; j < 4; ++j) lever -= share.weights[j] * place_of(facets_[share.facet].real_nodes[j]);
  return lever;
}

// What a contact gives to nodes, facets and totals. Eq. (13): each node of each facet of the contact takes its share of the
// force on the facet and of the stiffness.
void InterfaceFacets::book(const Contact& contact, const Share* shares, const Sums& sums, bool transfers_moment) {
  for (const Share* share = shares; share != shares + contact.share_count; ++share) {
    const Facet& facet = facets_[share->facet];
    for (std::size_t j = 0; j < 4; ++j) node_load_[facet.real_nodes[j]].add(share->share * share->weights[j], contact);
    facet_load_[facet.below].add(share->share, contact);
    if (!transfers_moment) continue;
    const Turn& turn = turns_[facet.below];
    const Vec3 about = turn.inverse * lever_of(*share, contact.point).cross(share->share * contact.force);
    for (const std::int32_t node : facet_nodes_[facet.below])
      node_load_[node].force -= about.cross(place_of(node) - turn.mean);
  }
  ++totals_.contacts;
  totals_.particle_force += contact.force;
  totals_.particle_moment += contact.point.cross(contact.force);
  totals_.normal_force += sums.normal_force;
  totals_.neglected_moment += sums.neglected_moment;
  totals_.elastic_energy += sums.elastic_energy;
  totals_.slip_work += sums.slip_work, totals_.dashpot_work += sums.dashpot_work;
  totals_.power += sums.power;
  totals_.max_overlap = std::max(totals_.max_overlap, sums.overlap_ratio);
}

// One contact: its force, on the body at once.
void InterfaceFacets::press(Particles& particles, const Toucher& pebble, const Push& push, Part& part) {
  const std::size_t first_share = part.shares.size() - static_cast<std::size_t>(push.share_count);
  const Share* const shares = &part.shares[first_share];
  const Share* const end = shares + push.share_count;
  const Vec3 point = pebble.center + (pebble.radius - 0.5 * push.overlap) * push.normal;  // eq. 1

  Vec3 facet_velocity = Vec3::Zero();  // eqs 6, 7
  for (const Share* share = shares; share != end; ++share) {
    for (std::size_t j = 0; j < 4; ++j)
      facet_velocity += share->share * share->weights[j] * velocity_of(facet_nodes_[share->facet][j]);
    if (pebble.transfers_moment)
      facet_velocity += share->share * turns_[facets_[share->facet].below].spin.cross(lever_of(*share, point));
  }
  ContactHistory history = inherited(pebble, shares->facet, push.normal);
  const Vec3 approach = facet_velocity - particles.velocity_at(pebble.body, point);  // eq. 4
  const ContactResult result =
      contact_force(pebble.law, push.normal, push.overlap, approach, pebble.time_step, history);
  const Vec3& force = result.force_on_a;
  particles.add_force(pebble.body, point, force);  // eq. 12

  part.contacts.push_back({history, pebble.pebble, pebble.body, static_cast<std::int32_t>(first_share),
                           push.share_count, point, force, push.overlap, pebble.law.normal_stiffness,
                           pebble.law.shear_stiffness});
  const Vec3 shear = force - force.dot(push.normal) * push.normal;
  const Sums sums = {result.normal_force,
                     pebble.transfers_moment ? 0.0 : 0.5 * push.overlap * shear.norm(),
                     contact_energy(pebble.law, push.overlap, history),
                     result.slip_work,
                     result.dashpot_power * pebble.time_step,
                     force.dot(facet_velocity),
                     push.overlap / pebble.radius};
  if (part.is_first)
    book(part.contacts.back(), shares, sums, pebble.transfers_moment);
  else
    part.sums.push_back(sums);
}

// The contacts of a pebble's local minima.
void InterfaceFacets::press_minima(Particles& particles, const Toucher& pebble, Part& part) {
  bool is_tunnelled = false;
  for (std::size_t seed = 0; seed < part.minima.size(); ++seed) {
    if (part.minima[seed].is_taken) continue;
    is_tunnelled |= part.minima[seed].distance < -tunnel_depth * pebble.radius;
    press(particles, pebble, merge(part, seed, pebble.radius), part);
  }
  part.tunnelled += is_tunnelled;
}

void InterfaceFacets::find_contacts(Particles& particles, const FacetMaterial& material, double dt,
                                    const PebbleRange& range, Part& part) {
  part.contacts.clear(), part.shares.clear(), part.sums.clear();
  part.tunnelled = 0;
  const std::int32_t* const facet_of = candidates_.extras().data();
  const FacetSurface surface = {std::as_const(particles).pebbles(), nodes_.data(), boxes_.data(),
                                reinterpret_cast<const std::int32_t(*)[4]>(facet_nodes_.data())};
  const FacetPairs pairs = {pair_pebble_.data(), facet_of};
  const auto [first_candidate, end_candidate] = candidates_.within(range);
  const std::int32_t first_pair = candidates_.extra_begin(first_candidate),
                     end_pair = candidates_.extra_begin(end_candidate);
  part.near.resize(static_cast<std::size_t>(end_pair - first_pair + facet_block));
  std::int32_t* const near = part.near.data();
  const double reach = travel_ - box_travel_ + box_slack * smallest_;
  const std::int32_t count = kernels_.find_near(surface, pairs, first_pair, end_pair, reach, near);

  const auto next_previous = [&](std::size_t i, std::int32_t pebble) {
    while (i < previous_.size() && previous_[i].pebble < pebble) ++i;
    return i;
  };
  std::size_t previous = static_cast<std::size_t>(
      std::partition_point(previous_.begin(), previous_.end(),
                           [&](const Contact& contact) { return contact.pebble < range.begin; }) -
      previous_.begin());
  const auto toucher = [&](std::int32_t pebble, std::int32_t body) {
    ContactMaterial law;
    law.normal_stiffness = material.normal_stiffness(particles.equivalent_radius(body));
    law.shear_stiffness = law.normal_stiffness / material.stiffness_ratio;
    law.friction = material.friction;
    if (material.damping_ratio > 0)
      law.normal_dashpot = 2 * material.damping_ratio * std::sqrt(law.normal_stiffness * particles.mass(body));
    const std::size_t first_previous = next_previous(previous, pebble);
    previous = next_previous(first_previous, pebble + 1);
    return Toucher{pebble,  body, particles.pebble_center(pebble), particles.pebble_radius(pebble),
                   law,     dt,   material.transfers_moment,       first_previous,
                   previous};
  };
  const auto end_of_block = [&](std::int32_t k) {  // no pebble lies in two
    k = std::min(k + pair_block, count);
    while (k < count && pair_pebble_[near[k]] == pair_pebble_[near[k - 1]]) ++k;
    return k;
  };

  std::int32_t fetched = 0;
  for (std::int32_t begin = 0, end = 0; begin < count; begin = end) {
    end = end_of_block(begin);
    for (; fetched < std::min(end + pairs_ahead, count); ++fetched) {
      const std::int32_t body = pair_body_[near[fetched]];
      __builtin_prefetch(&std::as_const(particles).bodies()[body]);
      __builtin_prefetch(&std::as_const(particles).motion()[body]);
      __builtin_prefetch(&particles.loads()[body], 1);
    }
    const auto room = static_cast<std::size_t>(end - begin + facet_block);
    if (part.face_feet.size() < room) part.face_feet.resize(room), part.face_contacts.resize(room);
    kernels_.find_feet(surface, pairs, near + begin, end - begin, part.face_feet.data(), part.face_contacts.data());

    for (std::int32_t k = begin, end_k = k; k < end; k = end_k) {
      const std::int32_t id = pair_pebble_[near[k]];
      std::int32_t touching = 0, at = k;
      bool is_known = true;
      for (; end_k < end && pair_pebble_[near[end_k]] == id; ++end_k) {
        const FaceContact contact = part.face_contacts[static_cast<std::size_t>(end_k - begin)];
        if (contact == FaceContact::Touching) ++touching, at = end_k;
        is_known = is_known && contact != FaceContact::Unknown;
      }
      if (is_known && touching == 0) continue;
      const Toucher pebble = toucher(id, pair_body_[near[k]]);
      if (!is_known || touching > 1) {
        find_feet(near + k, near + end_k, pebble.center, pebble.radius, part);
        press_minima(particles, pebble, part);
        continue;
      }
      const FaceFoot& foot = part.face_feet[static_cast<std::size_t>(at - begin)];
      part.shares.push_back({facet_of[near[at]], 1, {foot.weight[0], foot.weight[1], foot.weight[2], foot.weight[3]}});
      press(particles, pebble, {foot.overlap, Vec3(-foot.nx, -foot.ny, -foot.nz), 1}, part);
      part.tunnelled += foot.overlap > (1 + tunnel_depth) * pebble.radius;
    }
  }
}

FacetTotals InterfaceFacets::compute(Particles& particles, const FacetMaterial& material, double dt,
                                     const TravelLimits& limits, Team& team, const Partition& partition) {
  totals_ = {};
  if (facets_.empty()) return totals_;

  if (travel_ - box_travel_ > box_drift * smallest_) update_boxes();
  if (neighborhoods_.size() != particles.pebble_count()) neighborhoods_.assign(particles.pebble_count(), {});
  renew_candidates(particles, limits, team, partition);
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    const Vec3 v = velocity_[real_node_[i]] + offset_velocity_[real_node_[i]];
    nodes_[i].vx = v.x(), nodes_[i].vy = v.y(), nodes_[i].vz = v.z();
  }
  if (material.transfers_moment) find_turns();

  node_load_.assign(nodal_force_.size(), {});
  facet_load_.assign(real_facet_count_, {});
  std::swap(contacts_, previous_), std::swap(shares_, previous_shares_);
  is_inherited_.assign(previous_.size(), 0);
  parts_.resize(static_cast<std::size_t>(partition.parts(team.size())));
  parts_[0].is_first = true;
  team.run_parts(partition.parts(team.size()), [&](int k) {
    find_contacts(particles, material, dt, pebbles_of_part(particles, partition, team.size(), k),
                  parts_[static_cast<std::size_t>(k)]);
  });

  std::swap(contacts_, parts_[0].contacts), std::swap(shares_, parts_[0].shares);
  tunnelled_ = parts_[0].tunnelled;
  for (std::size_t t = 1; t < parts_.size(); ++t) {
    Part& part = parts_[t];
    const auto before = static_cast<std::int32_t>(shares_.size());
    for (std::size_t c = 0; c < part.contacts.size(); ++c) {
      Contact& contact = contacts_.emplace_back(part.contacts[c]);
      book(contact, &part.shares[static_cast<std::size_t>(contact.first_share)], part.sums[c],
           material.transfers_moment);
      contact.first_share += before;
    }
    shares_.insert(shares_.end(), part.shares.begin(), part.shares.end());
    tunnelled_ += part.tunnelled;
  }
  totals_.tunnelled = tunnelled_;
  for (std::size_t i = 0; i < node_load_.size(); ++i)
    nodal_force_[i] = node_load_[i].force, node_stiffness_[i] = node_load_[i].stiffness;
  for (std::size_t f = 0; f < facet_load_.size(); ++f)
    facet_force_[f] = facet_load_[f].force, facet_stiffness_[f] = facet_load_[f].stiffness;
  return totals_;
}

// ---- state

std::vector<FacetContact> InterfaceFacets::contacts() const {
  std::vector<FacetContact> all;
  all.reserve(contacts_.size());
  for (const Contact& c : contacts_) {
    FacetContact& contact = all.emplace_back();
    contact.pebble = c.pebble, contact.body = c.body, contact.share_count = c.share_count;
    std::copy_n(shares_.begin() + c.first_share, c.share_count, contact.shares.begin());
    contact.point = c.point;
    for (std::int32_t s = 0; s < c.share_count; ++s) {
      const Share& share = contact.shares[static_cast<std::size_t>(s)];
      contact.foot += share.share * interpolate(share.weights, corners(share.facet));
    }
    contact.overlap = c.overlap;
    contact.normal_stiffness = c.normal_stiffness, contact.shear_stiffness = c.shear_stiffness;
    contact.force = c.force;
    contact.history = c.history;
  }
  return all;
}

void InterfaceFacets::hash(Hash& h) const {
  h.add(std::span<const Vec3>(position_));
  h.add(std::span<const Vec3>(offset_));
  h.add(std::span<const Vec3>(velocity_));
  h.add(std::span<const Vec3>(offset_velocity_));
  for (const Contact& contact : contacts_) {
    h.add(static_cast<std::uint64_t>(contact.pebble));
    for (std::int32_t s = 0; s < contact.share_count; ++s)
      h.add(static_cast<std::uint64_t>(shares_[static_cast<std::size_t>(contact.first_share + s)].facet));
    h.add(contact.history.spring);
    h.add(contact.history.normal);
  }
}

void InterfaceFacets::clear_history() {
  contacts_.clear(), shares_.clear();
  neighborhoods_.clear();
  candidates_.forget();
}

void InterfaceFacets::restore(const FacetState& state) {
  const std::size_t nodes = position_.size();
  if (state.positions.size() != nodes || state.offsets.size() != nodes || state.velocity.size() != nodes ||
      state.offset_velocity.size() != nodes)
    throw InputError(fmt::format("state of {} interface nodes for a surface of {}", state.positions.size(), nodes));
  for (const FacetContact& contact : state.contacts)
    for (std::int32_t s = 0; s < contact.share_count; ++s) {
      const std::int32_t facet = contact.shares[static_cast<std::size_t>(s)].facet;
      if (facet < 0 || static_cast<std::size_t>(facet) >= facets_.size())
        throw InputError(fmt::format("state with a contact on facet {} of {}", facet, facets_.size()));
    }
  position_ = state.positions;
  offset_ = state.offsets;
  velocity_ = state.velocity;
  offset_velocity_ = state.offset_velocity;
  contacts_.clear(), shares_.clear();
  for (const FacetContact& c : state.contacts) {
    contacts_.push_back({c.history, c.pebble, c.body, static_cast<std::int32_t>(shares_.size()), c.share_count, c.point,
                         c.force, c.overlap, c.normal_stiffness, c.shear_stiffness});
    shares_.insert(shares_.end(), c.shares.begin(), c.shares.begin() + c.share_count);
  }
  neighborhoods_.clear();
  candidates_.forget();
  place_nodes();
  update_boxes();
}

}  // namespace lockstep::dem
