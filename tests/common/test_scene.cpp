#include "common/scene.hpp"

#include <catch2/catch.hpp>

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "common/checks.hpp"

namespace {

using namespace lockstep;

const char* const pile_scene = R"(# a pile in sand
title: "test"
continuum {
  cylinder_in_brick { }
}
grains {
  packing { count: 5000 }
}
pile { }
)";

// The text of the InputError that the scene gives; empty if it gives none.
std::string complaint(const std::string& text, const std::vector<std::string>& overrides = {}) {
  try {
    parse_scene(text, "scene.txt", overrides);
  } catch (const InputError& e) {
    CHECK(e.code() == ExitCode::Input);
    return e.what();
  }
  return "";
}

std::string override_complaint(const std::vector<std::string>& overrides) { return complaint(pile_scene, overrides); }

bool starts_with(const std::string& text, const std::string& head) { return text.rfind(head, 0) == 0; }
bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

}  // namespace

TEST_CASE("A scene's values come from the file and its defaults from the schema") {
  const SceneFile file = parse_scene(pile_scene, "scene.txt");
  CHECK(file.scene.title() == "test");
  CHECK(file.scene.grains().packing().count() == 5000);
  CHECK(file.scene.continuum().youngs_modulus() == 44.3e6);
  CHECK(file.where("grains.packing.count") == "scene.txt:7: grains.packing.count");
  // A key left to its default stands in the block that would hold it, or nowhere if there is no such block.
  CHECK(file.where("grains.packing.radius") == "scene.txt:7: grains.packing.radius");
  CHECK(file.where("output.particles") == "scene.txt: output.particles");
}

TEST_CASE("A misspelt key fails with file, line, column and the nearest key of its block") {
  const std::string text = complaint("continuum {\n  block { }\n  poison_ratio: 0.2\n}\n");
  CAPTURE(text);
  CHECK(starts_with(text, "scene.txt:3:3: "));
  CHECK(contains(text, "\"poison_ratio\" is no key of a block Continuum"));
  CHECK(contains(text, "\"poisson_ratio\""));
}

TEST_CASE("A key that stands in the wrong block fails with the name of the right one") {
  const std::string text = complaint("grains { packing { } }\npile_velocity: 0.3\n");
  CAPTURE(text);
  CHECK(starts_with(text, "scene.txt:2:1: "));
  CHECK(contains(text, "fidelity.pile_velocity"));
}

TEST_CASE("Broken syntax, a wrong type and an unknown choice fail with line and column") {
  for (const auto& [scene, head, part] : std::vector<std::array<std::string, 3>>{
           {"continuum {\n  block { }\n", "scene.txt:3:1:", "Expected"},
           {"gravity: fast\n", "scene.txt:1:10:", "fast"},
           {"seed: -1\n", "scene.txt:1:7:", "-"},
           {"gravity: 1\ngravity: 2\n", "scene.txt:2:", "gravity"},
           {"continuum {\n  block { }\n  supports: ROLLER\n}\n", "scene.txt:3:13: ", "ALL_FIXED, ROLLERS"}}) {
    const std::string text = complaint(scene);
    CAPTURE(scene, text);
    CHECK(starts_with(text, head));
    CHECK(contains(text, part));
  }
}

TEST_CASE("A value out of range fails with line, value, range, unit, meaning and remedy") {
  CHECK(complaint("continuum {\n  block { }\n  poisson_ratio: 0.7\n}\n") ==
        "scene.txt:3: continuum.poisson_ratio = 0.7 is out of range [-0.9, 0.4999] (-): nu of the ground (paper, Table "
        "2); "
        "give a value inside");
  CHECK(complaint("continuum {\n  block { }\n  poisson_ratio: 0.4999\n}\n").empty());
}

TEST_CASE("A value that is not finite fails even where the key has no range") {
  for (const char* value : {"nan", "inf", "-inf"}) {
    const std::string text = complaint(fmt::format("grains {{\n  grain {{\n    center {{ x: {} }}\n  }}\n}}\n", value));
    CAPTURE(text);
    CHECK(starts_with(text, "scene.txt:3: grains.grain[0].center.x = "));
    CHECK(contains(text, "not finite"));
  }
  CHECK(contains(complaint("gravity: nan\ngrains { grain { } }\n"), "not finite"));
}

TEST_CASE("Overrides set numbers, choices, flags and texts, and win over the file") {
  const SceneFile file =
      parse_scene(pile_scene, "scene.txt",
                  {"fidelity.pile_velocity=0.3", "continuum.supports=ROLLERS", "output.zones=false",
                   "grains.packing.count=700", "title=other words = here", "seed=18446744073709551615"});
  CHECK(file.scene.fidelity().pile_velocity() == 0.3);
  CHECK(file.scene.continuum().supports() == scene::Continuum::ROLLERS);
  CHECK_FALSE(file.scene.output().zones());
  CHECK(file.scene.grains().packing().count() == 700);
  CHECK(file.scene.title() == "other words = here");
  CHECK(file.scene.seed() == 18446744073709551615ull);
  CHECK(file.where("grains.packing.count") == "scene.txt (--set): grains.packing.count");

  const SceneFile grain =
      parse_scene("grains { grain { } grain { radius: 0.1 } }", "g.txt", {"grains.grain[1].center.z=2"});
  CHECK(grain.scene.grains().grain(1).center().z() == 2);
}

TEST_CASE("An override that fits no key or value fails with the nearest key or the kind of value wanted") {
  for (const auto& [override_text, part] : std::vector<std::pair<std::string, std::string>>{
           {"fidelity.pile_velosity=0.3", "\"pile_velocity\""},
           {"fidelitty.pile_velocity=0.3", "\"fidelity\""},
           {"pile_velocity=0.3", "fidelity.pile_velocity"},
           {"fidelity.pile_velocity=quick", "double"},
           {"fidelity.pile_velocity=0.3 m", "double"},
           {"continuum.supports=NONE_AT_ALL", "ALL_FIXED"},
           {"grains.packing.count=-3", "uint32"},
           {"fidelity=3", "is a block"},
           {"gravity.x=3", "is a value"},
           {"gravity", "key=value"},
           {"a..b=1", "a key looks like"},
           {"plane[0].normal.x=1", "0 blocks plane"},
           {"continuum.mesh_file.file=a.msh", "no block continuum.mesh_file"},
           {"grains.lattice.count_x=3", "no block grains.lattice"},
           {"continuum.poisson_ratio=0.7", "(--set): continuum.poisson_ratio = 0.7 is out of range"}}) {
    const std::string text = override_complaint({override_text});
    CAPTURE(override_text, text);
    CHECK(contains(text, part));
  }
}

TEST_CASE("Values that contradict each other fail with both keys, both values and a remedy") {
  struct Case {
    std::vector<std::string> overrides;
    std::vector<std::string> parts;
  };
  for (const Case& c : std::vector<Case>{
           {{"continuum.cylinder_in_brick.zones_around=30"}, {"zones_around = 30", "multiple of 8", "24 or 32"}},
           {{"continuum.cylinder_in_brick.width=0.8", "pile.diameter=0.1"}, {"hole_diameter = 0.875", "width = 0.8"}},
           {{"continuum.cylinder_in_brick.depth=7"}, {"hole_depth = 7.2", "depth = 7 m"}},
           {{"pile.diameter=0.8"}, {"pile.diameter = 0.8", "hole_diameter = 0.875", "thinner"}},
           {{"pile.embedment=7"}, {"pile.embedment = 7", "pile.penetration = 1", "7.25", "hole_depth = 7.2"}}}) {
    const std::string text = override_complaint(c.overrides);
    CAPTURE(text);
    for (const std::string& part : c.parts) CHECK(contains(text, part));
  }
  for (const auto& [scene, part] : std::vector<std::pair<std::string, std::string>>{
           {"", "models nothing"},
           {"continuum { }", "cylinder_in_brick { } or block { }"},
           {"grains { }", "packing { }, lattice { } or grain { }"},
           {"grains { packing { } }", "grains.packing.box"},
           {"grains { packing { box { } } }", "neither grains.packing.count nor grains.packing.radius"},
           {"grains { packing { count: 9 box { } } } continuum { cylinder_in_brick { } }", "container already"},
           {"continuum { mesh_file { } }", "continuum.mesh_file.file is missing"},
           {"continuum { mesh_file { file: 'a.msh' } } fidelity { mesh_refinement: 2 }", "finer or coarser"},
           {"continuum { mesh_file { file: 'a.msh' hole { diameter: 1 depth: 1 } } }", "names no group"},
           {"continuum { mesh_file { file: 'a.msh' discrete_domain: 'a' interface: 'b' } }", "leave out interface"},
           {"grains { packing { } } continuum { mesh_file { file: 'a.msh' } }", "continuum.mesh_file.hole"},
           {"pile { embedment: 2 } grains { packing { count: 99 } } continuum { mesh_file { file: 'a.msh' "
            "discrete_domain: "
            "'a' hole { diameter: 1 depth: 2 } } }",
            "continuum.mesh_file.hole.depth = 2"},
           {"grains { packing { count: 9 box { width_x: 2 } } } continuum { block { } }",
            "continuum.block.width_x = 1"},
           {"grains { packing { count: 9 box { bottom: -1 } } } continuum { block { } }", "continuum.block.top_z = 0"},
           {"grains { lattice { overlap: 0.1 } }", "grains.lattice.radius = 0.05"},
           {"grains { lattice { side_overlap: 0.1 } }", "grains.lattice.side_overlap = 0.1"},
           {"grains { lattice { } } continuum { block { } } packet { length: 1 }", "apply.max_steps = 0 (now 60000)"},
           {"continuum { cylinder_in_brick { } } pile { }", "give grains.packing"},
           {"grains { grain { } } plane { }", "plane[0].normal"}}) {
    const std::string text = complaint(scene);
    CAPTURE(scene, text);
    CHECK(contains(text, part));
  }
}

TEST_CASE("The digest depends on values alone, overrides included, and not on layout") {
  const std::string digest = parse_scene(pile_scene, "a.txt").digest;
  CHECK(digest.size() == 16);
  CHECK(digest.find_first_not_of("0123456789abcdef") == std::string::npos);
  CHECK(parse_scene(
            "pile { } grains { packing { count: 5000 } } # else\ncontinuum { cylinder_in_brick { } } title: \"test\"",
            "b.txt")
            .digest == digest);
  CHECK(parse_scene(pile_scene, "a.txt", {"gravity=9.8"}).digest != digest);
}

TEST_CASE("A scene that cannot be read is an IoError with path, reason and remedy") {
  try {
    read_scene("/no/such/scene.txt");
    FAIL("no error");
  } catch (const IoError& e) {
    const std::string text = e.what();
    CAPTURE(text);
    CHECK(contains(text, "/no/such/scene.txt"));
    CHECK(contains(text, "No such file"));
    CHECK(contains(text, "scene.txt"));
  }
}

TEST_CASE("Every scene that ships is valid") {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(std::string(SOURCE_DIR) + "/scenarios")) {
    if (!std::filesystem::exists(entry.path() / "scene.txt")) continue;
    INFO(entry.path());
    CHECK_NOTHROW(read_scene(entry.path()));
    ++count;
  }
  CHECK(count > 0);
}

TEST_CASE("The list of keys names every key once with its default, range and effect") {
  const std::string keys = list_keys();
  CHECK(contains(keys, "\ngravity "));
  CHECK(contains(keys, "\n  poisson_ratio "));
  CHECK(contains(keys, "[-0.9, 0.4999]"));
  CHECK(contains(keys, "one of ALL_FIXED, ROLLERS, BOTTOM_FIXED, BOTTOM_ROLLER"));
  CHECK(contains(keys, "at most one of cylinder_in_brick, block, mesh_file"));
  CHECK(contains(keys, "\n    hole_diameter "));
  CHECK(lockstep_version() == "0.1.0");
}
