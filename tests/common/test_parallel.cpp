#include "common/parallel.hpp"

#include <atomic>
#include <catch2/catch.hpp>
#include <chrono>
#include <ctime>
#include <numeric>
#include <set>
#include <stdexcept>
#include <string>

#include "common/checks.hpp"

namespace {

using namespace lockstep;

constexpr int sizes[] = {1, 2, 3, 8};

}  // namespace

TEST_CASE("A run calls the task once for each thread, each on its own, number 0 on the caller's") {
  for (const int size : sizes) {
    Team team(size);
    CHECK(team.size() == size);
    const auto count = static_cast<std::size_t>(size);
    std::vector<std::atomic<int>> calls(count);
    std::vector<std::thread::id> ids(count);
    team.run([&](int t) {
      const auto place = static_cast<std::size_t>(t);
      ++calls.at(place);
      ids.at(place) = std::this_thread::get_id();
    });
    for (const auto& of_one : calls) CHECK(of_one == 1);
    CHECK(ids[0] == std::this_thread::get_id());
    CHECK(std::set<std::thread::id>(ids.begin(), ids.end()).size() == count);
    // Threads are kept: the second run finds each number on the thread of the first.
    const std::vector<std::thread::id> first = ids;
    team.run([&](int t) { ids.at(static_cast<std::size_t>(t)) = std::this_thread::get_id(); });
    CHECK(ids == first);
  }
}

TEST_CASE("Threads work at the same time: a task that waits for all of them ends") {
  // Each waits until all have come; a team that calls one after the other would never get there. The deadline turns
  // that into a failure.
  for (const int size : sizes) {
    Team team(size);
    std::atomic<int> here = 0, met = 0;
    team.run([&](int) {
      ++here;
      const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
      while (here < size && std::chrono::steady_clock::now() < deadline) std::this_thread::yield();
      met += here == size;
    });
    CAPTURE(size);
    CHECK(met == size);
  }
}

TEST_CASE("Parts are each worked on once, and by others where a thread is held up") {
  for (const int size : sizes) {
    Team team(size);
    for (const int parts : {0, 1, 7, 100}) {
      std::vector<std::atomic<int>> calls(static_cast<std::size_t>(parts));
      team.run_parts(parts, [&](int part) { ++calls.at(static_cast<std::size_t>(part)); });
      CAPTURE(size, parts);
      for (const auto& of_one : calls) CHECK(of_one == 1);
    }
    if (size == 1) continue;
    // Who gets part 0 waits until all others are done: with shares fixed beforehand, those of its own would never be.
    std::atomic<int> done = 0;
    team.run_parts(20, [&](int part) {
      const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
      while (part == 0 && done < 19 && std::chrono::steady_clock::now() < deadline) std::this_thread::yield();
      CHECK((part > 0 || done == 19));
      ++done;
    });
    CHECK(done == 20);
  }
}

TEST_CASE("Thousands of runs in a row each see what all threads wrote in the run before") {
  // Each thread's value becomes one more than the sum of all threads' values of the run before, so all are equal and
  // v(n) = size v(n-1) + 1, kept small by a prime's remainder. A run that began before the last one had ended, or that
  // missed a thread, breaks the chain for good. Plain integers: the team alone orders the accesses.
  const int runs = 2000;
  const std::uint64_t prime = 1000003;
  for (const int size : sizes) {
    Team team(size);
    std::vector<std::uint64_t> now(static_cast<std::size_t>(size), 1), before = now;
    std::uint64_t expected = 1;
    int wrong = 0;
    for (int run = 0; run < runs; ++run) {
      before.swap(now);
      team.run([&](int t) {
        now[static_cast<std::size_t>(t)] = std::accumulate(before.begin(), before.end(), std::uint64_t{1}) % prime;
      });
      expected = (expected * static_cast<std::uint64_t>(size) + 1) % prime;
      for (const std::uint64_t value : now) wrong += value != expected;
    }
    CAPTURE(size, expected);
    CHECK(wrong == 0);
  }
}

TEST_CASE("A team that has gone to sleep in a pause wakes for the next run") {
  // Threads spin for some 20 us before they sleep; pauses of 0, 1, 5 and 20 ms lie on both sides. A caller that waits
  // sleeps as well: the other threads then take 5 ms.
  for (const int size : sizes) {
    Team team(size);
    std::atomic<int> calls = 0;
    int expected = 0;
    for (const int pause : {0, 1, 5, 20, 0, 20, 1}) {
      std::this_thread::sleep_for(std::chrono::milliseconds(pause));
      team.run([&](int t) {
        if (t > 0) std::this_thread::sleep_for(std::chrono::milliseconds(5));
        ++calls;
      });
      expected += size;
      CAPTURE(size, pause);
      CHECK(calls == expected);
    }
  }
}

TEST_CASE("A team whose threads sleep uses no processor time") {
  // Seven threads spin for some 20 us each and then sleep through half a second: 0.2 ms of 500. Threads that spun on
  // would take 500 ms or more of the processor.
  Team team(8);
  std::atomic<int> calls = 0;
  team.run([&](int) { ++calls; });
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  const std::clock_t start = std::clock();
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  const double used = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  CAPTURE(used);
  CHECK(calls == 8);
  CHECK(used < 0.1);
}

TEST_CASE("An exception of a task comes out when all have ended, and the team goes on") {
  for (const int size : sizes) {
    Team team(size);
    for (int thrower = 0; thrower < size; ++thrower) {
      CAPTURE(size, thrower);
      std::atomic<int> ended = 0;
      const auto task = [&](int t) {
        if (t == thrower) throw NumericalError("thread " + std::to_string(t));
        std::this_thread::sleep_for(std::chrono::milliseconds(1));  // the thrower is done first
        ++ended;
      };
      CHECK_THROWS_MATCHES(team.run(task), NumericalError, Catch::Message("thread " + std::to_string(thrower)));
      CHECK(ended == size - 1);
      // And is gone: the next run is a good one.
      std::atomic<int> calls = 0;
      CHECK_NOTHROW(team.run([&](int) { ++calls; }));
      CHECK(calls == size);
    }
  }
}

TEST_CASE("Of several exceptions the lowest thread's comes out, whichever was first") {
  Team team(8);
  for (int lowest = 0; lowest < 8; ++lowest) {
    const auto task = [&](int t) {
      std::this_thread::sleep_for(std::chrono::milliseconds(t == lowest ? 4 : 0));  // the lowest throws last
      if (t >= lowest) throw std::runtime_error("thread " + std::to_string(t));
    };
    CHECK_THROWS_WITH(team.run(task), "thread " + std::to_string(lowest));
  }
}

TEST_CASE("A team of none or of too many is refused with value, range and option") {
  for (const int size : {0, -1, 257, 300}) {
    CAPTURE(size);
    CHECK_THROWS_AS(Team(size), InputError);
    CHECK_THROWS_WITH(Team(size),
                      Catch::Contains("--threads " + std::to_string(size) + ":") && Catch::Contains("[1, 256]"));
  }
}

TEST_CASE("A team that never ran, or that sleeps, ends at once; teams can live side by side") {
  const auto start = std::chrono::steady_clock::now();
  for (int round = 0; round < 50; ++round) Team idle(8);
  {
    Team asleep(8);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  Team one(3), two(2);
  std::atomic<int> calls = 0;
  one.run([&](int t) {
    if (t == 0) two.run([&](int) { ++calls; });
    ++calls;
  });
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  CAPTURE(seconds);
  CHECK(calls == 5);
  CHECK(seconds < 30);
}

TEST_CASE("The team of the caller alone is one, and belongs to its thread") {
  CHECK(Team::alone().size() == 1);
  CHECK(&Team::alone() == &Team::alone());
  const Team* other = nullptr;
  std::thread([&] { other = &Team::alone(); }).join();
  CHECK(other != &Team::alone());
  int calls = 0;
  Team::alone().run([&](int t) { calls += t == 0; });
  CHECK(calls == 1);
}
