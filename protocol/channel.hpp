// A channel carries whole frames between the two sides. TCP (tcp_channel.hpp) and in-memory (loopback_channel.hpp).
#pragma once
#include <chrono>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "protocol/framing.hpp"

namespace lockstep::protocol {

using Deadline = std::chrono::steady_clock::time_point;

class Channel {
 public:
  virtual ~Channel() = default;

  // Sends one frame, header included, as one write. Throws PeerError when the peer is gone.
  virtual void send(std::span<const std::byte> frame) = 0;

  // Waits for one whole frame (header included) and puts it into `frame`, whose memory is reused. Spins briefly, then
  // blocks. Returns false when the deadline passes first; throws PeerError on a closed or garbled connection.
  virtual bool receive(std::vector<std::byte>& frame, Deadline deadline) = 0;

  // For messages: "127.0.0.1:40123".
  virtual std::string peer() const = 0;

  // After this, send and receive fail on both sides.
  virtual void close() = 0;

  // Largest payload of each kind of message that receive() takes; checked when the header is there and before memory is
  // taken.
  void limit_frames(const FrameLimits& limits) { limits_ = limits; }

  // Longest time that send() waits for a peer that has stopped reading; then it throws PeerError.
  void set_send_timeout(std::chrono::milliseconds timeout) { send_timeout_ = timeout; }

 protected:
  FrameLimits limits_ = limits_before_hello();
  std::chrono::milliseconds send_timeout_{60'000};
};

}  // namespace lockstep::protocol
