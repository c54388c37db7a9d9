#include "dem_server/integrator.hpp"

#include <cmath>

namespace lockstep::dem {

namespace {

// Unit quaternion of Cayley's map of a rotation vector.
Quat cayley(const Vec3& angle) {
  const Vec3 half = 0.5 * angle;
  const double w = 1 / std::sqrt(1 + half.squaredNorm());
  const Vec3 v = w * half;
  return Quat(w, v.x(), v.y(), v.z());
}

// Turns the body about its own axis `k`, and with it the body-frame momentum p the other way.
void turn_about_axis(int k, double angle, Quat& attitude, Vec3& p) {
  const Quat turn = cayley(angle * Vec3::Unit(k));
  attitude = attitude * turn;
  const double t = 0.5 * angle, scale = 1 / (1 + t * t);
  const double cosine = (1 - t * t) * scale, sine = 2 * t * scale;
  const int i = (k + 1) % 3, j = (k + 2) % 3;
  const double p_i = p[i], p_j = p[j];
  p[i] = cosine * p_i + sine * p_j;
  p[j] = cosine * p_j - sine * p_i;
}

// Torque-free turn for `dt` with the angular momentum `momentum` (world) held. Returns the body-frame momentum at the
// end.
Vec3 turn_freely(Quat& attitude, const Vec3& momentum, const Vec3& inertia, double dt) {
  attitude = cayley((dt / inertia[1]) * momentum) * attitude;
  Vec3 p = attitude.conjugate() * momentum;
  const double rate_1 = 1 / inertia[0] - 1 / inertia[1];
  if (inertia[2] == inertia[1]) {
    turn_about_axis(0, dt * rate_1 * p[0], attitude, p);
  } else {
    const double rate_3 = 1 / inertia[2] - 1 / inertia[1];
    turn_about_axis(0, 0.5 * dt * rate_1 * p[0], attitude, p);
    turn_about_axis(2, dt * rate_3 * p[2], attitude, p);
    turn_about_axis(0, 0.5 * dt * rate_1 * p[0], attitude, p);
  }
  // Rounding only: one Newton step towards unit length.
  attitude.coeffs() *= 1.5 - 0.5 * attitude.squaredNorm();
  return p;
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
  totals = MotionTotals{};
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
    totals.kinetic_energy += 0.5 * mass * before.dot(after);
    totals.gravity_work += dt * weight.dot(mean);
    totals.contact_work += dt * particles.force[b].dot(mean);
    totals.damped_work -= dt * force_damping.dot(mean);
    totals.unbalanced_force += unbalanced.norm();
    totals.damping_force += force_damping;
    totals.momentum += mass * after;
    totals.momentum_change += mass * (after - before);
    const double square = after.squaredNorm();
    if (square > largest_square) {
      largest_square = square;
      totals.fastest_body = static_cast<std::int32_t>(b);
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
      totals.kinetic_energy += 0.5 * inertia[0] * spin_before.dot(spin_after);
      particles.spin[b] = spin_after;
    } else {
      Quat& attitude = particles.orientation[b];
      const Mat3 rotation = attitude.toRotationMatrix();
      const Vec3 momentum_before = rotation * inertia.cwiseProduct(rotation.transpose() * spin_before);
      const Vec3 momentum = momentum_before + dt * torque;
      const Vec3 spin_after = rotation * (rotation.transpose() * momentum).cwiseQuotient(inertia);
      spin_middle = 0.5 * (spin_before + spin_after);
      totals.kinetic_energy += 0.5 * spin_before.dot(momentum);
      const Vec3 p = turn_freely(attitude, momentum, inertia, time_step_new);
      particles.spin[b] = attitude.toRotationMatrix() * p.cwiseQuotient(inertia);
    }
    totals.contact_work += dt * particles.torque[b].dot(spin_middle);
    totals.damped_work -= dt * torque_damping.dot(spin_middle);
    particles.place_pebbles(static_cast<std::int32_t>(b));
  }
  totals.largest_speed = largest_square > 0 ? std::sqrt(largest_square) : 0.0;
}

}  // namespace lockstep::dem
