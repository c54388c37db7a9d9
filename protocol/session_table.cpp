#include "protocol/session_table.hpp"

#include <algorithm>
#include <vector>

#include "common/checks.hpp"

namespace lockstep::protocol {

std::string_view name_of(Role role) { return role == Role::Continuum ? "continuum" : "grains"; }

std::string_view name_of(Stage stage) {
  switch (stage) {
    case Stage::Hello:
      return "Hello";
    case Stage::InitialStress:
      return "InitialStress";
    case Stage::Balance:
      return "Balance";
    case Stage::Excavate:
      return "Excavate";
    case Stage::Apply:
      return "Apply";
    case Stage::Penetrate:
      return "Penetrate";
    case Stage::Finished:
      return "Finished";
    case Stage::Aborted:
      return "Aborted";
  }
  return "unknown stage";
}

std::string due_at(Turn turn) {
  std::vector<std::string_view> messages;
  std::string_view sender;
  for (const TurnRow& row : turn_table) {
    if (row.turn != turn) continue;
    sender = name_of(row.sender);
    if (const std::string_view name = name_of(row.message);
        std::find(messages.begin(), messages.end(), name) == messages.end())
      messages.push_back(name);
  }
  if (messages.empty()) return "nothing, the session is over";
  std::string text(messages.front());
  for (std::size_t i = 1; i < messages.size(); ++i)
    text += fmt::format("{}{}", i + 1 == messages.size() ? " or " : ", ", messages[i]);
  return fmt::format("{} from the {}", text, sender);
}

std::string refusal(Turn turn, Role sender, MessageType message, Stage cycle_stage) {
  const std::string of_stage =
      message == MessageType::Velocities ? fmt::format(" of stage {}", name_of(cycle_stage)) : "";
  return fmt::format("{}{} from the {} out of turn in stage {}; due is {}", name_of(message), of_stage, name_of(sender),
                     name_of(stage_of(turn)), due_at(turn));
}

}  // namespace lockstep::protocol
