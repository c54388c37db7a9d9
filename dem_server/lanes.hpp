// What the grains' kernels add to common/lanes.hpp: loads of eight bodies at a time.
#pragma once
#include "common/lanes.hpp"
#include "dem_server/records.hpp"

namespace lockstep::dem {
namespace {

// Adds f and t of each lane to the load record `on` of that lane, and takes f and u from `off`, one lane after the other.
// The fourth of each is unused.
#if defined(__AVX512F__)
// Rows 0 | 2, 1 | 3, 4 | 6, 5 | 7.
LOCKSTEP_INLINE void transpose_in_pairs(const Lanes4& v, Lanes* r) {
  const Lanes xy_even = _mm512_unpacklo_pd(v.x, v.y), xy_odd = _mm512_unpackhi_pd(v.x, v.y);
  const Lanes zw_even = _mm512_unpacklo_pd(v.z, v.w), zw_odd = _mm512_unpackhi_pd(v.z, v.w);
  const __m512i low = _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11), high = _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15);
  r[0] = _mm512_permutex2var_pd(xy_even, low, zw_even), r[1] = _mm512_permutex2var_pd(xy_odd, low, zw_odd);
  r[2] = _mm512_permutex2var_pd(xy_even, high, zw_even), r[3] = _mm512_permutex2var_pd(xy_odd, high, zw_odd);
}
LOCKSTEP_INLINE void add_loads(const Lanes4& f, const Lanes4& t, const Lanes4& u, LoadRecord* const* on,
                               LoadRecord* const* off) {
  Lanes fs[4], ts[4], us[4];
  transpose_in_pairs(f, fs), transpose_in_pairs(t, ts), transpose_in_pairs(u, us);
  const auto record = [](LoadRecord* r) -> Lanes& { return *reinterpret_cast<Lanes*>(&r->fx); };
  const auto first = [](Lanes a, Lanes b) -> Lanes { return _mm512_insertf64x4(a, _mm512_castpd512_pd256(b), 1); };
  const auto second = [](Lanes a, Lanes b) -> Lanes { return _mm512_shuffle_f64x2(a, b, 0xee); };
  for (int half = 0; half < 2; ++half) {
    const int l = 4 * half, p = 2 * half;
    record(on[l]) += first(fs[p], ts[p]);
    record(off[l]) -= first(fs[p], us[p]);
    record(on[l + 1]) += first(fs[p + 1], ts[p + 1]);
    record(off[l + 1]) -= first(fs[p + 1], us[p + 1]);
    record(on[l + 2]) += second(fs[p], ts[p]);
    record(off[l + 2]) -= second(fs[p], us[p]);
    record(on[l + 3]) += second(fs[p + 1], ts[p + 1]);
    record(off[l + 3]) -= second(fs[p + 1], us[p + 1]);
  }
}
#else
LOCKSTEP_INLINE void add_loads(const Lanes4& f, const Lanes4& t, const Lanes4& u, LoadRecord* const* on,
                               LoadRecord* const* off) {
  Row fs[width], ts[width], us[width];
  transpose(f, fs), transpose(t, ts), transpose(u, us);
  for (int l = 0; l < width; ++l) {
    add_row(&on[l]->fx, fs[l]);
    add_row(&on[l]->tx, ts[l]);
    add_row(&off[l]->fx, -fs[l]);
    add_row(&off[l]->tx, -us[l]);
  }
}
#endif

}  // namespace
}  // namespace lockstep::dem
