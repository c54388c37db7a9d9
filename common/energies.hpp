// Energies of one side of a coupled run, as both sides book them and tell each other.
#pragma once

namespace lockstep {

// At t_n [J]; work is counted from the start of Apply, and positive adds energy to that side.
struct Energies {
  double kinetic = 0;         // 1/2 m v(n-1/2) v(n+1/2), translation and rotation
  double elastic = 0;         // strain energy of zones, or of contact springs
  double gravity_work = 0;    // done by gravity on this side
  double damped = 0;          // taken out by damping
  double friction = 0;        // taken out by sliding
  double boundary_work = 0;   // done by the pile, by supports or by what fades out on this side
  double interface_work = 0;  // done by the interface on this side

  double stored() const { return kinetic + elastic; }
  double gained() const { return gravity_work + boundary_work + interface_work; }
  double lost() const { return damped + friction; }
  // Constant in exact arithmetic, whatever is done to this side.
  double balance() const { return stored() - gained() + lost(); }
};

}  // namespace lockstep
