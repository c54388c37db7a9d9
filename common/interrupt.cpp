#include "common/interrupt.hpp"

#include <csignal>

namespace lockstep {
namespace {

std::atomic<bool> requested = false;
static_assert(std::atomic<bool>::is_always_lock_free, "a signal handler may touch lock-free atomics only");

// The next signal of either kind ends the process.
extern "C" void raise_interrupt_flag(int) {
  requested = true;
  std::signal(SIGINT, SIG_DFL);
  std::signal(SIGTERM, SIG_DFL);
}

}  // namespace

std::atomic<bool>& interrupt_requested() { return requested; }

void install_interrupt_handlers() {
  std::signal(SIGINT, raise_interrupt_flag);
  std::signal(SIGTERM, raise_interrupt_flag);
}

}  // namespace lockstep
