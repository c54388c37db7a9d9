// The same bits whatever the machine does: threads, instruction sets, the age of lists, what is added up.
//
// The crowd is 1,331 bodies, six chunks, in a box whose walls close in while a pile is driven into it: lists are renewed
// every few steps, contacts form, slide and part, and wall, pile and pair forces meet on the same bodies. What the
// grains are made of changes on the way, so that every kernel has its turn.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <memory>
#include <vector>

#include "common/random.hpp"
#include "dem_server/clumps.hpp"
#include "dem_server/constants.hpp"
#include "dem_server/cycle.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

constexpr double step_length = 4e-5;  // [s]
constexpr int side = 11;              // bodies
constexpr double spacing = 0.059;     // [m]
constexpr int period = 30;            // steps with one material

enum class Crowd { Spheres, Clumps, Mixed };

// Walls close in at the speeds they were given, whatever else happens.
class ClosingBox : public Boundary {
 public:
  bool move_facets(Model& model) override {
    model.time_step = step_length;
    return true;
  }
  void take_forces(Model&) override {}
};

void fill(Particles& particles, Crowd crowd) {
  Random random(11);
  const ClumpTemplate sphere = make_clump(1, 1), clump = make_clump(3, 1.5);
  for (int k = 0; k < side * side * side; ++k) {
    const Vec3 cell(k % side - 0.5 * (side - 1), k / side % side - 0.5 * (side - 1), k / (side * side) + 0.5);
    const Vec3 jitter(random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05));
    const bool is_clump = crowd == Crowd::Clumps || (crowd == Crowd::Mixed && k % 3 == 0);
    const std::int32_t b = particles.add(is_clump ? clump : sphere, random.uniform(0.025, 0.030), 2650,
                                         spacing * (cell + jitter), random.rotation());
    particles.velocity(b) = Vec3(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    particles.spin(b) = Vec3(random.uniform(-9, 9), random.uniform(-9, 9), random.uniform(-9, 9));
  }
}

Walls closing_walls() {
  const double half = 0.5 * side * spacing, top = side * spacing, speed = 1;  // [m], [m/s]
  return Walls(std::vector<PlaneSettings>{{Vec3::Zero(), Vec3::UnitZ(), Vec3::Zero()},
                                          {Vec3(0, 0, top), -Vec3::UnitZ(), Vec3(0, 0, -speed)},
                                          {Vec3(-half, 0, 0), Vec3::UnitX(), Vec3(speed, 0, 0)},
                                          {Vec3(half, 0, 0), -Vec3::UnitX(), Vec3(-speed, 0, 0)},
                                          {Vec3(0, -half, 0), Vec3::UnitY(), Vec3(0, speed, 0)},
                                          {Vec3(0, half, 0), -Vec3::UnitY(), Vec3(0, 0.5 * speed, 0)}},
               0.4);
}

std::unique_ptr<Model> squeezed(Crowd crowd, int threads, InstructionSet instructions = best_instructions()) {
  auto model = std::make_unique<Model>(0.0008, threads, instructions);
  fill(model->particles, crowd);
  model->gravity = Vec3(0, 0, -9.81);
  model->damping = 0.1;
  model->walls = closing_walls();
  model->pile.emplace(PileShape{0.09}, side * spacing, 0.5);
  model->pile->set_velocity(-2);
  return model;
}

// Friction, a dashpot, both, neither, in turn.
void choose_material(Model& model, int step) {
  const int turn = step / period % 4;
  model.material.contact_modulus = 5e6;
  model.material.friction = turn == 0 || turn == 2 ? 0.5 : 0.0;
  model.material.damping_ratio = turn == 1 || turn == 2 ? damping_ratio(0.5) : 0.0;
}

void add(Hash& h, const WallTotals& t) {
  h.add(static_cast<std::uint64_t>(t.contacts));
  h.add(t.force), h.add(t.torque);
  for (const double x :
       {t.normal_force, t.stiffness, t.elastic_energy, t.slip_work, t.dashpot_work, t.power, t.work, t.max_overlap})
    h.add(x);
}

// Everything that a step adds up to.
void add_totals(Hash& h, const Model& model) {
  const ContactTotals& c = model.pair_totals;
  h.add(static_cast<std::uint64_t>(c.active));
  for (const double x : {c.slip_work, c.dashpot_work, c.normal_force, c.contact_force, c.normal_energy, c.shear_energy,
                         c.largest_overlap_ratio})
    h.add(x);
  const MotionTotals& m = model.motion;
  for (const double x : {m.translation_energy, m.rotation_energy, m.gravity_work, m.damped_work, m.contact_work,
                         m.unbalanced_force, m.moving_mass, m.largest_speed})
    h.add(x);
  h.add(m.damping_force), h.add(m.momentum), h.add(m.momentum_change);
  add(h, model.wall_totals), add(h, model.pile_totals.tip), add(h, model.pile_totals.shaft);
}

struct Bits {
  std::uint64_t state = 0;   // at the end
  std::uint64_t totals = 0;  // of all steps
  bool operator==(const Bits&) const = default;
};

// What a run went through, so that a crowd that does nothing cannot pass.
struct Events {
  std::int64_t refreshes = 0, rebuilds = 0;
  std::int64_t most_contacts = 0;
  std::size_t most_walls = 0, most_pile = 0;
  double slip_work = 0, dashpot_work = 0;  // [J]
};

class Run {
 public:
  explicit Run(Model& model) : model_(model) {}

  // Steps on until `steps` have been made in all.
  Bits after(int steps) {
    for (; step_ < steps; ++step_) {
      choose_material(model_, step_);
      cycle(model_, box_);
      add_totals(totals_, model_);
      note();
    }
    return {model_.hash(), totals_.value()};
  }
  Events events() const { return events_; }

 private:
  void note() {
    events_.refreshes = model_.contacts.refreshes(), events_.rebuilds = model_.contacts.rebuilds();
    events_.most_contacts = std::max(events_.most_contacts, model_.pair_totals.active);
    events_.most_walls = std::max(events_.most_walls, model_.wall_totals.contacts);
    events_.most_pile = std::max(events_.most_pile, model_.pile_totals.all().contacts);
    events_.slip_work += model_.pair_totals.slip_work;
    events_.dashpot_work += model_.pair_totals.dashpot_work;
  }

  Model& model_;
  ClosingBox box_;
  Hash totals_;
  Events events_;
  int step_ = 0;
};

}  // namespace

TEST_CASE("one, two, three and eight threads give the same bits, state and totals, over thousands of steps") {
  struct Leg {
    int threads, steps;
  };
  for (const Crowd crowd : {Crowd::Spheres, Crowd::Clumps, Crowd::Mixed}) {
    // Eight threads on few cores spend their time waiting for each other: they go the shortest way.
    const Leg legs[] = {{8, 4 * period}, {3, 8 * period}, {2, (crowd == Crowd::Spheres ? 67 : 12) * period}};
    const auto alone = squeezed(crowd, 1);
    REQUIRE(alone->particles.body_count() > 5 * chunk_bodies);
    Run truth(*alone);
    for (const auto& [threads, steps] : legs) {
      const auto model = squeezed(crowd, threads);
      CAPTURE(static_cast<int>(crowd), threads, steps);
      CHECK((Run(*model).after(steps) == truth.after(steps)));
    }
    const Events events = truth.events();
    CAPTURE(static_cast<int>(crowd), events.refreshes, events.rebuilds, events.most_contacts, events.most_walls,
            events.most_pile, events.slip_work, events.dashpot_work);
    CHECK(events.refreshes > 20);
    CHECK(events.rebuilds > 3);
    CHECK(events.most_contacts > 500);
    CHECK(events.most_walls > 100);
    CHECK(events.most_pile > 3);
    CHECK(events.slip_work > 0);
    CHECK(events.dashpot_work > 0);
  }
}

TEST_CASE("any number of threads finds the same limit of the step, of the same grain") {
  for (const Crowd crowd : {Crowd::Spheres, Crowd::Mixed}) {
    const auto pressed = [&](int threads) {
      auto model = squeezed(crowd, threads);
      choose_material(*model, 0);
      model->facet_material.contact_modulus = model->material.contact_modulus;
      model->particles.scale_all(1.45);
      evaluate_forces(*model);
      return model;
    };
    const auto alone = pressed(1);
    REQUIRE(alone->pair_totals.active > 3000);
    const StepLimit truth = stable_step(*alone, 0.2);
    REQUIRE(truth.worst_body >= 0);
    for (const int threads : {2, 3, 8}) {
      const auto model = pressed(threads);
      const StepLimit limit = stable_step(*model, 0.2);
      CAPTURE(static_cast<int>(crowd), threads, limit.step);
      CHECK(limit.step == truth.step);
      CHECK(limit.worst_body == truth.worst_body);
      CHECK(limit.touching_squared == truth.touching_squared);
    }
  }
}

// A new size of the team renews the list, and another list has its sums in another order (see the last test): the state alone
// is the same to the bit.
TEST_CASE("a team that changes its size on the way changes no bit of the state") {
  const auto alone = squeezed(Crowd::Mixed, 1), changing = squeezed(Crowd::Mixed, 3);
  constexpr int sizes[] = {1, 4, 2, 5, 3};
  Run truth(*alone), run(*changing);
  for (int k = 0; k < 10; ++k) {
    changing->team = std::make_unique<Team>(sizes[k % 5]);
    const int steps = 13 * (k + 1);
    CAPTURE(steps, sizes[k % 5]);
    CHECK(run.after(steps).state == truth.after(steps).state);
  }
}

// Generic x86-64 rounds a product and its sum one after the other, the others once for both. What that makes is round-off, until
// the packing's own sensitivity has magnified it: hence few steps.
TEST_CASE("AVX2 and AVX-512 give the same bits, state and totals, and generic instructions the same to round-off") {
  for (const Crowd crowd : {Crowd::Spheres, Crowd::Mixed}) {
    constexpr int steps = 5 * period, few_steps = 20;
    const auto best = squeezed(crowd, 1);
    Run run(*best);
    run.after(few_steps);
    const Particles soon = best->particles;
    const Bits truth = run.after(steps);
    for (const InstructionSet set : known_instructions()) {
      const auto model = squeezed(crowd, 2, set);
      CAPTURE(static_cast<int>(crowd), name_of(set));
      if (set != InstructionSet::Generic || known_instructions().size() == 1) {
        CHECK((Run(*model).after(steps) == truth));
        continue;
      }
      Run(*model).after(few_steps);
      double farthest = 0, fastest = 0;
      for (std::size_t b = 0; b < soon.body_count(); ++b) {
        const Particles& p = model->particles;
        farthest = std::max(farthest, (p.position(b) - soon.position(b)).norm() / p.equivalent_radius(b));
        fastest = std::max(fastest, (p.velocity(b) - soon.velocity(b)).norm());
      }
      INFO("places differ by " << farthest << " radii, velocities by " << fastest << " m/s after " << few_steps
                               << " steps");
      CHECK(farthest < 1e-12);
      CHECK(fastest < 1e-9);
    }
  }
}

TEST_CASE("what is wanted of the totals changes neither the state nor the totals that all of them have") {
  const auto all = squeezed(Crowd::Mixed, 1), works = squeezed(Crowd::Mixed, 2), forces = squeezed(Crowd::Mixed, 2),
             in_turn = squeezed(Crowd::Mixed, 1);
  works->detail = Detail::Works;
  forces->detail = Detail::Forces;
  constexpr Detail details[] = {Detail::Forces, Detail::Works, Detail::All};
  ClosingBox box;
  double slip = 0, dashpots = 0;
  bool same_works = true, same_speed = true;
  for (int k = 0; k < 5 * period; ++k) {
    in_turn->detail = details[k % 3];
    for (Model* model : {all.get(), works.get(), forces.get(), in_turn.get()}) {
      choose_material(*model, k);
      cycle(*model, box);
    }
    same_works = same_works && works->pair_totals.slip_work == all->pair_totals.slip_work &&
                 works->pair_totals.dashpot_work == all->pair_totals.dashpot_work &&
                 works->motion.contact_work == all->motion.contact_work &&
                 works->motion.kinetic_energy() == all->motion.kinetic_energy();
    same_speed = same_speed && forces->motion.largest_speed == all->motion.largest_speed;
    slip += all->pair_totals.slip_work, dashpots += all->pair_totals.dashpot_work;
  }
  CAPTURE(slip, dashpots);
  CHECK(slip > 0);
  CHECK(dashpots > 0);
  CHECK(same_works);
  CHECK(same_speed);
  CHECK(works->hash() == all->hash());
  CHECK(forces->hash() == all->hash());
  CHECK(in_turn->hash() == all->hash());
}

// The eight partial sums of a chunk take the entries of its list in turn, touching or not: another list has the same
// touching entries in other places. Its sums are the same but for rounding, some 1e3 additions of 1.1e-16 each; its
// counts and largest overlaps are the same.
TEST_CASE("a list renewed or restored at arbitrary steps changes no bit of the state, and sums by rounding alone") {
  for (const Crowd crowd : {Crowd::Spheres, Crowd::Mixed}) {
    const auto calm = squeezed(crowd, 1), restored = squeezed(crowd, 3);
    Random random(5);
    ClosingBox box;
    int renewals = 0;
    std::int64_t springs = 0;
    double worst = 0;
    bool same_counts = true, same_state = true;
    for (int k = 0; k < 6 * period; ++k) {
      choose_material(*calm, k), choose_material(*restored, k);
      if (random.uniform() < 0.2) {
        const auto kept = restored->contacts.springs();
        restored->contacts.restore(restored->particles, kept);
        springs += static_cast<std::int64_t>(kept.size());
        ++renewals;
      }
      cycle(*calm, box), cycle(*restored, box);
      const ContactTotals &a = calm->pair_totals, &b = restored->pair_totals;
      same_counts = same_counts && a.active == b.active && a.largest_overlap_ratio == b.largest_overlap_ratio;
      const double energy = a.elastic_energy() + calm->motion.kinetic_energy();
      worst = std::max(worst, std::abs(a.normal_energy - b.normal_energy) / energy);
      worst = std::max(worst, std::abs(a.shear_energy - b.shear_energy) / energy);
      worst = std::max(worst, std::abs(a.contact_force - b.contact_force) / std::max(a.contact_force, 1.0));
      if (k % 30 == 29) same_state = same_state && calm->hash() == restored->hash();
    }
    CAPTURE(static_cast<int>(crowd), renewals, springs, calm->contacts.refreshes(), worst);
    CHECK(renewals > 25);
    CHECK(springs > 1000);
    CHECK(same_counts);
    CHECK(same_state);
    CHECK(worst < 1e-13);
  }
}

TEST_CASE(
    "a stable step may be asked for before the first lists and after they were forgotten, by any number of threads") {
  for (const int threads : {1, 2, 3}) {
    const auto model = squeezed(Crowd::Mixed, threads);
    CHECK(model->contacts.partition().size() == 0);
    const double without_lists = stable_step(*model, 0.1).step;
    CHECK(without_lists > 0);
    ClosingBox box;
    for (int n = 0; n < 5; ++n) cycle(*model, box);
    model->contacts.clear_history();
    CHECK(model->contacts.partition().size() == 0);
    CHECK(stable_step(*model, 0.1).step > 0);
  }
}
