#include "tools/coupled_bar.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/packet.hpp"
#include "common/shape_functions.hpp"
#include "continuum_client/boundary_conditions.hpp"
#include "continuum_client/grid_builder.hpp"
#include "continuum_client/internal_force.hpp"
#include "continuum_client/settings.hpp"

namespace lockstep {
namespace {

using Eigen::Index, Eigen::MatrixXd, Eigen::VectorXd;

constexpr double zone_size = 0.1;          // h, of cubes [m]
constexpr double youngs_modulus = 44.3e6;  // [Pa]
constexpr double facet_factor = 2;
constexpr double middle_density = 1000;   // between spheres' and ground's, the mass ratio splits to both sides [kg/m3]
constexpr double width_of_spheres = 0.9;  // of a column's share of the facet: neighbours do not touch
constexpr double excursion = 0.05;        // of the overlap, the most that the start asks for
constexpr double grown = 1e3;             // of energies
constexpr double hopeless = 1e60;         // of amplitudes: no need to go on

}  // namespace

CoupledBar::CoupledBar(const BarCase& c) : case_(c) {
  radius_ = 0.5 * width_of_spheres * zone_size / c.columns;
  overlap_ = c.preload * radius_;
  pair_stiffness_ = c.contrast * youngs_modulus * zone_size;
  facet_stiffness_ = facet_factor * pair_stiffness_;
  grain_density_ = middle_density * std::sqrt(c.mass_ratio);
  const double sphere = grain_density_ * 4.0 / 3.0 * pi * radius_ * radius_ * radius_;
  ground_density_ = sphere / c.mass_ratio / (zone_size * zone_size * zone_size);
  if (c.columns == 1) {
    places_ = {{0.1 * zone_size, -0.17 * zone_size}};
  } else {
    for (int i = 0; i < c.columns; ++i)
      for (int j = 0; j < c.columns; ++j)
        places_.push_back({((i + 0.5) / c.columns - 0.5) * zone_size, ((j + 0.5) / c.columns - 0.5) * zone_size});
  }
  assemble();
  choose_start();
}

void CoupledBar::assemble() {
  const continuum::Settings settings = continuum::read_settings(scene(1, 0));
  const continuum::Grid grid = continuum::build_grid(settings);
  const continuum::StiffnessMatrix stiffness = continuum::assemble_stiffness(grid);
  const std::vector<double> mass = continuum::lumped_masses(grid);
  const Vec3s is_free = continuum::free_components(grid, settings.supports, mass, settings.is_free_direction);
  std::vector<Index> number(grid.node_count(), -1);  // of u_z in q
  for (std::size_t i = 0; i < number.size(); ++i)
    if (is_free[i].z() > 0) number[i] = nodes_++;
  const auto count = nodes_ + static_cast<Index>(places_.size()) * case_.spheres;
  mass_.resize(count);
  zones_ = spheres_ = interface_ = MatrixXd::Zero(count, count);
  start_ = load_ = VectorXd::Zero(count);
  for (std::size_t i = 0; i < number.size(); ++i) {
    if (number[i] < 0) continue;
    mass_[number[i]] = mass[i];
    for (std::int64_t k = stiffness.row_begin[i]; k < stiffness.row_begin[i + 1]; ++k) {
      const Index j = number[stiffness.column[k]];
      if (j >= 0) zones_(number[i], j) = zones_(j, number[i]) = stiffness.block[k](2, 2);
    }
  }
  const auto& facet = grid.facet.front();  // the only one
  stretch_ = MatrixXd::Zero(static_cast<Index>(places_.size()), count);
  for (std::size_t p = 0; p < places_.size(); ++p) {
    const Index lowest = nodes_ + static_cast<Index>(p) * case_.spheres;
    stretch_(static_cast<Index>(p), lowest) = 1;
    for (int j = 0; j < 4; ++j) {
      // Bilinear in x and y: product of the shares of the two sides.
      const Vec3& x = grid.node[facet[j]];
      const double share = (0.5 + 2 * x.x() * places_[p].x() / (zone_size * zone_size)) *
                           (0.5 + 2 * x.y() * places_[p].y() / (zone_size * zone_size));
      stretch_(static_cast<Index>(p), number[facet[j]]) = -share;
    }
    for (Index s = lowest; s < lowest + case_.spheres; ++s) {
      mass_[s] = grain_density_ * 4.0 / 3.0 * pi * radius_ * radius_ * radius_;
      spheres_(s, s) += pair_stiffness_;  // to the next one, or the wall
      if (s + 1 == lowest + case_.spheres) continue;
      spheres_(s + 1, s + 1) += pair_stiffness_;
      spheres_(s, s + 1) = spheres_(s + 1, s) = -pair_stiffness_;
    }
  }
  interface_ = facet_stiffness_ * stretch_.transpose() * stretch_;
  const VectorXd root = mass_.cwiseSqrt().cwiseInverse();
  const MatrixXd scaled = root.asDiagonal() * (zones_ + spheres_ + interface_) * root.asDiagonal();
  const VectorXd squares = Eigen::SelfAdjointEigenSolver<MatrixXd>(scaled, Eigen::EigenvaluesOnly).eigenvalues();
  omega_max_ = std::sqrt(squares[count - 1]), omega_min_ = std::sqrt(std::max(0.0, squares[0]));
}

// No displacement from it exceeds its energy's: |q| <= v / omega_min for the packet, p / k for the weight.
void CoupledBar::choose_start() {
  if (case_.has_weight) {
    const VectorXd weight = -mass_.tail(spheres());
    VectorXd load = VectorXd::Zero(mass_.size());
    load.tail(spheres()) = weight;
    const VectorXd settled = (zones_ + spheres_ + interface_).ldlt().solve(load);
    gravity_ = excursion * overlap_ / settled.cwiseAbs().maxCoeff();
    load_ = gravity_ * load;
    return;
  }
  const double lightest = mass_.minCoeff();
  peak_velocity_ = 1;
  const scene::Packet packet = scene(1, 0).scene.packet();
  const continuum::Grid grid = continuum::build_grid(continuum::read_settings(scene(1, 0)));
  const SceneFile file = scene(1, 0);
  const continuum::Settings settings = continuum::read_settings(file);
  const Vec3s is_free =
      continuum::free_components(grid, settings.supports, continuum::lumped_masses(grid), settings.is_free_direction);
  Index n = 0;
  for (std::size_t i = 0; i < grid.node_count(); ++i)
    if (is_free[i].z() > 0) start_[n++] = packet_velocity(packet, grid.node[i]).z();
  for (const scene::Grain& g : file.scene.grains().grain())
    start_[n++] = packet_velocity(packet, {g.center().x(), g.center().y(), g.center().z()}).z();
  // 1/2 v M v >= 1/2 omega_min^2 q M q >= 1/2 omega_min^2 m_min |q|^2
  const double furthest = std::sqrt(start_.dot(mass_.cwiseProduct(start_)) / lightest) / omega_min_;
  peak_velocity_ = excursion * overlap_ / furthest;
  start_ *= peak_velocity_;
}

SceneFile CoupledBar::scene(double step_fraction, double duration) const {
  return parse_scene(scene_text(step_fraction, duration), "bar of the stability map");
}

std::string CoupledBar::scene_text(double step_fraction, double duration) const {
  const double pitch = 2 * radius_ - overlap_, first = radius_ - overlap_ / facet_factor;
  std::string text = fmt::format(
      "gravity: {}\n"
      "continuum {{\n"
      "  youngs_modulus: {} poisson_ratio: 0.3 density: {} dynamic: {}\n"
      "  block {{ width_x: {} width_y: {} height: {} zones_x: 1 zones_y: 1 zones_z: {} }}\n"
      "  initial_supports: ROLLERS supports: ROLLERS held {{ x: true y: true }}\n"
      "}}\n"
      "plane {{ point {{ z: {} }} normal {{ z: -1 }} }}\n"
      "grains {{\n"
      "  density: {} contact_modulus: {} friction: 0 interface_friction: 0 facet_stiffness_factor: {}\n",
      gravity_, youngs_modulus, ground_density_, case_.damping == 0, zone_size, zone_size, case_.zones * zone_size,
      case_.zones, first + (case_.spheres - 1) * pitch + radius_ - overlap_, grain_density_,
      pair_stiffness_ / (2 * radius_), facet_factor);
  for (const Eigen::Vector2d& p : places_)
    for (int s = 0; s < case_.spheres; ++s)
      text += fmt::format("  grain {{ center {{ x: {} y: {} z: {} }} radius: {} }}\n", p.x(), p.y(), first + s * pitch,
                          radius_);
  text += fmt::format(
      "}}\n"
      "balance {{ servo: NONE max_cycles: 0 }}\n"
      "apply {{ baseline: HOLD max_steps: 0 }}\n"
      "run {{ duration: {} damping: {} continuum_damping: {} }}\n"
      "fidelity {{ step_fraction: {} exchange_interval: {} }}\n"
      "output {{ history_interval: 1 }}\n",
      duration, case_.damping, case_.damping, step_fraction, case_.exchange_interval);
  // Shorter than two zones and off every symmetry.
  if (!case_.has_weight)
    text += fmt::format("packet {{ velocity {{ z: {} }} center {{ x: {} z: {} }} length: {} wavelength_across: {} }}\n",
                        peak_velocity_, 0.3 * zone_size, -0.1 * zone_size, 3.1 * zone_size, 1.7 * zone_size);
  return text;
}

double CoupledBar::exact_limit() const { return 2 / omega_max_ / std::sqrt(1 + case_.damping); }

double CoupledBar::spectral_radius(double time_step) const {
  const double f = 0.5 * omega_max_ * time_step;
  return f <= 1 ? 1.0 : (f + std::sqrt(f * f - 1)) * (f + std::sqrt(f * f - 1));
}

// The order of an exchange (protocol/README.md): facets go to x(n) in n equal parts, in each of which the spheres take a step;
// the mean of the contacts' forces is what the nodes get at t_n.
class CoupledBar::Motion {
 public:
  Motion(const CoupledBar& bar, double time_step)
      : bar_(bar), dt_(time_step), inverse_mass_(bar.mass_.cwiseInverse()), nodes_(bar.nodes_) {
    q = VectorXd::Zero(bar.mass_.size()), v = bar.start_;
    places_ = q;
    k_zones_ = bar.zones_.topLeftCorner(nodes_, nodes_);
    k_spheres_ = bar.spheres_.bottomRightCorner(bar.spheres(), bar.spheres());
    from_nodes_ = bar.stretch_.leftCols(nodes_), from_spheres_ = bar.stretch_.rightCols(bar.spheres());
  }

  void exchange() {
    const Index spheres = bar_.spheres();
    const auto parts = static_cast<int>(is_first_ ? 1 : bar_.case_.exchange_interval);
    const double dt = dt_ / bar_.case_.exchange_interval;
    const VectorXd before = is_first_ ? VectorXd(q.head(nodes_)) : VectorXd(q.head(nodes_) - dt_ * v.head(nodes_));
    VectorXd sum = VectorXd::Zero(from_nodes_.rows());
    for (int k = 1; k <= parts; ++k) {
      const VectorXd facet = before + (static_cast<double>(k) / parts) * (q.head(nodes_) - before);
      const VectorXd force =
          -bar_.facet_stiffness_ * (from_nodes_ * facet + from_spheres_ * q.tail(spheres));  // on the spheres
      sum += force;
      VectorXd f = from_spheres_.transpose() * force - k_spheres_ * q.tail(spheres) + bar_.load_.tail(spheres);
      damp(f, v.tail(spheres));
      v.tail(spheres) += (is_first_ ? 0.5 : 1.0) * dt * inverse_mass_.tail(spheres).cwiseProduct(f);
      q.tail(spheres) += dt * v.tail(spheres);
      kinetic_spheres = v.tail(spheres).dot(bar_.mass_.tail(spheres).cwiseProduct(v.tail(spheres)));
    }
    VectorXd f = from_nodes_.transpose() * (sum / parts) - k_zones_ * q.head(nodes_);
    damp(f, v.head(nodes_));
    v.head(nodes_) += dt_ * inverse_mass_.head(nodes_).cwiseProduct(f);
    q.head(nodes_) += dt_ * v.head(nodes_);
    is_first_ = false;
  }

  VectorXd q, v;
  double kinetic_spheres = 0;

 private:
  // -alpha |F| sgn(v), none for v = 0.
  template <class Velocity>
  void damp(VectorXd& force, const Velocity& velocity) const {
    if (bar_.case_.damping == 0) return;
    for (Index i = 0; i < force.size(); ++i)
      if (velocity[i] != 0) force[i] -= bar_.case_.damping * std::copysign(std::abs(force[i]), velocity[i]);
  }

  const CoupledBar& bar_;
  double dt_;
  VectorXd inverse_mass_, places_;
  Index nodes_;
  MatrixXd k_zones_, k_spheres_, from_nodes_, from_spheres_;
  bool is_first_ = true;
};

CoupledBar::State CoupledBar::state_after(double time_step, std::uint64_t exchanges) const {
  Motion motion(*this, time_step);
  for (std::uint64_t n = 0; n < exchanges; ++n) motion.exchange();
  return {motion.q, motion.v};
}

double CoupledBar::kinetic_of_nodes(const VectorXd& v) const {
  return 0.5 * v.head(nodes_).dot(mass_.head(nodes_).cwiseProduct(v.head(nodes_)));
}
double CoupledBar::kinetic_of_spheres(const VectorXd& v) const {
  return 0.5 * v.tail(spheres()).dot(mass_.tail(spheres()).cwiseProduct(v.tail(spheres())));
}

double CoupledBar::start_energy() const {
  return case_.has_weight ? load_.cwiseAbs().sum() * excursion * overlap_
                          : kinetic_of_nodes(start_) + kinetic_of_spheres(start_);
}

CoupledBar::Growth CoupledBar::growth(double time_step, std::uint64_t exchanges) const {
  Motion motion(*this, time_step);
  const auto amplitude = [&] { return std::sqrt(kinetic_of_nodes(motion.v) + kinetic_of_spheres(motion.v)); };
  const double start = std::sqrt(start_energy());
  Growth g;
  double largest[4] = {};  // by quarters
  for (std::uint64_t n = 0; n < exchanges; ++n) {
    motion.exchange();
    const double now = amplitude();
    largest[4 * n / exchanges] = std::max(largest[4 * n / exchanges], now);
    if (g.onset == 0 && !(now < std::sqrt(grown) * start)) g.onset = n + 1;
    if (!(now < hopeless * start)) {
      g.grows = true, g.rate = std::pow(hopeless, 1.0 / static_cast<double>(n + 1));
      return g;
    }
  }
  g.rate = std::pow(largest[3] / largest[2], 4.0 / static_cast<double>(exchanges));
  g.grows = largest[3] > 2 * largest[2];
  g.is_bounded = largest[3] < 1.05 * largest[2];
  return g;
}

double CoupledBar::limit_by_growth(double low, double high, std::uint64_t exchanges) const {
  while (high > 1.001 * low) {
    const double middle = std::sqrt(low * high);
    (growth(middle, exchanges).grows ? high : low) = middle;
  }
  return low;
}

}  // namespace lockstep
