#include "protocol/codec.hpp"

#include <algorithm>
#include <bit>
#include <catch2/catch.hpp>
#include <cstring>
#include <limits>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "protocol/framing.hpp"
#include "tests/protocol/allocation_count.hpp"
#include "tests/protocol/session_fixture.hpp"

using namespace lockstep;
using namespace lockstep::protocol;
using Catch::Matchers::Contains;

namespace {

// Doubles that text or arithmetic would spoil: a negative zero, the smallest and largest, one third.
constexpr double negative_zero = -0.0, smallest = std::numeric_limits<double>::denorm_min(),
                 largest = std::numeric_limits<double>::max(), third = 1.0 / 3;

Velocities some_velocities(std::size_t nodes) {
  Velocities v;
  v.step = 0xfedcba9876543210ull;
  v.stage = Stage::Penetrate;
  v.time_step = 1.25e-5;
  Random random(3);
  for (std::size_t i = 0; i < nodes; ++i)
    v.velocity.emplace_back(random.uniform(-1, 1), random.uniform(), negative_zero);
  if (nodes > 1) v.velocity[1] = Vec3(smallest, -largest, third);
  v.unbalanced_ratio = negative_zero;
  v.position_hash = 0x8000000000000001ull;
  v.energies = {1.5, third, -2, smallest, 5, largest, negative_zero};
  return v;
}

Forces some_forces(std::size_t nodes) {
  Forces f;
  f.step = 41;
  Random random(4);
  for (std::size_t i = 0; i < nodes; ++i)
    f.force.emplace_back(random.uniform(-1e6, 1e6), negative_zero, random.uniform());
  f.stable_step = third;
  f.node_stiffness.assign(nodes, 1e6 + third);
  f.unbalanced_ratio = 1e-3;
  f.is_done = true;
  f.energies = Energies{7, 6, 5, 4, 3, 2, 1};
  f.particle_moment = Vec3(third, negative_zero, largest);
  f.limited_by = "grain 7";
  f.particle_force = Vec3(negative_zero, third, -1);
  f.neglected_moment = smallest;
  return f;
}

std::vector<Message> one_of_each() {
  Hello hello = hello_of(Role::Grains);
  hello.major = 3, hello.minor = 4, hello.resume_step = 17;
  GrainsExcavated excavated{{Vec3(1, negative_zero, third), Vec3(4, 5, 6)}, third, {1, 2},
                            {Vec3(7, 8, 9), Vec3(smallest, 0, 1)},          ~0ull, "grain 3"};
  return {hello,
          flat_interface(3, 2),
          Balance{{Vec3(1, 2, third), Vec3(negative_zero, 5, 6)}, 0.371, 1e-3, 12345678901ull, 7},
          ContinuumExcavated{900, third, 1e-5, 77, {4e6, {1, third}, 0.7, 1e-4}},
          excavated,
          some_velocities(5),
          some_forces(5),
          Progress{"settling: \xc3\xa4 \"quoted\"", third},
          CheckpointRequest{12, "half way"},
          CheckpointCommit{12, 99},
          Finish{1000, "S = 1.0 D"},
          Abort{-4, "particle 7 left the box"}};
}

std::vector<std::byte> frame_of(const Message& message) {
  std::vector<std::byte> frame;
  Codec().encode(message, frame);
  return frame;
}

std::vector<std::byte> frame_of_payload(MessageType type, const std::vector<std::byte>& payload) {
  std::vector<std::byte> frame(header_size + payload.size());
  std::copy(payload.begin(), payload.end(), frame.begin() + header_size);
  write_header(frame, type);
  return frame;
}

// The frame with the one double `from` in it replaced, its checksum right again: what a peer with that number would
// send.
std::vector<std::byte> with_number(std::vector<std::byte> frame, double from, double to) {
  const auto bytes = std::bit_cast<std::array<std::byte, 8>>(from), other = std::bit_cast<std::array<std::byte, 8>>(to);
  const auto at = std::search(frame.begin(), frame.end(), bytes.begin(), bytes.end());
  REQUIRE(at != frame.end());
  std::copy(other.begin(), other.end(), at);
  write_header(frame, type_of(frame));
  return frame;
}

template <class M>
bool same_bits(const std::vector<M>& a, const std::vector<M>& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(M)) == 0);
}
bool same_bits(double a, double b) { return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b); }
bool same_bits(const Energies& a, const Energies& b) { return std::memcmp(&a, &b, sizeof a) == 0; }

}  // namespace

TEST_CASE("every message comes back with the same bits") {
  Codec codec;
  for (const Message& message : one_of_each()) {
    const std::vector<std::byte> frame = frame_of(message);
    CAPTURE(name_of(type_of(frame)));
    CHECK(static_cast<std::size_t>(type_of(frame)) == message.index());
    const Message back = codec.decode(frame);
    REQUIRE(back.index() == message.index());
    // The encoding holds the bits of every field, so equal encodings are equal structs as far as the encoder looks.
    CHECK(frame_of(back) == frame);
  }
}

TEST_CASE("the struct behind the wire is the struct before it, field by field") {
  const auto velocities = some_velocities(5);
  const auto v = std::get<Velocities>(Codec().decode(frame_of(velocities)));
  CHECK(v.step == velocities.step);
  CHECK(v.stage == velocities.stage);
  CHECK(same_bits(v.time_step, velocities.time_step));
  CHECK(same_bits(v.velocity, velocities.velocity));
  CHECK(same_bits(v.unbalanced_ratio, velocities.unbalanced_ratio));
  CHECK(v.position_hash == velocities.position_hash);
  CHECK(same_bits(v.energies, velocities.energies));

  const auto forces = some_forces(5);
  const auto f = std::get<Forces>(Codec().decode(frame_of(forces)));
  CHECK(f.step == forces.step);
  CHECK(same_bits(f.force, forces.force));
  CHECK(same_bits(f.stable_step, forces.stable_step));
  CHECK(same_bits(f.node_stiffness, forces.node_stiffness));
  CHECK(same_bits(f.unbalanced_ratio, forces.unbalanced_ratio));
  CHECK(f.is_done);
  REQUIRE(f.energies);
  CHECK(same_bits(*f.energies, *forces.energies));
  CHECK(std::memcmp(f.particle_moment.data(), forces.particle_moment.data(), 24) == 0);
  CHECK(f.limited_by == forces.limited_by);
  CHECK(std::memcmp(f.particle_force.data(), forces.particle_force.data(), 24) == 0);
  CHECK(same_bits(f.neglected_moment, forces.neglected_moment));

  const InitialStress initial = flat_interface(3, 2);
  const auto i = std::get<InitialStress>(Codec().decode(frame_of(initial)));
  CHECK(same_bits(i.nodes, initial.nodes));
  CHECK(i.facets == initial.facets);
  CHECK(i.ring == initial.ring);
  CHECK(same_bits(i.traction, initial.traction));
  CHECK(same_bits(i.stress, initial.stress));
  CHECK(i.profile.size() == 2);
  CHECK(i.profile[0].vertical == -16e3);
  CHECK(i.gravity == initial.gravity);
  CHECK(i.bulk_density == initial.bulk_density);

  Hello hello = hello_of(Role::Grains);
  hello.resume_step = 5;
  const auto h = std::get<Hello>(Codec().decode(frame_of(hello)));
  CHECK(h.role == Role::Grains);
  CHECK(h.capabilities == hello.capabilities);
  CHECK(h.scene_digest == hello.scene_digest);
  CHECK(h.resume_step == 5);
}

TEST_CASE("an exchange takes no memory after the first") {
  Codec codec;
  codec.set_mesh(770, 700);
  std::vector<std::byte> velocities_frame, forces_frame;
  const Velocities velocities = some_velocities(770);
  const Forces forces = some_forces(770);
  Velocities v;
  Forces f;
  const auto exchange = [&] {
    codec.encode(velocities, velocities_frame);
    codec.decode(velocities_frame, v);
    codec.encode(forces, forces_frame);
    codec.decode(forces_frame, f);
  };
  exchange();
  const std::size_t before = allocation_count();
  for (int i = 0; i < 10; ++i) exchange();
  const std::size_t taken = allocation_count() - before;
  INFO(taken << " allocations in 10 exchanges");
  CHECK(taken == 0);
  CHECK(same_bits(f.force, forces.force));
}

TEST_CASE("numbers that are not finite are refused on arrival, with message, field and place") {
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  Velocities velocities = some_velocities(5);
  velocities.velocity[3].y() = 1234.5;
  for (const double bad : {nan, infinity, -infinity})
    CHECK_THROWS_WITH(Codec().decode(with_number(frame_of(velocities), 1234.5, bad)),
                      Contains("peer sent Velocities.velocity[3], component 2 of 3") && Contains("not finite"));
  Forces forces = some_forces(3);
  forces.energies->friction = 4321.5;
  CHECK_THROWS_WITH(Codec().decode(with_number(frame_of(forces), 4321.5, nan)), Contains("Forces.energies.friction"));
  InitialStress initial = flat_interface(2, 2);
  initial.stress[2][4] = 4321.5;
  CHECK_THROWS_WITH(Codec().decode(with_number(frame_of(initial), 4321.5, infinity)),
                    Contains("InitialStress.stress[2], component 5 of 6, = inf"));
}

TEST_CASE("numbers that are not finite are not sent either") {
  std::vector<std::byte> frame;
  Velocities velocities = some_velocities(5);
  velocities.velocity[4].z() = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(Codec().encode(velocities, frame), NumericalError);
  CHECK_THROWS_WITH(Codec().encode(velocities, frame), Contains("Velocities.velocity[4], component 3 of 3"));
}

TEST_CASE("array lengths must fit each other and the mesh") {
  Codec codec;
  codec.set_mesh(6, 2);
  CHECK_THROWS_WITH(codec.decode(frame_of(some_velocities(5))),
                    Contains("Velocities.velocity has 5 entries for 6 nodes"));
  CHECK_THROWS_WITH(codec.decode(frame_of(some_forces(7))), Contains("Forces.force has 7 entries for 6 nodes"));
  Forces forces = some_forces(6);
  forces.node_stiffness.clear();
  CHECK_NOTHROW(codec.decode(frame_of(forces)));
  forces.node_stiffness.assign(2, 1.0);
  CHECK_THROWS_WITH(codec.decode(frame_of(forces)), Contains("Forces.node_stiffness has 2 entries for 6 nodes"));
  CHECK_THROWS_WITH(codec.decode(frame_of(Balance{{Vec3::Zero()}, 0, 0, 0, 0})),
                    Contains("traction has 1 entries for 2 facets"));

  std::vector<std::byte> frame;
  InitialStress initial = flat_interface(2, 2);
  initial.ring.pop_back();
  CHECK_THROWS_AS(codec.encode(initial, frame), InternalError);

  // Field 4 of Velocities (tag 0x22) with 16 bytes: two numbers are no vector. time_step comes first (field 3, tag
  // 0x19).
  std::vector<std::byte> payload;
  for (const int byte : {0x10, 1, 0x19}) payload.push_back(static_cast<std::byte>(byte));
  for (const std::byte byte : std::bit_cast<std::array<std::byte, 8>>(1e-5)) payload.push_back(byte);
  for (const int byte : {0x22, 16}) payload.push_back(static_cast<std::byte>(byte));
  payload.resize(payload.size() + 16);
  CHECK_THROWS_WITH(Codec().decode(frame_of_payload(MessageType::Velocities, payload)),
                    Contains("Velocities.velocity with 2 numbers, not a multiple of 3"));
}

TEST_CASE("facets must be made of nodes that exist") {
  std::vector<std::byte> frame = frame_of(flat_interface(2, 2));  // nodes 0 to 8
  const std::array<std::byte, 4> last = {std::byte{4}, std::byte{5}, std::byte{8}, std::byte{7}};
  const auto at = std::search(frame.begin(), frame.end(), last.begin(), last.end());
  REQUIRE(at != frame.end());
  at[2] = std::byte{9};
  write_header(frame, type_of(frame));
  CHECK_THROWS_WITH(Codec().decode(frame),
                    Contains("InitialStress.facets[3], corner 2, = 9 is not a node; there are 9"));
}

TEST_CASE("enums out of range and a time step that is not above zero are refused") {
  for (const double bad : {0.0, -1e-5}) {
    CHECK_THROWS_WITH(Codec().decode(with_number(frame_of(some_velocities(3)), 1.25e-5, bad)),
                      Contains("Velocities.time_step") && Contains("not above zero"));
  }
  // Velocities.stage is field 2 (tag 0x10), Hello.role field 3 (tag 0x18).
  CHECK_THROWS_WITH(Codec().decode(frame_of_payload(MessageType::Velocities, {std::byte{0x10}, std::byte{7}})),
                    Contains("Velocities.stage = 7"));
  CHECK_THROWS_WITH(Codec().decode(frame_of_payload(MessageType::Velocities, {})), Contains("Velocities.stage = 0"));
  CHECK_THROWS_WITH(Codec().decode(frame_of_payload(MessageType::Hello, {std::byte{0x18}, std::byte{9}})),
                    Contains("Hello.role = 9"));
  CHECK_THROWS_WITH(Codec().decode(frame_of_payload(MessageType::Finish, {std::byte{0xff}})),
                    Contains("Finish of 1 bytes that is not a Finish of coupling.proto"));
}

TEST_CASE("a mutated frame is refused as the peer's fault or decodes, and never crashes") {
  Random random(20);
  std::vector<std::vector<std::byte>> frames;
  for (const Message& message : one_of_each()) frames.push_back(frame_of(message));
  std::size_t decoded = 0, refused = 0, other = 0;
  for (int round = 0; round < 20'000; ++round) {
    std::vector<std::byte> frame = frames[random.next() % frames.size()];
    const std::size_t changes = 1 + random.next() % 4;
    for (std::size_t i = 0; i < changes; ++i) {
      switch (random.next() % 4) {
        case 0:
          frame[random.next() % frame.size()] ^= static_cast<std::byte>(1 << random.next() % 8);
          break;
        case 1:
          frame[random.next() % frame.size()] = static_cast<std::byte>(random.next() & 0xff);
          break;
        case 2:
          frame.resize(std::max(header_size, random.next() % (frame.size() + 1)));
          break;
        case 3:
          frame.insert(frame.begin() + static_cast<std::ptrdiff_t>(random.next() % frame.size()), std::byte{0xff});
          break;
      }
    }
    // Most mutants get a right header, so that they reach the decoder; the others try the header.
    if (random.next() % 4 != 0) write_header(frame, static_cast<MessageType>(random.next() % message_types));
    try {
      const FrameHeader header = read_header(std::span(frame).first(header_size), limits_for_mesh(5, 2));
      check_payload(header, payload_of(frame));
      Codec codec;
      codec.decode(frame);
      ++decoded;
    } catch (const PeerError&) {
      ++refused;
    } catch (const std::exception& error) {
      UNSCOPED_INFO(error.what());
      ++other;
    }
  }
  INFO(decoded << " decoded, " << refused << " refused, " << other << " failed otherwise");
  CHECK(other == 0);
  CHECK(decoded > 100);
  CHECK(refused > 1000);
}
