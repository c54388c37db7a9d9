// Which state a run that fails goes back to: the newest of the last two that is old enough.
#include <catch2/catch.hpp>
#include <memory>

#include "common/good_states.hpp"

namespace lockstep {
namespace {

// Kept every 500 steps up to `last`; the step that a failure at `failed_at` goes back to, 0 for none.
std::uint64_t sound_step(std::uint64_t last, std::uint64_t failed_at) {
  GoodStates<std::unique_ptr<int>> states;
  for (std::uint64_t step = 500; step <= last; step += 500)
    states.keep(step, 1e-3 * static_cast<double>(step), std::make_unique<int>(static_cast<int>(step)));
  const auto* good = states.before(failed_at, 100);
  if (!good) return 0;
  CHECK(good->time == 1e-3 * static_cast<double>(good->step));
  CHECK(*good->state == static_cast<int>(good->step));
  return good->step;
}

}  // namespace

TEST_CASE("A run that fails goes back to the newest state that is 100 steps older than the failure") {
  CHECK(sound_step(0, 400) == 0);
  CHECK(sound_step(500, 599) == 0);
  CHECK(sound_step(500, 600) == 500);
  CHECK(sound_step(1000, 1099) == 500);
  CHECK(sound_step(1000, 1100) == 1000);
  CHECK(sound_step(2500, 2599) == 2000);
  CHECK(sound_step(2500, 2999) == 2500);
  CHECK(sound_step(2500, 2000) == 0);  // those of 500 to 1500 are gone
}

}  // namespace lockstep
