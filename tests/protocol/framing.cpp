#include "protocol/framing.hpp"

#include <zlib.h>

#include <catch2/catch.hpp>
#include <cstring>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "protocol/crc32.hpp"

using namespace lockstep;
using namespace lockstep::protocol;
using Catch::Matchers::Contains;

namespace {

std::vector<std::byte> bytes_of(std::string_view text) {
  std::vector<std::byte> bytes(text.size());
  if (!text.empty()) std::memcpy(bytes.data(), text.data(), text.size());
  return bytes;
}

std::vector<std::byte> frame_of(std::string_view payload, MessageType type) {
  std::vector<std::byte> frame(header_size), body = bytes_of(payload);
  frame.insert(frame.end(), body.begin(), body.end());
  write_header(frame, type);
  return frame;
}

std::span<const std::byte> head(const std::vector<std::byte>& frame) { return std::span(frame).first(header_size); }

}  // namespace

TEST_CASE("the checksum is the CRC-32 of zlib at every length and alignment") {
  // The check value of CRC-32 (ISO 3309) for the digits 1 to 9.
  CHECK(crc32(bytes_of("123456789")) == 0xcbf43926u);
  Random random(7);
  std::vector<std::byte> bytes(20'000);
  for (std::byte& b : bytes) b = static_cast<std::byte>(random.next() & 0xff);
  std::size_t wrong = 0, tried = 0;
  const auto compare = [&](std::size_t begin, std::size_t size) {
    const std::span<const std::byte> part = std::span(bytes).subspan(begin, size);
    const auto reference = static_cast<std::uint32_t>(
        ::crc32(::crc32(0, nullptr, 0), reinterpret_cast<const Bytef*>(part.data()), static_cast<uInt>(size)));
    wrong += protocol::crc32(part) != reference;
    ++tried;
  };
  for (std::size_t size = 0; size < 600; ++size) compare(size % 17, size);
  for (std::size_t size = 18'400; size < 18'600; ++size) compare(size % 17, size);
  INFO(tried << " lengths, " << wrong << " wrong");
  CHECK(wrong == 0);
}

TEST_CASE("the header has the bytes that the contract states") {
  const std::vector<std::byte> frame = frame_of("123456789", MessageType::Forces);
  // LKST, version 1, type 6, length 9, CRC cbf43926, each little-endian.
  const std::vector<std::byte> expected =
      bytes_of(std::string_view("LKST\x01\x00\x06\x00\x09\x00\x00\x00\x26\x39\xf4\xcb"
                                "123456789",
                                25));
  CHECK(frame == expected);
  const FrameHeader header = read_header(head(frame), limits_before_hello());
  CHECK(header.type == MessageType::Forces);
  CHECK(header.payload_size == 9);
  CHECK_NOTHROW(check_payload(header, payload_of(frame)));
}

TEST_CASE("a header that is not ours is refused in words") {
  const FrameLimits limits = limits_before_hello();
  CHECK_THROWS_WITH(read_header(bytes_of("GET / HTTP/1.1\r\n"), limits),
                    Contains("not a Lockstep peer") && Contains("GET / HTTP/1.1\\x0d\\x0a"));
  CHECK_THROWS_WITH(check_magic(bytes_of("SSH")), Contains("first bytes \"SSH\""));
  CHECK_NOTHROW(check_magic(bytes_of("LK")));

  std::vector<std::byte> frame = frame_of("", MessageType::Hello);
  frame[4] = std::byte{2};
  CHECK_THROWS_WITH(read_header(head(frame), limits), Contains("header version 2, this side by 1"));
  frame = frame_of("", MessageType::Hello);
  frame[6] = std::byte{12};
  CHECK_THROWS_WITH(read_header(head(frame), limits), Contains("unknown message type 12"));
}

TEST_CASE("a length beyond its limit is refused from the header alone") {
  std::vector<std::byte> frame = frame_of("", MessageType::Hello);
  frame[10] = std::byte{1};  // 65536 bytes: the cap itself
  CHECK(read_header(head(frame), limits_before_hello()).payload_size == 65536);
  frame[8] = std::byte{1};
  CHECK_THROWS_WITH(read_header(head(frame), limits_before_hello()),
                    Contains("Hello of 65537 bytes where at most 65536"));

  frame = frame_of("", MessageType::InitialStress);
  frame[11] = std::byte{0x10};  // 256 MiB
  CHECK(read_header(head(frame), limits_before_mesh()).payload_size == max_payload);
  frame[8] = std::byte{1};
  CHECK_THROWS_AS(read_header(head(frame), limits_before_mesh()), PeerError);

  // 9 nodes: Velocities need 9 x 24 bytes and some scalars.
  frame = frame_of(std::string(9 * 24 + 1024 + 1, 'x'), MessageType::Velocities);
  CHECK_THROWS_AS(read_header(head(frame), limits_for_mesh(9, 4)), PeerError);
  CHECK_NOTHROW(read_header(head(frame), limits_for_mesh(10, 4)));
}

TEST_CASE("one changed bit of the payload or a missing byte is noticed") {
  std::vector<std::byte> frame =
      frame_of("some payload that is longer than sixty-four bytes, so that folding sees it too", MessageType::Progress);
  const FrameHeader header = read_header(head(frame), limits_before_hello());
  CHECK_THROWS_WITH(check_payload(header, payload_of(frame).first(40)), Contains("truncated Progress: 40 of 78 bytes"));
  for (std::size_t i = header_size; i < frame.size(); ++i) {
    for (int bit = 0; bit < 8; ++bit) {
      frame[i] ^= static_cast<std::byte>(1 << bit);
      REQUIRE_THROWS_WITH(check_payload(header, payload_of(frame)), Contains("Progress of 78 bytes arrived damaged"));
      frame[i] ^= static_cast<std::byte>(1 << bit);
    }
  }
}
