// Threads that do the same thing to different parts, again and again.
//
// run(task) calls task(0) .. task(size() - 1), each on its own thread, task(0) on the caller's, and returns when all are
// done. What a thread works on is the caller's affair; bits must not depend on size(): each sum stays with one thread,
// or is made of parts whose borders do not depend on the number of threads.
//
// Waiting threads spin for some microseconds, since the next task of a time step is that near, then sleep in the kernel:
// a spinning thread on a core that another process needs costs a whole time slice.
#pragma once
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <thread>
#include <utility>
#include <vector>

namespace lockstep {

// The part of `count` things that is a thread's: [first, second), in the order of threads.
template <class Count>
std::pair<Count, Count> share_of(Count count, int thread, int threads) {
  const auto border = [&](int t) {
    return static_cast<Count>(static_cast<std::int64_t>(count) * t / static_cast<std::int64_t>(threads));
  };
  return {border(thread), border(thread + 1)};
}

class Team {
 public:
  // InputError for a number outside [1, 256].
  explicit Team(int threads = 1);
  ~Team();
  Team(const Team&) = delete;
  Team& operator=(const Team&) = delete;

  int size() const { return static_cast<int>(errors_.size()); }

  // An exception of a task is thrown here, when all have ended: that of the lowest thread.
  template <class Task>
  void run(Task&& task) {
    if (size() == 1) {
      task(0);
      return;
    }
    auto call = [](void* object, int thread) { (*static_cast<std::remove_reference_t<Task>*>(object))(thread); };
    run_all(call, const_cast<void*>(static_cast<const void*>(&task)));
  }

  // task(0) .. task(parts - 1), each once. A thread begins with its own share, whose data its core still has from the last
  // call, and then takes what others have not begun: one that another process keeps from its core leaves more to the
  // others instead of holding them up.
  template <class Task>
  void run_parts(int parts, Task&& task) {
    if (size() == 1) {
      for (int part = 0; part < parts; ++part) task(part);
      return;
    }
    std::vector<std::atomic<bool>> is_taken(static_cast<std::size_t>(parts));
    run([&](int thread) {
      const int first = parts * thread / size();
      for (int k = 0; k < parts; ++k) {
        const int part = (first + k) % parts;
        if (!is_taken[static_cast<std::size_t>(part)].exchange(true, std::memory_order_relaxed)) task(part);
      }
    });
  }

  // A team of the calling thread alone.
  static Team& alone();

 private:
  using Call = void (*)(void* object, int thread);
  void run_all(Call call, void* object);
  void work(int thread);
  void call_one(int thread);

  Call call_ = nullptr;
  void* object_ = nullptr;
  bool is_ending_ = false;
  std::vector<std::exception_ptr> errors_;  // one a thread
  alignas(64) std::atomic<std::uint32_t> task_number_ = 0;
  alignas(64) std::atomic<std::int32_t> working_ = 0;
  std::vector<std::thread> threads_;  // one fewer than size()
};

}  // namespace lockstep
