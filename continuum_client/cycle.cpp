// The explicit cycle of the ground, leap-frog: x and u at t_n, v at t_(n-1/2) on entry. The grains work while the
// ground does: they start on F(n) when they have v(n-1/2), and on their own contacts when they have sent F(n).
#include "continuum_client/cycle.hpp"

namespace lockstep::continuum {

void cycle(CoupledGround& ground, protocol::Session& peer) {
  ground.send_velocities(peer);      // v(n-1/2) of the interface: paper step 5
  ground.compute_internal_forces();  // f0 + K u(n), while the grains find their contacts
  ground.load_surface();             // tractions of the scene, if any
  ground.receive_forces(peer);       // F(n) on the interface's nodes: paper step 6, eq. 13
  ground.book_exchange();            // action, reaction, works and energies of both sides
  ground.fade_baseline();            // what is left of the deleted zones, during Apply
  ground.advance();                  // v(n+1/2), u(n+1), x(n+1): paper step 7, eqs 14 and 17
  ground.guard_step();               // the step that n+1 will take
}

}  // namespace lockstep::continuum
