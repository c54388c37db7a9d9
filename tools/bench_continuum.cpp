// Measures the ground's step: internal force and motion of the nodes, as continuum_client's cycle has them, for each kind of
// zone, mesh and number of threads. tools/bench continuum builds and runs it; --help says more.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "common/checks.hpp"
#include "common/hash.hpp"
#include "common/parallel.hpp"
#include "common/random.hpp"
#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/grid_builder.hpp"
#include "continuum_client/incremental_force.hpp"
#include "continuum_client/integrator.hpp"
#include "continuum_client/internal_force.hpp"
#include "continuum_client/timestep.hpp"

namespace {

using namespace lockstep;
using namespace lockstep::continuum;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

struct Options {
  std::vector<std::string> meshes = {"paper", "distorted"};
  std::vector<std::string> kinds = {"mixed_discretization", "b_bar", "one_point"};
  std::vector<int> threads = {1, 2};
  std::string instructions, format = "auto";
  int steps = 200, blocks = 5;
  std::string route = "assembled";
  bool has_large_strain = false, beside_grains = false;
  std::vector<int> bar;  // zones along x, y, z
  double bar_time = 0.05;
  std::string export_path;
};

const Material soil{elastic_moduli(44.3e6, 0.3), 1630};

ZoneKind kind_by_name(const std::string& name) {
  if (name == "mixed_discretization") return ZoneKind::MixedDiscretization;
  if (name == "b_bar") return ZoneKind::BBar;
  if (name == "one_point") return ZoneKind::OnePoint;
  throw InputError(fmt::format("--kinds {}: expected mixed_discretization, b_bar or one_point", name));
}

Grid block(double x, double y, double z, int nx, int ny, int nz) {
  BlockMesh m;
  m.width_x = x, m.width_y = y, m.height = z, m.zones_x = nx, m.zones_y = ny, m.zones_z = nz, m.where = "bench";
  return build_block(m);
}

Grid distorted_block(int nx, int ny, int nz) {
  const double h = 0.1;
  Grid grid = block(h * nx, h * ny, h * nz, nx, ny, nz);
  Random random(3);
  for (Vec3& x : grid.node)
    if ((x - grid.low).minCoeff() > 0.5 * h && (grid.high - x).minCoeff() > 0.5 * h)
      for (int c = 0; c < 3; ++c) x[c] += 0.2 * h * random.uniform(-1, 1);
  return grid;
}

Grid cylinder(int around, int radial, int beside, int below) {
  CylinderMesh m;
  m.width = 6.25, m.depth = 9, m.hole_diameter = 0.875, m.hole_depth = 7.2, m.radial_growth = 1.12, m.depth_growth = 1;
  m.zones_around = around, m.zones_radial = radial, m.zones_hole_depth = beside, m.zones_below = below;
  m.where = "bench";
  return build_cylinder_in_brick(m);
}

Grid mesh_by_name(const std::string& name) {
  if (name == "paper") return cylinder(32, 15, 38, 5);  // 21,280 zones left
  if (name == "distorted") return distorted_block(28, 20, 38);
  if (name == "large") return cylinder(64, 32, 80, 12);
  if (name == "large_distorted") return distorted_block(70, 60, 48);
  throw InputError(fmt::format("--mesh {}: expected paper, distorted, large or large_distorted", name));
}

constexpr const char* format_names[] = {"shared rows", "half rows", "zones"};  // StiffnessProduct::Format

// Median of some numbers.
double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

// What the machine can read and write: a = b + s c over arrays that no cache holds [GB/s].
double triad(Team& team) {
  static std::vector<double> a(8 << 20, 1.0), b(8 << 20, 2.0), c(8 << 20, 3.0);
  double best = 0;
  for (int round = 0; round < 5; ++round) {
    const auto begin = Clock::now();
    team.run([&](int t) {
      const std::size_t size = a.size(), n = static_cast<std::size_t>(team.size());
      for (std::size_t i = size * t / n; i < size * (t + 1) / n; ++i) a[i] = b[i] + 0.5 * c[i];
    });
    best = std::max(best, 3e-9 * sizeof(double) * static_cast<double>(a.size()) / seconds_since(begin));
  }
  return best;
}

// Reads an array of `bytes` again and again: what the operator alone costs to stream. Best of some rounds [s].
double stream_seconds(std::size_t bytes, Team& team) {
  constexpr std::size_t sums_at_once = 16;  // what the fewest registers hold
  const std::vector<double> data(bytes / sizeof(double) + sums_at_once, 1.0);
  std::vector<double> sums(static_cast<std::size_t>(team.size()));
  double best = 1e9;
  for (int round = 0; round < 12; ++round) {
    const auto begin = Clock::now();
    team.run([&](int t) {
      const std::size_t n = static_cast<std::size_t>(team.size()), size = data.size() / sums_at_once;
      double part[sums_at_once] = {};
      for (std::size_t i = size * t / n; i < size * (t + 1) / n; ++i)
        for (std::size_t k = 0; k < sums_at_once; ++k) part[k] += data[sums_at_once * i + k];
      double sum = 0;
      for (const double p : part) sum += p;
      sums[static_cast<std::size_t>(t)] = sum;
    });
    best = std::min(best, seconds_since(begin));
  }
  if (sums[0] < 0) std::puts("");  // the sum is wanted
  return best;
}

struct Ground {
  Grid grid;
  std::vector<char> is_left;
  std::vector<double> mass;
  Vec3s is_free;
  StiffnessMatrix stiffness;
  double assembly_seconds = 0, arrange_seconds = 0;
  InternalForce force;
  double time_step = 0;  // [s]

  Ground(Grid mesh, ZoneKind kind, Supports supports, const std::string& format, InstructionSet instructions)
      : grid(std::move(mesh)) {
    grid.zone_kind = kind;
    grid.materials = {soil};
    is_left = zones_outside_discrete_domain(grid);
    auto begin = Clock::now();
    stiffness = assemble_stiffness(grid, is_left);
    assembly_seconds = seconds_since(begin);
    mass = lumped_masses(grid, is_left);
    is_free = free_components(grid, supports, mass);
    begin = Clock::now();
    force = InternalForce(product_of(format, instructions));
    arrange_seconds = seconds_since(begin);
    time_step = 0.9 * stable_step(frequency_squared_bound(stiffness, mass, is_free), 0);
  }
  StiffnessProduct product_of(const std::string& format, InstructionSet instructions) const {
    if (format == "auto") return StiffnessProduct(stiffness, grid, is_left, instructions);
    if (format == "zones" && grid.zone_kind != ZoneKind::OnePoint)
      throw InputError("--format zones: only one_point zones go without a matrix; add --kinds one_point");
    if (format == "zones") return StiffnessProduct::of_zones(grid, is_left, instructions);
    return StiffnessProduct(
        stiffness, format == "shared" ? StiffnessProduct::Format::SharedRows : StiffnessProduct::Format::HalfRows,
        instructions);
  }

  std::size_t zones() const { return static_cast<std::size_t>(std::count(is_left.begin(), is_left.end(), 1)); }
};

// Walks 24 MB on a core of its own, as grains that share the last cache do.
class Rival {
 public:
  explicit Rival(bool is_wanted) {
    if (is_wanted)
      thread_ = std::thread([this] {
        std::vector<double> field(3 << 20, 1.0);
        while (!is_over_)
          for (double& x : field) x = 0.5 * x + 1;
      });
  }
  ~Rival() {
    is_over_ = true;
    if (thread_.joinable()) thread_.join();
  }
  Rival(const Rival&) = delete;
  Rival& operator=(const Rival&) = delete;

 private:
  std::atomic<bool> is_over_ = false;
  std::thread thread_;
};

void measure(const std::string& mesh, const std::string& kind, Ground& ground, int threads, const Options& o,
             InstructionSet instructions) {
  Team team(threads);
  Integrator integrator(ground.mass, ground.is_free, {}, instructions);
  const std::size_t nodes = ground.mass.size();
  Motion motion{Vec3s(nodes, Vec3::Zero()), Vec3s(nodes, Vec3::Zero())};
  for (std::size_t i = 0; i < nodes; ++i) {
    const Vec3 s = (ground.grid.node[i] - ground.grid.low).cwiseQuotient(ground.grid.high - ground.grid.low);
    motion.velocity[i] = 0.01 * std::sin(pi * s.x()) * std::sin(pi * s.y()) * std::sin(pi * s.z()) * Vec3(1, 1, 1);
    motion.velocity[i] = motion.velocity[i].cwiseProduct(ground.is_free[i]);
  }
  Vec3s internal(nodes);
  std::optional<IncrementalForce> incremental;
  if (o.route == "incremental")
    incremental.emplace(ground.grid, ground.is_left, InitialState(Vec3s(nodes, Vec3::Zero())), o.has_large_strain);
  double gone = 0;  // no way leads to the first state [s]
  const Rival rival(o.beside_grains);
  std::vector<double> force_seconds, node_seconds, step_seconds;
  double best_force = 1e9, best_step = 1e9;
  for (int b = 0; b < o.blocks; ++b) {
    double in_force = 0, in_nodes = 0;
    for (int n = 0; n < o.steps; ++n) {
      const auto begin = Clock::now();
      if (incremental)
        incremental->advance(motion.displacement, motion.velocity, gone, internal, team);
      else
        ground.force.evaluate(motion.displacement, internal, team);
      const auto middle = Clock::now();
      gone = ground.time_step;
      integrator.advance(motion, internal, ground.force.reference, {}, 0.2, {ground.time_step, ground.time_step}, 1e9,
                         team);
      const double whole = seconds_since(begin), first = std::chrono::duration<double>(middle - begin).count();
      in_force += first, in_nodes += whole - first;
      best_force = std::min(best_force, first), best_step = std::min(best_step, whole);
    }
    force_seconds.push_back(in_force / o.steps), node_seconds.push_back(in_nodes / o.steps);
    step_seconds.push_back((in_force + in_nodes) / o.steps);
  }
  Hash hash;
  hash.add(std::span<const Vec3>(motion.displacement));
  hash.add(std::span<const Vec3>(motion.velocity));
  const double zones = static_cast<double>(ground.zones()), micro = 1e6 / zones;
  const StiffnessProduct& product = ground.force.product();
  const std::size_t bytes = incremental ? incremental->bytes() : product.bytes();
  const char* const held = incremental ? o.has_large_strain ? "stresses, large strain," : "stresses"
                                       : format_names[static_cast<int>(product.format())];
  const double stream = stream_seconds(bytes, team);
  std::printf(
      "%-15s %-20s %6.0f zones  %d thr  force %.4f (best %.4f)  nodes %.4f  step %.4f (best %.4f) us/zone = %.3f ms  "
      "%s %.1f MB, %.2f x its streaming  assembly %.2f + %.2f s  hash %016llx\n",
      mesh.c_str(), kind.c_str(), zones, threads, median(force_seconds) * micro, best_force * micro,
      median(node_seconds) * micro, median(step_seconds) * micro, best_step * micro, 1e3 * median(step_seconds), held,
      static_cast<double>(bytes) * 1e-6, best_force / stream, ground.assembly_seconds, ground.arrange_seconds,
      static_cast<unsigned long long>(hash.value()));
  std::fflush(stdout);
}

// A column held at its bottom whose velocity starts as 0.1 z/H: the same mesh, material and motion for another program.
void export_bar(const Grid& grid, const Options& o) {
  std::ofstream file(o.export_path);
  file << "*NODE,NSET=ALL\n";
  const auto line = [&](const std::string& text) { file << text << "\n"; };
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    line(fmt::format("{},{:.17g},{:.17g},{:.17g}", i + 1, grid.node[i].x(), grid.node[i].y(), grid.node[i].z()));
  line("*ELEMENT,TYPE=@ELEMENT@,ELSET=ZONES");
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    const auto& n = grid.zone[z];
    line(fmt::format("{},{},{},{},{},{},{},{},{}", z + 1, n[0] + 1, n[1] + 1, n[2] + 1, n[3] + 1, n[4] + 1, n[5] + 1,
                     n[6] + 1, n[7] + 1));
  }
  line("*NSET,NSET=BOTTOM");
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    if (grid.node[i].z() < grid.low.z() + 1e-9) line(fmt::format("{},", i + 1));
  line(fmt::format("*NSET,NSET=TOP\n{},", grid.node_count()));
  line("*MATERIAL,NAME=SOIL\n*ELASTIC\n44.3e6,0.3\n*DENSITY\n1630\n*SOLID SECTION,ELSET=ZONES,MATERIAL=SOIL");
  line("*BOUNDARY\nALL,1,2\nBOTTOM,3,3\n*INITIAL CONDITIONS,TYPE=VELOCITY");
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    line(fmt::format("{},3,{:.17g}", i + 1, 0.1 * (grid.node[i].z() - grid.low.z()) / grid.depth()));
  line("*STEP,INC=10000000\n*DYNAMIC,EXPLICIT\n1e-6,@TIME@\n*NODE PRINT,NSET=TOP,FREQUENCY=1000000\nU\n*END STEP");
  if (!file) throw IoError(fmt::format("{} could not be written", o.export_path));
}

void run_bar(const Options& o, InstructionSet instructions) {
  const double h = 0.2;
  Grid grid = block(h * o.bar[0], h * o.bar[1], h * o.bar[2], o.bar[0], o.bar[1], o.bar[2]);
  if (!o.export_path.empty()) export_bar(grid, o);
  Ground ground(std::move(grid), kind_by_name(o.kinds.front()), Supports::BottomFixed, o.format, instructions);
  for (Vec3& f : ground.is_free) f.x() = f.y() = 0;
  Integrator integrator(ground.mass, ground.is_free, {}, instructions);
  const std::size_t nodes = ground.mass.size();
  Motion motion{Vec3s(nodes, Vec3::Zero()), Vec3s(nodes, Vec3::Zero())};
  for (std::size_t i = 0; i < nodes; ++i)
    motion.velocity[i].z() =
        ground.is_free[i].z() * 0.1 * (ground.grid.node[i].z() - ground.grid.low.z()) / ground.grid.depth();
  const int steps = static_cast<int>(std::ceil(o.bar_time / ground.time_step));
  const double dt = o.bar_time / steps;
  Vec3s internal(nodes);
  // v(-1/2) = v(0) for u(0) = 0: the first half step has no force.
  const auto begin = Clock::now();
  for (int n = 0; n < steps; ++n) {
    ground.force.evaluate(motion.displacement, internal);
    integrator.advance(motion, internal, ground.force.reference, {}, 0, {dt, dt}, 1e9);
  }
  const double seconds = seconds_since(begin);
  std::printf("bar zones=%zu steps=%d time_step=%.9g seconds_a_step=%.9g top=%.9g\n", ground.zones(), steps, dt,
              seconds / steps, motion.displacement.back().z());
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  CLI::App app{"The ground's step: microseconds a zone and step, one line a mesh, kind of zone and number of threads."};
  app.add_option(
         "--mesh", o.meshes,
         "paper (21,280 zones around the hole), distorted (21,280, no two alike), large, large_distorted (200,000)")
      ->delimiter(',')
      ->capture_default_str();
  app.add_option("--kinds", o.kinds, "kinds of zones")->delimiter(',')->capture_default_str();
  app.add_option("--threads", o.threads)->delimiter(',')->capture_default_str()->check(CLI::Range(1, 256));
  app.add_option("--steps", o.steps, "of a block")->capture_default_str()->check(CLI::Range(1, 1000000));
  app.add_option("--blocks", o.blocks, "the median of their means is printed, and the best step")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000));
  app.add_option("--instructions", o.instructions, "generic, avx2 or avx512; the best by default");
  app.add_option("--format", o.format, "of the stiffness: auto, shared, half or zones")
      ->capture_default_str()
      ->check(CLI::IsMember({"auto", "shared", "half", "zones"}));
  app.add_option("--route", o.route, "assembled, or incremental: stresses stored and updated, some forty times slower")
      ->capture_default_str()
      ->check(CLI::IsMember({"assembled", "incremental"}));
  app.add_flag("--large-strain", o.has_large_strain, "zones deform with their nodes; only with --route incremental");
  app.add_flag("--beside-grains", o.beside_grains, "while another thread walks 24 MB, as grains on the next core do");
  app.add_option("--bar", o.bar, "NX,NY,NZ: a column of cubes instead, for other programs to follow")
      ->delimiter(',')
      ->expected(3);
  app.add_option("--bar-time", o.bar_time, "simulated [s]")->capture_default_str();
  app.add_option("--export", o.export_path, "CalculiX input of the column, with @ELEMENT@ and @TIME@ to fill in");
  app.footer(
      "Examples:\n"
      "  tools/bench continuum\n"
      "  tools/bench continuum --route incremental --large-strain --mesh paper --steps 10\n"
      "  tools/bench continuum --mesh large,large_distorted --kinds b_bar --steps 50\n"
      "  tools/bench continuum --against ccx      (CalculiX's explicit dynamics on the same column)");
  CLI11_PARSE(app, argc, argv);
  try {
    const InstructionSet set = o.instructions.empty() ? best_instructions() : instructions_by_name(o.instructions);
    if (o.has_large_strain && o.route != "incremental")
      throw InputError("--large-strain: the assembled operator keeps its shape; add --route incremental");
    if (!o.bar.empty()) {
      run_bar(o, set);
      return 0;
    }
    for (const int threads : o.threads) {
      Team team(threads);
      std::printf("triad, %d threads: %.1f GB/s\n", threads, triad(team));
    }
    for (const std::string& mesh : o.meshes)
      for (const std::string& kind : o.kinds) {
        Ground ground(mesh_by_name(mesh), kind_by_name(kind), Supports::AllFixed, o.format, set);
        for (const int threads : o.threads) measure(mesh, kind, ground, threads, o, set);
      }
  } catch (const Error& e) {
    std::fprintf(stderr, "bench_continuum: %s\n", e.what());
    return static_cast<int>(e.code());
  }
  return 0;
}
