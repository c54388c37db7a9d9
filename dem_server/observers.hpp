// What a scene's block `measure` asks for, taken from the running model and written to files:
//   ball_N.csv                     a row every measure.interval steps: porosity, stress, coordination, fabric
//   fabric.csv, forces.csv         the same rows for all grains
//   tracked_N.csv                  a row every output.history_interval steps
//   grid_N_MMMM.vtu, grid_N.pvd, coordination_MMMM.csv, forces_MMMM.csv, mobilisation_MMMM.csv       with each snapshot
// It only looks: a run with it and one without it have the same bits. After a step grains stand at t_{n+1}: contacts
// of grains are those that overlap there, with the shear springs of t_n; contacts with facets, walls and pile are of
// t_n. The difference is one step's travel.
#pragma once
#include <filesystem>
#include <memory>
#include <optional>
#include <vector>

#include "common/results.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/measure.hpp"
#include "dem_server/settings.hpp"

namespace lockstep::dem {

// All contacts at one time; those of grains with grains come first.
struct ContactSurvey {
  std::vector<ContactView> contacts;
  std::size_t grain_pairs = 0;
  std::span<const ContactView> between_grains() const { return std::span(contacts).first(grain_pairs); }
};
ContactSurvey survey(const Model& model);
// Those of some bodies alone, `is_wanted` per body.
ContactSurvey survey(const Model& model, const std::vector<char>& is_wanted);

// Where grains could be: inside the packing's container, in front of all walls and outside the pile as they stand now.
// `model` must outlive what is returned.
Room room_of(const Model& model, const Settings& settings);

// A grain whose way is followed. The turn since the start is the product of all turns spin times step; that of a clump
// is read from its attitude, which is the same but for round-off.
class TrackedGrain {
 public:
  TrackedGrain(const Particles& particles, std::int32_t body);
  std::int32_t body() const { return body_; }
  // After each step, of `time_step` [s].
  void follow(const Particles& particles, double time_step);
  Vec3 displacement(const Particles& particles) const { return particles.position(body_) - start_; }  // [m]
  // Axis times angle of the turn since the start, at most pi [rad].
  Vec3 rotation(const Particles& particles) const;

 private:
  std::int32_t body_;
  Vec3 start_;                      // [m]
  Quat start_attitude_;             // body frame -> world
  Quat turned_ = Quat::Identity();  // of a sphere, which has no attitude
};

// The body that a scene means. InputError when there is none of that number, or no body at all.
std::int32_t find_tracked(const TrackedSettings& tracked, const Particles& particles);

// Cells of a grid with a room of at least `least_room`, as a ParaView file: porosity [-], room [-], stress (symmetric
// tensor, tension positive), pressure and deviator [Pa], contacts.
inline constexpr double least_room = 0.25;  // a sliver of room beside the pile holds a part of one grain: no mean
void write_grid(const std::filesystem::path& path, const CellGrid& grid, const std::vector<RegionSolid>& solid,
                const StressField& stress);

class Observers {
 public:
  // Files are opened at the first call of record or snapshot, when there are grains to look at.
  Observers(const Settings& settings, std::filesystem::path folder);
  ~Observers();

  // After each step.
  void record(const Model& model, double s_over_d);
  // `number` is that of the snapshot.
  void snapshot(const Model& model, int number);
  double seconds() const { return seconds_; }  // spent here, wall clock [s]

 private:
  void begin(const Model& model);
  void record_balls(const Model& model, const ContactSurvey& seen, double s_over_d);
  void record_fabric(const Model& model, const ContactSurvey& seen, double s_over_d);
  void record_forces(const Model& model, const ContactSurvey& seen, double s_over_d);
  void record_tracked(const Model& model, double s_over_d);
  void write_grids(const Model& model, const ContactSurvey& seen, int number);
  void write_distributions(const Model& model, const ContactSurvey& seen, int number);

  const Settings& settings_;
  std::filesystem::path folder_;
  bool has_begun_ = false;
  std::uint32_t steps_ = 0;  // recorded so far
  double diameter_ = 0;      // mean equivalent diameter at the start [m]
  double tip_start_ = 0;     // [m]
  std::vector<std::unique_ptr<History>> ball_rows_, tracked_rows_;
  std::unique_ptr<History> fabric_rows_, force_rows_;
  std::vector<TrackedGrain> tracked_;
  std::vector<char> is_tracked_;  // per body
  std::vector<CellGrid> grids_;
  std::vector<Series> grid_series_;
  double seconds_ = 0;  // [s]
};

}  // namespace lockstep::dem
