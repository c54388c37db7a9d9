// Two sides of a session for tests and benchmarks: a flat interface, and both openings up to the first Velocities.
#pragma once
#include <chrono>
#include <memory>
#include <string>
#include <utility>

#include "common/hash.hpp"
#include "protocol/loopback_channel.hpp"
#include "protocol/session.hpp"
#include "protocol/tcp_channel.hpp"

namespace lockstep::protocol {

inline Deadline within(double seconds) {
  return std::chrono::steady_clock::now() + std::chrono::milliseconds(static_cast<long>(1000 * seconds));
}

inline Hello hello_of(Role role) {
  Hello hello;
  hello.role = role;
  hello.solver = role == Role::Continuum ? "test_continuum" : "test_grains";
  hello.solver_version = "0.1";
  hello.capabilities = {"progress"};
  hello.scene_digest = "5ce7e";
  return hello;
}

// columns x rows facets of 0.1 m, normal up, under 10 kPa.
inline InitialStress flat_interface(int columns, int rows) {
  InitialStress initial;
  for (int j = 0; j <= rows; ++j) {
    for (int i = 0; i <= columns; ++i) initial.nodes.emplace_back(0.1 * i, 0.1 * j, 0.0);
  }
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const int corner = j * (columns + 1) + i;
      initial.facets.push_back({corner, corner + 1, corner + columns + 2, corner + columns + 1});
      initial.ring.push_back(-1);
      initial.traction.emplace_back(0, 0, -10e3);
      initial.stress.push_back((Voigt() << -5e3, -5e3, -10e3, 0, 0, 0).finished());
    }
  }
  initial.profile = {{-1, -16e3, -8e3}, {0, 0, 0}};
  initial.gravity = Vec3(0, 0, -9.81);
  initial.bulk_density = 1630;
  return initial;
}

inline std::uint64_t hash_of(const Vec3s& positions) {
  Hash hash;
  hash.add(std::span<const Vec3>(positions));
  return hash.value();
}

// From the connection to just before the first Velocities.
inline void open_as_continuum(Session& session, const InitialStress& initial) {
  session.shake_hands(hello_of(Role::Continuum));
  session.send(initial);
  session.receive<Balance>();
  session.send(ContinuumExcavated{1, 0.0, 1e-4, hash_of(initial.nodes), {}});
  session.receive<GrainsExcavated>();
}

inline InitialStress open_as_grains(Session& session) {
  session.shake_hands(hello_of(Role::Grains));
  const InitialStress initial = session.receive<InitialStress>();
  session.send(Balance{initial.traction, 0.37, 1e-4, 1000, 3000});
  session.receive<ContinuumExcavated>();
  GrainsExcavated excavated;
  excavated.offset.assign(initial.nodes.size(), Vec3::Zero());
  excavated.node_stiffness.assign(initial.nodes.size(), 1e6);
  excavated.nodal_force.assign(initial.nodes.size(), Vec3(0, 0, -100));
  excavated.stable_step = 1e-4;
  excavated.position_hash = hash_of(initial.nodes);
  session.send(excavated);
  return initial;
}

// {continuum's end, grains' end}
using ChannelPair = std::pair<std::unique_ptr<Channel>, std::unique_ptr<Channel>>;

inline ChannelPair make_tcp_pair() {
  TcpListener listener;
  std::unique_ptr<Channel> client = connect_tcp("127.0.0.1", listener.port(), within(10));
  return {std::move(client), listener.accept(within(10))};
}

}  // namespace lockstep::protocol
