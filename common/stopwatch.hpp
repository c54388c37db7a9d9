// Wall-clock time since it was made or started anew.
#pragma once
#include <chrono>

namespace lockstep {

class Stopwatch {
 public:
  void restart() { begin_ = Clock::now(); }
  double seconds() const { return std::chrono::duration<double>(Clock::now() - begin_).count(); }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point begin_ = Clock::now();
};

}  // namespace lockstep
