// A rigid surface of triangles, read from an STL file, and the contacts of a sphere with it.
//
// The surface is thin and presses on both sides, towards the side that a centre is on: the order of a triangle's corners
// (its orientation) is of no account, which is what files from different programs need. A sphere must therefore not sink
// in by its radius: its centre would be on the other side.
//
// ONE CONTACT ON A SMOOTH SURFACE. The rules are those of interface_facets.hpp.
//
//   1. Local minima only. The closest point of a triangle counts if it is a local minimum of the distance to the WHOLE
//      surface: on an edge or a corner only if no triangle that shares it comes closer. Corners are the same when their
//      coordinates in the file are. Equal minima are one push, so files that have a corner twice, apart by rounding, do
//      no harm.
//   2. One push. Minima whose directions differ by less than merge_angle stand for one curved surface (the inside of a
//      faceted drum): the contact is the SHORTEST PUSH t that frees the sphere of all of them,
//          |t| -> min   with   t . n_i >= U_i;    overlap |t|, normal t/|t|.
//      t changes by no more than the centre moves and |t|^2/2 is its potential: a sphere that rolls over edges gains and
//      loses no energy. Without this rule a drum of ever finer facets does not converge to the round one: over every
//      edge a share R/R_drum of the circumference is touched twice.
//
// WHICH TRIANGLES. A grid of cubes holds, for each, the triangles that reach into it. A sphere looks at the cubes
// around it, once a renewal of its list of candidates; an empty cube costs one comparison.
#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

#include "common/vectors.hpp"

namespace lockstep::dem {

// Feature of a triangle that a closest point lies on.
enum class TriangleFeature : std::int8_t { Face, Edge, Corner };

struct TrianglePoint {
  Vec3 point = Vec3::Zero();  // [m]
  TriangleFeature feature = TriangleFeature::Face;
  std::int8_t index = 0;  // of the edge (from corner k to corner k+1) or corner
};

TrianglePoint closest_point(const std::array<Vec3, 3>& corners, const Vec3& x);

// One contact of a sphere with a mesh.
struct MeshContact {
  double overlap = 0;           // [m]
  Vec3 normal = Vec3::UnitZ();  // unit, towards the sphere's centre
};

// The shortest t with t . n_i >= U_i, U_i > 0, unit n_i that lie within a right angle of each other.
Vec3 shortest_push(const std::vector<MeshContact>& constraints);

class TriangleMesh {
 public:
  static constexpr double merge_angle = pi / 3;      // between a drum's facets and its corners [rad]
  static constexpr double largest_coordinate = 1e6;  // [m]
  static constexpr double smallest_size = 1e-6;      // of the whole [m]
  static constexpr double least_slenderness = 1e-9;  // twice the area over the square of the longest edge

  // InputError, in words that begin with `name`, without triangles, with one that has no area, or for absurd sizes.
  TriangleMesh(const std::vector<std::array<Vec3, 3>>& triangles, std::string_view name);

  std::size_t triangle_count() const { return triangles_.size(); }
  std::size_t corner_count() const { return corners_.size(); }
  std::array<Vec3, 3> corners(std::size_t t) const {
    return {corners_[triangles_[t][0]], corners_[triangles_[t][1]], corners_[triangles_[t][2]]};
  }
  double area() const;  // of all triangles, one side [m2]
  const Vec3& low() const { return low_; }
  const Vec3& high() const { return high_; }

  // Adds the triangles nearer to x than `reach` to `found`, by rising index. `found` may hold others already.
  void list_near(const Vec3& x, double reach, std::vector<std::int32_t>& found) const;

  // Contacts of a sphere with some of the triangles, the deepest first. Every triangle that it touches must be among
  // `near`.
  struct Scratch;
  void touch(const Vec3& center, double radius, const std::int32_t* near, std::size_t count, Scratch& scratch,
             std::vector<MeshContact>& contacts) const;

 private:
  struct Foot {
    TrianglePoint at;
    std::int32_t triangle = -1;
    double distance = 0;  // [m]
    Vec3 normal = Vec3::Zero();
  };

 public:
  // Kept by the caller, one a thread: nothing is allocated in a step.
  struct Scratch {
    std::vector<Foot> feet;
    std::vector<MeshContact> minima;
    std::vector<MeshContact> merged;
    std::vector<char> is_taken;
  };

 private:
  void make_grid();
  std::array<int, 3> cell_of(const Vec3& x) const;
  std::size_t cell_index(int i, int j, int k) const {
    return static_cast<std::size_t>(i) +
           static_cast<std::size_t>(cells_[0]) *
               (static_cast<std::size_t>(j) + static_cast<std::size_t>(cells_[1]) * static_cast<std::size_t>(k));
  }
  bool has_feature(std::int32_t triangle, const Foot& foot) const;
  bool is_local_minimum(const std::vector<Foot>& feet, std::size_t i) const;
  Vec3 normal_of(std::size_t t) const;  // unit

  Vec3s corners_;                                       // [m]
  std::vector<std::array<std::int32_t, 3>> triangles_;  // corners
  Vec3 low_ = Vec3::Zero(), high_ = Vec3::Zero();       // box around all [m]
  double cell_ = 1;                                     // edge of a cube [m]
  std::array<int, 3> cells_ = {0, 0, 0};                // along x, y, z
  std::vector<std::int32_t> cell_begin_;                // one more than cubes
  std::vector<std::int32_t> cell_triangles_;            // by rising index in each
};

// Reads an STL file, ASCII or binary; coordinates become scale * x + shift. IoError when it cannot be read, InputError
// when it is no STL file, is cut short, or its surface is none (above).
TriangleMesh read_stl(const std::filesystem::path& path, double scale = 1, const Vec3& shift = Vec3::Zero());

}  // namespace lockstep::dem
