// The same bits from any number of threads and any instruction set, and both forms of the operator beside the plain one.
#include <catch2/catch.hpp>
#include <limits>

#include "tests/continuum_client/fixtures.hpp"

namespace lockstep::continuum {
namespace {

// A mesh with a hole, levels of equal and of growing height, and nodes without zones.
Grid excavated_ground(std::vector<char>& is_left) {
  Grid grid = small_cylinder();
  is_left = zones_outside_discrete_domain(grid);
  return grid;
}

Vec3s some_field(std::size_t count, std::uint64_t seed) {
  Random random(seed);
  Vec3s field(count);
  for (Vec3& v : field)
    for (int c = 0; c < 3; ++c) v[c] = random.uniform(-1, 1);
  return field;
}

std::uint64_t hash_of(const Vec3s& field) {
  Hash h;
  h.add(std::span<const Vec3>(field));
  return h.value();
}

}  // namespace

TEST_CASE("rows of both forms give the assembled matrix's product") {
  // Each product of a block and a vector is the same; their sums differ by the order of 27 terms: some eps of the sum of
  // sizes.
  std::vector<char> is_left;
  const Grid meshes[] = {excavated_ground(is_left), brick(1, 1, 1, 3, 3, 19)};
  for (const Grid& grid : meshes) {
    const StiffnessMatrix k =
        assemble_stiffness(grid, grid.zone_count() == is_left.size() ? is_left : std::vector<char>{});
    const Vec3s u = some_field(grid.node_count(), 1), reference = some_field(grid.node_count(), 2);
    Vec3s exact(u.size()), f(u.size());
    k.multiply(u, exact);
    double scale = 0;
    for (const Vec3& v : exact) scale = std::max(scale, v.norm());
    for (const auto format : {StiffnessProduct::Format::SharedRows, StiffnessProduct::Format::HalfRows})
      for (const InstructionSet set : known_instructions()) {
        StiffnessProduct product(k, format, set);
        product.evaluate(u, reference, f);
        double error = 0;
        for (std::size_t i = 0; i < f.size(); ++i)
          error = std::max(error, (f[i] - reference[i] - exact[i]).norm() / scale);
        CAPTURE(name_of(set), static_cast<int>(format), error);
        CHECK(error > 0);  // another order: no error at all would mean that the plain product was called
        CHECK(error < 30 * std::numeric_limits<double>::epsilon());
      }
  }
}

TEST_CASE("zones without a matrix give its product, on distorted and warped zones of two materials") {
  // The matrix is sums of the same zones' stiffness, 24 x 24 each: forces differ by the order of some hundred terms, of
  // which each is as large as the largest force.
  std::vector<char> is_left;
  Grid meshes[] = {excavated_ground(is_left), brick(1, 1, 1, 3, 3, 19), brick(1, 1, 1, 5, 4, 2)};
  for (Grid& grid : meshes) {
    const std::vector<char> included = grid.zone_count() == is_left.size() ? is_left : std::vector<char>{};
    grid.zone_kind = ZoneKind::OnePoint;
    distort(grid, 0.05, 0.2);
    grid.materials.push_back({elastic_moduli(1e6, 0.45), 1000});
    for (std::size_t z = 0; z < grid.zone_count(); z += 3) grid.material[z] = 1;
    const StiffnessMatrix k = assemble_stiffness(grid, included);
    const Vec3s u = some_field(grid.node_count(), 1), reference = some_field(grid.node_count(), 2);
    Vec3s exact(u.size()), f(u.size());
    k.multiply(u, exact);
    double scale = 0;
    for (const Vec3& v : exact) scale = std::max(scale, v.norm());
    std::uint64_t expected = 0;
    for (const InstructionSet set : known_instructions())
      for (const int threads : {1, 3}) {
        Team team(threads);
        StiffnessProduct product = StiffnessProduct::of_zones(grid, included, set);
        product.evaluate(u, reference, f, team);
        double error = 0;
        for (std::size_t i = 0; i < f.size(); ++i)
          error = std::max(error, (f[i] - reference[i] - exact[i]).norm() / scale);
        INFO(name_of(set) << ", " << threads << " threads: error " << error);
        CHECK(error < 300 * std::numeric_limits<double>::epsilon());
        if (expected == 0) expected = hash_of(f);
        CHECK(hash_of(f) == expected);
      }
  }
}

TEST_CASE("levels of one height share their rows, distorted zones do not") {
  const Grid regular = brick(1, 1, 4, 4, 4, 32);
  Grid distorted = regular;
  distort(distorted, 0.1, 0.1);
  const StiffnessProduct shared(assemble_stiffness(regular)), half(assemble_stiffness(distorted));
  CHECK(shared.format() == StiffnessProduct::Format::SharedRows);
  CHECK(half.format() == StiffnessProduct::Format::HalfRows);
  // A column has three kinds of nodes, bottom, top and the 31 between: 3 rows of at most 27 blocks for 25 columns,
  // instead of 33 half rows of 14.
  INFO(shared.bytes() << " bytes shared, " << half.bytes() << " half");
  CHECK(shared.bytes() < half.bytes() / 2);
}

TEST_CASE("the ground's step has the same bits for any threads and instructions") {
  std::vector<char> is_left;
  const Grid with_hole = excavated_ground(is_left), plain = brick(1, 1, 1, 6, 6, 41);
  Grid irregular = plain;
  distort(irregular, 1.0 / 41, 0.1);
  Grid one_point = irregular;
  one_point.zone_kind = ZoneKind::OnePoint;
  const Grid* const meshes[] = {&with_hole, &plain, &irregular, &one_point};
  for (const Grid* grid : meshes) {
    const std::vector<char> included = grid == &with_hole ? is_left : std::vector<char>{};
    const StiffnessMatrix k = assemble_stiffness(*grid, included);
    const std::vector<double> mass = lumped_masses(*grid, included);
    const Vec3s is_free = free_components(*grid, Supports::BottomFixed, mass);
    const InterfaceSurface surface = interface_surface(*grid);
    const double dt = 0.5 * stable_step(frequency_squared_bound(k, mass, is_free), 0.2);
    Vec3s dashpot = some_field(mass.size(), 5), pushed = some_field(surface.node_count(), 6);
    for (Vec3& c : dashpot) c = 0.1 / dt * c.cwiseAbs();
    std::uint64_t expected = 0;
    double energy = 0;
    for (const InstructionSet set : known_instructions())
      for (const int threads : {1, 2, 3, 8}) {
        Team team(threads);
        InternalForce force(StiffnessProduct(k, *grid, included, set));
        Integrator integrator(mass, is_free, dashpot, set);
        Motion motion{Vec3s(mass.size(), Vec3::Zero()), some_field(mass.size(), 4)};
        Vec3s internal(mass.size());
        NodalLoads loads;
        loads.gravity = Vec3(0, 0, -9.81);
        loads.interface_node = surface.node, loads.interface_force = loads.baseline_force = pushed;
        for (int n = 0; n < 50; ++n) {
          force.evaluate(motion.displacement, internal, team);
          integrator.advance(motion, internal, force.reference, loads, 0.2, {dt, dt}, 1e9, team);
        }
        const std::uint64_t hash = hash_of(motion.displacement) ^ hash_of(motion.velocity);
        CAPTURE(name_of(set), threads, grid->zone_count(), hash, integrator.ledger().residual());
        if (expected == 0) expected = hash, energy = integrator.ledger().residual();
        CHECK(hash == expected);
        CHECK(integrator.ledger().residual() == energy);
      }
  }
}

}  // namespace lockstep::continuum
