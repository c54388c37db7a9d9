// One time step of the grains. cycle.cpp is the place to start reading.
//
// The facets are the grains' boundary. Who moves them is a Boundary: the peer's velocities in a coupled run
// (exchange.hpp), the servo while the packing is balanced (servo.hpp). Both see the same step.
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "common/parallel.hpp"
#include "common/profile.hpp"
#include "dem_server/contacts.hpp"
#include "dem_server/integrator.hpp"
#include "dem_server/interface_facets.hpp"
#include "dem_server/ledger.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/timestep.hpp"
#include "dem_server/walls.hpp"

namespace lockstep::dem {

enum class Phase { WaitForPeer, Lists, InterfaceContacts, PairContacts, WallContacts, Motion, Ledger, Count };

struct Model {
  // `skin` of the contact list [m].
  explicit Model(double skin, int threads = 1, InstructionSet instructions = best_instructions())
      : team(std::make_unique<Team>(threads)), contacts(skin, {}, instructions) {}

  std::unique_ptr<Team> team;

  Particles particles;
  std::vector<char> is_fixed;   // per body: held in place; empty when none is
  Vec3 gravity = Vec3::Zero();  // [m/s2]
  double damping = 0;           // local, of force and torque

  GrainMaterial material;
  FacetMaterial facet_material;
  PairContacts contacts;
  InterfaceFacets facets;
  Walls walls;
  std::optional<Pile> pile;

  Detail detail = Detail::All;  // of the totals of the next step
  bool has_loads = false;       // forces were evaluated without a step: the next one starts by clearing them

  std::uint64_t step = 0;
  double time = 0;            // t_n [s]
  double last_time_step = 0;  // from n-1 to n [s]; 0 before the first step
  double time_step = 0;       // from n to n+1 [s]

  ContactTotals pair_totals;
  FacetTotals facet_totals;
  WallTotals wall_totals;
  PileTotals pile_totals;
  MotionTotals motion;
  Ledger ledger;
  StiffnessSum stiffness;  // stable_step() sums there
  Profile<Phase> profile;

  // Hash of everything that decides the future: poses, velocities, springs, facets, pile.
  std::uint64_t hash() const;
};

class Boundary {
 public:
  virtual ~Boundary() = default;
  // Brings the facets to t_n and sets model.time_step. False: the run is over, and nothing has been changed.
  virtual bool move_facets(Model& model) = 0;
  // The interface forces F(n) stand in model.facets.
  virtual void take_forces(Model& model) = 0;
};

// Facets that nobody moves, and steps of one length.
class Held : public Boundary {
 public:
  explicit Held(double step = 0) : time_step(step) {}
  bool move_facets(Model& model) override {
    model.time_step = time_step;
    return true;
  }
  void take_forces(Model&) override {}

  double time_step;  // [s]
};

// Advances from t_n to t_{n+1}; false when the boundary says that the run is over.
bool cycle(Model& model, Boundary& boundary);

// Forces at the present positions with nothing moving: brings contacts, totals and nodal forces up to date.
void evaluate_forces(Model& model);

// A stable step of the grains with their present contacts, walls, pile and facets included (timestep.hpp); never more
// than what one contact of each body with a facet would allow, so that a first touch is safe. `damping` is the largest
// local damping that the step must bear.
struct StepLimit {
  double step = 0;               // [s]
  std::int32_t worst_body = -1;  // -1: a first touch limits
  double touching_squared =
      0;  // omega^2 of contacts with facets alone, the largest of a body, a first touch included [1/s2]
};
StepLimit stable_step(Model& model, double damping);

}  // namespace lockstep::dem
