#include "continuum_client/stages.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <span>
#include <utility>

#include "common/checks.hpp"
#include "common/good_states.hpp"
#include "common/hash.hpp"
#include "common/interrupt.hpp"
#include "common/log.hpp"
#include "common/packet.hpp"
#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/constants.hpp"
#include "continuum_client/grid_builder.hpp"
#include "continuum_client/settings.hpp"
#include "continuum_client/timestep.hpp"

namespace lockstep::continuum {
namespace {

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

Vec3 sum_of(std::span<const Vec3> values) {
  Vec3 sum = Vec3::Zero();
  for (const Vec3& v : values) sum += v;
  return sum;
}

class Stages {
 public:
  Stages(const SceneFile& scene, const std::filesystem::path& folder, std::unique_ptr<protocol::Channel> channel,
         const RunOptions& options)
      : scene_(scene),
        settings_(read_settings(scene)),
        options_(options),
        team_(options.threads),
        files_(folder, settings_) {
    if (settings_.has_grains && !channel)
      throw InputError("the scene has grains, so the continuum needs a peer that has them");
    if (!settings_.has_grains && channel)
      throw InputError(fmt::format(
          "{}: the scene has no grains, so there is no peer to connect to; leave --connect out", scene.path.string()));
    ground_.team = &team_;
    if (!channel) return;
    protocol::SessionSettings session;
    session.peer_timeout =
        std::chrono::milliseconds(static_cast<std::int64_t>(std::ceil(1000 * settings_.peer_timeout)));
    session.record_path = options.record_path;
    peer_ = std::make_unique<protocol::Session>(std::move(channel), protocol::Role::Continuum, session);
    peer_->on_progress = [this](const protocol::Progress& p) {
      spdlog::debug("peer: {} ({:.0f} %)", p.text, 100 * p.fraction);
      progress(report_.stages.empty() ? "Hello" : report_.stages.back().name.c_str(), p.fraction);
    };
  }

  RunReport run() {
    const Clock::time_point begin = Clock::now();
    try {
      if (peer_)
        couple();
      else
        stand_alone();
    } catch (const Error& e) {
      give_up(e.code(), e.what());
      throw;
    } catch (const std::exception& e) {
      give_up(ExitCode::Internal, e.what());
      throw;
    }
    conclude();
    report_.seconds = seconds_since(begin);
    files_.write_summary(report_, settings_.title);
    return report_;
  }

 private:
  void give_up(ExitCode code, const std::string& why) {
    if (peer_) peer_->abort(static_cast<int>(code), why);
    keep_last_state(why, code == ExitCode::Numerical);
  }

  void couple() {
    hello();
    initial_stress();
    send_initial_stress();
    wait_for_balance();
    excavate();
    take_snapshot();
    if (settings_.apply_max_steps > 0) apply();
    if (!is_over()) penetrate();
    finish();
  }

  // The ground alone: it is in equilibrium and stays there, which is what there is to see.
  void stand_alone() {
    initial_stress();
    take_reference_state();
    StepGuard& guard = ground_.guard;
    guard.fraction = settings_.step_fraction;
    guard.limits = CoupledLimit(ground_stiffness(settings_.run_damping));
    stiffness_ = {};
    start_clock(guard.wanted());
    ground_.damping = settings_.run_damping;
    ground_.incoming.force.assign(ground_.interface.node_count(), Vec3::Zero());
    ground_.baseline.force = ground_.baseline.offset = ground_.incoming.force;
    take_snapshot();
    begin_stage("Penetrate");
    next_snapshot_ = settings_.snapshot_interval;
    double still = 0;  // from when on the loads do not change [s]
    for (const SurfaceLoad& load : settings_.loads)
      still = std::max(still, load.duration > 0 ? 2 * load.ramp + load.duration : load.ramp);
    bool is_at_rest = false;
    while (ground_.time < settings_.duration && !is_at_rest && !stop_requested()) {
      ground_.compute_internal_forces();
      ground_.load_surface();
      ground_.advance();
      is_at_rest = ground_.time >= still && ground_.sums.unbalanced_ratio() < settings_.run_tolerance;
      ground_.guard_step();
      after_step("Penetrate", ground_.time / settings_.duration);
      snapshot_if_due(ground_.time);
    }
    if (settings_.run_tolerance > 0 && !is_at_rest && !report_.is_interrupted)
      spdlog::warn("the run ends at run.duration {} s with an unbalanced ratio of {:.2e}, above run.tolerance {:.2e}",
                   settings_.duration, ground_.sums.unbalanced_ratio(), settings_.run_tolerance);
    end_stage(fmt::format("{} steps, {:.4g} s, unbalanced ratio {:.2e}", ground_.step, ground_.time,
                          ground_.sums.unbalanced_ratio()));
  }

  void hello() {
    begin_stage("Hello");
    protocol::Hello mine;
    mine.role = protocol::Role::Continuum;
    mine.solver = "lockstep continuum_client";
    mine.solver_version = lockstep_version();
    mine.capabilities = {"progress"};
    mine.scene_digest = scene_.digest;
    const protocol::Hello theirs = peer_->shake_hands(mine);
    end_stage(fmt::format("peer {} {} at {}", theirs.solver, theirs.solver_version, peer_->peer()));
  }

  // Paper step 1: the whole model under gravity, the discrete domain still full of zones.
  void initial_stress() {
    begin_stage("InitialStress");
    ground_.grid = build_grid(settings_);
    const Grid& grid = ground_.grid;
    ground_.interface = interface_surface(grid);
    is_left_ = peer_ ? zones_outside_discrete_domain(grid) : std::vector<char>(grid.zone_count(), 1);
    files_.find_places(grid, is_left_);
    report_.zones = grid.zone_count(), report_.nodes = grid.node_count();
    report_.interface_nodes = ground_.interface.node_count(), report_.facets = ground_.interface.facet_count();
    beat("assembling the ground", 0);
    stiffness_ = assemble_stiffness(grid);
    mass_ = lumped_masses(grid);
    is_free_ = free_components(grid, settings_.initial_supports, mass_, settings_.is_free_direction);
    ground_.gravity = Vec3(0, 0, -settings_.gravity);
    beat("looking for equilibrium", 0);
    if (settings_.k0) initial_.stress = stress_by_depth(grid, settings_.layers, *settings_.k0, settings_.gravity);
    report_.equilibrium = reach_equilibrium(
        stiffness_, mass_, is_free_, ground_.gravity, settings_.equilibrium, initial_.displacement,
        [this](const std::string& text, double fraction) { beat(text, fraction); },
        initial_.stress.empty() ? Vec3s() : prescribed_force(grid, initial_));
    check_initial_yield(grid, is_left_, initial_, scene_.where("continuum.mohr_coulomb"));
    describe_initial_stress();
    end_stage(fmt::format(
        "ratio {:.2e} after {} solver iterations and {} cycles (drift {:.1e}), sigma_v at bottom {:.4g} kPa, K0 "
        "{:.4f}, "
        "{} zones, {} nodes",
        report_.equilibrium.unbalanced_ratio, report_.equilibrium.solve.iterations, report_.equilibrium.cycles,
        report_.equilibrium.drift, report_.bottom_vertical_stress / 1e3, report_.k0, report_.zones, report_.nodes));
  }

  void send_initial_stress() {
    const Grid& grid = ground_.grid;
    const InterfaceSurface& surface = ground_.interface;
    reaction_ = discrete_domain_reaction(grid, surface, settings_.gravity, initial_);
    protocol::InitialStress message;
    message.nodes = surface.position;
    message.facets = surface.facet;
    message.ring = surface.ring;
    message.stress = facet_stress(grid, surface, initial_);
    const bool deletes_zones =
        std::find(grid.in_discrete_domain.begin(), grid.in_discrete_domain.end(), 1) != grid.in_discrete_domain.end();
    traction_ =
        deletes_zones ? facet_traction(surface, message.stress, reaction_) : Vec3s(surface.facet_count(), Vec3::Zero());
    message.traction = traction_;
    for (const LevelStress& l : discrete_domain_profile(grid, initial_))
      message.profile.push_back({l.z, l.vertical, l.horizontal});
    message.gravity = ground_.gravity;
    message.bulk_density = replaced_density(grid);
    message.unbalanced_ratio = report_.equilibrium.unbalanced_ratio;
    peer_->send(protocol::Message(std::move(message)));
  }

  // Paper step 2 is the grains'.
  void wait_for_balance() {
    begin_stage("Balance");
    const protocol::Balance b = peer_->receive<protocol::Balance>();
    end_stage(fmt::format("{} particles, {} contacts, porosity {:.4f}, unbalanced ratio {:.2e}", b.particles,
                          b.contacts, b.porosity, b.unbalanced_ratio));
  }

  // Paper step 3: the zones go, their reaction stays as the baseline; both sides agree on the step.
  void excavate() {
    begin_stage("Excavate");
    const Grid& grid = ground_.grid;
    report_.zones_deleted = static_cast<std::uint64_t>(std::count(is_left_.begin(), is_left_.end(), 0));
    if (report_.zones_deleted > 0) {
      stiffness_ = assemble_stiffness(grid, is_left_);
      mass_ = lumped_masses(grid, is_left_);
    }
    take_reference_state();
    report_.excavation_residual = largest_unbalanced();

    protocol::ContinuumExcavated mine;
    mine.stiffness = ground_stiffness(settings_.largest_damping());
    stiffness_ = {};
    StepGuard& guard = ground_.guard;
    guard.fraction = settings_.step_fraction, guard.is_strict = settings_.is_step_strict;
    guard.limits = CoupledLimit(mine.stiffness, settings_.exchange_interval);
    mine.zones_deleted = report_.zones_deleted;
    mine.residual_ratio = report_.excavation_residual;
    mine.stable_step = std::isfinite(guard.limits.zones_limit()) ? guard.limits.zones_limit() : 0.0;
    mine.position_hash = ground_.interface.position_hash();
    peer_->send(protocol::Message(mine));
    const auto theirs = peer_->receive<protocol::GrainsExcavated>();
    if (theirs.position_hash != mine.position_hash)
      throw PeerError(
          fmt::format("GrainsExcavated.position_hash: the grains hold other interface positions than the ground (mine "
                      "{:016x}, theirs "
                      "{:016x}): both sides must keep the doubles of InitialStress.nodes",
                      mine.position_hash, theirs.position_hash));
    guard.limits.set_contacts(theirs.node_stiffness);
    guard.limits.set_grains(guard.told_limit = theirs.stable_step, theirs.limited_by);
    ground_.contact_offset = theirs.offset;
    if (!std::isfinite(guard.limits.limit()))
      throw InputError(
          "neither the zones nor the grains limit the time step: everything is held; free some nodes or add grains");
    start_clock(guard.wanted());
    start_baseline(theirs.nodal_force);
    end_stage(
        fmt::format("{} zones deleted, {} left, residual {:.1e} of the baseline; time step {:.4g} s = {:.2f} of the "
                    "limit of the {} "
                    "(zones {:.4g} s, with contacts {:.4g} s, grains {:.4g} s); f_D(0) differs from f_A by {:.2f} %",
                    report_.zones_deleted, report_.zones - report_.zones_deleted, report_.excavation_residual,
                    report_.first_time_step, guard.fraction, guard.limits.limited_by(), guard.limits.zones_limit(),
                    guard.limits.interface_limit(), guard.limits.grains_limit(), 100 * report_.jump.force_difference));
  }

  // Paper step 4: the contacts act at once at full stiffness; what they lack of the deleted zones' reaction fades out.
  void apply() {
    begin_stage("Apply");
    ground_.stage = protocol::Stage::Apply;
    ground_.damping = settings_.apply_damping;
    const double duration = settings_.ramp_transits * ground_.grid.depth() / fastest_wave(ground_.grid);
    if (duration / ground_.step_sizes.out_of > settings_.apply_max_steps && !settings_.holds_baseline)
      spdlog::warn(
          "apply.ramp_transits takes {:.0f} steps, more than apply.max_steps {}: the rest of the baseline will drop at "
          "once",
          duration / ground_.step_sizes.out_of, settings_.apply_max_steps);
    double ramp = settings_.holds_baseline ? 1.0 : 0.0;  // of the duration
    bool is_done = false;
    while (!is_done && ground_.step < settings_.apply_max_steps && !is_over()) {
      ground_.baseline.share = settings_.holds_baseline ? 1.0 : 1 - smoothstep(ramp);
      const bool ramp_is_over = ramp >= 1;
      ramp += ground_.step_sizes.out_of / duration;
      cycle(ground_, *peer_);
      is_done = ramp_is_over && ground_.sums.unbalanced_ratio() < settings_.apply_tolerance &&
                ground_.incoming.unbalanced_ratio < settings_.apply_tolerance;
      after_step("Apply", std::min(ramp, 1.0));
    }
    if (!settings_.holds_baseline) ground_.baseline.share = 0;
    report_.jump.apply_steps = ground_.step;
    report_.jump.apply_ratio_zones = ground_.sums.unbalanced_ratio();
    report_.jump.apply_ratio_grains = ground_.incoming.unbalanced_ratio;
    report_.jump.apply_converged = is_done;
    measure_jump();
    if (!is_done && !is_over())
      spdlog::warn(
          "Apply ends at apply.max_steps {} with unbalanced ratios {:.2e} (zones) and {:.2e} (grains), above "
          "apply.tolerance {:.2e}; "
          "what follows starts from there",
          settings_.apply_max_steps, report_.jump.apply_ratio_zones, report_.jump.apply_ratio_grains,
          settings_.apply_tolerance);
    end_stage(fmt::format(
        "{} steps, ratios {:.2e} (zones) and {:.2e} (grains); the interface moved {:.3g} mm at most = {:.2e} facets, "
        "stresses changed by {:.3g} Pa at most",
        ground_.step, report_.jump.apply_ratio_zones, report_.jump.apply_ratio_grains, 1e3 * report_.jump.largest,
        report_.jump.largest_in_facets, report_.jump.stress));
  }

  // Paper steps 5 to 7, until the pile is down or the time is up.
  void penetrate() {
    begin_stage("Penetrate");
    ground_.stage = protocol::Stage::Penetrate;
    ground_.damping = settings_.run_damping;
    const double begin = ground_.time;
    next_snapshot_ = settings_.snapshot_interval;
    while (!is_over()) {
      if (!settings_.has_pile && ground_.time - begin > settings_.duration - 0.5 * ground_.step_sizes.out_of) break;
      cycle(ground_, *peer_);
      const double time = ground_.time - begin;
      const double position = settings_.has_pile ? pile_travel(time) / settings_.pile_diameter : time;
      after_step("Penetrate", settings_.has_pile ? position / scene_.scene.pile().penetration()
                                                 : time / std::max(settings_.duration, time));
      snapshot_if_due(position);
    }
    end_stage(fmt::format("{} steps in all, {:.4g} s, time step {:.4g} s, {} cuts", ground_.step, ground_.time,
                          ground_.step_sizes.out_of, ground_.guard.cuts));
  }

  void finish() {
    begin_stage("Finish");
    protocol::Finish mine;
    mine.step = ground_.step;
    mine.is_interrupted = report_.is_interrupted;
    mine.text = report_.is_interrupted ? "the user of the continuum interrupted the run" : "done";
    peer_->send(protocol::Message(mine));
    const auto theirs = peer_->receive<protocol::Finish>();
    report_.finish_text = theirs.text;
    report_.is_interrupted |= theirs.is_interrupted;
    report_.seconds_waiting = peer_->seconds_waiting();
    report_.bytes_sent = peer_->bytes_sent(), report_.bytes_received = peer_->bytes_received();
    end_stage(fmt::format("peer says: {}", theirs.text));
  }

  // ---------------------------------------------------------------------------------------------- pieces of stages

  bool has_baseline() const { return settings_.apply_max_steps > 0 || settings_.holds_baseline; }

  // Displacements start again from zero; what gravity's displacements caused stays as f0 and as reactions of released
  // supports.
  void take_reference_state() {
    const std::size_t count = ground_.grid.node_count();
    InternalForce& force = ground_.internal_force;
    force = InternalForce(StiffnessProduct(stiffness_, ground_.grid, is_left_));
    stiffness_.multiply(initial_.displacement, force.reference);
    if (!initial_.stress.empty()) {
      const Vec3s prescribed = prescribed_force(ground_.grid, initial_, is_left_);
      for (std::size_t i = 0; i < count; ++i) force.reference[i] += prescribed[i];
    }
    const Vec3s after = free_components(ground_.grid, settings_.supports, mass_, settings_.is_free_direction);
    Vec3s weight(count);
    for (std::size_t i = 0; i < count; ++i) weight[i] = mass_[i] * ground_.gravity;
    ground_.reaction_load = released_reactions(is_free_, after, force.reference, weight);
    Vec3s dashpot = quiet_dashpots(ground_.grid, settings_.supports, is_left_);
    if (settings_.mass_damping > 0) {
      dashpot.resize(count, Vec3::Zero());
      for (std::size_t i = 0; i < count; ++i) dashpot[i] += Vec3::Constant(settings_.mass_damping * mass_[i]);
    }
    if (settings_.results.reactions) ground_.kept_reaction = ground_.reaction_load;
    std::vector<double> inertia = mass_;
    ground_.velocity_limit = fastest_wave(ground_.grid);
    if (settings_.scales_density) {
      inertia = scaled_masses(stiffness_, mass_, after);
      double lightest = 1;
      for (std::size_t i = 0; i < count; ++i)
        if (mass_[i] > 0) lightest = std::min(lightest, inertia[i] / mass_[i]);
      ground_.velocity_limit /= std::sqrt(lightest);
      // The weight is the real masses'.
      if (ground_.reaction_load.empty()) ground_.reaction_load.assign(count, Vec3::Zero());
      for (std::size_t i = 0; i < count; ++i) ground_.reaction_load[i] += weight[i];
      ground_.gravity.setZero();
    }
    ground_.integrator = Integrator(std::move(inertia), after, std::move(dashpot));
    ground_.stiffness_damping = settings_.stiffness_damping;
    if (settings_.is_incremental)
      ground_.incremental =
          std::make_unique<IncrementalForce>(ground_.grid, is_left_, initial_, settings_.has_large_strain);
    if (ground_.incremental && files_.is_active() && settings_.results.needs_strain())
      ground_.incremental->keep_strain();
    if (settings_.may_yield()) ground_.yielding = std::make_unique<YieldingZones>(ground_.grid, is_left_, initial_);
    ground_.loads = settings_.loads;
    for (const SurfaceLoad& load : settings_.loads)
      ground_.load_force.push_back(loaded_nodes(ground_.grid, load, is_left_));
    ground_.motion = {Vec3s(count, Vec3::Zero()), Vec3s(count, Vec3::Zero())};
    if (settings_.packet)
      for (std::size_t i = 0; i < count; ++i)
        ground_.motion.velocity[i] = after[i].cwiseProduct(packet_velocity(*settings_.packet, ground_.grid.node[i]));
    ground_.internal = ground_.last_internal = force.reference;
    ground_.hash_interval = settings_.hash_interval;
    gather_interface(ground_.interface, ground_.motion.velocity, ground_.outgoing.velocity);
  }

  // Worst unbalanced nodal force with the baseline in place of the deleted zones, over the largest nodal weight or
  // baseline.
  double largest_unbalanced() const {
    Vec3s force(ground_.grid.node_count());
    double scale = 0, worst = 0;
    for (std::size_t i = 0; i < force.size(); ++i) {
      const Vec3 weight = mass_[i] * ground_.gravity;
      force[i] = weight - ground_.internal[i];
      if (!ground_.reaction_load.empty()) force[i] += ground_.reaction_load[i];
      scale = std::max(scale, weight.norm());
    }
    for (std::size_t k = 0; k < reaction_.size(); ++k) {
      force[ground_.interface.node[k]] += reaction_[k];
      scale = std::max(scale, reaction_[k].norm());
    }
    for (std::size_t i = 0; i < force.size(); ++i)
      worst = std::max(worst, force[i].cwiseProduct(ground_.integrator.is_free()[i]).norm());
    return scale > 0 ? worst / scale : 0.0;
  }

  // Of the operator as it stands.
  GroundStiffness ground_stiffness(double damping) const {
    const Integrator& integrator = ground_.integrator;
    GroundStiffness ground;
    ground.frequency_squared = frequency_squared_bound(stiffness_, integrator.mass(), integrator.is_free());
    for (const std::int32_t i : ground_.interface.node)
      ground.node_mass.push_back(integrator.is_free()[i].maxCoeff() > 0 ? integrator.mass()[i] : 0.0);
    ground.damping = damping, ground.stiffness_damping = settings_.stiffness_damping;
    return ground;
  }

  void start_clock(double time_step) {
    ground_.step = 0, ground_.time = 0;
    ground_.step_sizes = {time_step, time_step};
    ground_.guard.logged_step = time_step;
    ground_.sums = {};
    ground_.integrator.start_ledger(ground_.motion);
    if (peer_ && settings_.keeps_ledger) ground_.coupled.emplace(settings_.stop_if_energy_error);
    report_.first_time_step = time_step;
  }

  void start_baseline(const Vec3s& contact_force) {
    Baseline& b = ground_.baseline;
    b.offset.resize(ground_.interface.node_count());
    b.force.assign(b.offset.size(), Vec3::Zero());
    double scale = 0;
    for (std::size_t i = 0; i < b.offset.size(); ++i) {
      b.offset[i] = reaction_[i] - contact_force[i];
      scale += reaction_[i].norm();
    }
    b.share = has_baseline() ? 1.0 : 0.0;
    if (!has_baseline()) b.offset.assign(b.offset.size(), Vec3::Zero());
    // Forces of the reference state, for what is written of it.
    ground_.fade_baseline();
    ground_.incoming.force = contact_force;
    report_.jump.force_difference = scale > 0 ? (sum_of(reaction_) - sum_of(contact_force)).norm() / scale : 0.0;
  }

  // Depth that the pile has gone since it started, with its linear ramp of speed.
  double pile_travel(double time) const {
    const double ramp = settings_.pile_speed_ramp, v = settings_.pile_velocity;
    return time < ramp ? 0.5 * v * time * time / ramp : v * (time - 0.5 * ramp);
  }

  // Mean of -u_z over the interface's area, each facet's corners alike.
  double settlement() const {
    const InterfaceSurface& s = ground_.interface;
    double area = 0, sum = 0;
    for (std::size_t f = 0; f < s.facet_count(); ++f) {
      const double corner = 0.25 * facet_area_vector(s.corners(f)).norm();
      for (const std::int32_t i : s.facet[f]) {
        area += corner;
        sum -= corner * ground_.motion.displacement[s.node[i]].z();
      }
    }
    return area > 0 ? sum / area : 0.0;
  }

  void measure_jump() {
    const InterfaceSurface& s = ground_.interface;
    double sum = 0;
    for (std::size_t i = 0; i < s.node_count(); ++i) {
      const double moved = (s.position[i] - ground_.grid.node[s.node[i]]).norm();
      report_.jump.largest = std::max(report_.jump.largest, moved);
      sum += moved;
    }
    report_.jump.mean = sum / static_cast<double>(s.node_count());
    report_.jump.largest_in_facets = report_.jump.largest / s.mean_facet_size();
    double largest_stress = 0;
    for (std::size_t z = 0; z < is_left_.size(); ++z) {
      if (!is_left_[z]) continue;
      const Mat3 before = initial_.zone_stress(ground_.grid, z);
      const Mat3 change = ground_.zone_stress(initial_, z) - before;
      report_.jump.stress = std::max(report_.jump.stress, change.cwiseAbs().maxCoeff());
      largest_stress = std::max(largest_stress, before.cwiseAbs().maxCoeff());
    }
    report_.jump.stress_fraction = largest_stress > 0 ? report_.jump.stress / largest_stress : 0.0;
  }

  void describe_initial_stress() {
    const std::vector<Voigt> stress = zone_stresses(ground_.grid, initial_);
    double vertical = 0, horizontal = 0, bottom = 0, bottom_volume = 0;
    for (std::size_t z = 0; z < stress.size(); ++z) {
      const double volume = ground_.grid.geometry(z).zone_volume();
      vertical += volume * stress[z][2];
      horizontal += volume * 0.5 * (stress[z][0] + stress[z][1]);
      if (ground_.grid.level[z] == 0) bottom += volume * stress[z][2], bottom_volume += volume;
    }
    report_.k0 = vertical != 0 ? horizontal / vertical : 0.0;
    report_.bottom_vertical_stress = bottom / bottom_volume;
  }

  void after_step(const char* stage, double fraction) {
    const auto scope = ground_.profile.measure(Phase::Output);
    if (ground_.step % settings_.history_interval == 0) files_.add_history(ground_, initial_);
    if (ground_.step % good_state_interval == 0) keep_good_state();
    progress(stage, fraction);
  }

  void take_snapshot() {
    const auto scope = ground_.profile.measure(Phase::Output);
    files_.add_snapshot(ground_, initial_, is_left_);
  }

  // `position` is S/D with a pile, else the time since the stage began, as output.snapshot_interval.
  void snapshot_if_due(double position) {
    if (!(settings_.snapshot_interval > 0) || position < next_snapshot_) return;
    take_snapshot();
    next_snapshot_ = std::max(next_snapshot_ + settings_.snapshot_interval, position);
  }

  void beat(const std::string& text, double fraction) {
    if (peer_) peer_->heartbeat(text, fraction);
    progress("InitialStress", fraction);
  }

  void progress(const char* stage, double fraction) {
    if (!options_.prints_progress || seconds_since(last_progress_) < progress_seconds) return;
    last_progress_ = Clock::now();
    const double all = seconds_since(begin_);
    print_progress(fmt::format("side=continuum stage={} step={} time={:.6g} fraction={:.4f} wait={:.3f}", stage,
                               ground_.step, ground_.time, std::clamp(fraction, 0.0, 1.0),
                               peer_ && all > 0 ? peer_->seconds_waiting() / all : 0.0));
  }

  void keep_good_state() {
    const CoupledGround& g = ground_;
    good_states_.keep(
        g.step, g.time,
        {g.motion, g.interface.position, g.incremental ? std::make_unique<IncrementalForce>(*g.incremental) : nullptr,
         g.yielding ? std::make_unique<YieldingZones>(*g.yielding) : nullptr});
  }

  // The newest state that the failure had not reached yet, if there is one.
  void return_to_good_state() {
    CoupledGround& g = ground_;
    const std::uint64_t failed_at = g.step;
    auto* good = good_states_.before(failed_at, good_state_age);
    if (!good) return;
    g.step = good->step, g.time = good->time;
    g.motion = good->state.motion, g.interface.position = good->state.position;
    if (good->state.incremental) g.incremental = std::move(good->state.incremental);
    if (good->state.yielding) g.yielding = std::move(good->state.yielding);
    spdlog::error("failed at step {}; the last files show step {}, the last one known to be sound", failed_at, g.step);
  }

  // The summary of a run that failed after it had begun to step.
  void keep_last_state(const std::string& why, bool is_unstable) noexcept {
    try {
      if (ground_.step == 0) return;
      if (is_unstable) return_to_good_state();
      report_.finish_text = why;
      conclude();
      files_.write_summary(report_, settings_.title);
    } catch (const std::exception& error) {
      spdlog::error("the summary could not be written: {}", error.what());
    }
  }

  // The grains may end the run in any step, at their user's wish even in Apply.
  bool is_over() { return stop_requested() || ground_.incoming.is_done; }

  bool stop_requested() {
    if (interrupt_requested() && !report_.is_interrupted) {
      report_.is_interrupted = true;
      spdlog::warn("interrupted at step {}: finishing", ground_.step);
    }
    return report_.is_interrupted;
  }

  void begin_stage(const char* name) {
    report_.stages.push_back({name, 0, ""});
    stage_begin_ = Clock::now();
  }

  void end_stage(const std::string& achievement) {
    StageReport& s = report_.stages.back();
    s.seconds = seconds_since(stage_begin_);
    s.achievement = achievement;
    static const std::pair<const char*, const char*> paper_steps[] = {
        {"InitialStress", "1"}, {"Balance", "2"}, {"Excavate", "3"}, {"Apply", "4"}, {"Penetrate", "5 to 7"}};
    std::string paper;
    for (const auto& [name, number] : paper_steps)
      if (s.name == name) paper = fmt::format(" (paper step {})", number);
    spdlog::info("stage {}{}: {}, {:.2f} s", s.name, paper, achievement, s.seconds);
  }

  void conclude() {
    report_.steps = ground_.step;
    report_.time = ground_.time;
    report_.last_time_step = ground_.step_sizes.out_of;
    report_.step_limited_by = ground_.guard.limits.limited_by();
    report_.coupled = ground_.coupled;
    report_.step_cuts = ground_.guard.cuts;
    report_.ledger = ground_.integrator.ledger();
    const Ledger& l = report_.ledger;
    const double turnover = std::abs(l.work.gravity) + std::abs(l.work.boundary) + std::abs(l.work.interface) +
                            std::abs(l.work.baseline) + std::abs(l.work.damped) + l.work.yielded + l.kinetic +
                            std::abs(l.elastic);
    report_.ledger_residual_fraction = turnover > 0 ? std::abs(l.residual()) / turnover : 0.0;
    for (const Vec3& u : ground_.motion.displacement)
      report_.largest_displacement = std::max(report_.largest_displacement, u.norm());
    report_.settlement = settlement();
    if (ground_.yielding) {
      report_.zones_yielded = ground_.yielding->yielded();
      report_.zones_yielding = ground_.yielding->yielding();
    }
    report_.largest_strain_measure = report_.largest_displacement / ground_.interface.mean_facet_size();
    for (std::size_t p = 0; p < Profile<Phase>::size; ++p)
      report_.phase_seconds.push_back(ground_.profile.seconds(static_cast<Phase>(p)));
    Hash h;
    h.add(std::span<const Vec3>(ground_.motion.displacement));
    h.add(std::span<const Vec3>(ground_.motion.velocity));
    report_.state_hash = h.value();
    report_.position_hash = ground_.interface.position_hash();
    files_.add_history(ground_, initial_);
    take_snapshot();
    files_.write_interface(ground_,
                           traction_.empty() ? Vec3s(ground_.interface.facet_count(), Vec3::Zero()) : traction_);
  }

  const SceneFile& scene_;
  Settings settings_;
  RunOptions options_;
  Team team_;
  ResultFiles files_;
  std::unique_ptr<protocol::Session> peer_;
  CoupledGround ground_;
  RunReport report_;

  StiffnessMatrix stiffness_;  // until the stable step is known; internal_force has its own form of it
  std::vector<double> mass_;   // per node [kg]
  Vec3s is_free_;              // in InitialStress
  InitialState initial_;       // before Excavate
  Vec3s reaction_;             // f_A per interface node [N]
  Vec3s traction_;             // per facet [Pa]
  std::vector<char> is_left_;  // per zone: not deleted at Excavate
  double next_snapshot_ = 0;   // as output.snapshot_interval
  // What a run that fails goes back to.
  struct GoodState {
    Motion motion;
    Vec3s position;  // of the interface [m]
    std::unique_ptr<IncrementalForce> incremental;
    std::unique_ptr<YieldingZones> yielding;
  };
  GoodStates<GoodState> good_states_;
  Clock::time_point begin_ = Clock::now(), stage_begin_, last_progress_;
};

}  // namespace

RunReport run_continuum(const SceneFile& scene, const std::filesystem::path& results_folder,
                        std::unique_ptr<protocol::Channel> channel, const RunOptions& options) {
  return Stages(scene, results_folder, std::move(channel), options).run();
}

}  // namespace lockstep::continuum
