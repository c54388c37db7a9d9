#include <catch2/catch.hpp>

#include "dem_server/fabric.hpp"
#include "dem_server/force_network.hpp"

using namespace lockstep;
using namespace lockstep::dem;

namespace {

ContactView touch(std::int32_t a, std::int32_t b, const Vec3& normal = Vec3::UnitX(),
                  const Vec3& force = Vec3::Zero()) {
  ContactView c;
  c.body_a = a, c.body_b = b, c.normal = normal, c.force_on_a = force;
  return c;
}

double sum_of_areas(const Histogram& h) {
  double sum = 0;
  for (std::size_t n = 0; n < h.counts.size(); ++n) sum += h.density(n) * h.bin_width;
  return sum;
}

}  // namespace

TEST_CASE("the mechanical coordination number leaves out grains with no or one partner") {
  // Partners: 0 and 1 have 2, 2 has 3, 3 has 2 and two walls, 4 and 5 have each other, 6 has none. Thornton:
  // (2 N_c - N_1) / (N - N_0 - N_1), where 2 N_c = 12 is the sum of all partners.
  Coordination c(7);
  c.add(touch(0, 1)), c.add(touch(1, 0)), c.add(touch(0, 2)), c.add(touch(2, 1)), c.add(touch(2, 3));
  c.add(touch(3, -1)), c.add(touch(3, -1)), c.add(touch(4, 5));
  const PartnerCounts n = c.partners();
  CHECK(n.distribution() == std::vector<std::size_t>{1, 2, 2, 2});
  CHECK(n.mean() == Approx(12.0 / 7));
  CHECK(n.rattlers() == 3);
  for (std::int32_t b = 0; b < 7; ++b) CHECK(c.partners_of(b) == n[static_cast<std::size_t>(b)]);
  CHECK(n.mechanical_mean() == Approx(10.0 / 4));
  CHECK(n.of([](std::size_t b) { return b >= 4; }).mean() == Approx(2.0 / 3));
  CHECK(Coordination(0).mean() == 0);
  CHECK(Coordination(2).partners().mechanical_mean() == 0);
}

TEST_CASE("fabric is isotropic for three axes, half for a plane and whole for a line") {
  Fabric none, axes, plane, line;
  for (int axis = 0; axis < 3; ++axis) axes.add(touch(0, 1, Vec3::Unit(axis)));
  for (int n = 0; n < 12; ++n) plane.add(touch(0, 1, Vec3(std::cos(n * pi / 12), std::sin(n * pi / 12), 0)));
  for (int n = 0; n < 4; ++n) line.add(touch(0, 1, Vec3(0.6, 0, 0.8)));
  line.add(touch(0, -1, Vec3::UnitY()));  // a wall
  CHECK(none.deviator() == 0);
  CHECK(axes.deviator() < 1e-15);
  // diag(1/2, 1/2, 0): D = (1/6, 1/6, -1/3), 3/2 D:D = 1/4.
  CHECK(plane.deviator() == Approx(0.5));
  CHECK(plane.tensor()[2] == 0);
  CHECK(line.deviator() == Approx(1));
  CHECK(line.contacts() == 4);
  CHECK(line.tensor()[5] == Approx(0.48));
}

TEST_CASE("anisotropy is that of the density that the normals are drawn from") {
  // E(n) = (1 + a (3 u^2 - 1) / 2) / (4 pi) with u = n_z: a_zz = a, a_xx = a_yy = -a/2, sqrt(3/2 a_ij a_ij) = 3/2 a.
  // u is drawn at equal steps of its distribution (1 + u + a (u^3 - u) / 2) / 2, found by bisection, the azimuth by
  // the golden angle: an even sample, whose error is about 1 / N.
  const double a = 0.4;
  constexpr int count = 20000;
  Fabric fabric;
  for (int n = 0; n < count; ++n) {
    double low = -1, high = 1;
    const double wanted = (n + 0.5) / count;
    for (int step = 0; step < 50; ++step) {
      const double u = 0.5 * (low + high);
      (0.5 * (1 + u + 0.5 * a * (u * u * u - u)) < wanted ? low : high) = u;
    }
    const double ring = std::sqrt(1 - low * low), turn = n * pi * (3 - std::sqrt(5.0));
    fabric.add(touch(0, 1, Vec3(ring * std::cos(turn), ring * std::sin(turn), low)));
  }
  const double error = fabric.anisotropy() - 1.5 * a;
  CAPTURE(error);
  CHECK(std::abs(error) < 1e-4);
}

TEST_CASE("forces with an exponential distribution have its density and its share of strong contacts") {
  // F at equal steps of 1 - exp(-F): mean 1, share above the mean 1/e, which carries 2/e of the sum. Bin [a, b) holds
  // exp(-a) - exp(-b).
  constexpr int count = 100000;
  std::vector<ContactView> contacts;
  for (int n = 0; n < count; ++n) {
    const double force = -50 * std::log(1 - (n + 0.5) / count);
    contacts.push_back(touch(0, 1, Vec3::UnitY(), Vec3(0, -force, 0)));
  }
  contacts.push_back(touch(0, -1, Vec3::UnitY(), Vec3(0, -1e6, 0)));  // a wall
  contacts.push_back(touch(0, 1));                                    // touches, presses nothing
  const ForceNetwork n = force_network(contacts, 0.5);
  const double mean = n.mean_normal_force / 50 - 1, strong = n.strong_share - std::exp(-1.0);
  const double carried = n.strong_force_share - 2 * std::exp(-1.0);
  double worst = 0;
  const double w = n.normal_force.bin_width;
  for (int k = 0; k < 40; ++k)
    worst = std::max(worst, std::abs(n.normal_force.density(k) - (std::exp(-k * w) - std::exp(-(k + 1) * w)) / w));
  CAPTURE(mean, strong, carried, worst);
  CHECK(n.contacts == count);
  CHECK(std::abs(mean) < 1e-4);
  CHECK(std::abs(strong) < 1e-4);
  CHECK(std::abs(carried) < 1e-4);
  CHECK(worst < 1e-3);
  CHECK(sum_of_areas(n.normal_force) == Approx(1));
}

TEST_CASE("mobilised friction is the shear force over what friction can hold") {
  // Shear 0.05, 0.10, ... 1.00 of mu F_n: the mean is 21/40, one of twenty slides.
  const double friction = 0.7;
  std::vector<ContactView> contacts;
  for (int n = 1; n <= 20; ++n) contacts.push_back(touch(0, 1, Vec3::UnitX(), Vec3(-10, 0, 0.05 * n * friction * 10)));
  const ForceNetwork n = force_network(contacts, friction);
  CHECK(n.mean_mobilisation == Approx(21.0 / 40));
  CHECK(n.sliding_share == Approx(1.0 / 20));
  CHECK(sum_of_areas(n.mobilisation) == Approx(1));
  CHECK(n.mobilisation.counts.size() == 20);
  CHECK(mobilisation_of(contacts[0], 0) == 0);
  const ForceNetwork none = force_network({}, friction);
  CHECK(none.contacts == 0);
  CHECK(none.normal_force.density(0) == 0);
}

TEST_CASE("one contact that carries nearly everything does not make a histogram of its own size") {
  std::vector<ContactView> contacts(100000, touch(0, 1, Vec3::UnitX(), Vec3(-1e-9, 0, 0)));
  contacts.push_back(touch(0, 1, Vec3::UnitX(), Vec3(-1e6, 0, 0)));
  const ForceNetwork n = force_network(contacts, 0.5);
  CHECK(n.normal_force.counts.size() <= 1001);
  CHECK(n.normal_force.total() == contacts.size());
  CHECK(n.normal_force.counts.back() == 1);
}
