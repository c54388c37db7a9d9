#include "continuum_client/integrator.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include "common/checks.hpp"

namespace lockstep::continuum {
namespace {

constexpr std::size_t chunk_nodes = 1024;  // what threads share out
constexpr std::size_t at_once = 8;         // nodes, of the kernel

double* numbers(Vec3s& vectors) { return vectors.empty() ? nullptr : reinterpret_cast<double*>(vectors.data()); }
const double* numbers(std::span<const Vec3> vectors) {
  return vectors.empty() ? nullptr : reinterpret_cast<const double*>(vectors.data());
}

// The last nodes, fewer than the kernel takes at once, copied in front of held ones without mass.
void advance_last(NodeKernel kernel, const NodeArrays& all, const NodeStep& step, std::size_t first, std::size_t count,
                  NodeSums& sums) {
  std::array<std::array<double, 3 * at_once>, 9> copies{};
  std::array<double, at_once> mass{};
  std::size_t used = 0;
  const auto copy = [&](const double* from) -> double* {
    if (!from) return nullptr;
    double* const to = copies[used++].data();
    std::copy_n(from + 3 * first, 3 * count, to);
    return to;
  };
  std::copy_n(all.mass + first, count, mass.begin());
  const NodeArrays a{copy(all.displacement), copy(all.velocity), copy(all.internal), copy(all.reference),
                     copy(all.mobility),     mass.data(),        copy(all.applied),  copy(all.reaction),
                     copy(all.viscous),      copy(all.dashpot)};
  kernel(a, step, 0, at_once, sums);
  std::copy_n(a.displacement, 3 * count, all.displacement + 3 * first);
  std::copy_n(a.velocity, 3 * count, all.velocity + 3 * first);
}

}  // namespace

Integrator::Integrator(std::vector<double> mass, Vec3s is_free, Vec3s dashpot, InstructionSet instructions)
    : mass_(std::move(mass)),
      is_free_(std::move(is_free)),
      mobility_(mass_.size(), Vec3::Zero()),
      dashpot_(std::move(dashpot)),
      kernel_(LOCKSTEP_KERNEL_FOR(instructions, node_kernel)()),
      sums_((mass_.size() + chunk_nodes - 1) / chunk_nodes) {
  for (std::size_t i = 0; i < mass_.size(); ++i)
    if (mass_[i] > 0) mobility_[i] = is_free_[i] / mass_[i];
}

void Integrator::start_ledger(const Motion& motion) {
  ledger_ = {};
  for (std::size_t i = 0; i < motion.velocity.size(); ++i)
    ledger_.start += 0.5 * mass_[i] * motion.velocity[i].squaredNorm();
  rest_ = {};
}

StepSums Integrator::advance(Motion& motion, const Vec3s& internal, const Vec3s& reference, const NodalLoads& loads,
                             double damping, StepSizes steps, double velocity_limit, Team& team) {
  const double dt_velocity = steps.velocity_step();
  Work before, after;  // the two halves of this step's work, without the half steps' length
  applied_.resize(loads.interface_node.empty() ? 0 : mass_.size(), Vec3::Zero());
  for (std::size_t k = 0; k < loads.interface_node.size(); ++k) {
    const std::int32_t i = loads.interface_node[k];
    applied_[i] = loads.interface_force[k] + loads.baseline_force[k];
    before.interface += loads.interface_force[k].dot(motion.velocity[i]);
    before.baseline += loads.baseline_force[k].dot(motion.velocity[i]);
  }

  const NodeArrays arrays{numbers(motion.displacement),
                          numbers(motion.velocity),
                          numbers(internal),
                          numbers(reference),
                          numbers(mobility_),
                          mass_.data(),
                          numbers(applied_),
                          numbers(loads.reaction),
                          numbers(loads.viscous),
                          numbers(dashpot_)};
  const NodeStep step{{loads.gravity.x(), loads.gravity.y(), loads.gravity.z()},
                      damping,
                      dt_velocity,
                      steps.into,
                      steps.out_of,
                      velocity_limit * velocity_limit};
  const std::size_t chunks = sums_.size(), threads = static_cast<std::size_t>(team.size());
  NodeSums last;
  team.run([&](int thread) {
    for (std::size_t c = chunks * thread / threads; c < chunks * (thread + 1) / threads; ++c) {
      const std::size_t begin = c * chunk_nodes, end = std::min(begin + chunk_nodes, mass_.size());
      const std::size_t whole = begin + (end - begin) / at_once * at_once;
      kernel_(arrays, step, static_cast<std::int64_t>(begin), static_cast<std::int64_t>(whole), sums_[c]);
      if (whole < end) advance_last(kernel_, arrays, step, whole, end - whole, last);
    }
  });

  StepSums result;
  double kinetic = 0, elastic = 0, jolt = 0, runaways = 0;
  const auto count_in = [&](const NodeSums& s) {
    result.unbalanced += s.unbalanced, result.internal += s.internal;
    kinetic += s.kinetic, elastic += s.elastic, jolt += s.jolt, runaways += s.runaways;
    before.gravity += s.gravity_before, after.gravity += s.gravity_after;
    before.boundary += s.reaction_before, after.boundary += s.reaction_after;
    before.damped += s.damped_before, after.damped += s.damped_after;
  };
  for (const NodeSums& s : sums_) count_in(s);
  count_in(last);
  for (std::size_t k = 0; k < loads.interface_node.size(); ++k) {
    const std::int32_t i = loads.interface_node[k];
    after.interface += loads.interface_force[k].dot(motion.velocity[i]);
    after.baseline += loads.baseline_force[k].dot(motion.velocity[i]);
    applied_[i].setZero();
  }
  for (std::size_t i = 0; runaways > 0 && result.runaway_node < 0 && i < mass_.size(); ++i)
    if (!(motion.velocity[i].squaredNorm() <= step.square_limit)) result.runaway_node = static_cast<std::int64_t>(i);

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
  return result;
}

}  // namespace lockstep::continuum
