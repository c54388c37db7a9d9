// Every frame of a session, both ways, in a file; and a channel that plays such a file back to one side alone.
//
// File: the 8 bytes "LKSTREC1", then per frame 1 byte direction ('>' sent by the recording side, '<' received), 8 bytes
// little-endian nanoseconds since the recording began, and the frame as it was on the wire (its header holds its
// length).
#pragma once
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "protocol/channel.hpp"

namespace lockstep::protocol {

enum class Direction : char { Sent = '>', Received = '<' };

struct RecordedFrame {
  Direction direction = Direction::Sent;
  std::uint64_t nanoseconds = 0;  // since the recording began
  std::vector<std::byte> frame;   // header and payload, checked
};

class Recorder {
 public:
  // IoError if the file cannot be made.
  explicit Recorder(std::filesystem::path path);
  void add(Direction direction, std::span<const std::byte> frame);
  void flush();

 private:
  std::filesystem::path path_;
  std::ofstream file_;
  std::chrono::steady_clock::time_point begin_;
};

class Recording {
 public:
  // IoError if the file cannot be read or is not a recording.
  explicit Recording(std::filesystem::path path);
  // Reads the next frame; false at the end. A last frame cut short (its writer was killed) is the end too, and
  // is_truncated() tells. IoError if a frame is damaged.
  bool next(RecordedFrame& into);
  bool is_truncated() const { return is_truncated_; }

 private:
  std::filesystem::path path_;
  std::ifstream file_;
  bool is_truncated_ = false;
};

// Plays a recording to one side. receive() gives the other side's frames in their place in the order; send() compares
// with this side's recorded frames and throws PeerError at the first difference, with the frame's number and the field.
// This side's Progress frames are skipped both in the file and when sent: how many there are depends on the clock.
class ReplayChannel : public Channel {
 public:
  // `own` says which of the file's frames this side sent: Sent when the recording was made on this side, Received when
  // it was made on the peer's.
  explicit ReplayChannel(std::filesystem::path path, Direction own = Direction::Sent);

  void send(std::span<const std::byte> frame) override;
  // Never waits: when this side's own frame is due first, it returns false for a deadline that has passed and throws
  // PeerError for one in the future, which nothing could meet.
  bool receive(std::vector<std::byte>& frame, Deadline deadline) override;
  std::string peer() const override { return "recording " + path_.string(); }
  void close() override { is_closed_ = true; }

 private:
  // Goes to the next frame that counts; false at the end.
  bool advance();

  std::filesystem::path path_;
  Recording recording_;
  Direction own_;
  RecordedFrame current_;
  bool has_current_ = false;
  std::uint64_t number_ = 0;  // of the current frame, from 1
  bool is_closed_ = false;
};

}  // namespace lockstep::protocol
