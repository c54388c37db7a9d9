// The two programs as processes of their own, over TCP: what they compute together, and what each says and does when
// the other, the scene or the command line fails it. Long scenes here are runs of 1000 s of ground time, millions of
// steps, which nothing but the event under test ends.
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <chrono>
#include <cmath>
#include <csignal>
#include <fstream>
#include <mutex>
#include <regex>
#include <span>
#include <sstream>
#include <thread>

#include "protocol/codec.hpp"
#include "protocol/framing.hpp"
#include "tests/coupled/coupled_fixture.hpp"

namespace lockstep::coupled {
namespace {

namespace fs = std::filesystem;
using Catch::Matchers::Contains;
using Clock = std::chrono::steady_clock;
using Words = std::vector<std::string>;
using namespace std::chrono_literals;

constexpr auto patience = 30s;         // with what takes a fraction of a second on an idle machine
constexpr auto look_again = 5ms;       // between two looks at a process
constexpr int killed = 128 + SIGKILL;  // exit code of a killed process, as a shell gives it
constexpr int exit_input = 1, exit_io = 2, exit_peer = 3, exit_interrupted = 130;

const std::string dem_server = BINARY_DIR "/bin/dem_server";
const std::string continuum_client = BINARY_DIR "/bin/continuum_client";

Words operator+(Words a, const Words& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

std::string content_of(const fs::path& path) {
  std::ifstream file(path);
  INFO(path);
  REQUIRE(file.good());
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

// The first group of the first match; empty if there is none.
std::string find(const std::string& text, const std::string& pattern) {
  std::smatch match;
  return std::regex_search(text, match, std::regex(pattern)) ? match.str(match.size() > 1 ? 1 : 0) : std::string();
}

// A folder that goes with its test.
class Folder {
 public:
  Folder() {
    std::string name = (fs::temp_directory_path() / "lockstep_test_XXXXXX").string();
    REQUIRE(::mkdtemp(name.data()) != nullptr);
    path_ = name;
  }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  fs::path operator/(const std::string& name) const { return path_ / name; }
  const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

// A program that runs: its words are collected while it does, and it does not outlive this object.
class Process {
 public:
  explicit Process(const Words& command, const fs::path& folder = SOURCE_DIR) : name_(command.front()) {
    std::vector<char*> arguments;
    for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    std::array<int, 2> out{}, err{};
    REQUIRE(::pipe2(out.data(), O_CLOEXEC) == 0);
    REQUIRE(::pipe2(err.data(), O_CLOEXEC) == 0);
    const int nothing = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
    id_ = ::fork();
    if (id_ == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      if (::chdir(folder.c_str()) == 0 && ::dup2(nothing, 0) == 0 && ::dup2(out[1], 1) == 1 && ::dup2(err[1], 2) == 2)
        ::execv(arguments[0], arguments.data());
      ::_exit(127);
    }
    ::close(nothing), ::close(out[1]), ::close(err[1]);
    REQUIRE(id_ > 0);
    reader_ = std::thread([this, from = std::array{out[0], err[0]}] { collect(from); });
  }
  ~Process() {
    if (!has_ended_) {
      ::kill(id_, SIGKILL);
      ::waitpid(id_, nullptr, 0);
    }
    reader_.join();
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  void send(int signal) const { ::kill(id_, signal); }

  // Waits until it has said something that matches; returns the first group.
  std::string await(const std::string& pattern) {
    for (const auto deadline = Clock::now() + patience; Clock::now() < deadline;
         std::this_thread::sleep_for(look_again)) {
      const bool was_over = has_ended();
      if (const std::string found = find(out() + err(), pattern); !found.empty()) return found;
      if (was_over) break;
    }
    FAIL(name_ << " has not said \"" << pattern << "\" but\n" << out() << err());
    return {};
  }

  // Waits for its end; returns the exit code, or 128 + signal.
  int wait() {
    for (const auto deadline = Clock::now() + patience; !has_ended(); std::this_thread::sleep_for(look_again))
      if (Clock::now() >= deadline) FAIL(name_ << " does not end; it said\n" << out() << err());
    return WIFSIGNALED(status_) ? 128 + WTERMSIG(status_) : WEXITSTATUS(status_);
  }

  std::string out() const { return said(0); }
  std::string err() const { return said(1); }
  // Its last line on the error stream.
  std::string last_words() const {
    std::string text = err();
    while (!text.empty() && text.back() == '\n') text.pop_back();
    return text.substr(text.find_last_of('\n') + 1);
  }

 private:
  // From both pipes to their ends.
  void collect(std::array<int, 2> from) {
    std::array<char, 4096> buffer;
    for (std::array open{true, true}; open[0] || open[1];) {
      std::array<pollfd, 2> entries{pollfd{open[0] ? from[0] : -1, POLLIN, 0},
                                    pollfd{open[1] ? from[1] : -1, POLLIN, 0}};
      ::poll(entries.data(), entries.size(), -1);
      for (std::size_t k = 0; k < 2; ++k) {
        if (entries[k].revents == 0) continue;
        const ssize_t count = ::read(from[k], buffer.data(), buffer.size());
        const std::lock_guard lock(mutex_);
        if (count > 0) said_[k].append(buffer.data(), static_cast<std::size_t>(count));
        open[k] = count > 0;
      }
    }
    for (const int descriptor : from) ::close(descriptor);
    const std::lock_guard lock(mutex_);
    is_silent_ = true;
  }

  // True once it has ended and all its words are here.
  bool has_ended() {
    if (!has_ended_) has_ended_ = ::waitpid(id_, &status_, WNOHANG) == id_;
    const std::lock_guard lock(mutex_);
    return has_ended_ && is_silent_;
  }

  std::string said(std::size_t stream) const {
    const std::lock_guard lock(mutex_);
    return said_[stream];
  }

  std::string name_;
  pid_t id_ = -1;
  int status_ = 0;
  bool has_ended_ = false;
  std::thread reader_;
  mutable std::mutex mutex_;
  std::array<std::string, 2> said_;  // on standard output and error
  bool is_silent_ = false;
};

Words serving(const std::string& scene) { return {dem_server, scene, "--listen", "127.0.0.1:0"}; }
Words connecting(const std::string& scene, const std::string& address) {
  return {continuum_client, scene, "--connect", address};
}
std::string address_of(Process& grains) { return grains.await("listening on (\\S+)\n"); }

// Both programs on one scene, reporting their progress.
struct Pair {
  explicit Pair(const std::string& scene, const Words& both = {}, const Words& grains_only = {},
                const Words& zones_only = {})
      : grains(serving(scene) + Words{"--progress"} + both + grains_only),
        zones(connecting(scene, address_of(grains)) + Words{"--progress"} + both + zones_only) {}
  Process grains, zones;
};

const Words for_long = {"--set", "run.duration=1000"};
const std::string small_scene = "scenarios/grain_on_block";
const std::string slow_packing = "scenarios/pile_quick";
const std::string grains_alone = "scenarios/rolling_grain";

// A socket of a program that is no Lockstep solver.
class Socket {
 public:
  explicit Socket(int descriptor) : descriptor_(descriptor) { REQUIRE(descriptor_ >= 0); }
  ~Socket() { ::close(descriptor_); }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;

  int descriptor() const { return descriptor_; }
  void say(std::span<const std::byte> bytes) const {
    REQUIRE(::send(descriptor_, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size()));
  }
  void say(std::string_view text) const { say(std::as_bytes(std::span(text.data(), text.size()))); }

  // All that the other side sends before it hangs up.
  std::vector<std::byte> hear_out() const {
    std::vector<std::byte> all;
    std::array<std::byte, 4096> buffer;
    for (;;) {
      pollfd entry{descriptor_, POLLIN, 0};
      REQUIRE(::poll(&entry, 1, std::chrono::milliseconds(patience).count()) == 1);
      const ssize_t count = ::recv(descriptor_, buffer.data(), buffer.size(), 0);
      if (count <= 0) return all;
      all.insert(all.end(), buffer.begin(), buffer.begin() + count);
    }
  }

 private:
  int descriptor_;
};

sockaddr_in here(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

Socket connected_to(const std::string& address) {
  const int descriptor = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const sockaddr_in there = here(static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1))));
  REQUIRE(::connect(descriptor, reinterpret_cast<const sockaddr*>(&there), sizeof there) == 0);
  return Socket(descriptor);
}

// A port of this machine that a stranger holds.
class Port {
 public:
  Port() : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address = here(0);
    socklen_t size = sizeof address;
    REQUIRE(::bind(socket_.descriptor(), reinterpret_cast<const sockaddr*>(&address), size) == 0);
    REQUIRE(::listen(socket_.descriptor(), 1) == 0);
    REQUIRE(::getsockname(socket_.descriptor(), reinterpret_cast<sockaddr*>(&address), &size) == 0);
    address_ = fmt::format("127.0.0.1:{}", ntohs(address.sin_port));
  }
  const std::string& address() const { return address_; }
  Socket accept() const {
    pollfd entry{socket_.descriptor(), POLLIN, 0};
    REQUIRE(::poll(&entry, 1, std::chrono::milliseconds(patience).count()) == 1);
    return Socket(::accept4(socket_.descriptor(), nullptr, nullptr, SOCK_CLOEXEC));
  }

 private:
  Socket socket_;
  std::string address_;
};

std::vector<std::byte> frame_of(const protocol::Message& message) {
  std::vector<std::byte> frame;
  protocol::Codec().encode(message, frame);
  return frame;
}

// The peer's Abort, the last frame of what it sent.
protocol::Abort abort_in(std::span<const std::byte> bytes) {
  for (;;) {
    REQUIRE(bytes.size() >= protocol::header_size);
    const auto header = protocol::read_header(bytes.first(protocol::header_size), protocol::limits_before_hello());
    const std::size_t size = protocol::header_size + header.payload_size;
    REQUIRE(bytes.size() >= size);
    if (header.type == protocol::MessageType::Abort)
      return std::get<protocol::Abort>(protocol::Codec().decode(bytes.first(size)));
    bytes = bytes.subspan(size);
  }
}

// A copy of the small scene with one text in place of another.
std::string altered_scene(const Folder& folder, const std::string& from, const std::string& to) {
  std::string text = content_of(scenario("grain_on_block"));
  const auto at = text.find(from);
  REQUIRE(at != std::string::npos);
  const fs::path path = folder / "scene.txt";
  std::ofstream(path) << text.replace(at, from.size(), to);
  return path.string();
}

// Every number of a history is finite; returns the number of rows.
int rows_of(const fs::path& csv) {
  std::istringstream lines(content_of(csv));
  std::string line;
  REQUIRE(std::getline(lines, line));
  int rows = 0;
  for (; std::getline(lines, line); ++rows) {
    std::istringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) {
      INFO(csv << ": " << line);
      REQUIRE(std::isfinite(std::stod(cell)));
    }
  }
  return rows;
}

}  // namespace

TEST_CASE("two processes over TCP come to the same bits as both solvers in one process") {
  const std::string scene = GENERATE(as<std::string>(), "grain_on_block", "impact_on_block");
  CAPTURE(scene);
  const Folder folder;
  Pair pair("scenarios/" + scene, {"--results", folder.path().string()});
  CHECK(pair.zones.wait() == 0);
  CHECK(pair.grains.wait() == 0);
  const Reports r = run_in_process(scene);
  const std::string grains = content_of(folder / "dem_summary.json");
  const std::string zones = content_of(folder / "continuum_summary.json");
  const auto hash_in = [](const std::string& json, const std::string& key) {
    return find(json, "\"" + key + "\": \"([0-9a-f]{16})\"");
  };
  CHECK(hash_in(grains, "state_hash") == fmt::format("{:016x}", r.grains.state_hash));
  CHECK(hash_in(grains, "position_hash") == fmt::format("{:016x}", r.grains.position_hash));
  CHECK(hash_in(zones, "state_hash") == fmt::format("{:016x}", r.zones.state_hash));
  CHECK(hash_in(zones, "position_hash") == fmt::format("{:016x}", r.zones.position_hash));
  CHECK(find(grains, "\"steps\": (\\d+),\n  \"time_s\"") == std::to_string(r.grains.steps));
}

TEST_CASE("the side that lives names a killed peer and its last words at once") {
  // A peer that is merely silent would be waited for twice as long as this test waits at all.
  const Words settings = for_long + Words{"--set", "coupling.peer_timeout=60"};
  const bool are_grains_killed = GENERATE(true, false);
  CAPTURE(are_grains_killed);
  SECTION("while the two step") {
    Pair pair(small_scene, settings);
    pair.zones.await("side=continuum stage=Penetrate");
    Process& victim = are_grains_killed ? pair.grains : pair.zones;
    Process& survivor = are_grains_killed ? pair.zones : pair.grains;
    victim.send(SIGKILL);
    CHECK(survivor.wait() == exit_peer);
    CHECK(victim.wait() == killed);
    const std::string words = survivor.last_words();
    CHECK_THAT(words, Contains("[error] ") && Contains("127.0.0.1:") && Contains(", in stage Penetrate, due: ") &&
                          Contains(are_grains_killed ? "from the grains" : "from the continuum"));
    CHECK_THAT(words, Contains("its last words, ") &&
                          Contains(are_grains_killed ? "s ago: Forces of step " : "s ago: Velocities of step "));
  }
  SECTION("while the grains are packed") {
    Pair pair(slow_packing, settings);
    pair.grains.await("side=grains stage=Balance");
    Process& victim = are_grains_killed ? pair.grains : pair.zones;
    Process& survivor = are_grains_killed ? pair.zones : pair.grains;
    victim.send(SIGKILL);
    CHECK(survivor.wait() == exit_peer);
    CHECK(victim.wait() == killed);
    CHECK_THAT(survivor.last_words(), Contains("127.0.0.1:") && Contains(", in stage Balance, due: Balance") &&
                                          Contains("its last words, ") &&
                                          Contains(are_grains_killed ? "s ago: Progress" : "s ago: InitialStress"));
  }
}

TEST_CASE("a peer that hangs is given up after the scene's peer_timeout, and hears why when it wakes") {
  const bool are_grains_stopped = GENERATE(true, false);
  CAPTURE(are_grains_stopped);
  Pair pair(small_scene, for_long + Words{"--set", "coupling.peer_timeout=2"});
  pair.zones.await("side=continuum stage=Penetrate");
  Process& stopped = are_grains_stopped ? pair.grains : pair.zones;
  Process& survivor = are_grains_stopped ? pair.zones : pair.grains;
  stopped.send(SIGSTOP);
  CHECK(survivor.wait() == exit_peer);
  const std::string words = survivor.last_words();
  CHECK_THAT(words, Contains(are_grains_stopped ? "no word from the grains (127.0.0.1:"
                                                : "no word from the continuum (127.0.0.1:") &&
                        Contains(" for 2.0 s, in stage Penetrate") && Contains("its last words, 2.") &&
                        Contains("raise coupling.peer_timeout if it is only slow"));
  stopped.send(SIGCONT);
  CHECK(stopped.wait() == exit_peer);
  CHECK_THAT(stopped.last_words(), Contains("peer gave up: no word from the ") && Contains("exit code 3"));
}

TEST_CASE("a side without a peer gives up after the scene's connect_timeout and says what to start") {
  const Words settings = {"--set", "coupling.connect_timeout=0.3"};
  Process grains(serving(small_scene) + settings);
  CHECK(grains.wait() == exit_peer);
  CHECK_THAT(grains.last_words(),
             Contains("no peer has connected to 127.0.0.1:") && Contains("start the continuum client"));
  Process zones(connecting(small_scene, "127.0.0.1:1") + settings);
  CHECK(zones.wait() == exit_peer);
  CHECK_THAT(zones.last_words(), Contains("no peer answers at 127.0.0.1:1") && Contains("start dem_server first"));
}

TEST_CASE("a stranger on the line is told from a Lockstep peer by its first bytes") {
  SECTION("a browser at the grains' port") {
    Process grains(serving(small_scene));
    const Socket browser = connected_to(address_of(grains));
    browser.say("GET / HTTP/1.0\r\n\r\n");
    CHECK(grains.wait() == exit_peer);
    CHECK_THAT(grains.last_words(), Contains("not a Lockstep peer") && Contains("GET"));
  }
  SECTION("a mail server where the client takes the grains to be") {
    const Port port;
    Process zones(connecting(small_scene, port.address()));
    const Socket mail = port.accept();
    mail.say("220 mail ready\r\n");
    CHECK(zones.wait() == exit_peer);
    CHECK_THAT(zones.last_words(), Contains("not a Lockstep peer") && Contains("220"));
  }
  SECTION("somebody who hangs up without a word") {
    Process grains(serving(small_scene));
    { const Socket caller = connected_to(address_of(grains)); }
    CHECK(grains.wait() == exit_peer);
    CHECK_THAT(grains.last_words(), Contains("closed the connection") && Contains("it has said nothing yet"));
  }
}

TEST_CASE("a peer of another major version is refused with both versions, and told so") {
  protocol::Hello hello;
  hello.major = 99;
  hello.solver = "solver_of_tomorrow";
  hello.solver_version = "7";
  const std::string versions = fmt::format("protocol versions differ: {}.{} and 99.{}", protocol::version_major,
                                           protocol::version_minor, hello.minor);
  SECTION("by the grains") {
    hello.role = protocol::Role::Continuum;
    Process grains(serving(small_scene));
    const Socket peer = connected_to(address_of(grains));
    peer.say(frame_of(hello));
    CHECK(grains.wait() == exit_peer);
    CHECK_THAT(grains.last_words(), Contains(versions) && Contains("solver_of_tomorrow 7"));
    const protocol::Abort told = abort_in(peer.hear_out());
    CHECK(told.exit_code == exit_peer);
    CHECK_THAT(told.reason, Contains(versions));
  }
  SECTION("by the continuum") {
    hello.role = protocol::Role::Grains;
    const Port port;
    Process zones(connecting(small_scene, port.address()));
    const Socket peer = port.accept();
    peer.say(frame_of(hello));
    CHECK(zones.wait() == exit_peer);
    CHECK_THAT(zones.last_words(), Contains(versions) && Contains("solver_of_tomorrow 7"));
    const protocol::Abort told = abort_in(peer.hear_out());
    CHECK(told.exit_code == exit_peer);
    CHECK_THAT(told.reason, Contains(versions));
  }
}

TEST_CASE("two sides with different scenes both end with both digests") {
  const std::string mine = read_scene(scenario("grain_on_block"), {}).digest;
  const std::string other = read_scene(scenario("grain_on_block"), {"seed=2"}).digest;
  REQUIRE(mine != other);
  Pair pair(small_scene, {}, {}, {"--set", "seed=2"});
  CHECK(pair.grains.wait() == exit_peer);
  CHECK(pair.zones.wait() == exit_peer);
  for (const Process* side : {&pair.grains, &pair.zones})
    CHECK_THAT(side->last_words(), Contains("different scenes") && Contains(mine) && Contains(other));
}

TEST_CASE("an interrupted run ends on both sides with code 130 and whole files") {
  const Folder folder;
  const Words results = {"--results", folder.path().string()};
  SECTION("while the two step: summaries are written, and no number in a history is not finite") {
    Pair pair(small_scene, for_long + results);
    pair.zones.await("side=continuum stage=Penetrate");
    pair.grains.send(SIGINT);
    pair.zones.send(SIGINT);
    CHECK(pair.grains.wait() == exit_interrupted);
    CHECK(pair.zones.wait() == exit_interrupted);
    CHECK_FALSE(find(content_of(folder / "dem_summary.json"), "\"state_hash\"").empty());
    CHECK_FALSE(find(content_of(folder / "continuum_summary.json"), "\"state_hash\"").empty());
    CHECK(rows_of(folder / "dem_history.csv") > 0);
    CHECK(rows_of(folder / "continuum_history.csv") > 0);
  }
  SECTION("during the hand-over: the summary names that stage as the last one") {
    // Without damping the grain swings on, and no ratio falls below the tolerance.
    Pair pair(small_scene,
              Words{"--set", "apply.damping=0", "--set", "apply.tolerance=1e-9", "--set", "apply.max_steps=100000000"} +
                  results);
    pair.zones.await("side=continuum stage=Apply");
    pair.grains.send(SIGINT);
    CHECK(pair.grains.wait() == exit_interrupted);
    CHECK(pair.zones.wait() == exit_interrupted);
    CHECK_THAT(content_of(folder / "dem_summary.json"), Contains("\"Apply\"") && !Contains("\"Penetrate\""));
  }
  SECTION("while the grains are packed: one side's interrupt is enough") {
    const bool is_at_grains = GENERATE(true, false);
    Pair pair(slow_packing, results);
    pair.grains.await("side=grains stage=Balance");
    (is_at_grains ? pair.grains : pair.zones).send(SIGINT);
    CHECK(pair.grains.wait() == exit_interrupted);
    CHECK(pair.zones.wait() == exit_interrupted);
    CHECK_THAT((is_at_grains ? pair.zones : pair.grains).last_words(),
               Contains(is_at_grains ? "the user of the grains stopped it in stage Balance"
                                     : "the user of the continuum stopped it in stage Balance"));
  }
}

TEST_CASE("a side alone runs its scene without a peer, and an interrupt leaves whole files") {
  const Folder folder;
  const Words results = {"--results", folder.path().string()};
  const fs::path ground = folder / "ground.txt";
  std::ofstream(ground) << "continuum { block { } }\nrun { duration: 0.01 }\n";
  SECTION("grains") {
    Process grains(Words{dem_server, grains_alone} + results);
    CHECK(grains.wait() == 0);
    CHECK_THAT(grains.out(), !Contains("listening"));
    CHECK(rows_of(folder / "dem_history.csv") > 0);
    CHECK_THAT(content_of(folder / "dem_summary.json"),
               Contains("run.duration is over") && Contains("\"interrupted\": false"));
  }
  SECTION("ground") {
    Process zones(Words{continuum_client, ground.string()} + results);
    CHECK(zones.wait() == 0);
    CHECK(rows_of(folder / "continuum_history.csv") > 0);
  }
  SECTION("grains that are interrupted on their way") {
    Process grains(Words{dem_server, grains_alone, "--progress"} + for_long + results);
    grains.await("side=grains stage=Penetrate");
    grains.send(SIGINT);
    CHECK(grains.wait() == exit_interrupted);
    CHECK(rows_of(folder / "dem_history.csv") > 0);
    CHECK_THAT(content_of(folder / "dem_summary.json"), Contains("the user interrupted the run") &&
                                                            Contains("\"interrupted\": true") &&
                                                            Contains("\"state_hash\""));
  }
  SECTION("grains that are interrupted while they are balanced") {
    // Rest to 1e-9 is not reached in a packing that is still settling.
    Process grains(Words{dem_server, "scenarios/pressed_cube", "--progress", "--set", "balance.tolerance=1e-9", "--set",
                         "balance.max_cycles=100000000"} +
                   results);
    grains.await("side=grains stage=Balance step=[1-9]");
    grains.send(SIGINT);
    CHECK(grains.wait() == exit_interrupted);
    CHECK_THAT(grains.last_words(), Contains("interrupted in stage Balance"));
    CHECK_THAT(content_of(folder / "dem_summary.json"), Contains("\"interrupted\": true"));
  }
}

TEST_CASE("what is wrong with a command line or a scene is said with key, value and remedy before anything starts") {
  const Folder folder;
  const Port taken;
  std::ofstream(folder / "file") << "not a folder\n";
  const std::string below_file = (folder / "file/results").string();
  const std::string ground = (folder / "ground.txt").string();
  std::ofstream(ground) << "continuum { block { } }\n";
  const auto set = [](const std::string& scene, const std::string& override_) {
    return Words{scene, "--set", override_};
  };
  struct Wrong {
    Words arguments;  // of both programs, or of one if the other has no such option
    int exit_code;
    Words words;
    bool is_for_grains = true, is_for_zones = true;
  };
  const std::vector<Wrong> wrongs = {
      {{altered_scene(folder, "contact_modulus", "contact_modulos")},
       exit_input,
       {"scene.txt:17:3: ", "\"contact_modulos\" is no key", "did you mean \"contact_modulus\""}},
      {set(small_scene, "grains.grain[0].radius=-0.03"),
       exit_input,
       {"grains.grain[0].radius = -0.03 is out of range", "give a value inside"}},
      {set(small_scene, "grains.bogus=1"), exit_input, {"grains.bogus=1", "\"bogus\" is no key", "the keys are "}},
      {set(slow_packing, "pile.diameter=0.95"),
       exit_input,
       {"pile.diameter = 0.95 m leaves no room", "hole_diameter = 0.875 m", "give a thinner pile or a wider zone"}},
      {set(slow_packing, "pile.embedment=2.5"),
       exit_input,
       {"pile.embedment = 2.5 m", "hole_depth = 2.2 m", "give less penetration or a deeper zone"}},
      {set("scenarios/oedometer", "grains.packing.porosity=0.25"),
       exit_input,
       {"grains.packing.porosity = 0.25", "grains of 3 pebbles", "0.332 to 0.460"},
       true,
       false},
      {{"scenarios/nowhere"}, exit_io, {"scenarios/nowhere: cannot read the scene", "give a scene file"}},
      {{small_scene, "--results", below_file}, exit_io, {below_file, "cannot make the folder", "choose another place"}},
      {{small_scene, "--log", below_file}, exit_io, {below_file, "cannot write the log", "give another --log"}},
      {{}, exit_input, {"no scene", "continuum_client SCENE"}, false, true},
      {{}, exit_input, {"no scene given; try: dem_server scenarios/"}, true, false},
      {{small_scene, "--listen", taken.address()},
       exit_io,
       {"cannot listen on " + taken.address(), "Address already in use", "choose another port, or port 0"},
       true,
       false},
      {{small_scene, "--listen", "127.0.0.1:port"},
       exit_input,
       {"127.0.0.1:port", "try --listen 127.0.0.1:0"},
       true,
       false},
      {{small_scene, "--listen", "127.0.0.1:70000"}, exit_input, {"127.0.0.1:70000", "from 0 to 65535"}, true, false},
      {{small_scene, "--listen", "nohost:0"}, exit_input, {"\"nohost\"", "give 127.0.0.1"}, true, false},
      {{small_scene, "--connect", "127.0.0.1:0"}, exit_input, {"127.0.0.1:0", "port from 1 to 65535"}, false, true},
      {{small_scene}, exit_input, {"the scene has grains", "--connect HOST:PORT"}, false, true},
      {{small_scene}, exit_input, {"the scene has a continuum", "--listen HOST:PORT", "tools/run"}, true, false},
      {{grains_alone, "--listen", "127.0.0.1:0"}, exit_input, {"no continuum", "leave --listen out"}, true, false},
      {{grains_alone}, exit_input, {"no continuum block", "run dem_server alone"}, false, true},
      {{grains_alone, "--connect", "127.0.0.1:9"},
       exit_input,
       {"no continuum block", "run dem_server alone"},
       false,
       true},
      {{ground, "--connect", "127.0.0.1:9"}, exit_input, {"no grains", "leave --connect out"}, false, true},
      {{ground}, exit_input, {"no `grains` block", "add one"}, true, false},
  };
  for (const Wrong& wrong : wrongs) {
    for (const bool are_grains : {true, false}) {
      if (!(are_grains ? wrong.is_for_grains : wrong.is_for_zones)) continue;
      Process program(Words{are_grains ? dem_server : continuum_client} + wrong.arguments);
      CAPTURE(are_grains, wrong.arguments);
      CHECK(program.wait() == wrong.exit_code);
      for (const std::string& words : wrong.words) CHECK_THAT(program.err(), Contains(words));
      CHECK_THAT(program.out(), !Contains("listening"));
    }
  }
}

TEST_CASE("a packing that turns out impossible ends both sides with the grains' words") {
  // The cube is let down to 2 kPa after its compression, which the generator finds wrong once the session is under way.
  Pair pair("scenarios/oedometer", {"--set", "grains.packing.cube_pressure=1"});
  CHECK(pair.grains.wait() == exit_input);
  CHECK(pair.zones.wait() == exit_peer);
  for (const Process* side : {&pair.grains, &pair.zones})
    CHECK_THAT(side->last_words(), Contains("grains.packing.cube_pressure = 1 Pa") && Contains("must lie above"));
  CHECK_THAT(pair.zones.last_words(), Contains("peer gave up: ") && Contains("exit code 1"));
}

namespace {

// The example commands of a program in a help text or a head comment: indented, without remarks behind them.
std::vector<Words> commands_in(const std::string& text, const std::string& program) {
  std::vector<Words> commands;
  std::istringstream lines(text);
  const std::regex example("^(?://)? {2,}(" + program + " -{0,2}[a-z].*?)(?: {2,}.*)?$");
  for (std::string line; std::getline(lines, line);) {
    std::smatch match;
    if (!std::regex_match(line, match, example)) continue;
    std::istringstream words(match.str(1));
    Words command;
    for (std::string word; words >> word;) command.push_back(word);
    commands.push_back(command);
  }
  return commands;
}

std::vector<Words> examples_of(const std::string& path, const std::string& source) {
  const std::string name = fs::path(path).filename();
  Process help({path, "--help"});
  CHECK(help.wait() == 0);
  std::vector<Words> examples = commands_in(help.out(), name);
  CHECK(examples.size() >= 3);
  const std::string text = content_of(fs::path(SOURCE_DIR) / source);
  const std::vector<Words> from_comment = commands_in(text.substr(0, text.find("#include")), name);
  CHECK(from_comment.size() >= 1);
  examples.insert(examples.end(), from_comment.begin(), from_comment.end());
  for (Words& command : examples) command.front() = path;
  return examples;
}

// The value behind an option; null if it is not given.
std::string* value_of(Words& command, const std::string& option) {
  const auto at = std::find(command.begin(), command.end(), option);
  return at == command.end() ? nullptr : &*std::next(at);
}

}  // namespace

TEST_CASE("the command lines that the programs show do run") {
  // As they stand there, in a folder with scenarios/; but the port is a free one.
  const Folder folder;
  fs::create_directory_symlink(fs::path(SOURCE_DIR) / "scenarios", folder / "scenarios");
  SECTION("dem_server: listens, or runs grains alone to their end") {
    for (Words command : examples_of(dem_server, "dem_server/main.cpp")) {
      if (std::string* address = value_of(command, "--listen")) *address = "127.0.0.1:0";
      CAPTURE(command);
      Process grains(command, folder.path());
      if (value_of(command, "--listen")) {
        address_of(grains);
        grains.send(SIGINT);
        CHECK(grains.wait() == exit_interrupted);
      } else {
        CHECK(grains.wait() == 0);
        if (std::find(command.begin(), command.end(), "--keys") == command.end())
          CHECK_THAT(grains.out(), !Contains("listening"));
        else
          CHECK_THAT(grains.out(), Contains("peer_timeout"));
      }
    }
  }
  SECTION("continuum_client: runs to its end with a dem_server that is given the same") {
    for (Words command : examples_of(continuum_client, "continuum_client/main.cpp")) {
      CAPTURE(command);
      std::string* address = value_of(command, "--connect");
      if (!address) {
        Process zones(command, folder.path());
        CHECK(zones.wait() == 0);
        continue;
      }
      Words serving_command = {dem_server, command.at(1), "--listen", "127.0.0.1:0"};
      for (auto word = command.begin(); word != command.end(); ++word)
        if (*word == "--set") serving_command.insert(serving_command.end(), {"--set", *std::next(word)});
      Process grains(serving_command, folder.path());
      *address = address_of(grains);
      Process zones(command, folder.path());
      CHECK(zones.wait() == 0);
      CHECK(grains.wait() == 0);
    }
  }
}

TEST_CASE("tools/run runs both programs and leaves a folder with all there is to know") {
  const Folder folder;
  const Words command = {SOURCE_DIR "/tools/run",  "scenarios/grain_on_block", "--programs", BINARY_DIR "/bin", "--out",
                         (folder / "run").string()};
  SECTION("a whole run") {
    Process run(command);
    const int exit_code = run.wait();
    INFO(run.out() << run.err());
    CHECK(exit_code == 0);
    for (const char* name :
         {"manifest.json", "scene.txt", "dem_history.csv", "continuum_history.csv", "particles.pvd", "contacts.pvd",
          "zones.pvd", "summary.json", "summary.txt", "dem_server.log", "continuum_client.log"}) {
      INFO(name);
      REQUIRE(fs::exists(folder / "run" / name));
      CHECK(fs::file_size(folder / "run" / name) > 0);
    }
    CHECK(content_of(folder / "run/scene.txt") == content_of(scenario("grain_on_block")));
    CHECK_THAT(run.out(), Contains("grain_on_block") && Contains("done"));
  }
  SECTION("a scene with a wrong key") {
    Process run(command + Words{"--set", "grains.bogus=1"});
    CHECK(run.wait() == exit_input);
    CHECK_THAT(run.err(), Contains("\"bogus\" is no key"));
  }
  SECTION("a run that is interrupted") {
    Process run(command + for_long);
    run.await("Penetrate");
    run.send(SIGINT);
    CHECK(run.wait() == exit_interrupted);
    CHECK(fs::exists(folder / "run/summary.json"));
  }
}

TEST_CASE("tools/run starts only the program that a scene needs") {
  const Folder folder;
  const fs::path ground = folder / "ground.txt", nothing = folder / "nothing.txt";
  std::ofstream(ground) << "continuum { block { } }\nrun { duration: 0.01 }\n";
  std::ofstream(nothing) << "gravity: 1\n";
  const fs::path out = folder / "run";
  const auto run_of = [&](const std::string& scene, const Words& more = {}) {
    return Words{SOURCE_DIR "/tools/run", scene, "--programs", BINARY_DIR "/bin", "--out", out.string()} + more;
  };
  SECTION("one side") {
    const bool are_grains = GENERATE(true, false);
    const std::string side = are_grains ? "dem_server" : "continuum_client",
                      other = are_grains ? "continuum_client" : "dem_server";
    Process run(run_of(are_grains ? grains_alone : ground.string()));
    const int exit_code = run.wait();
    INFO(run.out() << run.err());
    CHECK(exit_code == 0);
    CHECK_THAT(run.out(), Contains("done") && Contains(are_grains ? "Penetrate" : "InitialStress"));
    CHECK_THAT(content_of(out / "manifest.json"), Contains(side) && !Contains(other));
    CHECK_THAT(content_of(out / "summary.json"), Contains("\"" + side + "\"") && !Contains("\"" + other + "\""));
    CHECK(fs::exists(out / (side + ".log")));
    CHECK_FALSE(fs::exists(out / (other + ".log")));
  }
  SECTION("an interrupt") {
    Process run(run_of(grains_alone, for_long));
    run.await("Penetrate");
    run.send(SIGINT);
    CHECK(run.wait() == exit_interrupted);
    CHECK_THAT(content_of(out / "manifest.json"), Contains("\"exit_code\": 130"));
    CHECK(fs::exists(out / "summary.txt"));
  }
  SECTION("what is refused leaves no folder") {
    Process wrong(run_of(grains_alone, {"--set", "grains.bogus=1"}));
    CHECK(wrong.wait() == exit_input);
    CHECK_THAT(wrong.err(), Contains("\"bogus\" is no key"));
    Process no_use(run_of(ground.string(), {"--packing", "some.packing"}));
    CHECK(no_use.wait() == exit_input);
    CHECK_THAT(no_use.err(), Contains("--packing some.packing") && Contains("needs no dem_server"));
    Process no_scene(run_of(nothing.string()));
    CHECK(no_scene.wait() == exit_input);
    CHECK_THAT(no_scene.err(), Contains("no block grains and no block continuum"));
    CHECK_FALSE(fs::exists(out));
  }
}

}  // namespace lockstep::coupled
