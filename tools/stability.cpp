// The stability map: small coupled scenes over stiffness contrast, mass ratio, step, damping and exchange interval, run by
// both solvers in this process; what they did beside what is true (stability_case.hpp says how that is known).
//
//   tools/stability --quick
//   tools/stability --only interval --out runs/interval
//
// Writes stability.csv (one row a run) and stability.txt. Ends with code 4 when an unstable run was missed, or one within
// the predicted limit went wrong.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "common/checks.hpp"
#include "common/results.hpp"
#include "tools/stability_case.hpp"

namespace {

using namespace lockstep;
using Clock = std::chrono::steady_clock;

const std::vector<std::string> all_groups = {"contrast", "columns", "damping", "interval",
                                             "packing",  "bounce",  "impact"};

struct Options {
  bool is_quick = false;
  std::vector<std::string> only = all_groups;
  std::string out = "runs/stability";
};

// Runs of one bar, which share its assembly and its predicted limit; or one run of a scene.
struct Task {
  std::string group;
  BarCase bar;
  std::vector<double> of_exact, of_predicted;
  std::function<void(Point&)> measure;  // of a scene
  double work = 1;                      // seconds that it is thought to take, for the time to go
};

// Contrast and mass ratio where the limit is that of the zones, of the grains, and of both together.
const std::vector<std::pair<double, double>> corners = {{1, 1},      {1e-2, 1e-2}, {1e-2, 1e2},
                                                        {1e2, 1e-2}, {1e2, 1e2},   {1e4, 1}};

std::vector<Task> sweep(const Options& o) {
  std::vector<Task> tasks;
  const auto is_wanted = [&](const std::string& group) {
    return std::find(o.only.begin(), o.only.end(), group) != o.only.end();
  };
  const int decades = o.is_quick ? 2 : 1;
  if (is_wanted("contrast"))
    for (int a = -4; a <= 4; a += decades)
      for (int b = -4; b <= 4; b += decades)
        tasks.push_back({"contrast",
                         {.contrast = std::pow(10, a), .mass_ratio = std::pow(10, b)},
                         o.is_quick ? std::vector<double>{0.99, 1.05} : std::vector<double>{0.5, 0.99, 1.01, 1.05, 1.2},
                         {1},
                         {},
                         o.is_quick ? 0.1 : 0.25});
  if (is_wanted("columns"))
    for (int a = -4; a <= 4; a += 2 * decades)
      for (int b = -4; b <= 4; b += decades)
        tasks.push_back({"columns",
                         {.contrast = std::pow(10, a), .mass_ratio = std::pow(10, b), .columns = 3, .spheres = 2},
                         {0.99, 1.05},
                         {1},
                         {},
                         0.2});
  for (const auto& [contrast, mass_ratio] : corners) {
    if (o.is_quick && contrast != 1) continue;
    if (is_wanted("damping"))
      for (const double damping : {0.0, 0.1, 0.3, 0.5, 0.7, 0.9})
        if (!o.is_quick || damping == 0.3 || damping == 0.9)
          tasks.push_back({"damping",
                           {.contrast = contrast, .mass_ratio = mass_ratio, .damping = damping},
                           {0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.98, 1.02, 1.05, 1.1, 1.2},
                           {1},
                           {},
                           0.4});
    if (is_wanted("interval"))
      for (const std::uint32_t interval : {2U, 5U, 10U, 20U, 50U})
        for (const double damping : {0.3, 0.5, 0.7, 0.9})
          if (!o.is_quick || (damping == 0.3 && interval < 20))
            tasks.push_back({"interval",
                             {.contrast = contrast,
                              .mass_ratio = mass_ratio,
                              .spheres = 3,
                              .zones = 3,
                              .damping = damping,
                              .exchange_interval = interval,
                              .has_weight = true},
                             {},
                             {0.25, 0.5, 0.9, 1, 1.2, 1.5, 2, 3},
                             {},
                             0.3 + 0.1 * interval});
  }
  const std::filesystem::path packing = std::filesystem::path(o.out) / "stability.packing";
  const auto add = [&](const std::string& group, Scene scene, double damping, double asked, double work) {
    if (!is_wanted(group)) return;
    tasks.push_back({group,
                     {},
                     {},
                     {},
                     [=](Point& p) {
                       p.damping = damping, p.asked = asked, p.is_of_exact = false;
                       measure_scene(p, scene, packing);
                     },
                     work});
  };
  for (const double damping : {0.1, 0.3, 0.7})
    for (const double asked : {0.5, 0.9, 1.0, 1.05, 1.1, 1.2, 1.5, 2.0})
      if (!o.is_quick || (damping == 0.7 && (asked == 1 || asked == 1.2)))
        add("packing", Scene::Packing, damping, asked, 4);
  for (const double asked : {0.5, 0.9, 1.0, 1.05, 1.1, 1.2, 1.5, 2.0})
    if (!o.is_quick || asked == 1 || asked == 1.5)
      add("bounce", Scene::Bounce, 0, asked, 0.3), add("impact", Scene::Impact, 0, asked, 0.3);
  return tasks;
}

std::vector<Point> run_all(const std::vector<Task>& tasks) {
  std::vector<Point> points;
  double all = 0, done = 0;
  for (const Task& t : tasks) all += t.work;
  const auto begin = Clock::now();
  for (std::size_t i = 0; i < tasks.size(); ++i) {
    const Task& t = tasks[i];
    if (t.measure) {
      t.measure(points.emplace_back());
      points.back().group = t.group;
    } else {
      const CoupledBar bar(t.bar);
      const double predicted = predicted_limit(bar);
      for (const bool is_of_exact : {true, false})
        for (const double asked : is_of_exact ? t.of_exact : t.of_predicted) {
          Point& p = points.emplace_back();
          p.group = t.group, p.asked = asked, p.is_of_exact = is_of_exact;
          measure_bar(p, bar, predicted);
        }
    }
    done += t.work;
    const double spent = std::chrono::duration<double>(Clock::now() - begin).count();
    std::fprintf(stderr, "\r%zu of %zu scenes (%s), %.0f s to go   ", i + 1, tasks.size(), t.group.c_str(),
                 spent * (all - done) / done);
  }
  std::fputc('\n', stderr);
  return points;
}

std::string quoted(std::string text) {
  std::replace(text.begin(), text.end(), '"', '\'');
  std::replace(text.begin(), text.end(), '\n', ' ');
  return '"' + text + '"';
}

std::string csv(const std::vector<Point>& points) {
  std::string text =
      "group,contrast k_n/(E h) [-],mass ratio [-],columns [-],damping [-],exchange interval [-],asked [-],asked of,"
      "predicted limit [s],exact limit [s],time step [s],step over predicted [-],step over exact [-],growth a step [-],"
      "truth,evidence,steps asked,onset,stopped at step,class,seconds,words\n";
  for (const Point& p : points)
    text += fmt::format(
        "{},{:g},{:g},{},{},{},{},{},{:.8e},{:.8e},{:.8e},{:.6f},{:.6f},{:.8f},{},{},{},{},{},{},{:.3f},{}\n", p.group,
        p.contrast, p.mass_ratio, p.columns, p.damping, p.exchange_interval, p.asked,
        p.is_of_exact ? "exact" : "predicted", p.predicted, p.exact, p.time_step, p.time_step / p.predicted,
        p.exact > 0 ? p.time_step / p.exact : 0.0, p.radius,
        p.truth == Truth::Stable     ? "stable"
        : p.truth == Truth::Unstable ? "unstable"
                                     : "too slow",
        quoted(p.evidence), p.steps, p.onset, p.is_stopped ? p.at_step : 0, name_of(p.verdict()), p.seconds,
        quoted(p.words));
  return text;
}

std::string line_of(const Point& p) {
  return fmt::format(
      "{:<9} {:>7.0e} {:>7.0e} {:>3} {:>5} {:>4} {:>10.3e} {:>10.3e} {:>8.4f} {:>9.5f} {:>6} {:>6} {:<22} {}\n",
      p.group, p.contrast, p.mass_ratio, p.columns, p.damping, p.exchange_interval, p.predicted, p.time_step,
      p.time_step / p.predicted, p.radius, p.onset, p.is_stopped ? p.at_step : 0, name_of(p.verdict()),
      p.words.empty() ? p.evidence : p.words);
}

std::string table(const std::vector<Point>& points) {
  std::string text =
      fmt::format("{:<9} {:>7} {:>7} {:>3} {:>5} {:>4} {:>10} {:>10} {:>8} {:>9} {:>6} {:>6} {:<22} {}\n", "group",
                  "k/(E h)", "m/m_z", "col", "alpha", "n", "limit [s]", "step [s]", "of limit", "growth", "onset",
                  "stop", "class", "words or evidence");
  for (const Point& p : points) text += line_of(p);
  return text;
}

std::string counts(const std::vector<Point>& points) {
  std::map<std::string, std::map<Class, int>> by_group;
  for (const Point& p : points) ++by_group[p.group][p.verdict()], ++by_group["all"][p.verdict()];
  std::string text = fmt::format("{:<10}", "");
  const std::vector<Class> classes = {
      Class::StableAsPredicted, Class::StableBeyond, Class::Caught,           Class::Missed,
      Class::WrongWithin,       Class::TooSlow,      Class::StoppedForNothing};
  for (const Class c : classes) text += fmt::format("{:>24}", name_of(c));
  text += '\n';
  for (std::vector<std::string> groups = all_groups; const std::string& group : [&] {
         groups.push_back("all");
         return groups;
       }()) {
    if (!by_group.contains(group)) continue;
    text += fmt::format("{:<10}", group);
    for (const Class c : classes) text += fmt::format("{:>24}", by_group[group][c]);
    text += '\n';
  }
  return text;
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  CLI::App app{
      "The stability map of the coupled step: small scenes over stiffness contrast, mass ratio, step, damping and "
      "exchange "
      "interval; what both solvers did, beside what is true.\nWrites stability.csv, stability.txt and stability.png."};
  app.add_flag("--quick", o.is_quick, "a few points of each sweep, in less than a minute");
  app.add_option("--only", o.only,
                 "groups: contrast (stiffness and mass), columns (nine contacts a facet), damping, interval (steps of "
                 "the grains to one of the ground), packing, bounce, impact")
      ->delimiter(',')
      ->capture_default_str()
      ->check(CLI::IsMember(all_groups));
  app.add_option("--out", o.out, "folder of the results, written over")->capture_default_str();
  app.footer(
      "Examples:\n"
      "  tools/stability --quick\n"
      "  tools/stability --only packing,impact --out runs/packing\n"
      "  tools/stability                          (the whole map)");
  CLI11_PARSE(app, argc, argv);
  spdlog::set_level(spdlog::level::off);  // runs that fail are what it is about
  try {
    prepare_folder(o.out);
    const auto begin = Clock::now();
    const std::vector<Point> points = run_all(sweep(o));
    std::string wrong;
    double least = 1e300;
    std::uint64_t latest = 0;
    for (const Point& p : points) {
      const Class c = p.verdict();
      if (c == Class::Missed || c == Class::WrongWithin) wrong += line_of(p);
      if (p.exact > 0) least = std::min(least, p.exact / p.predicted);
      // With several steps to an exchange the grains count theirs, the walk exchanges.
      if (c == Class::Caught && p.exchange_interval == 1 && p.onset > 0 && p.at_step > p.onset)
        latest = std::max(latest, p.at_step - p.onset);
    }
    std::string text = counts(points);
    if (least < 1e300) text += fmt::format("exact over predicted limit: at least {:.5f}\n", least);
    text += fmt::format("alarms: at most {} steps after the thousandfold of the start's energy\n", latest);
    text += fmt::format("{} runs in {:.0f} s\n", points.size(),
                        std::chrono::duration<double>(Clock::now() - begin).count());
    write_file(std::filesystem::path(o.out) / "stability.csv", csv(points));
    write_file(std::filesystem::path(o.out) / "stability.txt", table(points) + '\n' + text);
    std::fputs((wrong + text).c_str(), stdout);
    if (!wrong.empty()) throw NumericalError("runs were missed, or went wrong within the limit; they are listed above");
  } catch (const Error& e) {
    std::fprintf(stderr, "stability: %s\n", e.what());
    return static_cast<int>(e.code());
  }
  return 0;
}
