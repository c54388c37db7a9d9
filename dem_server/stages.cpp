#include "dem_server/stages.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>

#include "common/checks.hpp"
#include "common/coupled_ledger.hpp"
#include "common/coupled_limit.hpp"
#include "common/interrupt.hpp"
#include "common/log.hpp"
#include "common/packet.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/output.hpp"
#include "dem_server/packing.hpp"
#include "dem_server/packing_file.hpp"
#include "dem_server/reversal.hpp"
#include "dem_server/servo.hpp"
#include "dem_server/settings.hpp"
#include "protocol/session.hpp"

namespace lockstep::dem {

namespace {

using protocol::Session;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

// What the bottom carries in stage Balance, against what smooth sides leave it to carry.
struct BottomBalance {
  double force = 0;   // of the bottom [N]
  double weight = 0;  // of the grains [N]
  double tip = 0;     // of the pile on the grains [N]
  double area = 0;    // of the bottom [m2]
  double error() const { return force - (weight + tip); }
  // At most 1 when matched: |error| over the share of the load and 0.5 kPa.
  double mismatch(double relative) const {
    return std::abs(error()) / (relative * (weight + tip) + Servo::pressure_floor * area);
  }
};

// The run of one session. Each stage is a member function, in order.
class GrainsRun {
 public:
  GrainsRun(const SceneFile& scene, std::unique_ptr<protocol::Channel> channel, const RunOptions& options)
      : scene_(scene),
        settings_(make_settings(scene)),
        output_(settings_, options.results),
        prints_progress_(options.prints_progress),
        packing_path_(options.packing),
        watches_shivering_(options.watches_shivering),
        threads_(options.threads),
        balance_threads_(options.balance_threads),
        session_(make_session(settings_, std::move(channel), options.record_path)) {
    check_company(settings_, session_ != nullptr, scene);
  }

  RunReport run() {
    try {
      if (settings_.is_alone) return run_alone();
      shake_hands();
      receive_initial_stress();
      balance();
      excavate();
      exchange();
      return finish();
    } catch (const Error& error) {
      if (session_) session_->abort(static_cast<int>(error.code()), error.what());
      report_.is_interrupted = error.code() == ExitCode::Interrupted;
      end_ = error.what();
      keep_last_state(error.code() == ExitCode::Numerical);
      throw;
    } catch (const std::exception& error) {
      if (session_) session_->abort(static_cast<int>(ExitCode::Internal), error.what());
      throw;
    }
  }

 private:
  class Peer;
  class NoPeer;

  static std::unique_ptr<Session> make_session(const Settings& settings, std::unique_ptr<protocol::Channel> channel,
                                               const std::string& record_path) {
    if (!channel) return nullptr;
    protocol::SessionSettings s;
    s.peer_timeout = std::chrono::milliseconds(std::llround(1000 * settings.peer_timeout));
    s.record_path = record_path;
    return std::make_unique<Session>(std::move(channel), protocol::Role::Grains, s);
  }

  RunReport run_alone();
  void beat(std::string_view text, double fraction);
  void shake_hands();
  void receive_initial_stress();
  void balance();
  void make_model();
  HandedOver handed_over() const;
  BalanceFigures make_packing(const HandedOver& ground);
  void take_packing(const BalancedPacking& packing);
  BalanceFigures figures_of(const Servo& servo) const;
  void tell_balance(const BalanceFigures& figures, double tip_target, Clock::time_point begin);
  void relax();
  void grow();
  void settle(Servo& servo);
  void excavate();
  void exchange();
  RunReport finish();

  void begin_apply();
  void begin_penetration();
  void push_pile();
  void record_step();
  bool is_over() const;
  double penetration() const {
    return stage_ >= protocol::Stage::Apply && settings_.pile ? pile_start_ - model_->pile->tip_z() : 0.0;
  }
  double s_over_d() const { return settings_.pile ? 0.5 * penetration() / settings_.pile->shape.radius : 0.0; }
  double target_vertical_pressure(double z) const;
  StepLimit grains_limit() const;
  std::string culprit(const StepLimit& limit) const;
  double weight_above(double z) const;
  double tip_target() const;
  void set_friction(double grain, double walls_and_pile_factor);
  BottomBalance bottom_balance(const Servo& servo) const;
  double renew_step();
  void watch();
  void watch_reversal();
  void choose_detail(bool is_booked);
  void keep_good_state(std::uint64_t exchanges);
  void return_to_good_state();
  void show_progress(double unbalanced);
  void show_packing(double fraction);
  void keep_last_state(bool has_failed) noexcept;
  void stage_done(const std::string& name, Clock::time_point begin, Json entry);
  Json summary();

  SceneFile scene_;
  Settings settings_;
  Output output_;
  bool prints_progress_;
  std::filesystem::path packing_path_;
  bool watches_shivering_;
  int threads_, balance_threads_;
  std::unique_ptr<Session> session_;  // none when the grains are alone

  protocol::InitialStress initial_;
  Assembly assembly_;
  std::unique_ptr<Model> model_;
  StepLimit limit_;                                                 // of the grains, at Excavate
  double balance_limit_ = std::numeric_limits<double>::infinity();  // smallest so far in Balance [s]
  double reach_ = 0;  // of grains and interface from the origin at the start [m]

  protocol::Stage stage_ = protocol::Stage::Hello;
  double pile_start_ = 0;               // tip_z at S = 0 [m]
  double penetration_begin_ = 0;        // time at S = 0 [s]
  double next_snapshot_ = 0;            // S/D or seconds
  std::vector<double> told_stiffness_;  // per node, as the peer knows it [N/m]
  CoupledLimit told_limit_;  // as the peer knows it; of the grains alone with a peer that does not tell its own
  std::optional<CoupledLedger> coupled_;
  // What a run that fails goes back to, newest last.
  struct GoodState {
    std::uint64_t exchanges = 0, step = 0;
    double time = 0;  // [s]
    PackingState state;
  };
  std::vector<GoodState> good_states_;
  double ratio_ = 1;            // unbalanced, latest known
  std::uint64_t contacts_ = 0;  // that touch, likewise
  Reversal reversal_;
  Clock::time_point last_progress_{};
  Clock::time_point begin_ = Clock::now();
  Clock::time_point stage_begin_ = Clock::now();
  double stage_fraction_ = 0;  // of Balance
  Json stages_;
  std::string end_;
  RunReport report_;
};

// ------------------------------------------------------------------------------------------------ Hello, steps 1 and 2

void GrainsRun::shake_hands() {
  protocol::Hello mine;
  mine.role = protocol::Role::Grains;
  mine.solver = "dem_server";
  mine.solver_version = lockstep_version();
  mine.capabilities = {"progress"};
  mine.scene_digest = scene_.digest;
  const protocol::Hello peer = session_->shake_hands(mine);
  spdlog::info("stage Hello: peer {} {} at {}, scene {}", peer.solver, peer.solver_version, session_->peer(),
               peer.scene_digest.empty() ? "of its own" : peer.scene_digest);
}

void GrainsRun::receive_initial_stress() {
  stage_ = protocol::Stage::InitialStress;
  const auto begin = Clock::now();
  session_->on_progress = [](const protocol::Progress& p) {
    spdlog::debug("peer: {} ({:.0f} %)", p.text, 100 * p.fraction);
  };
  initial_ = session_->receive<protocol::InitialStress>();
  spdlog::info("stage InitialStress (paper step 1): {} nodes, {} facets, unbalanced ratio {:.1e}, after {:.1f} s",
               initial_.nodes.size(), initial_.facets.size(), initial_.unbalanced_ratio, seconds_since(begin));
  if (settings_.pile && initial_.profile.empty())
    throw PeerError(
        "InitialStress.profile is empty, but the scene has a pile whose tip must carry the stress of its depth; "
        "the peer must send the profile inside the discrete domain");
  stage_done("InitialStress", begin, Json().add("nodes", static_cast<int>(initial_.nodes.size())));
}

// Vertical pressure that the ground carried at z, interpolated in the profile [Pa].
double GrainsRun::target_vertical_pressure(double z) const {
  const auto& p = initial_.profile;
  if (p.empty()) return 0;
  if (z <= p.front().z) return -p.front().vertical;
  for (std::size_t k = 1; k < p.size(); ++k)
    if (z <= p[k].z) {
      const double t = (z - p[k - 1].z) / (p[k].z - p[k - 1].z);
      return -(p[k - 1].vertical + t * (p[k].vertical - p[k - 1].vertical));
    }
  return -p.back().vertical;
}

// Friction between grains, and that of interface, walls and pile as a share of the scene's.
void GrainsRun::set_friction(double grain, double share) {
  model_->material.friction = grain;
  model_->facet_material.friction = share * settings_.interface_friction;
  model_->walls.set_friction_share(share);
  if (model_->pile) model_->pile->set_friction(share * settings_.pile->friction);
}

void GrainsRun::balance() {
  stage_ = protocol::Stage::Balance;
  const auto begin = Clock::now();
  std::optional<BalancedPacking> packing;
  if (!packing_path_.empty()) packing = open_packing(packing_path_, settings_.packing_keys);
  const bool is_given = packing.has_value();
  const HandedOver ground = handed_over();
  if (is_given) {
    check_fits(packing->ground, ground, packing_path_);
    take_packing(*packing);
  } else {
    packing.emplace();
    packing->figures = make_packing(ground);
  }
  Model& m = *model_;
  m.facets.set_offsets(Vec3s(m.facets.offsets()));  // frozen: their velocity is zero from here on
  if (m.pile) m.pile->set_velocity(0);
  m.walls.set_moving(false, false);
  m.detail = Detail::All;
  if (!is_given && !packing_path_.empty()) {
    // Goes on as one that reads the file will: with lists of the same age sums have the same bits too, not states alone.
    packing->state = state_of(m);
    restore(m, packing->state);
  }
  m.team = std::make_unique<Team>(threads_);
  evaluate_forces(m);
  if (!is_given) packing->figures.porosity = bulk_porosity(settings_, assembly_, m.particles);
  tell_balance(packing->figures, tip_target(), begin);
  if (is_given) {
    spdlog::info("the balanced packing was taken from {}", packing_path_.string());
  } else if (!packing_path_.empty()) {
    packing->keys = settings_.packing_keys;
    packing->ground = ground;
    packing->assembly = assembly_;
    write_packing(packing_path_, *packing);
    spdlog::info("the balanced packing was written to {}", packing_path_.string());
  }
}

HandedOver GrainsRun::handed_over() const {
  return {initial_.nodes,    initial_.facets,       initial_.ring,
          initial_.traction, initial_.bulk_density, settings_.is_alone ? 0.0 : tip_target()};
}

// The grains of `assembly_`, and what is around them.
void GrainsRun::make_model() {
  const double radius = assembly_.mean_radius > 0 ? assembly_.mean_radius : 1.0;
  const double collar = settings_.pile ? 2 * settings_.pile->shape.radius : 0.0;
  model_ = std::make_unique<Model>(list_skin * radius,
                                   worthwhile_threads(assembly_.particles.body_count(), balance_threads_));
  Model& m = *model_;
  m.particles = std::move(assembly_.particles);
  m.is_fixed = assembly_.is_fixed;
  m.gravity = {0, 0, -settings_.gravity};
  m.material = settings_.material;
  m.facet_material = {settings_.material.contact_modulus, settings_.material.stiffness_ratio,
                      settings_.interface_friction,       settings_.material.damping_ratio,
                      settings_.facet_stiffness_factor,   settings_.transfers_moment};
  m.facets = InterfaceFacets(initial_.nodes, initial_.facets, collar);
  m.walls = Walls(settings_.all_walls(), settings_.wall_friction);
  m.walls.set_moving(false, false);
  if (settings_.pile) m.pile.emplace(settings_.pile->shape, -settings_.pile->embedment, settings_.pile->friction);
  spdlog::info(
      "packing: {} grains with {} pebbles, mean radius {:.4g} m, solid density {:.0f} kg/m3, porosity of the cube "
      "{:.3f}, overall {:.3f}",
      m.particles.body_count(), m.particles.pebble_count(), assembly_.mean_radius, assembly_.solid_density,
      assembly_.cube_porosity, assembly_.overall_porosity);

  for (std::size_t b = 0; b < m.particles.body_count(); ++b)
    reach_ = std::max(reach_, std::as_const(m.particles).position(b).norm());
  for (const Vec3& x : initial_.nodes) reach_ = std::max(reach_, x.norm());
  if (!settings_.is_alone) return;
  // No ground says how wide the scene is: what flies and falls freely as long as the run lasts is still in it.
  double speed = 0;
  for (std::size_t b = 0; b < m.particles.body_count(); ++b)
    speed = std::max(speed, std::as_const(m.particles).velocity(b).norm());
  reach_ += settings_.run_duration * (speed + 0.5 * settings_.gravity * settings_.run_duration);
}

BalanceFigures GrainsRun::make_packing(const HandedOver& ground) {
  assembly_ = assemble(
      settings_, initial_.bulk_density,
      [this](std::string_view text, double fraction) {
        beat(text, 0.2 * fraction);
        show_packing(0.2 * fraction);
      },
      balance_threads_);
  make_model();
  ServoSettings servo_settings;
  servo_settings.max_travel = settings_.balance.max_servo_travel * assembly_.mean_radius;
  const bool is_cycled = settings_.balance.max_cycles > 0;
  if (is_cycled) relax();
  if (is_cycled && settings_.packing) grow();
  Servo servo(*model_, ground.ring, ground.traction, tip_target(), servo_settings);
  if (is_cycled) settle(servo);
  return figures_of(servo);
}

void GrainsRun::take_packing(const BalancedPacking& packing) {
  assembly_ = packing.assembly;
  assembly_.particles = packing.state.particles;
  assembly_.is_fixed = packing.state.is_fixed;
  make_model();
  restore(*model_, packing.state);
  if (settings_.balance.max_cycles > 0) set_friction(settings_.balance.friction, 0);
}

BalanceFigures GrainsRun::figures_of(const Servo& servo) const {
  BalanceFigures figures;
  figures.cycles = model_->step;
  figures.unbalanced_ratio = settings_.balance.max_cycles > 0 ? unbalanced_ratio(*model_) : 0.0;
  figures.has_servo = settings_.balance.max_cycles > 0 && settings_.balance.servo;
  if (!figures.has_servo) return figures;
  const BottomBalance bottom = bottom_balance(servo);
  figures.rings = servo.rings();
  figures.tip_pressure = servo.tip_pressure();
  figures.ring_mismatch = servo.worst_mismatch(settings_.balance.traction_tolerance);
  figures.bottom_mismatch = bottom.mismatch(settings_.balance.traction_tolerance);
  figures.bottom_force = bottom.force, figures.weight = bottom.weight, figures.tip_force = bottom.tip;
  return figures;
}

// What the packing reached, to the peer, the log and the summary.
void GrainsRun::tell_balance(const BalanceFigures& figures, double tip_target, Clock::time_point begin) {
  const Model& m = *model_;
  protocol::Balance reached;
  reached.traction.resize(initial_.facets.size());
  for (std::size_t f = 0; f < reached.traction.size(); ++f)
    reached.traction[f] = m.facets.facet_force()[f] / m.facets.area_vector(f).norm();
  reached.porosity = figures.porosity;
  reached.unbalanced_ratio = figures.unbalanced_ratio;
  reached.particles = m.particles.body_count();
  reached.contacts = static_cast<std::uint64_t>(m.pair_totals.active) + m.facet_totals.contacts;
  if (session_) session_->send(reached);

  Json entry;
  entry.add("unbalanced_ratio", reached.unbalanced_ratio)
      .add("contacts", static_cast<std::int64_t>(reached.contacts))
      .add("bulk_porosity", reached.porosity)
      .add("cube_porosity", assembly_.cube_porosity)
      .add("preparation_friction", assembly_.preparation_friction)
      .add("overall_porosity", assembly_.overall_porosity);
  if (figures.has_servo) {
    std::string table;
    std::vector<double> targets, pressures, depths;
    for (const Ring& ring : figures.rings) {
      if (!ring.is_side()) continue;
      targets.push_back(ring.target), pressures.push_back(ring.pressure), depths.push_back(ring.center_z);
      table += fmt::format("\n    ring at z {:6.2f} m: {:8.2f} kPa, handed over {:8.2f} kPa, moved {:+.3f} mm",
                           ring.center_z, ring.pressure / 1000, ring.target / 1000, 1000 * ring.travel);
    }
    if (!table.empty()) spdlog::info("ring pressures:{}", table);
    const double bottom_error = figures.bottom_force - (figures.weight + figures.tip_force);
    if (m.pile)
      spdlog::info(
          "tip at z {:.3f} m carries {:.2f} kPa, handed over {:.2f} kPa; bottom {:.2f} kN = weight {:.2f} + tip {:.2f} "
          "{:+.2f} kN",
          m.pile->tip_z(), figures.tip_pressure / 1000, tip_target / 1000, figures.bottom_force / 1000,
          figures.weight / 1000, figures.tip_force / 1000, bottom_error / 1000);
    entry.add("ring_depth_m", depths).add("ring_target_pa", targets).add("ring_pressure_pa", pressures);
    entry.add("tip_target_pa", tip_target).add("tip_pressure_pa", figures.tip_pressure);
    entry.add("bottom_force_n", figures.bottom_force)
        .add("weight_n", figures.weight)
        .add("bottom_error_n", bottom_error);
    report_.ring_mismatch = figures.ring_mismatch;
    report_.bottom_mismatch = figures.bottom_mismatch;
    entry.add("worst_ring_mismatch", report_.ring_mismatch);
  }
  spdlog::info(
      "stage Balance (paper step 2): unbalanced ratio {:.1e}, {} contacts, bulk porosity {:.3f}, {} cycles, {:.1f} s",
      reached.unbalanced_ratio, reached.contacts, reached.porosity, figures.cycles, seconds_since(begin));
  entry.add("cycles", static_cast<std::int64_t>(figures.cycles));
  stage_done("Balance", begin, std::move(entry));
}

BottomBalance GrainsRun::bottom_balance(const Servo& servo) const {
  BottomBalance b;
  b.weight = model_->particles.total_mass() * settings_.gravity;
  if (settings_.is_alone) {
    b.force = -model_->wall_totals.force.z();  // smooth sides: what walls carry is the bottom's, less a lid's push
    b.area = settings_.packing ? settings_.packing->container.cross_section() : 0.0;
  }
  for (const Ring& ring : servo.rings())
    if (!ring.is_side()) b.force += ring.pressure * ring.area, b.area += ring.area;
  if (model_->pile) b.tip = servo.tip_pressure() * model_->pile->tip_area();
  return b;
}

// The step of the next cycles of Balance. It never grows: a packing that has come loose for a moment gets its contacts
// back sooner than the limit is looked at again.
double GrainsRun::renew_step() {
  balance_limit_ = std::min(balance_limit_, stable_step(*model_, settings_.balance.damping).step);
  return std::min(1.0, settings_.step_fraction) * balance_limit_;
}

// The cut leaves grains pressed into walls and pile: they are let go without gravity and friction, at limited speed.
void GrainsRun::relax() {
  Model& m = *model_;
  Held held;
  m.damping = settings_.balance.damping;
  m.gravity.setZero();
  set_friction(0, 0);
  double largest = 1;
  const auto begin = Clock::now();
  evaluate_forces(m);
  for (int n = 0; n < relax_cycles && largest > relaxed_overlap; ++n) {
    if (n % limit_interval == 0) held.time_step = renew_step();
    if (!cycle(m, held)) break;
    for (std::size_t b = 0; b < m.particles.body_count(); ++b) {
      if (const double speed = m.particles.velocity(b).norm(); speed > relax_speed)
        m.particles.velocity(b) *= relax_speed / speed;
      if (const double speed = m.particles.spin(b).norm() * m.particles.equivalent_radius(b); speed > relax_speed)
        m.particles.spin(b) *= relax_speed / speed;
    }
    largest = std::max({m.pair_totals.largest_overlap_ratio, m.facet_totals.max_overlap,
                        m.pile_totals.all().max_overlap, m.wall_totals.max_overlap});
    if (n % heartbeat_interval == 0) beat("relaxing the cut packing", 0.2 + 0.1 * n / relax_cycles);
  }
  m.gravity = {0, 0, -settings_.gravity};
  spdlog::info("relaxed: largest overlap {:.3f} R after {} cycles, {:.1f} s", largest, m.step, seconds_since(begin));
}

// The cut leaves gaps along walls and pile as well, and a packing that is not jammed collapses for ever under gravity.
// So the grains are grown, with the friction that the cube was packed with and under a lid, until the whole packing
// presses on the facets again, and let down.
void GrainsRun::grow() {
  Model& m = *model_;
  Held held;
  m.damping = settings_.balance.damping;
  m.gravity.setZero();
  set_friction(assembly_.preparation_friction, 0);
  std::vector<WallSettings> with_lid = settings_.all_walls();
  with_lid.push_back(
      plane_wall({{0, 0, settings_.packing->container.top + assembly_.mean_radius}, -Vec3::UnitZ(), Vec3::Zero()}));
  m.walls = Walls(with_lid, settings_.wall_friction);
  m.walls.set_moving(false, false);
  m.walls.set_friction_share(0);
  double area = settings_.is_alone ? settings_.packing->container.surface() : 0.0;
  for (std::size_t f = 0; f < m.facets.facet_count(); ++f) area += m.facets.area_vector(f).norm();
  double growth = 1, pressure = 0, reached = 0;
  bool is_growing = true;
  const std::uint64_t begin = m.step;
  const auto begin_time = Clock::now();
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
      beat("growing the packing into its gaps", 0.3 + 0.1 * std::min(1.0, pressure / grown_pressure));
  }
  refit(assembly_, settings_, initial_.bulk_density, m.particles);
  m.walls = Walls(settings_.all_walls(), settings_.wall_friction);
  m.walls.set_moving(false, false);
  m.gravity = {0, 0, -settings_.gravity};
  spdlog::info(
      "grown by {:.2f} % to {:.1f} kPa and let down to {:.1f} kPa in {} cycles: mean radius {:.4g} m, overall porosity "
      "{:.3f}, solid density {:.0f} kg/m3, {:.1f} s",
      100 * (growth - 1), reached / 1000, pressure / 1000, m.step - begin, assembly_.mean_radius,
      assembly_.overall_porosity, assembly_.solid_density, seconds_since(begin_time));
}

// Gravity with friction between the grains but smooth walls (with rough ones the sides would carry the weight, as in a
// silo), first with everything held, then with the servo.
void GrainsRun::settle(Servo& servo) {
  Model& m = *model_;
  const BalanceSettings& b = settings_.balance;
  m.damping = b.damping;
  set_friction(b.friction, 0);
  m.contacts.clear_history();
  servo.is_active = false;
  m.walls.set_moving(false, true);
  const auto begin = Clock::now();
  double ratio = 1;
  std::uint32_t n = 0;
  bool is_balanced = false;
  for (; n < b.max_cycles && !is_balanced; ++n) {
    if (n % limit_interval == 0) servo.time_step = renew_step();
    m.detail = n % heartbeat_interval == 0 ? Detail::All : Detail::Forces;  // sums are looked at once in a while
    cycle(m, servo);
    if (n % heartbeat_interval != 0) continue;
    ratio = unbalanced_ratio(m);
    if (!servo.is_active && b.servo && n > settle_cycles && ratio < servo_start_ratio) {
      servo.is_active = true;
      spdlog::info("servo on after {} cycles, unbalanced ratio {:.1e}", n, ratio);
    }
    const bool has_servo_done = !b.servo || (servo.is_active && servo.fastest() < b.servo_tolerance &&
                                             servo.worst_movable_mismatch(b.traction_tolerance) < 1 &&
                                             bottom_balance(servo).mismatch(b.traction_tolerance) < 1);
    is_balanced = n > settle_cycles && ratio < b.tolerance && has_servo_done &&
                  m.walls.worst_servo_error() < b.traction_tolerance;
    const double fraction = std::clamp(std::log10(std::max(ratio, b.tolerance)) / std::log10(b.tolerance), 0.0, 1.0);
    beat(fmt::format("balancing, unbalanced ratio {:.1e}", ratio), 0.3 + 0.7 * fraction);
    stage_fraction_ = 0.3 + 0.7 * fraction;
    show_progress(ratio);
    watch();
    if (n % 2000 == 0)
      spdlog::debug(
          "balancing: cycle {}, unbalanced ratio {:.1e}, ring mismatch {:.2f}, servo speed {:.1e} m/s, tip {:.2f} kPa, "
          "bottom contacts {}, list builds {}",
          n, ratio, servo.worst_mismatch(b.traction_tolerance), servo.fastest(), servo.tip_pressure() / 1000,
          m.facet_totals.contacts, m.contacts.rebuilds());
  }
  if (!is_balanced && ratio > hopeless_ratio)
    throw NumericalError(fmt::format(
        "Balance gave up after balance.max_cycles = {} with an unbalanced ratio of {:.2g} (wanted {:.1e}): the "
        "packing still falls; give more cycles",
        b.max_cycles, ratio, b.tolerance));
  if (!is_balanced)
    spdlog::warn(
        "Balance gave up after balance.max_cycles = {}: unbalanced ratio {:.1e} (wanted {:.1e}), servo {:.1e} m/s "
        "(wanted "
        "{:.1e}), mismatch {:.2f} of the tolerance; give more cycles or a looser tolerance",
        b.max_cycles, ratio, b.tolerance, servo.fastest(), b.servo_tolerance,
        servo.worst_mismatch(b.traction_tolerance));
  for (const Ring& ring : servo.rings())
    if (ring.is_at_end)
      spdlog::warn(
          "the ring at z {:.2f} m is at the end of its travel with {:.2f} kPa of {:.2f} kPa; balance.max_servo_travel "
          "(now "
          "{} R) would let it go on",
          ring.center_z, ring.pressure / 1000, ring.target / 1000, b.max_servo_travel);
  spdlog::info("settled in {} cycles, {:.1f} s", n, seconds_since(begin));
}

// ----------------------------------------------------------------------------------------------------- step 3

// Who sets the grains' limit, for messages.
std::string GrainsRun::culprit(const StepLimit& limit) const {
  if (limit.worst_body < 0) return "the grains (a first touch of the lightest one)";
  const Vec3 x = std::as_const(model_->particles).position(limit.worst_body);
  return fmt::format("grain {} at ({:.4g}, {:.4g}, {:.4g}) m", limit.worst_body, x.x(), x.y(), x.z());
}

// The grains' limit on the ground as the peer described it, from the contacts of the moment.
StepLimit GrainsRun::grains_limit() const {
  const double damped = 1 + settings_.step_damping;
  StepLimit limit = stable_step(*model_, settings_.step_damping);
  const double own = 4 / (limit.step * limit.step * damped);
  limit.step = 2 / std::sqrt(told_limit_.grains_on_ground(own, limit.touching_squared) * damped);
  return limit;
}

void GrainsRun::excavate() {
  stage_ = protocol::Stage::Excavate;
  const auto begin = Clock::now();
  Model& m = *model_;
  const auto theirs = session_->receive<protocol::ContinuumExcavated>();
  if (theirs.position_hash != 0 && theirs.position_hash != m.facets.position_hash())
    throw PeerError(fmt::format(
        "ContinuumExcavated.position_hash is {:016x}, but the nodes sent with InitialStress hash to {:016x}: "
        "the peer has moved its interface since",
        theirs.position_hash, m.facets.position_hash()));
  told_limit_ = CoupledLimit(theirs.stiffness, settings_.exchange_interval);
  protocol::GrainsExcavated reply;
  reply.offset = m.facets.offsets();
  // A node that nothing touches yet counts as if one grain did: a first touch must not find too long a step.
  const double first_touch = m.facet_material.normal_stiffness(m.particles.largest_radius());
  told_stiffness_ = m.facets.node_stiffness();
  for (double& k : told_stiffness_) k = std::max(k, first_touch);
  reply.node_stiffness = told_stiffness_;
  told_limit_.set_contacts(told_stiffness_);
  limit_ = grains_limit();
  reply.stable_step = settings_.exchange_interval * limit_.step;
  reply.limited_by = culprit(limit_);
  told_limit_.set_grains(reply.stable_step, reply.limited_by);
  reply.nodal_force = m.facets.nodal_force();
  reply.position_hash = m.facets.position_hash();
  session_->send(reply);
  spdlog::info(
      "stage Excavate (paper step 3): peer deleted {} zones, residual {:.1e}; stable steps {:.3e} s (grains, body {}) "
      "and "
      "{:.3e} s (zones)",
      theirs.zones_deleted, theirs.residual_ratio, limit_.step, limit_.worst_body, theirs.stable_step);
  stage_done("Excavate", begin, Json().add("stable_step_s", limit_.step).add("zones_deleted", theirs.zones_deleted));
}

// ---------------------------------------------------------------------------------------------- steps 4 to 7

// The peer moves the facets: paper steps 5 and 6. An exchange holds fidelity.exchange_interval steps of the grains (the first
// one: a single step), in which the facets go their way in equal parts and whose mean force is the answer, so that both
// sides see the same impulse.
class GrainsRun::Peer : public Boundary {
 public:
  explicit Peer(GrainsRun& run) : run_(run), coupled_(run.coupled_), parts_(run.settings_.exchange_interval) {}

  bool move_facets(Model& m) override {
    if (part_ == exchange_parts_) {
      {
        const auto timing = m.profile.measure(Phase::WaitForPeer);
        if (!run_.session_->receive_or_finish(velocities_)) return false;
      }
      exchange_parts_ = last_step_ > 0 ? parts_ : 1;
      part_ = 0;
    }
    ++part_;
    m.facets.advance_part(velocities_.velocity, last_step_, part_, exchange_parts_);
    m.time_step = (is_last_part() ? velocities_.time_step : last_step_) / parts_;
    if (is_last_part()) check_peer(m);
    if (velocities_.stage == protocol::Stage::Penetrate && run_.stage_ == protocol::Stage::Apply)
      run_.begin_penetration();
    run_.push_pile();
    run_.choose_detail(is_last_part() && (velocities_.step + 1) % ledger_interval == 0);
    return true;
  }

  void take_forces(Model& m) override {
    add_forces(m);
    if (!is_last_part()) return;
    if (exchange_parts_ > 1) take_mean();
    forces_.step = velocities_.step;
    forces_.unbalanced_ratio = run_.ratio_;
    forces_.stable_step = parts_ * limit_.step;
    forces_.limited_by.clear();
    if (forces_.stable_step != run_.told_limit_.grains_limit()) {
      forces_.limited_by = run_.culprit(limit_);
      run_.told_limit_.set_grains(forces_.stable_step, forces_.limited_by);
    }
    forces_.is_done = run_.is_over();
    forces_.energies = energies_;
    tell_stiffness(m);
    run_.session_->send(forces_);
  }

  // After the cycle, while the message is on its way.
  void take_stock(Model& m) {
    if (m.step % limit_interval == 0) {
      const StepLimit now = run_.grains_limit();
      if (now.step < limit_.step) limit_ = now;
    }
    if (!is_last_part()) return;
    if (coupled_) book_exchange(m);
    if (coupled_ && m.step % run_.settings_.history_interval == 0) run_.output_.record_interface(*coupled_);
    last_step_ = velocities_.time_step;
    energies_.reset();
    if (m.detail == Detail::All && run_.settings_.keeps_ledger) {
      const GrainEnergies& e = m.ledger.energies();
      energies_ = {e.kinetic,  e.elastic,       e.gravity_work,  e.damped + e.dashpots,
                   e.friction, e.boundary_work, e.interface_work};
    }
    if ((velocities_.step + 1) % good_state_interval == 0) run_.keep_good_state(velocities_.step + 1);
  }

  void start() { limit_ = run_.limit_; }

 private:
  bool is_last_part() const { return part_ == exchange_parts_; }

  void check_peer(const Model& m) const {
    if (velocities_.position_hash != 0 && velocities_.position_hash != m.facets.position_hash())
      throw PeerError(
          fmt::format("Velocities({}).position_hash is {:016x}, the grains hold {:016x}: the two sides no longer agree "
                      "where the interface is; both must do x += v * time_step in double precision",
                      velocities_.step, velocities_.position_hash, m.facets.position_hash()));
    // A scene may ask for more than the limit, knowingly.
    const double allowed = std::max(1.0, run_.settings_.step_fraction) * run_.told_limit_.limit();
    if (velocities_.time_step > allowed)
      throw NumericalError(
          fmt::format("Velocities({}).time_step is {:.4e} s, but zones and grains together are stable up to {:.4e} s "
                      "(zones {:.4e} s, "
                      "with contacts {:.4e} s, grains {:.4e} s), as both sides know since Forces({}) or "
                      "GrainsExcavated; the limit is "
                      "that of {}. The peer owns the step and must keep below",
                      velocities_.step, velocities_.time_step, run_.told_limit_.limit(), run_.told_limit_.zones_limit(),
                      run_.told_limit_.interface_limit(), run_.told_limit_.grains_limit(), velocities_.step - 1,
                      run_.told_limit_.culprit(m.facets.positions())));
  }

  // Of this step; the sum over the exchange so far where it has several.
  void add_forces(const Model& m) {
    const Vec3s& force = m.facets.nodal_force();
    if (part_ == 1) {
      forces_.force = force;
      forces_.particle_force = m.facet_totals.particle_force, forces_.particle_moment = m.facet_totals.particle_moment;
      forces_.neglected_moment = m.facet_totals.neglected_moment;
      return;
    }
    for (std::size_t j = 0; j < force.size(); ++j) forces_.force[j] += force[j];
    forces_.particle_force += m.facet_totals.particle_force, forces_.particle_moment += m.facet_totals.particle_moment;
    forces_.neglected_moment += m.facet_totals.neglected_moment;
  }

  void take_mean() {
    const double share = 1.0 / exchange_parts_;
    for (Vec3& f : forces_.force) f *= share;
    forces_.particle_force *= share, forces_.particle_moment *= share, forces_.neglected_moment *= share;
  }

  // Forces of this exchange, energies of the end of the last one.
  void book_exchange(const Model& m) {
    InterfaceSums sums;
    for (const Vec3& f : forces_.force) sums.nodes_force += f;
    sums.nodes_moment = moment_of(m.facets.positions(), forces_.force) + moment_of(m.facets.offsets(), forces_.force);
    sums.particles_force = forces_.particle_force, sums.particles_moment = forces_.particle_moment;
    coupled_->book_interface(velocities_.step, m.time,
                             0.5 * ((last_step_ > 0 ? last_step_ : velocities_.time_step) + velocities_.time_step),
                             sums);
    if (!energies_) return;
    coupled_->book_energies(*energies_, velocities_.energies);
    if (const std::string words = coupled_->alarm(); !words.empty()) throw NumericalError(words);
  }

  // Node stiffness travels when one has grown by a tenth beyond what the peer knows.
  void tell_stiffness(const Model& m) {
    const std::vector<double>& now = m.facets.node_stiffness();
    std::vector<double>& told = run_.told_stiffness_;
    bool has_grown = false;
    for (std::size_t j = 0; j < now.size(); ++j) has_grown |= now[j] > stiffness_growth * told[j];
    forces_.node_stiffness.clear();
    if (!has_grown) return;
    for (std::size_t j = 0; j < now.size(); ++j) told[j] = std::max(told[j], now[j]);
    forces_.node_stiffness = told;
    run_.told_limit_.set_contacts(told);
  }

  GrainsRun& run_;
  std::optional<CoupledLedger>& coupled_;
  const std::uint32_t parts_;         // of an exchange
  std::uint32_t exchange_parts_ = 0;  // of this one
  std::uint32_t part_ = 0;            // of this exchange, from 1
  double last_step_ = 0;              // time_step of the exchange before [s]
  protocol::Velocities velocities_;
  protocol::Forces forces_;
  std::optional<Energies> energies_;  // at the end of the last exchange
  StepLimit limit_;                   // as of the last renewal
};

void GrainsRun::begin_apply() {
  stage_ = protocol::Stage::Apply;
  stage_begin_ = Clock::now();
  Model& m = *model_;
  m.damping = settings_.has_apply ? settings_.apply_damping : settings_.run_damping;
  m.walls.set_moving(false, true);
  m.walls.end_balance();
  set_friction(settings_.material.friction, 1);
  m.time = 0;
  m.step = 0;
  m.last_time_step = 0;
  m.ledger.restart();
  m.ledger.is_kept = settings_.keeps_ledger;
  if (session_ && settings_.keeps_ledger) coupled_.emplace(settings_.stop_if_energy_error);
  if (settings_.packet)
    for (std::size_t b = 0; b < m.particles.body_count(); ++b)
      if (m.is_fixed.empty() || !m.is_fixed[b])
        m.particles.velocity(b) += packet_velocity(*settings_.packet, m.particles.position(b));
  output_.snapshot(m, settings_);
}

// S = 0.
void GrainsRun::begin_penetration() {
  Model& m = *model_;
  spdlog::info("stage Apply (paper step 4): {} steps, {:.3g} s of ground time, unbalanced ratio {:.1e}, {:.1f} s",
               m.step, m.time, unbalanced_ratio(m), seconds_since(stage_begin_));
  stage_done("Apply", stage_begin_,
             Json()
                 .add("steps", static_cast<std::int64_t>(m.step))
                 .add("unbalanced_ratio", m.step ? unbalanced_ratio(m) : 0.0));
  stage_ = protocol::Stage::Penetrate;
  stage_begin_ = Clock::now();
  m.damping = settings_.run_damping;
  m.walls.set_moving(true, true);
  if (m.pile) pile_start_ = m.pile->tip_z();
  penetration_begin_ = m.time;
  next_snapshot_ = 0;
}

// The pile's speed in the step to come.
void GrainsRun::push_pile() {
  Model& m = *model_;
  if (stage_ != protocol::Stage::Penetrate || !m.pile) return;
  const PileSettings& pile = *settings_.pile;
  const double ramp = std::min(1.0, (m.time - penetration_begin_) / pile.speed_ramp);
  m.pile->set_velocity(-pile.velocity * ramp);
}

// What the next step sums up: what its histories, alarms and `is_booked` ask for.
void GrainsRun::choose_detail(bool is_booked) {
  Model& m = *model_;
  const std::uint64_t step = m.step + 1;
  const auto is_due = [&](std::uint32_t interval) { return interval > 0 && step % interval == 0; };
  const bool is_measured = is_booked || step == 1 || is_due(heartbeat_interval) || is_due(settings_.history_interval) ||
                           (settings_.measure.is_any() && is_due(settings_.measure.interval));
  m.detail = is_measured ? Detail::All : settings_.keeps_ledger ? Detail::Works : Detail::Forces;
}

// After each step: alarms, histories, snapshots.
void GrainsRun::record_step() {
  const Model& m = *model_;
  if (m.detail == Detail::All) {
    ratio_ = unbalanced_ratio(m);
    contacts_ = static_cast<std::uint64_t>(m.pair_totals.active) + m.facet_totals.contacts;
  }
  if (watches_shivering_ && m.damping > 0) watch_reversal();
  output_.record(m, s_over_d(), ratio_);
  if (m.step % heartbeat_interval == 0) {
    watch();
    show_progress(ratio_);
  }
  if (settings_.is_alone && m.step % good_state_interval == 0) keep_good_state(m.step);
  if (stage_ != protocol::Stage::Penetrate || settings_.snapshot_interval <= 0) return;
  const double now = settings_.pile ? s_over_d() : m.time - penetration_begin_;
  if (now >= next_snapshot_) {
    output_.snapshot(m, settings_);
    next_snapshot_ += settings_.snapshot_interval;
  }
}

void GrainsRun::exchange() {
  begin_apply();
  if (settings_.pile) pile_start_ = model_->pile->tip_z();
  Model& m = *model_;
  Peer peer(*this);
  peer.start();
  while (cycle(m, peer)) {
    record_step();
    peer.take_stock(m);
  }
}

// ---------------------------------------------------------------------------------------------- grains alone

// Nobody moves facets, since there are none: the grains hold their own step.
class GrainsRun::NoPeer : public Boundary {
 public:
  explicit NoPeer(GrainsRun& run) : run_(run) {}

  bool move_facets(Model& m) override {
    const Settings& settings = run_.settings_;
    const bool is_timed_out = !settings.pile && m.time - run_.penetration_begin_ >= settings.run_duration;
    if (run_.is_over() || is_timed_out) return false;
    if (m.step % limit_interval == 0) renew_step(m);
    m.time_step = time_step_;
    run_.push_pile();
    run_.choose_detail(false);
    return true;
  }
  void take_forces(Model&) override {}

 private:
  // As in a coupled run the step is cut when contacts ask for it, and never grows.
  void renew_step(const Model& m) {
    const StepLimit limit = stable_step(m, run_.settings_.step_damping);
    const double step = run_.settings_.step_fraction * limit.step;
    if (step >= time_step_) return;
    if (step < told_ / stiffness_growth) {
      spdlog::info("step {}: time step {:.4e} s, {} of the limit of grain {}", m.step, step,
                   run_.settings_.step_fraction, limit.worst_body);
      told_ = step;
    }
    time_step_ = step;
  }

  GrainsRun& run_;
  double time_step_ = std::numeric_limits<double>::infinity();  // of the next steps [s]
  double told_ = std::numeric_limits<double>::infinity();       // as last logged [s]
};

// Balance and Penetrate in one process. What stage Apply is to a coupled run is a moment here: friction of walls and pile
// is switched on, and time and S are counted from there.
RunReport GrainsRun::run_alone() {
  balance();
  begin_apply();
  begin_penetration();
  NoPeer no_peer(*this);
  while (cycle(*model_, no_peer)) record_step();
  end_ = interrupt_requested() ? "the user interrupted the run"
         : settings_.pile      ? "the pile is there"
                               : "run.duration is over";
  return finish();
}

// A sign of life to the peer while the packing is made; alone, only the user's Ctrl-C is looked for.
void GrainsRun::beat(std::string_view text, double fraction) {
  if (session_)
    session_->heartbeat(text, fraction);
  else if (interrupt_requested())
    throw Interrupted("interrupted in stage Balance");
}

// Vertical pressure at z in grains alone at rest between smooth walls: their weight above, and lids that press [Pa].
double GrainsRun::weight_above(double z) const {
  if (!settings_.packing) return 0;
  const double bulk_density = assembly_.solid_density * (1 - assembly_.overall_porosity);  // [kg/m3]
  double pressure = bulk_density * settings_.gravity * (settings_.packing->container.top - z);
  for (const WallSettings& wall : settings_.walls)
    if (const auto* plane = std::get_if<PlaneShape>(&wall.shape); plane && wall.servo && plane->normal.z() < 0)
      pressure += wall.servo->pressure;
  return pressure;
}

// Of stage Balance: what the ground carried at the tip's depth, or alone the grains [Pa].
double GrainsRun::tip_target() const {
  if (!settings_.pile) return 0;
  const double z = -settings_.pile->embedment;
  return settings_.is_alone ? weight_above(z) : target_vertical_pressure(z);
}

bool GrainsRun::is_over() const {
  return interrupt_requested() ||
         (settings_.pile && stage_ == protocol::Stage::Penetrate && penetration() >= settings_.pile->penetration);
}

RunReport GrainsRun::finish() {
  Model& m = *model_;
  report_.is_interrupted = interrupt_requested();
  if (session_) {
    end_ = session_->finish().text;
    report_.is_interrupted |= session_->finish().is_interrupted;
    session_->send(protocol::Message(protocol::Finish{
        m.step, interrupt_requested() ? "the user of the grains interrupted the run" : "done", interrupt_requested()}));
  }
  if (stage_ == protocol::Stage::Penetrate)
    spdlog::info(
        "stage Velocities, Forces, Advance (paper steps 5 to 7): {} steps, S/D {:.3f}, tip {:.3g} MPa, shaft {:.3g} "
        "kN, "
        "{:.1f} s",
        m.step, s_over_d(), output_.tip_resistance() / 1e6, output_.shaft_force() / 1e3, seconds_since(stage_begin_));
  stage_done("Penetrate", stage_begin_,
             Json().add("steps", static_cast<std::int64_t>(m.step)).add("s_over_d", s_over_d()));
  output_.snapshot(m, settings_);
  output_.summary(summary());
  spdlog::info("finished: {}", end_);

  RunReport& r = report_;
  r.steps = m.step;
  r.time = m.time;
  r.state_hash = m.hash();
  r.position_hash = m.facets.position_hash();
  r.grains = m.particles.body_count();
  r.s_over_d = s_over_d();
  r.tip_resistance = output_.tip_resistance();
  r.shaft_force = output_.shaft_force();
  for (const Vec3& f : m.facets.nodal_force()) r.interface_force += f;
  r.energy_residual = m.ledger.residual_fraction();
  r.worst_vertical_imbalance = m.ledger.worst_vertical_imbalance();
  r.worst_action_reaction = m.ledger.worst_action_reaction();
  r.coupled = coupled_;
  r.unbalanced_ratio = ratio_;
  r.contacts = contacts_;
  r.kinetic_energy = m.ledger.energies().kinetic;
  r.start_energies = m.ledger.start();
  r.energies = m.ledger.energies();
  for (std::size_t b = 0; b < m.particles.body_count(); ++b)
    r.momentum += m.particles.mass(b) * m.particles.velocity(b);
  r.mass = m.particles.total_mass();
  for (std::size_t k = 0; k < settings_.walls.size(); ++k)
    r.walls.push_back({m.walls.totals()[k].force, m.walls.has_servo(k) ? m.walls.pressure(k) : 0.0});
  r.end = end_;
  return r;
}

// ------------------------------------------------------------------------------------------------------ watching

void GrainsRun::watch_reversal() {
  const Model& m = *model_;
  reversal_.observe(m.step, m.particles);
  if (reversal_.is_alarming() && ratio_ > Reversal::least_unbalanced_ratio)
    throw NumericalError(fmt::format(
        "step {}: the grains' accelerations turn from each step to the next (share {:.2f} over {} looks, where motion "
        "that "
        "the steps follow has -0.6 and below; unbalanced ratio {:.1e}): the packing shivers instead of resting; lower "
        "fidelity.step_fraction (now {})",
        m.step, reversal_.mean_share(), Reversal::reversal_looks, ratio_, settings_.step_fraction));
}

// What a run that has gone wrong shows, looked at every few cycles: the peer hears it by Abort.
void GrainsRun::watch() {
  const Model& m = *model_;
  if (!std::isfinite(m.motion.kinetic_energy())) {
    throw NumericalError(
        fmt::format("step {}: the grains' kinetic energy is not finite; the run went unstable: lower "
                    "fidelity.step_fraction (now {})",
                    m.step, settings_.step_fraction));
  }
  for (std::size_t b = 0; b < m.particles.body_count(); ++b)
    if (!(m.particles.position(b).norm() < farthest * reach_))
      throw NumericalError(
          fmt::format("step {}: grain {} has left the scene (now at {:.3g} {:.3g} {:.3g} m): it went through a wall or "
                      "nothing holds it; close the scene with walls, or lower fidelity.step_fraction (now {})",
                      m.step, b, m.particles.position(b).x(), m.particles.position(b).y(), m.particles.position(b).z(),
                      settings_.step_fraction));
  const double overlap = std::max(m.pair_totals.largest_overlap_ratio, m.facet_totals.max_overlap);
  if (stage_ != protocol::Stage::Balance && overlap > alarming_overlap)
    throw NumericalError(
        fmt::format("step {}: an overlap of {:.2f} R is no contact any more; stiffen grains.contact_modulus (now "
                    "{:.3g} Pa), slow fidelity.pile_velocity down or lower fidelity.step_fraction (now {})",
                    m.step, overlap, settings_.material.contact_modulus, settings_.step_fraction));
  if (m.facets.tunnelled() > 0)
    spdlog::warn("step {}: {} pebbles have sunk more than half their radius through the interface", m.step,
                 m.facets.tunnelled());
}

void GrainsRun::show_progress(double unbalanced) {
  if (!prints_progress_ || seconds_since(last_progress_) < 0.5) return;
  last_progress_ = Clock::now();
  const Model& m = *model_;
  static constexpr const char* names[] = {"Hello", "InitialStress", "Balance",  "Excavate",
                                          "Apply", "Penetrate",     "Finished", "Aborted"};
  const double waiting = m.profile.seconds(Phase::WaitForPeer);
  const double total = m.profile.total();
  std::string line =
      fmt::format("side=grains stage={} step={} time={:.6g} unbalanced={:.3e} wait={:.3f}",
                  names[static_cast<int>(stage_)], m.step, m.time, unbalanced, total > 0 ? waiting / total : 0.0);
  if (settings_.pile && stage_ == protocol::Stage::Penetrate)
    line += fmt::format(" fraction={:.4f} sd={:.4f} tip_kpa={:.1f}", penetration() / settings_.pile->penetration,
                        s_over_d(), output_.tip_resistance() / 1000);
  else if (stage_ == protocol::Stage::Balance)
    line += fmt::format(" fraction={:.4f}", stage_fraction_);
  else if (settings_.is_alone && settings_.run_duration > 0)
    line += fmt::format(" fraction={:.4f}", (m.time - penetration_begin_) / settings_.run_duration);
  print_progress(line);
}

void GrainsRun::show_packing(double fraction) {
  if (!prints_progress_ || seconds_since(last_progress_) < 0.5) return;
  last_progress_ = Clock::now();
  print_progress(fmt::format("side=grains stage=Balance fraction={:.3f}", fraction));
}

void GrainsRun::keep_good_state(std::uint64_t exchanges) {
  watch();
  if (good_states_.size() == 2) good_states_.erase(good_states_.begin());
  good_states_.push_back({exchanges, model_->step, model_->time, state_of(*model_)});
}

// The newest state that the failure had not reached yet, if there is one.
void GrainsRun::return_to_good_state() {
  Model& m = *model_;
  const std::uint64_t failed_at = m.step;
  const std::uint64_t age = good_state_age * settings_.exchange_interval;
  while (!good_states_.empty() && good_states_.back().step + age > failed_at) good_states_.pop_back();
  if (good_states_.empty()) return;
  const GoodState& good = good_states_.back();
  restore(m, good.state);
  m.step = good.step, m.time = good.time;
  m.detail = Detail::All;
  evaluate_forces(m);
  spdlog::error("failed at step {}; the last files show step {}, the last one known to be sound", failed_at, m.step);
}

void GrainsRun::keep_last_state(bool has_failed) noexcept {
  try {
    if (!model_) return;
    if (has_failed) return_to_good_state();
    output_.snapshot(*model_, settings_);
    output_.summary(summary());
  } catch (const std::exception& error) {
    spdlog::error("the last state could not be written: {}", error.what());
  }
}

void GrainsRun::stage_done(const std::string& name, Clock::time_point begin, Json entry) {
  entry.add("seconds", seconds_since(begin));
  stages_.add(name, entry);
}

Json GrainsRun::summary() {
  const Model& m = *model_;
  Json j;
  j.add("program", "dem_server")
      .add("version", lockstep_version())
      .add("scene_digest", scene_.digest)
      .add("title", settings_.title)
      .add("end", end_)
      .add("interrupted", report_.is_interrupted);
  j.add("seconds", seconds_since(begin_)).add("stages", stages_);
  j.add("grains", static_cast<std::int64_t>(m.particles.body_count()))
      .add("pebbles", static_cast<std::int64_t>(m.particles.pebble_count()))
      .add("mean_radius_m", assembly_.mean_radius)
      .add("solid_density_kg_m3", assembly_.solid_density)
      .add("seed", static_cast<std::int64_t>(settings_.seed));
  j.add("steps", static_cast<std::int64_t>(m.step)).add("time_s", m.time).add("time_step_s", m.last_time_step);
  if (m.pile)
    j.add("pile_diameter", 2 * settings_.pile->shape.radius)
        .add("pile_tip_z", m.pile->tip_z())
        .add("pile_tip_z_start", pile_start_)
        .add("s_over_d", s_over_d())
        .add("tip_resistance_pa", output_.tip_resistance())
        .add("shaft_force_n", output_.shaft_force());
  Json walls;
  for (std::size_t k = 0; k < settings_.walls.size(); ++k) {
    const WallTotals& totals = m.walls.totals()[k];
    Json wall;
    wall.add("force_n", std::vector<double>{totals.force.x(), totals.force.y(), totals.force.z()})
        .add("contacts", static_cast<std::int64_t>(totals.contacts));
    if (m.walls.has_servo(k))
      wall.add("pressure_pa", m.walls.pressure(k)).add("servo_way_m", m.walls.state(k).servo_way);
    walls.add(m.walls.name(k), wall);
  }
  if (!settings_.walls.empty()) j.add("walls", walls);
  const GrainEnergies& e = m.ledger.energies();
  j.add("energies_j", Json()
                          .add("kinetic", e.kinetic)
                          .add("elastic", e.elastic)
                          .add("gravity_work", e.gravity_work)
                          .add("boundary_work", e.boundary_work)
                          .add("interface_work", e.interface_work)
                          .add("damped", e.damped)
                          .add("friction", e.friction)
                          .add("dashpots", e.dashpots));
  Json guarantees;
  if (m.ledger.is_kept)
    guarantees.add("energy_residual_over_work", m.ledger.residual_fraction())
        .add("worst_vertical_imbalance_over_largest_force", m.ledger.worst_vertical_imbalance())
        .add("worst_action_minus_reaction", m.ledger.worst_action_reaction());
  j.add("guarantees", guarantees.add("tunnelled_pebbles", static_cast<std::int64_t>(m.facets.tunnelled())));
  if (coupled_) j.add("coupled", coupled_->summary());
  j.add("seconds_by_phase", Json()
                                .add("wait for peer", m.profile.seconds(Phase::WaitForPeer))
                                .add("interface contacts", m.profile.seconds(Phase::InterfaceContacts))
                                .add("contact lists", m.profile.seconds(Phase::Lists))
                                .add("grain contacts", m.profile.seconds(Phase::PairContacts))
                                .add("pile and walls", m.profile.seconds(Phase::WallContacts))
                                .add("motion", m.profile.seconds(Phase::Motion))
                                .add("ledger", m.profile.seconds(Phase::Ledger))
                                .add("measurements", output_.measuring_seconds()));
  j.add("list_builds", m.contacts.rebuilds()).add("list_refreshes", m.contacts.refreshes());
  if (session_) j.add("bytes_sent", session_->bytes_sent()).add("bytes_received", session_->bytes_received());
  j.add("state_hash", fmt::format("{:016x}", m.hash()));
  j.add("position_hash", fmt::format("{:016x}", m.facets.position_hash()));
  return j;
}

}  // namespace

void check_company(const Settings& settings, bool has_peer, const SceneFile& scene) {
  if (settings.is_alone && has_peer)
    throw InputError(fmt::format("{}: the scene has no continuum, so there is no peer to wait for; leave --listen out",
                                 scene.path.string()));
  if (!settings.is_alone && !has_peer)
    throw InputError(
        fmt::format("{}: the scene has a continuum; say with --listen HOST:PORT where the grains wait for its program "
                    "(127.0.0.1:0 takes a free port), or start both with tools/run",
                    scene.path.string()));
}

RunReport run_grains(const SceneFile& scene, std::unique_ptr<protocol::Channel> channel, const RunOptions& options) {
  return GrainsRun(scene, std::move(channel), options).run();
}

}  // namespace lockstep::dem
