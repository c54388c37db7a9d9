// continuum_client: the ground of a coupled run, an elastic brick with a hole full of grains.
//
//   z = 0  ____________________
//         |      : | | :      |      The zones (explicit finite differences) fill the brick around and below the hole;
//         | zones: |#| :zones |      the grains in it, and the pile that is pushed into them, belong to dem_server.
//         |      :.|_|.:      |      At each time step this program sends the velocities of the hole's walls and
//         |      :o8o8o:      |      receives the forces that the grains press on them with.
//         |      :8o8o8:      |
//         |      '''''''      |      # pile   o 8 grains   : . interface
//         |____________________|
//
// It connects to a dem_server that listens. In two terminals:
//   dem_server scenarios/grain_on_block --listen 127.0.0.1:4711
//   continuum_client scenarios/grain_on_block --connect 127.0.0.1:4711 --results out
// Any program that speaks protocol/coupling.proto may take the server's place.
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <chrono>
#include <iostream>

#include "common/checks.hpp"
#include "common/interrupt.hpp"
#include "common/log.hpp"
#include "common/results.hpp"
#include "common/scene.hpp"
#include "continuum_client/settings.hpp"
#include "continuum_client/stages.hpp"
#include "protocol/tcp_channel.hpp"

namespace {

using namespace lockstep;

struct Address {
  std::string host;
  std::uint16_t port = 0;
};

Address parse_address(const std::string& text) {
  const auto colon = text.rfind(':');
  Address a;
  if (colon != std::string::npos && colon > 0) {
    a.host = text.substr(0, colon);
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data() + colon + 1, end, a.port);
    if (error == std::errc() && stop == end && a.port > 0) return a;
  }
  throw InputError(
      fmt::format("--connect {}: expected HOST:PORT with a port from 1 to 65535, such as 127.0.0.1:40000", text));
}

int run(const std::string& scene_path, const std::vector<std::string>& overrides, const std::string& address,
        const std::string& results, const continuum::RunOptions& options) {
  const SceneFile scene = read_scene(scene_path, overrides);
  continuum::read_settings(scene);  // what is wrong with the scene or the folder is said before a peer is involved
  if (!results.empty()) prepare_folder(results);
  std::unique_ptr<protocol::Channel> channel;
  if (!address.empty() && !scene.scene.has_grains())  // before it waits for someone who will never come
    throw InputError(fmt::format("{}: the scene has no grains, so there is no peer to connect to; leave --connect out",
                                 scene.path.string()));
  if (!address.empty()) {
    const Address a = parse_address(address);
    const auto patience = std::chrono::duration<double>(scene.scene.coupling().connect_timeout());
    channel = protocol::connect_tcp(
        a.host, a.port,
        std::chrono::steady_clock::now() + std::chrono::duration_cast<std::chrono::steady_clock::duration>(patience));
  } else if (scene.scene.has_grains()) {
    throw InputError(fmt::format("{}: the scene has grains; say where dem_server listens with --connect HOST:PORT",
                                 scene.path.string()));
  }
  const continuum::RunReport report = continuum::run_continuum(scene, results, std::move(channel), options);
  // An interrupt may come in the very step with which the grains end the run.
  const bool is_interrupted = report.is_interrupted || interrupt_requested();
  return static_cast<int>(is_interrupted ? ExitCode::Interrupted : ExitCode::Success);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"The ground of a coupled run: explicit finite differences around a hole full of grains (dem_server)."};
  app.footer(
      "Examples:\n"
      "  continuum_client scenarios/grain_on_block --connect 127.0.0.1:4711 --results runs/by_hand\n"
      "  continuum_client scenarios/grain_on_block --connect 127.0.0.1:4711 --set run.duration=0.1 --set seed=7\n"
      "  continuum_client --keys         (every key of a scene with unit, default and range)\n"
      "Exit codes: 0 done, 1 input, 2 file or port, 3 peer or protocol, 4 numerical, 5 internal, 130 interrupted.");
  std::string scene, address, results, log;
  std::vector<std::string> overrides;
  bool is_verbose = false, lists_keys = false;
  continuum::RunOptions options;
  app.add_option("SCENE", scene, "scene file, or a folder with scene.txt");
  app.add_option("--connect", address, "HOST:PORT of dem_server; not for scenes without grains");
  app.add_option("--results", results, "folder for result files; none are written without it");
  app.add_option("--set", overrides, "KEY=VALUE, overrides a key of the scene; give the peer the same")
      ->allow_extra_args(false);
  app.add_option("--log", log, "file for the full log");
  app.add_flag("--verbose", is_verbose, "more on the console");
  app.add_option("--record", options.record_path, "file for every frame sent and received");
  app.add_option("--threads", options.threads, "of the cycle; the results do not depend on it")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_flag("--progress", options.prints_progress,
               "\"@progress key=value ...\" lines on standard output, as tools/run reads them");
  app.add_flag("--keys", lists_keys, "list every key of a scene and stop");
  app.set_version_flag("--version", [] { return fmt::format("continuum_client {}", lockstep_version()); });
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return static_cast<int>(app.exit(e) == 0 ? ExitCode::Success : ExitCode::Input);
  }
  try {
    if (lists_keys) {
      std::cout << list_keys();
      return 0;
    }
    start_log("continuum_client", {}, is_verbose);  // errors before the log file is open go to the console
    if (scene.empty()) throw InputError("no scene: say continuum_client SCENE, or --help");
    if (!log.empty()) start_log("continuum_client", log, is_verbose);
    install_interrupt_handlers();
    return run(scene, overrides, address, results, options);
  } catch (const Error& e) {
    spdlog::error("{}", e.what());
    return static_cast<int>(e.code());
  } catch (const std::exception& e) {
    spdlog::error("internal error: {}", e.what());
    return static_cast<int>(ExitCode::Internal);
  }
}
