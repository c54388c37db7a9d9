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

// Runs a scene with both sides in this process; the first error of either side is thrown on.
inline Reports run_both(const SceneFile& scene) {
  auto [server, client] = protocol::make_loopback();
  Reports reports;
  std::exception_ptr grains_failed, zones_failed;
  std::thread grains([&, channel = std::move(server)]() mutable {
    try {
      reports.grains = dem::run_grains(scene, std::move(channel), {});
    } catch (...) {
      grains_failed = std::current_exception();
    }
  });
  try {
    reports.zones = continuum::run_continuum(scene, {}, std::move(client), {});
  } catch (...) {
    zones_failed = std::current_exception();
  }
  grains.join();
  if (grains_failed) std::rethrow_exception(grains_failed);
  if (zones_failed) std::rethrow_exception(zones_failed);
  return reports;
}

}  // namespace lockstep
