#include "protocol/loopback_channel.hpp"

#include <atomic>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>

#include "common/checks.hpp"

namespace lockstep::protocol {
namespace {

using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

constexpr auto spin_time = 50us;  // as over TCP

// One direction.
struct Queue {
  std::deque<std::vector<std::byte>> frames;
  std::vector<std::vector<std::byte>> spare;  // memory of frames that have been taken
  std::atomic<std::size_t> size = 0;          // of frames, for a reader that spins
};

struct Wire {
  std::mutex mutex;
  std::condition_variable changed;
  Queue queue[2];
  std::atomic<bool> is_closed = false;
};

class LoopbackChannel : public Channel {
 public:
  LoopbackChannel(std::shared_ptr<Wire> wire, int side) : wire_(std::move(wire)), side_(side) {}
  ~LoopbackChannel() override { close(); }

  void send(std::span<const std::byte> frame) override {
    {
      std::lock_guard lock(wire_->mutex);
      if (wire_->is_closed)
        throw PeerError(fmt::format("cannot send {} to {}: the connection is closed", name_of(type_of(frame)), peer()));
      Queue& queue = wire_->queue[side_];
      std::vector<std::byte> memory;
      if (!queue.spare.empty()) {
        memory.swap(queue.spare.back());
        queue.spare.pop_back();
      }
      memory.assign(frame.begin(), frame.end());
      queue.frames.push_back(std::move(memory));
      queue.size = queue.frames.size();
    }
    wire_->changed.notify_all();
  }

  bool receive(std::vector<std::byte>& frame, Deadline deadline) override {
    if (is_closed_) throw PeerError(fmt::format("the connection to {} is closed", peer()));
    Queue& queue = wire_->queue[1 - side_];
    const Clock::time_point begin = Clock::now();
    while (queue.size == 0 && !wire_->is_closed) {
      const Clock::time_point now = Clock::now();
      if (now >= deadline) return false;
      if (now > begin + spin_time) break;
      std::this_thread::yield();
    }
    std::unique_lock lock(wire_->mutex);
    if (!wire_->changed.wait_until(lock, deadline, [&] { return !queue.frames.empty() || wire_->is_closed; }))
      return false;
    if (queue.frames.empty()) throw PeerError(fmt::format("{} closed the connection", peer()));
    frame.swap(queue.frames.front());
    queue.spare.push_back(std::move(queue.frames.front()));
    queue.frames.pop_front();
    queue.size = queue.frames.size();
    lock.unlock();
    if (frame.size() < header_size)
      throw PeerError(fmt::format("{}: truncated after {} of {} bytes of a header", peer(), frame.size(), header_size));
    check_payload(read_header(std::span(frame).first(header_size), limits_), payload_of(frame));
    return true;
  }

  std::string peer() const override { return side_ == 0 ? "loopback:1" : "loopback:0"; }

  void close() override {
    is_closed_ = true;
    {
      std::lock_guard lock(wire_->mutex);
      wire_->is_closed = true;
    }
    wire_->changed.notify_all();
  }

 private:
  std::shared_ptr<Wire> wire_;
  int side_;
  bool is_closed_ = false;  // by this side
};

}  // namespace

std::pair<std::unique_ptr<Channel>, std::unique_ptr<Channel>> make_loopback() {
  auto wire = std::make_shared<Wire>();
  return {std::make_unique<LoopbackChannel>(wire, 0), std::make_unique<LoopbackChannel>(wire, 1)};
}

}  // namespace lockstep::protocol
