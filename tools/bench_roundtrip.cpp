// How long one exchange of Velocities and Forces takes, both solvers' work left out: two processes, TCP on this
// machine, the whole path (check, encode, checksum, send, receive, checksum, decode, check, each way).
//
//   bench_roundtrip [nodes] [round trips]        default 770 5000, a pile scene's interface
//
// Prints one line: times of a round trip in microseconds, and a hash of the forces received (another hash is another
// answer).
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "tests/protocol/session_fixture.hpp"

using namespace lockstep;
using namespace lockstep::protocol;

namespace {

// Answers every velocity by a force of -1000 N s/m times it.
int run_grains(std::uint16_t port) {
  Session session(connect_tcp("127.0.0.1", port, within(10)), Role::Grains, {});
  const InitialStress initial = open_as_grains(session);
  Velocities velocities;
  Forces forces;
  forces.force.resize(initial.nodes.size());
  forces.stable_step = 1e-4;
  while (session.receive_or_finish(velocities)) {
    for (std::size_t i = 0; i < forces.force.size(); ++i) forces.force[i] = -1000 * velocities.velocity[i];
    forces.step = velocities.step;
    session.send(forces);
  }
  session.send(Finish{session.finish().step, "done"});
  return 0;
}

}  // namespace

int main(int argument_count, char** arguments) {
  const int nodes = argument_count > 1 ? std::atoi(arguments[1]) : 770;
  const int rounds = argument_count > 2 ? std::atoi(arguments[2]) : 5000;
  constexpr int warm_up = 200;
  if (nodes < 4 || nodes % 2 != 0 || rounds < 1) {
    std::fprintf(stderr, "bench_roundtrip: nodes must be even and at least 4, round trips at least 1\n");
    return 1;
  }

  TcpListener listener;
  const pid_t peer = fork();
  if (peer == 0) _exit(run_grains(listener.port()));
  Session session(listener.accept(within(10)), Role::Continuum, {});
  open_as_continuum(session, flat_interface(nodes / 2 - 1, 1));

  Velocities velocities;
  velocities.stage = Stage::Penetrate;
  velocities.time_step = 1e-5;
  velocities.velocity.resize(static_cast<std::size_t>(nodes));
  Forces forces;
  Hash hash;
  std::vector<double> microseconds;
  std::uint64_t bytes = 0;
  for (int round = -warm_up; round < rounds; ++round) {
    velocities.step = static_cast<std::uint64_t>(round + warm_up);
    for (int i = 0; i < nodes; ++i)
      velocities.velocity[static_cast<std::size_t>(i)] = Vec3(1e-3 * i, 1e-6 * round, 0.1);
    bytes = session.bytes_sent();
    const auto begin = std::chrono::steady_clock::now();
    session.send(velocities);
    session.receive(forces);
    const auto end = std::chrono::steady_clock::now();
    if (round >= 0) microseconds.push_back(std::chrono::duration<double, std::micro>(end - begin).count());
    hash.add(std::span<const Vec3>(forces.force));
  }
  bytes = session.bytes_sent() - bytes;
  session.send(Finish{velocities.step + 1, "done"});
  session.receive<Finish>();
  int status = 0;
  waitpid(peer, &status, 0);

  std::sort(microseconds.begin(), microseconds.end());
  const auto quantile = [&](double q) {
    return microseconds[static_cast<std::size_t>(q * static_cast<double>(microseconds.size() - 1))];
  };
  std::printf(
      "bench_roundtrip nodes=%d rounds=%d frame_bytes=%llu median_us=%.1f p90_us=%.1f p99_us=%.1f hash=%016llx\n",
      nodes, rounds, static_cast<unsigned long long>(bytes), quantile(0.5), quantile(0.9), quantile(0.99),
      static_cast<unsigned long long>(hash.value()));
  return status == 0 ? 0 : 1;
}
