// Random numbers with the same bits on every machine (the distributions of <random> differ between libraries).
// SplitMix64: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
#pragma once
#include <cmath>
#include <cstdint>

#include "common/vectors.hpp"

namespace lockstep {

class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}

  std::uint64_t next() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ull);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
  }

  // Uniform in [0, 1), 53 bits.
  double uniform() { return static_cast<double>(next() >> 11) * 0x1.0p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }

  // Uniform on the group of rotations (Shoemake, Graphics Gems III, 1992).
  Quat rotation() {
    const double u = uniform(), a = 2 * pi * uniform(), b = 2 * pi * uniform();
    const double s = std::sqrt(1 - u), t = std::sqrt(u);
    return Quat(t * std::cos(b), s * std::sin(a), s * std::cos(a), t * std::sin(b));
  }

 private:
  std::uint64_t state_;
};

}  // namespace lockstep
