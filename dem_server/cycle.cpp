// The grains' half of the coupled step. On entry x, orientations and facets are at t_n (the facets once move_facets has
// returned), velocities and spins at t_{n-1/2}; forces at t_n use x(n) and v(n-1/2), as one monolithic explicit code
// would.
#include "dem_server/cycle.hpp"

#include <algorithm>
#include <cmath>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/timestep.hpp"

namespace lockstep::dem {

namespace {

void clear_loads(Model& m) {
  m.particles.clear_forces();
  m.has_loads = false;
}

void interface_contacts(Model& m) {
  const auto timing = m.profile.measure(Phase::InterfaceContacts);
  // Equal shares: the ground waits for these, and so holds no thread up.
  m.facet_totals = m.facets.compute(m.particles, m.facet_material, m.last_time_step, m.contacts.limits(), *m.team,
                                    {});  // paper eqs 1-4, 8-13
}

void renew_lists(Model& m) {
  const auto timing = m.profile.measure(Phase::Lists);
  m.contacts.update(m.particles, *m.team, m.motion.ways);
}

void pair_contacts(Model& m) {
  const auto timing = m.profile.measure(Phase::PairContacts);
  m.pair_totals = m.contacts.compute(m.particles, m.material, m.last_time_step, m.detail, *m.team);
}

void wall_contacts(Model& m) {
  const auto timing = m.profile.measure(Phase::WallContacts);
  const WallKernels kernels = wall_kernels(m.contacts.instructions());
  m.wall_totals = m.walls.compute(m.particles, m.material, m.last_time_step, m.contacts.limits(), *m.team,
                                  m.contacts.partition(), kernels);
  if (m.pile)
    m.pile_totals = m.pile->compute(m.particles, m.material, m.last_time_step, m.contacts.limits(), *m.team,
                                    m.contacts.partition(), kernels);
}

void move(Model& m) {
  const auto timing = m.profile.measure(Phase::Motion);
  m.motion = integrate(m.particles, m.gravity, m.last_time_step, m.time_step, m.damping,
                       {m.is_fixed.empty() ? nullptr : &m.is_fixed, m.team.get(), &m.contacts.partition(),
                        m.contacts.instructions(), m.detail, fastest_travel});
  m.walls.advance(m.time_step);
  if (m.pile) m.pile->advance(m.time_step);
}

// omega^2 of one contact of a body, whether there is one or not: for a lever of the equivalent radius, k (1/m + R^2/I)
// bounds it in any direction. The largest of all bodies, with a facet alone and with a facet or a wall [1/s2].
struct FirstTouch {
  double facet = 0, any = 0;
};
FirstTouch first_touch(const Model& m) {
  FirstTouch largest;
  for (std::size_t b = 0; b < m.particles.body_count(); ++b) {
    const double radius = m.particles.equivalent_radius(b);
    const double facet = m.facet_material.normal_stiffness(radius);
    const double stiffness = std::max(facet, 2 * m.material.normal_stiffness(radius, radius));
    const double shear = 1 / m.particles.mass(b) + radius * radius / m.particles.inertia(b).minCoeff();
    const double mobility = std::max(1 / m.particles.mass(b), shear / m.material.stiffness_ratio);
    largest.facet = std::max(largest.facet, facet * mobility);
    largest.any = std::max(largest.any, stiffness * mobility);
  }
  return largest;
}

// A body that crosses half its radius within a step has lost its contacts' control: instability, or absurd
// speed.
void check_speed(const Model& m) {
  if (!m.motion.is_too_fast) return;
  const auto body = fastest_body(m.particles);
  const Vec3 x = m.particles.position(body);
  const double speed = m.particles.velocity(body).norm();
  throw NumericalError(fmt::format(
      "step {}: grain {} at ({:.3g}, {:.3g}, {:.3g}) m moves at {:.3g} m/s, {:.2g} of its radius a step: the "
      "grains went unstable; lower fidelity.step_fraction, or the speeds that the scene imposes",
      m.step, body, x.x(), x.y(), x.z(), speed, speed * m.time_step / m.particles.equivalent_radius(body)));
}

void book(Model& m) {
  const auto timing = m.profile.measure(Phase::Ledger);
  m.ledger.book(m);
}

}  // namespace

bool cycle(Model& m, Boundary& boundary) {
  if (!boundary.move_facets(m)) return false;  // facets to x(n)                          (step 5 of the procedure)
  if (m.has_loads) clear_loads(m);
  renew_lists(m);
  interface_contacts(m);    // before the grains' own, since the continuum waits for them
  boundary.take_forces(m);  // nodal forces F(n)                       (step 6)
  pair_contacts(m);
  wall_contacts(m);
  move(m);  // v(n+1/2), x(n+1)                        (step 7)
  check_speed(m);
  if (m.detail != Detail::Forces) book(m);
  m.time += m.time_step;
  m.last_time_step = m.time_step;
  ++m.step;
  return true;
}

void evaluate_forces(Model& m) {
  const double last = m.last_time_step;
  m.last_time_step = 0;  // no shear increments, no slip
  clear_loads(m);
  renew_lists(m);
  interface_contacts(m);
  pair_contacts(m);
  wall_contacts(m);
  m.last_time_step = last;
  m.has_loads = true;
}

StepLimit stable_step(Model& m, double damping) {
  const Partition& partition = m.contacts.partition();  // none before the first lists: no pairs then
  m.stiffness.reset(partition.size() > 0 ? partition
                                         : Partition{{0, static_cast<std::int32_t>(m.particles.body_count())}});
  m.team->run_parts(partition.size(), [&](int part) {
    m.contacts.for_each_contact_of_part(
        m.particles, part, [&](const ContactView& contact) { m.stiffness.add_to_part(part, contact, m.particles); });
  });
  const auto add = [&](const ContactView& contact) { m.stiffness.add(contact, m.particles); };
  std::vector<ContactView> touching;
  m.facets.for_each_contact([&](const ContactView& contact) { touching.push_back(contact); });
  for (const ContactView& contact : touching) add(contact);
  m.walls.for_each_contact(add);
  if (m.pile) m.pile->for_each_contact(add);

  StepLimit limit;
  limit.step = m.stiffness.stable_step(damping, &limit.worst_body, *m.team);
  const FirstTouch first = first_touch(m);
  if (const double step = 2 / std::sqrt(first.any * (1 + damping)); step < limit.step)
    limit.step = step, limit.worst_body = -1;
  limit.touching_squared = std::max(first.facet, largest_wall_frequency_squared(touching, m.particles));
  return limit;
}

std::uint64_t Model::hash() const {
  Hash h;
  particles.hash(h);
  contacts.hash(h);
  facets.hash(h);
  walls.hash(h);
  if (pile) pile->hash(h);
  return h.value();
}

}  // namespace lockstep::dem
