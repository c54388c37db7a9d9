// A wave packet sent against the interface of grains and zones in the real coupled program, and the exact answer to it.
//
//      fixed layer  ---------------     The packet is a starting velocity (scene.proto, Packet), which parts into two
//      of grains     o o o o o o o      packets of half the energy, exactly alike. One meets the interface, the other
//                    o o o o o o o      goes away from it; the run ends when the first has been reflected and passed
//      packet -->    o o o o o o o      on, and before anything comes back from the ends:
//                    o o o o o o o        reflected   = (energy left on the packet's side - E/2) / (E/2)
//      interface    #-#-#-#-#-#-#-#       transmitted =  energy on the other side / (E/2)
//                   #-#-#-#-#-#-#-#       created     = (energy of both - E) / (E/2)
//      held bottom  ---------------     E the energy of the start, all of it kinetic.
//
// Energies are those of the two ledgers. A preload of the springs keeps spheres in touch; its energy is that of the
// start, and what the constant baseline force of the interface does is the work of that preload.
//
// MATCHED. A column of cubes of side d, one sphere each (mass m, spring k up and down), has at long waves the speed
// d sqrt(k/m) and the impedance sqrt(k m). Zones of area A = d^2, modulus C and density rho have sqrt(C / rho) and
// A sqrt(rho C). Both agree for rho = m / d^3 and C = k / d: the lattice's own modulus and density. An impedance ratio
// multiplies both.
//
//   Pressure  along z: C = E (1-nu)/((1+nu)(1-2nu)), k = k_n, sides of the zones on rollers
//   Shear     motion along y: C = G, k = k_s; nodes held along x and z, spins held
//   Oblique   motion along y in a strip with free sides x = +-W/2, k_s between columns too, spins held: the lattice is then
//             as isotropic for this motion as the zones, and matched at all angles. The strip is W = pi/p wide, so that
//             cos(p (x + W/2)), the sum of waves from both sides, is its own first mode: free sides mirror it, in lattice
//             and mesh exactly, and no edge is seen. Zones are B_BAR, whose gradients are those of interface_waves.hpp.
//
// Spheres that are free to turn have no shear stiffness in one column (they roll), which is why spins are held.
#pragma once
#include <string>

#include "tools/in_process.hpp"
#include "tools/interface_waves.hpp"

namespace lockstep {

enum class WaveKind { Pressure, Shear, Oblique };

struct ReflectionCase {
  WaveKind kind = WaveKind::Pressure;
  Side from = Side::Grains;
  int grains_per_zone = 1;     // h/d
  double zones_per_wave = 10;  // wavelength over h; of a hump its length
  double impedance_ratio = 1;  // zones over grains
  double angle = 0;      // of the wave's way to the normal; met where zones_per_wave / 2 sin(angle) is whole [rad]
  bool is_hump = false;  // the bounding hump alone
  double step_fraction = 0.5;  // of the stable step
};

struct ReflectionResult {
  double angle = 0;         // as it is, of the long wave [rad]
  EnergyShares exact;       // of the packet
  EnergyShares at_center;   // of its middle wave number alone; of a hump: none
  EnergyShares measured;    // in the run
  double created = 0;       // over the energy that comes in
  double ground_speed = 0;  // of long waves [m/s]
  std::uint64_t steps = 0;
  std::size_t grains = 0, zones = 0;
  double seconds = 0;  // wall clock
};

// The model that interface_waves.hpp solves for this case, and the scene that both programs read.
InterfaceModel interface_model(const ReflectionCase& c);
std::string scene_text(const ReflectionCase& c);

// Grains and zones times seconds of its run: what its wall time goes with.
double work_of(const ReflectionCase& c);

ReflectionResult exact_reflection(const ReflectionCase& c);
// Runs it. Throws as the two programs do.
ReflectionResult measure_reflection(const ReflectionCase& c);

}  // namespace lockstep
