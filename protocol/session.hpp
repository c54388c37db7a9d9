// One side of a session: sends and receives whole messages over a channel, in the order that session_table.hpp allows,
// every wait with a deadline. Progress messages are taken out on the way and handed to on_progress; an Abort from the
// peer becomes a PeerError with the peer's words. A message that is out of turn, malformed, non-finite or of the wrong
// size is a PeerError that names message and field, and the peer is told by Abort before this side gives up.
#pragma once
#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "common/checks.hpp"
#include "protocol/channel.hpp"
#include "protocol/messages.hpp"

namespace lockstep::protocol {

// The peer has sent Abort. Where its computation failed, so has the coupled one: both sides end with the same code.
struct PeerGaveUp : PeerError {
  PeerGaveUp(std::int32_t code, const std::string& text)
      : PeerError(text, code == static_cast<int>(ExitCode::Numerical) ? ExitCode::Numerical : ExitCode::Peer),
        peer_exit_code(code) {}
  std::int32_t peer_exit_code;  // with which the peer's process ends
};

struct SessionSettings {
  std::chrono::milliseconds peer_timeout{60'000};      // longest silence taken for life; Progress counts as life
  std::chrono::milliseconds progress_interval{1'000};  // heartbeat() sends at most one Progress per interval
  std::string record_path;                             // every frame is recorded there if not empty
};

class Session {
 public:
  Session(std::unique_ptr<Channel> channel, Role mine, SessionSettings settings);
  ~Session();

  // Exchanges Hello and checks version, role and scene digest; throws with both values. Returns the peer's.
  Hello shake_hands(const Hello& mine);

  // Sends in turn. For Velocities and Forces no memory is allocated after the first call. PeerError if the peer is gone
  // (with its last words), InternalError if this side speaks out of turn or contradicts the mesh, NumericalError if a
  // number is not finite.
  void send(const Message& message);
  void send(const Velocities& message);
  void send(const Forces& message);

  // Receives exactly an M, or throws: PeerError; PeerGaveUp if the peer has sent Abort (Interrupted if its user stopped
  // it). Interrupted too when this side's user asks to stop while a stage before Apply is waited for; an exchange of
  // Velocities and Forces is always finished. The overloads reuse the memory of `into`.
  template <class M>
  M receive();
  void receive(Forces& into);

  // The continuum client ends the session by Finish: then false, and finish() holds it. Otherwise true with `into`
  // filled.
  bool receive_or_finish(Velocities& into);
  const Finish& finish() const;

  // Progress at most once per interval: cheap to call in every cycle of a long stage. Also throws PeerError if the peer
  // has closed or aborted meanwhile, and Interrupted when the user has asked to stop.
  void heartbeat(std::string_view text, double fraction);

  // Tells the peer why this side gives up; never throws.
  void abort(int exit_code, std::string_view reason) noexcept;

  std::function<void(const Progress&)> on_progress;

  // Number of interface nodes and facets, for size checks; known from InitialStress on.
  std::size_t node_count() const;
  std::size_t facet_count() const;
  Stage stage() const;
  std::string peer() const;        // address, and name once known
  double seconds_waiting() const;  // in receive, all told [s]
  std::uint64_t bytes_sent() const;
  std::uint64_t bytes_received() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace lockstep::protocol
