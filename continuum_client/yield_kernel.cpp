#include "continuum_client/yield_kernel.hpp"

#include "continuum_client/zone_lanes.hpp"

namespace lockstep::continuum {
namespace {

// xx yy zz xy yz zx
struct Tensor {
  Lanes v[6];
};
LOCKSTEP_INLINE Tensor load_tensor(const double (*from)[8], int l) {
  Tensor t;
#pragma GCC unroll 6
  for (int c = 0; c < 6; ++c) t.v[c] = load(from[c] + l);
  return t;
}
LOCKSTEP_INLINE void store_tensor(double (*to)[8], int l, const Tensor& t) {
#pragma GCC unroll 6
  for (int c = 0; c < 6; ++c) store(to[c] + l, t.v[c]);
}
LOCKSTEP_INLINE Lanes trace(const Tensor& t) { return t.v[0] + t.v[1] + t.v[2]; }
LOCKSTEP_INLINE Lanes product(const Tensor& a, const Tensor& b) {
  const Lanes shear = a.v[3] * b.v[3] + a.v[4] * b.v[4] + a.v[5] * b.v[5];
  return a.v[0] * b.v[0] + a.v[1] * b.v[1] + a.v[2] * b.v[2] + (shear + shear);
}
LOCKSTEP_INLINE Lanes3 times(const Tensor& t, const Lanes3& b) {
  return {t.v[0] * b.x + t.v[3] * b.y + t.v[5] * b.z, t.v[3] * b.x + t.v[1] * b.y + t.v[4] * b.z,
          t.v[5] * b.x + t.v[4] * b.y + t.v[2] * b.z};
}

// Shape and strain of the zones of a part.
struct PartStrain {
  Lanes3 gradient[8];  // integrals over the zone [m2]
  Lanes volume;        // [m3]
  Tensor strain;       // mean of the zone [-]
};

LOCKSTEP_INLINE void strain_of(const Lanes3 (&x)[8], const Lanes3 (&u)[8], PartStrain& s) {
  Lanes3 r[8];
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) r[a] = x[a] - x[0];
  gradient_integrals(r, s.gradient);
  Lanes thrice = {};
  Lanes3 hx = {}, hy = {}, hz = {};
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) {
    const Lanes3 d = u[a] - u[0];
    thrice += dot(r[a], s.gradient[a]);
    hx = hx + d.x * s.gradient[a], hy = hy + d.y * s.gradient[a], hz = hz + d.z * s.gradient[a];
  }
  const Lanes inverse = lanes(3) / thrice, half = lanes(0.5) * inverse;
  s.volume = lanes(1.0 / 3) * thrice;
  s.strain = {{inverse * hx.x, inverse * hy.y, inverse * hz.z, half * (hx.y + hy.x), half * (hy.z + hz.y),
               half * (hz.x + hx.z)}};
}

LOCKSTEP_INLINE Mask holds_zone(int l, std::int32_t zones) {
  Mask m;
  for (int i = 0; i < width; ++i) m[i] = l + i < zones ? -1 : 0;
  return m;
}

// a : D^-1 b = a : b / 2G - (1 / 6G - 1 / 9K) tr a tr b
LOCKSTEP_INLINE Lanes compliance(const YieldBlock& z, int l, const Tensor& a, const Tensor& b) {
  const Lanes half = lanes(0.5) / load(z.shear + l),
              isotropic = lanes(1.0 / 3) * half - lanes(1.0 / 9) / load(z.bulk + l);
  return half * product(a, b) - isotropic * (trace(a) * trace(b));
}

LOCKSTEP_INLINE Lanes determinant(const Tensor& t) {
  return t.v[0] * (t.v[1] * t.v[2] - t.v[4] * t.v[4]) - t.v[3] * (t.v[3] * t.v[2] - t.v[4] * t.v[5]) +
         t.v[5] * (t.v[3] * t.v[4] - t.v[1] * t.v[5]);
}

// A bound of F / 2 + c cos phi without principal axes, at most 3.5 % of sqrt(J2) above it (1.7 % at phi = 35 degrees). With
// Lode's angle t, cos 3t = (3 sqrt(3) / 2) J3 / J2^(3/2),
//   F / 2 + c cos phi = sin phi p + sqrt(J2) K,  K = sin(t + 60) + a cos(t + 60),  a = sin phi / sqrt(3),
// where p is the mean stress. As a function of cos 3t, K is concave for any phi, so that each tangent lies above it: here
// those at five angles t. A share of 1e-6 is added, since the law's principal stresses may err by 1e-8.
LOCKSTEP_INLINE Lanes largest_shear(Lanes sine, Lanes mean, const Tensor& deviator) {
  struct Tangent {
    double at, slope;  // of c + d x, x = cos 3t: c + c_a a and d + d_a a
    double at_a, slope_a;
  };
  // t = 58, 52, 40, 25, 8 degrees.
  constexpr Tangent tangents[] = {
      {2.3718554426050642, 1.4971091704268529, 2.3307568346935721, 2.8156528383344765},
      {1.2076439160864954, 0.30700175801151003, 0.31955641775984267, 0.75985601522997948},
      {1.0182263603856381, 0.066837214746860024, 0.015878162766946119, 0.37905268086775257},
      {1.0039791350534022, -0.030076754817533181, -0.0018207788716247258, 0.34377888066173268},
      {1.2076439160864951, -0.30700175801150997, -0.319556417759842, 0.75985601522997892}};
  constexpr double least = 1e-300;  // [Pa2]: keeps 0/0 out
  const Lanes square = larger(lanes(0.5) * product(deviator, deviator), lanes(least)), root = square_root(square);
  const Lanes a = lanes(0.57735026918962576) * sine;
  const Lanes cubic = lanes(2.5980762113533160) * determinant(deviator) / square;  // sqrt(J2) cos 3t
  Lanes bound = root * square_root(lanes(1) + a * a);
  for (const Tangent& t : tangents)
    bound = smaller(bound, (t.at + t.at_a * a) * root + (t.slope + t.slope_a * a) * cubic);
  const Lanes pressing = sine * mean, size = larger(pressing, -pressing) + root;
  return pressing + bound + lanes(1e-6) * size;
}

struct Sums {
  Sum8 energy, dissipated;
  std::int64_t yielding = 0;
};

// The stress of elastic law and plastic stress goes back to the yield surface where it lies beyond, and the plastic stress
// takes the difference. Zones that are not surely within ask the law.
LOCKSTEP_INLINE void yield_part(const PartStrain& s, YieldBlock& z, int l, Mask holds,
                                const YieldingMaterial* materials, Sums& sums) {
  const Lanes shear = load(z.shear + l), bulk = load(z.bulk + l), sine = load(z.friction + l), third = lanes(1.0 / 3);
  const Tensor initial = load_tensor(z.initial, l), plastic = load_tensor(z.plastic, l),
               last = load_tensor(z.stress, l);
  const Lanes dilation = trace(s.strain), isotropic = bulk * dilation - (2.0 / 3) * shear * dilation;
  Tensor stress;
#pragma GCC unroll 6
  for (int c = 0; c < 6; ++c) {
    const Lanes elastic = (shear + shear) * s.strain.v[c];
    stress.v[c] = (initial.v[c] + plastic.v[c]) + (c < 3 ? elastic + isotropic : elastic);
  }
  store_tensor(z.stress, l, stress);
  const Lanes mean = third * trace(stress);
  Tensor deviator = stress;
#pragma GCC unroll 3
  for (int c = 0; c < 3; ++c) deviator.v[c] -= mean;
  const Mask may_yield = holds & (largest_shear(sine, mean, deviator) > load(z.strength + l));
  if (!any(may_yield)) return;
  int yielding = 0;
  for (unsigned left = bits(may_yield); left != 0; left &= left - 1) {
    const int i = l + __builtin_ctz(left);
    double now[6];
    for (int c = 0; c < 6; ++c) now[c] = z.stress[c][i];
    if (!yield_zone(materials, z.material[i], now)) continue;
    ++yielding;
    for (int c = 0; c < 6; ++c) z.plastic[c][i] += now[c] - z.stress[c][i], z.stress[c][i] = now[c];
  }
  if (yielding == 0) return;
  z.has_yielded = true;
  sums.yielding += yielding;
  // V de_p : (sigma(n-1) + sigma(n)) / 2, de_p = -D^-1 dp.
  Tensor change = load_tensor(z.plastic, l), both = load_tensor(z.stress, l);
#pragma GCC unroll 6
  for (int c = 0; c < 6; ++c) change.v[c] = plastic.v[c] - change.v[c], both.v[c] += last.v[c];
  sums.dissipated.add(l, select(holds, lanes(0.5) * s.volume * compliance(z, l, change, both), Lanes{}));
}

// V (p : e / 2 + p : D^-1 p / 2 + s0 : D^-1 p), for yielding_zones.hpp.
LOCKSTEP_INLINE Lanes energy_of(const PartStrain& s, const YieldBlock& z, int l) {
  const Tensor p = load_tensor(z.plastic, l);
  Tensor half = load_tensor(z.initial, l);  // p / 2 + s0
#pragma GCC unroll 6
  for (int c = 0; c < 6; ++c) half.v[c] += lanes(0.5) * p.v[c];
  return s.volume * (lanes(0.5) * product(p, s.strain) + compliance(z, l, half, p));
}

YieldSums run(const ZoneBlock* blocks, YieldBlock* states, std::int32_t count, const std::int32_t* tables,
              const YieldingMaterial* materials, const Components& x, const Components& u, const Components& f,
              std::int32_t f_begin) {
  Sums sums;
  PartStrain part[parts];
  for (std::int32_t k = 0; k < count; ++k) {
    const ZoneBlock& zones = blocks[k];
    YieldBlock& state = states[k];
    const Corners places(zones, tables, x), displacements(zones, tables, u);
    for (int p = 0; p < parts; ++p) {
      Lanes3 at[8], moved[8];
      places.get(p * width, at), displacements.get(p * width, moved);
      strain_of(at, moved, part[p]);
      yield_part(part[p], state, p * width, holds_zone(p * width, zones.zones), materials, sums);
    }
    if (!state.has_yielded) continue;
    add_forces(zones, tables, f, f_begin, [&](int l, Lanes3(&result)[8]) {
      const PartStrain& s = part[l / width];
      const Tensor plastic = load_tensor(state.plastic, l);
#pragma GCC unroll 8
      for (int a = 0; a < 8; ++a) result[a] = times(plastic, s.gradient[a]);
      sums.energy.add(l, select(holds_zone(l, zones.zones), energy_of(s, state, l), Lanes{}));
    });
  }
  return {sums.energy.total(), sums.dissipated.total(), sums.yielding};
}

}  // namespace

YieldKernel LOCKSTEP_YIELD_KERNEL() { return run; }

}  // namespace lockstep::continuum
