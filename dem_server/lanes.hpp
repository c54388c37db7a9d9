// What the grains' kernels add to common/lanes.hpp: loads of eight bodies at a time.
#pragma once
#include "common/lanes.hpp"
#include "dem_server/records.hpp"

namespace lockstep::dem {
namespace {

// ---- `width` records of two rows each <-> two sets of four lanes
#if defined(__AVX512F__)
// A record is one register.
LOCKSTEP_INLINE void join_rows(const Lanes4& first, const Lanes4& second, Lanes* r) {
  Lanes a[4], b[4];
  rows_in_pairs(first, a), rows_in_pairs(second, b);
  for (int half = 0; half < 2; ++half)
    for (int p = 0; p < 2; ++p) {
      const int k = 2 * half + p;
      r[4 * half + p] = _mm512_insertf64x4(a[k], _mm512_castpd512_pd256(b[k]), 1);
      r[4 * half + p + 2] = _mm512_shuffle_f64x2(a[k], b[k], 0xee);
    }
}
#endif

// Sets `count` records.
template <class Record>
LOCKSTEP_INLINE void store_records(const Lanes4& first, const Lanes4& second, Record* to, int count) {
  static_assert(sizeof(Record) == 2 * sizeof(Row));
#if defined(__AVX512F__)
  Lanes r[width];
  join_rows(first, second, r);
  for (int l = 0; l < count; ++l) *reinterpret_cast<Lanes*>(to + l) = r[l];
#else
  Row a[width], b[width];
  transpose(first, a), transpose(second, b);
  for (int l = 0; l < count; ++l) {
    reinterpret_cast<Row*>(to + l)[0] = a[l];
    reinterpret_cast<Row*>(to + l)[1] = b[l];
  }
#endif
}

// Adds force f and moment m of each lane to the load record `on` of that lane, and takes f and n from `off`, one lane after
// the other. The fourth of each is unused.
LOCKSTEP_INLINE void add_loads(const Lanes4& f, const Lanes4& m, const Lanes4& n, LoadRecord* const* on,
                               LoadRecord* const* off) {
#if defined(__AVX512F__)
  Lanes plus[width], minus[width];
  join_rows(f, m, plus), join_rows(f, n, minus);
  for (int l = 0; l < width; ++l) {
    *reinterpret_cast<Lanes*>(on[l]) += plus[l];
    *reinterpret_cast<Lanes*>(off[l]) -= minus[l];
  }
#else
  Row fs[width], ms[width], ns[width];
  transpose(f, fs), transpose(m, ms), transpose(n, ns);
  for (int l = 0; l < width; ++l) {
    add_row(&on[l]->fx, fs[l]);
    add_row(&on[l]->mx, ms[l]);
    add_row(&off[l]->fx, -fs[l]);
    add_row(&off[l]->mx, -ns[l]);
  }
#endif
}

// v + x x w, by shuffles of rows, in the order of cross_add(): the bits of the motion kernel.
inline void make_twists(const SphereRecord* bodies, const MotionRecord* motion, TwistRecord* twists, std::int32_t begin,
                        std::int32_t end) {
  const auto yzx = [](Row r) { return __builtin_shufflevector(r, r, 1, 2, 0, 3); };
  const auto zxy = [](Row r) { return __builtin_shufflevector(r, r, 2, 0, 1, 3); };
  for (std::int32_t k = begin; k < end; ++k) {
    const Row x = row(&bodies[k].x), v = row(&motion[k].vx), w = row(&motion[k].wx);
    const Row at_origin = multiply_add(yzx(x), zxy(w), multiply_add(-zxy(x), yzx(w), v));
    *reinterpret_cast<Row*>(&twists[k].vx) = __builtin_shufflevector(at_origin, w, 0, 1, 2, 7);
    *reinterpret_cast<Row*>(&twists[k].wx) = __builtin_shufflevector(w, v, 0, 1, 2, 7);
  }
}

}  // namespace
}  // namespace lockstep::dem
