// Meshes from files: the same ground whatever the format and the order, and every fault named.
#include "continuum_client/mesh_file.hpp"

#include <spdlog/spdlog.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <map>
#include <set>

#include "continuum_client/mesh_input.hpp"
#include "continuum_client/stages.hpp"
#include "tests/continuum_client/fixtures.hpp"
#include "tests/continuum_client/mesh_writers.hpp"

namespace lockstep::continuum {
namespace {

using Catch::Matchers::Contains;

FileMeshSettings file_settings(const MeshOnDisk& file) {
  FileMeshSettings s;
  s.path = file.path();
  s.cell_array = "region";
  s.where = "scene.txt: continuum.mesh_file";
  return s;
}

// With group 2 as the discrete domain.
Grid with_hole(const std::string& bytes) {
  const MeshOnDisk file(bytes);
  FileMeshSettings s = file_settings(file);
  s.discrete_domain = {"2"};
  return of_one_material(build_from_file(s), test_material);
}

using Key = std::array<double, 3>;
Key place(const Vec3& x) { return {x.x(), x.y(), x.z()}; }

std::map<Key, std::int32_t> nodes_by_place(const Grid& grid) {
  std::map<Key, std::int32_t> nodes;
  for (std::size_t i = 0; i < grid.node_count(); ++i) nodes[place(grid.node[i])] = static_cast<std::int32_t>(i);
  return nodes;
}

// A displacement without any symmetry, the same at a place whatever its node's number [m].
Vec3 wave(const Vec3& x) {
  return {std::sin(3 * x.x() + x.y()), std::cos(2 * x.y() - x.z()), std::sin(x.x() * x.z() + 1)};
}

Vec3s force_of_wave(const Grid& grid) {
  Vec3s u, f(grid.node_count());
  for (const Vec3& x : grid.node) u.push_back(wave(x));
  assemble_stiffness(grid).multiply(u, f);
  return f;
}

struct Difference {
  double force = 0, area = 0;  // largest, of the largest of the reference
  bool has_same_rings = true, has_same_levels = true, has_same_domain = true;
};

Difference difference(const Grid& a, const Grid& b) {
  Difference d;
  const std::map<Key, std::int32_t> of_b = nodes_by_place(b);
  const Vec3s fa = force_of_wave(a), fb = force_of_wave(b);
  double scale = 0;
  for (std::size_t i = 0; i < a.node_count(); ++i) {
    d.force = std::max(d.force, (fa[i] - fb[of_b.at(place(a.node[i]))]).norm());
    scale = std::max(scale, fa[i].norm());
  }
  d.force /= scale;
  const auto facets = [](const Grid& g) {
    std::map<std::set<Key>, std::pair<int, Vec3>> all;  // ring and area vector by corners
    for (std::size_t f = 0; f < g.facet.size(); ++f) {
      FacetCorners x;
      std::set<Key> corners;
      for (int c = 0; c < 4; ++c) x[c] = g.node[g.facet[f][c]], corners.insert(place(x[c]));
      all[corners] = {g.ring[f], facet_area_vector(x)};
    }
    return all;
  };
  const auto facets_a = facets(a), facets_b = facets(b);
  d.has_same_rings = facets_a.size() == facets_b.size();
  for (const auto& [corners, facet] : facets_a) {
    const auto other = facets_b.find(corners);
    d.has_same_rings &= other != facets_b.end() && other->second.first == facet.first;
    if (other != facets_b.end())
      d.area = std::max(d.area, (other->second.second - facet.second).norm() / facet.second.norm());
  }
  const auto zones = [](const Grid& g) {
    std::map<std::set<Key>, std::pair<int, int>> all;  // level and domain by corners
    for (std::size_t z = 0; z < g.zone_count(); ++z) {
      std::set<Key> corners;
      for (const std::int32_t n : g.zone[z]) corners.insert(place(g.node[n]));
      all[corners] = {g.level[z], g.in_discrete_domain[z]};
    }
    return all;
  };
  const auto zones_b = zones(b);
  for (const auto& [corners, zone] : zones(a)) {
    const auto other = zones_b.find(corners);
    d.has_same_levels &= other != zones_b.end() && other->second.first == zone.first;
    d.has_same_domain &= other != zones_b.end() && other->second.second == zone.second;
  }
  return d;
}

std::string complaint(const std::string& bytes, const std::function<void(FileMeshSettings&)>& change = {}) {
  const MeshOnDisk file(bytes);
  FileMeshSettings s = file_settings(file);
  if (change) change(s);
  try {
    build_from_file(s);
  } catch (const Error& e) {
    return e.what();
  }
  return "no complaint";
}

PlainMesh small_brick() { return plain(brick(2, 2, 2, 2, 2, 2)); }

}  // namespace

TEST_CASE("a mesh from a file is the built-in one in every format, shuffled or not") {
  // The built-in cylinder, written with all digits, its nodes and zones in any order and zones turned at random. What is
  // read must have the same forces at the same places for a displacement without symmetry, and the same facets, rings,
  // levels and zones of the discrete domain. Forces differ by the order of sums alone, and by the exchange of the two
  // overlays where a zone is turned by 90 degrees.
  const Grid truth = small_cylinder();
  const PlainMesh straight = plain(truth), mixed = shuffled(straight, 5);
  const std::size_t interface_nodes = interface_surface(truth).node_count();
  const std::vector<std::pair<std::string, std::string>> files = {
      {"MSH 2.2, not shuffled", msh_2(straight, false)},
      {"MSH 2.2", msh_2(mixed, false)},
      {"MSH 2.2 binary", msh_2(mixed, true)},
      {"MSH 2.2 binary, other byte order", msh_2(mixed, true, true)},
      {"MSH 4.1", msh_4(mixed, false)},
      {"MSH 4.1 binary", msh_4(mixed, true)},
      {"MSH 4.1 binary, other byte order", msh_4(mixed, true, true)},
      {"VTK 3", vtk_legacy(straight, 3, false)},
      {"VTK 3 binary", vtk_legacy(mixed, 3, true)},
      {"VTK 5.1", vtk_legacy(mixed, 5, false)},
      {"VTK 5.1 binary", vtk_legacy(mixed, 5, true)},
      {"VTU", vtu(mixed, VtuForm::Ascii)},
      {"VTU inline", vtu(mixed, VtuForm::Inline)},
      {"VTU inline, other byte order", vtu(mixed, VtuForm::Inline, true)},
      {"VTU appended raw", vtu(mixed, VtuForm::AppendedRaw)},
      {"VTU appended base64", vtu(mixed, VtuForm::AppendedBase64)}};
  double worst = 0;
  for (const auto& [format, bytes] : files) {
    INFO(format);
    const Grid grid = with_hole(bytes);
    REQUIRE(grid.node_count() == truth.node_count());
    REQUIRE(grid.zone_count() == truth.zone_count());
    CHECK(grid.facet.size() == truth.facet.size());
    CHECK(interface_surface(grid).node_count() == interface_nodes);
    CHECK(grid.low == truth.low);
    CHECK(grid.high == truth.high);
    const Difference d = difference(truth, grid);
    CHECK(d.has_same_rings);
    CHECK(d.has_same_levels);
    CHECK(d.has_same_domain);
    CHECK(d.area < 1e-14);
    CHECK(d.force < 1e-13);
    worst = std::max(worst, d.force);
  }
  INFO("force of a wave: " << worst << " of the largest");
  CHECK(worst < 1e-13);
}

TEST_CASE(
    "columns are found again: a shuffled file costs a step what the built-in mesh costs, with the same bits for any "
    "order") {
  CylinderMesh deep = small_cylinder_mesh();
  deep.zones_hole_depth = 24, deep.zones_below = 16, deep.depth_growth = 1;
  const Grid truth = of_one_material(build_cylinder_in_brick(deep), test_material);
  const PlainMesh straight = plain(truth);
  const Grid first = with_hole(msh_4(shuffled(straight, 1), true)),
             second = with_hole(vtu(shuffled(straight, 2), VtuForm::Inline));
  CHECK(first.node == second.node);
  CHECK(first.zone == second.zone);
  CHECK(first.facet == second.facet);
  // The bytes of the operator that a step reads: rows shared along columns need those of the built-in order, to the few
  // ends of columns.
  const StiffnessProduct built_in(assemble_stiffness(truth)), read(assemble_stiffness(first));
  // Without the columns, in the file's order.
  Grid mixed = truth;
  const PlainMesh any = shuffled(straight, 1);
  mixed.node = any.node, mixed.zone = any.zone;
  const StiffnessProduct lost(assemble_stiffness(mixed));
  INFO("bytes: built in " << built_in.bytes() << ", from a shuffled file " << read.bytes() << ", without renumbering "
                          << lost.bytes());
  CHECK(built_in.format() == StiffnessProduct::Format::SharedRows);
  CHECK(read.format() == StiffnessProduct::Format::SharedRows);
  CHECK(static_cast<double>(read.bytes()) < 1.05 * static_cast<double>(built_in.bytes()));
  CHECK(lost.bytes() > 2 * read.bytes());
}

TEST_CASE("a mesh without columns works: a brick of tetrahedra, each cut into four hexahedra, passes the patch test") {
  // Linear displacements are exact for zones of any shape: no force at inner nodes. A cube is six tetrahedra around its
  // diagonal; each gives four hexahedra, from each corner to the middles of its edges, faces and inside.
  PlainMesh m;
  std::map<Key, std::int32_t> known;
  const auto node = [&](const Vec3& x) {
    const auto [found, is_new] = known.emplace(place(x), static_cast<std::int32_t>(m.node.size()));
    if (is_new) m.node.push_back(x);
    return found->second;
  };
  const int axes[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
  for (const auto& axis : axes) {
    // Twelve times the coordinates are whole numbers: middles have no round-off.
    std::array<Vec3, 4> corner = {Vec3::Zero(), Vec3::Zero(), Vec3::Zero(), Vec3::Constant(12)};
    corner[1][axis[0]] = 12;
    corner[2][axis[0]] = corner[2][axis[1]] = 12;
    if ((corner[1] - corner[0]).cross(corner[2] - corner[0]).dot(corner[3] - corner[0]) < 0)
      std::swap(corner[1], corner[2]);
    const auto middle = [&](std::initializer_list<int> of) {
      Vec3 sum = Vec3::Zero();
      for (const int c : of) sum += corner[c];
      return node(sum / static_cast<double>(of.size()));
    };
    const int around[4][4] = {{0, 1, 2, 3}, {1, 2, 0, 3}, {2, 0, 1, 3}, {3, 0, 2, 1}};
    for (const auto& [a, b, c, d] : around) {
      m.zone.push_back({middle({a}), middle({a, b}), middle({a, b, c}), middle({a, c}), middle({a, d}),
                        middle({a, b, d}), middle({0, 1, 2, 3}), middle({a, c, d})});
      m.group.push_back(1);
    }
  }
  const MeshOnDisk file(msh_4(m, false));
  FileMeshSettings settings = file_settings(file);
  Grid grid = of_one_material(build_from_file(settings), test_material);
  for (const ZoneKind kind : {ZoneKind::BBar, ZoneKind::OnePoint}) {
    grid.zone_kind = kind;
    check_zones(grid, "test");
    Vec3s u, f(grid.node_count());
    for (const Vec3& x : grid.node) u.push_back(1e-3 * Vec3(x.x() + 2 * x.y(), x.z() - x.x(), 3 * x.z() + x.y()));
    assemble_stiffness(grid).multiply(u, f);
    double inside = 0, outside = 0;
    int inner = 0;
    for (std::size_t i = 0; i < grid.node_count(); ++i) {
      const Vec3& x = grid.node[i];
      const bool is_inner = (x - grid.low).minCoeff() > 0 && (grid.high - x).minCoeff() > 0;
      (is_inner ? inside : outside) = std::max(is_inner ? inside : outside, f[i].norm());
      inner += is_inner ? 1 : 0;
    }
    INFO("kind " << static_cast<int>(kind) << ", " << grid.zone_count() << " zones, " << inner
                 << " inner nodes: force inside " << inside / outside << " of that outside");
    CHECK(grid.zone_count() == 24);
    CHECK(inner > 6);
    CHECK(inside < 1e-13 * outside);
    CHECK(interface_surface(grid).facet_count() == 6);  // the top: two triangles of three quadrilaterals
  }
}

TEST_CASE("a run of the ground alone has the same stresses with its mesh from a file") {
  const PlainMesh mixed = shuffled(plain(small_cylinder()), 9);
  const MeshOnDisk file(msh_4(mixed, true));
  const std::string head = "gravity: 9.81 continuum { ",
                    mesh =
                        fmt::format("mesh_file {{ file: '{}' discrete_domain: 'grains here' }}", file.path().string());
  const std::string built_in =
      "cylinder_in_brick { width: 3 depth: 4 hole_diameter: 0.875 hole_depth: 2.5 zones_around: 16 zones_radial: 5 "
      "zones_hole_depth: 6 zones_below: 3 radial_growth: 1.3 depth_growth: 1.1 }";
  for (const std::string& more :
       {std::string(), std::string("zone_kind: B_BAR"), std::string("zone_kind: ONE_POINT"),
        std::string("route: INCREMENTAL"),
        std::string("layer { top: -2.5 youngs_modulus: 2e8 density: 2000 } initial_stress { k0: 0.6 }")}) {
    const auto run = [&](const std::string& ground) {
      const std::string load =
          "load { low { x: -0.5 y: -0.5 z: -0.01 } high { x: 0.5 y: 0.5 z: 0.01 } traction { z: -1e5 } } ";
      return run_continuum(
          parse_scene(head + ground + " " + more + " dynamic: true " + load + "} run { duration: 0.02 }", "test.txt"),
          {}, nullptr, {});
    };
    const RunReport a = run(built_in), b = run(mesh);
    INFO(more << ": sigma_v at the bottom " << a.bottom_vertical_stress << " Pa; from the file it differs by "
              << b.bottom_vertical_stress - a.bottom_vertical_stress << ", K0 " << a.k0 << " by " << b.k0 - a.k0
              << ", settlement after " << a.steps << " steps " << a.settlement << " m by "
              << b.settlement - a.settlement);
    CHECK(a.zones == b.zones);
    CHECK(a.interface_nodes == b.interface_nodes);
    CHECK(a.steps == b.steps);
    CHECK(std::abs(b.bottom_vertical_stress / a.bottom_vertical_stress - 1) < 1e-11);
    CHECK(std::abs(b.k0 - a.k0) < 1e-11);
    CHECK(std::abs(b.settlement / a.settlement - 1) < 1e-9);
  }
}

TEST_CASE("groups, regions, surfaces, scale and shift of a mesh file are taken, and what is not there is named") {
  PlainMesh m = small_brick();
  for (std::size_t z = 0; z < m.zone.size(); ++z) m.group[z] = z % 2 ? 1 : 2;  // columns are two high: 1 above, 2 below
  for (std::size_t z = 0; z < m.zone.size(); ++z)
    if (z % 2) m.face.push_back(face_nodes(m.zone[z], 1));
  m.face.resize(3);
  for (const std::string& bytes : {msh_2(m, false), msh_4(shuffled(m, 3), true)}) {
    const MeshOnDisk file(bytes);
    FileMeshSettings s = file_settings(file);
    s.interface = {"top"}, s.regions = {{"grains here", 4}};
    s.scale = 0.5, s.shift = Vec3(0, 0, 7);
    const Grid grid = build_from_file(s);
    CHECK(grid.facet.size() == 3);
    CHECK(grid.low == Vec3(-0.5, -0.5, 6));
    CHECK(grid.high == Vec3(0.5, 0.5, 7));
    for (std::size_t z = 0; z < grid.zone_count(); ++z) CHECK(grid.material[z] == (grid.level[z] == 0 ? 4 : 0));
  }
  const auto with = [&](auto change) { return complaint(msh_4(m, false), change); };
  CHECK_THAT(with([](FileMeshSettings& s) { s.discrete_domain = {"grain"}; }),
             Contains("mesh_file.discrete_domain") && Contains("\"grain\"") && Contains("grains here = 2") &&
                 Contains("ground = 1"));
  CHECK_THAT(with([](FileMeshSettings& s) { s.interface = {"side"}; }),
             Contains("mesh_file.interface") && Contains("top = 7"));
  CHECK_THAT(with([](FileMeshSettings& s) {
               s.regions = {{"1", 1}, {"ground", 2}};
             }),
             Contains("two") || Contains("one material"));
  CHECK_THAT(with([](FileMeshSettings& s) { s.discrete_domain = {"1", "2"}; }), Contains("takes all 8 zones"));
  CHECK_THAT(
      complaint(vtu(m, VtuForm::Ascii), [](FileMeshSettings& s) { s.cell_array = "soil", s.discrete_domain = {"2"}; }),
      Contains("its cell arrays are region"));
}

TEST_CASE("the hole that a scene gives for the grains is compared with the mesh file") {
  const CylinderMesh c = small_cylinder_mesh();
  const std::string bytes = msh_4(plain(small_cylinder()), true);
  const auto with = [&](double diameter, double depth) {
    return complaint(bytes, [&](FileMeshSettings& s) { s.discrete_domain = {"2"}, s.hole = {diameter, depth}; });
  };
  const double flats = c.hole_diameter * std::cos(pi / c.zones_around);
  CHECK(with(flats, c.hole_depth) == "no complaint");
  CHECK_THAT(with(c.hole_diameter, c.hole_depth),
             Contains("diameter is 0.875") && Contains(fmt::format("{:.6g}", flats)));
  CHECK_THAT(with(flats, 2), Contains("depth is 2") && Contains("2.5"));
}

TEST_CASE("what is wrong with a mesh is named with its zone, place and remedy") {
  const auto changed = [](const std::function<void(PlainMesh&)>& change) {
    PlainMesh m = small_brick();
    change(m);
    return complaint(msh_4(m, false));
  };
  CHECK(changed([](PlainMesh&) {}) == "no complaint");
  // Zone 1005 is one corner moved through its opposite, zone 1003 has its bottom and top exchanged.
  CHECK_THAT(changed([](PlainMesh& m) { m.node[m.zone[5][6]] += Vec3(-0.3, -0.4, -1.5); }),
             Contains("zone 1005 around") && Contains("inside out"));
  CHECK_THAT(
      changed([](PlainMesh& m) { std::swap_ranges(m.zone[3].begin(), m.zone[3].begin() + 4, m.zone[3].begin() + 4); }),
      Contains("1 zones are turned inside out") && Contains("zone 1003 around (0.5, -0.5, -0.5) m"));
  CHECK(changed([](PlainMesh& m) {
          for (ZoneNodes& zone : m.zone) std::swap_ranges(zone.begin(), zone.begin() + 4, zone.begin() + 4);
        }) == "no complaint");
  CHECK_THAT(changed([](PlainMesh& m) {
               for (Vec3& x : m.node) x.z() = 0;
             }),
             Contains("one place") || Contains("flat"));
  CHECK_THAT(changed([](PlainMesh& m) { m.node[m.zone[7][6]] = m.node[m.zone[7][0]] + Vec3(0.68, 0.68, 0.68); }),
             Contains("too warped") && Contains("zone 1007"));
  // The top a saddle z = 0.65 (+ - + -): a corner's normal is (-1.3, -1.3, 1), atan(1.3 sqrt 2) = 61 degrees from the mean one.
  CHECK_THAT(changed([](PlainMesh& m) {
               m = plain(brick(1, 1, 2, 1, 1, 1));
               for (Vec3& x : m.node)
                 if (x.z() == 0) x.z() = x.x() * x.y() > 0 ? 0.65 : -0.65;
             }),
             Contains("face that is too warped") && Contains("zone 1000") && Contains("61 degrees"));
  CHECK_THAT(changed([](PlainMesh& m) { m.zone.push_back(m.zone[2]), m.group.push_back(1); }),
             Contains("there twice") && Contains("zone 1002") && Contains("zone 1008"));
  CHECK_THAT(changed([](PlainMesh& m) { m.zone[4][1] = m.zone[4][0]; }),
             Contains("node twice") && Contains("zone 1004"));
  CHECK_THAT(changed([](PlainMesh& m) {  // a copy of a node that zone 1006 has for itself
               m.node.push_back(m.node[m.zone[6][6]]);
               m.zone[6][6] = static_cast<std::int32_t>(m.node.size()) - 1;
             }),
             Contains("1 pairs of nodes are in one place") && Contains("merge_distance"));
  CHECK_THAT(changed([](PlainMesh& m) {  // a third zone on the inner face of zones 1000 and 1001
               ZoneNodes zone = m.zone[1];
               for (int a = 4; a < 8; ++a) {
                 m.node.push_back(m.node[zone[a]] + Vec3(0.1, 0.2, 0.4));
                 zone[a] = static_cast<std::int32_t>(m.node.size()) - 1;
               }
               m.zone.push_back(zone), m.group.push_back(1);
             }),
             Contains("belong to three zones") && Contains("1000, 1001, 1008"));
  CHECK_THAT(changed([](PlainMesh& m) {
               const PlainMesh far = small_brick();
               for (const Vec3& x : far.node) m.node.push_back(x + Vec3(5, 0, 0));
               for (ZoneNodes zone : far.zone) {
                 for (std::int32_t& n : zone) n += static_cast<std::int32_t>(far.node.size());
                 m.zone.push_back(zone), m.group.push_back(1);
               }
               m.zone.pop_back(), m.group.pop_back();
             }),
             Contains("1 bodies share no face") && Contains("7 zones with zone 1008 around (4.5, -0.5, -1.5)"));
  CHECK_THAT(changed([](PlainMesh& m) {  // a brick of 3 x 3 zones on one of 2 x 2: four nodes at the corners are shared
               const PlainMesh fine = plain(brick(2, 2, 2, 3, 3, 2));
               std::map<Key, std::int32_t> known;
               for (std::size_t i = 0; i < m.node.size(); ++i) known[place(m.node[i])] = static_cast<std::int32_t>(i);
               for (ZoneNodes zone : fine.zone) {
                 for (std::int32_t& n : zone) {
                   const Vec3 x = fine.node[n] + Vec3(0, 0, 2);
                   const auto [found, is_new] = known.emplace(place(x), static_cast<std::int32_t>(m.node.size()));
                   if (is_new) m.node.push_back(x);
                   n = found->second;
                 }
                 m.zone.push_back(zone), m.group.push_back(1);
               }
             }),
             Contains("hanging nodes") && Contains(" on zone 100"));
  CHECK_THAT(changed([](PlainMesh& m) {  // turned by 10 degrees about z
               for (Vec3& x : m.node)
                 x = Vec3(std::cos(0.17) * x.x() - std::sin(0.17) * x.y(),
                          std::sin(0.17) * x.x() + std::cos(0.17) * x.y(), x.z());
             }),
             Contains("16 outer faces are neither on the sides") && Contains("and 11 more") && Contains("free_faces"));
  CHECK_THAT(changed([](PlainMesh& m) { m.node[4].x() = 1e12; }), Contains("within 1e+09 m"));
}

TEST_CASE("nodes in one place are joined where merge_distance asks for it, and unused ones left out") {
  // Every zone with eight nodes of its own, moved by up to 1e-6 m.
  const PlainMesh whole = small_brick();
  PlainMesh m;
  Random random(2);
  for (const ZoneNodes& zone : whole.zone) {
    ZoneNodes own;
    for (int a = 0; a < 8; ++a) {
      own[a] = static_cast<std::int32_t>(m.node.size());
      m.node.push_back(whole.node[zone[a]]);
      if (m.node.back().cwiseAbs().maxCoeff() < 0.9) m.node.back().x() += 1e-6 * random.uniform();
    }
    m.zone.push_back(own), m.group.push_back(1);
  }
  m.node.push_back(Vec3(9, 9, 9));
  CHECK_THAT(complaint(msh_4(m, false)), Contains("pairs of nodes"));
  const MeshOnDisk file(msh_4(m, false));
  FileMeshSettings s = file_settings(file);
  s.merge_distance = 1e-5;
  const Grid grid = build_from_file(s);
  CHECK(grid.node_count() == 27);
  CHECK(grid.zone_count() == 8);
  CHECK(grid.high == Vec3(1, 1, 0));
}

TEST_CASE("files that are no mesh of hexahedra are refused in words") {
  const PlainMesh m = small_brick();
  const std::string msh = msh_4(m, false), old = msh_2(m, false), vtk = vtk_legacy(m, 3, false),
                    xml = vtu(m, VtuForm::Ascii);
  const auto replaced = [](std::string text, const std::string& from, const std::string& to) {
    const std::size_t at = text.find(from);
    REQUIRE(at != std::string::npos);
    return text.replace(at, from.size(), to);
  };
  CHECK_THAT(complaint(""), Contains("is empty"));
  CHECK_THAT(complaint("solid cube\n"), Contains("begins with \"solid cube\""));
  CHECK_THAT(complaint(msh, [](FileMeshSettings& s) { s.path = "/no/such/mesh.msh"; }), Contains("No such file"));
  CHECK_THAT(complaint(replaced(msh, "4.1", "4.0")), Contains("MSH version 4.0") && Contains("2.2 and 4.1"));
  CHECK_THAT(complaint(replaced(msh, "$MeshFormat", "$NOD")), Contains("before $MeshFormat"));
  CHECK_THAT(complaint(msh.substr(0, msh.size() / 2)), Contains("cut short") || Contains("is due"));
  CHECK_THAT(complaint(replaced(old, "$Nodes\n27", "$Nodes\n270000000")), Contains("270000000 nodes are due"));
  CHECK_THAT(complaint(replaced(old, "1000 5 ", "1000 4 ")),
             Contains("element 1000 is a tetrahedron") && Contains("transfinite"));
  CHECK_THAT(complaint(replaced(old, "1000 5 ", "1000 17 ")), Contains("20-node hexahedron"));
  CHECK_THAT(complaint(replaced(old, "1000 5 2 1 1 10 ", "1000 5 2 1 1 11 ")), Contains("names node 11"));
  CHECK_THAT(complaint(replaced(old, "\n10 -1 ", "\n10 nan ")), Contains("node 10") && Contains("finite"));
  CHECK_THAT(complaint(replaced(old, "\n10 -1 ", "\n10 x ")), Contains("\"x\"") && Contains("coordinate"));
  CHECK_THAT(complaint(replaced(vtk, "POINTS 27", "POINTS 500000000")), Contains("1500000000 coordinates are due"));
  CHECK_THAT(complaint(replaced(vtk, "UNSTRUCTURED_GRID", "STRUCTURED_GRID")), Contains("UNSTRUCTURED_GRID is due"));
  CHECK_THAT(complaint(replaced(vtk, "CELL_TYPES 8\n12", "CELL_TYPES 8\n10")), Contains("cell 0 is a tetrahedron"));
  CHECK_THAT(complaint(replaced(xml, "type=\"UnstructuredGrid\"", "type=\"PolyData\"")), Contains("\"PolyData\""));
  CHECK_THAT(complaint(replaced(xml, "header_type", "compressor=\"vtkZLibDataCompressor\" header_type")),
             Contains("compress"));
}

TEST_CASE("whatever bytes a mesh file holds, it is a mesh or an error in words") {
  const PlainMesh m = shuffled(plain(brick(2, 2, 2, 2, 2, 2)), 4);
  const std::vector<std::string> files = {msh_2(m, false),         msh_2(m, true),
                                          msh_4(m, false),         msh_4(m, true),
                                          vtk_legacy(m, 3, false), vtk_legacy(m, 3, true),
                                          vtk_legacy(m, 5, true),  vtu(m, VtuForm::Ascii),
                                          vtu(m, VtuForm::Inline), vtu(m, VtuForm::AppendedRaw)};
  const auto level = spdlog::get_level();
  spdlog::set_level(spdlog::level::warn);
  Random random(11);
  int refused = 0, taken = 0;
  MeshOnDisk file;
  for (const std::string& whole : files)
    for (int mutation = 0; mutation < 60; ++mutation) {
      std::string bytes = whole;
      const auto any = [&] { return static_cast<std::size_t>(random.uniform() * static_cast<double>(bytes.size())); };
      if (mutation % 4 == 0) bytes.resize(any());
      for (int flips = mutation % 4; flips > 0 && !bytes.empty(); --flips)
        bytes[any()] = static_cast<char>(mutation % 2 ? random.next() : '0' + random.next() % 10);
      file.write(bytes);
      try {
        const Grid grid = build_from_file(file_settings(file));
        ++taken;
        CHECK(grid.zone_count() > 0);
        for (const ZoneNodes& zone : grid.zone)
          for (const std::int32_t n : zone) CHECK((n >= 0 && static_cast<std::size_t>(n) < grid.node_count()));
      } catch (const InputError& e) {
        ++refused;
        CHECK_THAT(e.what(), Contains(file.path().string()) || Contains("continuum.mesh_file"));
      }
    }
  spdlog::set_level(level);
  INFO(refused << " refused, " << taken << " taken");
  CHECK(refused > taken);
  CHECK(taken > 0);
}

}  // namespace lockstep::continuum
