#include "tools/reflection_case.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "common/checks.hpp"
#include "common/packet.hpp"
#include "common/scene.hpp"

namespace lockstep {

namespace {

// A sphere of 0.1 m, as in scenarios/bar. Results are ratios and depend on none of these.
constexpr double radius = 0.05;           // [m]
constexpr double grain_density = 2650;    // [kg/m3]
constexpr double contact_modulus = 70e6;  // [Pa]
constexpr double stiffness_ratio = 2;     // k_n / k_s
constexpr double facet_factor = 2;        // contact of grain and zone: half a pitch of lattice in series
constexpr double poisson_ratio = 0.3;
// Overlaps that a packet's strain, 4e-7 of a pitch, leaves closed, and that are small: the normal force F of the preload
// takes F/d off the shear stiffness.
constexpr double overlap = 2e-7;        // [m]
constexpr double peak_velocity = 1e-4;  // [m/s]
// Waves in the hump. The share of waves that hardly travel along z falls with it; oblique ones, slow already, need more.
constexpr double periods = 8, oblique_periods = 12;

constexpr double pitch = 2 * radius - overlap;  // in all directions

double mass() { return grain_density * 4.0 / 3.0 * pi * radius * radius * radius; }
double normal_spring() { return contact_modulus * 2 * radius; }
double spring(const ReflectionCase& c) {
  return c.kind == WaveKind::Pressure ? normal_spring() : normal_spring() / stiffness_ratio;
}
double zone_size(const ReflectionCase& c) { return pitch * c.grains_per_zone; }
double wavelength(const ReflectionCase& c) { return c.zones_per_wave * zone_size(c); }

// Columns of an oblique case: W = lambda / (2 sin angle), to whole zones.
int zones_across(const ReflectionCase& c) {
  if (c.kind != WaveKind::Oblique) return 1;
  return std::max(1, static_cast<int>(std::lround(0.5 * c.zones_per_wave / std::sin(c.angle))));
}
double sine_of_angle(const ReflectionCase& c) {
  if (c.kind != WaveKind::Oblique) return 0;
  const double sine = 0.5 * c.zones_per_wave / zones_across(c);
  if (!(sine < 1))
    throw InputError(
        fmt::format("angle {:.3g}, {} zones a wave: a strip of {} whole zones has no such wave; give a longer wave or "
                    "another angle",
                    c.angle, c.zones_per_wave, zones_across(c)));
  return sine;
}
double wave_number_along(const ReflectionCase& c) {
  const double sine = sine_of_angle(c);
  return 2 * pi / wavelength(c) * std::sqrt(1 - sine * sine);
}

// Where everything is, from the times it takes.
struct Layout {
  double length = 0;    // of the packet [m]
  double center = 0;    // distance of its middle from the interface [m]
  double duration = 0;  // [s]
  int rows_of_grains = 0, rows_of_zones = 0;
};

Layout layout(const ReflectionCase& c) {
  const InterfaceModel m = interface_model(c);
  const double k = wave_number_along(c), limit = pi / (c.from == Side::Grains ? m.pitch : m.height);
  Layout l;
  l.length = c.is_hump ? wavelength(c) : (c.kind == WaveKind::Oblique ? oblique_periods : periods) * 2 * pi / k;
  const double margin = std::max(4 * zone_size(c), 0.5 * wavelength(c));
  l.center = margin + 0.5 * l.length;
  // The hump's spectrum has its first zero 4 pi / length off the middle, 3 % of amplitude beyond it and 0.3 % beyond 10 pi
  // / length. Long oblique waves are the slow ones, along z.
  const double half_width = 6 * pi / l.length;
  double slowest = m.group_velocity(c.from, c.is_hump ? 0.01 * half_width : k);
  const double middle = c.is_hump ? 0.0 : k;
  for (const double off : {c.kind == WaveKind::Oblique ? -1.7 : -1.0, -0.5, 0.5, 1.0}) {
    const double near = std::clamp(std::abs(middle + off * half_width), 0.2 * k, 0.9 * limit);
    slowest = std::min(slowest, m.group_velocity(c.from, near));
  }
  // No wave is faster than long ones along a lattice's axis.
  const double fastest = pitch * std::sqrt(spring(c) / mass());
  const double way = 2 * margin + l.length;
  l.duration = way / slowest;
  const double own = 0.5 * (fastest * l.duration + way), other = 0.5 * fastest * l.duration + margin;
  const double grains = c.from == Side::Grains ? own : other, zones = c.from == Side::Grains ? other : own;
  l.rows_of_grains = static_cast<int>(std::ceil(grains / pitch)) + 1;
  l.rows_of_zones = static_cast<int>(std::ceil(zones / zone_size(c))) + 1;
  return l;
}

scene::Packet packet(const ReflectionCase& c) {
  const Layout l = layout(c);
  scene::Packet p;
  scene::Point& v = *p.mutable_velocity();
  c.kind == WaveKind::Pressure ? v.set_z(peak_velocity) : v.set_y(peak_velocity);
  const double width = zones_across(c) * zone_size(c);
  p.mutable_center()->set_x(c.kind == WaveKind::Oblique ? -0.5 * width : 0.0);
  p.mutable_center()->set_z(c.from == Side::Grains ? l.center : -l.center);
  p.set_length(l.length);
  if (!c.is_hump) p.set_wavelength(2 * pi / wave_number_along(c));
  if (c.kind == WaveKind::Oblique) p.set_wavelength_across(2 * width);
  return p;
}

// Starting velocities by rows from the interface.
std::vector<double> row_velocities(const ReflectionCase& c) {
  const Layout l = layout(c);
  const scene::Packet p = packet(c);
  std::vector<double> v;
  if (c.from == Side::Grains)
    for (int j = 0; j < l.rows_of_grains; ++j)
      v.push_back(packet_velocity(p, {p.center().x(), 0, radius - overlap / facet_factor + j * pitch}).sum());
  else
    for (int j = 0; j <= l.rows_of_zones; ++j)
      v.push_back(packet_velocity(p, {p.center().x(), 0, -j * zone_size(c)}).sum());
  return v;
}

}  // namespace

InterfaceModel interface_model(const ReflectionCase& c) {
  InterfaceModel m;
  const double h = zone_size(c);
  m.pitch = pitch;
  m.columns = c.kind == WaveKind::Oblique ? c.grains_per_zone : 1;
  m.mass = mass();
  m.spring = spring(c);
  m.side_spring = c.kind == WaveKind::Oblique ? m.spring : 0.0;
  m.contact = facet_factor * m.spring;
  m.height = h;
  const double modulus = c.impedance_ratio * m.spring / pitch;                  // C [Pa]
  const double density = c.impedance_ratio * m.mass / (pitch * pitch * pitch);  // [kg/m3]
  const double width = m.columns * pitch;
  m.row_mass = density * width * pitch * h;
  m.wave_number_across = c.kind == WaveKind::Oblique ? pi / (zones_across(c) * h) : 0.0;
  if (c.kind != WaveKind::Oblique) {
    m.layer_own = modulus * pitch * pitch / h;
    m.layer_next = -m.layer_own;
    return m;
  }
  const double cosine = std::cos(m.wave_number_across * h), along = (2 + cosine) / 3;
  m.layer_own = modulus * pitch * (along + 2 * (1 - cosine) / 3);
  m.layer_next = modulus * pitch * (-along + (1 - cosine) / 3);
  return m;
}

std::string scene_text(const ReflectionCase& c) {
  const Layout l = layout(c);
  const scene::Packet p = packet(c);
  const double h = zone_size(c), width = c.kind == WaveKind::Oblique ? zones_across(c) * h : pitch;
  const int columns = c.kind == WaveKind::Oblique ? zones_across(c) * c.grains_per_zone : 1;
  const double modulus = c.impedance_ratio * spring(c) / pitch;
  const double density = c.impedance_ratio * mass() / (pitch * pitch * pitch);
  const double nu = poisson_ratio;
  const bool is_pressure = c.kind == WaveKind::Pressure;
  const double youngs_modulus = is_pressure ? modulus * (1 + nu) * (1 - 2 * nu) / (1 - nu) : 2 * modulus * (1 + nu);
  std::string text = fmt::format(
      "gravity: 0\n"
      "continuum {{\n"
      "  youngs_modulus: {} poisson_ratio: {} density: {}\n"
      "  block {{ width_x: {} width_y: {} height: {} zones_x: {} zones_y: 1 zones_z: {} }}\n"
      "  initial_supports: ROLLERS supports: {} zone_kind: {} dynamic: true\n"
      "  held {{ x: {} y: {} z: {} }}\n"
      "}}\n",
      youngs_modulus, nu, density, width, pitch, l.rows_of_zones * h, zones_across(c), l.rows_of_zones,
      is_pressure ? "ROLLERS" : "BOTTOM_FIXED", c.kind == WaveKind::Oblique ? "B_BAR" : "MIXED_DISCRETIZATION", true,
      is_pressure, !is_pressure);
  text += fmt::format(
      "grains {{\n"
      "  density: {} contact_modulus: {} stiffness_ratio: {} friction: {} interface_friction: {} wall_friction: 0\n"
      "  facet_stiffness_factor: {}\n"
      "  lattice {{ count_x: {} count_y: 1 count_z: {} radius: {} overlap: {} side_overlap: {} fix_top: true "
      "hold_spins: {} }}\n"
      "}}\n",
      grain_density, contact_modulus, stiffness_ratio, is_pressure ? 0 : 1000, is_pressure ? 0 : 1000, facet_factor,
      columns, l.rows_of_grains, radius, overlap, overlap, !is_pressure);
  if (columns > 1)
    for (const int side : {-1, 1})
      text += fmt::format("plane {{ point {{ x: {} }} normal {{ x: {} }} }}\n",
                          side * (0.5 * (columns - 1) * pitch + radius - overlap), -side);
  text += fmt::format(
      "packet {{ velocity {{ y: {} z: {} }} center {{ x: {} z: {} }} length: {} wavelength: {} wavelength_across: {} "
      "}}\n"
      "balance {{ servo: NONE max_cycles: 0 }}\n"
      "apply {{ baseline: HOLD max_steps: 0 }}\n"
      "run {{ duration: {} damping: 0 }}\n"
      "fidelity {{ step_fraction: {} }}\n"
      "output {{ history_interval: 1 }}\n",  // the energies of the last step count
      p.velocity().y(), p.velocity().z(), p.center().x(), p.center().z(), p.length(), p.wavelength(),
      p.wavelength_across(), l.duration, c.step_fraction);
  return text;
}

double work_of(const ReflectionCase& c) {
  const Layout l = layout(c);
  const int across = zones_across(c), columns = c.kind == WaveKind::Oblique ? across * c.grains_per_zone : 1;
  return l.duration * (columns * l.rows_of_grains + across * l.rows_of_zones);
}

ReflectionResult exact_reflection(const ReflectionCase& c) {
  const InterfaceModel m = interface_model(c);
  ReflectionResult r;
  r.angle = std::asin(sine_of_angle(c));
  r.exact = energy_shares(m, c.from, row_velocities(c));
  if (!c.is_hump) r.at_center = energy_shares(m, c.from, wave_number_along(c));
  return r;
}

ReflectionResult measure_reflection(const ReflectionCase& c) {
  const auto begin = std::chrono::steady_clock::now();
  ReflectionResult r = exact_reflection(c);
  const Reports run = run_both(parse_scene(scene_text(c), "reflection"));
  const dem::GrainEnergies& before = run.grains.start_energies;
  const dem::GrainEnergies& after = run.grains.energies;
  const continuum::Ledger& zones = run.zones.ledger;
  const double start = before.kinetic + zones.start;
  // The baseline's work is what the preload does: with the top held, its force times the way of the interface.
  const double in_grains = after.kinetic + after.elastic - before.elastic - zones.work.baseline;
  const double in_zones = zones.kinetic + zones.elastic;
  const double own = c.from == Side::Grains ? in_grains : in_zones;
  const double other = c.from == Side::Grains ? in_zones : in_grains;
  r.measured = {2 * own / start - 1, 2 * other / start};
  r.created = 2 * (in_grains + in_zones - start) / start;
  r.steps = run.zones.steps;
  r.grains = run.grains.grains;
  r.zones = run.zones.zones;
  r.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return r;
}

}  // namespace lockstep
