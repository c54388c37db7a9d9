#include "dem_server/timestep.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/checks.hpp"
#include "common/random.hpp"

namespace lockstep::dem {

namespace {

using Mat6 = Eigen::Matrix<double, 6, 6>;
using Mat36 = Eigen::Matrix<double, 3, 6>;
using Vec6 = Eigen::Matrix<double, 6, 1>;

Mat3 cross_matrix(const Vec3& r) {
  Mat3 m;
  m << 0, -r.z(), r.y(), r.z(), 0, -r.x(), -r.y(), r.x(), 0;
  return m;
}

// Velocity of the contact point per mass-scaled velocity of the body: G of the header. Rotation in the body's axes.
Mat36 mass_scaled_map(const Particles& particles, std::int32_t body, const Vec3& lever) {
  Mat36 g;
  g.leftCols<3>() = Mat3::Identity() / std::sqrt(particles.mass(body));
  const Vec3 root = particles.inertia(body).cwiseSqrt().cwiseInverse();
  g.rightCols<3>() = -cross_matrix(lever) * particles.orientation(body).toRotationMatrix() * root.asDiagonal();
  return g;
}

// Symmetric square root of the contact's stiffness.
Mat3 root_stiffness(const ContactView& c) {
  const double n = std::sqrt(c.normal_stiffness), s = std::sqrt(c.shear_stiffness);
  return (n - s) * c.normal * c.normal.transpose() + s * Mat3::Identity();
}

// What a contact with a wall adds to its body's diagonal block.
Mat6 wall_block(const ContactView& contact, const Particles& particles) {
  const Vec3 lever = contact.point - particles.position(contact.body_a);
  const Mat36 h = root_stiffness(contact) * mass_scaled_map(particles, contact.body_a, lever);
  return h.transpose() * h;
}

// Upper bound of the largest eigenvalue of a positive semi-definite matrix, at most size^(1/16) too large:
// |D^8|_F^(1/8).
template <class Matrix>
double largest_eigenvalue_bound(const Matrix& d) {
  const double size = d.trace();
  if (!(size > 0)) return 0;
  Matrix power = d / size;
  for (int k = 0; k < 3; ++k) power = (power * power).eval();
  return size * std::pow(power.norm(), 0.125);
}

}  // namespace

void StiffnessSum::reset(std::size_t bodies) { reset(Partition{{0, static_cast<std::int32_t>(bodies)}}); }

void StiffnessSum::reset(const Partition& partition) {
  const auto bodies = static_cast<std::size_t>(partition.body_begin.back());
  diagonal_.resize(bodies), own_.resize(bodies), scale_.resize(bodies), image_.resize(bodies);
  std::fill(diagonal_.begin(), diagonal_.end(), Mat6::Zero());
  parts_.resize(static_cast<std::size_t>(partition.size()));
  for (std::size_t p = 0; p < parts_.size(); ++p) {
    parts_[p].begin = partition.body_begin[p], parts_[p].end = partition.body_begin[p + 1];
    parts_[p].couplings.clear();
  }
}

void StiffnessSum::add(const ContactView& contact, const Particles& particles) {
  const Vec3 end = contact.body_b >= 0 ? particles.position(contact.body_b) : contact.point;
  add(contact, particles, Vec3(end - particles.position(contact.body_a)));
}

void StiffnessSum::add(const ContactView& contact, const Particles& particles, const Vec3& branch) {
  if (contact.body_b < 0) {
    diagonal_[contact.body_a] += wall_block(contact, particles);
    return;
  }
  LOCKSTEP_ASSERT(parts_.size() == 1, "a pair among bodies of {} parts", parts_.size());
  const Vec3 lever_a = contact.point - particles.position(contact.body_a);
  add_levers(parts_[0], contact, particles, lever_a, Vec3(lever_a - branch));
}

void StiffnessSum::add_to_part(int part, const ContactView& contact, const Particles& particles) {
  const Vec3 lever_a = contact.point - particles.position(contact.body_a);
  const Vec3 branch = particles.position(contact.body_b) - particles.position(contact.body_a);
  add_levers(parts_[static_cast<std::size_t>(part)], contact, particles, lever_a, Vec3(lever_a - branch));
}

void StiffnessSum::add_levers(Part& part, const ContactView& contact, const Particles& particles, const Vec3& lever_a,
                              const Vec3& lever_b) {
  const Mat3 root = root_stiffness(contact);
  const std::int32_t a = contact.body_a, b = contact.body_b;
  const Mat36 h_a = root * mass_scaled_map(particles, a, lever_a);
  if (a >= part.begin && a < part.end) diagonal_[a] += h_a.transpose() * h_a;
  const Mat36 h_b = root * mass_scaled_map(particles, b, lever_b);
  if (b >= part.begin && b < part.end) diagonal_[b] += h_b.transpose() * h_b;
  const double product = std::sqrt(largest_eigenvalue_bound<Mat3>(h_a * h_a.transpose()) *
                                   largest_eigenvalue_bound<Mat3>(h_b * h_b.transpose()));
  part.couplings.push_back({a, b, product});
}

// Gershgorin's rows of the part's bodies, over their scale: the largest of them.
void StiffnessSum::look_at_rows(Part& part) {
  for (std::int32_t b = part.begin; b < part.end; ++b) image_[b] = own_[b] * scale_[b];
  for (const Coupling& c : part.couplings) {
    if (c.a >= part.begin && c.a < part.end) image_[c.a] += c.strength * scale_[c.b];
    if (c.b >= part.begin && c.b < part.end) image_[c.b] += c.strength * scale_[c.a];
  }
  part.largest = 0, part.worst = -1;
  for (std::int32_t b = part.begin; b < part.end; ++b)
    if (const double ratio = image_[b] / scale_[b]; ratio > part.largest) part.largest = ratio, part.worst = b;
}

double StiffnessSum::stable_step(double damping, std::int32_t* worst_body, Team& team) {
  const auto for_each_part = [&](auto&& work) {
    team.run_parts(static_cast<int>(parts_.size()), [&](int part) { work(parts_[static_cast<std::size_t>(part)]); });
  };
  for_each_part([&](const Part& part) {
    for (std::int32_t b = part.begin; b < part.end; ++b)
      own_[b] = largest_eigenvalue_bound<Mat6>(diagonal_[b]), scale_[b] = 1;
  });
  double least = std::numeric_limits<double>::infinity();
  std::int32_t worst = -1;
  for (int sweep = 0; sweep < bound_sweeps; ++sweep) {
    for_each_part([&](Part& part) { look_at_rows(part); });
    double largest = 0;
    std::int32_t at = -1;
    for (const Part& part : parts_)
      if (part.largest > largest) largest = part.largest, at = part.worst;
    if (at < 0) break;  // no contact
    if (largest < least) least = largest, worst = at;
    // A body without contacts keeps its scale; the others turn towards Perron's vector.
    for_each_part([&](const Part& part) {
      for (std::int32_t b = part.begin; b < part.end; ++b)
        if (image_[b] > 0) scale_[b] = image_[b] / largest;
    });
  }
  if (worst_body) *worst_body = worst;
  if (worst < 0) return std::numeric_limits<double>::infinity();
  return 2 / std::sqrt(least * (1 + damping));
}

double largest_wall_frequency_squared(const std::vector<ContactView>& contacts, const Particles& particles) {
  double largest = 0;
  for (std::size_t k = 0; k < contacts.size();) {
    const std::int32_t body = contacts[k].body_a;
    Mat6 sum = Mat6::Zero();
    for (; k < contacts.size() && contacts[k].body_a == body; ++k) sum += wall_block(contacts[k], particles);
    LOCKSTEP_ASSERT(k == contacts.size() || contacts[k].body_a > body, "contacts do not come body by body");
    largest = std::max(largest, largest_eigenvalue_bound<Mat6>(sum));
  }
  return largest;
}

double critical_step_power(const std::vector<ContactView>& contacts, const Particles& particles, double damping,
                           int products, const Vec3s& branches) {
  if (contacts.empty()) return std::numeric_limits<double>::infinity();
  std::vector<Mat36> map_a, map_b;
  for (std::size_t c = 0; c < contacts.size(); ++c) {
    const ContactView& contact = contacts[c];
    const Mat3 root = root_stiffness(contact);
    const Vec3 lever_a = contact.point - particles.position(contact.body_a);
    map_a.push_back(root * mass_scaled_map(particles, contact.body_a, lever_a));
    if (contact.body_b < 0) {
      map_b.push_back(Mat36::Zero());
    } else {
      const Vec3 lever_b =
          branches.empty() ? Vec3(contact.point - particles.position(contact.body_b)) : Vec3(lever_a - branches[c]);
      map_b.push_back(root * mass_scaled_map(particles, contact.body_b, lever_b));
    }
  }
  std::vector<Vec6> shape(particles.body_count()), image(particles.body_count());
  Random random(1);
  for (Vec6& s : shape)
    for (int k = 0; k < 6; ++k) s[k] = random.uniform(-1, 1);
  double squared_frequency = 0;
  for (int product = 0; product < products; ++product) {
    double norm = 0;
    for (const Vec6& s : shape) norm += s.squaredNorm();
    const double scale = 1 / std::sqrt(norm);
    for (Vec6& s : shape) s *= scale;
    for (Vec6& s : image) s.setZero();
    double energy = 0;
    for (std::size_t c = 0; c < contacts.size(); ++c) {
      const std::int32_t a = contacts[c].body_a, b = contacts[c].body_b;
      Vec3 stretch = map_a[c] * shape[a];
      if (b >= 0) stretch -= map_b[c] * shape[b];
      energy += stretch.squaredNorm();
      image[a] += map_a[c].transpose() * stretch;
      if (b >= 0) image[b] -= map_b[c].transpose() * stretch;
    }
    squared_frequency = energy;  // Rayleigh's quotient of the unit shape
    shape.swap(image);
  }
  return power_margin * 2 / std::sqrt(squared_frequency * (1 + damping));
}

double quiet_step(const Particles& particles, const GrainMaterial& material) {
  const double smallest = particles.smallest_radius();
  return quiet_share * std::sqrt(particles.lightest() / material.normal_stiffness(smallest, smallest));
}

}  // namespace lockstep::dem
