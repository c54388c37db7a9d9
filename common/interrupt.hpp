// Ctrl-C that ends a run cleanly: the first SIGINT or SIGTERM only raises a flag, which long loops look at; the second
// kills.
#pragma once
#include <atomic>

namespace lockstep {

// True from the first signal on. Tests may set and clear it.
std::atomic<bool>& interrupt_requested();

// Call once, from main.
void install_interrupt_handlers();

}  // namespace lockstep
