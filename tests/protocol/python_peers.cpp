// The smallest peers in another language speak the same contract, against each other and against this code.
#include <sys/wait.h>

#include <catch2/catch.hpp>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "tests/protocol/session_fixture.hpp"

using namespace lockstep;
using namespace lockstep::protocol;

namespace {

const std::string python = "/usr/bin/python3 -B " SOURCE_DIR "/tools/";

// A program whose standard output is read here.
struct Program {
  explicit Program(const std::string& command) : output(::popen(command.c_str(), "r")) { REQUIRE(output != nullptr); }
  ~Program() {
    if (output) ::pclose(output);
  }
  std::string line() {
    char text[256] = {};
    return std::fgets(text, sizeof text, output) ? text : "";
  }
  int exit_code() {
    const int status = ::pclose(output);
    output = nullptr;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  std::FILE* output;
};

int port_of(const std::string& line) { return std::atoi(line.substr(line.rfind(':') + 1).c_str()); }

}  // namespace

TEST_CASE("the two Python peers run a whole session and find the discrete solution of a mass on a spring") {
  Program grains(python + "peer_grains.py");
  const int port = port_of(grains.line());
  REQUIRE(port > 0);
  // The continuum peer compares its motion with leap-frog's exact solution and exits with 4 if it differs.
  const int status = std::system((python + "peer_continuum.py --steps 100 " + std::to_string(port)).c_str());
  CHECK(status == 0);
  CHECK(grains.exit_code() == 0);
}

TEST_CASE("a Python peer accepts this code's frames and agrees on every position hash") {
  Program grains(python + "peer_grains.py --stiffness 2e6");
  const auto port = static_cast<std::uint16_t>(port_of(grains.line()));
  Session session(connect_tcp("127.0.0.1", port, within(60)), Role::Continuum, {});
  Hello hello = hello_of(Role::Continuum);
  session.shake_hands(hello);
  InitialStress initial = flat_interface(3, 2);
  session.send(initial);
  CHECK(session.receive<Balance>().traction == initial.traction);
  session.send(ContinuumExcavated{0, 0, 0, hash_of(initial.nodes), {}});
  const GrainsExcavated excavated = session.receive<GrainsExcavated>();
  CHECK(excavated.position_hash == hash_of(initial.nodes));

  // A spring of 2e6 N/m under a node that sinks at 0.3 m/s: F_z(n) = F_z(0) - k z(n), z(n) summed as the peers sum it.
  // A corner node carries a quarter of one facet, 0.01 m2 at 10 kPa.
  Velocities velocities;
  velocities.stage = Stage::Penetrate;
  velocities.velocity.assign(initial.nodes.size(), Vec3(1e-3, 0, -0.3));
  Forces forces;
  Vec3s x = initial.nodes;
  double time_step = 0, worst = 0;
  for (velocities.step = 0; velocities.step < 20; ++velocities.step) {
    for (std::size_t i = 0; i < x.size(); ++i) x[i] += velocities.velocity[i] * time_step;
    velocities.time_step = time_step = 1e-5 * (1 + static_cast<double>(velocities.step % 3));
    velocities.position_hash = hash_of(x);
    session.send(velocities);
    session.receive(forces);
    worst = std::max(worst, std::abs(forces.force[0].z() - (-25.0 - 2e6 * x[0].z())));
  }
  INFO("largest error " << worst << " N of a force of " << forces.force[0].z() << " N");
  CHECK(worst < 1e-9);
  session.send(Finish{20, "done"});
  session.receive<Finish>();
  CHECK(grains.exit_code() == 0);
}
