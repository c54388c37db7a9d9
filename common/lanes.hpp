// Vectors of doubles, as wide as the instruction set that this is compiled for: 8, 4 or 2 lanes. Included only by
// kernels that are compiled once for each instruction set; everything is local to the file that includes it.
//
// All arithmetic is that of single doubles, lane by lane, and contracts nothing by itself: any width gives the same bits.
// Only multiply_add() and what is made of it round once where the instruction set can (AVX2, AVX-512), twice where it cannot:
// kernels that use them have other last bits there. Sums over lanes are kept as eight partial sums whatever the width (Sum8).
#pragma once
#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace lockstep {
namespace {

#if defined(__AVX512F__)
constexpr int width = 8;
#elif defined(__AVX2__)
constexpr int width = 4;
#else
constexpr int width = 2;
#endif
constexpr int block = 8;  // entries that kernels take at a time, for any width

using Lanes [[gnu::vector_size(8 * width)]] = double;
using Mask [[gnu::vector_size(8 * width)]] = long long;
using Row [[gnu::vector_size(32)]] = double;  // half a record
using RowMask [[gnu::vector_size(32)]] = long long;
using Pair [[gnu::vector_size(16)]] = double;

#define LOCKSTEP_INLINE inline __attribute__((always_inline))

// Less zero, which changes no value and costs nothing; plus zero would lose a zero's sign, and so is added.
LOCKSTEP_INLINE Lanes lanes(double value) { return value - Lanes{}; }
LOCKSTEP_INLINE Lanes load(const double* from) { return *reinterpret_cast<const Lanes*>(from); }
LOCKSTEP_INLINE void store(double* to, Lanes value) { *reinterpret_cast<Lanes*>(to) = value; }
// The same for any address of a double.
using LooseLanes [[gnu::vector_size(8 * width), gnu::aligned(8)]] = double;
LOCKSTEP_INLINE Lanes loose(const double* from) { return *reinterpret_cast<const LooseLanes*>(from); }
LOCKSTEP_INLINE void store_loose(double* to, Lanes value) { *reinterpret_cast<LooseLanes*>(to) = value; }
LOCKSTEP_INLINE Row row(const double* from) { return *reinterpret_cast<const Row*>(from); }
LOCKSTEP_INLINE void add_row(double* to, Row value) { *reinterpret_cast<Row*>(to) += value; }
LOCKSTEP_INLINE Row spread(double value) { return value - Row{}; }

LOCKSTEP_INLINE Lanes select(Mask which, Lanes yes, Lanes no) { return which ? yes : no; }
// a > b ? a : b and a < b ? a : b, also where one is no number.
#if defined(__AVX512F__)
LOCKSTEP_INLINE Lanes larger(Lanes a, Lanes b) { return _mm512_max_pd(a, b); }
LOCKSTEP_INLINE Lanes smaller(Lanes a, Lanes b) { return _mm512_min_pd(a, b); }
#elif defined(__AVX2__)
LOCKSTEP_INLINE Lanes larger(Lanes a, Lanes b) { return _mm256_max_pd(a, b); }
LOCKSTEP_INLINE Lanes smaller(Lanes a, Lanes b) { return _mm256_min_pd(a, b); }
#else
LOCKSTEP_INLINE Lanes larger(Lanes a, Lanes b) { return a > b ? a : b; }
LOCKSTEP_INLINE Lanes smaller(Lanes a, Lanes b) { return a < b ? a : b; }
#endif

LOCKSTEP_INLINE Lanes square_root(Lanes x) {
#if defined(__AVX512F__)
  return _mm512_sqrt_pd(x);
#elif defined(__AVX2__)
  return _mm256_sqrt_pd(x);
#elif defined(__SSE2__)
  return _mm_sqrt_pd(x);
#else
  for (int l = 0; l < width; ++l) x[l] = __builtin_sqrt(x[l]);
  return x;
#endif
}

// a b + c, in one rounding where there is an instruction for it.
#if defined(__AVX512F__)
LOCKSTEP_INLINE Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return _mm512_fmadd_pd(a, b, c); }
#endif
#if defined(__AVX2__)
LOCKSTEP_INLINE Row multiply_add(Row a, Row b, Row c) { return _mm256_fmadd_pd(a, b, c); }
#else
LOCKSTEP_INLINE Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return a * b + c; }
LOCKSTEP_INLINE Row multiply_add(Row a, Row b, Row c) { return a * b + c; }
#endif

LOCKSTEP_INLINE bool any(Mask m) {
#if defined(__AVX512F__)
  return _mm512_test_epi64_mask((__m512i)m, (__m512i)m) != 0;
#elif defined(__AVX2__)
  return !_mm256_testz_si256((__m256i)m, (__m256i)m);
#else
  long long all = 0;
  for (int l = 0; l < width; ++l) all |= m[l];
  return all != 0;
#endif
}

// Bit l says whether lane l is set.
LOCKSTEP_INLINE unsigned bits(Mask m) {
#if defined(__AVX512F__)
  return _mm512_test_epi64_mask((__m512i)m, (__m512i)m);
#elif defined(__AVX2__)
  return static_cast<unsigned>(_mm256_movemask_pd((__m256d)m));
#else
  unsigned all = 0;
  for (int l = 0; l < width; ++l) all |= m[l] != 0 ? 1u << l : 0u;
  return all;
#endif
}

// ---- vectors in space, lane by lane

struct Lanes3 {
  Lanes x, y, z;
};
LOCKSTEP_INLINE Lanes3 operator+(const Lanes3& a, const Lanes3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
LOCKSTEP_INLINE Lanes3 operator-(const Lanes3& a, const Lanes3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
LOCKSTEP_INLINE Lanes3 operator*(Lanes s, const Lanes3& a) { return {s * a.x, s * a.y, s * a.z}; }
LOCKSTEP_INLINE Lanes dot(const Lanes3& a, const Lanes3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
LOCKSTEP_INLINE Lanes3 cross(const Lanes3& a, const Lanes3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
LOCKSTEP_INLINE Lanes3 multiply_add(Lanes s, const Lanes3& a, const Lanes3& b) {  // s a + b
  return {multiply_add(s, a.x, b.x), multiply_add(s, a.y, b.y), multiply_add(s, a.z, b.z)};
}
LOCKSTEP_INLINE Lanes fused_dot(const Lanes3& a, const Lanes3& b) {
  return multiply_add(a.z, b.z, multiply_add(a.y, b.y, a.x * b.x));
}
LOCKSTEP_INLINE Lanes3 fused_cross(const Lanes3& a, const Lanes3& b) {
  return {multiply_add(a.y, b.z, -(a.z * b.y)), multiply_add(a.z, b.x, -(a.x * b.z)),
          multiply_add(a.x, b.y, -(a.y * b.x))};
}
LOCKSTEP_INLINE Lanes3 cross_add(const Lanes3& a, const Lanes3& b, const Lanes3& c) {  // a x b + c
  return {multiply_add(a.y, b.z, multiply_add(-a.z, b.y, c.x)), multiply_add(a.z, b.x, multiply_add(-a.x, b.z, c.y)),
          multiply_add(a.x, b.y, multiply_add(-a.y, b.x, c.z))};
}
LOCKSTEP_INLINE Lanes3 select(Mask which, const Lanes3& yes, const Lanes3& no) {
  return {select(which, yes.x, no.x), select(which, yes.y, no.y), select(which, yes.z, no.z)};
}

// ---- `width` rows of four <-> four lanes: transposed in registers, since gathers are slower than loads and shuffles

struct Lanes4 {
  Lanes x, y, z, w;
};
LOCKSTEP_INLINE Lanes3 xyz(const Lanes4& v) { return {v.x, v.y, v.z}; }

#if defined(__AVX512F__)
LOCKSTEP_INLINE Lanes join(Row a, Row b) { return _mm512_insertf64x4(_mm512_castpd256_pd512(a), b, 1); }
LOCKSTEP_INLINE Lanes4 transpose(const Row* r) {
  const Lanes r02 = join(r[0], r[2]), r13 = join(r[1], r[3]), r46 = join(r[4], r[6]), r57 = join(r[5], r[7]);
  const Lanes xz_low = _mm512_unpacklo_pd(r02, r13), yw_low = _mm512_unpackhi_pd(r02, r13);
  const Lanes xz_high = _mm512_unpacklo_pd(r46, r57), yw_high = _mm512_unpackhi_pd(r46, r57);
  return {_mm512_shuffle_f64x2(xz_low, xz_high, 0x88), _mm512_shuffle_f64x2(yw_low, yw_high, 0x88),
          _mm512_shuffle_f64x2(xz_low, xz_high, 0xdd), _mm512_shuffle_f64x2(yw_low, yw_high, 0xdd)};
}
// Rows 0 | 2, 1 | 3, 4 | 6, 5 | 7.
LOCKSTEP_INLINE void rows_in_pairs(const Lanes4& v, Lanes* pairs) {
  const __m512i low = _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11), high = _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15);
  const Lanes xy_even = _mm512_unpacklo_pd(v.x, v.y), xy_odd = _mm512_unpackhi_pd(v.x, v.y);
  const Lanes zw_even = _mm512_unpacklo_pd(v.z, v.w), zw_odd = _mm512_unpackhi_pd(v.z, v.w);
  pairs[0] = _mm512_permutex2var_pd(xy_even, low, zw_even), pairs[1] = _mm512_permutex2var_pd(xy_odd, low, zw_odd);
  pairs[2] = _mm512_permutex2var_pd(xy_even, high, zw_even), pairs[3] = _mm512_permutex2var_pd(xy_odd, high, zw_odd);
}
LOCKSTEP_INLINE void transpose(const Lanes4& v, Row* r) {
  Lanes pairs[4];
  rows_in_pairs(v, pairs);
  for (int k = 0; k < 4; ++k) {
    const int first = k < 2 ? k : k + 2;
    r[first] = _mm512_castpd512_pd256(pairs[k]), r[first + 2] = _mm512_extractf64x4_pd(pairs[k], 1);
  }
}
#elif defined(__AVX2__)
LOCKSTEP_INLINE Lanes4 transpose(const Row* r) {
  const Row xz_low = _mm256_unpacklo_pd(r[0], r[1]), yw_low = _mm256_unpackhi_pd(r[0], r[1]);
  const Row xz_high = _mm256_unpacklo_pd(r[2], r[3]), yw_high = _mm256_unpackhi_pd(r[2], r[3]);
  return {_mm256_permute2f128_pd(xz_low, xz_high, 0x20), _mm256_permute2f128_pd(yw_low, yw_high, 0x20),
          _mm256_permute2f128_pd(xz_low, xz_high, 0x31), _mm256_permute2f128_pd(yw_low, yw_high, 0x31)};
}
LOCKSTEP_INLINE void transpose(const Lanes4& v, Row* r) {
  const Lanes rows[4] = {v.x, v.y, v.z, v.w};
  const Lanes4 turned = transpose(rows);
  r[0] = turned.x, r[1] = turned.y, r[2] = turned.z, r[3] = turned.w;
}
#else
LOCKSTEP_INLINE Pair low(Row r) { return Pair{r[0], r[1]}; }
LOCKSTEP_INLINE Pair high(Row r) { return Pair{r[2], r[3]}; }
LOCKSTEP_INLINE Lanes4 transpose(const Row* r) {
  const Pair a = low(r[0]), b = low(r[1]), c = high(r[0]), d = high(r[1]);
  return {Lanes{a[0], b[0]}, Lanes{a[1], b[1]}, Lanes{c[0], d[0]}, Lanes{c[1], d[1]}};
}
LOCKSTEP_INLINE void transpose(const Lanes4& v, Row* r) {
  for (int l = 0; l < 2; ++l) r[l] = Row{v.x[l], v.y[l], v.z[l], v.w[l]};
}
#endif

// ---- `width` vectors in space, three doubles each in memory one after the other <-> three lanes

#if defined(__AVX512F__)
LOCKSTEP_INLINE Lanes3 load_vectors(const double* from) {
  const Lanes a = loose(from), b = loose(from + 8), c = loose(from + 16);
  const Lanes x = __builtin_shufflevector(a, b, 0, 3, 6, 9, 12, 15, 15, 15);
  const Lanes y = __builtin_shufflevector(a, b, 1, 4, 7, 10, 13, 13, 13, 13);
  const Lanes z = __builtin_shufflevector(a, b, 2, 5, 8, 11, 14, 14, 14, 14);
  return {__builtin_shufflevector(x, c, 0, 1, 2, 3, 4, 5, 10, 13),
          __builtin_shufflevector(y, c, 0, 1, 2, 3, 4, 8, 11, 14),
          __builtin_shufflevector(z, c, 0, 1, 2, 3, 4, 9, 12, 15)};
}
LOCKSTEP_INLINE void store_vectors(double* to, const Lanes3& v) {
  const Lanes a = __builtin_shufflevector(v.x, v.y, 0, 8, 8, 1, 9, 9, 2, 10);
  const Lanes b = __builtin_shufflevector(v.x, v.y, 3, 3, 11, 4, 4, 12, 5, 5);
  const Lanes c = __builtin_shufflevector(v.x, v.y, 13, 6, 6, 14, 7, 7, 15, 15);
  store_loose(to, __builtin_shufflevector(a, v.z, 0, 1, 8, 3, 4, 9, 6, 7));
  store_loose(to + 8, __builtin_shufflevector(b, v.z, 10, 0, 2, 11, 3, 5, 12, 6));
  store_loose(to + 16, __builtin_shufflevector(c, v.z, 0, 13, 1, 3, 14, 4, 6, 15));
}
#elif defined(__AVX2__)
LOCKSTEP_INLINE Lanes3 load_vectors(const double* from) {
  const Lanes a = loose(from), b = loose(from + 4), c = loose(from + 8);
  const Lanes x = __builtin_shufflevector(a, b, 0, 3, 6, 6), y = __builtin_shufflevector(a, b, 1, 4, 7, 7);
  const Lanes z = __builtin_shufflevector(a, b, 2, 5, 5, 5);
  return {__builtin_shufflevector(x, c, 0, 1, 2, 5), __builtin_shufflevector(y, c, 0, 1, 2, 6),
          __builtin_shufflevector(z, c, 0, 1, 4, 7)};
}
LOCKSTEP_INLINE void store_vectors(double* to, const Lanes3& v) {
  const Lanes a = __builtin_shufflevector(v.x, v.y, 0, 4, 1, 1), b = __builtin_shufflevector(v.x, v.y, 5, 5, 2, 6);
  const Lanes c = __builtin_shufflevector(v.x, v.y, 3, 3, 7, 7);
  store_loose(to, __builtin_shufflevector(a, v.z, 0, 1, 4, 2));
  store_loose(to + 4, __builtin_shufflevector(b, v.z, 0, 5, 2, 3));
  store_loose(to + 8, __builtin_shufflevector(c, v.z, 6, 0, 2, 7));
}
#else
LOCKSTEP_INLINE Lanes3 load_vectors(const double* from) {
  return {Lanes{from[0], from[3]}, Lanes{from[1], from[4]}, Lanes{from[2], from[5]}};
}
LOCKSTEP_INLINE void store_vectors(double* to, const Lanes3& v) {
  for (int l = 0; l < width; ++l) to[3 * l] = v.x[l], to[3 * l + 1] = v.y[l], to[3 * l + 2] = v.z[l];
}
#endif

// Eight partial sums, one a lane of a tile; added up in the same order for any width.
struct Sum8 {
  alignas(64) double part[block] = {};
  LOCKSTEP_INLINE void add(int begin, Lanes value) { store(part + begin, load(part + begin) + value); }
  LOCKSTEP_INLINE void raise(int begin, Lanes value) { store(part + begin, larger(load(part + begin), value)); }
  double total() const {
    return ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]));
  }
  double largest() const {
    double most = part[0];
    for (int l = 1; l < block; ++l) most = part[l] > most ? part[l] : most;
    return most;
  }
};

}  // namespace
}  // namespace lockstep
