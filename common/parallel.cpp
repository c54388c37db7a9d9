#include "common/parallel.hpp"

#include "common/checks.hpp"

namespace lockstep {

namespace {

constexpr int most_threads = 256;
constexpr int spins = 4000;  // some 10 to 20 us

inline void relax_processor() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#endif
}

// Until `is_done`, or for so long.
template <class Condition>
bool spin_until(Condition&& is_done) {
  for (int k = 0; k < spins; ++k) {
    if (is_done()) return true;
    relax_processor();
  }
  return is_done();
}

}  // namespace

Team::Team(int threads) {
  if (threads < 1 || threads > most_threads)
    throw InputError(fmt::format("--threads {}: must lie in [1, {}]; the machine has {} cores", threads, most_threads,
                                 std::thread::hardware_concurrency()));
  errors_.resize(static_cast<std::size_t>(threads));
  for (int t = 1; t < threads; ++t) threads_.emplace_back([this, t] { work(t); });
}

Team::~Team() {
  is_ending_ = true;
  task_number_.fetch_add(1, std::memory_order_release);
  task_number_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

Team& Team::alone() {
  thread_local Team team(1);
  return team;
}

void Team::call_one(int thread) {
  try {
    call_(object_, thread);
  } catch (...) {
    errors_[static_cast<std::size_t>(thread)] = std::current_exception();
  }
}

void Team::work(int thread) {
  std::uint32_t done = 0;
  while (true) {
    if (!spin_until([&] { return task_number_.load(std::memory_order_acquire) != done; }))
      task_number_.wait(done, std::memory_order_acquire);
    const std::uint32_t number = task_number_.load(std::memory_order_acquire);
    if (number == done) continue;
    done = number;
    if (is_ending_) return;
    call_one(thread);
    if (working_.fetch_sub(1, std::memory_order_acq_rel) == 1) working_.notify_one();
  }
}

void Team::run_all(Call call, void* object) {
  call_ = call;
  object_ = object;
  for (std::exception_ptr& error : errors_) error = nullptr;
  working_.store(size() - 1, std::memory_order_relaxed);
  task_number_.fetch_add(1, std::memory_order_release);
  task_number_.notify_all();
  call_one(0);
  if (!spin_until([&] { return working_.load(std::memory_order_acquire) == 0; }))
    for (std::int32_t left = working_.load(std::memory_order_acquire); left != 0;
         left = working_.load(std::memory_order_acquire))
      working_.wait(left, std::memory_order_acquire);
  for (const std::exception_ptr& error : errors_)
    if (error) std::rethrow_exception(error);
}

}  // namespace lockstep
