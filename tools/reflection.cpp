// What the interface of grains and zones does to waves: packets through the real coupled program, both solvers in this
// process, beside the exact discrete answer (reflection_case.hpp has the setting, interface_waves.hpp the answer).
//
//   tools/reflection --quick
//   tools/reflection --only oblique --out runs/oblique
//
// Writes reflection.csv (one row a case), curves.csv (the exact answer along the wavelength) and reflection.txt.
// Ends with code 4 when a case misses the exact answer by more than 0.005 of the amplitude, or creates more than 1e-3 of
// the packet's energy.
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "common/checks.hpp"
#include "common/results.hpp"
#include "tools/reflection_case.hpp"

namespace {

using namespace lockstep;
using Clock = std::chrono::steady_clock;

constexpr double largest_difference = 0.005;  // of |R|
constexpr double largest_creation = 1e-3;     // of the energy that comes in
constexpr double degrees = pi / 180;

struct Options {
  bool is_quick = false;
  std::vector<std::string> only = {"pressure", "hump", "impedance", "shear", "oblique"};
  double step_fraction = 0.5;
  std::string out = "runs/reflection";
};

struct Entry {
  std::string group;
  ReflectionCase setting;
  ReflectionResult result;
};

const char* name_of(Side side) { return side == Side::Grains ? "grains" : "zones"; }

std::vector<Entry> sweep(const Options& o) {
  std::vector<Entry> entries;
  const auto is_wanted = [&](const std::string& group) {
    return std::find(o.only.begin(), o.only.end(), group) != o.only.end();
  };
  const auto add = [&](const std::string& group, ReflectionCase c) {
    c.step_fraction = o.step_fraction;
    if (is_wanted(group)) entries.push_back({group, c, {}});
  };
  const std::vector<double> waves =
      o.is_quick ? std::vector<double>{6, 10, 20} : std::vector<double>{4, 6, 10, 16, 20, 40};
  const std::vector<int> sizes = o.is_quick ? std::vector<int>{1, 3} : std::vector<int>{1, 2, 3};
  for (const Side from : {Side::Grains, Side::Zones}) {
    for (const int size : sizes) {
      for (const double wave : waves) add("pressure", {.from = from, .grains_per_zone = size, .zones_per_wave = wave});
      for (const double wave : {10.0, 20.0, 40.0})
        if (!o.is_quick || wave == 20)
          add("hump", {.from = from, .grains_per_zone = size, .zones_per_wave = wave, .is_hump = true});
      for (const double wave : waves)
        if (!o.is_quick || wave == 10)
          add("shear", {.kind = WaveKind::Shear, .from = from, .grains_per_zone = size, .zones_per_wave = wave});
    }
    for (const double ratio : {0.25, 0.5, 0.8, 2.0, 4.0})
      for (const double wave : {6.0, 20.0})
        if (!o.is_quick || (wave == 20 && ratio < 0.5))
          add("impedance", {.from = from, .zones_per_wave = wave, .impedance_ratio = ratio});
    for (const double angle : {30.0, 45.0, 60.0})
      for (const int size : {1, 2})
        for (const double wave : {6.0, 10.0, 20.0})
          if (o.is_quick ? angle == 45 && size == 1 && wave == 6 : size == 1 || wave < 20)
            // The wave nearest to that length which fits a strip of whole zones.
            add("oblique",
                {.kind = WaveKind::Oblique,
                 .from = from,
                 .grains_per_zone = size,
                 .zones_per_wave = 2 * std::sin(angle * degrees) * std::round(0.5 * wave / std::sin(angle * degrees)),
                 .angle = angle * degrees});
  }
  return entries;
}

double amplitude(double share) { return std::sqrt(std::max(0.0, share)); }
double difference(const Entry& e) {
  return amplitude(e.result.measured.reflected) - amplitude(e.result.exact.reflected);
}

void run_all(std::vector<Entry>& entries) {
  double all = 0, done = 0;
  for (const Entry& e : entries) all += work_of(e.setting);
  const auto begin = Clock::now();
  for (std::size_t i = 0; i < entries.size(); ++i) {
    Entry& e = entries[i];
    e.result = measure_reflection(e.setting);
    done += work_of(e.setting);
    const double spent = std::chrono::duration<double>(Clock::now() - begin).count();
    std::fprintf(stderr, "\r%zu of %zu: %s from %s, %g zones a wave, %d grains a zone; %.0f s to go   ", i + 1,
                 entries.size(), e.group.c_str(), name_of(e.setting.from), e.setting.zones_per_wave,
                 e.setting.grains_per_zone, spent * (all - done) / done);
  }
  std::fputc('\n', stderr);
}

std::string csv(const std::vector<Entry>& entries) {
  std::string text =
      "group,from,zones per wave [-],grains per zone [-],grains per wave [-],impedance ratio [-],angle [deg],"
      "|R| measured [-],|R| exact [-],difference [-],|R| of the middle wave number [-],reflected energy measured [-],"
      "reflected energy exact [-],transmitted energy measured [-],transmitted energy exact [-],created energy [-],"
      "steps,grains,zones,seconds\n";
  for (const Entry& e : entries) {
    const ReflectionCase& c = e.setting;
    const ReflectionResult& r = e.result;
    text += fmt::format(
        "{},{},{},{},{},{},{:.4f},{:.8f},{:.8f},{:.3e},{:.8f},{:.10f},{:.10f},{:.10f},{:.10f},{:.3e},{},{},{},{:.3f}\n",
        e.group, name_of(c.from), c.zones_per_wave, c.grains_per_zone, c.zones_per_wave * c.grains_per_zone,
        c.impedance_ratio, r.angle / degrees, amplitude(r.measured.reflected), amplitude(r.exact.reflected),
        difference(e), amplitude(r.at_center.reflected), r.measured.reflected, r.exact.reflected,
        r.measured.transmitted, r.exact.transmitted, r.created, r.steps, r.grains, r.zones, r.seconds);
  }
  return text;
}

std::string table(const std::vector<Entry>& entries) {
  std::string text =
      fmt::format("{:<10} {:<6} {:>8} {:>4} {:>5} {:>6} {:>10} {:>10} {:>10} {:>10} {:>10} {:>10}\n", "wave", "from",
                  "lambda/h", "h/d", "Z", "angle", "|R|", "exact", "off by", "passed", "exact", "created");
  for (const Entry& e : entries) {
    const ReflectionCase& c = e.setting;
    const ReflectionResult& r = e.result;
    text += fmt::format(
        "{:<10} {:<6} {:>8.4g} {:>4} {:>5} {:>6.1f} {:>10.5f} {:>10.5f} {:>10.1e} {:>10.6f} {:>10.6f} {:>10.1e}\n",
        e.group, name_of(c.from), c.zones_per_wave, c.grains_per_zone, c.impedance_ratio, r.angle / degrees,
        amplitude(r.measured.reflected), amplitude(r.exact.reflected), difference(e), r.measured.transmitted,
        r.exact.transmitted, r.created);
  }
  return text;
}

// The exact answer between the measured points of packets: one line a kind, side, size and strip of the same angle.
std::string curves(const std::vector<Entry>& entries) {
  std::string text =
      "group,from,grains per zone [-],angle [deg],zones per wave [-],|R| exact [-],|R| of the middle wave number [-]\n";
  std::vector<Entry> drawn;
  for (const Entry& e : entries) {
    if (e.group == "impedance" || e.group == "oblique") continue;
    const bool is_there = std::any_of(drawn.begin(), drawn.end(), [&](const Entry& d) {
      return d.group == e.group && d.setting.from == e.setting.from &&
             d.setting.grains_per_zone == e.setting.grains_per_zone;
    });
    if (is_there) continue;
    drawn.push_back(e);
    const double first = e.setting.is_hump ? 8 : 3.6, last = 44;
    constexpr int points = 28;
    for (int k = 0; k < points; ++k) {
      ReflectionCase c = e.setting;
      c.zones_per_wave = first * std::pow(last / first, k / (points - 1.0));
      const ReflectionResult r = exact_reflection(c);
      text += fmt::format("{},{},{},{:.4f},{:.5f},{:.8f},{:.8f}\n", e.group, name_of(c.from), c.grains_per_zone,
                          r.angle / degrees, c.zones_per_wave, amplitude(r.exact.reflected),
                          amplitude(r.at_center.reflected));
    }
  }
  return text;
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  CLI::App app{
      "What the interface of grains and zones does to waves: wave packets through both solvers, and the exact discrete "
      "answer.\nWrites reflection.csv, reflection.txt, curves.csv and reflection.png."};
  app.add_flag("--quick", o.is_quick, "a few cases, in seconds");
  app.add_option(
         "--only", o.only,
         "groups: pressure, hump (without a cosine in it), impedance (zones over grains, 0.25 to 4), shear, oblique")
      ->delimiter(',')
      ->capture_default_str()
      ->check(CLI::IsMember({"pressure", "hump", "impedance", "shear", "oblique"}));
  app.add_option("--step-fraction", o.step_fraction, "of the stable step")
      ->capture_default_str()
      ->check(CLI::Range(0.01, 0.95));
  app.add_option("--out", o.out, "folder of the results, written over")->capture_default_str();
  app.footer(
      "Examples:\n"
      "  tools/reflection --quick\n"
      "  tools/reflection --only oblique,shear --out runs/shear\n"
      "  tools/reflection --step-fraction 0.9      (the answer does not depend on the step)");
  CLI11_PARSE(app, argc, argv);
  spdlog::set_level(spdlog::level::warn);
  try {
    prepare_folder(o.out);
    std::vector<Entry> entries = sweep(o);
    const auto begin = Clock::now();
    run_all(entries);
    double worst = 0, created = 0;
    for (const Entry& e : entries) {
      worst = std::max(worst, std::abs(difference(e)));
      created = std::max(created, std::abs(e.result.created));
    }
    const std::string text =
        table(entries) + fmt::format(
                             "\n{} cases in {:.1f} s, step fraction {}: |R| off by at most {:.1e} (allowed {:.0e}), "
                             "energy created at most {:.1e} of the packet's (allowed {:.0e})\n",
                             entries.size(), std::chrono::duration<double>(Clock::now() - begin).count(),
                             o.step_fraction, worst, largest_difference, created, largest_creation);
    write_file(std::filesystem::path(o.out) / "reflection.csv", csv(entries));
    write_file(std::filesystem::path(o.out) / "curves.csv", curves(entries));
    write_file(std::filesystem::path(o.out) / "reflection.txt", text);
    std::fputs(text.c_str(), stdout);
    if (!(worst <= largest_difference && created <= largest_creation))
      throw NumericalError("a case misses the exact answer or creates energy; see the last line of the table");
  } catch (const Error& e) {
    std::fprintf(stderr, "reflection: %s\n", e.what());
    return static_cast<int>(e.code());
  }
  return 0;
}
