// Whole sessions, over TCP and in memory, between honest sides and against peers that lie, fall silent or die.
#include "protocol/session.hpp"

#include <catch2/catch.hpp>
#include <exception>
#include <thread>

#include "common/interrupt.hpp"
#include "protocol/codec.hpp"
#include "tests/protocol/allocation_count.hpp"
#include "tests/protocol/session_fixture.hpp"

using namespace lockstep;
using namespace lockstep::protocol;
using namespace std::chrono_literals;
using Catch::Matchers::Contains;

namespace {

// The other side of a test, on its own thread; rethrows at join() what it threw.
class Peer {
 public:
  template <class Action>
  explicit Peer(Action action)
      : thread_([this, action = std::move(action)]() mutable {
          try {
            action();
          } catch (...) {
            error_ = std::current_exception();
          }
        }) {}
  ~Peer() {
    if (thread_.joinable()) thread_.join();
  }
  void join() {
    thread_.join();
    if (error_) std::rethrow_exception(error_);
  }

 private:
  std::exception_ptr error_;
  std::thread thread_;
};

// A peer that says whatever it is told to, without a session's checks.
class Liar {
 public:
  explicit Liar(std::unique_ptr<Channel> channel) : channel_(std::move(channel)) {
    channel_->limit_frames(limits_before_mesh());
  }
  void say(const Message& message) {
    std::vector<std::byte> frame;
    codec_.encode(message, frame);
    channel_->send(frame);
  }
  Message hear() {
    std::vector<std::byte> frame;
    if (!channel_->receive(frame, within(60))) throw std::runtime_error("nothing to hear");
    return codec_.decode(frame);
  }
  // Through the opening as the continuum of `initial`.
  void open_as_continuum(const InitialStress& initial) {
    say(hello_of(Role::Continuum));
    hear();
    say(initial);
    hear();
    say(ContinuumExcavated{});
    hear();
  }
  void hang_up() { channel_->close(); }

 private:
  std::unique_ptr<Channel> channel_;
  Codec codec_;
};

Velocities velocities_of(std::uint64_t step, std::size_t nodes, Stage stage = Stage::Penetrate) {
  Velocities v;
  v.step = step;
  v.stage = stage;
  v.time_step = 1e-5;
  v.velocity.assign(nodes, Vec3(0.1, 0, 1e-3 * static_cast<double>(step)));
  return v;
}

Forces forces_of(std::uint64_t step, std::size_t nodes) {
  Forces f;
  f.step = step;
  f.force.assign(nodes, Vec3(0, 0, -1));
  return f;
}

}  // namespace

TEST_CASE("a whole session runs from Hello to Finish with every message") {
  const bool is_tcp = GENERATE(true, false);
  CAPTURE(is_tcp);
  auto [client_end, server_end] = is_tcp ? make_tcp_pair() : make_loopback();
  Peer grains([end = std::move(server_end)]() mutable {
    Session session(std::move(end), Role::Grains, {});
    session.shake_hands(hello_of(Role::Grains));
    const InitialStress initial = session.receive<InitialStress>();
    for (int i = 0; i < 3; ++i) session.send(Progress{"settling", 0.1 * i});
    session.send(Balance{initial.traction, 0.37, 1e-4, 10, 30});
    session.receive<ContinuumExcavated>();
    GrainsExcavated excavated;
    excavated.offset.assign(session.node_count(), Vec3::Zero());
    excavated.node_stiffness.assign(session.node_count(), 1);
    excavated.nodal_force.assign(session.node_count(), Vec3::Zero());
    session.send(excavated);
    Velocities v;
    for (std::uint64_t n = 0; n < 4; ++n) {
      if (!session.receive_or_finish(v)) throw std::runtime_error("finished early");
      if (session.stage() != v.stage) throw std::runtime_error("the stage does not follow the field");
      session.send(forces_of(v.step, session.node_count()));
    }
    session.send(CheckpointCommit{session.receive<CheckpointRequest>().step, 99});
    if (session.receive_or_finish(v)) throw std::runtime_error("Finish taken for Velocities");
    session.send(Finish{session.finish().step, "agreed"});
  });

  Session session(std::move(client_end), Role::Continuum, {});
  int progress = 0;
  session.on_progress = [&](const Progress& p) { progress += p.text == "settling"; };
  CHECK(session.shake_hands(hello_of(Role::Continuum)).solver == "test_grains");
  CHECK(session.stage() == Stage::InitialStress);
  const InitialStress initial = flat_interface(3, 2);
  session.send(initial);
  CHECK(session.node_count() == 12);
  CHECK(session.facet_count() == 6);
  CHECK(session.receive<Balance>().particles == 10);
  CHECK(progress == 3);
  CHECK(session.stage() == Stage::Excavate);
  session.send(ContinuumExcavated{});
  CHECK(session.receive<GrainsExcavated>().offset.size() == 12);
  CHECK(session.stage() == Stage::Apply);
  Forces forces;
  for (std::uint64_t n = 0; n < 4; ++n) {
    session.send(velocities_of(n, 12, n < 2 ? Stage::Apply : Stage::Penetrate));
    session.receive(forces);
    CHECK(forces.step == n);
  }
  CHECK(session.stage() == Stage::Penetrate);
  session.send(CheckpointRequest{4, "here"});
  CHECK(session.receive<CheckpointCommit>().state_hash == 99);
  session.send(Finish{4, "done"});
  CHECK(session.receive<Finish>().text == "agreed");
  CHECK(session.stage() == Stage::Finished);
  CHECK_THAT(session.peer(), Contains("the grains (test_grains 0.1)"));
  CHECK(session.bytes_sent() > 4 * 12 * 24);
  CHECK(session.bytes_received() > 4 * 12 * 24);
  grains.join();
}

TEST_CASE("an exchange takes no memory after the first, sockets included") {
  auto [client_end, server_end] = make_tcp_pair();
  Peer grains([end = std::move(server_end)]() mutable {
    Session session(std::move(end), Role::Grains, {});
    const std::size_t nodes = open_as_grains(session).nodes.size();
    Velocities v;
    while (session.receive_or_finish(v)) session.send(forces_of(v.step, nodes));
    session.send(Finish{});
  });
  Session session(std::move(client_end), Role::Continuum, {});
  open_as_continuum(session, flat_interface(10, 10));
  Velocities velocities = velocities_of(0, 121);
  Forces forces;
  std::size_t before = 0;
  for (std::uint64_t n = 0; n < 20; ++n) {
    velocities.step = n;
    session.send(velocities);
    session.receive(forces);
    if (n == 0) before = allocation_count();
  }
  const std::size_t taken = allocation_count() - before;
  INFO(taken << " allocations in 19 exchanges");
  CHECK(taken == 0);
  session.send(Finish{20, ""});
  session.receive<Finish>();
  grains.join();
}

TEST_CASE("a Hello that does not fit is refused by both sides with both values") {
  Hello theirs = hello_of(Role::Continuum);
  std::string expected;
  SECTION("version") {
    theirs.major = 7, theirs.minor = 3;
    expected = fmt::format("protocol versions differ: {}.{} and 7.3", version_major, version_minor);
  }
  SECTION("role") {
    theirs.role = Role::Grains;
    expected = "both sides are the grains";
  }
  SECTION("scene") {
    theirs.scene_digest = "07ce1";
    expected = "the two sides read different scenes: digest 5ce7e and 07ce1";
  }
  SECTION("resume step") {
    theirs.resume_step = 40;
    expected = "the two sides resume at different steps: 0 and 40";
  }
  auto [client_end, server_end] = make_tcp_pair();
  Liar liar(std::move(client_end));
  liar.say(theirs);
  Session session(std::move(server_end), Role::Grains, {});
  CHECK_THROWS_WITH(session.shake_hands(hello_of(Role::Grains)), Contains(expected));
  CHECK(session.stage() == Stage::Aborted);
  const auto abort = std::get<Abort>(liar.hear());
  CHECK(abort.exit_code == 3);
  CHECK_THAT(abort.reason, Contains(expected));
}

TEST_CASE("two continuum clients refuse each other") {
  auto [one_end, other_end] = make_loopback();
  Peer other([end = std::move(other_end)]() mutable {
    Session session(std::move(end), Role::Continuum, {});
    session.shake_hands(hello_of(Role::Continuum));
  });
  Session session(std::move(one_end), Role::Continuum, {});
  CHECK_THROWS_WITH(session.shake_hands(hello_of(Role::Continuum)), Contains("both sides are the continuum"));
  CHECK_THROWS_WITH(other.join(), Contains("both sides are the continuum"));
}

TEST_CASE("a solver without scene files is accepted") {
  auto [client_end, server_end] = make_loopback();
  Peer other([end = std::move(client_end)]() mutable {
    Session session(std::move(end), Role::Continuum, {});
    Hello hello = hello_of(Role::Continuum);
    hello.scene_digest.clear();
    session.shake_hands(hello);
  });
  Session session(std::move(server_end), Role::Grains, {});
  CHECK_NOTHROW(session.shake_hands(hello_of(Role::Grains)));
  other.join();
}

TEST_CASE("what the grains must not accept is refused, told to the peer and names the fault") {
  auto [client_end, server_end] = make_tcp_pair();
  std::string heard;
  std::string expected;
  std::function<void(Liar&)> lie;
  SECTION("a step that repeats") {
    lie = [](Liar& liar) { liar.say(velocities_of(0, 12)); };
    expected = "Velocities.step = 0 where step 1 is due";
  }
  SECTION("a step left out") {
    lie = [](Liar& liar) { liar.say(velocities_of(2, 12)); };
    expected = "Velocities.step = 2 where step 1 is due";
  }
  SECTION("a node too few") {
    lie = [](Liar& liar) { liar.say(velocities_of(1, 11)); };
    expected = "Velocities.velocity has 11 entries for 12 nodes";
  }
  SECTION("a message too large for the mesh") {
    lie = [](Liar& liar) { liar.say(velocities_of(1, 120)); };
    expected = "where at most 1312 can be right";
  }
  SECTION("back to Apply") {
    lie = [](Liar& liar) { liar.say(velocities_of(1, 12, Stage::Apply)); };
    expected = "Velocities of stage Apply from the continuum out of turn in stage Penetrate";
  }
  SECTION("a message of the other side") {
    lie = [](Liar& liar) { liar.say(forces_of(1, 12)); };
    expected = "Forces from the continuum out of turn in stage Penetrate; due is Velocities";
  }
  SECTION("a checkpoint at another step") {
    lie = [](Liar& liar) { liar.say(CheckpointRequest{9, ""}); };
    expected = "CheckpointRequest where this side takes Velocities only";
  }
  Peer liar_thread([&, end = std::move(client_end)]() mutable {
    Liar liar(std::move(end));
    liar.open_as_continuum(flat_interface(3, 2));
    liar.say(velocities_of(0, 12));
    liar.hear();
    lie(liar);
    heard = std::get<Abort>(liar.hear()).reason;
  });
  Session session(std::move(server_end), Role::Grains, {});
  open_as_grains(session);
  Velocities v;
  REQUIRE(session.receive_or_finish(v));
  session.send(forces_of(0, 12));
  CHECK_THROWS_WITH(session.receive_or_finish(v), Contains(expected));
  liar_thread.join();
  CHECK_THAT(heard, Contains(expected));
}

TEST_CASE("this side's own mistakes are internal errors and do not reach the peer") {
  auto [client_end, server_end] = make_loopback();
  Session session(std::move(client_end), Role::Continuum, {});
  CHECK_THROWS_AS(session.send(Balance{}), InternalError);
  CHECK_THROWS_AS(session.send(velocities_of(0, 3)), InternalError);
  std::vector<std::byte> frame;
  CHECK_FALSE(server_end->receive(frame, within(0)));
}

TEST_CASE("a peer that says nothing is an error with stage, time and its last words") {
  auto [client_end, server_end] = make_tcp_pair();
  Liar liar(std::move(server_end));
  liar.say(hello_of(Role::Grains));
  liar.say(Progress{"settling 12 %", 0.12});
  SessionSettings settings;
  settings.peer_timeout = 150ms;
  Session session(std::move(client_end), Role::Continuum, settings);
  session.shake_hands(hello_of(Role::Continuum));
  session.send(flat_interface(2, 2));
  CHECK_THROWS_WITH(session.receive<Balance>(), Contains("no word from the grains") && Contains("test_grains") &&
                                                    Contains("in stage Balance, due: Balance from the grains") &&
                                                    Contains("Progress \"settling 12 %\"") &&
                                                    Contains("coupling.peer_timeout"));
  CHECK(session.seconds_waiting() > 0.1);
}

TEST_CASE("a slow peer lives as long as it sends Progress") {
  auto [client_end, server_end] = make_tcp_pair();
  SessionSettings settings;
  settings.peer_timeout = 1500ms;
  settings.progress_interval = 50ms;
  Peer grains([&, end = std::move(server_end)]() mutable {
    Session session(std::move(end), Role::Grains, settings);
    session.shake_hands(hello_of(Role::Grains));
    const InitialStress initial = session.receive<InitialStress>();
    const auto done = std::chrono::steady_clock::now() + 2000ms;
    while (std::chrono::steady_clock::now() < done) {
      session.heartbeat("settling", 0.5);
      std::this_thread::sleep_for(5ms);
    }
    session.send(Balance{initial.traction, 0, 0, 0, 0});
    session.receive<ContinuumExcavated>();
  });
  Session session(std::move(client_end), Role::Continuum, settings);
  int progress = 0;
  session.on_progress = [&](const Progress& p) { progress += p.text == "settling"; };
  session.shake_hands(hello_of(Role::Continuum));
  session.send(flat_interface(2, 2));
  CHECK_NOTHROW(session.receive<Balance>());
  CHECK(progress > 1);
  CHECK(progress <= 41);  // one an interval, though called ten times as often
  session.send(ContinuumExcavated{});
  grains.join();
}

TEST_CASE("the survivor reports the peer's reason and not a broken pipe") {
  auto [client_end, server_end] = make_tcp_pair();
  Session session(std::move(client_end), Role::Continuum, {});
  const std::int32_t code = GENERATE(1, 4);
  {
    Liar liar(std::move(server_end));
    liar.say(hello_of(Role::Grains));
    session.shake_hands(hello_of(Role::Continuum));
    liar.say(Abort{code, "particle 7 left the box"});
  }
  SECTION("while it waits") {
    session.send(flat_interface(2, 2));
    try {
      session.receive<Balance>();
      FAIL("no error");
    } catch (const PeerGaveUp& error) {
      CHECK(error.peer_exit_code == code);
      CHECK_THAT(error.what(), Contains("peer gave up: particle 7 left the box") && Contains("test_grains"));
    }
  }
  SECTION("while it sends") {
    // Writes succeed until the reset comes back; whichever write fails must say why.
    InitialStress initial = flat_interface(300, 300);
    CHECK_THROWS_WITH((session.send(initial), session.receive<Balance>()),
                      Contains("peer gave up: particle 7 left the box"));
  }
  SECTION("in a long stage") {
    const auto work = [&] {
      for (;;) session.heartbeat("cycling", 0.1);
    };
    CHECK_THROWS_WITH(work(), Contains("peer gave up: particle 7 left the box"));
  }
}

TEST_CASE("a peer that dies is told from its last words") {
  auto [client_end, server_end] = make_tcp_pair();
  Session session(std::move(client_end), Role::Continuum, {});
  {
    Liar liar(std::move(server_end));
    liar.say(hello_of(Role::Grains));
    session.shake_hands(hello_of(Role::Continuum));
  }
  CHECK_THROWS_WITH(session.receive<Balance>(), Contains("closed the connection") &&
                                                    Contains("in stage InitialStress") && Contains("its last words") &&
                                                    Contains("Hello"));
}

TEST_CASE("a message that heartbeat finds is kept for the next receive") {
  auto [client_end, server_end] = make_loopback();
  Liar liar(std::move(server_end));
  Session session(std::move(client_end), Role::Continuum, {});
  liar.say(hello_of(Role::Grains));
  session.shake_hands(hello_of(Role::Continuum));
  session.send(flat_interface(1, 1));
  liar.say(Progress{"a", 0});
  liar.say(Balance{{Vec3::Zero()}, 0.4, 0, 5, 6});
  for (int i = 0; i < 10; ++i) {
    session.heartbeat("waiting", 0);
    std::this_thread::sleep_for(10ms);
  }
  CHECK(session.receive<Balance>().particles == 5);
}

TEST_CASE("Ctrl-C ends a long stage, is told to the peer, and leaves an exchange whole") {
  auto [client_end, server_end] = make_loopback();
  Liar liar(std::move(client_end));
  Session session(std::move(server_end), Role::Grains, {});
  struct Cleared {
    ~Cleared() { interrupt_requested() = false; }
  } cleared;
  SECTION("waiting for a stage") {
    liar.say(hello_of(Role::Continuum));
    session.shake_hands(hello_of(Role::Grains));
    interrupt_requested() = true;
    CHECK_THROWS_AS(session.receive<InitialStress>(), Interrupted);
    liar.hear();
    CHECK(std::get<Abort>(liar.hear()).exit_code == 130);
  }
  SECTION("computing a stage") {
    liar.say(hello_of(Role::Continuum));
    session.shake_hands(hello_of(Role::Grains));
    interrupt_requested() = true;
    CHECK_THROWS_AS(session.heartbeat("settling", 0.5), Interrupted);
    liar.hear();
    CHECK(std::get<Abort>(liar.hear()).exit_code == 130);
  }
  SECTION("in the cycle") {
    Peer continuum([&] {
      liar.open_as_continuum(flat_interface(1, 1));
      liar.say(velocities_of(0, 4));
      liar.hear();
      liar.say(Finish{1, "interrupted"});
    });
    open_as_grains(session);
    interrupt_requested() = true;
    Velocities v;
    CHECK(session.receive_or_finish(v));
    session.send(forces_of(0, 4));
    CHECK_FALSE(session.receive_or_finish(v));
    continuum.join();
  }
  SECTION("the peer's user") {
    liar.say(hello_of(Role::Continuum));
    session.shake_hands(hello_of(Role::Grains));
    liar.say(Abort{130, "its user stopped it"});
    CHECK_THROWS_AS(session.receive<InitialStress>(), Interrupted);
  }
}

TEST_CASE("abort reaches the peer once and ends the session") {
  auto [client_end, server_end] = make_loopback();
  Liar liar(std::move(server_end));
  Session session(std::move(client_end), Role::Continuum, {});
  session.abort(4, "node 12 ran away");
  session.abort(5, "again");
  CHECK(session.stage() == Stage::Aborted);
  const auto abort = std::get<Abort>(liar.hear());
  CHECK(abort.exit_code == 4);
  CHECK(abort.reason == "node 12 ran away");
  liar.hang_up();
  CHECK_THROWS_AS(session.send(Progress{}), InternalError);
}
