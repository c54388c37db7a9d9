#include "protocol/framing.hpp"

#include <algorithm>
#include <cctype>
#include <string>

#include "common/checks.hpp"
#include "protocol/crc32.hpp"

namespace lockstep::protocol {
namespace {

constexpr std::array<char, 4> magic = {'L', 'K', 'S', 'T'};

constexpr std::array<std::string_view, message_types> names = {
    "Hello",  "InitialStress", "Balance",           "ContinuumExcavated", "GrainsExcavated", "Velocities",
    "Forces", "Progress",      "CheckpointRequest", "CheckpointCommit",   "Finish",          "Abort"};

// What a message may need beside its arrays: scalars, energies, tags and lengths [bytes].
constexpr std::size_t scalars = 1024;

template <class Unsigned>
void put(std::span<std::byte> bytes, std::size_t offset, Unsigned value) {
  for (std::size_t i = 0; i < sizeof value; ++i) bytes[offset + i] = static_cast<std::byte>((value >> (8 * i)) & 0xff);
}

template <class Unsigned>
Unsigned get(std::span<const std::byte> bytes, std::size_t offset) {
  Unsigned value = 0;
  for (std::size_t i = 0; i < sizeof value; ++i)
    value = static_cast<Unsigned>(value | (std::to_integer<Unsigned>(bytes[offset + i]) << (8 * i)));
  return value;
}

std::string printable(std::span<const std::byte> bytes) {
  std::string text;
  for (std::byte b : bytes) {
    const int c = std::to_integer<int>(b);
    text += std::isprint(c) && c < 128 ? std::string(1, static_cast<char>(c)) : fmt::format("\\x{:02x}", c);
  }
  return text;
}

void set_limit(FrameLimits& limits, MessageType type, std::size_t size) {
  limits[static_cast<std::size_t>(type)] = std::min(size, max_payload);
}

}  // namespace

std::string_view name_of(MessageType type) { return names[static_cast<std::size_t>(type)]; }

FrameLimits limits_before_hello() {
  FrameLimits limits;
  limits.fill(max_small_payload);
  return limits;
}

FrameLimits limits_before_mesh() {
  FrameLimits limits = limits_before_hello();
  set_limit(limits, MessageType::InitialStress, max_payload);
  return limits;
}

FrameLimits limits_for_mesh(std::size_t nodes, std::size_t facets) {
  constexpr std::size_t vector = 3 * sizeof(double), number = sizeof(double);
  FrameLimits limits = limits_before_hello();
  set_limit(limits, MessageType::Balance, scalars + facets * vector);
  set_limit(limits, MessageType::ContinuumExcavated, scalars + nodes * number);
  set_limit(limits, MessageType::GrainsExcavated, scalars + nodes * (2 * vector + number));
  set_limit(limits, MessageType::Velocities, scalars + nodes * vector);
  set_limit(limits, MessageType::Forces, scalars + nodes * (vector + number));
  return limits;
}

void write_header(std::span<std::byte> frame, MessageType type) {
  const std::size_t size = frame.size() - header_size;
  LOCKSTEP_ASSERT(size <= max_payload, "{} of {} bytes exceeds the largest frame, {} bytes", name_of(type), size,
                  max_payload);
  for (std::size_t i = 0; i < magic.size(); ++i) frame[i] = static_cast<std::byte>(magic[i]);
  put<std::uint16_t>(frame, 4, header_version);
  put<std::uint16_t>(frame, 6, static_cast<std::uint16_t>(type));
  put<std::uint32_t>(frame, 8, static_cast<std::uint32_t>(size));
  put<std::uint32_t>(frame, 12, crc32(frame.subspan(header_size)));
}

void check_magic(std::span<const std::byte> bytes) {
  for (std::size_t i = 0; i < std::min(magic.size(), bytes.size()); ++i) {
    if (bytes[i] != static_cast<std::byte>(magic[i]))
      throw PeerError(fmt::format("not a Lockstep peer: first bytes \"{}\", expected \"LKST\"; check host and port",
                                  printable(bytes.first(std::min(header_size, bytes.size())))));
  }
}

FrameHeader read_header(std::span<const std::byte> bytes, const FrameLimits& limits) {
  check_magic(bytes);
  if (const auto version = get<std::uint16_t>(bytes, 4); version != header_version)
    throw PeerError(
        fmt::format("peer frames its messages by header version {}, this side by {}; use programs of one release",
                    version, header_version));
  const auto type = get<std::uint16_t>(bytes, 6);
  if (type >= message_types)
    throw PeerError(fmt::format("unknown message type {}; the last known one is {}", type, message_types - 1));
  const FrameHeader header{static_cast<MessageType>(type), get<std::uint32_t>(bytes, 8), get<std::uint32_t>(bytes, 12)};
  if (const std::size_t limit = limits[type]; header.payload_size > limit)
    throw PeerError(
        fmt::format("{} of {} bytes where at most {} can be right", name_of(header.type), header.payload_size, limit));
  return header;
}

void check_payload(const FrameHeader& header, std::span<const std::byte> payload) {
  if (payload.size() != header.payload_size)
    throw PeerError(
        fmt::format("truncated {}: {} of {} bytes", name_of(header.type), payload.size(), header.payload_size));
  if (const std::uint32_t actual = crc32(payload); actual != header.checksum)
    throw PeerError(fmt::format("{} of {} bytes arrived damaged: checksum {:08x}, header says {:08x}",
                                name_of(header.type), payload.size(), actual, header.checksum));
}

MessageType type_of(std::span<const std::byte> frame) { return static_cast<MessageType>(get<std::uint16_t>(frame, 6)); }

}  // namespace lockstep::protocol
