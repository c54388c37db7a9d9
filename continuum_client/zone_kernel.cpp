#include "continuum_client/zone_kernel.hpp"

#include "continuum_client/constants.hpp"
#include "continuum_client/zone_lanes.hpp"

namespace lockstep::continuum {
namespace {

// One point. With g_a = b_a / V, the displacement's gradient H = sum u_a (x) g_a, h_alpha the patterns, hx = sum h_a r_a and
// hu = sum h_a u_a:  q = sum gamma_a u_a = (hu - H hx) / 8, and of the resistance F = C q
//   f_a = F gamma_a = h_a F / 8 - (F (x) hx / 8 V) b_a,
// which joins the stress.
LOCKSTEP_INLINE void one_point_zone(const Lanes3 (&x)[8], const Lanes3 (&u)[8], Lanes shear, Lanes bulk,
                                    Lanes3 (&f)[8]) {
  Lanes3 r[8], d[8], b[8];
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) r[a] = x[a] - x[0], d[a] = u[a] - u[0];
  gradient_integrals(r, b);
  Lanes volume = {}, square = {};
  Lanes3 hx = {}, hy = {}, hz = {};  // rows of V H
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) {
    volume += dot(r[a], b[a]), square += dot(b[a], b[a]);
    hx = hx + d[a].x * b[a], hy = hy + d[a].y * b[a], hz = hz + d[a].z * b[a];
  }
  const Lanes inverse = lanes(3) / volume;  // volume is three times V so far
  hx = inverse * hx, hy = inverse * hy, hz = inverse * hz;
  const Lanes trace = hx.x + hy.y + hz.z, mean = bulk * trace - (2.0 / 3) * shear * trace, g2 = shear + shear;
  Lanes3 sx = {g2 * hx.x + mean, shear * (hx.y + hy.x), shear * (hx.z + hz.x)};
  Lanes3 sy = {sx.y, g2 * hy.y + mean, shear * (hy.z + hz.y)};
  Lanes3 sz = {sx.z, sy.z, g2 * hz.z + mean};
  const Lanes eighth = lanes(0.125), stiffness = hourglass_share * shear * square * inverse;
  Lanes3 resistance[4];
#pragma GCC unroll 4
  for (int alpha = 0; alpha < 4; ++alpha) {
    Lanes3 along = {}, displaced = {};
#pragma GCC unroll 8
    for (int a = 0; a < 8; ++a) {
      if (hourglass_pattern(alpha, a) > 0)
        along = along + r[a], displaced = displaced + d[a];
      else
        along = along - r[a], displaced = displaced - d[a];
    }
    const Lanes3 linear = {dot(hx, along), dot(hy, along), dot(hz, along)};
    // F / 8, with q = (...) / 8.
    const Lanes3 force = (eighth * eighth * stiffness) * (displaced - linear);
    const Lanes3 back = inverse * force;
    sx = sx - back.x * along, sy = sy - back.y * along, sz = sz - back.z * along;
    resistance[alpha] = force;
  }
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) {
    f[a] = {dot(sx, b[a]), dot(sy, b[a]), dot(sz, b[a])};
#pragma GCC unroll 4
    for (int alpha = 0; alpha < 4; ++alpha)
      f[a] = hourglass_pattern(alpha, a) > 0 ? f[a] + resistance[alpha] : f[a] - resistance[alpha];
  }
}

void forces(const ZoneBlock* blocks, std::int32_t count, const std::int32_t* tables, const double* moduli,
            const Components& x, const Components& u, const Components& f, std::int32_t f_begin) {
  for (std::int32_t k = 0; k < count; ++k, moduli += 2 * block) {
    const Corners places(blocks[k], tables, x), displacements(blocks[k], tables, u);
    add_forces(blocks[k], tables, f, f_begin, [&](int l, Lanes3(&result)[8]) {
      Lanes3 at[8], moved[8];
      places.get(l, at), displacements.get(l, moved);
      one_point_zone(at, moved, loose(moduli + l), loose(moduli + block + l), result);
    });
  }
}

}  // namespace

ZoneKernel LOCKSTEP_ZONE_KERNEL() { return forces; }

}  // namespace lockstep::continuum
