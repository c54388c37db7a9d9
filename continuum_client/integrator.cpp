#include "continuum_client/integrator.hpp"

#include <cmath>
#include <utility>

namespace lockstep::continuum {

Integrator::Integrator(std::vector<double> mass, Vec3s is_free)
    : mass_(std::move(mass)), is_free_(std::move(is_free)), mobility_(mass_.size(), Vec3::Zero()) {
  for (std::size_t i = 0; i < mass_.size(); ++i)
    if (mass_[i] > 0) mobility_[i] = is_free_[i] / mass_[i];
}

void Integrator::clear_ledger() {
  ledger_ = {};
  rest_ = {};
}

StepSums Integrator::advance(Motion& motion, const Vec3s& internal, const Vec3s& reference, const NodalLoads& loads,
                             double damping, StepSizes steps, double velocity_limit) {
  const double dt_velocity = steps.velocity_step(), limit = velocity_limit * velocity_limit;
  const double into_share = steps.into / dt_velocity;
  StepSums sums;
  Work before, after;                         // the two halves of this step's work, without the half steps' length
  double kinetic = 0, elastic = 0, jolt = 0;  // jolt: sum of m (v(n+1/2) - v(n-1/2))^2
  std::size_t next_interface = 0;

  for (std::size_t i = 0; i < mass_.size(); ++i) {
    Vec3& u = motion.displacement[i];
    const Vec3 v = motion.velocity[i];
    const Vec3 weight = mass_[i] * loads.gravity;
    Vec3 force = weight - internal[i];
    const bool has_reaction = !loads.reaction.empty();
    if (has_reaction) force += loads.reaction[i];
    const bool is_interface = next_interface < loads.interface_node.size() &&
                              loads.interface_node[next_interface] == static_cast<std::int32_t>(i);
    if (is_interface) force += loads.interface_force[next_interface] + loads.baseline_force[next_interface];

    Vec3 drag;  // F_d
    for (int c = 0; c < 3; ++c) {
      force[c] = mobility_[i][c] > 0 ? force[c] : 0.0;
      const double sign = static_cast<double>(v[c] > 0) - static_cast<double>(v[c] < 0);
      drag[c] = -damping * std::abs(force[c]) * sign;
    }
    const Vec3 v_new = v + dt_velocity * mobility_[i].cwiseProduct(force + drag);

    sums.unbalanced += force.norm();
    sums.internal += internal[i].norm();
    elastic += 0.5 * u.dot(reference[i] + internal[i]);
    const Vec3 change = v_new - v;
    kinetic += 0.5 * mass_[i] * v.dot(v + into_share * change);
    jolt += mass_[i] * change.squaredNorm();
    before.gravity += weight.dot(v), after.gravity += weight.dot(v_new);
    before.damped -= drag.dot(v), after.damped -= drag.dot(v_new);
    if (has_reaction) {
      before.boundary += loads.reaction[i].dot(v), after.boundary += loads.reaction[i].dot(v_new);
    }
    if (is_interface) {
      const Vec3& contact = loads.interface_force[next_interface];
      const Vec3& baseline = loads.baseline_force[next_interface];
      before.interface += contact.dot(v), after.interface += contact.dot(v_new);
      before.baseline += baseline.dot(v), after.baseline += baseline.dot(v_new);
      ++next_interface;
    }
    // Written so that NaN counts as running away.
    if (!(v_new.squaredNorm() <= limit) && sums.runaway_node < 0) sums.runaway_node = static_cast<std::int64_t>(i);

    motion.velocity[i] = v_new;
    u += v_new * steps.out_of;
  }

  Work& w = ledger_.work;
  const double half_into = 0.5 * steps.into, half_out_of = 0.5 * steps.out_of;
  w.gravity += rest_.gravity + half_into * before.gravity;
  w.boundary += rest_.boundary + half_into * before.boundary;
  w.interface += rest_.interface + half_into * before.interface;
  w.baseline += rest_.baseline + half_into * before.baseline;
  w.damped += rest_.damped + half_into * before.damped;
  w.step_change += rest_.step_change;
  rest_.gravity = half_out_of * after.gravity;
  rest_.boundary = half_out_of * after.boundary;
  rest_.interface = half_out_of * after.interface;
  rest_.baseline = half_out_of * after.baseline;
  rest_.damped = half_out_of * after.damped;
  rest_.step_change = 0.25 * (steps.into - steps.out_of) / dt_velocity * jolt;
  ledger_.kinetic = kinetic;
  ledger_.elastic = elastic;
  return sums;
}

}  // namespace lockstep::continuum
