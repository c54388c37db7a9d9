// What is measured on the grains. Every measure is a plain function, or a small class that contacts are added to, of
// the grains and their contacts (ContactView): tests, tools and the observers of a run (observers.hpp) use the same.
//
//   regions          boxes, balls, grids of cells
//   porosity         share of a region without grains
//   mean_stress      Love and Weber, of a region or of each cell
//   fabric           coordination number, rattlers, fabric tensor
//   force_network    distribution of forces, strong contacts, mobilised friction
#pragma once
#include "dem_server/fabric.hpp"
#include "dem_server/force_network.hpp"
#include "dem_server/mean_stress.hpp"
#include "dem_server/porosity.hpp"

namespace lockstep::dem {

// Mean unbalanced force of the bodies over the mean contact force [-]; infinite when bodies are out of balance and
// nothing touches, zero when neither is.
double unbalanced_ratio(double unbalanced_force_sum, std::size_t bodies, double contact_force_sum,
                        std::int64_t contacts);

// Kinetic energy in velocities and in spins as they stand, t_{n-1/2} [J].
struct KineticEnergies {
  double translational = 0;
  double rotational = 0;
};
KineticEnergies kinetic_energies(const Particles& particles);

// Elastic energy of contacts, in normal and in shear springs [J]. A dashpot's force is no spring's: the normal part is
// taken from the overlap.
struct ElasticEnergies {
  double normal = 0;
  double shear = 0;
  void add(const ContactView& contact);
};

}  // namespace lockstep::dem
