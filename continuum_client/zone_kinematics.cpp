#include "continuum_client/zone_kinematics.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "continuum_client/constants.hpp"

namespace lockstep::continuum {
namespace {

constexpr int overlays = 2, tetrahedra = 5;
// Node numbers of each tetrahedron, positive volume in a positive zone.
constexpr int tetrahedron_nodes[overlays][tetrahedra][4] = {
    {{0, 2, 7, 5}, {1, 2, 0, 5}, {3, 0, 2, 7}, {4, 7, 5, 0}, {6, 5, 7, 2}},
    {{1, 3, 4, 6}, {0, 1, 3, 4}, {2, 3, 1, 6}, {5, 4, 6, 1}, {7, 6, 4, 3}},
};

ZoneGeometry mixed_discretization(const ZoneVectors& corners) {
  ZoneGeometry g;
  g.point_count = overlays * tetrahedra, g.group_count = overlays;
  g.smallest_volume = std::numeric_limits<double>::infinity();
  for (int o = 0; o < overlays; ++o)
    for (int t = 0; t < tetrahedra; ++t) {
      const auto& node = tetrahedron_nodes[o][t];
      StrainPoint& p = g.point[o * tetrahedra + t];
      // With edges e1, e2, e3 from the first node and 6 V = e1 x e2 . e3, the linear function that is 1 at the second
      // node and 0 at the others has the gradient e2 x e3 / 6 V, and so on in turn; the four sum to zero.
      const Vec3 e1 = corners[node[1]] - corners[node[0]];
      const Vec3 e2 = corners[node[2]] - corners[node[0]];
      const Vec3 e3 = corners[node[3]] - corners[node[0]];
      const double six_volumes = e1.cross(e2).dot(e3);
      p.gradient.fill(Vec3::Zero());
      p.gradient[node[1]] = e2.cross(e3) / six_volumes;
      p.gradient[node[2]] = e3.cross(e1) / six_volumes;
      p.gradient[node[3]] = e1.cross(e2) / six_volumes;
      p.gradient[node[0]] = -(p.gradient[node[1]] + p.gradient[node[2]] + p.gradient[node[3]]);
      p.volume = six_volumes / 6 / overlays;
      p.group = o;
      g.group_volume[o] += p.volume;
      g.smallest_volume = std::min(g.smallest_volume, six_volumes / 6);
      for (const int a : node) g.nodal_volume[a] += p.volume / 4;
    }
  return g;
}

Vec3 cube_corner(int a) { return {node_at[a][0] * 1.0, node_at[a][1] * 1.0, node_at[a][2] * 1.0}; }

// Eight Gauss points, which integrate det J, N det J and dN/dx det J of trilinear zones exactly or, the second, as well
// as lumping needs.
ZoneGeometry b_bar(const ZoneVectors& corners) {
  ZoneGeometry g;
  g.point_count = 8, g.group_count = 1;
  g.smallest_volume = std::numeric_limits<double>::infinity();
  const double at = 1 / std::sqrt(3.0);
  for (int k = 0; k < 8; ++k) {
    const ShapeFunctions n = trilinear(at * cube_corner(k));
    const Mat3 j = jacobian(n, corners);
    StrainPoint& p = g.point[k];
    p.volume = j.determinant();
    const Mat3 turned = j.inverse().transpose();
    for (int a = 0; a < 8; ++a) {
      p.gradient[a] = turned * n.gradient[a];
      g.nodal_volume[a] += n.value[a] * p.volume;
    }
    g.group_volume[0] += p.volume;
    const Mat3 corner = jacobian(trilinear(cube_corner(k)), corners);
    g.smallest_volume = std::min({g.smallest_volume, 8 * p.volume, 8 * corner.determinant()});
  }
  return g;
}

ZoneGeometry one_point(const ZoneVectors& corners) {
  const ZoneGeometry full = b_bar(corners);
  ZoneGeometry g;
  g.point_count = g.group_count = 1;
  g.nodal_volume = full.nodal_volume, g.smallest_volume = full.smallest_volume;
  StrainPoint& p = g.point[0];
  p.volume = g.group_volume[0] = full.group_volume[0];
  double square = 0;
  for (int a = 0; a < 8; ++a) {
    p.gradient[a].setZero();
    for (int k = 0; k < full.point_count; ++k)
      p.gradient[a] += full.point[k].volume / p.volume * full.point[k].gradient[a];
    square += p.gradient[a].squaredNorm();
  }
  for (int alpha = 0; alpha < ZoneGeometry::patterns; ++alpha) {
    Vec3 along = Vec3::Zero();
    for (int a = 0; a < 8; ++a) along += hourglass_pattern(alpha, a) * corners[a];
    for (int a = 0; a < 8; ++a) g.hourglass[alpha][a] = (hourglass_pattern(alpha, a) - along.dot(p.gradient[a])) / 8;
  }
  g.hourglass_stiffness = hourglass_share * p.volume * square;
  return g;
}

Mat3 strain_at(const StrainPoint& p, const ZoneVectors& u) {
  Mat3 grad = Mat3::Zero();
  for (int a = 0; a < 8; ++a) grad += u[a] * p.gradient[a].transpose();
  return 0.5 * (grad + grad.transpose());
}

// Calls visit(point, stress) for each point.
template <class Visit>
void for_each_stress(const ZoneGeometry& g, const ElasticModuli& moduli, const ZoneVectors& u, const Visit& visit) {
  std::array<Mat3, ZoneGeometry::most_points> strain;
  std::array<double, ZoneGeometry::most_groups> dilatation{};
  for (int k = 0; k < g.point_count; ++k) {
    strain[k] = strain_at(g.point[k], u);
    dilatation[g.point[k].group] += g.point[k].volume / g.group_volume[g.point[k].group] * strain[k].trace();
  }
  for (int k = 0; k < g.point_count; ++k)
    visit(g.point[k], elastic_stress(moduli, strain[k], dilatation[g.point[k].group]));
}

}  // namespace

ShapeFunctions trilinear(const Vec3& xi) {
  ShapeFunctions n;
  for (int a = 0; a < 8; ++a) {
    const double x = 1 + xi.x() * node_at[a][0], y = 1 + xi.y() * node_at[a][1], z = 1 + xi.z() * node_at[a][2];
    n.value[a] = x * y * z / 8;
    n.gradient[a] = Vec3(node_at[a][0] * y * z, x * node_at[a][1] * z, x * y * node_at[a][2]) / 8;
  }
  return n;
}

Mat3 jacobian(const ShapeFunctions& n, const ZoneVectors& corners) {
  Mat3 j = Mat3::Zero();
  for (int a = 0; a < 8; ++a) j += corners[a] * n.gradient[a].transpose();
  return j;
}

double ZoneGeometry::zone_volume() const {
  double sum = 0;
  for (int k = 0; k < group_count; ++k) sum += group_volume[k];
  return sum;
}

ZoneGeometry zone_geometry(ZoneKind kind, const ZoneVectors& corners) {
  switch (kind) {
    case ZoneKind::BBar:
      return b_bar(corners);
    case ZoneKind::OnePoint:
      return one_point(corners);
    case ZoneKind::MixedDiscretization:
      break;
  }
  return mixed_discretization(corners);
}

ZoneVectors zone_force(const ZoneGeometry& g, const ElasticModuli& moduli, const ZoneVectors& displacement) {
  ZoneVectors f;
  f.fill(Vec3::Zero());
  for_each_stress(g, moduli, displacement, [&](const StrainPoint& p, const Mat3& stress) {
    for (int a = 0; a < 8; ++a) f[a] += p.volume * (stress * p.gradient[a]);
  });
  if (g.hourglass_stiffness == 0) return f;
  for (const auto& gamma : g.hourglass) {
    Vec3 q = Vec3::Zero();
    for (int a = 0; a < 8; ++a) q += gamma[a] * displacement[a];
    for (int a = 0; a < 8; ++a) f[a] += g.hourglass_stiffness * moduli.shear * gamma[a] * q;
  }
  return f;
}

ZoneVectors zone_force_of_stress(const ZoneGeometry& g, const Mat3& stress) {
  ZoneVectors f;
  f.fill(Vec3::Zero());
  for (int k = 0; k < g.point_count; ++k)
    for (int a = 0; a < 8; ++a) f[a] += g.point[k].volume * (stress * g.point[k].gradient[a]);
  return f;
}

Mat3 zone_stress(const ZoneGeometry& g, const ElasticModuli& moduli, const ZoneVectors& displacement) {
  Mat3 sum = Mat3::Zero();
  for_each_stress(g, moduli, displacement, [&](const StrainPoint& p, const Mat3& stress) { sum += p.volume * stress; });
  return sum / g.zone_volume();
}

Mat3 zone_strain(const ZoneGeometry& g, const ZoneVectors& displacement) {
  Mat3 sum = Mat3::Zero();
  for (int k = 0; k < g.point_count; ++k) sum += g.point[k].volume * strain_at(g.point[k], displacement);
  return sum / g.zone_volume();
}

// The block of nodes a and b is
//   sum_points V (G (g_a . g_b I + g_b (x) g_a) - 2/3 G g_a (x) g_b)
//   + K sum_groups (sum V g_a) (x) (sum V g_b) / V_group + C sum_patterns gamma_a gamma_b I.
ZoneMatrix zone_stiffness(const ZoneGeometry& g, const ElasticModuli& moduli) {
  ZoneMatrix k = ZoneMatrix::Zero();
  std::array<std::array<Vec3, 8>, ZoneGeometry::most_groups> mean;
  for (auto& group : mean) group.fill(Vec3::Zero());
  for (int n = 0; n < g.point_count; ++n)
    for (int a = 0; a < 8; ++a) mean[g.point[n].group][a] += g.point[n].volume * g.point[n].gradient[a];
  for (int a = 0; a < 8; ++a)
    for (int b = a; b < 8; ++b) {
      Mat3 block = Mat3::Zero();
      for (int n = 0; n < g.point_count; ++n) {
        const Vec3 &at_a = g.point[n].gradient[a], &at_b = g.point[n].gradient[b];
        block += g.point[n].volume * moduli.shear *
                 (at_a.dot(at_b) * Mat3::Identity() + at_b * at_a.transpose() - 2.0 / 3 * at_a * at_b.transpose());
      }
      for (int o = 0; o < g.group_count; ++o)
        block += moduli.bulk / g.group_volume[o] * mean[o][a] * mean[o][b].transpose();
      double patterns = 0;
      for (const auto& gamma : g.hourglass) patterns += gamma[a] * gamma[b];
      block += g.hourglass_stiffness * moduli.shear * patterns * Mat3::Identity();
      if (a == b) block = 0.5 * (block + block.transpose()).eval();
      k.block<3, 3>(3 * a, 3 * b) = block;
      k.block<3, 3>(3 * b, 3 * a) = block.transpose();
    }
  return k;
}

}  // namespace lockstep::continuum
