#include "continuum_client/observers.hpp"

#include <fmt/ranges.h>
#include <algorithm>
#include <limits>
#include <utility>

#include "common/checks.hpp"

namespace lockstep::continuum {
namespace {

// The names of a table's columns, and one row's numbers in their order.
const std::vector<std::string> vector_names = {"x", "y", "z"}, tensor_names = {"xx", "yy", "zz", "xy", "yz", "zx"};

class Columns {
 public:
  Columns& add(const std::string& name) {
    names.push_back(name);
    return *this;
  }
  Columns& add(const std::string& quantity, const std::vector<std::string>& components, const std::string& unit) {
    for (const std::string& c : components) names.push_back(fmt::format("{} {} [{}]", quantity, c, unit));
    return *this;
  }
  std::vector<std::string> names;
};

template <class Vector>
void append(std::vector<double>& values, const Vector& more) {
  values.insert(values.end(), more.data(), more.data() + more.size());
}

std::string in_words(const Vec3& x) { return fmt::format("({:.10g})", fmt::join(x, ", ")); }

}  // namespace

Place place_of(const PointResult& point, const Grid& grid, const std::vector<char>& is_left) {
  if (const std::optional<Place> place = find_place(grid, is_left, point.at)) return *place;
  throw InputError(
      fmt::format("{}: {} m lies {}; the nearest place that is left is {} m, and the ground reaches from {} to {} m",
                  point.where, in_words(point.at),
                  find_place(grid, {}, point.at) ? "in zones that are deleted at Excavate" : "outside of the ground",
                  in_words(nearest_on_surface(grid, is_left, point.at)), in_words(grid.low), in_words(grid.high)));
}

Observers::Observers(const std::filesystem::path& folder, const ResultSettings& settings, const Grid& grid,
                     const std::vector<char>& is_left)
    : folder_(folder) {
  for (const PointResult& p : settings.points) points_.push_back({place_of(p, grid, is_left), nullptr});
  for (const SectionResult& s : settings.sections) {
    ObservedSection section{s.name,
                            cut_zones(grid, is_left, s.point, s.normal),
                            {},
                            Series(folder_ / fmt::format("section_{}.pvd", s.name))};
    if (section.cut.polygon.empty()) {
      const Vec3 unit = s.normal.normalized();
      double low = std::numeric_limits<double>::infinity(), high = -low;
      for (const Vec3& x : grid.node) low = std::min(low, unit.dot(x)), high = std::max(high, unit.dot(x));
      throw InputError(
          fmt::format("{}: the plane through {} m across {} cuts no zone that is left; along its normal it is at "
                      "{:.6g} m and the ground "
                      "reaches from {:.6g} to {:.6g} m; move its point",
                      s.where, in_words(s.point), in_words(s.normal), unit.dot(s.point), low, high));
    }
    for (const CutPoint& p : section.cut.point) section.position.push_back(p.interpolate(grid.node));
    sections_.push_back(std::move(section));
  }
  for (const LineResult& l : settings.lines) {
    ObservedLine line{l.name, {}, {}, {}};
    for (int n = 0; n < l.points; ++n) {
      const double share = static_cast<double>(n) / (l.points - 1);
      const Vec3 x = (1 - share) * l.begin + share * l.end;
      const std::optional<Place> place = find_place(grid, is_left, x);
      if (!place) continue;
      line.way.push_back(share * (l.end - l.begin).norm());
      line.place.push_back(*place);
      line.position.push_back(x);
    }
    if (line.place.empty())
      throw InputError(
          fmt::format("{}: none of the {} points from {} to {} m lies in zones that are left; the place that is "
                      "nearest to its begin is "
                      "{} m, and the ground reaches from {} to {} m",
                      l.where, l.points, in_words(l.begin), in_words(l.end),
                      in_words(nearest_on_surface(grid, is_left, l.begin)), in_words(grid.low), in_words(grid.high)));
    lines_.push_back(std::move(line));
  }
  if (folder_.empty()) return;
  for (std::size_t n = 0; n < points_.size(); ++n)
    points_[n].rows = std::make_unique<History>(folder_ / fmt::format("point_{}.csv", settings.points[n].name),
                                                Columns()
                                                    .add("step [-]")
                                                    .add("time [s]")
                                                    .add("displacement", vector_names, "m")
                                                    .add("velocity", vector_names, "m/s")
                                                    .add("stress", tensor_names, "Pa")
                                                    .add("strain", tensor_names, "-")
                                                    .add("unbalanced force", vector_names, "N")
                                                    .names);
}

void Observers::add_rows(const CoupledGround& g, const InitialState& initial) {
  for (const ObservedPoint& p : points_) {
    const auto zone = static_cast<std::size_t>(p.place.zone);
    std::vector<double> row = {static_cast<double>(g.step), g.time};
    append(row, p.place.interpolate(g.grid, g.motion.displacement));
    append(row, p.place.interpolate(g.grid, g.motion.velocity));
    append(row, to_voigt(g.zone_stress(initial, zone)));
    append(row, to_voigt(g.zone_strain(zone)));
    append(row, g.unbalanced_force(static_cast<std::size_t>(p.place.nearest_node(g.grid))));
    p.rows->add(row);
  }
}

void Observers::add_snapshot(const CoupledGround& g, const InitialState& initial, int number) {
  for (ObservedSection& section : sections_) write_section(g, initial, section, number);
  for (const ObservedLine& line : lines_) write_line(g, initial, line, number);
}

void Observers::write_section(const CoupledGround& g, const InitialState& initial, ObservedSection& section,
                              int number) {
  Field displacement{"displacement [m]", 3, {}}, velocity{"velocity [m/s]", 3, {}};
  Field stress{"stress xx yy zz xy yz zx [Pa]", 6, {}}, strain{"strain xx yy zz xy yz zx [-]", 6, {}};
  for (const CutPoint& p : section.cut.point) {
    append(displacement.values, p.interpolate(g.motion.displacement));
    append(velocity.values, p.interpolate(g.motion.velocity));
  }
  for (const std::int32_t z : section.cut.zone) {
    append(stress.values, to_voigt(g.zone_stress(initial, static_cast<std::size_t>(z))));
    append(strain.values, to_voigt(g.zone_strain(static_cast<std::size_t>(z))));
  }
  const std::string name = fmt::format("section_{}_{:04d}.vtp", section.name, number);
  write_vtp_polygons(folder_ / name, section.position, section.cut.polygon, {displacement, velocity}, {stress, strain});
  section.series.add(g.time, name);
}

void Observers::write_line(const CoupledGround& g, const InitialState& initial, const ObservedLine& line, int number) {
  History rows(folder_ / fmt::format("line_{}_{:04d}.csv", line.name, number),
               Columns()
                   .add("distance [m]")
                   .add("position", vector_names, "m")
                   .add("displacement", vector_names, "m")
                   .add("stress", tensor_names, "Pa")
                   .add("strain", tensor_names, "-")
                   .names);
  for (std::size_t n = 0; n < line.place.size(); ++n) {
    const Place& place = line.place[n];
    const auto zone = static_cast<std::size_t>(place.zone);
    std::vector<double> row = {line.way[n]};
    append(row, line.position[n]);
    append(row, place.interpolate(g.grid, g.motion.displacement));
    append(row, to_voigt(g.zone_stress(initial, zone)));
    append(row, to_voigt(g.zone_strain(zone)));
    rows.add(row);
  }
}

}  // namespace lockstep::continuum
