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

struct Sums {
  Sum8 energy, dissipated;
  std::int64_t yielding = 0;
};

// The stress of elastic law and plastic stress goes back to the yield surface where it lies beyond, and the plastic stress
// takes the difference. A zone is surely within if sin phi p + sqrt(J2) sqrt(1 + sin^2 phi / 3) <= c cos phi, p the mean
// stress: the left side is the largest F / 2 of all angles of Lode. The others ask the law.
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
  const Lanes square = lanes(0.5) * product(deviator, deviator) * (lanes(1) + third * sine * sine);
  const Mask may_yield = holds & (sine * mean + square_root(square) > load(z.strength + l));
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
