// Frames over TCP. The grains listen, the continuum connects.
//
// A frame is one write on a socket with TCP_NODELAY. A waiter tries to read for 200 us before it sleeps, since waking an
// idle virtual core costs 60 to 90 us and the answer is usually there sooner; after the first 10 us it yields between
// tries, so that on a machine with more work than cores the peer gets the core that it needs to answer.
#pragma once
#include <cstdint>
#include <memory>
#include <string>

#include "protocol/channel.hpp"

namespace lockstep::protocol {

class TcpListener {
 public:
  // Listens from here on; port 0 takes a free one. Only this machine can connect unless another address is given
  // ("0.0.0.0" is every interface: the protocol has no passwords). IoError with address, port and remedy if it cannot.
  explicit TcpListener(const std::string& address = "127.0.0.1", std::uint16_t port = 0);
  ~TcpListener();

  std::uint16_t port() const;
  std::string address() const;

  // Waits for one peer. PeerError if none comes before the deadline; Interrupted when the user asks to stop. Destroy
  // the listener afterwards: then a second client is refused at once instead of waiting in the queue.
  std::unique_ptr<Channel> accept(Deadline deadline);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Connects, trying again until the deadline while nobody listens. PeerError with host, port, seconds and remedy when it
// passes; InputError if the host's name cannot be resolved; Interrupted when the user asks to stop.
std::unique_ptr<Channel> connect_tcp(const std::string& host, std::uint16_t port, Deadline deadline);

}  // namespace lockstep::protocol
