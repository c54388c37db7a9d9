// A frame is a header of 16 bytes, little-endian, and a payload (the protobuf bytes of one message, codec.hpp).
//
//   offset  size  field
//        0     4  magic "LKST"
//        4     2  header version, 1
//        6     2  message type: position in the Message variant
//        8     4  payload length [bytes]
//       12     4  CRC-32 of the payload (crc32.hpp)
//
// A length prefix alone would let a truncated or shifted stream be taken for a message; magic, type, limit and checksum
// each turn one such accident into an error in words. The header is written into the same buffer as the payload, so
// that a frame is one write: two writes meet Nagle's algorithm and the peer's delayed acknowledgement (tens of
// milliseconds a message).
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <variant>
#include <vector>

#include "protocol/messages.hpp"

namespace lockstep::protocol {

// Positions in the Message variant, which travel in the header.
enum class MessageType : std::uint16_t {
  Hello,
  InitialStress,
  Balance,
  ContinuumExcavated,
  GrainsExcavated,
  Velocities,
  Forces,
  Progress,
  CheckpointRequest,
  CheckpointCommit,
  Finish,
  Abort
};
inline constexpr std::size_t message_types = std::variant_size_v<Message>;
static_assert(static_cast<std::size_t>(MessageType::Abort) + 1 == message_types);

std::string_view name_of(MessageType type);

inline constexpr std::size_t header_size = 16;  // [bytes]
inline constexpr std::uint16_t header_version = 1;
inline constexpr std::size_t max_payload = std::size_t{256} << 20;       // of any message [bytes]
inline constexpr std::size_t max_small_payload = std::size_t{64} << 10;  // of a message without node arrays [bytes]

// Largest payload by message type [bytes].
using FrameLimits = std::array<std::size_t, message_types>;
// Until both Hellos are through: nothing is larger than a Hello.
FrameLimits limits_before_hello();
// From then on InitialStress may be as large as a frame can be.
FrameLimits limits_before_mesh();
// From InitialStress on the counts bound each message.
FrameLimits limits_for_mesh(std::size_t nodes, std::size_t facets);

struct FrameHeader {
  MessageType type = MessageType::Hello;
  std::uint32_t payload_size = 0;  // [bytes]
  std::uint32_t checksum = 0;
};

// Fills the first header_size bytes of a frame whose payload stands behind them. InternalError if it exceeds
// max_payload.
void write_header(std::span<std::byte> frame, MessageType type);

// Checks as much of the magic as has arrived; PeerError "not a Lockstep peer" with the bytes. A foreign program's
// greeting may be shorter than a header.
void check_magic(std::span<const std::byte> bytes);

// Reads header_size bytes. PeerError on another magic ("not a Lockstep peer"), header version, an unknown type, or a
// payload larger than the limit of its type.
FrameHeader read_header(std::span<const std::byte> bytes, const FrameLimits& limits);

// Checks a whole frame: length and checksum against its header. PeerError in words.
void check_payload(const FrameHeader& header, std::span<const std::byte> payload);

// Of a frame that has been checked.
MessageType type_of(std::span<const std::byte> frame);
inline std::span<const std::byte> payload_of(std::span<const std::byte> frame) { return frame.subspan(header_size); }

}  // namespace lockstep::protocol
