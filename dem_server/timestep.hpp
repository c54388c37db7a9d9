// The stable time step of the grains, from the stiffness that their contacts hold at the moment.
//
// Leap-frog is stable while dt < 2 / omega_max, omega_max^2 the largest eigenvalue of M^-1/2 K M^-1/2. Per contact c,
// with K_c = k_n n n^T + k_s (1 - n n^T) and, for a body with mass m, inertia I and lever r to the contact point,
//   G = [ 1/sqrt(m),  -[r]x I^-1/2 ]   (3 x 6),      a_c = |K_c^1/2 G_a|,  b_c = |K_c^1/2 G_b|  (spectral norms),
// Gershgorin's theorem for blocks of six says
//   omega_max^2 <= max over bodies of ( |sum_c G^T K_c G| + sum_c a_c b_c ).
// The norm of the summed 6 x 6 diagonal block is bounded as |D^8|_F^(1/8), at most 12 % above it (6 % in dt); a wall
// has b_c = 0. Local damping alpha takes a factor 1/sqrt(1 + alpha): it makes a mass up to 1 + alpha times lighter to
// stop.
//
// That is a bound: always safe, and 0.6 to 0.75 of the true limit in a dense packing (its neighbours' signs are all
// taken for the worst). critical_step_power gives an estimate of the true limit for who wants the rest.
#pragma once
#include <vector>

#include "common/parallel.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/travel.hpp"

namespace lockstep::dem {

// Bodies may lie in several parts, that threads add contacts to at the same time: the same bits come out.
class StiffnessSum {
 public:
  // All bodies in one part.
  void reset(std::size_t bodies);
  // The memory of an earlier sum is used again.
  void reset(const Partition& partition);
  // Adds one contact; of any family, body_b = -1 for a wall. Pairs need all bodies in one part.
  void add(const ContactView& contact, const Particles& particles);
  // In a periodic cell: `branch` goes from the centre of A to that of B's image.
  void add(const ContactView& contact, const Particles& particles, const Vec3& branch);
  // Adds a pair to those of its two bodies that are the part's: a pair across a border is given to both parts.
  void add_to_part(int part, const ContactView& contact, const Particles& particles);
  // Stable step [s], infinite without contacts; `worst_body` (may be null) is set to the body that limits it, -1 if
  // none.
  double stable_step(double damping, std::int32_t* worst_body = nullptr, Team& team = Team::alone());

 private:
  using Mat6 = Eigen::Matrix<double, 6, 6>;
  struct Coupling {
    std::int32_t a, b;
    double strength;  // a_c b_c [1/s2]
  };
  struct Part {
    std::int32_t begin = 0, end = 0;  // bodies
    std::vector<Coupling> couplings;
    double largest = 0;       // of the rows of its bodies, in a sweep [1/s2]
    std::int32_t worst = -1;  // the body that has it
  };
  void add_levers(Part& part, const ContactView& contact, const Particles& particles, const Vec3& lever_a,
                  const Vec3& lever_b);
  void look_at_rows(Part& part);

  std::vector<Mat6> diagonal_;  // [1/s2]
  std::vector<Part> parts_;
  std::vector<double> own_, scale_, image_;  // per body, of Gershgorin's rows
};

// omega^2 of the body that contacts with facets or walls alone hold most, zero without any [1/s2]. `contacts` come body by
// body.
double largest_wall_frequency_squared(const std::vector<ContactView>& contacts, const Particles& particles);

// Estimate of the true limit, times power_margin / sqrt(1 + damping) [s]: power iteration on the assembled network of
// linear springs with six degrees of freedom a body. Infinite without contacts. Deterministic. In a periodic cell
// `branches`, one per contact, holds the vector from centre to centre; empty means that positions say it.
double critical_step_power(const std::vector<ContactView>& contacts, const Particles& particles, double damping,
                           int products = power_products, const Vec3s& branches = {});

// For packings that are still being made, whose contacts come and go: quiet_share of sqrt(m / k_n) of the lightest and
// smallest grain [s].
double quiet_step(const Particles& particles, const GrainMaterial& material);

}  // namespace lockstep::dem
