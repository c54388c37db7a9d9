// The continuum's side of whole sessions, against a peer of a few lines in the same process.
#include "protocol/session.hpp"

#include <catch2/catch.hpp>
#include <cmath>
#include <exception>
#include <filesystem>
#include <fstream>
#include <functional>
#include <random>
#include <sstream>
#include <thread>

#include "common/interrupt.hpp"
#include "continuum_client/stages.hpp"
#include "protocol/loopback_channel.hpp"
#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

// Grains that are springs from each interface node to where it was: F = F0 - k (x - x(0)).
struct SpringGrains {
  double stiffness = 1e5;  // [N/m]
  std::function<Vec3s(const protocol::InitialStress&)> start_force = [](const auto& s) {
    return Vec3s(s.nodes.size(), Vec3::Zero());
  };
  std::uint64_t penetrate_steps = 50;
  double stable_step = 1;    // [s]
  std::uint64_t cut_at = 0;  // step at which stable_step becomes cut_step
  double cut_step = 0;
  bool spoils_positions = false;
  std::function<void(const protocol::Velocities&)> watch = [](const auto&) {};

  protocol::InitialStress initial;
  std::vector<double> steps;
  std::string error;

  void serve(std::unique_ptr<protocol::Channel> channel) {
    try {
      talk(std::move(channel));
    } catch (const std::exception& e) {
      error = e.what();
    }
  }

 private:
  void talk(std::unique_ptr<protocol::Channel> channel) {
    protocol::Session session(std::move(channel), protocol::Role::Grains, {});
    protocol::Hello hello;
    hello.role = protocol::Role::Grains;
    hello.solver = "springs";
    session.shake_hands(hello);
    initial = session.receive<protocol::InitialStress>();
    const std::size_t count = initial.nodes.size();
    protocol::Balance balance;
    balance.traction = initial.traction;
    session.send(protocol::Message(balance));
    const auto excavated = session.receive<protocol::ContinuumExcavated>();
    const Vec3s start = start_force(initial);
    protocol::GrainsExcavated mine;
    mine.offset.assign(count, Vec3::Zero());
    mine.node_stiffness.assign(count, stiffness);
    mine.nodal_force = start;
    mine.stable_step = stable_step;
    mine.position_hash = excavated.position_hash + (spoils_positions ? 1 : 0);
    session.send(protocol::Message(mine));

    Vec3s x = initial.nodes;
    protocol::Velocities v;
    protocol::Forces f;
    double step_into = 0;
    std::uint64_t penetrated = 0;
    while (session.receive_or_finish(v)) {
      for (std::size_t i = 0; i < count; ++i) x[i] += v.velocity[i] * step_into;
      step_into = v.time_step;
      steps.push_back(v.time_step);
      Hash h;
      h.add(std::span<const Vec3>(x));
      if (v.position_hash != 0 && v.position_hash != h.value()) throw std::runtime_error("positions differ");
      watch(v);
      f.step = v.step;
      f.force.resize(count);
      for (std::size_t i = 0; i < count; ++i) f.force[i] = start[i] - stiffness * (x[i] - initial.nodes[i]);
      f.stable_step = cut_at > 0 && v.step >= cut_at ? cut_step : stable_step;
      penetrated += v.stage == protocol::Stage::Penetrate ? 1 : 0;
      f.is_done = penetrated >= penetrate_steps;
      session.send(f);
    }
    protocol::Finish finish;
    finish.step = v.step;
    finish.text = "springs are done";
    session.send(protocol::Message(finish));
  }
};

RunReport couple(const std::string& scene_text, SpringGrains& grains, const std::filesystem::path& folder = {}) {
  auto [mine, theirs] = protocol::make_loopback();
  SceneFile scene = parse_scene(scene_text, "test.txt");
  scene.digest.clear();
  std::jthread peer([&grains, channel = std::move(theirs)]() mutable { grains.serve(std::move(channel)); });
  RunOptions options;
  options.prints_progress = false;
  const RunReport report = run_continuum(scene, folder, std::move(mine), options);
  peer.join();
  return report;
}

const std::string hole =
    "continuum { cylinder_in_brick { width: 3 depth: 4 hole_depth: 2.5 zones_around: 16 zones_radial: 4 "
    "zones_hole_depth: 5 zones_below: 2 "
    "radial_growth: 1.3 } } grains { packing { } } pile { embedment: 1 } ";

// The handed-over tractions, lumped to nodes: grains that match them well but not exactly.
Vec3s lumped_tractions(const protocol::InitialStress& s) {
  Vec3s force(s.nodes.size(), Vec3::Zero());
  for (std::size_t f = 0; f < s.facets.size(); ++f) {
    FacetCorners x;
    for (int c = 0; c < 4; ++c) x[c] = s.nodes[s.facets[f][c]];
    for (int c = 0; c < 4; ++c) force[s.facets[f][c]] += 0.25 * facet_area_vector(x).norm() * s.traction[f];
  }
  return force;
}

}  // namespace

TEST_CASE("a hole whose grains carry what the zones carried hardly moves when they take over") {
  SpringGrains grains;
  grains.start_force = lumped_tractions;
  const RunReport report = couple(hole + "apply { tolerance: 1e-3 }", grains);
  INFO(grains.error);
  CHECK(grains.error.empty());
  INFO("Apply took " << report.jump.apply_steps << " steps, the interface moved " << 1e3 * report.jump.largest
                     << " mm = " << report.jump.largest_in_facets << " facets; ledger residual "
                     << report.ledger_residual_fraction << ", excavation residual " << report.excavation_residual);
  CHECK(report.jump.apply_converged);
  CHECK(report.excavation_residual < 1e-10);
  CHECK(report.jump.force_difference < 1e-9);
  CHECK(report.jump.largest_in_facets < 1e-3);
  CHECK(report.ledger_residual_fraction < 1e-9);
  CHECK(report.steps == report.jump.apply_steps + grains.penetrate_steps);
  CHECK(report.finish_text == "springs are done");
}

TEST_CASE("the baseline starts from the zones' exact reaction, fades out smoothly and is gone after Apply") {
  // Grains that press with nothing but springs: at first the hole must not feel that its zones are gone, at the end
  // their absence is all there is. The start is the continuum's unbalanced ratio at step 0, round-off.
  SpringGrains grains;
  grains.stiffness = 1e6;
  double first = 1;
  std::vector<double> ratios;
  grains.watch = [&](const protocol::Velocities& v) { ratios.push_back(v.unbalanced_ratio); };
  const RunReport report = couple(hole + "apply { tolerance: 1e-3 }", grains);
  first = ratios.at(1);  // of step 0
  INFO("unbalanced ratio at step 0: " << first << ", largest displacement " << report.jump.largest);
  CHECK(first < 1e-9);
  CHECK(report.jump.largest > 1e-5);
  CHECK(report.ledger.work.baseline != 0);
  CHECK(report.ledger_residual_fraction < 1e-9);
}

TEST_CASE("stored stresses hand the hole over as the assembled operator does") {
  // The baseline makes up for the deleted zones to round-off whatever the route: at the first step nothing is unbalanced. Then
  // the offset fades and grains that are springs of another stress push back. Without local damping, which turns with signs,
  // both routes move the interface alike to the round-off that 1000 steps gather.
  const auto run = [](const std::string& route, std::vector<Vec3s>& velocity, double& first_ratio) {
    SpringGrains grains;
    grains.start_force = [](const protocol::InitialStress& s) {
      Vec3s force = lumped_tractions(s);
      for (Vec3& f : force) f *= 0.8;
      return force;
    };
    grains.penetrate_steps = 200;
    grains.watch = [&](const protocol::Velocities& v) {
      velocity.push_back(v.velocity);
      if (v.step == 1) first_ratio = v.unbalanced_ratio;
    };
    std::string scene = hole;
    scene.insert(scene.find('{') + 1, " route: " + route);
    const RunReport report = couple(
        scene + "apply { damping: 0 max_steps: 800 ramp_transits: 2 tolerance: 1e-9 } run { continuum_damping: 0 }",
        grains);
    INFO(grains.error);
    CHECK(grains.error.empty());
    return report;
  };
  std::vector<Vec3s> assembled, incremental;
  double assembled_ratio = 1, incremental_ratio = 1;
  const RunReport a = run("ASSEMBLED", assembled, assembled_ratio);
  const RunReport b = run("INCREMENTAL", incremental, incremental_ratio);
  REQUIRE(assembled.size() == 1000);
  REQUIRE(incremental.size() == assembled.size());
  double error = 0, scale = 0;
  for (std::size_t n = 0; n < assembled.size(); ++n)
    for (std::size_t i = 0; i < assembled[n].size(); ++i) {
      error = std::max(error, (assembled[n][i] - incremental[n][i]).norm());
      scale = std::max(scale, assembled[n][i].norm());
    }
  INFO("first unbalanced ratio " << assembled_ratio << " and " << incremental_ratio
                                 << "; interface velocities differ by " << error / scale << " of the largest, " << scale
                                 << " m/s; jump " << a.jump.largest << " m, by "
                                 << b.jump.largest / a.jump.largest - 1);
  CHECK(assembled_ratio < 1e-12);
  CHECK(incremental_ratio < 1e-12);
  CHECK(scale > 1e-5);
  CHECK(error / scale < 1e-10);
  CHECK(b.jump.largest == Approx(a.jump.largest).epsilon(1e-10));
  CHECK(b.ledger_residual_fraction < 1e-9);
}

TEST_CASE("two sessions of one scene end with the same bits") {
  SpringGrains a, b;
  a.start_force = b.start_force = lumped_tractions;
  const std::string scene = hole + "apply { max_steps: 30 }";
  const RunReport first = couple(scene, a), second = couple(scene, b);
  CHECK(first.state_hash == second.state_hash);
  CHECK(first.position_hash == second.position_hash);
  CHECK_FALSE(first.jump.apply_converged);
}

TEST_CASE("a block without an Apply stage answers a load on its top at once") {
  // E u / H = load / area for a bar with free sides, damped to rest: fixed bottom, so somewhat stiffer.
  SpringGrains grains;
  grains.stiffness = 0;
  grains.penetrate_steps = 1000000;
  const double pressure = 1000;
  grains.start_force = [&](const protocol::InitialStress& s) {
    Vec3s f(s.nodes.size(), Vec3::Zero());
    for (const auto& facet : s.facets)
      for (int n : facet) f[n].z() -= pressure / 16 / 4;
    return f;
  };
  const RunReport report = couple(
      "gravity: 0 continuum { block { height: 4 zones_z: 12 } supports: BOTTOM_FIXED } grains { grain { } } apply { "
      "max_steps: 0 } "
      "run { duration: 1 continuum_damping: 0.5 }",
      grains);
  INFO(grains.error);
  CHECK(grains.error.empty());
  CHECK(report.time == Approx(1).epsilon(0.01));
  const double expected = pressure * 4 / 44.3e6;
  INFO("settlement over that of a free bar " << report.largest_displacement / expected);
  CHECK(report.largest_displacement / expected == Approx(0.96).margin(0.04));
  CHECK(report.ledger_residual_fraction < 1e-9);
}

TEST_CASE("the time step is cut when the grains ask for it, one step later, and never grows back") {
  SpringGrains grains;
  grains.cut_at = 10, grains.cut_step = 1e-5;
  grains.penetrate_steps = 40;
  const RunReport report = couple(hole + "apply { max_steps: 0 } fidelity { step_fraction: 0.5 }", grains);
  REQUIRE(grains.steps.size() == 40);
  CHECK(grains.steps[10] == grains.steps[0]);
  CHECK(grains.steps[11] == 0.5e-5);
  CHECK(grains.steps[39] == 0.5e-5);
  CHECK(report.step_cuts == 1);
  CHECK(report.step_limited_by == "grains");
}

TEST_CASE("the step comes from zones, contacts on them and grains, whichever is lowest") {
  SpringGrains soft, stiff;
  soft.stiffness = 0, stiff.stiffness = 1e9;
  const std::string scene = hole + "apply { max_steps: 0 }";
  const RunReport free = couple(scene, soft), held = couple(scene, stiff);
  CHECK(free.step_limited_by == "zones");
  CHECK(held.step_limited_by == "zones with contacts");
  CHECK(held.first_time_step < 0.2 * free.first_time_step);
}

TEST_CASE("grains that hide their stiffness make the ground run away, and both sides are told where") {
  // Springs fifty times stiffer than the stable step allows for, reported as soft once the run has started.
  SpringGrains grains;
  grains.stiffness = 0;
  double real = 1e10;
  grains.watch = [&](const protocol::Velocities& v) {
    if (v.step == 1) grains.stiffness = real;
  };
  grains.start_force = [](const protocol::InitialStress& s) { return Vec3s(s.nodes.size(), Vec3(0, 0, -1)); };
  grains.penetrate_steps = 100000;
  CHECK_THROWS_WITH(couple(hole + "apply { max_steps: 0 }", grains),
                    Catch::Matchers::Contains("runs away") && Catch::Matchers::Contains("fidelity.step_fraction"));
  CHECK_THAT(grains.error, Catch::Matchers::Contains("runs away"));
}

TEST_CASE("grains with other positions are refused at Excavate") {
  SpringGrains grains;
  grains.spoils_positions = true;
  CHECK_THROWS_WITH(couple(hole, grains), Catch::Matchers::Contains("position_hash"));
  CHECK_THAT(grains.error, Catch::Matchers::Contains("position_hash"));
}

TEST_CASE("an interrupted run finishes its step and says so") {
  SpringGrains grains;
  grains.watch = [](const protocol::Velocities& v) {
    if (v.step == 5) interrupt_requested() = true;
  };
  const RunReport report = couple(hole + "apply { max_steps: 0 }", grains);
  interrupt_requested() = false;
  CHECK(report.is_interrupted);
  CHECK(report.steps == 6);
}

TEST_CASE("points, sections and lines come with a coupled run, and whole from one that fails") {
  const std::string results =
      "results { strain: true unbalanced_force: true reactions: true point { name: \"side\" near { x: 0.8 z: -1 } } "
      "section { name: \"xz\" normal { y: 1 } } line { name: \"x\" begin { x: -1.5 z: -1 } end { x: 1.5 z: -1 } } } ";
  std::string scene = hole;
  scene.insert(scene.find('{') + 1, " " + results);
  for (const bool fails : {false, true}) {
    const std::filesystem::path folder =
        std::filesystem::temp_directory_path() / ("lockstep_continuum_" + std::to_string(std::random_device{}()));
    SpringGrains grains;
    grains.start_force = lumped_tractions;
    if (fails) {
      grains.stiffness = 0, grains.penetrate_steps = 100000;
      grains.watch = [&](const protocol::Velocities& v) {
        if (v.step == 30) grains.stiffness = 1e10;
      };
      CHECK_THROWS_WITH(couple(scene + "apply { max_steps: 0 } output { history_interval: 10 }", grains, folder),
                        Catch::Matchers::Contains("runs away"));
    } else {
      couple(scene + "apply { max_steps: 20 } output { history_interval: 10 }", grains, folder);
    }
    const auto text_of = [&](const std::string& name) {
      std::stringstream text;
      text << std::ifstream(folder / name).rdbuf();
      return text.str();
    };
    const auto rows_of = [&](const std::string& name) {
      const std::string text = text_of(name);
      return std::count(text.begin(), text.end(), '\n') - 1;
    };
    CHECK(rows_of("point_side.csv") == rows_of("continuum_history.csv"));
    // 51 points on 3 m, of which 14 or 15 lie in the hole of 0.875 m.
    CHECK(rows_of("line_x_0001.csv") == 36);
    for (const char* name : {"zones_0001.vtu", "section_xz_0001.vtp", "section_xz.pvd"})
      CHECK_THAT(text_of(name), Catch::Matchers::EndsWith("</VTKFile>\n"));
    CHECK_THAT(text_of("zones_0001.vtu"), Catch::Matchers::Contains("reaction [N]"));
    std::filesystem::remove_all(folder);
  }
  // In the hole, where the zones are deleted: refused before the ground is brought to equilibrium.
  SpringGrains grains;
  CHECK_THROWS_WITH(
      couple("continuum { results { point { name: \"p\" near { z: -1 } } } " + hole.substr(hole.find('{') + 1), grains),
      Catch::Matchers::Contains("deleted at Excavate"));
}

TEST_CASE("a scene without grains runs alone and stays at rest") {
  const SceneFile scene = parse_scene("continuum { block { zones_z: 8 } } run { duration: 0.05 }", "test.txt");
  RunOptions options;
  options.prints_progress = false;
  const RunReport report = run_continuum(scene, {}, nullptr, options);
  CHECK(report.steps > 10);
  CHECK(report.largest_displacement < 1e-12);
}

TEST_CASE("the results folder holds history, zones, interface and summary") {
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("lockstep_continuum_" + std::to_string(std::random_device{}()));
  SpringGrains grains;
  couple(hole + "apply { max_steps: 0 } output { history_interval: 10 }", grains, folder);
  for (const char* name : {"continuum_history.csv", "zones_0000.vtu", "zones_0001.vtu", "zones.pvd", "interface.vtp",
                           "continuum_summary.json"})
    CHECK(std::filesystem::file_size(folder / name) > 100);
  std::stringstream summary;
  summary << std::ifstream(folder / "continuum_summary.json").rdbuf();
  for (const char* key :
       {"hand_off", "residual_fraction", "limited_by", "state_hash", "wait_for_forces", "excavation_residual"})
    CHECK_THAT(summary.str(), Catch::Matchers::Contains(key));
  std::filesystem::remove_all(folder);
}

}  // namespace lockstep::continuum
