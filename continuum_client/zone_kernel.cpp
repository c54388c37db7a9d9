#include "continuum_client/zone_kernel.hpp"

#include "common/lanes.hpp"
#include "continuum_client/constants.hpp"
#include "continuum_client/zone_topology.hpp"

namespace lockstep::continuum {
namespace {

static_assert(block == nodes_at_once);
constexpr int parts = block / width;

// What r_i x r_j adds to dV/dr of nodes, times 12 (one_point_zone()): node 0 is the origin, so its products are zero.
struct EdgeProduct {
  int i, j, plus[2], minus[2];
};
constexpr EdgeProduct edge_products[9] = {{1, 2, {5, 6}, {0, 3}}, {2, 3, {6, 7}, {0, 1}}, {4, 5, {6, 7}, {0, 1}},
                                          {5, 6, {4, 7}, {1, 2}}, {6, 7, {4, 5}, {2, 3}}, {4, 7, {0, 3}, {5, 6}},
                                          {1, 5, {0, 4}, {2, 6}}, {2, 6, {1, 5}, {3, 7}}, {3, 7, {2, 6}, {0, 4}}};
struct DiagonalProduct {
  int i, j, plus, minus;
};
constexpr DiagonalProduct diagonal_products[9] = {{1, 3, 2, 0}, {4, 6, 7, 5}, {5, 7, 4, 6}, {1, 4, 0, 5}, {1, 6, 5, 2},
                                                  {2, 5, 1, 6}, {2, 7, 6, 3}, {3, 6, 2, 7}, {3, 4, 7, 0}};

// One point. V of a hexahedron is the mean over both ways to cut each face into triangles, V = sum of r_i . (r_j x r_k)
// over the four triangles of each face / 12, and the integral of a shape function's gradient is b_a = dV/dr_a: of a face
// p0 p1 p2 p3 an edge's product p0 x p1 goes to p2 and p3, a diagonal's p0 x p2 to p3 and its opposite to p1. With
// g_a = b_a / V, the displacement's gradient H = sum u_a (x) g_a, h_alpha the patterns, hx = sum h_a r_a and
// hu = sum h_a u_a:  q = sum gamma_a u_a = (hu - H hx) / 8, and of the resistance F = C q
//   f_a = F gamma_a = h_a F / 8 - (F (x) hx / 8 V) b_a,
// which joins the stress.
LOCKSTEP_INLINE void one_point_zone(const Lanes3 (&x)[8], const Lanes3 (&u)[8], Lanes shear, Lanes bulk,
                                    Lanes3 (&f)[8]) {
  Lanes3 r[8], d[8], b[8] = {};
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) r[a] = x[a] - x[0], d[a] = u[a] - u[0];
#pragma GCC unroll 9
  for (int e = 0; e < 9; ++e) {
    const EdgeProduct& n = edge_products[e];
    const Lanes3 m = cross(r[n.i], r[n.j]);
    b[n.plus[0]] = b[n.plus[0]] + m, b[n.plus[1]] = b[n.plus[1]] + m;
    b[n.minus[0]] = b[n.minus[0]] - m, b[n.minus[1]] = b[n.minus[1]] - m;
  }
#pragma GCC unroll 9
  for (int e = 0; e < 9; ++e) {
    const DiagonalProduct& n = diagonal_products[e];
    const Lanes3 m = cross(r[n.i], r[n.j]);
    b[n.plus] = b[n.plus] + m, b[n.minus] = b[n.minus] - m;
  }
  Lanes volume = {}, square = {};
  Lanes3 hx = {}, hy = {}, hz = {};  // rows of V H
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) {
    b[a] = lanes(1.0 / 12) * b[a];
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

struct CornerValues {
  alignas(64) double value[8][3][block];
};

void gather(const std::int32_t* table, const Components& from, CornerValues& to) {
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a)
    for (int l = 0; l < block; ++l) {
      const std::int32_t i = table[block * a + l];
      to.value[a][0][l] = from.x[i], to.value[a][1][l] = from.y[i], to.value[a][2][l] = from.z[i];
    }
}

LOCKSTEP_INLINE void add(double* to, Lanes value) { store_loose(to, loose(to) + value); }

// Lanes one further, the first from the end of `before`.
LOCKSTEP_INLINE Lanes moved_on(Lanes before, Lanes value) {
#if defined(__AVX512F__)
  return __builtin_shufflevector(before, value, 7, 8, 9, 10, 11, 12, 13, 14);
#elif defined(__AVX2__)
  return __builtin_shufflevector(before, value, 3, 4, 5, 6);
#else
  return __builtin_shufflevector(before, value, 1, 2);
#endif
}

// Eight zones on each other: a node gets a lower corner's force of one zone and the upper corner's of the zone below it.
// Both are added first, in lanes, so that no load follows a store that it overlaps.
struct Stack {
  Lanes3 below[4] = {};  // upper corners of the zones before

  LOCKSTEP_INLINE void add_part(const Lanes3 (&force)[8], const ZoneBlock& b, int l, const Components& f,
                                std::int32_t f_begin) {
#pragma GCC unroll 4
    for (int a = 0; a < 4; ++a) {
      const std::int32_t at = b.node[a] - f_begin + l;
      const Lanes3 &low = force[a], &high = force[a + 4];
      add(f.x + at, low.x + moved_on(below[a].x, high.x));
      add(f.y + at, low.y + moved_on(below[a].y, high.y));
      add(f.z + at, low.z + moved_on(below[a].z, high.z));
      below[a] = high;
    }
  }
  // The upper corners of the highest zone.
  LOCKSTEP_INLINE void add_top(const ZoneBlock& b, const Components& f, std::int32_t f_begin) const {
    for (int a = 0; a < 4; ++a) {
      const std::int32_t at = b.node[a] - f_begin + block;
      f.x[at] += below[a].x[width - 1], f.y[at] += below[a].y[width - 1], f.z[at] += below[a].z[width - 1];
    }
  }
};

// Corner by corner for all zones, since a node gets forces from several of them and the order of its sum must not depend
// on the width.
void scatter(const ZoneBlock& b, const std::int32_t* tables, const CornerValues& force, const Components& f,
             std::int32_t f_begin) {
  for (int a = 0; a < 8; ++a)
    for (std::int32_t l = 0; l < b.zones; ++l) {
      const std::int32_t at = (b.table < 0 ? b.node[a] + l : tables[b.table + block * a + l]) - f_begin;
      f.x[at] += force.value[a][0][l], f.y[at] += force.value[a][1][l], f.z[at] += force.value[a][2][l];
    }
}

void forces(const ZoneBlock* blocks, std::int32_t count, const std::int32_t* tables, const double* moduli,
            const Components& x, const Components& u, const Components& f, std::int32_t f_begin) {
  CornerValues places{}, displacements{}, force;
  for (std::int32_t k = 0; k < count; ++k, moduli += 2 * block) {
    const ZoneBlock& b = blocks[k];
    const bool is_whole_stack = b.table < 0 && b.zones == block;
    Stack stack;
    if (b.table >= 0) gather(tables + b.table, x, places), gather(tables + b.table, u, displacements);
    for (int p = 0; p < parts; ++p) {
      const int l = p * width;
      Lanes3 at[8], moved[8], result[8];
#pragma GCC unroll 8
      for (int a = 0; a < 8; ++a) {
        if (b.table < 0) {
          const std::int64_t i = b.node[a] + l;
          at[a] = {loose(x.x + i), loose(x.y + i), loose(x.z + i)};
          moved[a] = {loose(u.x + i), loose(u.y + i), loose(u.z + i)};
        } else {
          const auto &from = places.value[a], &by = displacements.value[a];
          at[a] = {load(from[0] + l), load(from[1] + l), load(from[2] + l)};
          moved[a] = {load(by[0] + l), load(by[1] + l), load(by[2] + l)};
        }
      }
      one_point_zone(at, moved, loose(moduli + l), loose(moduli + block + l), result);
      if (is_whole_stack) {
        stack.add_part(result, b, l, f, f_begin);
        continue;
      }
#pragma GCC unroll 8
      for (int a = 0; a < 8; ++a) {
        auto& to = force.value[a];
        store(to[0] + l, result[a].x), store(to[1] + l, result[a].y), store(to[2] + l, result[a].z);
      }
    }
    if (is_whole_stack)
      stack.add_top(b, f, f_begin);
    else
      scatter(b, tables, force, f, f_begin);
  }
}

}  // namespace

ZoneKernel LOCKSTEP_ZONE_KERNEL() { return forces; }

}  // namespace lockstep::continuum
