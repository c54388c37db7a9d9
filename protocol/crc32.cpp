#include "protocol/crc32.hpp"

#include <zlib.h>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace lockstep::protocol {
namespace {

std::uint32_t crc32_by_tables(std::uint32_t crc, std::span<const std::byte> bytes) {
  return static_cast<std::uint32_t>(crc32_z(crc, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

#if defined(__x86_64__)

// A message is a polynomial over GF(2) and its CRC the remainder modulo P. A block B that stands n bits before the
// block after it may be replaced by B x^n mod P, added to that block; with B = H x^64 + L this is H (x^(n+64) mod P) +
// L (x^n mod P), two carry-less multiplications by constants. Four blocks of 128 bits are carried at once, so that the
// multiplications overlap, then folded into one, whose 16 bytes have the same remainder as all that went before. In the
// reflected bit order a product comes out one bit low and the halves are 32 bits off the remainder's place: the
// constants are x^(n+32) and x^(n-32), reflected and shifted by one. Source: V. Gopal et al., "Fast CRC Computation for
// Generic Polynomials Using PCLMULQDQ Instruction", Intel, 2009.
constexpr std::uint64_t fold_constant(int power) {
  std::uint32_t remainder = 1;  // x^0, highest power in the highest bit
  for (int i = 0; i < power; ++i) remainder = (remainder << 1) ^ ((remainder >> 31) * 0x04c11db7u);
  std::uint64_t reflected = 0;
  for (int i = 0; i < 32; ++i) reflected |= static_cast<std::uint64_t>((remainder >> i) & 1u) << (31 - i);
  return reflected << 1;
}
static_assert(fold_constant(4 * 128 + 32) == 0x154442bd4 && fold_constant(4 * 128 - 32) == 0x1c6e41596);
static_assert(fold_constant(128 + 32) == 0x1751997d0 && fold_constant(128 - 32) == 0x0ccaa009e);

constexpr std::size_t block = sizeof(__m128i);

__attribute__((target("pclmul"))) __m128i fold(__m128i from, __m128i constants, __m128i into) {
  return _mm_xor_si128(
      into, _mm_xor_si128(_mm_clmulepi64_si128(from, constants, 0x00), _mm_clmulepi64_si128(from, constants, 0x11)));
}

__attribute__((target("pclmul"))) std::uint32_t crc32_by_folding(std::span<const std::byte> bytes) {
  const auto load = [&](std::size_t offset) {
    return _mm_loadu_si128(reinterpret_cast<const __m128i*>(bytes.data() + offset));
  };
  const __m128i by_four = _mm_set_epi64x(static_cast<long long>(fold_constant(4 * 128 - 32)),
                                         static_cast<long long>(fold_constant(4 * 128 + 32)));
  const __m128i by_one =
      _mm_set_epi64x(static_cast<long long>(fold_constant(128 - 32)), static_cast<long long>(fold_constant(128 + 32)));
  __m128i a = _mm_xor_si128(load(0), _mm_cvtsi32_si128(-1));  // the CRC starts from all ones
  __m128i b = load(block), c = load(2 * block), d = load(3 * block);
  std::size_t done = 4 * block;
  for (; done + 4 * block <= bytes.size(); done += 4 * block) {
    a = fold(a, by_four, load(done));
    b = fold(b, by_four, load(done + block));
    c = fold(c, by_four, load(done + 2 * block));
    d = fold(d, by_four, load(done + 3 * block));
  }
  b = fold(a, by_one, b);
  c = fold(b, by_one, c);
  d = fold(c, by_one, d);
  std::byte rest[block];
  _mm_storeu_si128(reinterpret_cast<__m128i*>(rest), d);
  // zlib inverts its register at both ends: from ~0 it starts at zero.
  return crc32_by_tables(crc32_by_tables(0xffffffffu, rest), bytes.subspan(done));
}

#endif

}  // namespace

std::uint32_t crc32(std::span<const std::byte> bytes) {
#if defined(__x86_64__)
  static const bool has_multiplication = __builtin_cpu_supports("pclmul") != 0;
  if (has_multiplication && bytes.size() >= 4 * block) return crc32_by_folding(bytes);
#endif
  return crc32_by_tables(0, bytes);
}

}  // namespace lockstep::protocol
