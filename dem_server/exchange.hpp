// The exchange of a coupled run: the peer moves the facets (paper step 5), and gets the forces on them (step 6).
//
// An exchange holds fidelity.exchange_interval steps of the grains (the first one: a single step), in which the facets go
// their way in equal parts and whose mean force is the answer, so that both sides see the same impulse.
//
// Both sides know the limit of the step: the ground's stiffness, told once, the contacts' as they stiffen, and the grains'
// own, with each answer (common/coupled_limit.hpp).
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "common/coupled_ledger.hpp"
#include "common/coupled_limit.hpp"
#include "dem_server/course.hpp"
#include "dem_server/cycle.hpp"
#include "dem_server/output.hpp"
#include "dem_server/settings.hpp"
#include "dem_server/watch.hpp"
#include "protocol/session.hpp"

namespace lockstep::dem {

class Exchange : public Boundary {
 public:
  // All of them outlive this.
  Exchange(protocol::Session& session, Model& model, const Settings& settings, Course& course, Output& output,
           Watch& watch);

  // Stage Excavate: what the grains' side of the step is, on the ground as it is left. Returns the grains' limit.
  const StepLimit& agree_on_step(const protocol::ContinuumExcavated& theirs);
  // From Apply on, until the peer ends the session.
  void run();
  const std::optional<CoupledLedger>& ledger() const { return ledger_; }

  bool move_facets(Model& model) override;
  void take_forces(Model& model) override;

 private:
  // After the cycle, while the answer is on its way.
  void take_stock();

  bool is_last_part() const { return part_ == exchange_parts_; }
  void check_peer() const;
  void add_forces();
  void take_mean();
  void tell_limit();
  void tell_stiffness();
  void book_exchange();
  StepLimit grains_limit() const;
  std::string culprit() const;

  protocol::Session& session_;
  Model& model_;
  const Settings& settings_;
  Course& course_;
  Output& output_;
  Watch& watch_;

  std::vector<double> told_stiffness_;  // per node, as the peer knows it [N/m]
  CoupledLimit told_limit_;  // as the peer knows it; of the grains alone with a peer that does not tell its own
  StepLimit limit_;          // of the grains, as of the last renewal

  const std::uint32_t parts_;         // of an exchange
  std::uint32_t exchange_parts_ = 0;  // of this one
  std::uint32_t part_ = 0;            // of this exchange, from 1
  double last_step_ = 0;              // time_step of the exchange before [s]
  protocol::Velocities velocities_;
  protocol::Forces forces_;
  std::optional<Energies> energies_;  // at the end of the last exchange
  std::optional<CoupledLedger> ledger_;
};

}  // namespace lockstep::dem
