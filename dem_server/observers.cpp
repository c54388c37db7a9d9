#include "dem_server/observers.hpp"

#include <algorithm>
#include <chrono>
#include <limits>

#include "common/checks.hpp"

namespace lockstep::dem {

namespace {

using Columns = std::vector<std::string>;
using Row = std::vector<double>;

constexpr double points_a_diameter = 8;  // in balls, where points are counted at all; grids have a key for it

Columns six(const std::string& name, const std::string& unit) {
  Columns columns;
  for (const char* part : {"xx", "yy", "zz", "xy", "yz", "zx"})
    columns.push_back(fmt::format("{} {}{}", name, part, unit));
  return columns;
}

Columns three(const std::string& name, const std::string& unit) {
  Columns columns;
  for (const char* part : {"x", "y", "z"}) columns.push_back(fmt::format("{} {}{}", name, part, unit));
  return columns;
}

Columns joined(std::initializer_list<Columns> parts) {
  Columns all;
  for (const Columns& part : parts) all.insert(all.end(), part.begin(), part.end());
  return all;
}

const Columns clock_columns = {"step", "time [s]", "S/D"};
const Columns fabric_columns = joined({{"bodies", "coordination", "mechanical coordination", "rattlers", "contacts"},
                                       six("fabric", ""),
                                       {"fabric deviator", "fabric anisotropy"}});

Row clock_of(const Model& m, double s_over_d) { return {static_cast<double>(m.step), m.time, s_over_d}; }

void append(Row& row, std::initializer_list<double> values) {
  for (const double v : values) row.push_back(v);
}
void append(Row& row, const Voigt& v) {
  for (const double x : v) row.push_back(x);
}
void append(Row& row, const Vec3& v) {
  for (const double x : v) row.push_back(x);
}
void append(Row& row, const PartnerCounts& partners, const Fabric& fabric) {
  append(row, {static_cast<double>(partners.bodies()), partners.mean(), partners.mechanical_mean(),
               static_cast<double>(partners.rattlers()), static_cast<double>(fabric.contacts())});
  append(row, fabric.tensor());
  append(row, {fabric.deviator(), fabric.anisotropy()});
}

PartnerCounts partners_of(const Model& m, const ContactSurvey& seen) {
  Coordination coordination(m.particles.body_count());
  for (const ContactView& c : seen.contacts) coordination.add(c);
  return coordination.partners();
}

// What the packing may fill, or the pebbles' own extent in scenes without a container.
Box extent_of(const Model& m, const Settings& settings) {
  if (settings.packing) {
    const Container& c = settings.packing->container;
    const bool is_round = c.kind == Container::Kind::Cylinder;
    const double x = is_round ? c.radius : c.half_x, y = is_round ? c.radius : c.half_y;
    return {{-x, -y, c.bottom}, {x, y, c.top}};
  }
  Box box{Vec3::Constant(std::numeric_limits<double>::infinity()),
          Vec3::Constant(-std::numeric_limits<double>::infinity())};
  for (std::size_t p = 0; p < m.particles.pebble_count(); ++p) {
    const Vec3 x = m.particles.pebble_center(p), radius = Vec3::Constant(m.particles.pebble_radius(p));
    box.low = box.low.cwiseMin(x - radius);
    box.high = box.high.cwiseMax(x + radius);
  }
  return box;
}

class Stopwatch {
 public:
  explicit Stopwatch(double& seconds) : seconds_(seconds) {}
  ~Stopwatch() { seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count(); }
  Stopwatch(const Stopwatch&) = delete;
  Stopwatch& operator=(const Stopwatch&) = delete;

 private:
  double& seconds_;
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
};

void write_histogram(const std::filesystem::path& path, const std::string& what, const Histogram& h) {
  History rows(path, {what + " from", what + " to", "contacts", "density"});
  for (std::size_t n = 0; n < h.counts.size(); ++n)
    rows.add({static_cast<double>(n) * h.bin_width, static_cast<double>(n + 1) * h.bin_width,
              static_cast<double>(h.counts[n]), h.density(n)});
}

}  // namespace

// -------------------------------------------------------------------------------------------------------- what is seen

ContactSurvey survey(const Model& m) {
  ContactSurvey seen;
  const auto add = [&](const ContactView& c) { seen.contacts.push_back(c); };
  m.contacts.for_each_contact(m.particles, add);
  seen.grain_pairs = seen.contacts.size();
  m.facets.for_each_contact(add);
  m.walls.for_each_contact(add);
  if (m.pile) m.pile->for_each_contact(add);
  return seen;
}

ContactSurvey survey(const Model& m, const std::vector<char>& is_wanted) {
  ContactSurvey seen;
  const auto add = [&](const ContactView& c) { seen.contacts.push_back(c); };
  m.contacts.for_each_contact_of(m.particles, is_wanted, add);
  seen.grain_pairs = seen.contacts.size();
  const auto add_wanted = [&](const ContactView& c) {
    if (is_wanted[static_cast<std::size_t>(c.body_a)]) add(c);
  };
  m.facets.for_each_contact(add_wanted);
  m.walls.for_each_contact(add_wanted);
  if (m.pile) m.pile->for_each_contact(add_wanted);
  return seen;
}

Room room_of(const Model& m, const Settings& settings) {
  return [&m, &settings](const Vec3& x) {
    // Alone, the walls are the container, and may have moved since the packing was made in it.
    if (settings.packing && !settings.is_alone && settings.packing->container.depth_inside(x) < 0) return false;
    return !m.walls.is_behind(x) && (!m.pile || m.pile->closest(x).distance > 0);
  };
}

// ------------------------------------------------------------------------------------------------------ tracked grains

TrackedGrain::TrackedGrain(const Particles& particles, std::int32_t body)
    : body_(body), start_(particles.position(body)), start_attitude_(particles.orientation(body)) {}

void TrackedGrain::follow(const Particles& particles, double time_step) {
  const Vec3 turn = particles.spin(body_) * time_step;
  if (const double angle = turn.norm(); angle > 0)
    turned_ = (Quat(Eigen::AngleAxisd(angle, turn / angle)) * turned_).normalized();
}

Vec3 TrackedGrain::rotation(const Particles& particles) const {
  const bool is_sphere = particles.pebble_end(body_) - particles.pebble_begin(body_) == 1;
  const Eigen::AngleAxisd turn(is_sphere ? turned_ : Quat(particles.orientation(body_) * start_attitude_.conjugate()));
  return turn.angle() <= pi ? Vec3(turn.angle() * turn.axis()) : Vec3((turn.angle() - 2 * pi) * turn.axis());
}

std::int32_t find_tracked(const TrackedSettings& tracked, const Particles& particles) {
  const std::size_t bodies = particles.body_count();
  if (bodies == 0)
    throw InputError(fmt::format("{}: the scene has no grain to follow; leave the block out", tracked.where));
  if (tracked.grain) {
    if (*tracked.grain >= bodies)
      throw InputError(
          fmt::format("{}.grain = {} is out of range [0, {}]: the "
                      "packing has {} grains; give one of them, "
                      "or near {{ x y z }}",
                      tracked.where, *tracked.grain, bodies - 1, bodies));
    return static_cast<std::int32_t>(*tracked.grain);
  }
  std::size_t nearest = 0;
  for (std::size_t b = 1; b < bodies; ++b)
    if ((particles.position(b) - tracked.near).squaredNorm() <
        (particles.position(nearest) - tracked.near).squaredNorm())
      nearest = b;
  return static_cast<std::int32_t>(nearest);
}

// --------------------------------------------------------------------------------------------------------------- begin

Observers::Observers(const Settings& settings, std::filesystem::path folder)
    : settings_(settings), folder_(std::move(folder)) {}

Observers::~Observers() = default;

void Observers::begin(const Model& m) {
  has_begun_ = true;
  const MeasureSettings& asked = settings_.measure;
  diameter_ = 2 * m.particles.mean_radius();
  tip_start_ = m.pile ? m.pile->tip_z() : 0.0;
  const auto open = [&](const std::string& name, const Columns& columns) {
    return std::make_unique<History>(folder_ / name, joined({clock_columns, columns}));
  };
  for (std::size_t n = 0; n < asked.balls.size(); ++n)
    ball_rows_.push_back(open(fmt::format("ball_{}.csv", n), joined({three("center", " [m]"),
                                                                     {"radius [m]", "room", "porosity"},
                                                                     six("stress", " [Pa]"),
                                                                     {"pressure [Pa]", "deviator [Pa]"},
                                                                     fabric_columns})));
  if (asked.fabric) fabric_rows_ = open("fabric.csv", fabric_columns);
  if (asked.force_network)
    force_rows_ = open("forces.csv", {"contacts", "mean normal force [N]", "largest over mean", "strong contacts",
                                      "carried by strong contacts", "mean mobilisation", "sliding contacts"});
  for (const TrackedSettings& tracked : asked.tracked) {
    tracked_rows_.push_back(
        open(fmt::format("tracked_{}.csv", tracked_rows_.size()), joined({{"grain"},
                                                                          three("position", " [m]"),
                                                                          three("displacement", " [m]"),
                                                                          three("velocity", " [m/s]"),
                                                                          three("spin", " [rad/s]"),
                                                                          three("rotation", " [rad]"),
                                                                          three("contact force", " [N]"),
                                                                          {"contact force sum [N]", "partners"}})));
    tracked_.emplace_back(m.particles, find_tracked(tracked, m.particles));
  }
  is_tracked_.assign(m.particles.body_count(), 0);
  for (const TrackedGrain& grain : tracked_) is_tracked_[static_cast<std::size_t>(grain.body())] = 1;
  for (const GridSettings& grid : asked.grids) {
    if (m.particles.body_count() == 0)
      throw InputError(fmt::format("{}: the scene has no grains to measure; leave the block out", grid.where));
    try {
      grids_.emplace_back(grid.box ? *grid.box : extent_of(m, settings_), grid.cell * diameter_);
    } catch (const InputError& error) {
      throw InputError(fmt::format("{}: {}", grid.where, error.what()));
    }
    grid_series_.emplace_back(folder_ / fmt::format("grid_{}.pvd", grid_series_.size()));
  }
}

// ---------------------------------------------------------------------------------------------------------------- rows

void Observers::record(const Model& m, double s_over_d) {
  const Stopwatch timing(seconds_);
  if (!has_begun_) begin(m);
  ++steps_;
  for (TrackedGrain& grain : tracked_) grain.follow(m.particles, m.last_time_step);
  const MeasureSettings& asked = settings_.measure;
  const bool has_rows = !asked.balls.empty() || asked.fabric || asked.force_network;
  if (!tracked_.empty() && steps_ % settings_.history_interval == 0) record_tracked(m, s_over_d);
  if (!has_rows || steps_ % asked.interval != 0) return;
  const ContactSurvey seen = survey(m);
  record_balls(m, seen, s_over_d);
  if (fabric_rows_) record_fabric(m, seen, s_over_d);
  if (force_rows_) record_forces(m, seen, s_over_d);
}

void Observers::record_balls(const Model& m, const ContactSurvey& seen, double s_over_d) {
  if (settings_.measure.balls.empty()) return;
  const PartnerCounts partners = partners_of(m, seen);
  const Room room = room_of(m, settings_);
  for (std::size_t n = 0; n < ball_rows_.size(); ++n) {
    Ball ball = settings_.measure.balls[n].ball;
    if (settings_.measure.balls[n].follows_pile) ball.center.z() += m.pile->tip_z() - tip_start_;
    const RegionSolid solid = solid_share(m.particles, seen.between_grains(), ball,
                                          std::min(diameter_, 2 * ball.radius) / points_a_diameter, room);
    MeanStress<Ball> stress(ball);
    Fabric fabric;
    for (const ContactView& c : seen.contacts) {
      stress.add(c, m.particles);
      if (ball.contains(c.point)) fabric.add(c);
    }
    const Voigt mean = solid.room > 0 ? stress.stress(solid.room) : Voigt::Zero();
    Row row = clock_of(m, s_over_d);
    append(row, ball.center);
    append(row, {ball.radius, solid.room, solid.porosity()});
    append(row, mean);
    append(row, {pressure_of(mean), deviator_of(mean)});
    append(row, partners.of([&](std::size_t b) { return ball.contains(m.particles.position(b)); }), fabric);
    ball_rows_[n]->add(row);
  }
}

void Observers::record_fabric(const Model& m, const ContactSurvey& seen, double s_over_d) {
  Fabric fabric;
  for (const ContactView& c : seen.contacts) fabric.add(c);
  Row row = clock_of(m, s_over_d);
  append(row, partners_of(m, seen), fabric);
  fabric_rows_->add(row);
}

void Observers::record_forces(const Model& m, const ContactSurvey& seen, double s_over_d) {
  const ForceNetwork n = force_network(seen.between_grains(), m.material.friction);
  Row row = clock_of(m, s_over_d);
  append(row, {static_cast<double>(n.contacts), n.mean_normal_force, n.largest_over_mean, n.strong_share,
               n.strong_force_share, n.mean_mobilisation, n.sliding_share});
  force_rows_->add(row);
}

void Observers::record_tracked(const Model& m, double s_over_d) {
  const Particles& p = m.particles;
  const ContactSurvey seen = survey(m, is_tracked_);
  for (std::size_t n = 0; n < tracked_.size(); ++n) {
    const std::int32_t body = tracked_[n].body();
    Coordination coordination(p.body_count());
    Vec3 force = Vec3::Zero();
    double sum = 0;
    for (const ContactView& c : seen.contacts) {
      if (c.body_a != body && c.body_b != body) continue;
      coordination.add(c);
      force += c.body_a == body ? c.force_on_a : Vec3(-c.force_on_a);
      sum += c.force_on_a.norm();
    }
    Row row = clock_of(m, s_over_d);
    row.push_back(body);
    append(row, Vec3(p.position(body)));
    append(row, tracked_[n].displacement(p));
    append(row, Vec3(p.velocity(body)));
    append(row, Vec3(p.spin(body)));
    append(row, tracked_[n].rotation(p));
    append(row, force);
    append(row, {sum, static_cast<double>(coordination.partners_of(body))});
    tracked_rows_[n]->add(row);
  }
}

// ----------------------------------------------------------------------------------------------------------- snapshots

void Observers::snapshot(const Model& m, int number) {
  const Stopwatch timing(seconds_);
  if (!has_begun_) begin(m);
  const MeasureSettings& asked = settings_.measure;
  if (grids_.empty() && !asked.fabric && !asked.force_network) return;
  const ContactSurvey seen = survey(m);
  write_grids(m, seen, number);
  write_distributions(m, seen, number);
}

void Observers::write_grids(const Model& m, const ContactSurvey& seen, int number) {
  for (std::size_t n = 0; n < grids_.size(); ++n) {
    StressField stress(grids_[n]);
    for (const ContactView& c : seen.contacts) stress.add(c, m.particles);
    const std::string name = fmt::format("grid_{}_{:04d}.vtu", n, number);
    write_grid(folder_ / name, grids_[n],
               solid_shares(m.particles, seen.between_grains(), grids_[n],
                            diameter_ / settings_.measure.grids[n].points, room_of(m, settings_)),
               stress);
    grid_series_[n].add(m.time, name);
  }
}

void Observers::write_distributions(const Model& m, const ContactSurvey& seen, int number) {
  if (settings_.measure.fabric) {
    const PartnerCounts partners = partners_of(m, seen);
    History rows(folder_ / fmt::format("coordination_{:04d}.csv", number), {"partners", "bodies", "share"});
    const std::vector<std::size_t> bodies = partners.distribution();
    for (std::size_t k = 0; k < bodies.size(); ++k)
      rows.add({static_cast<double>(k), static_cast<double>(bodies[k]),
                static_cast<double>(bodies[k]) / static_cast<double>(partners.bodies())});
  }
  if (settings_.measure.force_network) {
    const ForceNetwork n = force_network(seen.between_grains(), m.material.friction);
    write_histogram(folder_ / fmt::format("forces_{:04d}.csv", number), "normal force over mean", n.normal_force);
    write_histogram(folder_ / fmt::format("mobilisation_{:04d}.csv", number), "mobilisation", n.mobilisation);
  }
}

void write_grid(const std::filesystem::path& path, const CellGrid& grid, const std::vector<RegionSolid>& solid,
                const StressField& stress) {
  Vec3s corners;
  std::vector<std::array<std::int32_t, 8>> cells;
  Field porosity{"porosity", 1, {}}, room{"room", 1, {}}, tensor{"stress", 6, {}}, pressure{"pressure", 1, {}},
      deviator{"deviator", 1, {}}, contacts{"contacts", 1, {}};
  const auto& count = grid.count();
  for (int k = 0; k < count[2]; ++k)
    for (int j = 0; j < count[1]; ++j)
      for (int i = 0; i < count[0]; ++i) {
        const std::size_t c = grid.index(i, j, k);
        if (solid[c].room < least_room) continue;
        const Box box = grid.cell(i, j, k);
        const auto first = static_cast<std::int32_t>(corners.size());
        for (const double z : {box.low.z(), box.high.z()})
          for (const auto& [x, y] : {std::pair(box.low.x(), box.low.y()), std::pair(box.high.x(), box.low.y()),
                                     std::pair(box.high.x(), box.high.y()), std::pair(box.low.x(), box.high.y())})
            corners.emplace_back(x, y, z);
        cells.push_back({first, first + 1, first + 2, first + 3, first + 4, first + 5, first + 6, first + 7});
        const Voigt s = stress.stress(c, solid[c].room);
        porosity.values.push_back(solid[c].porosity());
        room.values.push_back(solid[c].room);
        append(tensor.values, s);
        pressure.values.push_back(pressure_of(s));
        deviator.values.push_back(deviator_of(s));
        contacts.values.push_back(static_cast<double>(stress.contacts(c)));
      }
  write_vtu_hexahedra(path, corners, cells, {}, {porosity, room, tensor, pressure, deviator, contacts});
}

}  // namespace lockstep::dem
