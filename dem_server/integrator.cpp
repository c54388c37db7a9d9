#include "dem_server/integrator.hpp"

#include <algorithm>
#include <cmath>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/motion_kernel.hpp"

namespace lockstep::dem {

namespace {

void add(const double* part, Vec3& sum) { sum += Vec3(part[0], part[1], part[2]); }

MotionTotals added_up(const std::vector<MotionSums>& chunks) {
  MotionTotals totals;
  double square = 0;
  totals.ways.reserve(chunks.size());
  for (const MotionSums& sums : chunks) {
    totals.ways.push_back(sums.way);
    totals.translation_energy += sums.translation_energy;
    totals.rotation_energy += sums.rotation_energy;
    totals.gravity_work += sums.gravity_work;
    totals.damped_work += sums.damped_work;
    totals.contact_work += sums.contact_work;
    totals.unbalanced_force += sums.unbalanced_force;
    totals.moving_mass += sums.moving_mass;
    add(sums.damping_force, totals.damping_force);
    add(sums.momentum, totals.momentum);
    add(sums.momentum_change, totals.momentum_change);
    square = std::max(square, sums.largest_square);
    totals.is_too_fast = totals.is_too_fast || sums.too_fast > 0;
  }
  totals.largest_speed = std::sqrt(square);
  return totals;
}

}  // namespace

MotionTotals integrate(Particles& particles, const Vec3& gravity, double time_step_old, double time_step_new,
                       double damping, const MotionOptions& options) {
  const std::size_t bodies = particles.body_count();
  LOCKSTEP_ASSERT(!options.fixed || options.fixed->size() == bodies, "{} marks for {} bodies", options.fixed->size(),
                  bodies);
  const std::size_t chunks = (bodies + chunk_bodies - 1) / chunk_bodies;
  Team& team = options.team ? *options.team : Team::alone();
  const int parts = options.partition ? options.partition->parts(team.size()) : team.size();
  const MotionKernel kernel =
      LOCKSTEP_KERNEL_FOR(options.instructions, motion_kernel)(particles.has_clumps(), options.detail);
  const MotionStep step = {{gravity.x(), gravity.y(), gravity.z()},
                           0.5 * (time_step_old + time_step_new),
                           time_step_new,
                           damping,
                           options.fastest_travel / time_step_new};
  std::vector<MotionSums> sums(chunks);
  const auto first_chunk = [&](int part) {
    if (!options.partition || options.partition->size() == 0) return share_of(chunks, part, parts).first;
    const std::int32_t body = options.partition->body_begin[static_cast<std::size_t>(part)];
    return (static_cast<std::size_t>(body) + chunk_bodies - 1) / chunk_bodies;
  };
  particles.room_for_twists();
  const bool has_clumps = particles.has_clumps();
  const MotionStretch all = {particles.bodies(),
                             particles.motion(),
                             particles.loads(),
                             particles.attitudes(),
                             particles.shapes().records(),
                             particles.shapes().pebbles(),
                             particles.shapes().are_rows(),
                             particles.shape_numbers(),
                             particles.pebble_begins(),
                             has_clumps ? particles.pebbles() : nullptr,
                             particles.twists(),
                             options.fixed ? options.fixed->data() : nullptr,
                             0,
                             static_cast<std::int32_t>(bodies)};
  team.run_parts(parts, [&](int part) {
    for (std::size_t c = first_chunk(part); c < first_chunk(part + 1); ++c) {
      MotionStretch stretch = all;
      stretch.begin = static_cast<std::int32_t>(c * chunk_bodies);
      stretch.end = static_cast<std::int32_t>(std::min((c + 1) * chunk_bodies, bodies));
      kernel(stretch, step, sums[c]);
    }
  });
  if (has_clumps) particles.twists_are_made();
  return added_up(sums);
}

std::int32_t fastest_body(const Particles& particles) {
  std::int32_t fastest = -1;
  double largest = -1;
  for (std::size_t b = 0; b < particles.body_count(); ++b) {
    const double rate = particles.velocity(b).norm() / particles.equivalent_radius(b);
    if (!std::isfinite(rate) || !particles.spin(b).allFinite()) return static_cast<std::int32_t>(b);
    if (rate <= largest) continue;
    largest = rate;
    fastest = static_cast<std::int32_t>(b);
  }
  return fastest;
}

}  // namespace lockstep::dem
