// Zones in lanes: eight of them with their corners, the integrals of their shape functions' gradients, and how their corners'
// forces are added to nodes. Included only by kernels that are compiled once for each instruction set.
#pragma once
#include <cstdint>

#include "common/lanes.hpp"
#include "continuum_client/zone_blocks.hpp"
#include "continuum_client/zone_topology.hpp"

namespace lockstep::continuum {
namespace {

static_assert(block == nodes_at_once);
constexpr int parts = block / width;

// What r_i x r_j adds to dV/dr of nodes, times 12: node 0 is the origin, so its products are zero.
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

// b_a = dV/dr_a, the integral of a shape function's gradient, with r from node 0. V of a hexahedron is the mean over both ways
// to cut each face into triangles, V = sum of r_i . (r_j x r_k) over the four triangles of each face / 12: of a face
// p0 p1 p2 p3 an edge's product p0 x p1 goes to p2 and p3, a diagonal's p0 x p2 to p3 and its opposite to p1.
LOCKSTEP_INLINE void gradient_integrals(const Lanes3 (&r)[8], Lanes3 (&b)[8]) {
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) b[a] = Lanes3{};
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
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a) b[a] = lanes(1.0 / 12) * b[a];
}

struct CornerValues {
  alignas(64) double value[8][3][block];
};

inline void gather(const std::int32_t* table, const Components& from, CornerValues& to) {
#pragma GCC unroll 8
  for (int a = 0; a < 8; ++a)
    for (int l = 0; l < block; ++l) {
      const std::int32_t i = table[block * a + l];
      to.value[a][0][l] = from.x[i], to.value[a][1][l] = from.y[i], to.value[a][2][l] = from.z[i];
    }
}

// Values at the corners of the zones of a block: in a column where they stand, else gathered.
class Corners {
 public:
  LOCKSTEP_INLINE Corners(const ZoneBlock& b, const std::int32_t* tables, const Components& from)
      : block_(b), from_(from) {
    if (b.table >= 0) gather(tables + b.table, from, values_);
  }
  LOCKSTEP_INLINE void get(int l, Lanes3 (&to)[8]) const {
#pragma GCC unroll 8
    for (int a = 0; a < 8; ++a) {
      if (block_.table < 0) {
        const std::int64_t i = block_.node[a] + l;
        to[a] = {loose(from_.x + i), loose(from_.y + i), loose(from_.z + i)};
      } else {
        const auto& v = values_.value[a];
        to[a] = {load(v[0] + l), load(v[1] + l), load(v[2] + l)};
      }
    }
  }

 private:
  const ZoneBlock& block_;
  const Components& from_;
  CornerValues values_;
};

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
inline void scatter(const ZoneBlock& b, const std::int32_t* tables, const CornerValues& force, const Components& f,
                    std::int32_t f_begin) {
  for (int a = 0; a < 8; ++a)
    for (std::int32_t l = 0; l < b.zones; ++l) {
      const std::int32_t at = (b.table < 0 ? b.node[a] + l : tables[b.table + block * a + l]) - f_begin;
      f.x[at] += force.value[a][0][l], f.y[at] += force.value[a][1][l], f.z[at] += force.value[a][2][l];
    }
}

// f += the forces of a block's zones; force_of(l, result) gives those of the zones from lane l on, l rising.
template <class ForceOf>
LOCKSTEP_INLINE void add_forces(const ZoneBlock& b, const std::int32_t* tables, const Components& f,
                                std::int32_t f_begin, ForceOf&& force_of) {
  const bool is_whole_stack = b.table < 0 && b.zones == block;
  Stack stack;
  CornerValues force;
  for (int p = 0; p < parts; ++p) {
    const int l = p * width;
    Lanes3 result[8];
    force_of(l, result);
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

}  // namespace
}  // namespace lockstep::continuum
