#include "continuum_client/zone_kinematics.hpp"

#include <algorithm>
#include <limits>

namespace lockstep::continuum {

double ZoneGeometry::smallest_volume() const {
  double smallest = std::numeric_limits<double>::infinity();
  for (const auto& overlay : volume)
    for (double v : overlay) smallest = std::min(smallest, v);
  return smallest;
}

double ZoneGeometry::zone_volume() const {
  double sum = 0;
  for (const auto& overlay : volume)
    for (double v : overlay) sum += v;
  return sum / overlay_count;
}

ZoneGeometry zone_geometry(ZoneKind, const ZoneVectors& corners) {
  ZoneGeometry g;
  for (int o = 0; o < overlay_count; ++o)
    for (int t = 0; t < tetrahedra_per_overlay; ++t) {
      const auto& node = zone_tetrahedra[o][t];
      // With edges e1, e2, e3 from the first node and 6 V = e1 x e2 . e3, the linear function that is 1 at the second
      // node and 0 at the others has the gradient e2 x e3 / 6 V, and so on in turn; the four sum to zero.
      const Vec3 e1 = corners[node[1]] - corners[node[0]];
      const Vec3 e2 = corners[node[2]] - corners[node[0]];
      const Vec3 e3 = corners[node[3]] - corners[node[0]];
      const double six_volumes = e1.cross(e2).dot(e3);
      auto& gradient = g.gradient[o][t];
      gradient[1] = e2.cross(e3) / six_volumes;
      gradient[2] = e3.cross(e1) / six_volumes;
      gradient[3] = e1.cross(e2) / six_volumes;
      gradient[0] = -(gradient[1] + gradient[2] + gradient[3]);
      g.volume[o][t] = six_volumes / 6;
    }
  return g;
}

namespace {

// Calls visit(overlay, tetrahedron, stress) for each of the ten.
template <class Visit>
void for_each_stress(const ZoneGeometry& g, const ElasticModuli& moduli, const ZoneVectors& u, const Visit& visit) {
  for (int o = 0; o < overlay_count; ++o) {
    std::array<Mat3, tetrahedra_per_overlay> strain;
    double dilatation = 0, volume = 0;
    for (int t = 0; t < tetrahedra_per_overlay; ++t) {
      const auto& node = zone_tetrahedra[o][t];
      Mat3 grad = Mat3::Zero();
      for (int a = 0; a < 4; ++a) grad += u[node[a]] * g.gradient[o][t][a].transpose();
      strain[t] = 0.5 * (grad + grad.transpose());
      dilatation += g.volume[o][t] * strain[t].trace();
      volume += g.volume[o][t];
    }
    dilatation /= volume;
    for (int t = 0; t < tetrahedra_per_overlay; ++t) visit(o, t, elastic_stress(moduli, strain[t], dilatation));
  }
}

}  // namespace

ZoneVectors zone_force(const ZoneGeometry& g, const ElasticModuli& moduli, const ZoneVectors& displacement) {
  ZoneVectors f;
  f.fill(Vec3::Zero());
  for_each_stress(g, moduli, displacement, [&](int o, int t, const Mat3& stress) {
    const auto& node = zone_tetrahedra[o][t];
    for (int a = 0; a < 4; ++a) f[node[a]] += (g.volume[o][t] / overlay_count) * (stress * g.gradient[o][t][a]);
  });
  return f;
}

Mat3 zone_stress(const ZoneGeometry& g, const ElasticModuli& moduli, const ZoneVectors& displacement) {
  Mat3 sum = Mat3::Zero();
  for_each_stress(g, moduli, displacement,
                  [&](int o, int t, const Mat3& stress) { sum += g.volume[o][t] / overlay_count * stress; });
  return sum / g.zone_volume();
}

ZoneMatrix zone_stiffness(const ZoneGeometry& g, const ElasticModuli& moduli) {
  ZoneMatrix k;
  for (int column = 0; column < 24; ++column) {
    ZoneVectors u;
    u.fill(Vec3::Zero());
    u[column / 3][column % 3] = 1;
    const ZoneVectors f = zone_force(g, moduli, u);
    for (int a = 0; a < 8; ++a) k.block<3, 1>(3 * a, column) = f[a];
  }
  return 0.5 * (k + k.transpose());
}

std::array<double, 8> nodal_volumes(const ZoneGeometry& g) {
  std::array<double, 8> share{};
  for (int o = 0; o < overlay_count; ++o)
    for (int t = 0; t < tetrahedra_per_overlay; ++t)
      for (int a : zone_tetrahedra[o][t]) share[a] += g.volume[o][t] / 4 / overlay_count;
  return share;
}

}  // namespace lockstep::continuum
