// A session in the order of the paper's procedure (its section 2.2.3). Each stage says here what happens, when and what is
// told of it; the work is done elsewhere:
//
//   InitialStress        1        what the ground hands over
//   Balance              2        packing, make_model, balance, packing_file
//   Excavate             3        exchange
//   Apply, Penetrate     4 to 7   course, with exchange or alone; watch
//   Finish                        report
#include "dem_server/stages.hpp"

#include <chrono>
#include <cmath>
#include <optional>

#include "common/checks.hpp"
#include "common/interrupt.hpp"
#include "common/log.hpp"
#include "dem_server/alone.hpp"
#include "dem_server/balance.hpp"
#include "dem_server/course.hpp"
#include "dem_server/exchange.hpp"
#include "dem_server/make_model.hpp"
#include "dem_server/output.hpp"
#include "dem_server/packing_file.hpp"
#include "dem_server/progress.hpp"
#include "dem_server/watch.hpp"
#include "protocol/session.hpp"

namespace lockstep::dem {

namespace {

using protocol::Session;

std::unique_ptr<Session> make_session(const Settings& settings, std::unique_ptr<protocol::Channel> channel,
                                      const std::string& record_path) {
  if (!channel) return nullptr;
  protocol::SessionSettings s;
  s.peer_timeout = std::chrono::milliseconds(std::llround(1000 * settings.peer_timeout));
  s.record_path = record_path;
  return std::make_unique<Session>(std::move(channel), protocol::Role::Grains, s);
}

// Vertical pressure that the ground carried at z, interpolated in the profile [Pa].
double vertical_pressure(const std::vector<protocol::StressProfilePoint>& p, double z) {
  if (p.empty()) return 0;
  if (z <= p.front().z) return -p.front().vertical;
  for (std::size_t k = 1; k < p.size(); ++k)
    if (z <= p[k].z) {
      const double t = (z - p[k - 1].z) / (p[k].z - p[k - 1].z);
      return -(p[k - 1].vertical + t * (p[k].vertical - p[k - 1].vertical));
    }
  return -p.back().vertical;
}

// Interface, pile and walls stand still from here on.
void hold(Model& m) {
  m.facets.set_offsets(Vec3s(m.facets.offsets()));
  if (m.pile) m.pile->set_velocity(0);
  m.walls.set_moving(false, false);
}

class GrainsRun {
 public:
  GrainsRun(const SceneFile& scene, std::unique_ptr<protocol::Channel> channel, const RunOptions& options)
      : scene_(scene),
        options_(options),
        settings_(make_settings(scene)),
        output_(settings_, options.results),
        progress_(options.prints_progress),
        session_(make_session(settings_, std::move(channel), options.record_path)) {
    check_company(settings_, session_ != nullptr, scene);
  }

  RunReport run() {
    try {
      if (settings_.is_alone)
        run_alone();
      else
        run_coupled();
      return finish();
    } catch (const Error& error) {
      if (session_) session_->abort(static_cast<int>(error.code()), error.what());
      is_interrupted_ = error.code() == ExitCode::Interrupted;
      end_ = error.what();
      keep_last_state(error.code() == ExitCode::Numerical);
      throw;
    } catch (const std::exception& error) {
      if (session_) session_->abort(static_cast<int>(ExitCode::Internal), error.what());
      throw;
    }
  }

 private:
  void run_coupled() {
    shake_hands();
    receive_initial_stress();
    balance();
    excavate();
    course_->begin_apply();
    exchange_->run();
  }

  // Balance and Penetrate in one process. What stage Apply is to a coupled run is a moment here: friction of walls and
  // pile is switched on, and time and S are counted from there.
  void run_alone() {
    balance();
    course_->begin_apply();
    course_->begin_penetration();
    NoPeer no_peer(*course_, settings_);
    while (cycle(*model_, no_peer)) course_->record_step();
    end_ = interrupt_requested() ? "the user interrupted the run"
           : settings_.pile      ? "the pile is there"
                                 : "run.duration is over";
  }

  void shake_hands();
  void receive_initial_stress();
  void balance();
  void excavate();
  RunReport finish();

  void set_up_model();
  void make_packing();
  void take_packing(const BalancedPacking& packing);
  void tell_balance();
  void beat(std::string_view text, double fraction);
  RunReport report() const;
  void keep_last_state(bool has_failed) noexcept;

  const SceneFile scene_;
  const RunOptions options_;
  const Settings settings_;
  Output output_;
  ProgressLines progress_;
  StageRecord stages_;
  std::unique_ptr<Session> session_;  // none when the grains are alone

  HandedOver ground_;
  Assembly assembly_;
  BalanceFigures balanced_;
  std::unique_ptr<Model> model_;      // from Balance on, with
  std::unique_ptr<Watch> watch_;      // what watches it
  std::unique_ptr<Course> course_;    // and leads it through Apply and Penetrate
  std::optional<Exchange> exchange_;  // from Excavate on
  Stopwatch time_;
  bool is_interrupted_ = false;
  std::string end_;
};

// ------------------------------------------------------------------------------------------------------------ Hello

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

// ----------------------------------------------------------------------------------------------------------- step 1

void GrainsRun::receive_initial_stress() {
  stages_.begin();
  session_->on_progress = [](const protocol::Progress& p) {
    spdlog::debug("peer: {} ({:.0f} %)", p.text, 100 * p.fraction);
  };
  const auto initial = session_->receive<protocol::InitialStress>();
  spdlog::info("stage InitialStress (paper step 1): {} nodes, {} facets, unbalanced ratio {:.1e}, after {:.1f} s",
               initial.nodes.size(), initial.facets.size(), initial.unbalanced_ratio, stages_.seconds());
  if (settings_.pile && initial.profile.empty())
    throw PeerError(
        "InitialStress.profile is empty, but the scene has a pile whose tip must carry the stress of its depth; "
        "the peer must send the profile inside the discrete domain");
  ground_ = {initial.nodes, initial.facets, initial.ring, initial.traction, initial.bulk_density, 0.0};
  if (settings_.pile) ground_.tip_target = vertical_pressure(initial.profile, -settings_.pile->embedment);
  stages_.end("InitialStress", Json().add("nodes", static_cast<int>(initial.nodes.size())));
}

// ----------------------------------------------------------------------------------------------------------- step 2

// The packing is made and balanced, or taken from the file that an earlier run left it in; then everything is held.
void GrainsRun::balance() {
  stages_.begin();
  const std::filesystem::path& path = options_.packing;
  std::optional<BalancedPacking> given;
  if (!path.empty()) given = open_packing(path, settings_.packing_keys);
  if (given)
    take_packing(*given);
  else
    make_packing();

  Model& m = *model_;
  hold(m);
  m.detail = Detail::All;
  std::optional<PackingState> kept;
  if (!given && !path.empty()) {
    // Goes on as one that reads the file will: with lists of the same age sums have the same bits too, not states alone.
    kept = state_of(m);
    restore(m, *kept);
  }
  m.team = std::make_unique<Team>(options_.threads);
  evaluate_forces(m);
  if (!given) balanced_.porosity = bulk_porosity(settings_, assembly_, m.particles);
  tell_balance();
  if (kept) write_packing(path, {settings_.packing_keys, ground_, assembly_, balanced_, std::move(*kept)});
  if (!path.empty()) spdlog::info("the balanced packing was {} {}", given ? "taken from" : "written to", path.string());
}

void GrainsRun::make_packing() {
  assembly_ = assemble(
      settings_, ground_.bulk_density,
      [this](std::string_view text, double fraction) {
        beat(text, 0.2 * fraction);
        progress_.show_packing(0.2 * fraction);
      },
      options_.balance_threads);
  set_up_model();
  BalanceCalls calls;
  calls.beat = [this](std::string_view text, double fraction) { beat(text, fraction); };
  calls.look = [this](double unbalanced_ratio, double fraction) {
    progress_.show("Balance", *model_, unbalanced_ratio, fmt::format("fraction={:.4f}", fraction));
    watch_->look_at_packing(*model_);
  };
  balanced_ = balance_packing(*model_, assembly_, settings_, ground_, calls);
}

void GrainsRun::take_packing(const BalancedPacking& packing) {
  check_fits(packing.ground, ground_, options_.packing);
  balanced_ = packing.figures;
  assembly_ = packing.assembly;
  assembly_.particles = packing.state.particles;
  assembly_.is_fixed = packing.state.is_fixed;
  set_up_model();
  restore(*model_, packing.state);
  if (settings_.balance.max_cycles > 0) set_friction(*model_, settings_, settings_.balance.friction, 0);
}

void GrainsRun::set_up_model() {
  model_ = make_model(settings_, assembly_, ground_, options_.balance_threads);
  watch_ = std::make_unique<Watch>(*model_, settings_, options_.watches_shivering);
  course_ = std::make_unique<Course>(*model_, settings_, output_, *watch_, progress_, stages_);
}

// A sign of life to the peer while the packing is made; alone, only the user's Ctrl-C is looked for.
void GrainsRun::beat(std::string_view text, double fraction) {
  if (session_)
    session_->heartbeat(text, fraction);
  else if (interrupt_requested())
    throw Interrupted("interrupted in stage Balance");
}

// What the packing reached, to the peer, the log and the summary.
void GrainsRun::tell_balance() {
  const Model& m = *model_;
  protocol::Balance reached;
  reached.traction.resize(ground_.facets.size());
  for (std::size_t f = 0; f < reached.traction.size(); ++f)
    reached.traction[f] = m.facets.facet_force()[f] / m.facets.area_vector(f).norm();
  reached.porosity = balanced_.porosity;
  reached.unbalanced_ratio = balanced_.unbalanced_ratio;
  reached.particles = m.particles.body_count();
  reached.contacts = touching_contacts(m);
  if (session_) session_->send(reached);

  const double tip = tip_target(settings_, assembly_, ground_);
  log_servo(balanced_, m, tip);
  spdlog::info(
      "stage Balance (paper step 2): unbalanced ratio {:.1e}, {} contacts, bulk porosity {:.3f}, {} cycles, {:.1f} s",
      reached.unbalanced_ratio, reached.contacts, reached.porosity, balanced_.cycles, stages_.seconds());
  stages_.end("Balance", balance_entry(balanced_, m, assembly_, tip));
}

// ----------------------------------------------------------------------------------------------------------- step 3

void GrainsRun::excavate() {
  stages_.begin();
  const auto theirs = session_->receive<protocol::ContinuumExcavated>();
  exchange_.emplace(*session_, *model_, settings_, *course_, output_, *watch_);
  const StepLimit& limit = exchange_->agree_on_step(theirs);
  spdlog::info(
      "stage Excavate (paper step 3): peer deleted {} zones, residual {:.1e}; stable steps {:.3e} s (grains, body {}) "
      "and "
      "{:.3e} s (zones)",
      theirs.zones_deleted, theirs.residual_ratio, limit.step, limit.worst_body, theirs.stable_step);
  stages_.end("Excavate", Json().add("stable_step_s", limit.step).add("zones_deleted", theirs.zones_deleted));
}

// ----------------------------------------------------------------------------------------------------------- Finish

RunReport GrainsRun::finish() {
  is_interrupted_ = interrupt_requested();
  if (session_) {
    const protocol::Finish& theirs = session_->finish();
    end_ = theirs.text;
    is_interrupted_ |= theirs.is_interrupted;
    session_->send(protocol::Message(
        protocol::Finish{model_->step, interrupt_requested() ? "the user of the grains interrupted the run" : "done",
                         interrupt_requested()}));
  }
  course_->finish();
  RunReport r = report();
  output_.summary(make_summary(scene_, settings_, assembly_, *model_, stages_, r));
  spdlog::info("finished: {}", end_);
  return r;
}

RunReport GrainsRun::report() const {
  RunReport r;
  report_state(r, *model_, settings_);
  r.ring_mismatch = balanced_.ring_mismatch;
  r.bottom_mismatch = balanced_.bottom_mismatch;
  r.pile_start = course_->pile_start();
  r.s_over_d = course_->s_over_d();
  r.unbalanced_ratio = course_->unbalanced_ratio();
  r.contacts = course_->contacts();
  r.tip_resistance = output_.tip_resistance();
  r.shaft_force = output_.shaft_force();
  r.measuring_seconds = output_.measuring_seconds();
  if (exchange_) r.coupled = exchange_->ledger();
  if (session_) r.bytes_sent = session_->bytes_sent(), r.bytes_received = session_->bytes_received();
  r.seconds = time_.seconds();
  r.is_interrupted = is_interrupted_;
  r.end = end_;
  return r;
}

// Of a run that goes no further; one that went wrong shows the last state that was sound.
void GrainsRun::keep_last_state(bool has_failed) noexcept {
  try {
    if (!model_) return;
    if (has_failed) watch_->return_to_good_state(*model_);
    output_.snapshot(*model_, settings_);
    output_.summary(make_summary(scene_, settings_, assembly_, *model_, stages_, report()));
  } catch (const std::exception& error) {
    spdlog::error("the last state could not be written: {}", error.what());
  }
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
