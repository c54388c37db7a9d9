// How fast the grains' step is: a dense packing in a box of six planes, cycled as the server cycles it.
//
//        +-------------+  <- top wall, moves in slowly (--strain-rate), so that lists are renewed as in use
//        | o O o O o O |
//        | O o O o O o |     friction 0.7, k_n 1e7 N/m for the mean pair, k_n/k_s 8, gravity 9.81 m/s2
//        +-------------+
//
//   bench_dem                                            every case, one line a case and number of threads
//   bench_dem --case spheres_26700 --steps 1000
//   bench_dem --case clumps3_26700 --threads 1 --restitution 0.5
//   bench_dem --case spheres_26700 --export packing      the packing as text, for other programs
//
// The packing: a periodic cube of 1,000 grains, tiled, cut to the count asked for, then pressed between six smooth
// planes by a servo. It is made once and kept in the cache folder; a benchmark always starts from what the file holds,
// so that the first run and the next have the same hash. Springs are not kept: they grow anew in the steps before the
// timed ones.
//
// Rates are medians and bests of blocks, with list renewals and walls in them. Processor time is that of all threads.
#include <malloc.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <numeric>
#include <optional>

#include "common/checks.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/generation.hpp"
#include "dem_server/measure.hpp"

using namespace lockstep;
using namespace lockstep::dem;
namespace fs = std::filesystem;

namespace {

// ------------------------------------------------------------------------------------------------------- the case

constexpr double mean_radius = 0.029;                           // [m]
constexpr double radius_ratio = 4.0 / 3.0;                      // largest over smallest, uniform between
constexpr double density = 2650;                                // of the solid [kg/m3]
constexpr double mean_stiffness = 1e7;                          // k_n of two mean grains [N/m]
constexpr double modulus = mean_stiffness / (2 * mean_radius);  // k_n = E* (R_a + R_b) [Pa]
constexpr double stiffness_ratio = 8;                           // k_n / k_s
constexpr double friction = 0.7;                                // grains and walls
constexpr double elongation = 1.5;                              // of clumps
constexpr double gravity = 9.81;                                // [m/s2]

struct Case {
  const char* name;
  int grains;
  int pebbles;      // a grain
  double porosity;  // of the cube, at the packing pressure
};

// Porosities that a preparation friction of 0.02 to 0.05 gives at 1 MPa: dense, as after a servo-driven installation.
constexpr Case cases[] = {
    {"spheres_26700", 26700, 1, 0.375},
    {"spheres_100000", 100000, 1, 0.375},
    {"clumps3_26700", 26700, 3, 0.34},
    {"clumps5_26700", 26700, 5, 0.33},
};

GrainMaterial grain_material() {
  GrainMaterial material;
  material.contact_modulus = modulus;
  material.stiffness_ratio = stiffness_ratio;
  material.friction = friction;
  return material;
}

// ---------------------------------------------------------------------------------------------- making the packing

constexpr int recipe = 1;  // of the packing: a changed one makes the cache anew
constexpr int cube_grains = 1000;
constexpr double packing_pressure = 1e6;   // on the walls [Pa]
constexpr double packing_friction = 0.05;  // between grains, while pressed; walls are smooth
constexpr double packing_damping = 0.7;    // local
constexpr double packing_step = 0.3;       // of sqrt(m / k_n) of the smallest grain
constexpr double fastest_wall = 0.2;       // while it closes the gaps of the cut: inertial number below 1e-3 [m/s]
// The servo: full speed at a quarter of the pressure missing. A packing's stiffness M/L of about 1e8 Pa/m then closes
// an error in 250 kPa / (0.2 m/s 1e8 Pa/m) = 12 ms, some transits of a wave (1.6 m at 300 m/s).
constexpr double servo_band = 0.25;
constexpr double pressure_tolerance = 0.01;
constexpr double settled_ratio = 1e-3;  // unbalanced ratio
constexpr int settled_interval = 50;    // steps between two looks
constexpr int most_packing_steps = 40000;

// What the cache file holds, and all that a benchmark knows of the packing.
struct Grain {
  double radius;  // equivalent [m]
  Vec3 center;    // [m]
  Quat attitude;
};
struct Packing {
  Vec3 low, high;  // the walls [m]
  std::vector<Grain> grains;
};

std::vector<PlaneSettings> six_planes(const Vec3& low, const Vec3& high) {
  std::vector<PlaneSettings> planes;
  for (int axis = 0; axis < 3; ++axis) {
    planes.push_back({low, Vec3::Unit(axis), Vec3::Zero()});
    planes.push_back({high, -Vec3::Unit(axis), Vec3::Zero()});
  }
  return planes;
}

// Steps of one length between planes that move by their velocities; whole totals are wanted in every n-th step.
class EqualSteps : public Boundary {
 public:
  EqualSteps(double time_step, int measured_interval, Detail detail)
      : time_step_(time_step), measured_interval_(measured_interval), detail_(detail) {}
  bool move_facets(Model& model) override {
    model.time_step = time_step_;
    const bool is_measured = (model.step + 1) % static_cast<std::uint64_t>(measured_interval_) == 0;
    model.detail = is_measured ? Detail::All : detail_;
    return true;
  }
  void take_forces(Model&) override {}

 private:
  double time_step_;       // [s]
  int measured_interval_;  // steps
  Detail detail_;          // of the steps between
};

// The `count` grains nearest to the corner at the origin, by the cube that holds them: a grain belongs to a cube whose
// faces are at least a share of each pebble's radius beyond its centre. The shares overlap the walls' order away.
Particles cut_to_count(const Particles& tiled, int count) {
  const std::size_t bodies = tiled.body_count();
  constexpr double never = 1e300;
  std::vector<double> side(bodies, 0.0);  // of the cube that holds the grain [m]
  for (std::size_t b = 0; b < bodies; ++b)
    for (std::int32_t p = tiled.pebble_begin(b); p < tiled.pebble_end(b); ++p) {
      const double margin = clip_distance * tiled.pebble_radius(p);
      const Vec3 center = tiled.pebble_center(p);
      side[b] = center.minCoeff() < margin ? never : std::max(side[b], center.maxCoeff() + margin);
    }
  std::vector<std::int32_t> order(bodies);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) { return side[a] < side[b]; });
  LOCKSTEP_ASSERT(order.size() >= static_cast<std::size_t>(count) && side[order[count - 1]] < never,
                  "{} grains tiled, {} wanted", bodies, count);
  std::vector<char> keep(bodies, 0);
  for (int k = 0; k < count; ++k) keep[order[k]] = 1;
  Particles kept = tiled;
  kept.keep_only(keep);
  return kept;
}

Particles uncompressed(const Case& c) {
  CubeRequest request;
  request.grains = cube_grains;
  request.radius_mean = mean_radius;
  request.radius_ratio = radius_ratio;
  request.pebbles = c.pebbles;
  request.elongation = elongation;
  request.density = density;
  request.porosity = c.porosity;
  request.pressure = packing_pressure;
  request.released_pressure = 0.99 * packing_pressure;  // not let down: the walls press as hard
  request.material = grain_material();
  const Cube cube = make_cube(request);
  // Room for all, and for the layer that the cut takes from each face.
  const double solid = solid_volume(cube.particles) / cube_grains * c.grains;
  const double side = std::cbrt(solid / (1 - cube.porosity)) + 4 * mean_radius;
  return cut_to_count(tile(cube, Vec3::Zero(), Vec3::Constant(side)), c.grains);
}

// Presses all six walls in, opposite ones alike, until each pair bears the pressure and the grains are at rest.
class Press {
 public:
  explicit Press(Particles particles) : model_(list_skin * mean_radius), particles_(std::move(particles)) {}

  Packing run(const std::string& name) {
    Model& m = model_;
    m.particles = std::move(particles_);
    find_walls();
    m.walls = Walls(six_planes(low_, high_), 0);
    m.material = grain_material();
    m.material.friction = packing_friction;
    m.gravity = {0, 0, -gravity};
    m.damping = packing_damping;
    const double smallest = m.particles.smallest_radius();
    const double time_scale = std::sqrt(m.particles.lightest() / m.material.normal_stiffness(smallest, smallest));
    EqualSteps steps(packing_step * time_scale, settled_interval, Detail::Forces);
    while (true) {
      cycle(m, steps);
      const double worst = steer();
      if (m.step % settled_interval != 0) continue;
      const double unbalanced = unbalanced_ratio(m.motion.unbalanced_force, m.particles.body_count(),
                                                 m.pair_totals.contact_force, m.pair_totals.active);
      std::fprintf(stderr, "\rpacking %s: step %llu, pressure off by %.1f %%, unbalanced %.1e   ", name.c_str(),
                   static_cast<unsigned long long>(m.step), 100 * worst, unbalanced);
      if (worst < pressure_tolerance && unbalanced < settled_ratio) break;
      if (m.step > most_packing_steps)
        throw NumericalError(
            fmt::format("{}: the packing does not rest at {:.3g} Pa within {} steps (unbalanced ratio "
                        "{:.2g}): the preparation of this benchmark needs another friction",
                        name, packing_pressure, most_packing_steps, unbalanced));
    }
    std::fprintf(stderr, "\n");
    return result();
  }

 private:
  void find_walls() {
    const Particles& p = model_.particles;
    low_ = high_ = p.pebble_center(0);
    for (std::size_t k = 0; k < p.pebble_count(); ++k) {
      low_ = low_.cwiseMin(p.pebble_center(k) - Vec3::Constant(p.pebble_radius(k)));
      high_ = high_.cwiseMax(p.pebble_center(k) + Vec3::Constant(p.pebble_radius(k)));
    }
  }

  void read_walls() {
    for (int axis = 0; axis < 3; ++axis) {
      low_[axis] = model_.walls.planes()[2 * axis].point[axis];
      high_[axis] = model_.walls.planes()[2 * axis + 1].point[axis];
    }
  }

  // Sets the walls' velocities; the largest relative error of the pressure.
  double steer() {
    read_walls();
    const Vec3 size = high_ - low_;
    double worst = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const auto& totals = model_.walls.totals();
      const double area = size.prod() / size[axis];
      const double pressure = (totals[2 * axis].normal_force + totals[2 * axis + 1].normal_force) / (2 * area);
      const double error = 1 - pressure / packing_pressure;
      const double speed = fastest_wall * std::clamp(error / servo_band, -1.0, 1.0);
      model_.walls.set_velocity(2 * axis, speed * Vec3::Unit(axis));
      model_.walls.set_velocity(2 * axis + 1, -speed * Vec3::Unit(axis));
      worst = std::max(worst, std::abs(error));
    }
    return worst;
  }

  Packing result() {
    const Particles& p = model_.particles;
    Packing packing;
    for (std::size_t b = 0; b < p.body_count(); ++b)
      packing.grains.push_back({p.equivalent_radius(b), p.position(b), p.orientation(b)});
    read_walls();
    packing.low = low_;
    packing.high = high_;
    return packing;
  }

  Model model_;
  Particles particles_;
  Vec3 low_ = Vec3::Zero(), high_ = Vec3::Zero();  // the walls [m]
};

// ------------------------------------------------------------------------------------------------------- the cache

std::string cache_key(const Case& c) {
  return fmt::format(
      "recipe {} grains {} pebbles {} porosity {} radius {} ratio {} density {} modulus {} stiffness_ratio {} "
      "pressure {} friction {} damping {} gravity {}",
      recipe, c.grains, c.pebbles, c.porosity, mean_radius, radius_ratio, density, modulus, stiffness_ratio,
      packing_pressure, packing_friction, packing_damping, gravity);
}

fs::path cache_file(const Case& c, const fs::path& folder) {
  Hash hash;
  hash.add(std::string_view(cache_key(c)));
  return folder / fmt::format("{}-{:016x}.packing", c.name, hash.value());
}

constexpr std::size_t doubles_a_grain = 8;

void save(const Packing& packing, const std::string& key, const fs::path& file) {
  fs::create_directories(file.parent_path());
  fs::path unfinished = file;
  unfinished += ".part";
  std::ofstream out(unfinished, std::ios::binary);
  std::vector<double> values;
  for (const Vec3& v : {packing.low, packing.high}) values.insert(values.end(), {v.x(), v.y(), v.z()});
  for (const Grain& g : packing.grains)
    values.insert(values.end(), {g.radius, g.center.x(), g.center.y(), g.center.z(), g.attitude.x(), g.attitude.y(),
                                 g.attitude.z(), g.attitude.w()});
  out << key << '\n';
  out.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(double)));
  out.close();
  if (!out)
    throw IoError(fmt::format("{}: cannot be written: make room there, or give another --cache", file.string()));
  fs::rename(unfinished, file);
}

// Empty if there is none, or if another program or a broken run wrote it.
std::optional<Packing> load(const Case& c, const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::string key;
  if (!std::getline(in, key) || key != cache_key(c)) return {};
  std::vector<double> values(6 + doubles_a_grain * static_cast<std::size_t>(c.grains));
  const auto bytes = static_cast<std::streamsize>(values.size() * sizeof(double));
  if (!in.read(reinterpret_cast<char*>(values.data()), bytes)) return {};
  Packing packing;
  packing.low = Vec3(values[0], values[1], values[2]);
  packing.high = Vec3(values[3], values[4], values[5]);
  for (std::size_t k = 6; k < values.size(); k += doubles_a_grain) {
    const double* v = values.data() + k;
    packing.grains.push_back({v[0], {v[1], v[2], v[3]}, Quat(v[7], v[4], v[5], v[6])});
  }
  return packing;
}

Packing packing_of(const Case& c, const fs::path& folder) {
  const fs::path file = cache_file(c, folder);
  if (auto kept = load(c, file)) return *kept;
  std::fprintf(stderr, "packing %s: made once, then kept as %s\n", c.name, file.c_str());
  Packing packing = Press(uncompressed(c)).run(c.name);
  save(packing, cache_key(c), file);
  return packing;
}

Particles particles_of(const Case& c, const Packing& packing) {
  const ClumpTemplate shape = make_clump(c.pebbles, elongation);
  Particles particles;
  const std::size_t bodies = packing.grains.size(), pebbles = shape.pebble_center.size();
  particles.reserve(bodies, pebbles > 1 ? bodies * pebbles : 0);
  for (const Grain& g : packing.grains) particles.add(shape, g.radius, density, g.center, g.attitude);
  particles.place_pebbles();
  return particles;
}

// ----------------------------------------------------------------------------------------------------- measurement

struct Options {
  std::vector<std::string> names;
  std::vector<int> threads = {1, 2};
  int steps = 500;  // a block
  int blocks = 5;
  double step_share = 0.12;   // of sqrt(m / k_n) of the mean grain
  double strain_rate = 0.01;  // of the top wall's inward motion [1/s]
  double damping = 0.2;       // local
  double restitution = 1;
  bool has_gravity = true;
  int measured_interval = 20;  // steps; a scene's output.history_interval
  bool has_works = true;       // of every step, for the ledger
  std::string instructions;    // empty: the best
  fs::path export_folder;
  fs::path cache_folder = "build/release/bench_cache";
};

// Springs grow and the grains come to rest again: strongly damped, then as in the timed steps. Not timed.
constexpr int settle_steps = 300;
constexpr double settle_damping = 0.7;
constexpr int warm_up_steps = 100;

double mean_time_scale() {
  const double mass = density * 4.0 / 3.0 * pi * mean_radius * mean_radius * mean_radius;
  return std::sqrt(mass / mean_stiffness);
}
double time_step_of(const Options& o) { return o.step_share * mean_time_scale(); }

double processor_seconds() {
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}
double wall_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// A line "KEY: N kB" of /proc/self/status [bytes]; 0 where there is none.
double status_bytes(const std::string& key) {
  std::ifstream in("/proc/self/status");
  for (std::string line; std::getline(in, line);)
    if (line.starts_with(key)) return 1024 * std::strtod(line.c_str() + key.size() + 1, nullptr);
  return 0;
}
// Peak memory from here on is that of what follows: free memory is given back, and the peak starts anew.
void forget_peak_memory() {
  malloc_trim(0);
  std::ofstream("/proc/self/clear_refs") << "5";
}

struct Blocks {
  std::vector<double> values;
  double median() const {
    std::vector<double> sorted = values;
    std::sort(sorted.begin(), sorted.end());
    const std::size_t n = sorted.size();
    return n % 2 ? sorted[n / 2] : 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]);
  }
  double best() const { return *std::max_element(values.begin(), values.end()); }
};

struct Result {
  Blocks per_processor_second, per_wall_second;         // [grain-steps/s]
  double contacts = 0, renewals = 0, walls = 0;         // wall time [s]
  double motion = 0, rest = 0;                          // wall time [s]
  std::int64_t steps = 0, rebuilds = 0, refreshes = 0;  // of all blocks
  double growth = 0;                                    // of peak memory [bytes]
  double arrays = 0;                                    // of grains, lists and springs [bytes]
  std::uint64_t hash = 0;
};

InstructionSet instructions_of(const Options& o) {
  return o.instructions.empty() ? best_instructions() : instructions_by_name(o.instructions);
}

std::unique_ptr<Model> make_model(const Case& c, const Packing& packing, const Options& o, int threads) {
  auto model = std::make_unique<Model>(list_skin * mean_radius, threads, instructions_of(o));
  model->particles = particles_of(c, packing);
  model->walls = Walls(six_planes(packing.low, packing.high), friction);
  model->material = grain_material();
  model->material.damping_ratio = o.restitution < 1 ? damping_ratio(o.restitution) : 0;
  if (o.has_gravity) model->gravity = {0, 0, -gravity};
  return model;
}

void run_steps(Model& model, EqualSteps& boundary, int steps) {
  for (int k = 0; k < steps; ++k) cycle(model, boundary);
}

// Springs and lists are there, walls stand.
void settle(Model& model, EqualSteps& boundary, const Options& o) {
  model.damping = std::max(settle_damping, o.damping);
  run_steps(model, boundary, settle_steps);
  model.damping = o.damping;
}

void start_straining(Model& model, const Packing& packing, const Options& o) {
  constexpr std::size_t top = 5;  // of six_planes
  model.walls.set_velocity(top, {0, 0, -o.strain_rate * (packing.high.z() - packing.low.z())});
}

Result measure(const Case& c, const Packing& packing, const Options& o, int threads) {
  forget_peak_memory();
  const double memory_before = status_bytes("VmRSS");
  const auto model = make_model(c, packing, o, threads);
  Model& m = *model;
  EqualSteps boundary(time_step_of(o), o.measured_interval, o.has_works ? Detail::Works : Detail::Forces);
  settle(m, boundary, o);
  start_straining(m, packing, o);
  run_steps(m, boundary, warm_up_steps);

  Result result;
  const auto before = m.profile;
  const auto rebuilds = m.contacts.rebuilds(), refreshes = m.contacts.refreshes();
  double wall_total = 0;
  for (int block = 0; block < o.blocks; ++block) {
    const double processor = processor_seconds(), wall = wall_seconds();
    run_steps(m, boundary, o.steps);
    const double processor_spent = processor_seconds() - processor, wall_spent = wall_seconds() - wall;
    const double grain_steps = static_cast<double>(o.steps) * c.grains;
    result.per_processor_second.values.push_back(grain_steps / processor_spent);
    result.per_wall_second.values.push_back(grain_steps / wall_spent);
    wall_total += wall_spent;
  }
  const auto spent = [&](Phase phase) { return m.profile.seconds(phase) - before.seconds(phase); };
  result.steps = static_cast<std::int64_t>(o.steps) * o.blocks;
  result.rebuilds = m.contacts.rebuilds() - rebuilds;
  result.refreshes = m.contacts.refreshes() - refreshes;
  result.renewals = spent(Phase::Lists);
  result.contacts = spent(Phase::PairContacts);
  result.walls = spent(Phase::WallContacts);
  result.motion = spent(Phase::Motion);
  result.rest = wall_total - result.renewals - result.contacts - result.walls - result.motion;
  result.growth = status_bytes("VmHWM") - memory_before;
  result.arrays = static_cast<double>(m.particles.memory() + m.contacts.memory());
  result.hash = m.hash();
  return result;
}

// Once in the settled packing, so that the lines below can be judged.
void describe(const Case& c, const Packing& packing, const Options& o) {
  const auto model = make_model(c, packing, o, 1);
  Model& m = *model;
  EqualSteps boundary(time_step_of(o), o.measured_interval, o.has_works ? Detail::Works : Detail::Forces);
  settle(m, boundary, o);
  const Vec3 size = packing.high - packing.low;
  Coordination coordination(m.particles.body_count());
  double overlaps = 0;
  std::size_t contacts = 0;
  m.contacts.for_each_contact(m.particles, [&](const ContactView& contact) {
    coordination.add(contact);
    overlaps += contact.overlap;
    ++contacts;
  });
  std::size_t wall_contacts = 0;
  double pressure = 0;
  for (std::size_t k = 0; k < m.walls.size(); ++k) {
    const double area = size.prod() / size[static_cast<int>(k / 2)];
    wall_contacts += m.walls.totals()[k].contacts;
    pressure += m.walls.totals()[k].normal_force / area / static_cast<double>(m.walls.size());
  }
  const double grains = c.grains;
  std::printf(
      "# %s: box %.4f x %.4f x %.4f m, porosity %.3f, neighbours a grain %.2f (walls not counted), contacts a grain "
      "%.2f, wall contacts a grain %.3f, mean overlap / R %.2e, mean pressure on the walls %.0f kPa, step %.3g s\n",
      c.name, size.x(), size.y(), size.z(), 1 - solid_volume(m.particles) / size.prod(), coordination.mean(),
      static_cast<double>(contacts) / grains, static_cast<double>(wall_contacts) / grains,
      overlaps / static_cast<double>(contacts) / mean_radius, 1e-3 * pressure, time_step_of(o));
}

double interval(std::int64_t steps, std::int64_t renewals) {
  return renewals ? static_cast<double>(steps) / static_cast<double>(renewals)
                  : std::numeric_limits<double>::infinity();
}

void print(const Case& c, int threads, const Options& o, const Result& r) {
  constexpr double million = 1e6;
  const double nanoseconds = 1e9 / (static_cast<double>(r.steps) * c.grains);  // a grain and step
  std::printf(
      "bench_dem case=%s threads=%d isa=%s Mgs_per_cpu_s=%.2f best=%.2f Mgs_per_wall_s=%.2f best=%.2f "
      "ns contacts=%.1f lists=%.1f walls=%.1f motion=%.1f rest=%.1f bytes_arrays=%.0f bytes_peak=%.0f "
      "steps_per_inner_list=%.0f steps_per_outer_list=%.0f hash=%016llx\n",
      c.name, threads, name_of(instructions_of(o)).data(), r.per_processor_second.median() / million,
      r.per_processor_second.best() / million, r.per_wall_second.median() / million, r.per_wall_second.best() / million,
      nanoseconds * r.contacts, nanoseconds * r.renewals, nanoseconds * r.walls, nanoseconds * r.motion,
      nanoseconds * r.rest, r.arrays / c.grains, r.growth / c.grains, interval(r.steps, r.refreshes),
      interval(r.steps, r.rebuilds), static_cast<unsigned long long>(r.hash));
  std::fflush(stdout);
}

// ---------------------------------------------------------------------------------------------------------- export

// Lines "key value ..." up to "clumps"; then one line a grain: mass, centre, moments of inertia in the world frame; then
// "pebbles" and one line a pebble: its grain, centre, radius.
void export_packing(const Case& c, const Packing& packing, const Options& o) {
  fs::create_directories(o.export_folder);
  const fs::path file = o.export_folder / fmt::format("{}.txt", c.name);
  std::ofstream out(file);
  const Particles particles = particles_of(c, packing);
  out << fmt::format("# grains in a box, SI; clump: mass x y z ixx iyy izz ixy ixz iyz; pebble: clump x y z radius\n");
  out << fmt::format("case {}\ngrains {}\npebbles_per_grain {}\n", c.name, c.grains, c.pebbles);
  out << fmt::format("box_low {} {} {}\n", packing.low.x(), packing.low.y(), packing.low.z());
  out << fmt::format("box_high {} {} {}\n", packing.high.x(), packing.high.y(), packing.high.z());
  out << fmt::format("mean_radius {}\ndensity {}\nmean_stiffness {}\nstiffness_ratio {}\nfriction {}\n", mean_radius,
                     density, mean_stiffness, stiffness_ratio, friction);
  out << fmt::format("gravity {}\ntime_step {}\n", o.has_gravity ? gravity : 0.0, time_step_of(o));
  out << "clumps\n";
  for (std::size_t b = 0; b < particles.body_count(); ++b) {
    const Mat3 turn = particles.orientation(b).toRotationMatrix();
    const Mat3 i = turn * particles.inertia(b).asDiagonal() * turn.transpose();
    const Vec3 x = particles.position(b);
    out << fmt::format("{} {} {} {} {} {} {} {} {} {}\n", particles.mass(b), x.x(), x.y(), x.z(), i(0, 0), i(1, 1),
                       i(2, 2), i(0, 1), i(0, 2), i(1, 2));
  }
  out << "pebbles\n";
  for (std::size_t p = 0; p < particles.pebble_count(); ++p) {
    const Vec3 x = particles.pebble_center(p);
    out << fmt::format("{} {} {} {} {}\n", particles.pebble_body(p), x.x(), x.y(), x.z(), particles.pebble_radius(p));
  }
  out.close();
  if (!out) throw IoError(fmt::format("{}: cannot be written: give another --export", file.string()));
  std::printf("%s\n", file.c_str());
}

// ------------------------------------------------------------------------------------------------------------ main

std::string case_names() {
  std::string names;
  for (const Case& c : cases) names += (names.empty() ? "" : ", ") + std::string(c.name);
  return names;
}

std::vector<Case> wanted_cases(const Options& o) {
  if (o.names.empty()) return {std::begin(cases), std::end(cases)};
  std::vector<Case> wanted;
  for (const std::string& name : o.names) {
    const auto* found = std::find_if(std::begin(cases), std::end(cases), [&](const Case& c) { return c.name == name; });
    if (found == std::end(cases))
      throw InputError(fmt::format("--case {}: no such case; give one or more of {}", name, case_names()));
    wanted.push_back(*found);
  }
  return wanted;
}

void run(const Options& o) {
  for (const Case& c : wanted_cases(o)) {
    const Packing packing = packing_of(c, o.cache_folder);
    if (!o.export_folder.empty()) {
      export_packing(c, packing, o);
      continue;
    }
    describe(c, packing, o);
    std::optional<std::uint64_t> hash;
    for (const int threads : o.threads) {
      const Result result = measure(c, packing, o, threads);
      print(c, threads, o, result);
      if (hash.value_or(result.hash) != result.hash)
        throw InternalError(fmt::format("{}: {} threads end in another state than {}: the step depends on their number",
                                        c.name, threads, o.threads.front()));
      hash = result.hash;
    }
  }
}

void add_options(CLI::App& app, Options& o) {
  app.add_option("--case", o.names, "cases, by comma; all of them if left out: " + case_names())->delimiter(',');
  app.add_option("--threads", o.threads, "numbers of threads, by comma; default 1,2")
      ->delimiter(',')
      ->check(CLI::Range(1, 1024));
  app.add_option("--steps", o.steps, "of a block")->check(CLI::Range(1, 100000000))->capture_default_str();
  app.add_option("--blocks", o.blocks, "median and best are of these")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--step-share", o.step_share, "time step over sqrt(m/k_n) of the mean grain")
      ->check(CLI::Range(0.001, 0.5))
      ->capture_default_str();
  app.add_option("--strain-rate", o.strain_rate, "of the top wall's inward motion [1/s]")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--damping", o.damping, "local damping")->check(CLI::Range(0.0, 0.99))->capture_default_str();
  app.add_option("--restitution", o.restitution, "below 1: contacts have dashpots")
      ->check(CLI::Range(0.001, 1.0))
      ->capture_default_str();
  app.add_option("--isa", o.instructions, "instruction set of the kernels; the best of this machine if left out")
      ->check(CLI::IsMember({"generic", "avx2", "avx512"}));
  app.add_option("--measured-interval", o.measured_interval, "steps between two whole sets of totals, as for a history")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  app.add_flag("!--no-works", o.has_works, "energies only with whole totals; the ledger wants them in every step");
  app.add_flag("!--no-gravity", o.has_gravity, "9.81 m/s2 downwards otherwise");
  app.add_option("--export", o.export_folder, "write the packing as text into this folder, and measure nothing");
  app.add_option("--cache", o.cache_folder, "where packings are kept")->capture_default_str();
  app.footer(
      "examples:\n"
      "  bench_dem --case spheres_26700 --steps 1000\n"
      "  bench_dem --case clumps3_26700,clumps5_26700 --restitution 0.5\n"
      "  bench_dem --case spheres_26700 --threads 1 --isa avx2\n"
      "  bench_dem --case spheres_100000 --export packing\n"
      "one line a case and number of threads: Mgs, million grain-steps, a processor second (all threads' time) and a "
      "wall second, median of the blocks and best; wall time by phase in ns a grain and step; memory a grain, of the "
      "arrays of grains, lists and springs, and from the growth of the process; steps between renewals; a hash of the "
      "last state "
      "(another hash is another answer).");
}

}  // namespace

int main(int argument_count, char** arguments) {
  CLI::App app("Measures the grains' step: dense packings in a box of six walls.");
  Options options;
  add_options(app, options);
  try {
    app.parse(argument_count, arguments);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : static_cast<int>(ExitCode::Input);  // 0: --help
  }
  try {
    run(options);
    return 0;
  } catch (const Error& error) {
    std::fprintf(stderr, "bench_dem: %s\n", error.what());
    return static_cast<int>(error.code());
  }
}
