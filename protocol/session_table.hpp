// The order of messages as one pure table: no sockets, no memory, no time. A Turn says what may come next; both sides
// hold the same Turn, since apart from Progress and Abort they speak strictly one after the other.
//
//   turn               who        what                         next turn
//   ClientHello        continuum  Hello                        ServerHello
//   ServerHello        grains     Hello                        InitialStress
//   InitialStress      continuum  InitialStress                Balance
//   Balance            grains     Balance                      ContinuumExcavated
//   ContinuumExcavated continuum  ContinuumExcavated           GrainsExcavated
//   GrainsExcavated    grains     GrainsExcavated              FirstVelocities
//   FirstVelocities    continuum  Velocities, Finish           ApplyForces or PenetrateForces, FinishReply
//   ApplyForces        grains     Forces                       ApplyVelocities
//   ApplyVelocities    continuum  Velocities, Finish,          ApplyForces or PenetrateForces, FinishReply,
//                                 CheckpointRequest            ApplyCommit
//   ApplyCommit        grains     CheckpointCommit             ApplyVelocities
//   Penetrate...       the same, without the way back to Apply
//   FinishReply        grains     Finish                       Finished
//   Finished, Aborted  nobody     nothing
//
// Progress leaves the turn as it is, for either side, from InitialStress to FinishReply. Abort ends any turn but the
// last two.
#pragma once
#include <cstdint>
#include <optional>
#include <string>

#include "protocol/framing.hpp"
#include "protocol/messages.hpp"

namespace lockstep::protocol {

enum class Turn : std::uint8_t {
  ClientHello,
  ServerHello,
  InitialStress,
  Balance,
  ContinuumExcavated,
  GrainsExcavated,
  FirstVelocities,
  ApplyForces,
  ApplyVelocities,
  ApplyCommit,
  PenetrateForces,
  PenetrateVelocities,
  PenetrateCommit,
  FinishReply,
  Finished,
  Aborted
};
inline constexpr std::size_t turns = static_cast<std::size_t>(Turn::Aborted) + 1;

// A row of the table: at `turn`, `sender` may send `message`. A Velocities row holds for one stage of the cycle.
struct TurnRow {
  Turn turn;
  Role sender;
  MessageType message;
  Turn next;
  Stage cycle_stage = Stage::Hello;  // of Velocities: Apply or Penetrate; else unused
};

inline constexpr TurnRow turn_table[] = {
    {Turn::ClientHello, Role::Continuum, MessageType::Hello, Turn::ServerHello},
    {Turn::ServerHello, Role::Grains, MessageType::Hello, Turn::InitialStress},
    {Turn::InitialStress, Role::Continuum, MessageType::InitialStress, Turn::Balance},
    {Turn::Balance, Role::Grains, MessageType::Balance, Turn::ContinuumExcavated},
    {Turn::ContinuumExcavated, Role::Continuum, MessageType::ContinuumExcavated, Turn::GrainsExcavated},
    {Turn::GrainsExcavated, Role::Grains, MessageType::GrainsExcavated, Turn::FirstVelocities},

    {Turn::FirstVelocities, Role::Continuum, MessageType::Velocities, Turn::ApplyForces, Stage::Apply},
    {Turn::FirstVelocities, Role::Continuum, MessageType::Velocities, Turn::PenetrateForces, Stage::Penetrate},
    {Turn::FirstVelocities, Role::Continuum, MessageType::Finish, Turn::FinishReply},

    {Turn::ApplyForces, Role::Grains, MessageType::Forces, Turn::ApplyVelocities},
    {Turn::ApplyVelocities, Role::Continuum, MessageType::Velocities, Turn::ApplyForces, Stage::Apply},
    {Turn::ApplyVelocities, Role::Continuum, MessageType::Velocities, Turn::PenetrateForces, Stage::Penetrate},
    {Turn::ApplyVelocities, Role::Continuum, MessageType::CheckpointRequest, Turn::ApplyCommit},
    {Turn::ApplyVelocities, Role::Continuum, MessageType::Finish, Turn::FinishReply},
    {Turn::ApplyCommit, Role::Grains, MessageType::CheckpointCommit, Turn::ApplyVelocities},

    {Turn::PenetrateForces, Role::Grains, MessageType::Forces, Turn::PenetrateVelocities},
    {Turn::PenetrateVelocities, Role::Continuum, MessageType::Velocities, Turn::PenetrateForces, Stage::Penetrate},
    {Turn::PenetrateVelocities, Role::Continuum, MessageType::CheckpointRequest, Turn::PenetrateCommit},
    {Turn::PenetrateVelocities, Role::Continuum, MessageType::Finish, Turn::FinishReply},
    {Turn::PenetrateCommit, Role::Grains, MessageType::CheckpointCommit, Turn::PenetrateVelocities},

    {Turn::FinishReply, Role::Grains, MessageType::Finish, Turn::Finished},
};

// The turn after `message` from `sender`, or nothing if it is out of turn. `cycle_stage` is the stage field of
// Velocities.
constexpr std::optional<Turn> next_turn(Turn turn, Role sender, MessageType message, Stage cycle_stage = Stage::Hello) {
  const bool is_over = turn == Turn::Finished || turn == Turn::Aborted;
  if (message == MessageType::Abort) return is_over ? std::nullopt : std::optional(Turn::Aborted);
  if (message == MessageType::Progress)
    return is_over || turn < Turn::InitialStress ? std::nullopt : std::optional(turn);
  for (const TurnRow& row : turn_table) {
    if (row.turn == turn && row.sender == sender && row.message == message &&
        (message != MessageType::Velocities || row.cycle_stage == cycle_stage))
      return row.next;
  }
  return std::nullopt;
}

// The session's stage while `turn` is due.
constexpr Stage stage_of(Turn turn) {
  switch (turn) {
    case Turn::ClientHello:
    case Turn::ServerHello:
      return Stage::Hello;
    case Turn::InitialStress:
      return Stage::InitialStress;
    case Turn::Balance:
      return Stage::Balance;
    case Turn::ContinuumExcavated:
    case Turn::GrainsExcavated:
      return Stage::Excavate;
    case Turn::FirstVelocities:
    case Turn::ApplyForces:
    case Turn::ApplyVelocities:
    case Turn::ApplyCommit:
      return Stage::Apply;
    case Turn::PenetrateForces:
    case Turn::PenetrateVelocities:
    case Turn::PenetrateCommit:
      return Stage::Penetrate;
    case Turn::FinishReply:
    case Turn::Finished:
      return Stage::Finished;
    case Turn::Aborted:
      return Stage::Aborted;
  }
  return Stage::Aborted;
}

std::string_view name_of(Role role);
std::string_view name_of(Stage stage);

// What is due, in words: "Velocities, CheckpointRequest or Finish from the continuum".
std::string due_at(Turn turn);

// Why next_turn() refused: "Forces from the grains out of turn in stage Apply; due is ...".
std::string refusal(Turn turn, Role sender, MessageType message, Stage cycle_stage = Stage::Hello);

}  // namespace lockstep::protocol
