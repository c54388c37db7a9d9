#include <catch2/catch.hpp>
#include <cstdint>

#include "common/huge_pages.hpp"

namespace lockstep {
namespace {

struct alignas(64) Record {
  double value[8];
};

bool is_aligned(const void* place, std::size_t to) { return reinterpret_cast<std::uintptr_t>(place) % to == 0; }

}  // namespace

TEST_CASE("large arrays begin at huge pages, small ones where their entries ask, and both keep what is in them") {
  LargeArray<Record> records;
  for (int i = 0; i < 100000; ++i) {
    records.push_back({{static_cast<double>(i)}});
    if (i == 10) CHECK(is_aligned(records.data(), 64));
  }
  REQUIRE(records.size() * sizeof(Record) > 2 * HugePages<Record>::page);
  CHECK(is_aligned(records.data(), HugePages<Record>::page));
  const LargeArray<Record> copy = records;
  records.clear(), records.shrink_to_fit();
  double sum = 0;
  for (const Record& r : copy) sum += r.value[0];
  CHECK(sum == 99999.0 * 100000 / 2);
}

}  // namespace lockstep
