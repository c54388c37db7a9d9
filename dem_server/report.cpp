#include "dem_server/report.hpp"

#include "common/log.hpp"

namespace lockstep::dem {

namespace {

void add_pile(Json& summary, const Model& m, const RunReport& r) {
  if (!m.pile) return;
  summary.add("pile_diameter", 2 * m.pile->shape().radius)
      .add("pile_tip_z", m.pile->tip_z())
      .add("pile_tip_z_start", r.pile_start)
      .add("s_over_d", r.s_over_d)
      .add("tip_resistance_pa", r.tip_resistance)
      .add("shaft_force_n", r.shaft_force);
}

// Of `wall` blocks.
void add_walls(Json& summary, const Model& m, const Settings& settings) {
  if (settings.walls.empty()) return;
  Json walls;
  for (std::size_t k = 0; k < settings.walls.size(); ++k) {
    const WallTotals& totals = m.walls.totals()[k];
    Json wall;
    wall.add("force_n", std::vector<double>{totals.force.x(), totals.force.y(), totals.force.z()})
        .add("contacts", static_cast<std::int64_t>(totals.contacts));
    if (m.walls.has_servo(k))
      wall.add("pressure_pa", m.walls.pressure(k)).add("servo_way_m", m.walls.state(k).servo_way);
    walls.add(m.walls.name(k), wall);
  }
  summary.add("walls", walls);
}

Json energies_entry(const GrainEnergies& e) {
  return Json()
      .add("kinetic", e.kinetic)
      .add("elastic", e.elastic)
      .add("gravity_work", e.gravity_work)
      .add("boundary_work", e.boundary_work)
      .add("interface_work", e.interface_work)
      .add("damped", e.damped)
      .add("friction", e.friction)
      .add("dashpots", e.dashpots);
}

Json guarantees_entry(const Model& m) {
  Json guarantees;
  if (m.ledger.is_kept)
    guarantees.add("energy_residual_over_work", m.ledger.residual_fraction())
        .add("worst_vertical_imbalance_over_largest_force", m.ledger.worst_vertical_imbalance())
        .add("worst_action_minus_reaction", m.ledger.worst_action_reaction());
  return guarantees.add("tunnelled_pebbles", static_cast<std::int64_t>(m.facets.tunnelled()));
}

Json phases_entry(const Model& m, double measuring_seconds) {
  return Json()
      .add("wait for peer", m.profile.seconds(Phase::WaitForPeer))
      .add("interface contacts", m.profile.seconds(Phase::InterfaceContacts))
      .add("contact lists", m.profile.seconds(Phase::Lists))
      .add("grain contacts", m.profile.seconds(Phase::PairContacts))
      .add("pile and walls", m.profile.seconds(Phase::WallContacts))
      .add("motion", m.profile.seconds(Phase::Motion))
      .add("ledger", m.profile.seconds(Phase::Ledger))
      .add("measurements", measuring_seconds);
}

}  // namespace

void report_state(RunReport& r, const Model& m, const Settings& settings) {
  r.steps = m.step;
  r.time = m.time;
  r.state_hash = m.hash();
  r.position_hash = m.facets.position_hash();
  r.grains = m.particles.body_count();
  for (const Vec3& f : m.facets.nodal_force()) r.interface_force += f;
  r.energy_residual = m.ledger.residual_fraction();
  r.worst_vertical_imbalance = m.ledger.worst_vertical_imbalance();
  r.worst_action_reaction = m.ledger.worst_action_reaction();
  r.kinetic_energy = m.ledger.energies().kinetic;
  r.start_energies = m.ledger.start();
  r.energies = m.ledger.energies();
  for (std::size_t b = 0; b < m.particles.body_count(); ++b)
    r.momentum += m.particles.mass(b) * m.particles.velocity(b);
  r.mass = m.particles.total_mass();
  for (std::size_t k = 0; k < settings.walls.size(); ++k)
    r.walls.push_back({m.walls.totals()[k].force, m.walls.has_servo(k) ? m.walls.pressure(k) : 0.0});
}

Json make_summary(const SceneFile& scene, const Settings& settings, const Assembly& assembly, const Model& m,
                  const StageRecord& stages, const RunReport& r) {
  Json j;
  j.add("program", "dem_server")
      .add("version", lockstep_version())
      .add("scene_digest", scene.digest)
      .add("title", settings.title)
      .add("end", r.end)
      .add("interrupted", r.is_interrupted);
  j.add("seconds", r.seconds).add("stages", stages.entries());
  j.add("grains", static_cast<std::int64_t>(m.particles.body_count()))
      .add("pebbles", static_cast<std::int64_t>(m.particles.pebble_count()))
      .add("mean_radius_m", assembly.mean_radius)
      .add("solid_density_kg_m3", assembly.solid_density)
      .add("seed", settings.seed);
  j.add("steps", m.step).add("time_s", m.time).add("time_step_s", m.last_time_step);
  add_pile(j, m, r);
  add_walls(j, m, settings);
  j.add("energies_j", energies_entry(m.ledger.energies()));
  j.add("guarantees", guarantees_entry(m));
  if (r.coupled) j.add("coupled", r.coupled->summary());
  j.add("seconds_by_phase", phases_entry(m, r.measuring_seconds));
  j.add("list_builds", m.contacts.rebuilds()).add("list_refreshes", m.contacts.refreshes());
  if (r.bytes_sent && r.bytes_received) j.add("bytes_sent", *r.bytes_sent).add("bytes_received", *r.bytes_received);
  j.add("state_hash", fmt::format("{:016x}", r.state_hash));
  j.add("position_hash", fmt::format("{:016x}", r.position_hash));
  return j;
}

}  // namespace lockstep::dem
