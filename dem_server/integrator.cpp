#include "dem_server/integrator.hpp"

#include <cmath>

namespace lockstep::dem {

namespace {

// Turns the body about its own axis `k` by Cayley's map: `turn` is multiplied by (1, angle/2) from the right, and the
// body-frame momentum p turns the other way.
template <int k>
void turn_about_axis(double angle, Quat& turn, Vec3& p) {
  constexpr int i = (k + 1) % 3, j = (k + 2) % 3;
  const double t = 0.5 * angle;
  const double w = turn.w(), v_i = turn.vec()[i], v_j = turn.vec()[j], v_k = turn.vec()[k];
  turn.w() = w - t * v_k;
  turn.vec()[k] = v_k + t * w;
  turn.vec()[i] = v_i + t * v_j;
  turn.vec()[j] = v_j - t * v_i;
  const double scale = 1 / (1 + t * t);
  const double cosine = (1 - t * t) * scale, sine = 2 * t * scale;
  const double p_i = p[i], p_j = p[j];
  p[i] = cosine * p_i + sine * p_j;
  p[j] = cosine * p_j - sine * p_i;
}

// Torque-free turn for `dt` with the angular momentum held; `p` is it in body axes, before and after, and `mobility`
// has 1/I. The turn about the momentum leaves p as it is. Quaternions are composed without regard to their lengths, and
// the product is made unit.
void turn_freely(Quat& attitude, Vec3& p, const Vec3& mobility, double dt) {
  const Vec3 about_momentum = (0.5 * dt * mobility[1]) * p;
  Quat turn(1, about_momentum[0], about_momentum[1], about_momentum[2]);
  const double rate_1 = mobility[0] - mobility[1];
  if (mobility[2] == mobility[1]) {
    turn_about_axis<0>(dt * rate_1 * p[0], turn, p);
  } else {
    const double rate_3 = mobility[2] - mobility[1];
    turn_about_axis<0>(0.5 * dt * rate_1 * p[0], turn, p);
    turn_about_axis<2>(dt * rate_3 * p[2], turn, p);
    turn_about_axis<0>(0.5 * dt * rate_1 * p[0], turn, p);
  }
  attitude = attitude * turn;
  attitude.normalize();
}

Vec3 damping_part(const Vec3& unbalanced, const Vec3& velocity, double damping) {
  Vec3 part;
  for (int k = 0; k < 3; ++k)
    part[k] = velocity[k] == 0 ? 0.0 : -damping * std::copysign(std::abs(unbalanced[k]), velocity[k]);
  return part;
}

}  // namespace

void integrate(Particles& particles, const Vec3& gravity, double time_step_old, double time_step_new, double damping,
               MotionTotals& totals, const std::vector<char>* fixed) {
  MotionTotals sum;
  const double dt = 0.5 * (time_step_old + time_step_new);
  double largest_square = -1;
  for (std::size_t b = 0; b < particles.body_count(); ++b) {
    if (fixed && (*fixed)[b]) {
      particles.velocity[b].setZero();
      particles.spin[b].setZero();
      continue;
    }
    const double mass = particles.mass[b];
    const Vec3 before = particles.velocity[b];
    const Vec3 weight = mass * gravity;
    const Vec3 unbalanced = particles.force[b] + weight;
    const Vec3 force_damping = damping_part(unbalanced, before, damping);
    const Vec3 after = before + (dt / mass) * (unbalanced + force_damping);
    particles.velocity[b] = after;
    particles.position[b] += time_step_new * after;

    const Vec3 mean = 0.5 * (before + after);
    sum.kinetic_energy += 0.5 * mass * before.dot(after);
    sum.gravity_work += dt * weight.dot(mean);
    sum.contact_work += dt * particles.force[b].dot(mean);
    sum.damped_work -= dt * force_damping.dot(mean);
    sum.unbalanced_force += unbalanced.norm();
    sum.damping_force += force_damping;
    sum.momentum += mass * after;
    sum.momentum_change += mass * (after - before);
    const double square = after.squaredNorm();
    if (square > largest_square) {
      largest_square = square;
      sum.fastest_body = static_cast<std::int32_t>(b);
    }

    const Vec3& inertia = particles.inertia[b];
    const Vec3 spin_before = particles.spin[b];
    const Vec3 torque_damping = damping_part(particles.torque[b], spin_before, damping);
    const Vec3 torque = particles.torque[b] + torque_damping;
    Vec3 spin_middle;  // mean of the spins before and after, at the attitude of t_n
    if (particles.pebble_begin[b + 1] - particles.pebble_begin[b] == 1 && inertia[0] == inertia[1] &&
        inertia[1] == inertia[2]) {
      const Vec3 spin_after = spin_before + (dt / inertia[0]) * torque;
      spin_middle = 0.5 * (spin_before + spin_after);
      sum.kinetic_energy += 0.5 * inertia[0] * spin_before.dot(spin_after);
      particles.spin[b] = spin_after;
      particles.place_pebbles(static_cast<std::int32_t>(b));
    } else {
      // In body axes: spin w, momentum p.
      Quat attitude = particles.orientation[b];
      const Mat3 rotation = attitude.toRotationMatrix();
      const Vec3 mobility = inertia.cwiseInverse();
      const Vec3 w = rotation.transpose() * spin_before;
      Vec3 p = inertia.cwiseProduct(w) + dt * (rotation.transpose() * torque);
      spin_middle = rotation * (0.5 * (w + mobility.cwiseProduct(p)));
      sum.kinetic_energy += 0.5 * w.dot(p);
      turn_freely(attitude, p, mobility, time_step_new);
      const Mat3 turned = attitude.toRotationMatrix();
      particles.orientation[b] = attitude;
      particles.spin[b] = turned * mobility.cwiseProduct(p);
      particles.place_pebbles(static_cast<std::int32_t>(b), turned);
    }
    sum.contact_work += dt * particles.torque[b].dot(spin_middle);
    sum.damped_work -= dt * torque_damping.dot(spin_middle);
  }
  sum.largest_speed = largest_square > 0 ? std::sqrt(largest_square) : 0.0;
  totals = sum;
}

}  // namespace lockstep::dem
