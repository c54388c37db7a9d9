// The regions that measurements are taken in: boxes, balls, and boxes cut into equal cells. What a region must know of
// the grains is how much of a sphere lies in it, and how much of a straight line.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "common/vectors.hpp"

namespace lockstep::dem {

struct Box {
  Vec3 low = Vec3::Zero(), high = Vec3::Zero();  // [m]
  bool contains(const Vec3& x) const { return (x.array() >= low.array()).all() && (x.array() < high.array()).all(); }
  double volume() const { return (high - low).prod(); }  // [m3]
  Box bounds() const { return *this; }
  // Share of the line from `begin` to `end` that lies inside [-].
  double share_of_line(const Vec3& begin, const Vec3& end) const;
  // Volume of a sphere's part inside, exact to round-off of the sphere's volume [m3].
  double part_of_sphere(const Vec3& center, double radius) const;
};

struct Ball {
  Vec3 center = Vec3::Zero();  // [m]
  double radius = 0;           // [m]
  bool contains(const Vec3& x) const { return (x - center).squaredNorm() < radius * radius; }
  double volume() const { return 4.0 / 3.0 * pi * radius * radius * radius; }  // [m3]
  Box bounds() const { return {center - Vec3::Constant(radius), center + Vec3::Constant(radius)}; }
  double share_of_line(const Vec3& begin, const Vec3& end) const;
  double part_of_sphere(const Vec3& center, double radius) const;
};

// Volume that two spheres share when they overlap by `overlap` along the line of their centres [m3].
double shared_volume(double radius_a, double radius_b, double overlap);

// A box cut into equal cells, x fastest.
class CellGrid {
 public:
  // Cells as near to cubes of side `cell` as fit the box without rest; at least one along each axis. InputError when
  // the box has no volume, or more cells than an int counts along an axis.
  CellGrid(const Box& bounds, double cell);

  const Box& bounds() const { return bounds_; }
  const std::array<int, 3>& count() const { return count_; }
  const Vec3& cell_size() const { return cell_; }  // [m]
  double cell_volume() const { return cell_.prod(); }
  std::size_t size() const { return static_cast<std::size_t>(count_[0]) * count_[1] * count_[2]; }
  std::size_t index(int i, int j, int k) const { return (static_cast<std::size_t>(k) * count_[1] + j) * count_[0] + i; }
  Box cell(int i, int j, int k) const;
  // The cells along `axis` that a stretch of that axis meets, first > last when none: those whose index is in [first,
  // last].
  std::array<int, 2> range(int axis, double low, double high) const;

  // Visits (cell index, share of the line) for each cell that the line from `begin` to `end` runs through. The shares
  // of a line inside the bounds sum to 1.
  template <class Visitor>
  void for_each_piece(const Vec3& begin, const Vec3& end, Visitor&& visit) const {
    std::vector<double>& cuts = cuts_;
    cuts.assign({0.0, 1.0});
    const Vec3 line = end - begin;
    for (int axis = 0; axis < 3; ++axis) {
      const auto [first, last] = range(axis, std::min(begin[axis], end[axis]), std::max(begin[axis], end[axis]));
      for (int plane = first; plane <= last + 1; ++plane) {
        const double at = (bounds_.low[axis] + plane * cell_[axis] - begin[axis]) / line[axis];
        if (at > 0 && at < 1) cuts.push_back(at);  // a line along the plane gives no number, and no cut
      }
    }
    std::sort(cuts.begin(), cuts.end());
    for (std::size_t n = 0; n + 1 < cuts.size(); ++n) {
      const Vec3 middle = begin + 0.5 * (cuts[n] + cuts[n + 1]) * line;
      if (!bounds_.contains(middle)) continue;
      std::array<int, 3> at;
      for (int axis = 0; axis < 3; ++axis) at[axis] = place(axis, middle[axis]);
      visit(index(at[0], at[1], at[2]), cuts[n + 1] - cuts[n]);
    }
  }

 private:
  int place(int axis, double x) const {
    return std::clamp(static_cast<int>((x - bounds_.low[axis]) / cell_[axis]), 0, count_[axis] - 1);
  }

  Box bounds_;
  std::array<int, 3> count_{};
  Vec3 cell_ = Vec3::Zero();          // [m]
  mutable std::vector<double> cuts_;  // of one line, kept so that no line allocates
};

}  // namespace lockstep::dem
