#include "protocol/session_table.hpp"

#include <catch2/catch.hpp>
#include <set>

using namespace lockstep::protocol;

namespace {

constexpr Turn all_turns[] = {
    Turn::ClientHello,        Turn::ServerHello,     Turn::InitialStress,   Turn::Balance,
    Turn::ContinuumExcavated, Turn::GrainsExcavated, Turn::FirstVelocities, Turn::ApplyForces,
    Turn::ApplyVelocities,    Turn::ApplyCommit,     Turn::PenetrateForces, Turn::PenetrateVelocities,
    Turn::PenetrateCommit,    Turn::FinishReply,     Turn::Finished,        Turn::Aborted};
static_assert(std::size(all_turns) == turns);

// The order told message by message instead of turn by turn: where may this one be sent, and what follows. Written from
// the prose of README.md.
std::optional<Turn> expected(Turn turn, Role sender, MessageType message, Stage stage) {
  const bool is_continuum = sender == Role::Continuum;
  const auto only = [&](bool is_allowed, Turn next) { return is_allowed ? std::optional(next) : std::nullopt; };
  const bool is_before_exchange =
      turn == Turn::FirstVelocities || turn == Turn::ApplyVelocities || turn == Turn::PenetrateVelocities;
  switch (message) {
    case MessageType::Hello:
      if (is_continuum) return only(turn == Turn::ClientHello, Turn::ServerHello);
      return only(turn == Turn::ServerHello, Turn::InitialStress);
    case MessageType::InitialStress:
      return only(is_continuum && turn == Turn::InitialStress, Turn::Balance);
    case MessageType::Balance:
      return only(!is_continuum && turn == Turn::Balance, Turn::ContinuumExcavated);
    case MessageType::ContinuumExcavated:
      return only(is_continuum && turn == Turn::ContinuumExcavated, Turn::GrainsExcavated);
    case MessageType::GrainsExcavated:
      return only(!is_continuum && turn == Turn::GrainsExcavated, Turn::FirstVelocities);
    case MessageType::Velocities:
      if (stage == Stage::Apply)
        return only(is_continuum && is_before_exchange && turn != Turn::PenetrateVelocities, Turn::ApplyForces);
      return only(is_continuum && is_before_exchange && stage == Stage::Penetrate, Turn::PenetrateForces);
    case MessageType::Forces:
      if (turn == Turn::ApplyForces) return only(!is_continuum, Turn::ApplyVelocities);
      return only(!is_continuum && turn == Turn::PenetrateForces, Turn::PenetrateVelocities);
    case MessageType::Progress: {
      const std::set<Turn> silent = {Turn::ClientHello, Turn::ServerHello, Turn::Finished, Turn::Aborted};
      return only(!silent.contains(turn), turn);
    }
    case MessageType::CheckpointRequest:
      if (turn == Turn::ApplyVelocities) return only(is_continuum, Turn::ApplyCommit);
      return only(is_continuum && turn == Turn::PenetrateVelocities, Turn::PenetrateCommit);
    case MessageType::CheckpointCommit:
      if (turn == Turn::ApplyCommit) return only(!is_continuum, Turn::ApplyVelocities);
      return only(!is_continuum && turn == Turn::PenetrateCommit, Turn::PenetrateVelocities);
    case MessageType::Finish:
      if (is_continuum) return only(is_before_exchange, Turn::FinishReply);
      return only(turn == Turn::FinishReply, Turn::Finished);
    case MessageType::Abort:
      return only(turn != Turn::Finished && turn != Turn::Aborted, Turn::Aborted);
  }
  return std::nullopt;
}

}  // namespace

TEST_CASE("every turn takes exactly the messages that the order allows, from either side") {
  int allowed = 0, refused = 0;
  for (const Turn turn : all_turns) {
    for (const Role sender : {Role::Continuum, Role::Grains}) {
      for (std::size_t i = 0; i < message_types; ++i) {
        for (int s = 0; s <= static_cast<int>(Stage::Aborted); ++s) {
          const auto message = static_cast<MessageType>(i);
          const auto stage = static_cast<Stage>(s);
          CAPTURE(static_cast<int>(turn), name_of(sender), name_of(message), name_of(stage));
          const std::optional<Turn> next = next_turn(turn, sender, message, stage);
          REQUIRE(next == expected(turn, sender, message, stage));
          ++(next ? allowed : refused);
        }
      }
    }
  }
  // Per stage field: 13 rows without Velocities' 5, 28 Abort (14 turns, 2 sides), 24 Progress (12 turns, 2 sides), each
  // seen for 8 stage values; Velocities are allowed for one value each.
  CHECK(allowed == (16 + 28 + 24) * 8 + 5);
  CHECK(allowed + refused == 16 * 2 * 12 * 8);
}

TEST_CASE("a session reaches Finished, and never returns from Penetrate to Apply") {
  std::set<Turn> reached = {Turn::ClientHello}, beyond_apply;
  for (std::size_t pass = 0; pass < turns; ++pass) {
    for (const TurnRow& row : turn_table) {
      if (reached.contains(row.turn)) reached.insert(row.next);
      if (row.turn == Turn::PenetrateForces || beyond_apply.contains(row.turn)) beyond_apply.insert(row.next);
    }
  }
  CHECK(reached.size() == turns - 1);  // all but Aborted
  CHECK(beyond_apply.contains(Turn::Finished));
  for (const Turn turn : beyond_apply) CHECK(stage_of(turn) != Stage::Apply);
}

TEST_CASE("a refusal says who sent what, in which stage, and what is due") {
  CHECK(refusal(Turn::ApplyVelocities, Role::Grains, MessageType::Balance) ==
        "Balance from the grains out of turn in stage Apply; due is Velocities, CheckpointRequest or Finish from the "
        "continuum");
  CHECK(refusal(Turn::PenetrateVelocities, Role::Continuum, MessageType::Velocities, Stage::Apply) ==
        "Velocities of stage Apply from the continuum out of turn in stage Penetrate; due is Velocities, "
        "CheckpointRequest or "
        "Finish from the continuum");
  CHECK(due_at(Turn::Finished) == "nothing, the session is over");
}
