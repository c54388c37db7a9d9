// Cells that strain: closed-form moduli of a lattice, pressures held, and what must not matter.
#include "dem_server/periodic_cell.hpp"

#include <catch2/catch.hpp>
#include <cmath>

#include "dem_server/clumps.hpp"
#include "dem_server/measure.hpp"
#include "tests/dem_server/cubes.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

using Axes = std::array<PeriodicCell::Axis, 3>;

// Equal spheres on a face-centred cubic lattice, each with twelve neighbours at 2 R (1 - overlap).
struct Lattice {
  Particles grains;
  Vec3 period;
  double distance;  // of neighbours [m]
};

Lattice face_centred(int cells, double radius, double overlap) {
  Lattice lattice;
  lattice.distance = 2 * radius * (1 - overlap);
  const double edge = std::sqrt(2.0) * lattice.distance;
  const ClumpTemplate sphere = make_clump(1, 1);
  for (int x = 0; x < cells; ++x)
    for (int y = 0; y < cells; ++y)
      for (int z = 0; z < cells; ++z)
        for (const Vec3& place : {Vec3(0, 0, 0), Vec3(0.5, 0.5, 0), Vec3(0.5, 0, 0.5), Vec3(0, 0.5, 0.5)})
          lattice.grains.add(sphere, radius, 2650, edge * (Vec3(x, y, z) + place + Vec3::Constant(0.25)),
                             Quat::Identity());
  lattice.period = Vec3::Constant(cells * edge);
  return lattice;
}

GrainMaterial stiff(double ratio, double friction) {
  GrainMaterial material;
  material.contact_modulus = 94e6;
  material.stiffness_ratio = ratio;
  material.friction = friction;
  return material;
}

CubeRequest small_request(double radius) {
  CubeRequest request;
  request.grains = 100;
  request.porosity = 0.40;
  request.radius_mean = radius;
  request.material = stiff(8, 0.7);
  return request;
}

struct Moduli {
  double youngs, poisson;
};

// E and nu of the changes between two states, as an isotropic body under both stresses would have them:
// e1 = s1/E - 2 nu/E s3, e3 = (s3 - nu (s1 + s3))/E, linear in 1/E and nu/E.
Moduli moduli_between(const CellState& a, const CellState& b) {
  const double e1 = b.axial_strain - a.axial_strain, e3 = b.radial_strain - a.radial_strain;
  const double s1 = b.axial_stress - a.axial_stress, s3 = b.radial_stress - a.radial_stress;
  Eigen::Matrix2d m;
  m << s1, -2 * s3, s3, -(s1 + s3);
  const Eigen::Vector2d x = m.inverse() * Eigen::Vector2d(e1, e3);
  return {1 / x[0], x[1] / x[0]};
}

}  // namespace

TEST_CASE("A face-centred lattice in a cell has the moduli of its springs") {
  // Normal strains turn no sphere of a cubic lattice, so all follow the mean field: with V = d^3/sqrt 2 a sphere and six
  // contacts each, C_ijkl = d^2/V sum of (k_n - k_s) n_i n_j n_k n_l + k_s d_ik n_j n_l. For n = (+-1, +-1, 0)/sqrt 2 and so on:
  // sum n_x^4 = 1, sum n_x^2 n_y^2 = 1/2, sum n_x^2 = 2, so that
  //   C11 = sqrt 2 / d (k_n + k_s),  C12 = sqrt 2 / d (k_n - k_s)/2,  E = C11 - 2 C12^2/(C11 + C12),  nu = C12/(C11 + C12).
  // Measured are C11 and C12 from one axis that strains while two stand, as finite strain gives them: the springs' forces over
  // present areas. Without a preload contacts would open; the preload's own part is of the order of the overlap.
  constexpr double overlap = 1e-5, strain = 1e-7, radius = 0.03;
  for (const double ratio : {1.0, 8.0}) {
    Lattice lattice = face_centred(3, radius, overlap);
    PeriodicCell cell(lattice.grains, lattice.period, stiff(ratio, 1e3));
    cell.step(Axes{}, 0.7);
    const Vec3 before = cell.stress();
    constexpr int steps = 2000;  // slow: the lattice has no inhomogeneous motion to start
    const Axes pulled = {PeriodicCell::Axis{{}, strain / (steps * cell.time_step())}, {}, {}};
    for (int n = 0; n < steps; ++n) cell.step(pulled, 0.7);
    cell.step(Axes{}, 0.7);
    const Vec3 change = cell.stress() - before;
    const double k_n = 94e6 * 2 * radius, k_s = k_n / ratio, d = lattice.distance;
    const double c11 = change.x() / strain, c12 = 0.5 * (change.y() + change.z()) / strain;
    const double error11 = c11 / (std::sqrt(2.0) / d * (k_n + k_s)) - 1;
    const double error12 = (c12 - std::sqrt(2.0) / d * 0.5 * (k_n - k_s)) / c11;
    INFO("k_n/k_s " << ratio << ": C11 off by " << error11 << ", C12 by " << error12 << " of C11");
    CHECK(std::abs(error11) < 5 * overlap);
    CHECK(std::abs(error12) < 5 * overlap);
  }
}

TEST_CASE("A drained test of the lattice gives E and nu, whatever the grains' size") {
  // From C11 and C12 above, at k_n/k_s = 8: nu = (1 - 1/8)/(3 + 1/8) = 0.28 and E = C11 - 2 nu C12 with k_n = E* 2 R = E* d:
  // sqrt 2 E* (1.125 - 0.28 * 0.875) = 1.24451 E*, no R in it. At 20 kPa neighbours overlap by p/(2 sqrt 2 E*) = 7.5e-5 of d, more
  // than the first row's strain of 2e-5 opens; finite strain and preload are of that order.
  const double youngs = std::sqrt(2.0) * (1.125 - 0.28 * 0.875);
  for (const double radius : {0.03, 0.003}) {
    const Lattice lattice = face_centred(3, radius, 1e-5);
    Cube cube;
    cube.particles = lattice.grains;
    cube.period = lattice.period;
    CellTest test;
    test.pressure = 20e3;
    test.preparation_friction = 1e3;
    test.axial_strain = 2.1e-5;
    test.inertial_number = 1e-4;
    std::vector<CellState> states;
    run_cell_test(cube, stiff(8, 1e3), test, Team::alone(), [&](const CellState& s) { states.push_back(s); });
    REQUIRE(states.size() == 2);
    const Moduli m = moduli_between(states[0], states[1]);
    const double youngs_error = m.youngs / (94e6 * youngs) - 1, poisson_error = m.poisson - 0.28;
    INFO("R " << radius << " m: E off by " << youngs_error << ", nu by " << poisson_error);
    CHECK(std::abs(youngs_error) < 1e-3);
    CHECK(std::abs(poisson_error) < 1e-3);
  }
}

TEST_CASE("A packing in a cell holds its pressures and reads the same E at an eighth of the size") {
  // k_n = E* (R_i + R_j): with all lengths by f, accelerations k_n U/m go as 1/f, and at times by f all is alike again: stresses,
  // strains and E. With f = 1/8 even rounding is, since no mantissa changes.
  std::array<Moduli, 2> moduli;
  CubeRequest request = small_request(0.028);
  Cube cube = first_cube(request);
  for (int k = 0; k < 2; ++k) {
    if (k == 1) {
      for (std::size_t b = 0; b < cube.particles.body_count(); ++b) cube.particles.position(b) *= 0.125;
      cube.particles.scale_all(0.125);
      cube.period *= 0.125;
    }
    CellTest test;
    test.axial_strain = 1.1e-4;
    std::vector<CellState> states;
    const CellTestResult result =
        run_cell_test(cube, request.material, test, Team::alone(), [&](const CellState& s) { states.push_back(s); });
    double off = 0;
    for (const CellState& s : states) off = std::max(off, std::abs(s.radial_stress / test.pressure - 1));
    moduli[k] = moduli_between(states[1], states.back());
    INFO("R " << cube.particles.mean_radius() << " m: E " << moduli[k].youngs / 1e6 << " MPa, nu " << moduli[k].poisson
              << ", pressure off by " << off << ", porosity " << result.pressed.porosity);
    CHECK(off < 3e-3);
  }
  const double difference = moduli[1].youngs / moduli[0].youngs - 1;
  INFO("E of the small grains over that of the large: 1 + " << difference);
  CHECK(std::abs(difference) < 1e-9);
}

TEST_CASE("Spheres at rest in a cell that shrinks are found when they touch, images too") {
  // Three spheres of radius R in a row, 2.2 R apart in a cell of 6.6 R, the last as far from the first one's image. All touch
  // once the cell has shrunk to 6 R in x, at a strain of ln(6/6.6). No sphere moves in the cell: only its strain tells
  // the lists, whose skin is 0.01 R, that pairs come near.
  constexpr double radius = 0.05, rate = -1, dt = 1e-3;
  Particles grains;
  for (const double x : {1.0, 3.0, 5.0})
    grains.add(make_clump(1, 1), radius, 2650, {x * 1.1 * radius, radius, radius}, Quat::Identity());
  PairContacts contacts(0.01 * radius, Vec3(6.6, 20, 20) * radius);
  const int touching = static_cast<int>(std::ceil(std::log(6 / 6.6) / std::log1p(rate * dt)));  // steps
  for (int n = 1; n <= touching + 3; ++n) {
    contacts.strain(grains, Vec3(rate, 0, 0), dt);
    contacts.update(grains);
    int found = 0;
    contacts.for_each_contact(grains, [&](const ContactView&) { ++found; });
    INFO("step " << n << " of " << touching << ", period over R " << contacts.period()->x() / radius);
    REQUIRE(found == (n >= touching ? 3 : 0));
  }
  CHECK(contacts.refreshes() > 3);
}

TEST_CASE("A cell that strains far keeps its contacts, in the same bits for any number of threads") {
  // Shortened by a fifth, pairs part and meet: what the lists know must be what a fresh search finds, energies and all.
  CubeRequest request = small_request(0.028);
  const Cube cube = first_cube(request);
  std::uint64_t bits = 0;
  for (const int threads : {1, 2}) {
    Team team(threads);
    PeriodicCell cell(cube.particles, cube.period, request.material, team);
    const PeriodicCell::Axis held{100e3, 0}, pressed{{}, -2.0};
    for (int n = 0; n < 2000; ++n) cell.step({held, held, pressed}, 0.7);
    CHECK(cell.period().z() < 0.85 * cube.period.z());
    PairContacts fresh(1e-3, cell.period());
    Particles grains = cell.particles();
    fresh.update(grains);
    Coordination found(grains.body_count());
    fresh.for_each_contact(grains, [&](const ContactView& c) { found.add(c); });
    CHECK(cell.coordination() == found.mean());
    Hash h;
    grains.hash(h);
    h.add(cell.period());
    if (threads == 1) bits = h.value();
    CHECK(h.value() == bits);
  }
}
