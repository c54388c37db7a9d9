// What a scene's block `continuum.results` asks for beside the zones' files, taken from the running ground:
//   point_NAME.csv                              a row with each row of the history
//   section_NAME_MMMM.vtp, section_NAME.pvd     with each snapshot
//   line_NAME_MMMM.csv                          with each snapshot
// It only looks: a run with it and one without it have the same bits. Places are found once, in the mesh before it moved.
//
// When a quantity lives. After a step displacement is at t_{n+1} and velocity at t_{n+1/2}. Stress and strain of the assembled
// route are those of that displacement; the incremental route's are of t_n, where its last forces were found. Unbalanced
// force and reactions are of t_n.
#pragma once
#include <filesystem>
#include <memory>
#include <optional>
#include <vector>

#include "common/results.hpp"
#include "continuum_client/cycle.hpp"
#include "continuum_client/section.hpp"
#include "continuum_client/settings.hpp"
#include "continuum_client/zone_map.hpp"

namespace lockstep::continuum {

// Where a scene's point lies among the zones that are left. InputError naming the key, what holds the point instead, and the
// nearest place that would do.
Place place_of(const PointResult& point, const Grid& grid, const std::vector<char>& is_left);

class Observers {
 public:
  // Opens the points' files. Without a folder places are looked up, and nothing is written. InputError for a point, a plane or
  // a whole line outside of the zones with is_left.
  Observers(const std::filesystem::path& folder, const ResultSettings& settings, const Grid& grid,
            const std::vector<char>& is_left);

  void add_rows(const CoupledGround& ground, const InitialState& initial);
  void add_snapshot(const CoupledGround& ground, const InitialState& initial, int number);

 private:
  struct ObservedPoint {
    Place place;
    std::unique_ptr<History> rows;  // none without a folder
  };
  struct ObservedSection {
    std::string name;
    Section cut;
    Vec3s position;  // of its points [m]
    Series series;
  };
  struct ObservedLine {
    std::string name;
    std::vector<double> way;  // from its begin to those of its points that lie in the ground [m]
    std::vector<Place> place;
    Vec3s position;  // [m]
  };

  void write_section(const CoupledGround& ground, const InitialState& initial, ObservedSection& section, int number);
  void write_line(const CoupledGround& ground, const InitialState& initial, const ObservedLine& line, int number);

  std::filesystem::path folder_;
  std::vector<ObservedPoint> points_;
  std::vector<ObservedSection> sections_;
  std::vector<ObservedLine> lines_;
};

}  // namespace lockstep::continuum
