#include "protocol/session.hpp"

#include <algorithm>
#include <utility>

#include "common/interrupt.hpp"
#include "protocol/codec.hpp"
#include "protocol/framing.hpp"
#include "protocol/recording.hpp"
#include "protocol/session_table.hpp"

namespace lockstep::protocol {
namespace {

using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

constexpr auto wait_slice = 100ms;        // longest wait that does not look at interrupt_requested()
constexpr auto poll_interval = 20ms;      // heartbeat() looks at the channel at most this often
constexpr auto abort_timeout = 2s;        // for a peer that no longer reads, last words are not worth more
constexpr std::size_t max_reason = 4096;  // of an Abort, so that it always fits [bytes]

double seconds(Clock::duration duration) { return std::chrono::duration<double>(duration).count(); }

template <class M>
constexpr MessageType type_number() {
  constexpr std::size_t index = []<class... Ms>(std::variant<Ms...>*) {
    std::size_t i = 0;
    ((std::is_same_v<Ms, M> ? false : (++i, true)) && ...);
    return i;
  }(static_cast<Message*>(nullptr));
  return static_cast<MessageType>(index);
}

template <class M>
Stage cycle_stage_of(const M& message) {
  if constexpr (std::is_same_v<M, Velocities>) return message.stage;
  return Stage::Hello;
}

std::string text_of(const Hello& hello) {
  return fmt::format("the {} ({} {})", name_of(hello.role), hello.solver.empty() ? "unnamed solver" : hello.solver,
                     hello.solver_version);
}

}  // namespace

struct Session::Impl {
  Impl(Session& owner, std::unique_ptr<Channel> opened, Role role, SessionSettings given)
      : session(owner), channel(std::move(opened)), mine(role), settings(std::move(given)), heard(Clock::now()) {
    channel->limit_frames(limits_before_hello());
    channel->set_send_timeout(settings.peer_timeout);
    if (!settings.record_path.empty()) recorder.emplace(settings.record_path);
  }

  Role theirs() const { return mine == Role::Continuum ? Role::Grains : Role::Continuum; }
  bool is_over() const { return turn == Turn::Finished || turn == Turn::Aborted; }
  std::string peer() const { return peer_name.empty() ? channel->peer() : channel->peer() + ", " + peer_name; }

  std::string last_words() const {
    if (!heard_type) return "it has said nothing yet";
    const std::string of_step = *heard_type == MessageType::Velocities || *heard_type == MessageType::Forces
                                    ? fmt::format(" of step {}", heard_step)
                                    : std::string();
    const std::string words =
        *heard_type == MessageType::Progress ? fmt::format(" \"{}\"", progress_text) : std::string();
    return fmt::format("its last words, {:.1f} s ago: {}{}{}", seconds(Clock::now() - heard), name_of(*heard_type),
                       of_step, words);
  }

  std::string situation() const {
    return fmt::format("in stage {}, due: {}; {}", name_of(stage_of(turn)), due_at(turn), last_words());
  }

  // The peer's Abort as this side's error. The session is over.
  [[noreturn]] void give_up(std::span<const std::byte> frame) {
    const auto abort = std::get<Abort>(codec.decode(frame));
    turn = Turn::Aborted;
    has_pending = false;
    const std::string text = fmt::format("peer gave up: {} ({}, exit code {})", abort.reason, peer(), abort.exit_code);
    if (abort.exit_code == static_cast<int>(ExitCode::Interrupted)) throw Interrupted(text);
    throw PeerGaveUp(abort.exit_code, text);
  }

  void transmit(std::span<const std::byte> frame) {
    if (recorder) recorder->add(Direction::Sent, frame);
    try {
      channel->send(frame);
    } catch (const PeerError& error) {
      explain_lost_connection(error);
    }
    sent += frame.size();
  }

  // A peer that gives up says why before it closes; its words may still lie unread where the send failed.
  [[noreturn]] void explain_lost_connection(const PeerError& error) {
    try {
      if (has_pending && type_of(in) == MessageType::Abort) give_up(in);
      while (fetch(Clock::now())) {
        if (type_of(in) == MessageType::Abort) give_up(in);
      }
    } catch (const PeerGaveUp&) {
      throw;
    } catch (const PeerError&) {
      // The connection has nothing more to tell: the first error stands.
    }
    turn = Turn::Aborted;
    throw PeerError(fmt::format("{}; {}", error.what(), last_words()));
  }

  // One frame from the channel into `in`; false if none has come before the deadline.
  bool fetch(Deadline deadline) {
    try {
      if (!channel->receive(in, deadline)) return false;
    } catch (const PeerError& error) {
      throw PeerError(fmt::format("{}, {}", error.what(), situation()));
    }
    received += in.size();
    heard = Clock::now();
    if (recorder) recorder->add(Direction::Received, in);
    return true;
  }

  // Handles a frame that may come at any time; false if it is none of those.
  bool take_aside(std::span<const std::byte> frame) {
    const MessageType type = type_of(frame);
    if (type == MessageType::Abort) give_up(frame);
    if (type != MessageType::Progress) return false;
    if (!next_turn(turn, theirs(), type)) throw PeerError("peer sent " + refusal(turn, theirs(), type));
    const auto progress = std::get<Progress>(codec.decode(frame));
    heard_type = type;
    progress_text = progress.text;
    if (session.on_progress) session.on_progress(progress);
    return true;
  }

  // Waits until `in` holds a frame that is neither Progress nor Abort.
  void wait() {
    if (std::exchange(has_pending, false)) return;
    const Clock::time_point begin = Clock::now();
    const bool is_interruptible = stage_of(turn) < Stage::Apply;
    Clock::time_point alive = begin;  // the peer owes an answer from here on
    for (;;) {
      const Clock::time_point now = Clock::now();
      // A side that was itself held up (stopped, starved) may find the deadline past and the peer's words there: one
      // last look comes before the verdict.
      const bool is_overdue = now - alive >= settings.peer_timeout;
      if (is_interruptible && interrupt_requested()) stop_for_user();
      if (!fetch(is_overdue ? now : std::min<Deadline>(now + wait_slice, alive + settings.peer_timeout))) {
        if (!is_overdue) continue;
        waiting += now - begin;
        throw PeerError(
            fmt::format("no word from the {} ({}) for {:.1f} s, {}; look at its log, and raise coupling.peer_timeout "
                        "if it is only slow",
                        name_of(theirs()), peer(), seconds(now - alive), situation()));
      }
      if (!take_aside(in)) break;
      alive = heard;
    }
    waiting += heard - begin;
  }

  [[noreturn]] void stop_for_user() {
    const std::string stage(name_of(stage_of(turn)));
    abort(static_cast<int>(ExitCode::Interrupted),
          fmt::format("the user of the {} stopped it in stage {}", name_of(mine), stage));
    throw Interrupted("interrupted in stage " + stage);
  }

  void abort(int exit_code, std::string_view reason) noexcept {
    if (is_over()) return;
    turn = Turn::Aborted;
    try {
      channel->set_send_timeout(abort_timeout);
      std::vector<std::byte> frame;
      codec.encode(Message(Abort{exit_code, std::string(reason.substr(0, max_reason))}), frame);
      if (recorder) recorder->add(Direction::Sent, frame);
      channel->send(frame);
      if (recorder) recorder->flush();
    } catch (...) {
      // The peer is gone already; this side's own error is what counts.
    }
  }

  // Runs what may find fault with the peer, and tells the peer before it passes the fault on.
  template <class Action>
  auto telling_peer(Action action) {
    try {
      return action();
    } catch (const PeerGaveUp&) {
      throw;
    } catch (const PeerError& error) {
      abort(static_cast<int>(ExitCode::Peer), error.what());
      throw;
    }
  }

  // Whether the step number of `message` is the one that is due; words if not.
  template <class M>
  std::string wrong_step(const M& message) const {
    std::uint64_t due = 0, actual = 0;
    if constexpr (std::is_same_v<M, Velocities> || std::is_same_v<M, Forces> || std::is_same_v<M, CheckpointRequest>) {
      due = next_step;
      actual = message.step;
    } else if constexpr (std::is_same_v<M, CheckpointCommit>) {
      due = checkpoint_step;
      actual = message.step;
    }
    if (due == actual) return {};
    return fmt::format("{}.step = {} where step {} is due", name_of(type_number<M>()), actual, due);
  }

  // What both sides note when a message has passed, whoever sent it.
  template <class M>
  void note(const M& message, Turn next) {
    turn = next;
    if constexpr (std::is_same_v<M, InitialStress>) {
      nodes = message.nodes.size();
      facets = message.facets.size();
      codec.set_mesh(nodes, facets);
      channel->limit_frames(limits_for_mesh(nodes, facets));
    } else if constexpr (std::is_same_v<M, Forces>) {
      ++next_step;
    } else if constexpr (std::is_same_v<M, CheckpointRequest>) {
      checkpoint_step = message.step;
    } else if constexpr (std::is_same_v<M, Finish>) {
      last_finish = message;
      if (recorder && next == Turn::Finished) recorder->flush();
    }
  }

  template <class M>
  void send(const M& message) {
    constexpr MessageType type = type_number<M>();
    const std::optional<Turn> next = next_turn(turn, mine, type, cycle_stage_of(message));
    if (!next) throw InternalError(refusal(turn, mine, type, cycle_stage_of(message)));
    if (const std::string words = wrong_step(message); !words.empty())
      throw InternalError("not sent to the peer: " + words);
    if constexpr (std::is_same_v<M, Velocities> || std::is_same_v<M, Forces>) {
      codec.encode(message, out);
    } else {
      codec.encode(Message(message), out);
    }
    transmit(out);
    note(message, *next);
  }

  // Takes the frame in `in` for an M.
  template <class M>
  void take(M& into) {
    constexpr MessageType type = type_number<M>();
    if (type_of(in) != type) {
      const bool is_in_turn = next_turn(turn, theirs(), type_of(in), Stage::Apply) ||
                              next_turn(turn, theirs(), type_of(in), Stage::Penetrate);
      throw PeerError("peer sent " +
                      (is_in_turn ? fmt::format("{} where this side takes {} only", name_of(type_of(in)), name_of(type))
                                  : refusal(turn, theirs(), type_of(in))));
    }
    if constexpr (std::is_same_v<M, Velocities> || std::is_same_v<M, Forces>) {
      codec.decode(in, into);
      heard_step = into.step;
    } else {
      into = std::get<M>(codec.decode(in));
    }
    heard_type = type;
    if constexpr (std::is_same_v<M, Hello>) check_hello(into);
    const std::optional<Turn> next = next_turn(turn, theirs(), type, cycle_stage_of(into));
    if (!next) throw PeerError("peer sent " + refusal(turn, theirs(), type, cycle_stage_of(into)));
    if (const std::string words = wrong_step(into); !words.empty()) throw PeerError("peer sent " + words);
    note(into, *next);
  }

  template <class M>
  void receive(M& into) {
    telling_peer([&] {
      wait();
      take(into);
    });
  }

  void check_hello(const Hello& peers) {
    peer_name = text_of(peers);
    const std::string both = fmt::format("{} and {}", text_of(own_hello), text_of(peers));
    if (peers.major != own_hello.major)
      throw PeerError(fmt::format("protocol versions differ: {}.{} and {}.{} ({}); use programs of one major version",
                                  own_hello.major, own_hello.minor, peers.major, peers.minor, both));
    if (peers.role == mine)
      throw PeerError(fmt::format("both sides are the {} ({}); a session needs one continuum and one grains side",
                                  name_of(mine), both));
    if (!peers.scene_digest.empty() && !own_hello.scene_digest.empty() && peers.scene_digest != own_hello.scene_digest)
      throw PeerError(fmt::format(
          "the two sides read different scenes: digest {} and {} ({}); start both with the same scene file and "
          "overrides",
          own_hello.scene_digest, peers.scene_digest, both));
    if (peers.resume_step != own_hello.resume_step)
      throw PeerError(
          fmt::format("the two sides resume at different steps: {} and {} ({}); start both from the same checkpoint",
                      own_hello.resume_step, peers.resume_step, both));
  }

  Session& session;
  std::unique_ptr<Channel> channel;
  const Role mine;
  const SessionSettings settings;
  Codec codec;
  std::optional<Recorder> recorder;

  Turn turn = Turn::ClientHello;
  std::uint64_t next_step = 0;        // of the Velocities and Forces that come next
  std::uint64_t checkpoint_step = 0;  // of the request under way
  std::size_t nodes = 0, facets = 0;
  Hello own_hello;
  Finish last_finish;

  std::vector<std::byte> out;
  std::vector<std::byte> in;
  bool has_pending = false;  // `in` holds a frame that heartbeat() found and the next receive will take

  std::string peer_name;
  std::optional<MessageType> heard_type;
  std::uint64_t heard_step = 0;  // of the last Velocities or Forces
  std::string progress_text;
  Clock::time_point heard;  // when the last frame came
  Clock::time_point polled{}, progress_sent{};
  Clock::duration waiting{};
  std::uint64_t sent = 0, received = 0;  // [bytes]
};

Session::Session(std::unique_ptr<Channel> channel, Role mine, SessionSettings settings)
    : impl_(std::make_unique<Impl>(*this, std::move(channel), mine, std::move(settings))) {}

Session::~Session() { impl_->channel->close(); }

Hello Session::shake_hands(const Hello& mine) {
  LOCKSTEP_ASSERT(mine.role == impl_->mine, "Hello says {}, the session {}", name_of(mine.role), name_of(impl_->mine));
  impl_->own_hello = mine;
  impl_->next_step = mine.resume_step;
  Hello peers;
  if (impl_->mine == Role::Continuum) impl_->send(mine);
  impl_->receive(peers);
  if (impl_->mine == Role::Grains) impl_->send(mine);
  impl_->channel->limit_frames(limits_before_mesh());
  return peers;
}

void Session::send(const Message& message) {
  std::visit([&](const auto& m) { impl_->send(m); }, message);
}
void Session::send(const Velocities& message) { impl_->send(message); }
void Session::send(const Forces& message) { impl_->send(message); }

template <class M>
M Session::receive() {
  M message;
  impl_->receive(message);
  return message;
}
template Hello Session::receive<Hello>();
template InitialStress Session::receive<InitialStress>();
template Balance Session::receive<Balance>();
template ContinuumExcavated Session::receive<ContinuumExcavated>();
template GrainsExcavated Session::receive<GrainsExcavated>();
template Velocities Session::receive<Velocities>();
template Forces Session::receive<Forces>();
template CheckpointRequest Session::receive<CheckpointRequest>();
template CheckpointCommit Session::receive<CheckpointCommit>();
template Finish Session::receive<Finish>();

void Session::receive(Forces& into) { impl_->receive(into); }

bool Session::receive_or_finish(Velocities& into) {
  return impl_->telling_peer([&] {
    impl_->wait();
    if (type_of(impl_->in) != MessageType::Finish) {
      impl_->take(into);
      return true;
    }
    Finish finish;
    impl_->take(finish);
    return false;
  });
}

const Finish& Session::finish() const { return impl_->last_finish; }

void Session::heartbeat(std::string_view text, double fraction) {
  Impl& impl = *impl_;
  if (impl.is_over()) return;
  if (interrupt_requested()) impl.stop_for_user();
  const Clock::time_point now = Clock::now();
  if (!impl.has_pending && now - impl.polled >= poll_interval) {
    impl.polled = now;
    impl.telling_peer([&] {
      while (!impl.has_pending && impl.fetch(now)) impl.has_pending = !impl.take_aside(impl.in);
    });
  }
  if (now - impl.progress_sent >= impl.settings.progress_interval &&
      next_turn(impl.turn, impl.mine, MessageType::Progress)) {
    impl.progress_sent = now;
    impl.send(Progress{std::string(text), std::clamp(fraction, 0.0, 1.0)});
  }
}

void Session::abort(int exit_code, std::string_view reason) noexcept { impl_->abort(exit_code, reason); }

std::size_t Session::node_count() const { return impl_->nodes; }
std::size_t Session::facet_count() const { return impl_->facets; }
Stage Session::stage() const { return stage_of(impl_->turn); }
std::string Session::peer() const { return impl_->peer(); }
double Session::seconds_waiting() const { return seconds(impl_->waiting); }
std::uint64_t Session::bytes_sent() const { return impl_->sent; }
std::uint64_t Session::bytes_received() const { return impl_->received; }

}  // namespace lockstep::protocol
