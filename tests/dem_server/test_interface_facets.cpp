// Spheres of radius 0.03 m against surfaces of 4-node facets.
#include "dem_server/interface_facets.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <memory>
#include <string>

#include "common/checks.hpp"
#include "common/random.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

constexpr double R = 0.03;  // [m]

ClumpTemplate sphere() { return {{Vec3::Zero()}, {1.0}, Vec3::Constant(0.4), 1.0}; }

Particles spheres_at(const Vec3s& centers) {
  Particles p;
  for (const Vec3& center : centers) p.add(sphere(), R, 2650, center, Quat::Identity());
  p.clear_forces();
  return p;
}

void put(Particles& p, const Vec3& center) {
  p.position(0) = center;
  p.place_pebbles();
  p.clear_forces();
}

// Of all bodies [N].
Vec3s forces_on(const Particles& p) {
  Vec3s forces;
  for (std::size_t b = 0; b < p.body_count(); ++b) forces.push_back(p.force(b));
  return forces;
}

FacetMaterial material(double friction) {
  FacetMaterial m;
  m.friction = friction;
  return m;
}

const double k_n = material(0).normal_stiffness(R);  // [N/m]
const double k_s = k_n / 8;                          // [N/m]

using Facets = std::vector<std::array<std::int32_t, 4>>;

struct Mesh {
  Vec3s nodes;
  Facets facets;
  InterfaceFacets surface(double collar = 0) const { return InterfaceFacets(nodes, facets, collar); }
};

// n x n facets over [0, n h]^2 at height z(x, y), normals up.
Mesh sheet(int n, double h, const std::function<double(double, double)>& z) {
  Mesh m;
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) m.nodes.push_back({i * h, j * h, z(i * h, j * h)});
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i;
      m.facets.push_back({a, a + 1, a + n + 2, a + n + 1});
    }
  return m;
}

// A strip of facets two deep in y over the polyline (x, z), normals to the left of its direction seen from -y.
Mesh strip(const std::vector<std::pair<double, double>>& line) {
  Mesh m;
  for (const auto& [x, z] : line)
    for (const double y : {-0.2, 0.0, 0.2}) m.nodes.push_back({x, y, z});
  for (int i = 0; i + 1 < static_cast<int>(line.size()); ++i)
    for (int j = 0; j < 2; ++j) {
      const int a = 3 * i + j;
      m.facets.push_back({a, a + 3, a + 4, a + 1});
    }
  return m;
}

// The side of a hole: `around` facets of a regular polygon of radius 0.4375 m, levels 0.2 m high, normals inwards; a
// bottom of one facet a sector (two nodes on the side, two on an inner ring) and the inner polygon left open.
constexpr double hole_radius = 0.4375;
Mesh hole(int around, int levels, bool has_bottom) {
  Mesh m;
  const auto ring = [&](double radius, double z) {
    for (int i = 0; i < around; ++i) {
      const double angle = 2 * pi * i / around;
      m.nodes.push_back({radius * std::cos(angle), radius * std::sin(angle), z});
    }
  };
  for (int l = 0; l <= levels; ++l) ring(hole_radius, 0.2 * (l - levels));
  for (int l = 0; l < levels; ++l)
    for (int i = 0; i < around; ++i) {
      const int a = l * around + i, b = l * around + (i + 1) % around;
      m.facets.push_back({b, a, a + around, b + around});
    }
  if (has_bottom) {
    const int first = static_cast<int>(m.nodes.size());
    ring(0.6 * hole_radius, -0.2 * levels);
    for (int i = 0; i < around; ++i) {
      const int j = (i + 1) % around;
      m.facets.push_back({i, j, first + j, first + i});
    }
  }
  return m;
}

Vec3 sum(const Vec3s& v) {
  Vec3 s = Vec3::Zero();
  for (const Vec3& x : v) s += x;
  return s;
}

Vec3s still(const InterfaceFacets& f) { return Vec3s(f.node_count(), Vec3::Zero()); }

}  // namespace

// --------------------------------------------------------------------------------------------------- closest point

TEST_CASE("The foot of a centre above a known point of a warped facet is that point") {
  // c = x(xi, eta) + d n with d well below the radius of curvature has its closest point there.
  Random random(1);
  double worst = 0;
  for (int i = 0; i < 2000; ++i) {
    FacetCorners x = {Vec3(0, 0, 0), Vec3(0.1, 0, 0), Vec3(0.1, 0.2, 0), Vec3(0, 0.2, 0)};
    for (Vec3& corner : x) corner += 0.015 * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    const double xi = random.uniform(-0.999, 0.999), eta = random.uniform(-0.999, 0.999);
    const Vec3 normal = facet_tangent_xi(x, eta).cross(facet_tangent_eta(x, xi)).normalized();
    const double d = random.uniform(-0.03, 0.03);
    const FacetPoint foot = closest_point(x, interpolate(bilinear_weights(xi, eta), x) + d * normal);
    worst = std::max({worst, std::abs(foot.xi - xi), std::abs(foot.eta - eta)});
    REQUIRE(foot.feature == FacetFeature::Face);
    REQUIRE((foot.facet_normal - normal).norm() < 1e-10);
    REQUIRE(foot.distance == Approx(std::abs(d)).margin(1e-14));
  }
  CAPTURE(worst);
  CHECK(worst < 1e-12);
}

TEST_CASE("No sampled point of a strongly warped facet is closer than its foot") {
  Random random(2);
  double worst = 0;
  for (int i = 0; i < 200; ++i) {
    FacetCorners x = {Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(1, 1, 0), Vec3(0, 1, 0)};
    for (Vec3& corner : x) corner += 0.4 * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    const Vec3 c(random.uniform(-1, 2), random.uniform(-1, 2), random.uniform(-1, 1));
    const FacetPoint foot = closest_point(x, c);
    REQUIRE((foot.point - interpolate(foot.weights, x)).norm() == 0);
    for (int a = 0; a <= 100; ++a)
      for (int b = 0; b <= 100; ++b) {
        const double d = (interpolate(bilinear_weights(a / 50.0 - 1, b / 50.0 - 1), x) - c).norm();
        worst = std::max(worst, foot.distance - d);
      }
  }
  CAPTURE(worst);
  CHECK(worst < 1e-9);
}

TEST_CASE("The foot names the edge or node it lies on") {
  const FacetCorners x = {Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(1, 1, 0), Vec3(0, 1, 0)};
  const std::array<Vec3, 4> beside_edge = {Vec3(0.3, -1, 1), Vec3(2, 0.3, 1), Vec3(0.3, 2, 1), Vec3(-1, 0.3, 1)};
  const std::array<Vec3, 4> beside_node = {Vec3(-1, -1, 1), Vec3(2, -1, 1), Vec3(2, 2, 1), Vec3(-1, 2, 1)};
  for (int k = 0; k < 4; ++k) {
    const FacetPoint edge = closest_point(x, beside_edge[k]), node = closest_point(x, beside_node[k]);
    CHECK(edge.feature == FacetFeature::Edge);
    CHECK(edge.feature_index == k);
    CHECK(node.feature == FacetFeature::Vertex);
    CHECK(node.feature_index == k);
    CHECK((node.point - x[k]).norm() == 0);
    CHECK(node.weights[k] == 1);
  }
}

// ---------------------------------------------------------------------------------------------- one contact, no jump

TEST_CASE("Anywhere on a plane of facets a sphere has one contact with k_n U along the normal") {
  // Over faces, edges (a coordinate is a multiple of h) and nodes; the plane is tilted, so that nothing is exact by
  // chance.
  const double h = 0.05, overlap = 2e-4;
  Mesh mesh = sheet(6, h, [](double, double) { return 0.0; });
  const Quat tilt(Eigen::AngleAxisd(0.3, Vec3(1, 2, 3).normalized()));
  for (Vec3& node : mesh.nodes) node = tilt * node;
  Random random(3);
  double worst = 0;
  for (int i = 0; i < 3000; ++i) {
    InterfaceFacets surface = mesh.surface();
    const auto coordinate = [&] {
      const double u = random.uniform();
      const double at = h * (1 + std::floor(4.999 * random.uniform()));
      return u < 0.4 ? at : u < 0.6 ? at + 1e-12 * random.uniform(-1, 1) : random.uniform(h, 5 * h);
    };
    const double x = coordinate(), y = coordinate();
    Particles p = spheres_at({tilt * Vec3(x, y, R - overlap)});
    const FacetTotals totals = surface.compute(p, material(0), 0);
    REQUIRE(totals.contacts == 1);
    worst = std::max(worst, (p.force(0) - tilt * Vec3(0, 0, k_n * overlap)).norm() / (k_n * overlap));
    double stiffness = 0;
    for (const double k : surface.node_stiffness()) stiffness += k;
    REQUIRE(stiffness == Approx(k_n).epsilon(1e-12));
  }
  CAPTURE(worst);
  CHECK(worst < 1e-10);
}

TEST_CASE("A shear spring goes on growing over edges and nodes of a plane") {
  // Held at overlap U and moved along a diagonal over 5 facets without slip: the spring is k_s times the path, to
  // round-off.
  const double h = 0.05, overlap = 2e-4, dt = 1e-4;
  InterfaceFacets surface = sheet(6, h, [](double, double) { return 0.0; }).surface();
  for (const Vec3& direction : {Vec3(1, 1, 0), Vec3(1, 0, 0), Vec3(1, 0.37, 0)}) {
    surface.clear_history();
    Particles p = spheres_at({{0.5 * h, 0.5 * h, R - overlap}});
    p.velocity(0) = 2.0 * direction;
    const Vec3 start = p.position(0);
    double worst = 0;
    for (int n = 1; n <= 1000; ++n) {
      put(p, start + p.velocity(0) * dt * n);
      REQUIRE(surface.compute(p, material(1e9), dt).contacts == 1);
      const Vec3 expected = Vec3(0, 0, k_n * overlap) - k_s * n * dt * p.velocity(0);
      worst = std::max(worst, (p.force(0) - expected).norm() / expected.norm());
    }
    CAPTURE(direction.transpose(), worst);
    CHECK(worst < 1e-11);
  }
}

TEST_CASE("A sphere rolled around the hole's side has one contact and a force without jumps") {
  // t is the way from the centre to a convex set: a step of length s changes the force by k_n s at most. The deepest
  // facet alone would jump by 2 sin(theta/2) k_n U at each edge.
  for (const int around : {8, 16, 32}) {
    InterfaceFacets surface = hole(around, 2, false).surface();
    const double half = pi / around, overlap = 3e-4;
    const double r = hole_radius * std::cos(half) - R + overlap;
    const int steps = 20000;
    double worst = 0, deepest = 0;
    Vec3 last = Vec3::Zero(), last_center = Vec3::Zero();
    for (int i = 0; i <= steps; ++i) {
      const double angle = 4 * half * i / steps + 0.3 * half;  // over two edges
      // A polygon's edges lie at (1 + 2 k) half from a node; keep the same overlap with the nearest face.
      const double off = std::remainder(angle - half, 2 * half);
      const double q = r / std::cos(off);
      Particles p = spheres_at({{q * std::cos(angle), q * std::sin(angle), -0.17}});
      const FacetTotals totals = surface.compute(p, material(0), 0);
      REQUIRE(totals.contacts == 1);
      if (i > 0) worst = std::max(worst, (p.force(0) - last).norm() / (k_n * (p.position(0) - last_center).norm()));
      deepest = std::max(deepest, surface.contacts()[0].overlap);
      last = p.force(0);
      last_center = p.position(0);
    }
    INFO(around << " facets: largest change " << worst << " of k_n s, jump of the deepest alone "
                << 2 * std::sin(half) * overlap / (4 * half * r / steps) << "; largest overlap / U "
                << deepest / overlap);
    CHECK(worst < 1 + 1e-6);
    CHECK(worst > 0.1);
    CHECK(deepest < overlap / std::cos(half) * (1 + 1e-9));
  }
}

TEST_CASE("No energy comes from rolling around over a concave edge") {
  // Force along closed rectangular loops across the edge of a 32-facet hole, integrated by the midpoint rule with n and
  // 2 n points: the work must vanish against the elastic energy, half of k_n U^2.
  InterfaceFacets surface = hole(32, 2, false).surface();
  const double half = pi / 32, deep = 6e-4;
  const double r0 = (hole_radius * std::cos(half) - R + deep) / std::cos(half);  // over the edge both overlaps are U
  const auto work = [&](int n) {
    // Off the bisector: from -0.01 to 0.2 mm across the edge at angle 0 and 0.5 mm along the radius.
    const std::array<Vec3, 5> corner = {Vec3(r0, -1e-5, -0.17), Vec3(r0, 2e-4, -0.17), Vec3(r0 + 5e-4, 2e-4, -0.17),
                                        Vec3(r0 + 5e-4, -1e-5, -0.17), Vec3(r0, -1e-5, -0.17)};
    double total = 0;
    for (int leg = 0; leg < 4; ++leg)
      for (int i = 0; i < n; ++i) {
        const Vec3 along = corner[leg + 1] - corner[leg];
        Particles p = spheres_at({corner[leg] + (i + 0.5) / n * along});
        REQUIRE(surface.compute(p, material(0), 0).contacts == 1);
        total += p.force(0).dot(along) / n;
      }
    return total;
  };
  const double coarse = work(400), fine = work(800);
  const double energy = 0.5 * k_n * deep * deep;
  INFO("work around the loop " << fine / energy << " of the elastic energy (" << coarse / energy
                               << " with half the points)");
  CHECK(std::abs(fine) < 1e-4 * energy);
}

TEST_CASE("Where side meets bottom at a right angle a sphere has two contacts") {
  InterfaceFacets surface = hole(32, 2, true).surface();
  const double half = pi / 32, overlap = 2e-4;
  for (const double angle : {half, 2 * half, 2.7 * half}) {
    const double off = std::remainder(angle - half, 2 * half);
    const double r = (hole_radius * std::cos(half) - R + overlap) / std::cos(off);
    Particles p = spheres_at({{r * std::cos(angle), r * std::sin(angle), -0.4 + R - overlap}});
    const FacetTotals totals = surface.compute(p, material(0), 0);
    CAPTURE(angle, p.force(0).transpose(), k_n * overlap);
    CHECK(totals.contacts == 2);
    CHECK(p.force(0).z() == Approx(k_n * overlap).epsilon(1e-9));
    const double outwards = -p.force(0).dot(Vec3(std::cos(angle), std::sin(angle), 0));
    // The side's part: k_n U, over an edge of the side k_n U / cos(half).
    CHECK(outwards > std::cos(half) * k_n * overlap);
    CHECK(outwards < (1 + 1e-9) * k_n * overlap / std::cos(half));
  }
}

TEST_CASE("Around a convex right-angle edge a sphere has one contact whose normal and spring turn with it") {
  // A strip along +x that turns down at x = 0: normals +z, then +x.
  InterfaceFacets surface = strip({{-0.1, 0}, {0, 0}, {0, -0.1}}).surface();
  const double overlap = 2e-4, d = R - overlap, dt = 1e-4;
  Particles p = spheres_at({Vec3::Zero()});
  const int steps = 1000;
  double worst_normal = 0, worst_turn = 0;
  Vec3 last = Vec3::Zero();
  const double path = 0.04 + d * pi / 2;
  for (int i = 0; i <= steps; ++i) {
    const double s = i * path / steps - 0.02;
    const double angle = std::clamp(s / d, 0.0, pi / 2);
    const Vec3 normal(std::sin(angle), 0, std::cos(angle));
    put(p, d * normal + Vec3(std::min(0.0, s), 0.01, -std::max(0.0, s - d * pi / 2)));
    p.velocity(0) = Vec3(0, 0.1, 0);  // for a spring along the edge
    REQUIRE(surface.compute(p, material(1e9), dt).contacts == 1);
    const Vec3 expected = k_n * overlap * normal - Vec3(0, (i + 1) * k_s * dt * 0.1, 0);
    worst_normal = std::max(worst_normal, (p.force(0) - expected).norm() / expected.norm());
    if (i > 0) worst_turn = std::max(worst_turn, (p.force(0) - last).norm() / (k_n * overlap));
    last = p.force(0);
  }
  CAPTURE(worst_normal, worst_turn);
  CHECK(worst_normal < 1e-9);
  CHECK(worst_turn < 1.01 * std::hypot(path / steps / d, k_s * dt * 0.1 / (k_n * overlap)));
}

TEST_CASE("From inside a convex edge a sphere is pushed out through the nearer side alone") {
  InterfaceFacets surface = strip({{-0.1, 0}, {0, 0}, {0, -0.1}}).surface();
  Particles p = spheres_at({{-0.5 * R, 0.1, -0.2 * R}});
  const FacetTotals totals = surface.compute(p, material(0), 0);
  CAPTURE(p.force(0).transpose());
  CHECK(totals.contacts == 1);
  CHECK((p.force(0) - Vec3(0, 0, 1.2 * k_n * R)).norm() < 1e-9 * k_n * R);
}

TEST_CASE("In a concave right-angle edge each contact keeps its own spring") {
  // A floor that turns up at x = 0 into a wall facing -x; moved along y, both springs grow alike over the facets' joint
  // y = 0.
  InterfaceFacets surface = strip({{-0.1, 0}, {0, 0}, {0, 0.1}}).surface();
  const double overlap = 2e-4, dt = 1e-4, v = 0.5;
  Particles p = spheres_at({{-R + overlap, -0.02, R - overlap}});
  p.velocity(0) = Vec3(0, v, 0);
  const int steps = 800;
  for (int i = 1; i <= steps; ++i) {
    put(p, {-R + overlap, -0.02 + i * v * dt, R - overlap});
    REQUIRE(surface.compute(p, material(1e9), dt).contacts == 2);
  }
  const double expected = -2 * k_s * steps * v * dt;
  CAPTURE(p.force(0).transpose(), expected);
  CHECK(p.force(0).y() == Approx(expected).epsilon(1e-10));
  CHECK(p.force(0).z() == Approx(k_n * overlap).epsilon(1e-9));
}

TEST_CASE("A right angle pushes a deep sphere back from behind either side") {
  InterfaceFacets surface = strip({{-0.1, 0}, {0, 0}, {0, 0.1}}).surface();
  Particles p = spheres_at({{0.2 * R, 0.1, 0.5 * R}});  // behind the wall, above the floor's level
  CHECK(surface.compute(p, material(0), 0).contacts >= 1);
  CHECK(p.force(0).x() == Approx(-k_n * 1.2 * R).epsilon(1e-9));
  put(p, {0.1 * R, 0.1, -0.1 * R});  // behind both: back over the edge, which is the closest point
  CHECK(surface.compute(p, material(0), 0).contacts == 1);
  const double deep = k_n * (1 + 0.1 * std::sqrt(2.0)) * R;
  CHECK((p.force(0) - deep * Vec3(-1, 0, 1) / std::sqrt(2.0)).norm() < 1e-9 * deep);
}

// ------------------------------------------------------------------------------------------- sides and tunnelling

TEST_CASE("A sphere that went through is pushed back, and counted once it is deep") {
  InterfaceFacets surface = sheet(4, 0.05, [](double, double) { return 0.0; }).surface();
  for (const double z : {0.4, 1e-14, 0.0, -1e-14, -0.3, -0.49, -0.51, -0.99}) {
    for (const Vec3& over : {Vec3(0.07, 0.08, 0), Vec3(0.1, 0.08, 0), Vec3(0.1, 0.1, 0)}) {
      surface.clear_history();
      Particles p = spheres_at({over + Vec3(0, 0, z * R)});
      const FacetTotals totals = surface.compute(p, material(0), 0);
      CAPTURE(z, over.transpose(), p.force(0).transpose());
      CHECK(totals.contacts == 1);
      CHECK(p.force(0).z() == Approx(k_n * R * (1 - z)).epsilon(1e-9));
      CHECK(p.force(0).head<2>().norm() < 1e-9 * p.force(0).z());
      CHECK(totals.tunnelled == (z < -0.5 ? 1 : 0));
      CHECK(surface.tunnelled() == totals.tunnelled);
    }
  }
  Particles p = spheres_at({Vec3(0.07, 0.08, -1.01 * R)});
  CHECK(surface.compute(p, material(0), 0).contacts == 0);
}

// ---------------------------------------------------------------------------------------------- action = reaction

TEST_CASE("Grains and nodes get opposite forces; the moments differ by |F_s| U/2 and no more") {
  // Nodal forces N_j F at x_j have the moment of F at the foot, grains that of -F at x_C, U/2 behind the foot along the
  // normal: the difference is (U/2) n x F_s.
  Mesh mesh = sheet(3, 0.05, [](double x, double y) { return 0.3 * x * y + 0.5 * x * x; });
  InterfaceFacets surface = mesh.surface();
  const Vec3 at = interpolate(bilinear_weights(0.3, -0.4), surface.corners(4));
  const FacetCorners x = surface.corners(4);
  const Vec3 normal = facet_tangent_xi(x, -0.4).cross(facet_tangent_eta(x, 0.3)).normalized();
  const double overlap = 5e-4;
  Particles p = spheres_at({at + (R - overlap) * normal});
  p.velocity(0) = Vec3(0.5, -0.3, 0.2);
  p.spin(0) = Vec3(3, 5, -2);
  const FacetTotals totals = surface.compute(p, material(0.5), 1e-4);
  REQUIRE(totals.contacts == 1);
  const FacetContact contact = surface.contacts().at(0);
  CHECK((contact.foot - at).norm() < 1e-13);

  const Vec3 balance = p.force(0) + sum(surface.nodal_force());
  Vec3 moment = p.moment(0);
  for (std::size_t i = 0; i < surface.node_count(); ++i)
    moment += surface.positions()[i].cross(surface.nodal_force()[i]);
  const Vec3 shear = p.force(0) - p.force(0).dot(normal) * normal;
  const double expected = shear.norm() * overlap / 2;
  INFO("force " << balance.norm() << " N of " << p.force(0).norm() << "; moment " << moment.norm() << " N m, expected "
                << expected << ", reported " << totals.neglected_moment);
  CHECK(shear.norm() > 1);
  CHECK(balance.norm() < 1e-14 * p.force(0).norm());
  CHECK(moment.norm() == Approx(expected).epsilon(1e-9));
  CHECK(totals.neglected_moment == Approx(expected).epsilon(1e-9));
  CHECK((sum(surface.facet_force()) + p.force(0)).norm() < 1e-14 * p.force(0).norm());
}

namespace {

Vec3 moment_on_nodes(const InterfaceFacets& surface) {
  Vec3 moment = Vec3::Zero();
  for (std::size_t i = 0; i < surface.node_count(); ++i)
    moment += (surface.positions()[i] + surface.offsets()[i]).cross(surface.nodal_force()[i]);
  return moment;
}

// Of the largest number in them, moments about the origin: |M_grains + M_nodes|, |F_grains + F_nodes|, and what the power on
// grains lacks of what the nodes lose.
struct Gaps {
  double force = 0, moment = 0, power = 0;
};

Gaps gaps_of(InterfaceFacets& surface, Particles& p, const FacetMaterial& m, double dt) {
  const FacetTotals totals = surface.compute(p, m, dt);
  const Vec3 moment = moment_on_nodes(surface);
  double lost = 0;
  for (std::size_t i = 0; i < surface.node_count(); ++i) lost -= surface.nodal_force()[i].dot(surface.velocity()[i]);
  return {(totals.particle_force + sum(surface.nodal_force())).norm() / totals.particle_force.norm(),
          (totals.particle_moment + moment).norm() / totals.particle_moment.norm(),
          std::abs(totals.power - lost) / std::abs(lost)};
}

}  // namespace

TEST_CASE("With exact transfer the nodes get the whole moment, and the works still match") {
  // Any velocities of nodes and grain, warped facets, a shallow edge (two facets share the contact) and a rim's collar.
  FacetMaterial exact = material(0.5), paper = material(0.5);
  exact.transfers_moment = true;
  Random random(11);
  const auto stirred = [&](InterfaceFacets surface) {
    Vec3s velocity;
    for (std::size_t i = 0; i < surface.node_count(); ++i)
      velocity.emplace_back(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    surface.set_velocity(velocity);
    return surface;
  };
  const auto thrown = [&](const Vec3& center) {
    Particles p = spheres_at({center});
    p.velocity(0) = Vec3(0.5, -0.3, 0.2);
    p.spin(0) = Vec3(3, 5, -2);
    return p;
  };
  const Mesh wavy = sheet(3, 0.05, [](double x, double y) { return 0.3 * x * y + 0.5 * x * x; });
  const Mesh valley = strip({{-0.1, 0.02}, {0.0, 0.0}, {0.1, 0.02}});
  struct Case {
    const char* name;
    InterfaceFacets surface;
    Vec3 center;
  };
  for (const Case& c :
       {Case{"warped facet", stirred(wavy.surface()), {0.07, 0.06, R + 0.0025}},
        Case{"shallow edge", stirred(valley.surface()), {0.001, 0.05, R * 1.01}},
        Case{"collar", stirred(hole(16, 3, true).surface(0.25)), {hole_radius - 0.97 * R, 0.03, 0.05}}}) {
    InterfaceFacets surface = c.surface;
    Particles p = thrown(c.center);
    const Gaps gaps = gaps_of(surface, p, exact, 1e-4);
    InterfaceFacets again = c.surface;
    Particles q = thrown(c.center);
    const Gaps dropped = gaps_of(again, q, paper, 1e-4);
    INFO(c.name << ": force " << gaps.force << ", moment " << gaps.moment << " (eq. 13: " << dropped.moment
                << "), power " << gaps.power);
    REQUIRE(surface.contact_count() == 1);
    CHECK(gaps.force < 1e-13);
    CHECK(gaps.moment < 1e-13);
    CHECK(gaps.power < 1e-12);
    CHECK(dropped.moment > 1e-5);
    CHECK(dropped.force < 1e-13);
    CHECK(dropped.power < 1e-12);
  }
}

TEST_CASE("Exact transfer changes nothing for a force along the normal") {
  FacetMaterial exact = material(0.5);
  exact.transfers_moment = true;
  const Mesh flat = sheet(3, 0.05, [](double, double) { return 0; });
  InterfaceFacets one = flat.surface(), other = flat.surface();
  Particles p = spheres_at({{0.06, 0.08, 0.99 * R}}), q = p;
  one.compute(p, material(0.5), 0), other.compute(q, exact, 0);
  for (std::size_t i = 0; i < one.node_count(); ++i)
    CHECK((one.nodal_force()[i] - other.nodal_force()[i]).norm() < 1e-13 * p.force(0).norm());
}

TEST_CASE("The facets' power on the grains is what the nodes lose") {
  // Rigidly translated and rotated nodes: sum F_node . v_node = -sum F_grain . v_facet.
  InterfaceFacets surface = sheet(4, 0.05, [](double x, double y) { return x * y; }).surface();
  Vec3s velocity;
  for (const Vec3& x : surface.positions()) velocity.push_back(Vec3(0.1, 0.2, 0.3) + Vec3(1, -2, 3).cross(x));
  surface.set_velocity(velocity);
  Particles p = spheres_at({{0.07, 0.09, 0.006 + R - 1e-4}, {0.12, 0.11, 0.013 + R - 2e-4}});
  const FacetTotals totals = surface.compute(p, material(0.01), 1e-4);
  CHECK(totals.contacts == 2);
  double power = 0;
  for (std::size_t i = 0; i < velocity.size(); ++i) power -= velocity[i].dot(surface.nodal_force()[i]);
  CAPTURE(totals.power, power);
  CHECK(totals.power == Approx(power).epsilon(1e-12));
  CHECK(totals.slip_work > 0);
}

TEST_CASE("The velocity at a contact is the nodes' by N_j, and offsets add theirs") {
  // A facet sheared as v = (a x + b y, 0, 0), which bilinear weights reproduce; without slip one step gives k_s v dt.
  InterfaceFacets surface = sheet(3, 0.05, [](double, double) { return 0.0; }).surface();
  Vec3s velocity = still(surface);
  for (std::size_t i = 0; i < velocity.size(); ++i)
    velocity[i].x() = 2 * surface.positions()[i].x() + 3 * surface.positions()[i].y();
  surface.set_velocity(velocity);
  const Vec3s servo(surface.node_count(), Vec3(0, 0.25, 0));
  surface.move_offsets(servo, 0);
  Particles p = spheres_at({{0.061, 0.083, R - 1e-4}});
  surface.compute(p, material(1e9), 1e-3);
  const Vec3 expected = k_s * 1e-3 * Vec3(2 * 0.061 + 3 * 0.083, 0.25, 0);
  CAPTURE(p.force(0).transpose(), expected.transpose());
  CHECK((p.force(0).head<2>() - expected.head<2>()).norm() < 1e-11 * expected.norm());
}

TEST_CASE("Elastic energy and largest overlap are those of the springs") {
  InterfaceFacets surface = sheet(3, 0.05, [](double, double) { return 0.0; }).surface();
  const double overlap = 1e-4, dt = 1e-4, v = 0.2;
  Particles p = spheres_at({{0.061, 0.083, R - overlap}});
  p.velocity(0) = Vec3(v, 0, 0);
  const FacetTotals totals = surface.compute(p, material(1e9), dt);
  const double energy = 0.5 * k_n * overlap * overlap + 0.5 * k_s * v * v * dt * dt;
  CAPTURE(totals.elastic_energy, energy);
  CHECK(totals.elastic_energy == Approx(energy).epsilon(1e-10));
  CHECK(totals.max_overlap == Approx(overlap / R).epsilon(1e-10));
  CHECK(totals.normal_force == Approx(k_n * overlap).epsilon(1e-10));
}

// --------------------------------------------------------------------------------------------------- collar, offsets

TEST_CASE("The collar holds grains above the surface and hands their force to the ring below") {
  const double height = 0.25, overlap = 1e-4, half = pi / 32;
  InterfaceFacets surface = hole(32, 2, true).surface(height);
  CHECK(surface.facet_count() == 96);
  CHECK(surface.collar_count() == 32);
  CHECK(sheet(3, 0.05, [](double, double) { return 0.0; }).surface(0).collar_count() == 0);
  for (std::size_t f = 96; f < 128; ++f) {  // its normals point inwards as the side's do
    const Vec3 center = surface.center(f);
    CHECK(surface.area_vector(f).normalized().dot(-Vec3(center.x(), center.y(), 0).normalized()) == Approx(1));
  }
  const double r = hole_radius * std::cos(half) - R + overlap;
  for (const double z : {0.1, 1e-13, 0.0, -0.05}) {  // collar, the edge between, side
    surface.clear_history();
    Particles p = spheres_at({{r * std::cos(half), r * std::sin(half), z}});
    const FacetTotals totals = surface.compute(p, material(0), 0);
    CAPTURE(z, p.force(0).transpose());
    CHECK(totals.contacts == 1);
    CHECK((p.force(0) + k_n * overlap * Vec3(std::cos(half), std::sin(half), 0)).norm() < 1e-9 * k_n * overlap);
    const Vec3 ring = surface.nodal_force()[64] + surface.nodal_force()[65];
    if (z >= 0) CHECK((ring + p.force(0)).norm() < 1e-9 * k_n * overlap);
    CHECK((surface.facet_force()[32] + p.force(0)).norm() < 1e-12 * k_n * overlap);
    CHECK(surface.facet_stiffness()[32] == Approx(k_n));
  }
  // Its upper nodes move with the ring.
  Vec3s velocity = still(surface);
  velocity[64] = velocity[65] = {0, 0, 1};
  surface.advance(velocity, 0.01);
  CHECK(surface.center(96).z() == Approx(0.125 + 0.01));
}

TEST_CASE("Positions advance by x += v dt to the last bit, and offsets leave their hash alone") {
  const Mesh mesh = hole(8, 3, true);
  InterfaceFacets surface = mesh.surface(0.25);
  Vec3s x = mesh.nodes, velocity(x.size());
  Random random(5);
  for (int step = 0; step < 50; ++step) {
    const double dt = random.uniform(1e-5, 1e-4);
    for (std::size_t i = 0; i < x.size(); ++i) {
      velocity[i] = {random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
      for (int k = 0; k < 3; ++k) x[i][k] = x[i][k] + velocity[i][k] * dt;
    }
    surface.advance(velocity, dt);
  }
  Hash h;
  h.add(std::span<const Vec3>(x));
  CHECK(surface.position_hash() == h.value());
  CHECK(surface.positions() == x);
  surface.set_offsets(Vec3s(x.size(), Vec3(0, 0, 0.001)));
  CHECK(surface.position_hash() == h.value());
  CHECK((surface.corners(0)[0] - x[static_cast<std::size_t>(surface.nodes_of(0)[0])] - Vec3(0, 0, 0.001)).norm() <
        1e-15);
}

// ------------------------------------------------------------------------------------------------- lists and state

TEST_CASE("Facets moved in parts end where one move takes them, to the last bit") {
  InterfaceFacets whole = sheet(2, 0.05, [](double x, double) { return x / 3; }).surface(), parts = whole;
  Random random(5);
  for (int n = 0; n < 20; ++n) {
    Vec3s velocity;
    for (std::size_t i = 0; i < whole.node_count(); ++i)
      velocity.emplace_back(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    whole.advance(velocity, 1e-4 / 3);
    for (std::uint32_t k = 1; k <= 7; ++k) parts.advance_part(velocity, 1e-4 / 3, k, 7);
    REQUIRE(whole.position_hash() == parts.position_hash());
  }
}

TEST_CASE("Candidate lists do not change the answer, nor does a restart") {
  // A cloud wanders in a hole whose nodes move; beside it a surface that is restored each step and so lists anew.
  Random random(6);
  const Mesh mesh = hole(16, 2, true);
  InterfaceFacets surface = mesh.surface(0.25), fresh = surface;
  Vec3s centers;
  for (int i = 0; i < 300; ++i) {
    const double angle = random.uniform(0, 2 * pi), r = 0.42 * std::sqrt(random.uniform());
    centers.push_back({r * std::cos(angle), r * std::sin(angle), random.uniform(-0.38, 0.1)});
  }
  Particles p = spheres_at(centers);
  std::size_t contacts = 0;
  Vec3s velocity = still(surface);
  for (int step = 0; step < 100; ++step) {
    for (std::size_t b = 0; b < p.body_count(); ++b)
      p.position(b) += 0.01 * random.uniform() * random.uniform() *
                       Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    for (Vec3& v : velocity) v = 10 * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    p.place_pebbles();
    p.clear_forces();
    Particles q = p;
    fresh.restore(fresh.state());
    surface.advance(velocity, 1e-4);
    fresh.advance(velocity, 1e-4);
    contacts += surface.compute(p, material(0.5), 1e-4).contacts;
    fresh.compute(q, material(0.5), 1e-4);
    Hash with, without;
    surface.hash(with), with.add(std::span<const Vec3>(forces_on(p))),
        with.add(std::span<const Vec3>(surface.nodal_force()));
    fresh.hash(without), without.add(std::span<const Vec3>(forces_on(q))),
        without.add(std::span<const Vec3>(fresh.nodal_force()));
    REQUIRE(with.value() == without.value());
  }
  CAPTURE(contacts);
  CHECK(contacts > 3000);
  FacetState wrong = surface.state();
  wrong.offsets.pop_back();
  CHECK_THROWS_AS(surface.restore(wrong), InputError);
}

namespace {

// Let every pair through and know none of the feet: each contact is found facet by facet.
const FacetKernels blind = {
    [](const FacetSurface&, const FacetPairs&, std::int32_t begin, std::int32_t end, double, std::int32_t* near) {
      for (std::int32_t k = begin; k < end; ++k) near[k - begin] = k;
      return end - begin;
    },
    [](const FacetSurface&, const FacetPairs&, const std::int32_t*, std::int32_t count, FaceFoot*,
       FaceContact* contacts) { std::fill_n(contacts, count, FaceContact::Unknown); }};

}  // namespace

TEST_CASE("Kernels know the feet inside faces that closest_point() finds, to the last bit") {
  // Slanted parallelograms of 0.1 x 0.2 m whose corners are moved by up to `warp` along each axis.
  struct Kind {
    const char* name;
    double warp;       // [m]
    bool knows_faces;  // all feet inside faces
  };
  for (const InstructionSet set : known_instructions())
    for (const Kind& kind : {Kind{"parallelogram", 0, true}, Kind{"warped as the ground deforms", 1e-4, true},
                             Kind{"warped", 0.005, false}, Kind{"twisted", 0.08, false}}) {
      Random random(12);
      const FacetKernels kernels = facet_kernels(set);
      const std::size_t count = 203;  // not a multiple of any block
      std::vector<FacetNode> nodes;
      std::vector<FacetCorners> corners;
      std::vector<FacetBox> boxes(count);  // of no extent: everything is far from them
      std::vector<std::array<std::int32_t, 4>> facets;
      std::vector<std::int32_t> all(count);
      std::vector<SphereRecord> spheres;
      for (std::size_t k = 0; k < count; ++k) {
        all[k] = static_cast<std::int32_t>(k);
        const Vec3 along = 0.05 * Vec3(1, random.uniform(-0.3, 0.3), 0.2),
                   across = 0.1 * Vec3(-0.2, 1, random.uniform(-1, 1));
        const Vec3 middle(random.uniform(-5, 5), random.uniform(-5, 5), random.uniform(-5, 5));
        FacetCorners x = {middle - along - across, middle + along - across, middle + along + across,
                          middle - along + across};
        for (Vec3& corner : x) {
          corner += kind.warp * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
          nodes.push_back({corner.x(), corner.y(), corner.z(), 0, 0, 0, 0, 0});
        }
        const auto first = static_cast<std::int32_t>(4 * k);
        facets.push_back({first, first + 1, first + 2, first + 3});
        corners.push_back(x);
        const double xi = random.uniform(-1.2, 1.2), eta = random.uniform(-1.2, 1.2);
        const Vec3 normal = facet_tangent_xi(x, eta).cross(facet_tangent_eta(x, xi)).normalized();
        const Vec3 c = interpolate(bilinear_weights(xi, eta), x) + random.uniform(-0.5, 1.05) * R * normal;
        spheres.push_back({c.x(), c.y(), c.z(), R});
      }
      const FacetSurface surface = {spheres.data(), nodes.data(), boxes.data(),
                                    reinterpret_cast<const std::int32_t(*)[4]>(facets.data())};
      const FacetPairs pairs = {all.data(), all.data()};
      std::vector<FaceFoot> feet(count + facet_block);
      std::vector<FaceContact> contacts(count + facet_block);
      kernels.find_feet(surface, pairs, all.data(), static_cast<std::int32_t>(count), feet.data(), contacts.data());
      std::size_t touching = 0, faces = 0;
      for (std::size_t k = 0; k < count; ++k) {
        const Vec3 center(spheres[k].x, spheres[k].y, spheres[k].z);
        const FacetPoint foot = closest_point(corners[k], center);
        faces += foot.feature == FacetFeature::Face;
        CAPTURE(name_of(set), kind.name, k, foot.xi, foot.eta);
        if (contacts[k] == FaceContact::Unknown) {
          REQUIRE_FALSE((kind.knows_faces && foot.feature == FacetFeature::Face));
          continue;
        }
        REQUIRE(foot.feature == FacetFeature::Face);
        REQUIRE((contacts[k] == FaceContact::Touching) == (foot.distance < R));
        touching += contacts[k] == FaceContact::Touching;
        for (std::size_t j = 0; j < 4; ++j) REQUIRE(feet[k].weight[j] == foot.weights[j]);
        REQUIRE(Vec3(feet[k].nx, feet[k].ny, feet[k].nz) == foot.facet_normal);
        REQUIRE(feet[k].overlap == R - (center - foot.point).dot(foot.facet_normal));
      }
      CAPTURE(name_of(set), kind.name, touching, faces);
      CHECK(faces > 50);
      CHECK((touching > 50) == (kind.warp < 0.05));  // a twisted one is left to closest_point()
    }
}

TEST_CASE("Feet from kernels or one by one, any instructions, any number of threads: the same bits") {
  // A cloud wanders in a hole with a collar whose nodes move: contacts on faces, edges, corners and the rim.
  struct Way {
    std::string name;
    FacetKernels kernels;
    int threads;
    InterfaceFacets surface = {};
    std::unique_ptr<Team> team = {};
  };
  for (const bool transfers_moment : {false, true}) {
    const Mesh mesh = hole(16, 3, true);
    std::vector<Way> ways;
    ways.push_back({"one by one", blind, 1});
    for (const InstructionSet set : known_instructions())
      ways.push_back({std::string(name_of(set)), facet_kernels(set), 1});
    ways.push_back({"3 threads", facet_kernels(best_instructions()), 3});
    for (Way& way : ways) {
      way.surface = InterfaceFacets(mesh.nodes, mesh.facets, 0.25, way.kernels);
      way.team = std::make_unique<Team>(way.threads);
    }
    Random random(13);
    Vec3s centers;
    for (int i = 0; i < 400; ++i) {
      const double angle = random.uniform(0, 2 * pi), r = 0.425 * std::sqrt(random.uniform());
      centers.push_back({r * std::cos(angle), r * std::sin(angle), random.uniform(-0.59, 0.1)});
    }
    Particles p = spheres_at(centers);
    FacetMaterial law = material(0.5);
    law.damping_ratio = 0.1;
    law.transfers_moment = transfers_moment;
    std::size_t contacts = 0, shared = 0;
    Vec3s velocity = still(ways[0].surface);
    for (int step = 0; step < 60; ++step) {
      for (std::size_t b = 0; b < p.body_count(); ++b) {
        p.position(b) += 0.01 * random.uniform() * random.uniform() *
                         Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
        p.velocity(b) = Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
      }
      for (Vec3& v : velocity) v = 3 * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
      p.place_pebbles();
      std::uint64_t first = 0;
      for (Way& way : ways) {
        p.clear_forces();
        way.surface.advance(velocity, 1e-4);
        const FacetTotals t = way.surface.compute(p, law, 1e-4, {}, *way.team);
        Hash h;
        way.surface.hash(h);
        h.add(std::span<const Vec3>(forces_on(p)));
        h.add(std::span<const Vec3>(way.surface.nodal_force()));
        h.add(std::span<const Vec3>(way.surface.facet_force()));
        for (const double k : way.surface.node_stiffness()) h.add(k);
        for (const double k : way.surface.facet_stiffness()) h.add(k);
        for (const Vec3& v : {t.particle_force, t.particle_moment}) h.add(v);
        for (const double sum :
             {t.normal_force, t.neglected_moment, t.elastic_energy, t.slip_work, t.dashpot_work, t.power, t.max_overlap,
              static_cast<double>(t.contacts), static_cast<double>(t.tunnelled)})
          h.add(sum);
        if (&way == &ways[0]) first = h.value();
        CAPTURE(way.name, step, transfers_moment);
        REQUIRE(h.value() == first);
      }
      contacts += ways[0].surface.contact_count();
      for (const FacetContact& c : ways[0].surface.contacts()) shared += c.share_count > 1;
    }
    CAPTURE(contacts, shared);
    CHECK(contacts > 2000);
    CHECK(shared > 20);
  }
}

TEST_CASE("A surface without facets does nothing, and a wrong one is refused") {
  InterfaceFacets none;
  Particles p = spheres_at({Vec3::Zero()});
  CHECK(none.compute(p, material(1), 1e-4).contacts == 0);
  CHECK(none.nodal_force().empty());
  const Vec3s nodes = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  CHECK_THROWS_AS(InterfaceFacets(nodes, {{0, 1, 2, 4}}, 0), InputError);
  CHECK_THROWS_AS(InterfaceFacets(nodes, {{0, 1, 2, -1}}, 0), InputError);
  CHECK_THROWS_AS(InterfaceFacets(nodes, {{0, 1, 0, 1}}, 0), InputError);
}

TEST_CASE("2000 random spheres on a random wavy surface: weights, sums and one contact each where it is smooth") {
  // Slopes below 20 degrees: all normals within merge_angle, so that adjacent contacts of a sphere must have become
  // one.
  Random random(8);
  const int n = 12;
  const double h = 0.06;
  Mesh mesh = sheet(n, h, [&](double, double) { return 0.01 * random.uniform(-1, 1); });
  for (Vec3& node : mesh.nodes) node += 0.006 * Vec3(random.uniform(-1, 1), random.uniform(-1, 1), 0);
  Vec3s centers;
  for (int i = 0; i < 2000; ++i)
    centers.push_back(
        {random.uniform(-0.01, n * h + 0.01), random.uniform(-0.01, n * h + 0.01), random.uniform(-0.02, 0.04)});
  Particles p = spheres_at(centers);
  for (std::size_t b = 0; b < p.body_count(); ++b)
    p.velocity(b) = Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  InterfaceFacets surface = mesh.surface();
  surface.compute(p, material(0.7), 1e-4);
  p.clear_forces();
  const FacetTotals totals = surface.compute(p, material(0.7), 1e-4);

  double worst_sum = 0, worst_weight = 0, size = 0;
  std::size_t with_two = 0, merged = 0;
  const std::vector<FacetContact> contacts = surface.contacts();
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const FacetContact& c = contacts[i];
    double total = 0;
    for (int s = 0; s < c.share_count; ++s) {
      const FacetContact::Share& share = c.shares[static_cast<std::size_t>(s)];
      for (const double w : share.weights) {
        worst_weight = std::min(worst_weight, share.share * w);
        total += share.share * w;
      }
    }
    worst_sum = std::max(worst_sum, std::abs(total - 1));
    merged += c.share_count > 1;
    if (i > 0 && contacts[i - 1].pebble == c.pebble) ++with_two;
    REQUIRE(std::isfinite(c.force.squaredNorm()));
    REQUIRE(std::abs(c.history.normal.norm() - 1) < 1e-12);
    REQUIRE(c.overlap > 0);
    REQUIRE(std::abs(c.history.normal.dot(c.history.spring)) < 1e-9 * (1 + c.history.spring.norm()));
    size += c.force.norm();
  }
  Vec3 balance = sum(forces_on(p)) + sum(surface.nodal_force());
  INFO(totals.contacts << " contacts, " << merged << " on several facets, " << with_two
                       << " second ones; worst |sum N - 1| " << worst_sum << ", smallest weight " << worst_weight
                       << ", |sum F| / sum |F| " << balance.norm() / size << ", tunnelled " << totals.tunnelled);
  CHECK(totals.contacts > 1000);
  CHECK(merged > 10);
  CHECK(with_two == 0);
  CHECK(worst_sum < 1e-14);
  CHECK(worst_weight >= 0);
  CHECK(balance.norm() < 1e-13 * size);
}

TEST_CASE("On a random wavy surface the force follows a small move by a small change") {
  // Wherever feet cross edges, convex ones included, a move of length s may change the force by k_n s; a lost or
  // doubled contact would change it by k_n U, a thousand times more.
  Random random(9);
  const int n = 8;
  const double h = 0.1;
  Mesh mesh = sheet(n, h, [&](double, double) { return 0.006 * random.uniform(-1, 1); });
  InterfaceFacets surface = mesh.surface();
  double worst = 0;
  const double s = 1e-6;
  for (int i = 0; i < 20000; ++i) {
    // Half of the starts lie close to an edge.
    Vec3 x(random.uniform(h, (n - 1) * h), random.uniform(h, (n - 1) * h), R - 0.004);
    if (i % 2) x.x() = h * std::round(x.x() / h) + random.uniform(-2e-3, 2e-3);
    const double angle = random.uniform(0, 2 * pi);
    const Vec3 y = x + s * Vec3(std::cos(angle), std::sin(angle), 0);
    Particles p = spheres_at({x}), q = spheres_at({y});
    surface.clear_history();
    surface.compute(p, material(0), 0);
    surface.clear_history();
    surface.compute(q, material(0), 0);
    worst = std::max(worst, (p.force(0) - q.force(0)).norm() / (k_n * s));
  }
  CAPTURE(worst);
  CHECK(worst < 1.001);
}
