#include "dem_server/packing.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>

#include "common/checks.hpp"
#include "common/log.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/generation.hpp"
#include "dem_server/measure.hpp"

namespace lockstep::dem {

namespace {

using Clock = std::chrono::steady_clock;

double pile_volume(const Settings& s) {
  if (!s.pile) return 0;
  const double radius = s.pile->shape.radius;
  return pi * radius * radius * s.pile->embedment;
}

// What the packing has to fill.
struct Space {
  const Container& container;
  std::optional<Pile> pile;

  explicit Space(const Settings& s) : container(s.packing->container) {
    if (s.pile) pile.emplace(s.pile->shape, container.top - s.pile->embedment);
  }

  double room(const Vec3& x) const {
    const double depth = container.depth_inside(x);
    return pile ? std::min(depth, pile->closest(x).distance) : depth;
  }

  // True when the body's centre, moved by `shift`, stays clip_distance radii away from sides, bottom and pile, no
  // pebble's centre lies beyond them, and the centre is below the fill level. What sticks out by less is pushed back
  // when the packing is relaxed.
  bool keeps(const Particles& p, std::size_t body, const Vec3& shift) const {
    const Vec3 center = p.position(body) + shift;
    if (center.z() > container.top) return false;
    if (room(center) < clip_distance * p.equivalent_radius(body)) return false;
    for (auto i = p.pebble_begin(body); i < p.pebble_end(body); ++i)
      if (room(p.pebble_center(static_cast<std::size_t>(i)) + shift) < 0) return false;
    return true;
  }
};

// The same packing with every length times `factor`. Contact stiffness goes with the radius, so pressure and porosity
// stay.
Cube magnified(const Cube& cube, double factor) {
  Cube m = cube;
  m.period *= factor;
  for (std::size_t b = 0; b < m.particles.body_count(); ++b) {
    m.particles.position(b) *= factor;
    m.particles.scale(b, factor);
  }
  return m;
}

// Visits the bodies that the container keeps of the cube's tiles: number in the cube, and shift of the copy.
template <class Visitor>
void for_each_kept(const Cube& cube, const Vec3& lead, const Space& space, Visitor&& visit) {
  const Container& c = space.container;
  const double reach_x = c.kind == Container::Kind::Cylinder ? c.radius : c.half_x;
  const double reach_y = c.kind == Container::Kind::Cylinder ? c.radius : c.half_y;
  for_each_tiled(cube, {-reach_x, -reach_y, c.bottom}, {reach_x, reach_y, c.top}, lead,
                 [&](std::size_t b, const Vec3& shift) {
                   if (space.keeps(cube.particles, b, shift)) visit(b, shift);
                 });
}

std::size_t count_kept(const Cube& cube, const Vec3& lead, const Space& space) {
  std::size_t count = 0;
  for_each_kept(cube, lead, space, [&](std::size_t, const Vec3&) { ++count; });
  return count;
}

Particles cut(const Cube& cube, const Vec3& lead, const Space& space) {
  Particles kept;
  kept.reserve_copies(cube.particles, count_kept(cube, lead, space));
  for_each_kept(cube, lead, space,
                [&](std::size_t b, const Vec3& shift) { kept.append_copy(cube.particles, b, shift); });
  return kept;
}

// The cut with the magnification at which `count` grains are kept. Their number falls as factor^-3 with a scatter of
// whole grains, so Newton's iteration on that law closes in within a few trials; the nearest is taken. Where it goes
// round in circles (a container a few grains wide), the cube's place under the container is another knob: its three
// leads follow Kronecker sequences. A trial only counts: grains are copied once.
Particles cut_to_count(const Cube& cube, std::uint32_t count, const Space& space) {
  double factor = 1, best_factor = 1, best_error = 1e300;
  Vec3 best_lead = Vec3::Zero();
  std::size_t best_count = 0;
  for (int trial = 0; trial < count_trials && best_error > count_tolerance * count; ++trial) {
    const double turn = trial < lead_trials ? 0.0 : trial;
    const Vec3 lead =
        (turn * Vec3(0.8191725134, 0.6710436067, 0.5497004779)).unaryExpr([](double x) { return x - std::floor(x); });
    const std::size_t kept = count_kept(magnified(cube, factor), lead, space);
    const double error = std::abs(static_cast<double>(kept) - count);
    if (error < best_error) best_error = error, best_factor = factor, best_lead = lead, best_count = kept;
    factor *= std::cbrt(std::max(1.0, static_cast<double>(kept)) / count);
  }
  if (best_error > 0.01 * count)
    throw InputError(
        fmt::format("grains.packing.count = {}: the container holds {} or so, not within 1 % of it; a container only a "
                    "few grains wide cannot meet every count: give {} or set count: 0 and a radius",
                    count, best_count, best_count));
  return cut(magnified(cube, best_factor), best_lead, space);
}

Assembly assemble_packing(const Settings& s, double ground_density, const Heartbeat& heartbeat, int threads) {
  const PackingSettings& packing = *s.packing;
  const Container& container = packing.container;
  const double room = container.volume() - pile_volume(s);
  Assembly a;

  // First guess of the radius for a count; cut_to_count mends it.
  const double radius =
      packing.count ? std::cbrt(room * (1 - packing.porosity) / (packing.count * 4.0 / 3.0 * pi)) : packing.radius;
  CubeRequest request = cube_request(s, radius);
  request.threads = worthwhile_threads(packing.cube_grains, threads);
  request.progress = heartbeat;
  const auto begin = Clock::now();
  const Cube cube = make_cube(request);
  a.cube_porosity = cube.porosity;
  a.preparation_friction = cube.preparation_friction;
  const auto cube_made = Clock::now();

  const Space space(s);
  a.particles = packing.count ? cut_to_count(cube, packing.count, space) : cut(cube, Vec3::Zero(), space);
  spdlog::info(
      "cube: {} grains, porosity {:.4f} at preparation friction {:.3f}, {} tries, {} steps, {:.1f} s; cut in {:.2f} s",
      cube.particles.body_count(), cube.porosity, cube.preparation_friction, cube.tries, cube.steps,
      std::chrono::duration<double>(cube_made - begin).count(),
      std::chrono::duration<double>(Clock::now() - cube_made).count());
  if (a.particles.body_count() == 0)
    throw InputError(
        fmt::format("grains.packing: no grain of mean radius {:.4g} m fits into the container; give a smaller "
                    "radius, or a larger container",
                    radius));

  a.solid_density = s.density;
  refit(a, s, ground_density, a.particles);
  return a;
}

// Equal spheres on a cubic lattice. A pulse v(z) that travels down a chain of wave speed c carries the displacement
// u(z) = (1/c) int_{-inf}^z v dz' with it (u = f(z + c t) and u_t = v give f' = v/c; the chain below is still at rest).
void add_lattice(const LatticeSettings& l, const Settings& s, Assembly& a) {
  ClumpTemplate sphere = make_clump(1, 1);
  if (l.holds_spins) sphere.inertia_per_mass.setConstant(held_inertia);
  const double pitch = 2 * l.radius - l.overlap, side_pitch = 2 * l.radius - l.side_overlap;
  const double floor_overlap = l.overlap / s.facet_stiffness_factor;  // the same force in facet and pair
  const double mass = s.density * 4.0 / 3.0 * pi * std::pow(l.radius, 3);
  const double speed = pitch * std::sqrt(s.material.contact_modulus * 2 * l.radius / mass);
  const auto hump = [&](double z) {  // integral of (1 + cos(2 pi t))/2 over z', from the lower end of the hump to z
    const double t = std::clamp((z - l.pulse_center) / l.pulse_length, -0.5, 0.5);
    return l.pulse_length * 0.5 * (t + 0.5 + std::sin(2 * pi * t) / (2 * pi));
  };
  for (std::uint32_t k = 0; k < l.count_z; ++k)
    for (std::uint32_t j = 0; j < l.count_y; ++j)
      for (std::uint32_t i = 0; i < l.count_x; ++i) {
        const double x = (i - 0.5 * (l.count_x - 1)) * side_pitch;
        const double y = (j - 0.5 * (l.count_y - 1)) * side_pitch;
        const double z = l.bottom + l.radius - floor_overlap + k * pitch;
        const double t = (z - l.pulse_center) / l.pulse_length;
        const double velocity = std::abs(t) < 0.5 ? l.pulse_velocity * 0.5 * (1 + std::cos(2 * pi * t)) : 0.0;
        const double displacement = l.pulse_velocity / speed * hump(z);
        const auto body = a.particles.add(sphere, l.radius, s.density, {x, y, z + displacement}, Quat::Identity());
        a.particles.velocity(body) = Vec3(0, 0, velocity);
        if (l.fix_top) {
          a.is_fixed.resize(a.particles.body_count(), 0);
          a.is_fixed[body] = k + 1 == l.count_z;
        }
      }
}

}  // namespace

CubeRequest cube_request(const Settings& s, double radius) {
  const PackingSettings& packing = *s.packing;
  CubeRequest request;
  request.grains = static_cast<int>(packing.cube_grains);
  request.radius_mean = radius;
  request.radius_ratio = packing.radius_ratio;
  request.pebbles = s.pebbles;
  request.elongation = s.elongation;
  request.porosity = packing.porosity;
  request.pressure = packing.cube_pressure;
  request.density = s.density;
  request.material = s.material;
  request.seed = s.seed;
  return request;
}

int worthwhile_threads(std::size_t grains, int threads) {
  constexpr std::size_t grains_per_thread =
      4000;  // 1 ms a step; two threads for 600 took 10 to 20 times the time of one
  return std::clamp(static_cast<int>(grains / grains_per_thread), 1, threads);
}

double bulk_porosity(const Settings& s, const Assembly& a, const Particles& p) {
  if (!s.packing || p.body_count() == 0) return 0;
  const Container& container = s.packing->container;
  const double inset = wall_order * a.mean_radius;
  std::optional<Pile> pile;
  if (s.pile) pile.emplace(s.pile->shape, container.top - s.pile->embedment);
  const double half_x = container.kind == Container::Kind::Cylinder ? container.radius : container.half_x;
  const double half_y = container.kind == Container::Kind::Cylinder ? container.radius : container.half_y;
  const Box bounds{{-half_x, -half_y, container.bottom + inset}, {half_x, half_y, container.top - inset}};
  if (!(bounds.volume() > 0) || bounds.high.z() <= bounds.low.z() || std::min(half_x, half_y) <= inset) return 0;
  return porosity(p, bounds, a.mean_radius / 4, [&](const Vec3& x) {
    return container.depth_inside(x) > inset && (!pile || pile->closest(x).distance > inset);
  });
}

void refit(Assembly& a, const Settings& s, double ground_density, Particles& p) {
  if (!s.packing || p.body_count() == 0) return;
  const double room = s.packing->container.volume() - pile_volume(s);
  const double solid = solid_volume(p);
  a.overall_porosity = 1 - solid / room;
  const double density =
      s.packing->match_continuum_density && ground_density > 0 ? ground_density * room / solid : s.density;
  for (std::size_t b = 0; b < p.body_count(); ++b) p.scale_mass(b, density / a.solid_density);
  a.solid_density = density;
  a.mean_radius = p.mean_radius();
}

Assembly assemble(const Settings& s, double ground_density, const Heartbeat& heartbeat, int threads) {
  Assembly a;
  if (s.packing) a = assemble_packing(s, ground_density, heartbeat, threads);
  if (s.lattice) add_lattice(*s.lattice, s, a);
  const double density = a.solid_density > 0 ? a.solid_density : s.density;
  for (const GrainSettings& g : s.grains) {
    const ClumpTemplate shape = g.is_clump ? make_clump(s.pebbles, s.elongation) : make_clump(1, 1);
    const auto body = a.particles.add(shape, g.radius, density, g.center, Quat::Identity());
    a.particles.velocity(body) = g.velocity;
    a.particles.spin(body) = g.spin;
  }
  a.solid_density = density;
  if (!a.is_fixed.empty()) a.is_fixed.resize(a.particles.body_count(), 0);
  a.particles.place_pebbles();
  a.particles.clear_forces();
  a.mean_radius = a.particles.mean_radius();
  return a;
}

}  // namespace lockstep::dem
