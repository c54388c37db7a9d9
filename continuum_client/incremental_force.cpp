#include "continuum_client/incremental_force.hpp"

#include <Eigen/LU>

#include "common/checks.hpp"

namespace lockstep::continuum {

Mat3 linear_elastic(const ElasticModuli& moduli, const Mat3& stress, const Mat3& strain, double dilatation) {
  return stress + elastic_stress(moduli, strain, dilatation);
}

IncrementalForce::IncrementalForce(const Grid& grid, const std::vector<char>& is_included, const InitialState& initial,
                                   bool has_large_strain, ConstitutiveLaw law)
    : grid_(grid),
      has_large_strain_(has_large_strain),
      law_(law),
      representative_(representative_zones(grid)),
      place_(grid.zone_count(), -1),
      corner_begin_(grid.node_count() + 1, 0) {
  for (std::size_t z = 0; z < grid.zone_count(); ++z) {
    if (!is_included.empty() && !is_included[z]) continue;
    place_[z] = static_cast<std::int32_t>(zone_.size());
    zone_.push_back(static_cast<std::int32_t>(z));
    for (const std::int32_t node : grid.zone[z]) ++corner_begin_[static_cast<std::size_t>(node) + 1];
  }
  for (std::size_t i = 0; i < grid.node_count(); ++i) corner_begin_[i + 1] += corner_begin_[i];
  corner_.resize(corner_begin_.back());
  std::vector<std::size_t> next(corner_begin_.begin(), corner_begin_.end() - 1);
  for (std::size_t k = 0; k < zone_.size(); ++k)
    for (int a = 0; a < 8; ++a)
      corner_[next[static_cast<std::size_t>(grid.zone[zone_[k]][a])]++] = {static_cast<std::int32_t>(k), a};

  state_.resize(zone_.size());
  zone_force_.resize(zone_.size());
  for (std::size_t k = 0; k < zone_.size(); ++k) {
    const auto z = static_cast<std::size_t>(zone_[k]);
    state_[k].stress.fill(initial.stress.empty() ? Mat3(Mat3::Zero()) : initial.stress[z]);
    state_[k].hourglass.fill(Vec3::Zero());
    const ZoneGeometry geometry = grid.geometry(static_cast<std::size_t>(representative_[z]));
    if (!initial.displacement.empty())
      deform(state_[k], geometry, grid.moduli(z), gather(initial.displacement, grid.zone[z]), false, nullptr);
    zone_force_[k] = force_of(state_[k], geometry);
  }
  last_force_.resize(grid.node_count());
  gather_forces(last_force_, Team::alone());
}

// The zone k with its nodes at the reference plus displacement, less `share` of the increment.
ZoneGeometry IncrementalForce::shape(std::size_t k, const Vec3s& displacement, const Vec3s* increment,
                                     double share) const {
  const auto& nodes = grid_.zone[zone_[k]];
  ZoneVectors x;
  for (int a = 0; a < 8; ++a) {
    x[a] = grid_.node[nodes[a]] + displacement[nodes[a]];
    if (increment) x[a] -= share * (*increment)[nodes[a]];
  }
  return zone_geometry(grid_.zone_kind, x);
}

void IncrementalForce::deform(ZoneState& state, const ZoneGeometry& g, const ElasticModuli& moduli,
                              const ZoneVectors& increment, bool turns, PointTensors* total_strain) const {
  std::array<Mat3, ZoneGeometry::most_points> gradient;
  std::array<double, ZoneGeometry::most_groups> dilatation{};
  for (int p = 0; p < g.point_count; ++p) {
    const StrainPoint& point = g.point[p];
    gradient[p].setZero();
    for (int a = 0; a < 8; ++a) gradient[p] += increment[a] * point.gradient[a].transpose();
    dilatation[point.group] += point.volume / g.group_volume[point.group] * gradient[p].trace();
  }
  // Half of the step's turn, twice: before the law and after it.
  const auto half_turn = [&](int p) -> Mat3 {
    const Mat3 quarter_spin = 0.125 * (gradient[p] - gradient[p].transpose());
    return (Mat3::Identity() - quarter_spin).inverse() * (Mat3::Identity() + quarter_spin);
  };
  for (int p = 0; p < g.point_count; ++p) {
    Mat3& stress = state.stress[p];
    const Mat3 strain = 0.5 * (gradient[p] + gradient[p].transpose());
    const double change = dilatation[g.point[p].group];
    if (!turns) {
      stress = law_(moduli, stress, strain, change);
      if (total_strain) (*total_strain)[p] += strain;
      continue;
    }
    const Mat3 turn = half_turn(p);
    if (total_strain) {
      Mat3& total = (*total_strain)[p];
      total = turn * (turn * total * turn.transpose() + strain) * turn.transpose();
    }
    stress = turn * law_(moduli, turn * stress * turn.transpose(), strain, change) * turn.transpose();
  }
  if (g.hourglass_stiffness == 0) return;
  const Mat3 turn = turns ? half_turn(0) : Mat3(Mat3::Identity());
  for (int alpha = 0; alpha < ZoneGeometry::patterns; ++alpha) {
    Vec3& force = state.hourglass[alpha];
    force = turn * force;
    for (int a = 0; a < 8; ++a) force += g.hourglass_stiffness * moduli.shear * g.hourglass[alpha][a] * increment[a];
    force = turn * force;
  }
}

ZoneVectors IncrementalForce::force_of(const ZoneState& state, const ZoneGeometry& g) const {
  ZoneVectors f;
  f.fill(Vec3::Zero());
  for (int p = 0; p < g.point_count; ++p)
    for (int a = 0; a < 8; ++a) f[a] += g.point[p].volume * (state.stress[p] * g.point[p].gradient[a]);
  if (g.hourglass_stiffness > 0)
    for (int alpha = 0; alpha < ZoneGeometry::patterns; ++alpha)
      for (int a = 0; a < 8; ++a) f[a] += g.hourglass[alpha][a] * state.hourglass[alpha];
  return f;
}

void IncrementalForce::gather_forces(Vec3s& force, Team& team) const {
  team.run([&](int t) {
    const auto [begin, end] = share_of(force.size(), t, team.size());
    for (std::size_t i = begin; i < end; ++i) {
      Vec3 sum = Vec3::Zero();
      for (std::size_t c = corner_begin_[i]; c < corner_begin_[i + 1]; ++c)
        sum += zone_force_[corner_[c].zone][corner_[c].corner];
      force[i] = sum;
    }
  });
}

void IncrementalForce::advance(const Vec3s& displacement, const Vec3s& velocity, double time_step, Vec3s& force,
                               Team& team) {
  Vec3s increment(velocity.size());
  for (std::size_t i = 0; i < velocity.size(); ++i) increment[i] = velocity[i] * time_step;
  std::vector<std::int32_t> inverted(static_cast<std::size_t>(team.size()), -1);
  team.run([&](int t) {
    const auto [begin, end] = share_of(zone_.size(), t, team.size());
    ZoneGeometry geometry;
    std::int32_t geometry_of = -1;
    for (std::size_t k = begin; k < end; ++k) {
      const auto z = static_cast<std::size_t>(zone_[k]);
      const ZoneVectors du = gather(increment, grid_.zone[z]);
      PointTensors* const total_strain = strain_.empty() ? nullptr : &strain_[k];
      if (has_large_strain_) {
        deform(state_[k], shape(k, displacement, &increment, 0.5), grid_.moduli(z), du, true, total_strain);
        geometry = shape(k, displacement, nullptr, 0);
        if (!(geometry.smallest_volume > 0)) inverted[static_cast<std::size_t>(t)] = zone_[k];
      } else {
        if (representative_[z] != geometry_of) {
          geometry_of = representative_[z];
          geometry = grid_.geometry(static_cast<std::size_t>(geometry_of));
        }
        deform(state_[k], geometry, grid_.moduli(z), du, false, total_strain);
      }
      zone_force_[k] = force_of(state_[k], geometry);
    }
  });
  for (const std::int32_t z : inverted)
    if (z >= 0) {
      const Vec3 x = grid_.zone_center(static_cast<std::size_t>(z));
      throw NumericalError(fmt::format(
          "zone {} of the ground, at ({:.4g}, {:.4g}, {:.4g}) m in the reference, has turned inside out: the "
          "strain is too large for this mesh; use larger zones there, less load, or lower "
          "fidelity.step_fraction",
          z, x.x(), x.y(), x.z()));
    }
  gather_forces(force, team);
  double work = 0;
  for (std::size_t i = 0; i < force.size(); ++i) work += 0.5 * (last_force_[i] + force[i]).dot(increment[i]);
  work_ += work;
  last_force_ = force;
}

void IncrementalForce::keep_strain() {
  PointTensors zero;
  zero.fill(Mat3::Zero());
  strain_.assign(zone_.size(), zero);
}

std::size_t IncrementalForce::bytes() const {
  return zone_.size() * (sizeof(ZoneState) + sizeof(ZoneVectors)) + strain_.size() * sizeof(PointTensors) +
         corner_.size() * sizeof(Corner) + last_force_.size() * sizeof(Vec3);
}

Mat3 IncrementalForce::mean(std::size_t z, const PointTensors& values) const {
  const ZoneGeometry g = grid_.geometry(z);
  Mat3 sum = Mat3::Zero();
  for (int p = 0; p < g.point_count; ++p) sum += g.point[p].volume * values[p];
  return sum / g.zone_volume();
}

Mat3 IncrementalForce::zone_stress(std::size_t z) const {
  return mean(z, state_[static_cast<std::size_t>(place_[z])].stress);
}

Mat3 IncrementalForce::zone_strain(std::size_t z) const {
  return mean(z, strain_[static_cast<std::size_t>(place_[z])]);
}

}  // namespace lockstep::continuum
