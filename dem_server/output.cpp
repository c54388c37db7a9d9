#include "dem_server/output.hpp"

#include <spdlog/fmt/fmt.h>

#include <algorithm>
#include <cmath>

#include "dem_server/measure.hpp"

namespace lockstep::dem {

namespace {

// Those of every run, and the four that split the energies where the scene asks for them.
std::vector<std::string> history_columns(bool splits_energies) {
  std::vector<std::string> columns = {
      "step",
      "time [s]",
      "time step [s]",
      "S/D",
      "tip resistance [Pa]",
      "tip force [N]",
      "shaft force [N]",
      "interface force on grains x [N]",
      "interface force on grains y [N]",
      "interface force on grains z [N]",
      "unbalanced ratio",
      "contacts",
      "interface contacts",
      "largest overlap [R]",
      "kinetic [J]",
      "elastic [J]",
      "gravity work [J]",
      "boundary work [J]",
      "interface work [J]",
      "damped [J]",
      "friction [J]",
      "dashpots [J]",
      "energy residual [J]",
      "vertical imbalance [N]",
      "neglected moment [N m]",
  };
  if (splits_energies)
    for (const char* name :
         {"kinetic translational [J]", "kinetic rotational [J]", "elastic normal [J]", "elastic shear [J]"})
      columns.push_back(name);
  return columns;
}

// The last four columns; each pair of them sums up to the ledger's column. Its kinetic energy is leap-frog's own, of two
// half steps, and is shared out as the energies of the velocities that stand.
void append_split(std::vector<double>& row, const Model& m) {
  const KineticEnergies k = kinetic_energies(m.particles);
  const double sum = k.translational + k.rotational, kinetic = m.ledger.energies().kinetic;
  const double turning = sum > 0 ? kinetic * k.rotational / sum : 0.0;
  ElasticEnergies e{m.pair_totals.normal_energy, m.pair_totals.shear_energy};
  const auto add = [&](const ContactView& c) { e.add(c); };
  m.facets.for_each_contact(add);
  m.walls.for_each_contact(add);
  if (m.pile) m.pile->for_each_contact(add);
  for (const double energy : {kinetic - turning, turning, e.normal, e.shear}) row.push_back(energy);
}

}  // namespace

Output::Output(const Settings& settings, std::filesystem::path folder)
    : folder_(std::move(folder)), interval_(settings.history_interval), wall_history_(settings.walls, folder_) {
  if (folder_.empty()) return;
  splits_energies_ = settings.measure.energy_by_kind;
  history_ = std::make_unique<History>(folder_ / "dem_history.csv", history_columns(splits_energies_));
  if (settings.measure.is_any()) observers_ = std::make_unique<Observers>(settings, folder_);
  if (settings.write_particles) particle_series_.emplace(folder_ / "particles.pvd");
  if (settings.write_contacts) contact_series_.emplace(folder_ / "contacts.pvd");
}

void Output::record(const Model& m, double s_over_d, double ratio) {
  if (observers_) observers_->record(m, s_over_d);
  if (m.pile) {
    tip_sum_ += m.pile_totals.tip_force.z();
    shaft_sum_ += m.pile_totals.shaft_force.z();
  }
  interface_sum_ += m.facet_totals.particle_force;
  wall_history_.record(m.walls);
  if (++samples_ < interval_) return;
  wall_history_.write_row(m.walls, m.step, m.time);
  const double n = samples_;
  const double tip = tip_sum_ / n;
  tip_resistance_ = m.pile ? tip / m.pile->tip_area() : 0.0;
  shaft_force_ = shaft_sum_ / n;
  if (history_) {
    const GrainEnergies& e = m.ledger.energies();
    const Vec3 interface = interface_sum_ / n;
    std::vector<double> row = {static_cast<double>(m.step),
                               m.time,
                               m.time_step,
                               s_over_d,
                               tip_resistance_,
                               tip,
                               shaft_force_,
                               interface.x(),
                               interface.y(),
                               interface.z(),
                               ratio,
                               static_cast<double>(m.pair_totals.active),
                               static_cast<double>(m.facet_totals.contacts),
                               std::max(m.pair_totals.largest_overlap_ratio, m.facet_totals.max_overlap),
                               e.kinetic,
                               e.elastic,
                               e.gravity_work,
                               e.boundary_work,
                               e.interface_work,
                               e.damped,
                               e.friction,
                               e.dashpots,
                               m.ledger.residual(),
                               m.ledger.vertical_imbalance(),
                               m.facet_totals.neglected_moment};
    if (splits_energies_) append_split(row, m);
    history_->add(row);
  }
  samples_ = 0;
  tip_sum_ = shaft_sum_ = 0;
  interface_sum_.setZero();
}

void Output::record_interface(const CoupledLedger& ledger) {
  if (folder_.empty()) return;
  if (!interface_history_)
    interface_history_ = std::make_unique<History>(folder_ / "dem_interface.csv", CoupledLedger::columns());
  interface_history_->add(ledger.row());
}

namespace {

Field scalars(const char* name, std::size_t count) { return {name, 1, std::vector<double>(count)}; }
Field vectors(const char* name, std::size_t count) { return {name, 3, std::vector<double>(3 * count)}; }

void put(Field& field, std::size_t i, const Vec3& v) {
  for (int k = 0; k < 3; ++k) field.values[3 * i + k] = v[k];
}

void write_particles(const std::filesystem::path& path, const Particles& p) {
  const std::size_t n = p.pebble_count();
  Field radius = scalars("radius", n), body = scalars("clump", n), size = scalars("equivalent radius", n);
  Field velocity = vectors("velocity", n), spin = vectors("spin", n);
  Vec3s center(n);
  for (std::size_t i = 0; i < n; ++i) {
    center[i] = p.pebble_center(i);
    const auto b = p.pebble_body(i);
    radius.values[i] = p.pebble_radius(i);
    body.values[i] = b;
    size.values[i] = p.equivalent_radius(b);
    put(velocity, i, p.velocity(b));
    put(spin, i, p.spin(b));
  }
  write_vtp_points(path, center, {radius, body, size, velocity, spin});
}

void write_contacts(const std::filesystem::path& path, const Model& m) {
  // A line from body to body, or from body to contact point at walls; "family": 0 grain, 1 interface, 2 plane, 3 pile.
  Vec3s begin, end;
  Field normal_force{"normal force", 1, {}}, shear_force{"shear force", 1, {}}, mobilised{"mobilisation", 1, {}},
      family{"family", 1, {}};
  const auto add = [&](double kind, double friction) {
    return [&, kind, friction](const ContactView& c) {
      begin.push_back(m.particles.position(c.body_a));
      end.push_back(c.body_b >= 0 ? m.particles.position(c.body_b) : c.point);
      normal_force.values.push_back(normal_force_of(c));
      shear_force.values.push_back(shear_force_of(c).norm());
      mobilised.values.push_back(mobilisation_of(c, friction));
      family.values.push_back(kind);
    };
  };
  m.contacts.for_each_contact(m.particles, add(0, m.material.friction));
  m.facets.for_each_contact(add(1, m.facet_material.friction));
  for (const WallContact& c : m.walls.contacts()) add(2, m.walls.friction(static_cast<std::size_t>(c.part)))(c.view());
  if (m.pile) m.pile->for_each_contact(add(3, m.pile->friction()));
  write_vtp_lines(path, begin, end, {normal_force, shear_force, mobilised, family});
}

}  // namespace

void Output::snapshot(const Model& m, const Settings& settings) {
  if (folder_.empty() || last_snapshot_step_ == m.step) return;
  last_snapshot_step_ = m.step;
  if (settings.write_particles) {
    const std::string name = fmt::format("particles_{:04d}.vtp", snapshots_);
    write_particles(folder_ / name, m.particles);
    particle_series_->add(m.time, name);
  }
  if (settings.write_contacts) {
    const std::string name = fmt::format("contacts_{:04d}.vtp", snapshots_);
    write_contacts(folder_ / name, m);
    contact_series_->add(m.time, name);
  }
  if (observers_) observers_->snapshot(m, snapshots_);
  ++snapshots_;
}

void Output::summary(const Json& summary) {
  if (!folder_.empty()) write_file(folder_ / "dem_summary.json", summary.text() + "\n");
}

std::uint64_t touching_contacts(const Model& m) {
  return static_cast<std::uint64_t>(m.pair_totals.active) + m.facet_totals.contacts;
}

double unbalanced_ratio(const Model& m) {
  if (m.particles.body_count() == 0) return 0;
  std::size_t contacts = touching_contacts(m) + m.wall_totals.contacts;
  double force = m.pair_totals.normal_force + m.facet_totals.normal_force + m.wall_totals.normal_force;
  if (m.pile) {
    contacts += m.pile_totals.tip.contacts + m.pile_totals.shaft.contacts;
    force += m.pile_totals.tip.normal_force + m.pile_totals.shaft.normal_force;
  }
  if (!(force > 0)) return 1;
  return unbalanced_ratio(m.motion.unbalanced_force, m.particles.body_count(), force,
                          static_cast<std::int64_t>(contacts));
}

}  // namespace lockstep::dem
