// The packing: a periodic cube of grains at a given porosity, and bricks of it that fill a space.
//
//   insert at random, half size -> grow in a periodic cell -> squeeze to the pressure -> compact -> let down
//        (overlaps pushed out)       (drag: a gas of grains     with friction mu_prep    to the      to a few
//                                     spins and flies)          (growth is the servo)    porosity    kPa
//
// The friction while packing sets the porosity. A table per shape gives the friction to begin with, for a porosity a
// little above the one asked for; then the friction is lowered under pressure, which makes contacts slip and the packing
// denser, until the porosity is there. A packing that came out too dense is made again with more friction. So every
// lowering works on one and the same packing, and the scatter between packings (0.003 with 500 grains, 0.01 with 150)
// cannot send the search in circles. Rejected: a secant on the friction with a new packing each time, which gave up on
// 4 to 12 % of the seeds of 150 to 250 grains.
//
// Packing at tens of kPa and letting down afterwards is quasi-static; packing straight to a few kPa stops on inertia.
// Rejected: growth in place in the cylinder (60 to 130 s of CPU for what bricks do in 20), pouring (slower still,
// unfinished).
#pragma once
#include <cstdint>
#include <functional>
#include <string_view>

#include "dem_server/contact_law.hpp"
#include "dem_server/particles.hpp"

namespace lockstep::dem {

struct CubeRequest {
  int grains = 1000;                // at least 50
  double radius_mean = 0.028;       // equivalent; of the grains that come out [m]
  double radius_ratio = 4.0 / 3.0;  // largest over smallest, uniform between [-]
  int pebbles = 3;                  // 1 to 9
  double elongation = 1.5;          // A/B
  double density = 2650;            // of the solid [kg/m3]
  double porosity = 0.37;           // bulk, at `pressure`
  double pressure = 50e3;           // of packing [Pa]
  double released_pressure = 2e3;   // after it was let down [Pa]
  GrainMaterial material;           // friction is for later; preparation chooses its own
  std::uint64_t seed = 1;
  int threads = 1;                                         // the bits do not depend on them
  std::function<void(std::string_view, double)> progress;  // what is done, and its fraction; may be empty
};

struct Cube {
  Particles particles;         // at rest, at the released pressure, inside 0..period
  Vec3 period = Vec3::Zero();  // [m]
  double porosity = 0;         // at the packing pressure
  double pressure = 0;         // that porosity was taken at [Pa]
  double released_porosity = 0;
  double released_pressure = 0;     // [Pa]
  double preparation_friction = 0;  // at the end of compaction [-]
  double coordination = 0;          // at the packing pressure
  int tries = 0;                    // packings made
  std::int64_t steps = 0;           // of all tries
};

struct PorosityRange {
  double low, high;
};

// What a shape reaches with preparation frictions from 0.02 to 0.7, and a little more. InputError for a shape that cannot be made.
PorosityRange reachable_porosity(int pebbles, double elongation);

// InputError, before any cycling, when the porosity is out of reach; NumericalError when the packing does not settle,
// or when no try comes within 0.005 of the porosity.
// The same request gives the same bits.
Cube make_cube(const CubeRequest& request);

// Copies of the cube, side by side, as many as fill the box: visits all bodies whose centre lies in it, by their number
// in the cube and the shift of their copy, lowest layer of cubes first. The first copy begins `lead` of a period before
// `low` (0 to 1 in each direction); copies are cut off at the box.
void for_each_tiled(const Cube& cube, const Vec3& low, const Vec3& high, const Vec3& lead,
                    const std::function<void(std::size_t body, const Vec3& shift)>& visit);
// Those bodies.
Particles tile(const Cube& cube, const Vec3& low, const Vec3& high, const Vec3& lead = Vec3::Zero());

}  // namespace lockstep::dem
