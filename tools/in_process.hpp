// Both solvers in this process, over the in-memory channel.
#pragma once
#include <exception>
#include <thread>
#include <utility>

#include "common/scene.hpp"
#include "continuum_client/stages.hpp"
#include "dem_server/stages.hpp"
#include "protocol/loopback_channel.hpp"

namespace lockstep {

struct Reports {
  dem::RunReport grains;
  continuum::RunReport zones;
};

// How both sides ended: a report of each that came to its end, the error of each that did not.
struct Outcome {
  Reports reports;
  std::exception_ptr grains_failed, zones_failed;
};

// Runs a scene with both sides in this process.
inline Outcome try_both(const SceneFile& scene, const dem::RunOptions& grains_options = {}) {
  auto [server, client] = protocol::make_loopback();
  Outcome o;
  std::thread grains([&, channel = std::move(server)]() mutable {
    try {
      o.reports.grains = dem::run_grains(scene, std::move(channel), grains_options);
    } catch (...) {
      o.grains_failed = std::current_exception();
    }
  });
  try {
    o.reports.zones = continuum::run_continuum(scene, {}, std::move(client), {});
  } catch (...) {
    o.zones_failed = std::current_exception();
  }
  grains.join();
  return o;
}

// The same; the first error of either side is thrown on.
inline Reports run_both(const SceneFile& scene) {
  Outcome o = try_both(scene);
  if (o.grains_failed) std::rethrow_exception(o.grains_failed);
  if (o.zones_failed) std::rethrow_exception(o.zones_failed);
  return std::move(o.reports);
}

}  // namespace lockstep
