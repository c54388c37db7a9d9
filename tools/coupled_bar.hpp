// A short bar, spheres on zones, small enough that its whole step is one dense matrix: the exact stable step of the coupled
// system, and its motion integrated by other code than the two programs'.
//
//    rigid wall   -----------------     Zones in one column, nodes free along z alone: held along x and y, and all at the bottom.
//                   o  o  o  o          Columns of spheres on the top facet, side by side without touching, pressed together
//                   o  o  o  o          by a preload; no friction. A single column stands off the facet's middle, so that every
//    interface    #-------------#       mode of the zones takes part. What starts it keeps all contacts closed: up to the first
//                 #-------------#       gap the system is linear to round-off.
//    held bottom  #-------------#
//
// Unknowns: q = (free u_z of the nodes, z of the spheres), M q'' = -K q + p. K has the zones' own assembled stiffness, a
// spring k_n per pair of spheres and sphere and wall, and for sphere s on a facet with bilinear weights N_j the spring
// k_f (z_s - sum N_j u_j)^2 / 2. Spheres move along x and y in no mode: nothing pushes them there.
//
// Leap-frog's step is the matrix [I - dt^2 A, dt I; -dt A, I] on (q, v), A = M^-1 K. An eigenvalue w^2 of A gives it
// z^2 - (2 - w^2 dt^2) z + 1 = 0: |z| = 1 up to w dt = 2, and rho = (f + sqrt(f^2 - 1))^2 with f = w dt / 2 beyond.
#pragma once
#include <Eigen/Dense>
#include <cstdint>
#include <string>
#include <vector>

#include "common/scene.hpp"

namespace lockstep {

struct BarCase {
  double contrast = 1;    // k_n / (E h), k_n of a pair of spheres
  double mass_ratio = 1;  // a sphere over a zone
  int columns = 1;        // of spheres along x, and as many along y
  int spheres = 4;        // in a column
  int zones = 5;
  double damping = 0;  // local, of both sides
  std::uint32_t exchange_interval = 1;
  double preload = 1e-5;    // overlap over radius
  bool has_weight = false;  // gravity starts it; else a packet of velocity does
};

class CoupledBar {
 public:
  explicit CoupledBar(const BarCase& c);

  const BarCase& setting() const { return case_; }
  double omega_max() const { return omega_max_; }  // [rad/s]
  // 2 / omega_max / sqrt(1 + damping): exact without damping and with one step to an exchange [s].
  double exact_limit() const;
  // Largest modulus of an eigenvalue of an undamped step.
  double spectral_radius(double time_step) const;

  // The scene that both programs read. `step_fraction` is of what they hold to be the limit.
  SceneFile scene(double step_fraction, double duration) const;

  // The motion in steps of `time_step`, one per exchange, as the programs' order of a step is (the grains' first kick is half a
  // one: they start at t_0, the zones at t_-1/2).
  struct Growth {
    bool grows = false, is_bounded = false;  // neither: too slow to tell
    std::uint64_t onset = 0;  // exchanges until it has a thousand times the energy of the start; 0: never
    double rate = 0;          // factor of amplitude per exchange, over the last half of what was looked at
  };
  // Of the packet; of the weight, what it does over the way that the start may take [J].
  double start_energy() const;
  Growth growth(double time_step, std::uint64_t exchanges) const;
  // Displacements and velocities after `exchanges`: q of nodes and spheres [m].
  struct State {
    Eigen::VectorXd q, v;
  };
  State state_after(double time_step, std::uint64_t exchanges) const;
  // Kinetic energy of nodes and of spheres [J].
  double kinetic_of_nodes(const Eigen::VectorXd& v) const;
  double kinetic_of_spheres(const Eigen::VectorXd& v) const;
  // The step beyond which growth() grows, by bisection between `low` and `high` to a part in 1000 [s].
  double limit_by_growth(double low, double high, std::uint64_t exchanges) const;

  Eigen::Index nodes() const { return nodes_; }
  Eigen::Index spheres() const { return mass_.size() - nodes_; }

 private:
  class Motion;
  std::string scene_text(double step_fraction, double duration) const;
  void assemble();
  void choose_start();

  BarCase case_;
  double radius_ = 0, overlap_ = 0;                  // [m]
  double pair_stiffness_ = 0, facet_stiffness_ = 0;  // [N/m]
  double grain_density_ = 0, ground_density_ = 0;    // [kg/m3]
  double gravity_ = 0, peak_velocity_ = 0;           // [m/s2], [m/s]
  Eigen::Index nodes_ = 0;                           // free ones come first in q
  std::vector<Eigen::Vector2d> places_;              // of the columns [m]
  Eigen::VectorXd mass_, start_, load_;              // [kg], [m/s], [N]
  Eigen::MatrixXd zones_, spheres_, interface_;      // parts of K [N/m]
  Eigen::MatrixXd stretch_;                          // per facet contact: z_s - sum N u
  double omega_max_ = 0, omega_min_ = 0;             // [rad/s]
};

}  // namespace lockstep
