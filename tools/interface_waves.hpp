// What a harmonic wave does at the interface of a lattice of grains and a mesh of zones: the exact answer of the discrete
// equations, to compare runs with. Nothing here knows the solvers.
//
// One component of motion, periodic along x with the zones' width h = N d (d: pitch of the grains), up is +z:
//
//    u(i,1)  o   o   o     rows j = 0, 1, ... of grains, columns i = 0 .. N-1 at x_i = (i + 1/2) d: mass m, spring k to
//            |   |   |     the rows above and below, k_a to the columns beside
//    u(i,0)  o---o---o
//            |k_c|   |     contact spring to the facet, which node j moves by its weight at x_i
//    w(0)  #-----------#   rows l = 0, 1, ... of nodes, downwards: mass M a period (M/2 in row 0, lumped), a layer of zones
//    w(1)  #-----------#   between two rows
//
// TIME. A harmonic exp(-i w t) of leap-frog obeys a(n) = -W^2 u(n), W = 2 sin(w dt / 2) / dt, on both sides and at the
// interface alike. So W takes the place of w in all that follows, and the answer for a given wavelength does not depend on
// the step.
//
// GRAINS. u = B exp(i q x_i) exp(i s j d):      m W^2 = 4 k sin^2(s d / 2) + 4 k_a sin^2(q d / 2)                     (1)
// ZONES. w = C exp(i p x) exp(i r l h). A layer between rows has the energy 1/2 (w0* a w0 + w1* a w1 + w0* b w1 + w1* b
// w0) a period, a and b depending on p h alone:   M W^2 = 2 a + 2 b cos(r h)                                         (2)
//     one zone wide, p = 0:            a = -b = C A / h,   C the modulus of the wave (M or G), A the area
//     bilinear, motion along y (SH):   a = G t [(c + (1 - cos p h) 2/3],  b = G t [-c + (1 - cos p h)/3],
//                                      c = (2 + cos p h)/3, t the thickness: of the square zone's 2 x 2 points, the
//                                      gradient along z has the mass matrix along x, which gives c, and that along x the
//                                      one along z, 2/3 and 1/3 of (1 - cos p h)
// Rows couple p with all q = p + 2 pi n / h, n = 0 .. N-1, on the grains' side: of these mostly n = 0 travels, the
// others fade away from the interface.
//
// INTERFACE. In row 0 of the grains the spring to the row below is replaced by that to the facet; with the wave's own
// continuation u(i,-1) of (1) this is  k (u(i,-1) - u(i,0)) = k_c (s_i w(0) - u(i,0)),  s_i = 1 - e + e exp(i p h),
// e = x_i / h. In row 0 of the nodes  -1/2 M W^2 w(0) + a w(0) + b w(1) + k_c sum_i s_i* (s_i w(0) - u(i,0)) = 0.
// N + 1 equations for N amplitudes in the grains and one in the zones.
//
// ENERGY that a travelling wave carries through a row in a unit of time is w/2 times N k sin(s d) |B|^2 in the grains and
// -b sin(r h) |C|^2 in the zones: reflected and transmitted shares sum up to 1, since nothing damps.
#pragma once
#include <complex>
#include <functional>
#include <vector>

namespace lockstep {

enum class Side { Grains, Zones };

struct InterfaceModel {
  double pitch = 0;               // d [m]
  int columns = 1;                // N
  double mass = 0;                // m [kg]
  double spring = 0;              // k [N/m]
  double side_spring = 0;         // k_a [N/m]
  double contact = 0;             // k_c [N/m]
  double height = 0;              // of zones, along z [m]
  double row_mass = 0;            // M [kg]
  double layer_own = 0;           // a [N/m]
  double layer_next = 0;          // b [N/m]
  double wave_number_across = 0;  // p [1/m]

  // W^2 of the wave number along z on one side [1/s2], equations 1 and 2.
  double frequency_squared(Side side, double wave_number) const;
  // dW/ds or dW/dr there [m/s].
  double group_velocity(Side side, double wave_number) const;
};

struct EnergyShares {
  double reflected = 0, transmitted = 0;  // of the energy that comes in
};

// `wave_number` along z, above zero and below pi over the side's pitch or height, of the wave that comes from `side`.
EnergyShares energy_shares(const InterfaceModel& model, Side from, double wave_number);

// The same of a packet. `velocity` are the starting velocities of rows 0, 1, ... on its side; their spectrum weighs the
// wave numbers, each by its energy: at rest in the reference state the energy is all kinetic.
EnergyShares energy_shares(const InterfaceModel& model, Side from, const std::vector<double>& velocity);

}  // namespace lockstep
