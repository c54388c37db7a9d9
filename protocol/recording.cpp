#include "protocol/recording.hpp"

#include <array>
#include <cerrno>
#include <cstring>

#include "common/checks.hpp"
#include "protocol/codec.hpp"

namespace lockstep::protocol {
namespace {

constexpr std::string_view file_magic = "LKSTREC1";
constexpr std::size_t entry_size = 1 + 8;  // direction and time [bytes]

FrameLimits no_limits() {
  FrameLimits limits;
  limits.fill(max_payload);
  return limits;
}

}  // namespace

Recorder::Recorder(std::filesystem::path path)
    : path_(std::move(path)), file_(path_, std::ios::binary), begin_(std::chrono::steady_clock::now()) {
  file_ << file_magic;
  if (!file_) throw IoError(fmt::format("cannot write the recording {}: {}", path_.string(), std::strerror(errno)));
}

void Recorder::add(Direction direction, std::span<const std::byte> frame) {
  const auto elapsed =
      static_cast<std::uint64_t>((std::chrono::steady_clock::now() - begin_) / std::chrono::nanoseconds(1));
  std::array<char, entry_size> entry{static_cast<char>(direction)};
  for (std::size_t i = 0; i < 8; ++i) entry[1 + i] = static_cast<char>((elapsed >> (8 * i)) & 0xff);
  file_.write(entry.data(), entry.size());
  file_.write(reinterpret_cast<const char*>(frame.data()), static_cast<std::streamsize>(frame.size()));
  if (!file_) throw IoError(fmt::format("cannot write the recording {}: {}", path_.string(), std::strerror(errno)));
}

void Recorder::flush() { file_.flush(); }

Recording::Recording(std::filesystem::path path) : path_(std::move(path)), file_(path_, std::ios::binary) {
  if (!file_) throw IoError(fmt::format("cannot read the recording {}: {}", path_.string(), std::strerror(errno)));
  std::string magic(file_magic.size(), '\0');
  file_.read(magic.data(), static_cast<std::streamsize>(magic.size()));
  if (magic != file_magic)
    throw IoError(fmt::format("{} is not a recording: it does not begin with {}", path_.string(), file_magic));
}

bool Recording::next(RecordedFrame& into) {
  std::array<std::byte, entry_size + header_size> head;
  file_.read(reinterpret_cast<char*>(head.data()), head.size());
  if (file_.gcount() == 0) return false;
  if (static_cast<std::size_t>(file_.gcount()) < head.size()) {
    is_truncated_ = true;
    return false;
  }
  const char direction = std::to_integer<char>(head[0]);
  if (direction != '>' && direction != '<')
    throw IoError(
        fmt::format("{} is damaged: a frame's direction is {:#04x}", path_.string(), std::to_integer<int>(head[0])));
  into.direction = static_cast<Direction>(direction);
  into.nanoseconds = 0;
  for (std::size_t i = 0; i < 8; ++i) into.nanoseconds |= std::to_integer<std::uint64_t>(head[1 + i]) << (8 * i);
  try {
    const std::span<const std::byte> header_bytes = std::span<const std::byte>(head).subspan(entry_size);
    const FrameHeader header = read_header(header_bytes, no_limits());
    into.frame.assign(header_bytes.begin(), header_bytes.end());
    into.frame.resize(header_size + header.payload_size);
    file_.read(reinterpret_cast<char*>(into.frame.data() + header_size), header.payload_size);
    if (static_cast<std::size_t>(file_.gcount()) < header.payload_size) {
      is_truncated_ = true;
      return false;
    }
    check_payload(header, payload_of(into.frame));
  } catch (const PeerError& error) {
    throw IoError(fmt::format("{} is damaged: {}", path_.string(), error.what()));
  }
  return true;
}

ReplayChannel::ReplayChannel(std::filesystem::path path, Direction own)
    : path_(path), recording_(std::move(path)), own_(own) {
  has_current_ = advance();
}

bool ReplayChannel::advance() {
  while (recording_.next(current_)) {
    ++number_;
    if (current_.direction != own_ || type_of(current_.frame) != MessageType::Progress) return true;
  }
  return false;
}

void ReplayChannel::send(std::span<const std::byte> frame) {
  if (is_closed_) throw PeerError(peer() + " is closed");
  const MessageType type = type_of(frame);
  if (type == MessageType::Progress) return;
  if (!has_current_)
    throw PeerError(fmt::format("{} ends after {} frames; this side goes on with {}", peer(), number_, name_of(type)));
  const MessageType recorded = type_of(current_.frame);
  if (current_.direction != own_)
    throw PeerError(fmt::format("{}, frame {}: this side received {} here and now sends {}", peer(), number_,
                                name_of(recorded), name_of(type)));
  if (recorded != type)
    throw PeerError(fmt::format("{}, frame {}: this side sent {} and now sends {}", peer(), number_, name_of(recorded),
                                name_of(type)));
  if (const std::string difference = first_difference(current_.frame, frame); !difference.empty())
    throw PeerError(
        fmt::format("{}, frame {}: {} differs from what was sent, {}", peer(), number_, name_of(type), difference));
  has_current_ = advance();
}

bool ReplayChannel::receive(std::vector<std::byte>& frame, Deadline deadline) {
  if (is_closed_) throw PeerError(peer() + " is closed");
  if (!has_current_) throw PeerError(fmt::format("{} ends after {} frames", peer(), number_));
  if (current_.direction == own_) {
    if (deadline <= std::chrono::steady_clock::now()) return false;
    throw PeerError(fmt::format("{}, frame {}: this side sent {} here and now waits", peer(), number_,
                                name_of(type_of(current_.frame))));
  }
  check_payload(read_header(std::span(current_.frame).first(header_size), limits_), payload_of(current_.frame));
  frame.swap(current_.frame);
  has_current_ = advance();
  return true;
}

}  // namespace lockstep::protocol
