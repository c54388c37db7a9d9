// asio headers of Boost 1.74 use std::exchange without including <utility>.
#include <utility>

#include "protocol/tcp_channel.hpp"

#include <poll.h>

#include <algorithm>
#include <boost/asio/connect.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <cstring>
#include <thread>

#include "common/checks.hpp"
#include "common/interrupt.hpp"

namespace lockstep::protocol {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using boost::system::error_code;
using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

constexpr auto spin_time = 200us;  // with 50 us some exchanges slept and cost 53 us instead of 34
constexpr auto spin_before_yield = 10us;
constexpr auto connect_pause = 50ms;     // between two tries
constexpr auto interrupt_slice = 100ms;  // longest sleep that does not look at interrupt_requested()
constexpr std::size_t initial_inbox = std::size_t{64} << 10;  // [bytes]

// Sleeps until the socket is ready for `events` or the deadline passes; false in the second case.
bool wait_ready(int descriptor, short events, Deadline deadline) {
  for (;;) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now()).count();
    pollfd entry{descriptor, events, 0};
    const int ready = ::poll(&entry, 1, static_cast<int>(std::clamp<long>(left, 0, 1'000'000)));
    if (ready > 0) return true;
    if (ready < 0 && errno != EINTR) throw IoError(fmt::format("cannot wait on a socket: {}", std::strerror(errno)));
    if (Clock::now() >= deadline) return false;
  }
}

// The same for the waits in which the user may ask to stop.
bool wait_ready_or_interrupt(int descriptor, short events, Deadline deadline, const std::string& what) {
  for (;;) {
    if (interrupt_requested()) throw Interrupted("interrupted while " + what);
    if (wait_ready(descriptor, events, std::min<Deadline>(deadline, Clock::now() + interrupt_slice))) return true;
    if (Clock::now() >= deadline) return false;
  }
}

double seconds_since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

std::string name_of(const tcp::endpoint& endpoint) {
  const std::string address = endpoint.address().to_string();
  return endpoint.address().is_v6() ? fmt::format("[{}]:{}", address, endpoint.port())
                                    : fmt::format("{}:{}", address, endpoint.port());
}

class TcpChannel : public Channel {
 public:
  TcpChannel(std::unique_ptr<asio::io_context> context, tcp::socket socket)
      : context_(std::move(context)), socket_(std::move(socket)), inbox_(initial_inbox) {
    error_code error;
    const tcp::endpoint remote = socket_.remote_endpoint(error);
    peer_ = error ? std::string("unknown address") : name_of(remote);
    socket_.set_option(tcp::no_delay(true), error);
    socket_.non_blocking(true);
  }

  ~TcpChannel() override { close(); }

  void send(std::span<const std::byte> frame) override {
    if (!socket_.is_open()) throw PeerError(fmt::format("the connection to {} is closed", peer_));
    const Deadline deadline = Clock::now() + send_timeout_;
    std::size_t sent = 0;
    while (sent < frame.size()) {
      error_code error;
      // asio passes MSG_NOSIGNAL: a peer that is gone is an error code here and never a SIGPIPE.
      sent += socket_.send(asio::buffer(frame.data() + sent, frame.size() - sent), 0, error);
      if (error == asio::error::would_block || error == asio::error::try_again) {
        if (!wait_ready(socket_.native_handle(), POLLOUT, deadline))
          throw PeerError(fmt::format("{} has not read for {:.1f} s: {} of {} bytes of {} sent", peer_,
                                      std::chrono::duration<double>(send_timeout_).count(), sent, frame.size(),
                                      protocol::name_of(type_of(frame))));
      } else if (error && error != asio::error::interrupted) {
        throw PeerError(
            fmt::format("cannot send {} to {}: {}", protocol::name_of(type_of(frame)), peer_, error.message()));
      }
    }
  }

  bool receive(std::vector<std::byte>& frame, Deadline deadline) override {
    if (!socket_.is_open()) throw PeerError(fmt::format("the connection to {} is closed", peer_));
    if (take_frame(frame)) return true;
    const Clock::time_point begin = Clock::now();
    for (;;) {
      if (read_some()) {
        if (take_frame(frame)) return true;
        continue;
      }
      const Clock::time_point now = Clock::now();
      if (now >= deadline) return false;
      if (now < begin + spin_time) {
        if (now > begin + spin_before_yield) std::this_thread::yield();
      } else {
        wait_ready(socket_.native_handle(), POLLIN, deadline);
      }
    }
  }

  std::string peer() const override { return peer_; }

  void close() override {
    if (!socket_.is_open()) return;
    error_code ignored;
    socket_.shutdown(tcp::socket::shutdown_send, ignored);
    // A socket closed over unread bytes resets the connection, which may overtake this side's last words.
    for (error_code error; socket_.receive(asio::buffer(inbox_), 0, error) > 0 && !error;) {
    }
    socket_.close(ignored);
  }

 private:
  // Reads what is there; false if nothing is. PeerError when the connection has ended.
  bool read_some() {
    error_code error;
    const std::size_t count = socket_.receive(asio::buffer(inbox_.data() + filled_, inbox_.size() - filled_), 0, error);
    if (error == asio::error::would_block || error == asio::error::try_again || error == asio::error::interrupted)
      return false;
    if (error) throw PeerError(ending(error == asio::error::eof ? "closed the connection" : error.message()));
    filled_ += count;
    return true;
  }

  // Moves the first frame out of the inbox if it is whole.
  bool take_frame(std::vector<std::byte>& frame) {
    check_magic(std::span(inbox_).first(filled_));
    if (filled_ < header_size) return false;
    const FrameHeader header = read_header(std::span(inbox_).first(header_size), limits_);
    const std::size_t size = header_size + header.payload_size;
    if (filled_ < size) {
      if (inbox_.size() < size) inbox_.resize(size);
      return false;
    }
    check_payload(header, std::span(inbox_).subspan(header_size, header.payload_size));
    frame.assign(inbox_.begin(), inbox_.begin() + static_cast<std::ptrdiff_t>(size));
    std::memmove(inbox_.data(), inbox_.data() + size, filled_ - size);
    filled_ -= size;
    return true;
  }

  // How the connection ended, and what was under way.
  std::string ending(const std::string& how) const {
    if (filled_ == 0) return fmt::format("{} {}", peer_, how);
    if (filled_ < header_size)
      return fmt::format("{} {} within a message: truncated after {} of {} bytes of its header", peer_, how, filled_,
                         header_size);
    const FrameHeader header = read_header(std::span(inbox_).first(header_size), limits_);
    return fmt::format("{} {} within a message: truncated {}, {} of {} bytes", peer_, how,
                       protocol::name_of(header.type), filled_ - header_size, header.payload_size);
  }

  std::unique_ptr<asio::io_context> context_;  // outlives the socket
  tcp::socket socket_;
  std::string peer_;
  std::vector<std::byte> inbox_;  // bytes of frames not yet taken, from the front
  std::size_t filled_ = 0;        // of inbox_ [bytes]
};

}  // namespace

struct TcpListener::Impl {
  asio::io_context context;
  tcp::acceptor acceptor{context};
};

TcpListener::TcpListener(const std::string& address, std::uint16_t port) : impl_(std::make_unique<Impl>()) {
  error_code error;
  const asio::ip::address parsed = asio::ip::make_address(address, error);
  if (error)
    throw InputError(
        fmt::format("cannot listen on \"{}\": not an IP address; give 127.0.0.1 for this machine alone", address));
  const tcp::endpoint endpoint(parsed, port);
  impl_->acceptor.open(endpoint.protocol(), error);
  if (!error) impl_->acceptor.set_option(tcp::acceptor::reuse_address(true), error);
  if (!error) impl_->acceptor.bind(endpoint, error);
  if (!error) impl_->acceptor.listen(tcp::acceptor::max_listen_connections, error);
  if (error)
    throw IoError(fmt::format("cannot listen on {}: {}; choose another port, or port 0 for a free one",
                              name_of(endpoint), error.message()));
  impl_->acceptor.non_blocking(true);
}

TcpListener::~TcpListener() = default;

std::uint16_t TcpListener::port() const { return impl_->acceptor.local_endpoint().port(); }
std::string TcpListener::address() const { return impl_->acceptor.local_endpoint().address().to_string(); }

std::unique_ptr<Channel> TcpListener::accept(Deadline deadline) {
  const Clock::time_point begin = Clock::now();
  const std::string here = name_of(impl_->acceptor.local_endpoint());
  for (;;) {
    if (!wait_ready_or_interrupt(impl_->acceptor.native_handle(), POLLIN, deadline, "waiting for a peer on " + here))
      throw PeerError(
          fmt::format("no peer has connected to {} within {:.1f} s; start the continuum client with this port, or "
                      "raise coupling.connect_timeout",
                      here, seconds_since(begin)));
    auto context = std::make_unique<asio::io_context>();
    tcp::socket socket(*context);
    error_code error;
    impl_->acceptor.accept(socket, error);
    if (!error) return std::make_unique<TcpChannel>(std::move(context), std::move(socket));
    // A client that left the queue before it was served leaves nothing to accept.
    if (error != asio::error::would_block && error != asio::error::try_again &&
        error != asio::error::connection_aborted)
      throw IoError(fmt::format("cannot accept a connection on {}: {}", here, error.message()));
  }
}

std::unique_ptr<Channel> connect_tcp(const std::string& host, std::uint16_t port, Deadline deadline) {
  const Clock::time_point begin = Clock::now();
  const std::string what = fmt::format("connecting to {}:{}", host, port);
  auto context = std::make_unique<asio::io_context>();
  error_code error;
  const auto endpoints = tcp::resolver(*context).resolve(host, std::to_string(port), error);
  if (error)
    throw InputError(
        fmt::format("cannot resolve host \"{}\": {}; check its name, or give its IP address", host, error.message()));
  for (;;) {
    for (const auto& entry : endpoints) {
      tcp::socket socket(*context);
      socket.open(entry.endpoint().protocol(), error);
      if (error) continue;
      socket.non_blocking(true);
      socket.connect(entry.endpoint(), error);
      if (error == asio::error::in_progress || error == asio::error::would_block) {
        if (!wait_ready_or_interrupt(socket.native_handle(), POLLOUT, deadline, what)) break;
        int reason = 0;
        socklen_t size = sizeof reason;
        ::getsockopt(socket.native_handle(), SOL_SOCKET, SO_ERROR, &reason, &size);
        error = error_code(reason, boost::system::system_category());
      }
      if (error) continue;
      // A port of this machine that nobody listens on may, as this socket's own, connect to itself.
      if (socket.local_endpoint() == socket.remote_endpoint()) {
        error = asio::error::connection_refused;
        continue;
      }
      return std::make_unique<TcpChannel>(std::move(context), std::move(socket));
    }
    if (interrupt_requested()) throw Interrupted("interrupted while " + what);
    if (Clock::now() + connect_pause >= deadline) break;
    std::this_thread::sleep_for(connect_pause);
  }
  throw PeerError(
      fmt::format("no peer answers at {}:{} after {:.1f} s ({}); start dem_server first, check host and port, or "
                  "raise coupling.connect_timeout",
                  host, port, seconds_since(begin), error.message()));
}

}  // namespace lockstep::protocol
