#include <sys/wait.h>

#include <array>
#include <catch2/catch.hpp>
#include <cstdio>
#include <string>

namespace {

struct Outcome {
  int exit_code = -1;
  std::string text;  // both streams
};

Outcome run(const std::string& arguments) {
  const std::string command = std::string(SOURCE_DIR) + "/" + arguments + " 2>&1 </dev/null";
  Outcome outcome;
  std::FILE* pipe = popen(command.c_str(), "r");
  REQUIRE(pipe);
  std::array<char, 4096> buffer;
  while (const std::size_t n = std::fread(buffer.data(), 1, buffer.size(), pipe)) outcome.text.append(buffer.data(), n);
  const int status = pclose(pipe);
  outcome.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return outcome;
}

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

}  // namespace

TEST_CASE("tools/run refuses what cannot work, in words, before it starts anything") {
  const std::string scene = "tools/run " + std::string(SOURCE_DIR) + "/scenarios/pile_quick ";
  const Outcome none = run("tools/run no_such_scene --programs /tmp");
  CAPTURE(none.text);
  CHECK(none.exit_code == 2);
  CHECK(contains(none.text, "no_such_scene"));
  CHECK(contains(none.text, "scenarios/"));

  const Outcome unbuilt = run(scene + "--programs /tmp/none --out " + std::string(BINARY_DIR) + "/no_run");
  CAPTURE(unbuilt.text);
  CHECK(unbuilt.exit_code == 1);
  CHECK(contains(unbuilt.text, "tools/setup"));

  const Outcome malformed = run(scene + "--set gravity");
  CAPTURE(malformed.text);
  CHECK(malformed.exit_code == 1);
  CHECK(contains(malformed.text, "key=value"));

  const Outcome unwritable = run(scene + "--programs " + std::string(BINARY_DIR) + " --out /proc/lockstep");
  CAPTURE(unwritable.text);
  CHECK(unwritable.exit_code == 2);
  CHECK(contains(unwritable.text, "/proc/lockstep"));

  CHECK(run("tools/run --no-such-option").exit_code == 1);
}

TEST_CASE("tools/run --help shows examples") {
  const Outcome help = run("tools/run --help");
  CHECK(help.exit_code == 0);
  CHECK(contains(help.text, "tools/run scenarios/pile_quick"));
}

TEST_CASE("Moduli, strength and the calibration's search give what made-up tests were made of") {
  // The script derives each answer and prints the errors.
  const Outcome fit = run("tests/common/check_triaxial_fit.py");
  INFO(fit.text);
  CHECK(fit.exit_code == 0);
}

TEST_CASE("tools/report measures and judges made-up runs as they were made, and refuses what is none") {
  // The script derives each answer and prints what it checked.
  const Outcome report = run("tests/common/check_pile_report.py");
  INFO(report.text);
  CHECK(report.exit_code == 0);
  const Outcome help = run("tools/report --help");
  CHECK(help.exit_code == 0);
  CHECK(contains(help.text, "tools/report runs/coupled runs/particles_only"));
}

TEST_CASE("tools/triaxial and tools/calibrate refuse what cannot work, in words") {
  const Outcome pressures = run("tools/triaxial --pressures 100e3,none");
  CAPTURE(pressures.text);
  CHECK(pressures.exit_code == 1);
  CHECK(contains(pressures.text, "--pressures 100e3,none"));

  const Outcome ratio = run("tools/calibrate --poisson-ratio 0.6");
  CAPTURE(ratio.text);
  CHECK(ratio.exit_code == 1);
  CHECK(contains(ratio.text, "--poisson-ratio 0.6 is out of range [0, 0.45]"));

  const Outcome seeds = run("tools/calibrate --seeds one");
  CAPTURE(seeds.text);
  CHECK(seeds.exit_code == 1);
  CHECK(contains(seeds.text, "--seeds one"));
}

TEST_CASE("A study of cases finds the means, scatter and paired changes that made-up runs were made of") {
  // The script derives each answer and prints the errors.
  const Outcome study = run("tests/common/check_study.py");
  INFO(study.text);
  CHECK(study.exit_code == 0);
}

TEST_CASE("tools/study refuses what cannot work, in words") {
  const Outcome seeds = run("tools/study pile_quick --seeds one");
  CAPTURE(seeds.text);
  CHECK(seeds.exit_code == 1);
  CHECK(contains(seeds.text, "--seeds one"));

  const Outcome twice = run("tools/study pile_quick --case base --case base:run.damping=0.1");
  CAPTURE(twice.text);
  CHECK(twice.exit_code == 1);
  CHECK(contains(twice.text, "two of them have one name"));

  const Outcome unwritable = run("tools/study pile_quick --out /proc/lockstep");
  CAPTURE(unwritable.text);
  CHECK(unwritable.exit_code == 2);
  CHECK(contains(unwritable.text, "/proc/lockstep"));
}
