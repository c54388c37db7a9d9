// The channels alone: whole frames over TCP and in memory, and what a broken peer can do to them.
#include <netinet/in.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <cstring>
#include <thread>

#include "common/checks.hpp"
#include "common/interrupt.hpp"
#include "protocol/codec.hpp"
#include "tests/protocol/session_fixture.hpp"

using namespace lockstep;
using namespace lockstep::protocol;
using Catch::Matchers::Contains;

namespace {

std::vector<std::byte> frame_of(const Message& message) {
  std::vector<std::byte> frame;
  Codec().encode(message, frame);
  return frame;
}

// A foreign program: a plain socket that connects to the listener.
struct Stranger {
  explicit Stranger(std::uint16_t port) : socket(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    REQUIRE(::connect(socket, reinterpret_cast<sockaddr*>(&address), sizeof address) == 0);
  }
  ~Stranger() { hang_up(); }
  void say(std::span<const std::byte> bytes) {
    REQUIRE(::send(socket, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size()));
  }
  void say(std::string_view text) { say(std::as_bytes(std::span(text.data(), text.size()))); }
  void hang_up() {
    if (socket >= 0) ::close(socket);
    socket = -1;
  }
  int socket;
};

double thread_cpu_seconds() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

ChannelPair make_pair_of(bool is_tcp) { return is_tcp ? make_tcp_pair() : make_loopback(); }

}  // namespace

TEST_CASE("frames arrive whole, in order and with the same bits, both ways") {
  const bool is_tcp = GENERATE(true, false);
  CAPTURE(is_tcp);
  auto [client, server] = make_pair_of(is_tcp);
  client->limit_frames(limits_before_mesh());
  server->limit_frames(limits_before_mesh());
  // The large one (5 MB) exceeds every socket buffer, so that both ends meet partial sends and reads.
  const std::vector<std::vector<std::byte>> frames = {frame_of(Finish{}), frame_of(flat_interface(200, 150)),
                                                      frame_of(Progress{"x", 0.5}), frame_of(flat_interface(1, 1))};
  std::thread echo([&server = server] {
    std::vector<std::byte> frame;
    for (int i = 0; i < 4; ++i) {
      if (!server->receive(frame, within(60))) return;
      server->send(frame);
    }
  });
  std::vector<std::byte> frame;
  for (const std::vector<std::byte>& sent : frames) {
    client->send(sent);
    REQUIRE(client->receive(frame, within(60)));
    CHECK(frame == sent);
  }
  echo.join();
}

TEST_CASE("several frames in one read are told apart") {
  auto [client, server] = make_tcp_pair();
  for (std::uint64_t i = 0; i < 100; ++i) client->send(frame_of(Finish{i, "x"}));
  std::vector<std::byte> frame;
  for (std::uint64_t i = 0; i < 100; ++i) {
    REQUIRE(server->receive(frame, within(60)));
    REQUIRE(std::get<Finish>(Codec().decode(frame)).step == i);
  }
}

TEST_CASE("a deadline that passes is false, and the channel goes on") {
  const bool is_tcp = GENERATE(true, false);
  CAPTURE(is_tcp);
  auto [client, server] = make_pair_of(is_tcp);
  std::vector<std::byte> frame;
  CHECK_FALSE(server->receive(frame, within(0)));
  CHECK_FALSE(server->receive(frame, within(0.05)));
  client->send(frame_of(Finish{7, ""}));
  REQUIRE(server->receive(frame, within(60)));
  CHECK(std::get<Finish>(Codec().decode(frame)).step == 7);
}

TEST_CASE("a message that was sent before the connection closed is still read, then the close is an error") {
  const bool is_tcp = GENERATE(true, false);
  CAPTURE(is_tcp);
  auto [client, server] = make_pair_of(is_tcp);
  client->send(frame_of(Abort{4, "last words"}));
  client->close();
  CHECK_THROWS_AS(client->send(frame_of(Finish{})), PeerError);
  std::vector<std::byte> frame;
  CHECK_THROWS_AS(client->receive(frame, within(60)), PeerError);
  REQUIRE(server->receive(frame, within(60)));
  CHECK(std::get<Abort>(Codec().decode(frame)).reason == "last words");
  // Far from the deadline: a closed connection is told at once instead of being polled till then.
  CHECK_THROWS_WITH(server->receive(frame, within(3600)), Contains("closed the connection"));
}

TEST_CASE("a frame cut short anywhere is never taken for whole") {
  TcpListener listener;
  const std::vector<std::byte> whole = frame_of(Progress{"settling the packing", 0.25});
  std::vector<std::byte> frame;
  for (std::size_t cut = 0; cut < whole.size(); ++cut) {
    CAPTURE(cut, whole.size());
    Stranger stranger(listener.port());
    auto server = listener.accept(within(60));
    stranger.say(std::span(whole).first(cut));
    stranger.hang_up();
    const std::string expected = cut == 0            ? "closed the connection"
                                 : cut < header_size ? fmt::format("truncated after {} of 16 bytes of its header", cut)
                                                     : fmt::format("truncated Progress, {} of {} bytes",
                                                                   cut - header_size, whole.size() - header_size);
    REQUIRE_THROWS_WITH(server->receive(frame, within(60)), Contains(expected));
  }
}

TEST_CASE("a peer that hangs within a message meets the deadline") {
  TcpListener listener;
  const std::vector<std::byte> whole = frame_of(Progress{"settling the packing", 0.25});
  Stranger stranger(listener.port());
  auto server = listener.accept(within(60));
  stranger.say(std::span(whole).first(20));
  std::vector<std::byte> frame;
  CHECK_FALSE(server->receive(frame, within(0.05)));
  stranger.say(std::span(whole).subspan(20));
  REQUIRE(server->receive(frame, within(60)));
  CHECK(frame == whole);
}

TEST_CASE("a foreign program, a damaged frame and a huge length are errors in words") {
  TcpListener listener;
  Stranger stranger(listener.port());
  auto server = listener.accept(within(60));
  std::vector<std::byte> frame = frame_of(Progress{"settling", 0.25});
  SECTION("another protocol") {
    stranger.say("GET / HTTP/1.1\r\n\r\n");
    CHECK_THROWS_WITH(server->receive(frame, within(60)), Contains("not a Lockstep peer: first bytes \"GET / HTTP"));
  }
  SECTION("a greeting shorter than a header, and then silence") {
    stranger.say("hi\n");
    CHECK_THROWS_WITH(server->receive(frame, within(60)), Contains("not a Lockstep peer: first bytes \"hi\\x0a\""));
  }
  SECTION("damage") {
    frame.back() ^= std::byte{1};
    stranger.say(frame);
    CHECK_THROWS_WITH(server->receive(frame, within(60)), Contains("arrived damaged"));
  }
  SECTION("4 GiB announced") {
    std::fill(frame.begin() + 8, frame.begin() + 12, std::byte{0xff});
    stranger.say(frame);
    CHECK_THROWS_WITH(server->receive(frame, within(60)), Contains("Progress of 4294967295 bytes where at most 65536"));
  }
}

TEST_CASE("waiting costs little processor time") {
  auto [client, server] = make_tcp_pair();
  std::vector<std::byte> frame;
  const double before = thread_cpu_seconds();
  CHECK_FALSE(server->receive(frame, within(0.5)));
  const double used = thread_cpu_seconds() - before;
  INFO(used << " s of processor time in a wait of 0.5 s");
  CHECK(used < 0.05);
}

TEST_CASE("a peer that stops reading is an error, not a wait for ever") {
  auto [client, server] = make_tcp_pair();
  client->set_send_timeout(std::chrono::milliseconds(200));
  const std::vector<std::byte> frame = frame_of(flat_interface(300, 300));  // 20 MB
  CHECK_THROWS_WITH(client->send(frame), Contains("has not read for 0.2 s") && Contains("of InitialStress sent"));
}

TEST_CASE("sending to a peer that is gone is an error and does not kill the process") {
  auto [client, server] = make_tcp_pair();
  server.reset();
  const std::vector<std::byte> frame = frame_of(flat_interface(20, 20));
  const auto send_till_error = [&client = client, &frame] {
    for (int i = 0; i < 1000; ++i) client->send(frame);
  };
  CHECK_THROWS_WITH(send_till_error(), Contains("cannot send InitialStress to 127.0.0.1:"));
}

TEST_CASE("nobody listening is an error with host, port and remedy when the deadline passes") {
  std::uint16_t port = 0;
  {
    TcpListener listener;
    port = listener.port();
  }
  CHECK_THROWS_WITH(connect_tcp("127.0.0.1", port, within(0.2)),
                    Contains(fmt::format("no peer answers at 127.0.0.1:{}", port)) && Contains("Connection refused") &&
                        Contains("start dem_server first"));
  CHECK_THROWS_AS(connect_tcp("no-such-host.invalid", 1, within(0.2)), InputError);
}

TEST_CASE("a client may start before its server") {
  std::uint16_t port = 0;
  {
    TcpListener listener;
    port = listener.port();
  }
  std::unique_ptr<Channel> client;
  std::thread connecting([&] { client = connect_tcp("127.0.0.1", port, within(60)); });
  std::this_thread::sleep_for(std::chrono::milliseconds(120));
  TcpListener listener("127.0.0.1", port);
  auto server = listener.accept(within(60));
  connecting.join();
  client->send(frame_of(Finish{3, ""}));
  std::vector<std::byte> frame;
  CHECK(server->receive(frame, within(60)));
}

TEST_CASE("a listener says what is wrong: nobody comes, port taken, no address") {
  TcpListener listener;
  CHECK(listener.address() == "127.0.0.1");
  CHECK(listener.port() != 0);
  CHECK_THROWS_WITH(listener.accept(within(0.1)),
                    Contains(fmt::format("no peer has connected to 127.0.0.1:{}", listener.port())));
  CHECK_THROWS_AS(TcpListener("127.0.0.1", listener.port()), IoError);
  CHECK_THROWS_WITH(
      TcpListener("127.0.0.1", listener.port()),
      Contains(fmt::format("127.0.0.1:{}: Address already in use; choose another port", listener.port())));
  CHECK_THROWS_AS(TcpListener("localhost!", 0), InputError);
}

TEST_CASE("the user can stop a wait for the peer") {
  TcpListener listener;
  interrupt_requested() = true;
  CHECK_THROWS_AS(listener.accept(within(3600)), Interrupted);
  interrupt_requested() = false;
}
