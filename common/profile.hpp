// Wall-clock time by named phase: one scoped object per phase, one line in the summary.
#pragma once
#include <array>
#include <chrono>
#include <cstddef>
#include <string_view>

namespace lockstep {

// Phase is an enum class whose last member is Count.
template <class Phase>
class Profile {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr std::size_t size = static_cast<std::size_t>(Phase::Count);

  class Scope {
   public:
    Scope(Profile& profile, Phase phase) : profile_(profile), phase_(phase), begin_(Clock::now()) {}
    ~Scope() { profile_.seconds_[static_cast<std::size_t>(phase_)] += elapsed(begin_); }
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;

   private:
    Profile& profile_;
    Phase phase_;
    Clock::time_point begin_;
  };

  [[nodiscard]] Scope measure(Phase phase) { return Scope(*this, phase); }
  double seconds(Phase phase) const { return seconds_[static_cast<std::size_t>(phase)]; }
  double total() const {
    double sum = 0;
    for (double s : seconds_) sum += s;
    return sum;
  }

 private:
  static double elapsed(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }
  std::array<double, size> seconds_{};  // [s]
};

}  // namespace lockstep
