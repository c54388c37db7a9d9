#include "dem_server/balance.hpp"

#include <algorithm>
#include <limits>

#include "common/checks.hpp"
#include "common/log.hpp"
#include "common/stopwatch.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/make_model.hpp"
#include "dem_server/output.hpp"

namespace lockstep::dem {

namespace {

BottomBalance bottom_balance(const Model& m, const Servo& servo, const Settings& settings) {
  BottomBalance b;
  b.weight = m.particles.total_mass() * settings.gravity;
  if (settings.is_alone) {
    b.force = -m.wall_totals.force.z();  // smooth sides: what walls carry is the bottom's, less a lid's push
    b.area = settings.packing ? settings.packing->container.cross_section() : 0.0;
  }
  for (const Ring& ring : servo.rings())
    if (!ring.is_side()) b.force += ring.pressure * ring.area, b.area += ring.area;
  if (m.pile) b.tip = servo.tip_pressure() * m.pile->tip_area();
  return b;
}

RestFigures rest_figures(const Model& m, const Servo& servo, const Settings& settings) {
  const double tolerance = settings.balance.traction_tolerance;
  RestFigures f;
  f.unbalanced_ratio = unbalanced_ratio(m);
  f.is_servo_active = servo.is_active;
  f.servo_speed = servo.fastest();
  f.ring_mismatch = servo.worst_movable_mismatch(tolerance);
  f.bottom_mismatch = bottom_balance(m, servo, settings).mismatch(tolerance);
  f.wall_error = m.walls.worst_servo_error();
  return f;
}

BalanceFigures figures_of(const Model& m, const Servo& servo, const Settings& settings) {
  const BalanceSettings& b = settings.balance;
  BalanceFigures figures;
  figures.cycles = m.step;
  figures.unbalanced_ratio = b.max_cycles > 0 ? unbalanced_ratio(m) : 0.0;
  figures.has_servo = b.max_cycles > 0 && b.servo;
  if (!figures.has_servo) return figures;
  const BottomBalance bottom = bottom_balance(m, servo, settings);
  figures.rings = servo.rings();
  figures.tip_pressure = servo.tip_pressure();
  figures.ring_mismatch = servo.worst_mismatch(b.traction_tolerance);
  figures.bottom_mismatch = bottom.mismatch(b.traction_tolerance);
  figures.bottom_force = bottom.force, figures.weight = bottom.weight, figures.tip_force = bottom.tip;
  return figures;
}

// Vertical pressure at z in grains alone at rest between smooth walls: their weight above, and lids that press [Pa].
double weight_above(double z, const Settings& settings, const Assembly& assembly) {
  if (!settings.packing) return 0;
  const double bulk_density = assembly.solid_density * (1 - assembly.overall_porosity);  // [kg/m3]
  double pressure = bulk_density * settings.gravity * (settings.packing->container.top - z);
  for (const WallSettings& wall : settings.walls)
    if (const auto* plane = std::get_if<PlaneShape>(&wall.shape); plane && wall.servo && plane->normal.z() < 0)
      pressure += wall.servo->pressure;
  return pressure;
}

// The three parts of the stage, one after the other.
class Balancing {
 public:
  Balancing(Model& model, Assembly& assembly, const Settings& settings, const BalanceCalls& calls)
      : model_(model), assembly_(assembly), settings_(settings), balance_(settings.balance), calls_(calls) {}

  void relax();
  void grow(double ground_density);
  void settle(Servo& servo);

 private:
  double renew_step();
  void set_gravity(bool is_on) { model_.gravity = is_on ? Vec3(0, 0, -settings_.gravity) : Vec3(Vec3::Zero()); }
  void build_walls(const std::vector<WallSettings>& walls) {
    model_.walls = Walls(walls, settings_.wall_friction);
    model_.walls.set_moving(false, false);
  }
  void limit_speeds();
  void tell(const RestFigures& figures, const Servo& servo, std::uint32_t n);
  void judge(const RestFigures& figures, const Servo& servo, bool has_rest) const;

  Model& model_;
  Assembly& assembly_;
  const Settings& settings_;
  const BalanceSettings& balance_;
  const BalanceCalls& calls_;
  double limit_ = std::numeric_limits<double>::infinity();  // of the step, the smallest so far [s]
};

// The step of the next cycles. It never grows: a packing that has come loose for a moment gets its contacts back sooner
// than the limit is looked at again.
double Balancing::renew_step() {
  limit_ = std::min(limit_, stable_step(model_, balance_.damping).step);
  return std::min(1.0, settings_.step_fraction) * limit_;
}

void Balancing::limit_speeds() {
  Particles& p = model_.particles;
  for (std::size_t b = 0; b < p.body_count(); ++b) {
    if (const double speed = p.velocity(b).norm(); speed > relax_speed) p.velocity(b) *= relax_speed / speed;
    if (const double speed = p.spin(b).norm() * p.equivalent_radius(b); speed > relax_speed)
      p.spin(b) *= relax_speed / speed;
  }
}

// The cut leaves grains pressed into walls and pile: they are let go without gravity and friction, at limited speed.
void Balancing::relax() {
  Model& m = model_;
  Held held;
  set_gravity(false);
  set_friction(m, settings_, 0, 0);
  double largest = 1;
  const Stopwatch time;
  evaluate_forces(m);
  for (int n = 0; n < relax_cycles && largest > relaxed_overlap; ++n) {
    if (n % limit_interval == 0) held.time_step = renew_step();
    cycle(m, held);
    limit_speeds();
    largest = std::max({m.pair_totals.largest_overlap_ratio, m.facet_totals.max_overlap,
                        m.pile_totals.all().max_overlap, m.wall_totals.max_overlap});
    if (n % heartbeat_interval == 0) calls_.beat("relaxing the cut packing", 0.2 + 0.1 * n / relax_cycles);
  }
  set_gravity(true);
  spdlog::info("relaxed: largest overlap {:.3f} R after {} cycles, {:.1f} s", largest, m.step, time.seconds());
}

// The cut leaves gaps along walls and pile as well, and a packing that is not jammed collapses for ever under gravity.
// So the grains are grown, with the friction that the cube was packed with and under a lid, until the whole packing
// presses on the facets again, and let down.
void Balancing::grow(double ground_density) {
  Model& m = model_;
  Held held;
  set_gravity(false);
  std::vector<WallSettings> with_lid = settings_.all_walls();
  with_lid.push_back(
      plane_wall({{0, 0, settings_.packing->container.top + assembly_.mean_radius}, -Vec3::UnitZ(), Vec3::Zero()}));
  build_walls(with_lid);
  set_friction(m, settings_, assembly_.preparation_friction, 0);
  double area = settings_.is_alone ? settings_.packing->container.surface() : 0.0;
  for (std::size_t f = 0; f < m.facets.facet_count(); ++f) area += m.facets.area_vector(f).norm();
  double growth = 1, pressure = 0, reached = 0;
  bool is_growing = true;
  const std::uint64_t begin = m.step;
  const Stopwatch time;
  m.detail = Detail::Forces;  // only the sums of facets and walls are looked at
  for (int n = 0; n < grow_cycles && (is_growing || pressure > released_pressure); ++n) {
    if (n % limit_interval == 0) held.time_step = renew_step();
    if (n % grow_interval == 0) {
      const double change = (is_growing ? grow_rate : -release_rate) * grow_interval * held.time_step;
      growth *= 1 + change;
      m.particles.scale_all(1 + change);
    }
    cycle(m, held);
    const double pressing = settings_.is_alone ? m.wall_totals.normal_force : m.facet_totals.normal_force;
    pressure += (pressing / area - pressure) / grow_averaging;
    reached = std::max(reached, pressure);
    is_growing = is_growing && pressure < grown_pressure;
    if (n % heartbeat_interval == 0)
      calls_.beat("growing the packing into its gaps", 0.3 + 0.1 * std::min(1.0, pressure / grown_pressure));
  }
  refit(assembly_, settings_, ground_density, m.particles);
  build_walls(settings_.all_walls());
  set_gravity(true);
  spdlog::info(
      "grown by {:.2f} % to {:.1f} kPa and let down to {:.1f} kPa in {} cycles: mean radius {:.4g} m, overall porosity "
      "{:.3f}, solid density {:.0f} kg/m3, {:.1f} s",
      100 * (growth - 1), reached / 1000, pressure / 1000, m.step - begin, assembly_.mean_radius,
      assembly_.overall_porosity, assembly_.solid_density, time.seconds());
}

void Balancing::settle(Servo& servo) {
  Model& m = model_;
  set_friction(m, settings_, balance_.friction, 0);
  m.contacts.clear_history();
  servo.is_active = false;
  m.walls.set_moving(false, true);
  const Stopwatch time;
  RestFigures figures;
  std::uint32_t n = 0;
  bool has_rest = false;
  for (; n < balance_.max_cycles && !has_rest; ++n) {
    if (n % limit_interval == 0) servo.time_step = renew_step();
    m.detail = n % heartbeat_interval == 0 ? Detail::All : Detail::Forces;  // sums are looked at once in a while
    cycle(m, servo);
    if (n % heartbeat_interval != 0) continue;
    figures = rest_figures(m, servo, settings_);
    if (!servo.is_active && balance_.servo && n > settle_cycles && figures.unbalanced_ratio < servo_start_ratio) {
      servo.is_active = figures.is_servo_active = true;
      spdlog::info("servo on after {} cycles, unbalanced ratio {:.1e}", n, figures.unbalanced_ratio);
    }
    has_rest = n > settle_cycles && is_at_rest(figures, balance_);
    tell(figures, servo, n);
  }
  judge(figures, servo, has_rest);
  spdlog::info("settled in {} cycles, {:.1f} s", n, time.seconds());
}

void Balancing::tell(const RestFigures& figures, const Servo& servo, std::uint32_t n) {
  const double ratio = figures.unbalanced_ratio, wanted = balance_.tolerance;
  const double fraction = 0.3 + 0.7 * std::clamp(std::log10(std::max(ratio, wanted)) / std::log10(wanted), 0.0, 1.0);
  calls_.beat(fmt::format("balancing, unbalanced ratio {:.1e}", ratio), fraction);
  calls_.look(ratio, fraction);
  if (n % 2000 == 0)
    spdlog::debug(
        "balancing: cycle {}, unbalanced ratio {:.1e}, ring mismatch {:.2f}, servo speed {:.1e} m/s, tip {:.2f} kPa, "
        "bottom contacts {}, list builds {}",
        n, ratio, servo.worst_mismatch(balance_.traction_tolerance), figures.servo_speed, servo.tip_pressure() / 1000,
        model_.facet_totals.contacts, model_.contacts.rebuilds());
}

// What is said of a packing that did not come to rest, and of rings that could not follow.
void Balancing::judge(const RestFigures& figures, const Servo& servo, bool has_rest) const {
  const BalanceSettings& b = balance_;
  if (!has_rest && figures.unbalanced_ratio > hopeless_ratio)
    throw NumericalError(fmt::format(
        "Balance gave up after balance.max_cycles = {} with an unbalanced ratio of {:.2g} (wanted {:.1e}): the "
        "packing still falls; give more cycles",
        b.max_cycles, figures.unbalanced_ratio, b.tolerance));
  if (!has_rest)
    spdlog::warn(
        "Balance gave up after balance.max_cycles = {}: unbalanced ratio {:.1e} (wanted {:.1e}), servo {:.1e} m/s "
        "(wanted "
        "{:.1e}), mismatch {:.2f} of the tolerance; give more cycles or a looser tolerance",
        b.max_cycles, figures.unbalanced_ratio, b.tolerance, servo.fastest(), b.servo_tolerance,
        servo.worst_mismatch(b.traction_tolerance));
  for (const Ring& ring : servo.rings())
    if (ring.is_at_end)
      spdlog::warn(
          "the ring at z {:.2f} m is at the end of its travel with {:.2f} kPa of {:.2f} kPa; balance.max_servo_travel "
          "(now "
          "{} R) would let it go on",
          ring.center_z, ring.pressure / 1000, ring.target / 1000, b.max_servo_travel);
}

}  // namespace

bool is_at_rest(const RestFigures& f, const BalanceSettings& settings) {
  const bool has_servo_done = !settings.servo || (f.is_servo_active && f.servo_speed < settings.servo_tolerance &&
                                                  f.ring_mismatch < 1 && f.bottom_mismatch < 1);
  return f.unbalanced_ratio < settings.tolerance && has_servo_done && f.wall_error < settings.traction_tolerance;
}

double tip_target(const Settings& settings, const Assembly& assembly, const HandedOver& ground) {
  if (!settings.pile) return 0;
  return settings.is_alone ? weight_above(-settings.pile->embedment, settings, assembly) : ground.tip_target;
}

BalanceFigures balance_packing(Model& m, Assembly& assembly, const Settings& settings, const HandedOver& ground,
                               const BalanceCalls& calls) {
  ServoSettings servo_settings;
  servo_settings.max_travel = settings.balance.max_servo_travel * assembly.mean_radius;
  const bool is_cycled = settings.balance.max_cycles > 0;
  m.damping = settings.balance.damping;
  Balancing balancing(m, assembly, settings, calls);
  if (is_cycled) balancing.relax();
  if (is_cycled && settings.packing) balancing.grow(ground.bulk_density);
  Servo servo(m, ground.ring, ground.traction, tip_target(settings, assembly, ground), servo_settings);
  if (is_cycled) balancing.settle(servo);
  return figures_of(m, servo, settings);
}

void log_servo(const BalanceFigures& figures, const Model& m, double tip_target) {
  if (!figures.has_servo) return;
  std::string table;
  for (const Ring& ring : figures.rings)
    if (ring.is_side())
      table += fmt::format("\n    ring at z {:6.2f} m: {:8.2f} kPa, handed over {:8.2f} kPa, moved {:+.3f} mm",
                           ring.center_z, ring.pressure / 1000, ring.target / 1000, 1000 * ring.travel);
  if (!table.empty()) spdlog::info("ring pressures:{}", table);
  if (m.pile)
    spdlog::info(
        "tip at z {:.3f} m carries {:.2f} kPa, handed over {:.2f} kPa; bottom {:.2f} kN = weight {:.2f} + tip {:.2f} "
        "{:+.2f} kN",
        m.pile->tip_z(), figures.tip_pressure / 1000, tip_target / 1000, figures.bottom_force / 1000,
        figures.weight / 1000, figures.tip_force / 1000,
        (figures.bottom_force - (figures.weight + figures.tip_force)) / 1000);
}

Json balance_entry(const BalanceFigures& figures, const Model& m, const Assembly& assembly, double tip_target) {
  Json entry;
  entry.add("unbalanced_ratio", figures.unbalanced_ratio)
      .add("contacts", touching_contacts(m))
      .add("bulk_porosity", figures.porosity)
      .add("cube_porosity", assembly.cube_porosity)
      .add("preparation_friction", assembly.preparation_friction)
      .add("overall_porosity", assembly.overall_porosity);
  if (figures.has_servo) {
    std::vector<double> targets, pressures, depths;
    for (const Ring& ring : figures.rings)
      if (ring.is_side())
        targets.push_back(ring.target), pressures.push_back(ring.pressure), depths.push_back(ring.center_z);
    entry.add("ring_depth_m", depths).add("ring_target_pa", targets).add("ring_pressure_pa", pressures);
    entry.add("tip_target_pa", tip_target).add("tip_pressure_pa", figures.tip_pressure);
    entry.add("bottom_force_n", figures.bottom_force)
        .add("weight_n", figures.weight)
        .add("bottom_error_n", figures.bottom_force - (figures.weight + figures.tip_force));
    entry.add("worst_ring_mismatch", figures.ring_mismatch);
  }
  return entry.add("cycles", figures.cycles);
}

}  // namespace lockstep::dem
