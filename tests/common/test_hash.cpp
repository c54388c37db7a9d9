#include "common/hash.hpp"

#include <catch2/catch.hpp>
#include <limits>
#include <vector>

namespace {

using namespace lockstep;

std::uint64_t hash_of(const std::vector<double>& values) {
  Hash hash;
  hash.add(std::span<const double>(values));
  return hash.value();
}

}  // namespace

TEST_CASE("Two states have the same hash only if every bit is the same") {
  const std::uint64_t base = hash_of({1, 2, 3});
  CHECK(hash_of({1, 2, 3}) == base);
  CHECK(hash_of({1, 2, 3 + 4 * std::numeric_limits<double>::epsilon()}) != base);
  CHECK(hash_of({2, 1, 3}) != base);
  CHECK(hash_of({1, 2, 3, 0}) != base);
  CHECK(hash_of({0.0}) != hash_of({-0.0}));
}

TEST_CASE("A vector hashes as its three components in order") {
  Hash vectors, components;
  vectors.add(Vec3(1, -2, 3));
  for (double value : {1.0, -2.0, 3.0}) components.add(value);
  CHECK(vectors.value() == components.value());
  Hash list;
  const Vec3s one = {Vec3(1, -2, 3)};
  list.add(std::span<const Vec3>(one));
  CHECK(list.value() == components.value());
}

TEST_CASE("A text's hash depends on each letter and its place") {
  const auto of = [](std::string_view text) {
    Hash hash;
    hash.add(text);
    return hash.value();
  };
  CHECK(of("grains") == of("grains"));
  CHECK(of("grains") != of("grians"));
  CHECK(of("") != of(std::string_view("\0", 1)));
}
