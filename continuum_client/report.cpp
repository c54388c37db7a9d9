#include "continuum_client/report.hpp"

#include <algorithm>

#include "common/checks.hpp"

namespace lockstep::continuum {

namespace {

template <class Vector>
void append(Field& field, const Vector& value) {
  field.values.insert(field.values.end(), value.data(), value.data() + value.size());
}

}  // namespace

ResultFiles::ResultFiles(const std::filesystem::path& folder, const Settings& settings)
    : folder_(folder), writes_zones_(settings.writes_zones), results_(settings.results) {
  if (folder_.empty()) return;
  prepare_folder(folder_);
  history_ = std::make_unique<History>(
      folder_ / "continuum_history.csv",
      std::vector<std::string>{"step [-]", "time [s]", "time step [s]", "unbalanced ratio [-]", "kinetic [J]",
                               "elastic [J]", "gravity work [J]", "boundary work [J]", "interface work [J]",
                               "baseline work [J]", "damped [J]", "yielded [J]", "ledger residual [J]",
                               "interface force on ground z [N]", "baseline force z [N]", "largest displacement [m]"});
  series_ = std::make_unique<Series>(folder_ / "zones.pvd");
}

void ResultFiles::find_places(const Grid& grid, const std::vector<char>& is_left) {
  observers_.emplace(folder_, results_, grid, is_left);
}

void ResultFiles::add_history(const CoupledGround& g, const InitialState& initial) {
  if (!is_active() || g.step <= last_row_) return;
  last_row_ = g.step;
  if (g.coupled) {
    if (!coupled_history_)
      coupled_history_ = std::make_unique<History>(folder_ / "continuum_interface.csv", CoupledLedger::columns());
    coupled_history_->add(g.coupled->row());
  }
  const Ledger& l = g.integrator.ledger();
  double force = 0, baseline = 0, largest = 0;
  for (const Vec3& f : g.incoming.force) force += f.z();
  for (const Vec3& f : g.baseline.force) baseline += f.z();
  for (const Vec3& u : g.motion.displacement) largest = std::max(largest, u.norm());
  history_->add({static_cast<double>(g.step), g.time, g.step_sizes.out_of, g.sums.unbalanced_ratio(), l.kinetic,
                 l.elastic, l.work.gravity, l.work.boundary, l.work.interface, l.work.baseline, l.work.damped,
                 l.work.yielded, l.residual(), force, baseline, largest});
  if (observers_) observers_->add_rows(g, initial);
}

void ResultFiles::add_snapshot(const CoupledGround& g, const InitialState& initial, const std::vector<char>& is_left) {
  if (!is_active() || (snapshots_ > 0 && g.step == last_step_)) return;
  if (writes_zones_) write_zones(g, initial, is_left);
  if (observers_) observers_->add_snapshot(g, initial, snapshots_);
  ++snapshots_;
  last_step_ = g.step;
}

void ResultFiles::write_zones(const CoupledGround& g, const InitialState& initial, const std::vector<char>& is_left) {
  // Only the nodes of the zones that are left are written.
  std::vector<std::int32_t> number(g.grid.node_count(), -1);
  Vec3s points;
  Field displacement{"displacement [m]", 3, {}}, velocity{"velocity [m/s]", 3, {}};
  Field stress{"stress xx yy zz xy yz zx [Pa]", 6, {}}, change{"vertical stress change since Excavate [Pa]", 1, {}};
  Field strain{"strain xx yy zz xy yz zx [-]", 6, {}}, plastic{"plastic strain xx yy zz xy yz zx [-]", 6, {}};
  Field unbalanced{"unbalanced force [N]", 3, {}}, reaction{"reaction [N]", 3, {}};
  std::vector<std::array<std::int32_t, 8>> zones;
  for (std::size_t z = 0; z < g.grid.zone_count(); ++z)
    if (is_left[z])
      for (std::int32_t n : g.grid.zone[z]) number[n] = 0;
  for (std::size_t i = 0; i < number.size(); ++i) {
    if (number[i] < 0) continue;
    number[i] = static_cast<std::int32_t>(points.size());
    points.push_back(g.grid.node[i]);
    append(displacement, g.motion.displacement[i]);
    append(velocity, g.motion.velocity[i]);
    if (results_.unbalanced_force) append(unbalanced, g.unbalanced_force(i));
    if (results_.reactions) append(reaction, g.support_force(i));
  }
  for (std::size_t z = 0; z < g.grid.zone_count(); ++z) {
    if (!is_left[z]) continue;
    std::array<std::int32_t, 8> nodes;
    for (int a = 0; a < 8; ++a) nodes[a] = number[g.grid.zone[z][a]];
    zones.push_back(nodes);
    const Mat3 now = g.zone_stress(initial, z);
    append(stress, to_voigt(now));
    if (results_.strain) append(strain, to_voigt(g.zone_strain(z)));
    if (g.yielding) append(plastic, to_voigt(g.yielding->plastic_strain(z)));
    change.values.push_back(now(2, 2) - initial.zone_stress(g.grid, z)(2, 2));
  }
  const std::string name = fmt::format("zones_{:04d}.vtu", snapshots_);
  std::vector<Field> of_points = {displacement, velocity}, of_zones = {stress, change};
  if (results_.unbalanced_force) of_points.push_back(std::move(unbalanced));
  if (results_.reactions) of_points.push_back(std::move(reaction));
  if (results_.strain) of_zones.push_back(std::move(strain));
  if (g.yielding) of_zones.push_back(std::move(plastic));
  write_vtu_hexahedra(folder_ / name, points, zones, of_points, of_zones);
  series_->add(g.time, name);
}

void ResultFiles::write_interface(const CoupledGround& g, const Vec3s& traction) {
  if (!is_active()) return;
  Field force{"contact force [N]", 3, {}}, shift{"displacement [m]", 3, {}}, load{"handed-over traction [Pa]", 3, {}},
      ring{"ring", 1, {}};
  const InterfaceSurface& s = g.interface;
  for (std::size_t i = 0; i < s.node_count(); ++i)
    for (int c = 0; c < 3; ++c) {
      force.values.push_back(i < g.incoming.force.size() ? g.incoming.force[i][c] : 0.0);
      shift.values.push_back(s.position[i][c] - g.grid.node[s.node[i]][c]);
    }
  for (std::size_t f = 0; f < s.facet_count(); ++f) {
    for (int c = 0; c < 3; ++c) load.values.push_back(traction[f][c]);
    ring.values.push_back(s.ring[f]);
  }
  write_vtp_facets(folder_ / "interface.vtp", s.position, s.facet, {force, shift}, {load, ring});
}

void ResultFiles::write_summary(const RunReport& r, const std::string& title) {
  if (!is_active()) return;
  Json stages;
  for (const StageReport& s : r.stages)
    stages.add(s.name, Json().add("seconds", s.seconds).add("achievement", s.achievement));
  Json phases;
  for (std::size_t p = 0; p < r.phase_seconds.size(); ++p) phases.add(phase_names[p], r.phase_seconds[p]);
  const Ledger& l = r.ledger;
  Json json;
  json.add("title", title).add("version", lockstep_version());
  json.add("mesh", Json()
                       .add("zones", r.zones)
                       .add("zones_deleted", r.zones_deleted)
                       .add("zones_left", r.zones - r.zones_deleted)
                       .add("nodes", r.nodes)
                       .add("interface_nodes", r.interface_nodes)
                       .add("facets", r.facets));
  json.add("initial_stress", Json()
                                 .add("solver_iterations", r.equilibrium.solve.iterations)
                                 .add("solver_residual", r.equilibrium.solve.relative_residual)
                                 .add("cycles", static_cast<std::int64_t>(r.equilibrium.cycles))
                                 .add("unbalanced_ratio", r.equilibrium.unbalanced_ratio)
                                 .add("drift", r.equilibrium.drift)
                                 .add("bottom_vertical_stress_Pa", r.bottom_vertical_stress)
                                 .add("k0", r.k0));
  json.add("excavation_residual", r.excavation_residual);
  json.add("hand_off", Json()
                           .add("largest_displacement_m", r.jump.largest)
                           .add("mean_displacement_m", r.jump.mean)
                           .add("largest_in_facet_sizes", r.jump.largest_in_facets)
                           .add("largest_stress_change_pa", r.jump.stress)
                           .add("largest_stress_change_of_largest_stress", r.jump.stress_fraction)
                           .add("initial_force_difference", r.jump.force_difference)
                           .add("steps", r.jump.apply_steps)
                           .add("unbalanced_ratio_zones", r.jump.apply_ratio_zones)
                           .add("unbalanced_ratio_grains", r.jump.apply_ratio_grains)
                           .add("converged", r.jump.apply_converged));
  json.add("time", Json()
                       .add("steps", r.steps)
                       .add("time_s", r.time)
                       .add("first_time_step_s", r.first_time_step)
                       .add("last_time_step_s", r.last_time_step)
                       .add("limited_by", r.step_limited_by)
                       .add("cuts", r.step_cuts));
  json.add("energy", Json()
                         .add("kinetic_J", l.kinetic)
                         .add("elastic_J", l.elastic)
                         .add("gravity_work_J", l.work.gravity)
                         .add("boundary_work_J", l.work.boundary)
                         .add("interface_work_J", l.work.interface)
                         .add("baseline_work_J", l.work.baseline)
                         .add("step_change_J", l.work.step_change)
                         .add("damped_J", l.work.damped)
                         .add("yielded_J", l.work.yielded)
                         .add("residual_J", l.residual())
                         .add("residual_fraction", r.ledger_residual_fraction));
  if (r.zones_yielded)
    json.add("yielding", Json().add("zones_ever", *r.zones_yielded).add("zones_in_the_last_step", r.zones_yielding));
  if (r.coupled) json.add("coupled", r.coupled->summary());
  json.add("interface_settlement_m", r.settlement)
      .add("largest_displacement_m", r.largest_displacement)
      .add("largest_displacement_over_facet", r.largest_strain_measure);
  json.add("stages", stages).add("phase_seconds", phases);
  json.add("seconds", r.seconds).add("seconds_waiting_for_peer", r.seconds_waiting);
  json.add("bytes_sent", r.bytes_sent).add("bytes_received", r.bytes_received);
  json.add("state_hash", fmt::format("{:016x}", r.state_hash))
      .add("position_hash", fmt::format("{:016x}", r.position_hash));
  json.add("interrupted", r.is_interrupted).add("finish", r.finish_text);
  write_file(folder_ / "continuum_summary.json", json.text());
}

}  // namespace lockstep::continuum
