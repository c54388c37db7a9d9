// dem_server: the grains of a coupled run.
//
//   continuum_client                               dem_server
//   the elastic ground around      velocities      grains as rigid clumps,
//   the grains: zones         ------------------>  the pile, contacts with
//                             <-----------------   the interface's facets
//                                    forces
//
// It listens; the continuum client connects. In two terminals:
//   dem_server scenarios/grain_on_block --listen 127.0.0.1:4711
//   continuum_client scenarios/grain_on_block --connect 127.0.0.1:4711
// Any program that speaks protocol/coupling.proto may take the client's place. A scene that has grains alone runs here
// from beginning to end:
//   dem_server scenarios/pressed_cube
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <thread>

#include "common/checks.hpp"
#include "common/interrupt.hpp"
#include "common/log.hpp"
#include "common/results.hpp"
#include "common/scene.hpp"
#include "dem_server/packing_file.hpp"
#include "dem_server/settings.hpp"
#include "dem_server/stages.hpp"
#include "protocol/tcp_channel.hpp"

namespace {

constexpr const char* examples = R"(Examples:
  dem_server scenarios/pile_quick --listen 127.0.0.1:4711 --results runs/by_hand
  dem_server scenarios/pile_quick --listen 127.0.0.1:0          (takes a free port and prints it)
  dem_server scenarios/pile_quick --listen 127.0.0.1:0 --set fidelity.pile_velocity=0.5 --set seed=7
  dem_server scenarios/pile_quick --listen 127.0.0.1:0 --packing pile.packing        (writes the balanced packing; the next run takes it)
  dem_server scenarios/pressed_cube --results runs/cube         (grains alone: no peer, no port)
  dem_server --keys                                             (every key of a scene with unit, default and range)
Exit codes: 0 done, 1 wrong input, 2 file or port, 3 peer, 4 numerical, 5 internal, 130 interrupted.)";

struct Arguments {
  std::string scene;
  std::string listen;  // empty: the grains are alone
  std::string results, log, record, packing;
  int threads = 1;
  std::vector<std::string> overrides;
  bool verbose = false, progress = false, keys = false, version = false;
};

// "host:port" or "port".
std::pair<std::string, std::uint16_t> split_address(const std::string& text) {
  const auto colon = text.rfind(':');
  const std::string host = colon == std::string::npos ? "127.0.0.1" : text.substr(0, colon);
  const std::string port = colon == std::string::npos ? text : text.substr(colon + 1);
  if (port.empty() || port.find_first_not_of("0123456789") != std::string::npos || port.size() > 5 ||
      std::stoul(port) > 65535)
    throw lockstep::InputError(
        fmt::format("--listen {}: the port must be a number from 0 to 65535; try --listen 127.0.0.1:0", text));
  return {host, static_cast<std::uint16_t>(std::stoul(port))};
}

// Beyond these a packing of tens of thousands of grains has too little work for each.
constexpr int most_balance_threads = 16;

int cores() { return static_cast<int>(std::thread::hardware_concurrency()); }

int run(const Arguments& arguments) {
  using namespace lockstep;
  const SceneFile scene = read_scene(arguments.scene, arguments.overrides);
  // What is wrong with the scene or its packing is said before a port is opened.
  const dem::Settings settings = dem::make_settings(scene);
  if (!arguments.packing.empty()) dem::open_packing(arguments.packing, settings.packing_keys);
  if (!arguments.results.empty()) prepare_folder(arguments.results);
  dem::check_company(settings, !arguments.listen.empty(), scene);
  std::unique_ptr<protocol::Channel> channel;
  if (!arguments.listen.empty()) {
    const auto [host, port] = split_address(arguments.listen);
    protocol::TcpListener listener(host, port);
    std::printf("listening on %s:%u\n", listener.address().c_str(), static_cast<unsigned>(listener.port()));
    std::fflush(stdout);
    const auto patience = std::chrono::milliseconds(std::llround(1000 * scene.scene.coupling().connect_timeout()));
    channel = listener.accept(std::chrono::steady_clock::now() + patience);
  }
  dem::RunOptions options;
  options.results = arguments.results;
  options.record_path = arguments.record;
  options.prints_progress = arguments.progress;
  options.packing = arguments.packing;
  options.threads = arguments.threads;
  // The peer waits while the packing is made, or there is none: its cores are free.
  options.balance_threads = std::max(arguments.threads, std::clamp(cores(), 1, most_balance_threads));
  const dem::RunReport report = dem::run_grains(scene, std::move(channel), options);
  return static_cast<int>(report.is_interrupted || interrupt_requested() ? ExitCode::Interrupted : ExitCode::Success);
}

}  // namespace

int main(int argc, char** argv) {
  using namespace lockstep;
  Arguments arguments;
  CLI::App app(
      "Lockstep's discrete elements: listens for a continuum client and runs a scene with it, or runs grains alone.");
  app.footer(examples);
  app.add_option("scene", arguments.scene, "scene file, or a folder with scene.txt");
  app.add_option(
      "--listen", arguments.listen,
      "HOST:PORT for the continuum client; port 0 takes a free one and prints it; not for scenes without continuum");
  app.add_option("--results", arguments.results,
                 "folder for histories, ParaView files and summary; none: nothing is written");
  app.add_option("--set", arguments.overrides, "KEY=VALUE, overrides a key of the scene; give the peer the same")
      ->allow_extra_args(false);
  app.add_option("--log", arguments.log, "file for the full log");
  app.add_option("--packing", arguments.packing,
                 "file of the balanced packing: taken from it, or written to it when it does not exist yet");
  app.add_option("--threads", arguments.threads,
                 "of the grains from Apply on (Balance uses all cores); the results do not depend on it")
      ->capture_default_str()
      ->check(CLI::Range(1, 256));
  app.add_option("--record", arguments.record, "file that every frame is recorded in");
  app.add_flag("--verbose", arguments.verbose, "debug messages on the console too");
  app.add_flag("--progress", arguments.progress,
               "\"@progress key=value ...\" lines on standard output, as tools/run reads them");
  app.add_flag("--keys", arguments.keys, "list every key of a scene and end");
  app.add_flag("--version", arguments.version, "print the version and end");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : static_cast<int>(ExitCode::Input);
  }
  if (arguments.version || arguments.keys) {
    std::printf("%s\n", arguments.keys ? list_keys().c_str() : ("dem_server " + lockstep_version()).c_str());
    return 0;
  }
  try {
    start_log("dem_server", {}, arguments.verbose);  // errors before the log file is open go to the console
    if (arguments.scene.empty())
      throw InputError("no scene given; try: dem_server scenarios/grain_on_block --listen 127.0.0.1:0");
    if (!arguments.log.empty()) start_log("dem_server", arguments.log, arguments.verbose);
    install_interrupt_handlers();
    return run(arguments);
  } catch (const Error& error) {
    spdlog::error("{}", error.what());
    return static_cast<int>(error.code());
  } catch (const std::exception& error) {
    spdlog::critical("internal error: {}; please report it with the log", error.what());
    return static_cast<int>(ExitCode::Internal);
  }
}
