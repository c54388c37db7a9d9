// A 64-bit hash of doubles' bits, to show that two states are the same to the last bit (FNV-1a over 8-byte words with a
// final avalanche after MurmurHash3's fmix64). Not cryptographic.
#pragma once
#include <bit>
#include <cstdint>
#include <span>
#include <string_view>

#include "common/vectors.hpp"

namespace lockstep {

class Hash {
 public:
  void add(std::uint64_t word) { state_ = (state_ ^ word) * 0x100000001b3ull + (state_ >> 47); }
  void add(double value) { add(std::bit_cast<std::uint64_t>(value)); }
  void add(const Vec3& v) { add(v.x()), add(v.y()), add(v.z()); }
  void add(std::span<const Vec3> values) {
    for (const Vec3& v : values) add(v);
  }
  void add(std::span<const double> values) {
    for (double v : values) add(v);
  }
  void add(std::string_view text) {
    for (char c : text) add(static_cast<std::uint64_t>(static_cast<unsigned char>(c)));
  }
  std::uint64_t value() const {
    std::uint64_t h = state_;
    h ^= h >> 33, h *= 0xff51afd7ed558ccdull, h ^= h >> 33, h *= 0xc4ceb9fe1a85ec53ull, h ^= h >> 33;
    return h;
  }

 private:
  std::uint64_t state_ = 0xcbf29ce484222325ull;
};

}  // namespace lockstep
