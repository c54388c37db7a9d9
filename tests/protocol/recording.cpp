#include "protocol/recording.hpp"

#include <unistd.h>

#include <catch2/catch.hpp>
#include <filesystem>
#include <thread>

#include "common/checks.hpp"
#include "protocol/codec.hpp"
#include "tests/protocol/session_fixture.hpp"

using namespace lockstep;
using namespace lockstep::protocol;
using Catch::Matchers::Contains;

namespace {

struct TemporaryFile {
  explicit TemporaryFile(const std::string& name)
      : path(std::filesystem::temp_directory_path() / fmt::format("lockstep_{}_{}", ::getpid(), name)) {}
  ~TemporaryFile() { std::filesystem::remove(path); }
  std::filesystem::path path;
};

// Three exchanges of a plate that the grains slow down: v += gain F.
Vec3 run_continuum(Session& session, double gain) {
  const InitialStress initial = flat_interface(2, 2);
  open_as_continuum(session, initial);
  Velocities v;
  v.time_step = 1e-5;
  v.velocity.assign(initial.nodes.size(), Vec3(0, 0, 0.1));
  Forces forces;
  for (v.step = 0; v.step < 3; ++v.step) {
    session.heartbeat("cycling", 0.1);
    session.send(v);
    session.receive(forces);
    for (std::size_t i = 0; i < v.velocity.size(); ++i) v.velocity[i] += gain * forces.force[i];
  }
  session.send(Finish{3, "done"});
  session.receive<Finish>();
  return v.velocity[0];
}

void run_grains(Session& session) {
  const InitialStress initial = open_as_grains(session);
  Velocities v;
  Forces forces;
  forces.force.resize(initial.nodes.size());
  while (session.receive_or_finish(v)) {
    forces.step = v.step;
    for (std::size_t i = 0; i < forces.force.size(); ++i) forces.force[i] = -10 * v.velocity[i];
    session.send(forces);
  }
  session.send(Finish{session.finish().step, "done"});
}

Vec3 record(const std::filesystem::path& path) {
  auto [client_end, server_end] = make_loopback();
  std::thread grains([end = std::move(server_end)]() mutable {
    Session session(std::move(end), Role::Grains, {});
    run_grains(session);
  });
  SessionSettings settings;
  settings.record_path = path.string();
  settings.progress_interval = std::chrono::milliseconds(0);
  Session session(std::move(client_end), Role::Continuum, settings);
  const Vec3 result = run_continuum(session, 0.01);
  grains.join();
  return result;
}

}  // namespace

TEST_CASE("a recording holds every frame of both directions in order") {
  TemporaryFile file("all_frames");
  record(file.path);
  Recording recording(file.path);
  RecordedFrame frame;
  std::string order;
  std::uint64_t last = 0;
  while (recording.next(frame)) {
    if (type_of(frame.frame) == MessageType::Progress) continue;
    order += static_cast<char>(frame.direction);
    order += "HIBCGVFPRSXA"[static_cast<std::size_t>(type_of(frame.frame))];
    CHECK(frame.nanoseconds >= last);
    last = frame.nanoseconds;
  }
  CHECK(order == ">H<H>I<B>C<G>V<F>V<F>V<F>X<X");
  CHECK_FALSE(recording.is_truncated());
}

TEST_CASE("either side can be replayed alone from one recording, to the same bits") {
  TemporaryFile file("replay");
  const Vec3 original = record(file.path);
  Session continuum(std::make_unique<ReplayChannel>(file.path), Role::Continuum, {});
  const Vec3 replayed = run_continuum(continuum, 0.01);
  CHECK(replayed == original);
  Session grains(std::make_unique<ReplayChannel>(file.path, Direction::Received), Role::Grains, {});
  CHECK_NOTHROW(run_grains(grains));
}

TEST_CASE("a replay reports the first difference with frame and field") {
  TemporaryFile file("difference");
  record(file.path);
  Session session(std::make_unique<ReplayChannel>(file.path), Role::Continuum, {});
  // Velocities of 0.1 m/s meet forces of -1 N: 0.1 - 0.01 m/s were recorded for the second exchange, 0.1 - 0.02 m/s
  // come.
  CHECK_THROWS_WITH(run_continuum(session, 0.02),
                    Contains("Velocities differs from what was sent") && Contains("velocity[2]: 0.09"));
}

TEST_CASE("a recording cut short ends before the cut, a damaged one is an error") {
  TemporaryFile file("cut");
  record(file.path);
  const auto size = std::filesystem::file_size(file.path);
  const auto count = [&] {
    Recording recording(file.path);
    RecordedFrame frame;
    std::size_t frames = 0;
    while (recording.next(frame)) ++frames;
    return std::pair(frames, recording.is_truncated());
  };
  const std::size_t whole = count().first;
  std::filesystem::resize_file(file.path, size - 1);
  CHECK(count() == std::pair(whole - 1, true));
  {
    std::fstream damaged(file.path, std::ios::in | std::ios::out | std::ios::binary);
    damaged.seekp(8 + 9 + 16 + 2);
    damaged.put('\xff');
  }
  CHECK_THROWS_WITH(count(), Contains("is damaged: Hello"));
  CHECK_THROWS_AS(Recording("/nowhere/recording"), IoError);
  CHECK_THROWS_AS(Recorder("/nowhere/recording"), IoError);
}
