#include "dem_server/generation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/contacts.hpp"
#include "dem_server/integrator.hpp"
#include "dem_server/measure.hpp"
#include "dem_server/timestep.hpp"

namespace lockstep::dem {

namespace {

// Friction while packing against the porosity that make_cube reaches with it: 500 grains, 50 kPa, E* = 94 MPa,
// elongation 1.5 (dem_server/README.md has the runs; scatter between seeds 0.003). Without any friction clumps never
// come to rest.
constexpr std::array<double, 6> table_friction = {0.02, 0.05, 0.1, 0.2, 0.4, 0.7};
using Row = std::array<double, 6>;
constexpr Row table_1 = {0.375, 0.386, 0.396, 0.415, 0.434, 0.445};
constexpr Row table_2 = {0.322, 0.346, 0.366, 0.398, 0.433, 0.457};
constexpr Row table_3 = {0.335, 0.348, 0.369, 0.399, 0.434, 0.457};
constexpr Row table_5 = {0.318, 0.338, 0.367, 0.394, 0.430, 0.453};
constexpr Row table_9 = {0.314, 0.336, 0.357, 0.389, 0.426, 0.447};
constexpr double table_elongation = 1.5;

// The search for the preparation friction. Small cubes scatter by 0.01 from seed to seed and from friction to friction,
// so no root finder on the friction alone is sure to end; compaction is, since it goes on from the packing that is there.
constexpr double porosity_tolerance = 0.003;  // ends the search; generation.hpp promises 0.005
constexpr double first_aim = 0.003;           // looser than asked for: a loose packing can be compacted
constexpr double friction_rise = 1.4;         // of the friction after a packing that was too dense, at least
constexpr double compaction_step = 0.95;      // of the friction while a packing is compacted, at most
constexpr double least_friction = 0.01;       // half the table's least: clumps come to rest slowly without
constexpr double most_friction = 3;           // above 1 hardly a contact slips any more
constexpr int tries_per_draw = 4;             // frictions for one random arrangement,
constexpr int most_draws = 6;                 // and arrangements of one seed
constexpr std::uint64_t draw_stride = 0xd1342543de82ef95ull;  // odd and without pattern: no seed's draws meet another's

constexpr double packing_damping = 0.7;    // local damping
constexpr double inserted_size = 0.5;      // of the size at the looked-for porosity: a tenth of the cell is solid
constexpr int insertion_steps = 300;       // push overlaps apart
constexpr double insertion_drag = 0.9;     // share of velocity kept a step: overlaps of a whole grain push hard
constexpr double gas_drag = 0.98;          // while grains fly
constexpr double squeeze_drag = 0.998;     // while they touch: only rattlers feel it
constexpr int growth_interval = 5;         // steps between changes of size
constexpr double gas_growth = 3e-4;        // relative, a step, until grains begin to touch for good
constexpr double loose_growth = 4e-5;      // without pressure, falling to
constexpr double dense_growth = 6e-6;      // at pressure_rise and above: inertial number 1e-3 at 50 kPa
constexpr double gas_end_porosity = 0.50;  // looser than any packing
constexpr double pressure_rise = 0.2;      // of the pressure asked for
constexpr double bulk_over_contact = 0.4;  // bulk modulus of a packing over E*, for the servo's gain
constexpr double servo_gain = 0.2;         // of the pressure error, a growth interval
constexpr double pressure_tolerance = 0.01;
constexpr double settled_ratio = 2e-3;   // unbalanced ratio at the end of packing
constexpr double settled_growth = 1e-4;  // of size over `settled_window` steps: creep passes the force test alone
constexpr std::int64_t settled_window = 500;
constexpr std::int64_t most_steps = 60000;
constexpr double release_step = 1e-4;  // relative shrinking at once
constexpr int release_interval = 60;   // steps after each
constexpr int most_releases = 1000;

double interpolate(const std::array<double, 6>& from, const std::array<double, 6>& to, double x) {
  for (std::size_t k = 1; k < from.size(); ++k)
    if (x <= from[k] || k + 1 == from.size()) {
      const double share = std::clamp((x - from[k - 1]) / (from[k] - from[k - 1]), 0.0, 1.0);
      return to[k - 1] + share * (to[k] - to[k - 1]);
    }
  return to.back();
}

// Rows between those of the table are blended by the number of pebbles, and a nearly round clump packs like a sphere:
// rows are blended by the elongation too.
Row porosity_row(int pebbles, double elongation) {
  const auto blend = [](const Row& from, const Row& to, double share) {
    Row row;
    for (std::size_t k = 0; k < row.size(); ++k) row[k] = from[k] + share * (to[k] - from[k]);
    return row;
  };
  if (pebbles == 1) return table_1;
  const Row clump = pebbles == 2   ? table_2
                    : pebbles <= 5 ? blend(table_3, table_5, (pebbles - 3) / 2.0)
                                   : blend(table_5, table_9, (pebbles - 5) / 4.0);
  return blend(table_1, clump, std::clamp((elongation - 1) / (table_elongation - 1), 0.0, 1.0));
}

// Grains in a fixed periodic cell whose size is the knob.
class PackingCell {
 public:
  PackingCell(Particles grains, const Vec3& period, double radius, const GrainMaterial& material, Team& team)
      : particles(std::move(grains)),
        period_(period),
        contacts_(0.08 * radius, period),
        material_(material),
        team_(&team) {}

  Particles particles;
  std::int64_t steps = 0;
  double unbalanced = 0;  // mean unbalanced over mean contact force, last step

  void set_friction(double friction) { material_.friction = friction; }
  double friction() const { return material_.friction; }

  void grow(double relative) { particles.scale_all(1 + relative); }

  void cycle(int count, double drag) {
    const double dt = quiet_step(particles, material_);
    for (int k = 0; k < count; ++k, ++steps) {
      const Detail detail = k + 1 == count ? Detail::All : Detail::Forces;  // the last step's sums are looked at
      contacts_.update(particles, *team_);
      const ContactTotals totals = contacts_.compute(particles, material_, dt, detail, *team_);
      MotionOptions options;
      options.team = team_;
      options.partition = &contacts_.partition();
      options.detail = detail;
      const MotionTotals motion = integrate(particles, Vec3::Zero(), dt, dt, packing_damping, options);
      unbalanced =
          unbalanced_ratio(motion.unbalanced_force, particles.body_count(), totals.contact_force, totals.active);
      for (std::size_t b = 0; b < particles.body_count(); ++b) {
        particles.velocity(b) *= drag;
        particles.spin(b) *= drag;
      }
    }
  }

  double pressure() const {
    double sum = 0;
    contacts_.for_each_branch(particles,
                              [&](const ContactView& c, const Vec3& branch) { sum += c.force_on_a.dot(branch); });
    return -sum / (3 * period_.prod());
  }

  double porosity() const { return 1 - solid_volume(particles) / period_.prod(); }

  double coordination() const {
    Coordination coordination(particles.body_count());
    contacts_.for_each_contact(particles, [&](const ContactView& c) { coordination.add(c); });
    return coordination.mean();
  }

 private:
  Vec3 period_;
  PairContacts contacts_;
  GrainMaterial material_;
  Team* team_;
};

// `draw` numbers the random arrangements of one seed.
Particles insert_at_random(const CubeRequest& request, int draw, double factor, const Vec3& period) {
  const ClumpTemplate shape = make_clump(request.pebbles, request.elongation);
  Random random(request.seed + static_cast<std::uint64_t>(draw) * draw_stride);
  // Uniform in [low, high] with the mean asked for; the sample's own mean is then made exact.
  const double low = 2 * request.radius_mean / (1 + request.radius_ratio), high = low * request.radius_ratio;
  std::vector<double> radius(request.grains);
  for (double& r : radius) r = random.uniform(low, high);
  const double mean = std::accumulate(radius.begin(), radius.end(), 0.0) / request.grains;
  Particles particles;
  for (const double r : radius) {
    const double x = random.uniform(), y = random.uniform(), z = random.uniform();
    particles.add(shape, factor * r * request.radius_mean / mean, request.density, Vec3(x, y, z).cwiseProduct(period),
                  random.rotation());
  }
  return particles;
}

// Cells' order, so that neighbours in space are neighbours in memory.
void sort_in_space(Particles& particles, double cell) {
  std::vector<std::int32_t> order(particles.body_count());
  std::iota(order.begin(), order.end(), 0);
  const auto key = [&](std::int32_t b) {
    const Vec3 c = (std::as_const(particles).position(b) / cell).array().floor();
    return std::array<double, 3>{c.z(), c.y(), c.x()};
  };
  std::stable_sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) { return key(a) < key(b); });
  particles.reorder(order);
}

void check(const CubeRequest& request) {
  if (request.grains < 50)
    throw InputError(fmt::format("grains.packing.cube_grains = {}: must be at least 50", request.grains));
  if (!(request.radius_mean > 0) || !(request.radius_ratio >= 1))
    throw InputError(fmt::format("grains.packing: radius {} and radius_ratio {} must be positive and at least 1",
                                 request.radius_mean, request.radius_ratio));
  if (!(request.pressure > request.released_pressure && request.released_pressure > 0))
    throw InputError(
        fmt::format("grains.packing.cube_pressure = {} Pa: must lie above the {} Pa that it is let down to",
                    request.pressure, request.released_pressure));
  const PorosityRange range = reachable_porosity(request.pebbles, request.elongation);
  if (!(request.porosity >= range.low && request.porosity <= range.high))
    throw InputError(fmt::format(
        "grains.packing.porosity = {}: grains of {} pebbles and elongation {} reach {:.3f} to {:.3f}; choose a "
        "porosity in "
        "that range{}",
        request.porosity, request.pebbles, request.elongation, range.low, range.high,
        request.porosity < range.low && request.pebbles == 1 ? ", or clumps (grains.pebbles = 3), which pack denser"
                                                             : ""));
}

// A gas of grains that begin to touch, at rest nowhere yet.
PackingCell make_gas(const CubeRequest& request, int draw, const Vec3& period, Team& team) {
  GrainMaterial material = request.material;
  material.friction = 0;
  material.damping_ratio = 0;
  PackingCell gas(insert_at_random(request, draw, inserted_size, period), period, request.radius_mean, material, team);
  gas.cycle(insertion_steps, insertion_drag);
  while (gas.porosity() > gas_end_porosity) {
    gas.grow(growth_interval * gas_growth);
    gas.cycle(growth_interval, gas_drag);
  }
  return gas;
}

// dp per relative growth [Pa].
double growth_stiffness(const CubeRequest& request) { return 3 * bulk_over_contact * request.material.contact_modulus; }

// Brings the cell to rest at the pressure asked for, with its present friction. Growth is the servo: in proportion to
// the pressure that is missing, up to a rate that falls as the grains come to bear.
void squeeze(PackingCell& cell, const CubeRequest& request) {
  const std::int64_t begin = cell.steps;
  std::int64_t window_begin = begin;
  double pressure = cell.pressure(), window_growth = 0;
  while (true) {
    const double wanted = servo_gain * (request.pressure - pressure) / growth_stiffness(request);
    const double slackness = std::max(0.0, 1 - pressure / (pressure_rise * request.pressure));
    const double fastest = growth_interval * (dense_growth + slackness * (loose_growth - dense_growth));
    const double growth = std::clamp(wanted, -fastest, fastest);
    cell.grow(growth);
    window_growth += growth;
    cell.cycle(growth_interval, squeeze_drag);
    pressure = cell.pressure();
    if (cell.steps - window_begin < settled_window) continue;
    if (std::abs(pressure / request.pressure - 1) < pressure_tolerance && cell.unbalanced < settled_ratio &&
        std::abs(window_growth) < settled_growth)
      return;
    window_growth = 0;
    window_begin = cell.steps;
    if (request.progress) request.progress("squeezing the cube", std::min(1.0, pressure / request.pressure));
    if (cell.steps - begin > most_steps)
      throw NumericalError(fmt::format(
          "grains.packing: the cube does not settle at {:.3g} Pa within {} steps (pressure {:.3g} Pa, unbalanced ratio "
          "{:.2g}, friction {:.3f}): try another seed or a higher cube_pressure",
          request.pressure, most_steps, pressure, cell.unbalanced, cell.friction()));
  }
}

// Lowers the friction of a packing that is too loose, under pressure, until its porosity is the one asked for: contacts
// slip and the grains move closer. What one lowering brings is not known beforehand, so each aims at a part of what is
// missing. Ends above the tolerance when the least friction is reached.
void compact(PackingCell& cell, const CubeRequest& request, const Row& row) {
  while (cell.porosity() > request.porosity + porosity_tolerance && cell.friction() > least_friction) {
    const double excess = cell.porosity() - request.porosity;
    const double aimed = interpolate(table_friction, row, cell.friction()) - excess;
    const double next = interpolate(row, table_friction, aimed);
    cell.set_friction(std::max(least_friction, std::min(next, compaction_step * cell.friction())));
    squeeze(cell, request);
  }
}

// Shrinks the grains until the pressure is the released one.
void let_down(PackingCell& cell, const CubeRequest& request) {
  double pressure = cell.pressure();
  for (int k = 0; k < most_releases && pressure > 1.05 * request.released_pressure; ++k) {
    cell.grow(-std::min(release_step, 0.5 * (pressure - request.released_pressure) / growth_stiffness(request)));
    cell.cycle(release_interval, squeeze_drag);
    pressure = cell.pressure();
  }
}

// The friction to pack with after `friction` gave a packing that is too dense by `miss`: the table's shape, moved
// through what came out, and a share more, since a packing that is too loose can be compacted and a dense one not be
// loosened.
double looser_friction(const Row& row, double friction, double miss) {
  const double aimed = interpolate(table_friction, row, friction) + miss + porosity_tolerance;
  return std::max(interpolate(row, table_friction, aimed), friction * friction_rise);
}

// Grains grew to fill the cell; the whole picture is scaled so that they have the sizes asked for. Contact stiffness
// goes as the radius and area as its square: the stresses stay.
void bring_to_size(Cube& cube, const CubeRequest& request) {
  Particles& particles = cube.particles;
  const double factor = request.radius_mean / particles.mean_radius();
  cube.period *= factor;
  for (std::size_t b = 0; b < particles.body_count(); ++b) {
    particles.velocity(b).setZero();
    particles.spin(b).setZero();
    for (int k = 0; k < 3; ++k) {
      double x = factor * particles.position(b)[k];
      x -= cube.period[k] * std::floor(x / cube.period[k]);
      particles.position(b)[k] = x < cube.period[k] ? x : 0.0;
    }
    particles.scale(b, factor);
  }
  sort_in_space(particles, 2 * request.radius_mean);
}

}  // namespace

PorosityRange reachable_porosity(int pebbles, double elongation) {
  make_clump(pebbles, elongation);  // refuses what cannot be made
  const Row row = porosity_row(pebbles, elongation);
  return {row.front() - porosity_tolerance, row.back() + porosity_tolerance};
}

Cube make_cube(const CubeRequest& request) {
  check(request);
  Team team(request.threads);
  const Row row = porosity_row(request.pebbles, request.elongation);
  const auto report = [&](std::string_view what, double fraction) {
    if (request.progress) request.progress(what, fraction);
  };

  Cube cube;
  double nearest = 1;  // |porosity - asked for| of the best try
  for (int draw = 0; draw < most_draws; ++draw) {
    // The cell holds the grains, at the size asked for, at the porosity asked for.
    const double solid = solid_volume(insert_at_random(request, draw, 1, Vec3::Ones()));
    cube.period = Vec3::Constant(std::cbrt(solid / (1 - request.porosity)));
    report("inserting the cube's grains", 0);
    const PackingCell gas = make_gas(request, draw, cube.period, team);
    cube.steps += gas.steps;
    double friction = interpolate(row, table_friction, request.porosity + first_aim);
    for (int k = 0; k < tries_per_draw; ++k) {
      PackingCell cell = gas;
      cell.steps = 0;
      cell.set_friction(friction);
      squeeze(cell, request);
      compact(cell, request, row);
      ++cube.tries;
      cube.porosity = cell.porosity();
      cube.pressure = cell.pressure();
      cube.preparation_friction = cell.friction();
      cube.coordination = cell.coordination();
      const double miss = request.porosity - cube.porosity;
      nearest = std::min(nearest, std::abs(miss));
      if (std::abs(miss) <= porosity_tolerance) {
        let_down(cell, request);
        cube.released_porosity = cell.porosity();
        cube.released_pressure = cell.pressure();
        cube.steps += cell.steps;
        cube.particles = std::move(cell.particles);
        bring_to_size(cube, request);
        report("cube made", 1);
        return cube;
      }
      cube.steps += cell.steps;
      if (miss < 0 || friction >= most_friction) break;  // cannot be compacted, or not be loosened, any further
      friction = std::min(most_friction, looser_friction(row, friction, miss));
    }
  }
  throw NumericalError(
      fmt::format("grains.packing.porosity = {}: {} tries came no nearer than {:.4f}; grains of {} pebbles and "
                  "elongation {} hardly "
                  "pack so: ask for a porosity farther from the ends of {:.3f} to {:.3f}, for another seed or for more "
                  "grains.packing.cube_grains (now {})",
                  request.porosity, cube.tries, nearest, request.pebbles, request.elongation, row.front(), row.back(),
                  request.grains));
}

void for_each_tiled(const Cube& cube, const Vec3& low, const Vec3& high, const Vec3& lead,
                    const std::function<void(std::size_t, const Vec3&)>& visit) {
  LOCKSTEP_ASSERT((cube.period.array() > 0).all(), "a cube without extent");
  const Box box{low, high};
  std::array<int, 3> copies;
  const Vec3 start = low - lead.cwiseProduct(cube.period);
  for (int k = 0; k < 3; ++k)
    copies[k] = std::max(0, static_cast<int>(std::ceil((high[k] - start[k]) / cube.period[k])));
  for (int z = 0; z < copies[2]; ++z)
    for (int y = 0; y < copies[1]; ++y)
      for (int x = 0; x < copies[0]; ++x) {
        const Vec3 shift = start + Vec3(x, y, z).cwiseProduct(cube.period);
        for (std::size_t b = 0; b < cube.particles.body_count(); ++b)
          if (box.contains(cube.particles.position(b) + shift)) visit(b, shift);
      }
}

Particles tile(const Cube& cube, const Vec3& low, const Vec3& high, const Vec3& lead) {
  std::size_t bodies = 0;
  for_each_tiled(cube, low, high, lead, [&](std::size_t, const Vec3&) { ++bodies; });
  Particles filled;
  filled.reserve_copies(cube.particles, bodies);
  for_each_tiled(cube, low, high, lead,
                 [&](std::size_t b, const Vec3& shift) { filled.append_copy(cube.particles, b, shift); });
  return filled;
}

}  // namespace lockstep::dem
