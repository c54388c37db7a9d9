// The pile, all seven stages, with few and large grains so that it takes seconds: what must hold whatever the grains
// do.
#include <catch2/catch.hpp>
#include <cmath>

#include "tests/coupled/coupled_fixture.hpp"

namespace lockstep::coupled {

TEST_CASE("a small pile goes through all seven stages and every balance closes") {
  // Grains 1.8 times the paper's size: some 1,370 clumps, 2.4 across the pile.
  const Reports r = run_in_process(
      "pile_quick", {"fidelity.particle_scale=1.8", "fidelity.pile_velocity=0.5", "fidelity.mesh_refinement=0.75",
                     "pile.penetration=0.1", "grains.packing.cube_grains=400", "balance.tolerance=5e-3",
                     "balance.max_servo_travel=0.2"});
  CAPTURE(r.grains.grains, r.grains.steps, r.grains.tip_resistance, r.grains.shaft_force, r.grains.ring_mismatch,
          r.grains.bottom_mismatch);
  CAPTURE(r.grains.energy_residual, r.zones.ledger_residual_fraction, r.grains.worst_vertical_imbalance,
          r.grains.worst_action_reaction);
  CAPTURE(r.zones.jump.largest, r.zones.jump.force_difference, r.zones.excavation_residual);
  CHECK(r.grains.grains == Approx(8000 / std::pow(1.8, 3)).epsilon(0.02));

  // Stage 1: gravity alone gives sigma_v = rho g z and K0 = nu / (1 - nu).
  CHECK(r.zones.k0 == Approx(0.3 / 0.7).epsilon(1e-6));
  // Stage 2: each ring and the tip carry what was handed over, within 2 % and 0.5 kPa; the bottom carries weight and
  // tip.
  CHECK(r.grains.ring_mismatch < 1);
  CHECK(r.grains.bottom_mismatch < 1);
  // Stage 3: the deleted zones' reaction takes their place exactly.
  CHECK(r.zones.excavation_residual < 1e-10);
  // Stage 4: the hand-off moves the interface by far less than a grain (R = 50 mm).
  CHECK(r.zones.jump.largest < 0.05 * 0.050);
  // Stages 5 to 7.
  CHECK(r.grains.s_over_d == Approx(0.1).epsilon(0.01));
  CHECK(r.grains.tip_resistance > 16e3);  // more than the ground's own stress at that depth
  CHECK(r.grains.shaft_force > 0);        // the shaft is held up by what it drags down
  // Guarantees: action = reaction and the vertical balance to round-off, each step; the energy ledger.
  CHECK(r.grains.worst_action_reaction < 1e-13);
  CHECK(r.grains.worst_vertical_imbalance < 1e-12);
  CHECK(std::abs(r.grains.energy_residual) < 5e-3);
  CHECK(std::abs(r.zones.ledger_residual_fraction) < 1e-12);
}

}  // namespace lockstep::coupled
