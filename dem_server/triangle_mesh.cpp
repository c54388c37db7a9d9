#include "dem_server/triangle_mesh.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <numeric>
#include <string>

#include "common/checks.hpp"

namespace lockstep::dem {

namespace {

using Triangle = std::array<Vec3, 3>;

// Cubes of the grid, at most, for each triangle, and at least in all: two large triangles still get a few.
constexpr double cells_per_triangle = 8;
constexpr double least_cells = 64;

// Side of a cube over the mean size of a triangle's box: smaller ones hold each triangle many times, larger ones many
// triangles each.
constexpr double cell_over_triangle = 1.5;

// Minima that a push cannot tell apart: the square of the sine between two normals.
constexpr double least_turn = 1e-20;

// A push misses a constraint when it is short by more than this share of it.
constexpr double push_tolerance = 1e-12;

bool is_before(const Vec3& a, const Vec3& b) {
  return std::lexicographical_compare(a.data(), a.data() + 3, b.data(), b.data() + 3);
}

std::string words(const Vec3& x) { return fmt::format("({:.6g}, {:.6g}, {:.6g})", x.x(), x.y(), x.z()); }

}  // namespace

// ------------------------------------------------------------------------------------------------ closest point

// The plane is cut into seven regions by the lines across each edge at its ends: over a corner, over an edge, over the
// face. With d_k = (x - a_k) . edge the signs of six dot products tell which; over an edge the area of the triangle that
// x spans with it is negative.
TrianglePoint closest_point(const std::array<Vec3, 3>& a, const Vec3& x) {
  const Vec3 e01 = a[1] - a[0], e02 = a[2] - a[0];
  const Vec3 x0 = x - a[0], x1 = x - a[1], x2 = x - a[2];
  const double u0 = e01.dot(x0), v0 = e02.dot(x0);
  if (u0 <= 0 && v0 <= 0) return {a[0], TriangleFeature::Corner, 0};
  const double u1 = e01.dot(x1), v1 = e02.dot(x1);
  if (u1 >= 0 && v1 <= u1) return {a[1], TriangleFeature::Corner, 1};
  const double over_01 = u0 * v1 - u1 * v0;
  if (over_01 <= 0 && u0 >= 0 && u1 <= 0) return {a[0] + u0 / (u0 - u1) * e01, TriangleFeature::Edge, 0};
  const double u2 = e01.dot(x2), v2 = e02.dot(x2);
  if (v2 >= 0 && u2 <= v2) return {a[2], TriangleFeature::Corner, 2};
  const double over_02 = u2 * v0 - u0 * v2;
  if (over_02 <= 0 && v0 >= 0 && v2 <= 0) return {a[0] + v0 / (v0 - v2) * e02, TriangleFeature::Edge, 2};
  const double over_12 = u1 * v2 - u2 * v1, past_1 = v1 - u1, past_2 = u2 - v2;
  if (over_12 <= 0 && past_1 >= 0 && past_2 >= 0)
    return {a[1] + past_1 / (past_1 + past_2) * (a[2] - a[1]), TriangleFeature::Edge, 1};
  const double whole = over_12 + over_02 + over_01;
  return {a[0] + over_02 / whole * e01 + over_01 / whole * e02, TriangleFeature::Face, 0};
}

// --------------------------------------------------------------------------------------------------------- push

namespace {

// The shortest push of at most three constraints with all of them met exactly, or zero when a share is negative: then
// the constraints do not all hold it.
Vec3 push_of(const std::array<const MeshContact*, 3>& c, int count) {
  if (count == 1) return c[0]->overlap * c[0]->normal;
  const Vec3 &n0 = c[0]->normal, &n1 = c[1]->normal;
  const Vec3 n01 = n0.cross(n1);
  if (count == 2) {
    const double sine = n01.squaredNorm(), cosine = n0.dot(n1);
    if (sine < least_turn) return Vec3::Zero();
    const double share_0 = (c[0]->overlap - cosine * c[1]->overlap) / sine;
    const double share_1 = (c[1]->overlap - cosine * c[0]->overlap) / sine;
    return share_0 < 0 || share_1 < 0 ? Vec3::Zero() : Vec3(share_0 * n0 + share_1 * n1);
  }
  const Vec3& n2 = c[2]->normal;
  const double det = n01.dot(n2);
  if (det * det < least_turn) return Vec3::Zero();
  const Vec3 n12 = n1.cross(n2), n20 = n2.cross(n0);
  const Vec3 t = (c[0]->overlap * n12 + c[1]->overlap * n20 + c[2]->overlap * n01) / det;
  const bool holds = t.dot(n12) / det >= 0 && t.dot(n20) / det >= 0 && t.dot(n01) / det >= 0;
  return holds ? t : Vec3::Zero();
}

}  // namespace

// An active set of at most three. The constraint that the push misses most joins; of all combinations of it with those
// of the set that hold it (shares >= 0) the longest is the shortest push of the four (duality: none that is held is
// longer than it). The length rises with each round, so no set comes twice.
Vec3 shortest_push(const std::vector<MeshContact>& constraints) {
  std::array<const MeshContact*, 3> active{};
  int active_count = 0;
  Vec3 push = Vec3::Zero();
  for (std::size_t round = 0; round <= constraints.size(); ++round) {
    const MeshContact* missed = nullptr;
    double worst = 0;
    for (const MeshContact& c : constraints) {
      const double shortfall = c.overlap - push.dot(c.normal);
      if (shortfall > push_tolerance * c.overlap && shortfall > worst) worst = shortfall, missed = &c;
    }
    if (!missed) break;
    Vec3 longest = Vec3::Zero();
    std::array<const MeshContact*, 3> best{};
    int best_count = 0;
    for (int subset = 0; subset < (1 << active_count); ++subset) {
      std::array<const MeshContact*, 3> tried{missed};
      int count = 1;
      for (int k = 0; k < active_count; ++k)
        if (subset >> k & 1) {
          if (count == 3) {
            count = 4;
            break;
          }
          tried[static_cast<std::size_t>(count++)] = active[static_cast<std::size_t>(k)];
        }
      if (count > 3) continue;
      const Vec3 t = push_of(tried, count);
      if (t.squaredNorm() > longest.squaredNorm()) longest = t, best = tried, best_count = count;
    }
    if (longest.squaredNorm() <= push.squaredNorm()) break;  // round-off: as near as it gets
    push = longest, active = best, active_count = best_count;
  }
  return push;
}

// ------------------------------------------------------------------------------------------------------ the mesh

TriangleMesh::TriangleMesh(const std::vector<Triangle>& triangles, std::string_view name) {
  if (triangles.empty()) throw InputError(fmt::format("{} holds no triangles; give a file with a surface", name));

  struct Numbered {
    Vec3 at;
    std::size_t place;  // 3 triangle + corner
  };
  std::vector<Numbered> sorted;
  sorted.reserve(3 * triangles.size());
  low_ = high_ = triangles[0][0];
  for (std::size_t t = 0; t < triangles.size(); ++t)
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec3& x = triangles[t][k];
      if (!(x.cwiseAbs().maxCoeff() <= largest_coordinate))
        throw InputError(
            fmt::format("{}: triangle {} has a corner at {} m; coordinates must lie within {:g} m, so mend the file or "
                        "choose another scale",
                        name, t + 1, words(x), largest_coordinate));
      low_ = low_.cwiseMin(x), high_ = high_.cwiseMax(x);
      sorted.push_back({x, 3 * t + k});
    }
  if (!((high_ - low_).maxCoeff() >= smallest_size))
    throw InputError(fmt::format("{} is {:.3g} m large in all; it must be at least {:g} m: choose another scale", name,
                                 (high_ - low_).maxCoeff(), smallest_size));

  std::sort(sorted.begin(), sorted.end(), [](const Numbered& a, const Numbered& b) {
    return is_before(a.at, b.at) || (!is_before(b.at, a.at) && a.place < b.place);
  });
  triangles_.resize(triangles.size());
  for (const Numbered& n : sorted) {
    if (corners_.empty() || is_before(corners_.back(), n.at)) corners_.push_back(n.at);
    triangles_[n.place / 3][n.place % 3] = static_cast<std::int32_t>(corners_.size() - 1);
  }

  std::string flat;
  std::size_t flat_count = 0;
  constexpr std::size_t named = 3;
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    const Triangle a = corners(t);
    const Vec3 e01 = a[1] - a[0], e12 = a[2] - a[1], e20 = a[0] - a[2];
    const double longest = std::max({e01.squaredNorm(), e12.squaredNorm(), e20.squaredNorm()});
    if (e01.cross(e20).norm() > least_slenderness * longest) continue;
    if (++flat_count <= named)
      flat += fmt::format("{}{} with corners {} {} {} m", flat_count > 1 ? "; " : "", t + 1, words(a[0]), words(a[1]),
                          words(a[2]));
  }
  if (flat_count > 0)
    throw InputError(
        fmt::format("{}: {} of {} triangles have no area: {}{}; mend the surface in the program that wrote it", name,
                    flat_count, triangles_.size(), flat, flat_count > named ? "; ..." : ""));
  make_grid();
}

double TriangleMesh::area() const {
  double sum = 0;
  for (std::size_t t = 0; t < triangle_count(); ++t) {
    const Triangle a = corners(t);
    sum += 0.5 * (a[1] - a[0]).cross(a[2] - a[0]).norm();
  }
  return sum;
}

Vec3 TriangleMesh::normal_of(std::size_t t) const {
  const Triangle a = corners(t);
  return (a[1] - a[0]).cross(a[2] - a[0]).normalized();
}

std::array<int, 3> TriangleMesh::cell_of(const Vec3& x) const {
  std::array<int, 3> cell{};
  for (int k = 0; k < 3; ++k) {
    const double along = (x[k] - low_[k]) / cell_;
    cell[static_cast<std::size_t>(k)] =
        static_cast<int>(std::clamp(along, 0.0, static_cast<double>(cells_[static_cast<std::size_t>(k)] - 1)));
  }
  return cell;
}

void TriangleMesh::make_grid() {
  double mean_size = 0;  // largest side of a triangle's box [m]
  const auto box_of = [&](std::size_t t) {
    const Triangle a = corners(t);
    return std::pair<Vec3, Vec3>(a[0].cwiseMin(a[1]).cwiseMin(a[2]), a[0].cwiseMax(a[1]).cwiseMax(a[2]));
  };
  const auto count = static_cast<double>(triangle_count());
  for (std::size_t t = 0; t < triangle_count(); ++t) {
    const auto [low, high] = box_of(t);
    mean_size += (high - low).maxCoeff() / count;
  }
  cell_ = cell_over_triangle * mean_size;
  const double most = std::max(least_cells, cells_per_triangle * count);
  const auto counted = [&] {
    double product = 1;
    for (int k = 0; k < 3; ++k) product *= std::floor((high_[k] - low_[k]) / cell_) + 1;
    return product;
  };
  constexpr double coarser = 1.25;
  while (counted() > most) cell_ *= coarser;
  for (int k = 0; k < 3; ++k)
    cells_[static_cast<std::size_t>(k)] = static_cast<int>(std::floor((high_[k] - low_[k]) / cell_)) + 1;

  // A triangle goes into the cubes of its box that its plane passes: their centre is no farther from it than half their
  // diagonal.
  const auto for_each_cube = [&](std::size_t t, auto&& visit) {
    const auto [low, high] = box_of(t);
    const auto first = cell_of(low), last = cell_of(high);
    const Vec3 normal = normal_of(t), corner = corners(t)[0];
    const double half_diagonal = 0.5001 * std::sqrt(3.0) * cell_;
    for (int k = first[2]; k <= last[2]; ++k)
      for (int j = first[1]; j <= last[1]; ++j)
        for (int i = first[0]; i <= last[0]; ++i) {
          const Vec3 middle = low_ + cell_ * (Vec3(i, j, k) + Vec3::Constant(0.5));
          if (std::abs((middle - corner).dot(normal)) <= half_diagonal) visit(cell_index(i, j, k));
        }
  };
  const std::size_t cubes = cell_index(cells_[0] - 1, cells_[1] - 1, cells_[2] - 1) + 1;
  cell_begin_.assign(cubes + 1, 0);
  for (std::size_t t = 0; t < triangle_count(); ++t) for_each_cube(t, [&](std::size_t c) { ++cell_begin_[c + 1]; });
  std::partial_sum(cell_begin_.begin(), cell_begin_.end(), cell_begin_.begin());
  cell_triangles_.resize(static_cast<std::size_t>(cell_begin_.back()));
  std::vector<std::int32_t> next(cell_begin_.begin(), cell_begin_.end() - 1);
  for (std::size_t t = 0; t < triangle_count(); ++t)
    for_each_cube(
        t, [&](std::size_t c) { cell_triangles_[static_cast<std::size_t>(next[c]++)] = static_cast<std::int32_t>(t); });
}

void TriangleMesh::list_near(const Vec3& x, double reach, std::vector<std::int32_t>& found) const {
  for (int k = 0; k < 3; ++k)
    if (x[k] < low_[k] - reach || x[k] > high_[k] + reach) return;
  const auto first = cell_of(x - Vec3::Constant(reach)), last = cell_of(x + Vec3::Constant(reach));
  const auto before = static_cast<std::ptrdiff_t>(found.size());
  for (int k = first[2]; k <= last[2]; ++k)
    for (int j = first[1]; j <= last[1]; ++j)
      for (int i = first[0]; i <= last[0]; ++i) {
        const std::size_t c = cell_index(i, j, k);
        found.insert(found.end(), cell_triangles_.begin() + cell_begin_[c],
                     cell_triangles_.begin() + cell_begin_[c + 1]);
      }
  std::sort(found.begin() + before, found.end());
  found.erase(std::unique(found.begin() + before, found.end()), found.end());
  const auto is_far = [&](std::int32_t t) {
    return (closest_point(corners(static_cast<std::size_t>(t)), x).point - x).squaredNorm() >= reach * reach;
  };
  found.erase(std::remove_if(found.begin() + before, found.end(), is_far), found.end());
}

// Whether the triangle has the edge or corner that the foot lies on.
bool TriangleMesh::has_feature(std::int32_t triangle, const Foot& foot) const {
  const auto& own = triangles_[static_cast<std::size_t>(foot.triangle)];
  const auto& other = triangles_[static_cast<std::size_t>(triangle)];
  const auto has = [&](std::int32_t corner) { return std::find(other.begin(), other.end(), corner) != other.end(); };
  const auto k = static_cast<std::size_t>(foot.at.index);
  if (foot.at.feature == TriangleFeature::Corner) return has(own[k]);
  return has(own[k]) && has(own[(k + 1) % 3]);
}

// Of equal ones all stay: they are one push.
bool TriangleMesh::is_local_minimum(const std::vector<Foot>& feet, std::size_t i) const {
  const Foot& foot = feet[i];
  if (foot.at.feature == TriangleFeature::Face) return true;
  return std::none_of(feet.begin(), feet.end(), [&](const Foot& other) {
    return other.distance < foot.distance && has_feature(other.triangle, foot);
  });
}

void TriangleMesh::touch(const Vec3& center, double radius, const std::int32_t* near, std::size_t count,
                         Scratch& scratch, std::vector<MeshContact>& contacts) const {
  contacts.clear();
  scratch.feet.clear();
  for (std::size_t i = 0; i < count; ++i) {
    Foot foot;
    foot.triangle = near[i];
    foot.at = closest_point(corners(static_cast<std::size_t>(near[i])), center);
    const Vec3 away = center - foot.at.point;
    const double squared = away.squaredNorm();
    if (squared >= radius * radius) continue;
    foot.distance = std::sqrt(squared);
    foot.normal = foot.distance > 0 ? Vec3(away / foot.distance) : normal_of(static_cast<std::size_t>(near[i]));
    scratch.feet.push_back(foot);
  }
  if (scratch.feet.empty()) return;

  std::vector<MeshContact>& minima = scratch.minima;
  minima.clear();
  for (std::size_t i = 0; i < scratch.feet.size(); ++i)
    if (is_local_minimum(scratch.feet, i))
      minima.push_back({radius - scratch.feet[i].distance, scratch.feet[i].normal});
  std::stable_sort(minima.begin(), minima.end(),
                   [](const MeshContact& a, const MeshContact& b) { return a.overlap > b.overlap; });

  static const double cos_merge_angle = std::cos(merge_angle);
  scratch.is_taken.assign(minima.size(), 0);
  for (std::size_t seed = 0; seed < minima.size(); ++seed) {
    if (scratch.is_taken[seed]) continue;
    scratch.merged.clear();
    for (std::size_t i = seed; i < minima.size(); ++i) {
      if (scratch.is_taken[i] || minima[i].normal.dot(minima[seed].normal) < cos_merge_angle) continue;
      scratch.is_taken[i] = 1;
      scratch.merged.push_back(minima[i]);
    }
    if (scratch.merged.size() == 1) {
      contacts.push_back(scratch.merged[0]);
      continue;
    }
    const Vec3 push = shortest_push(scratch.merged);
    const double length = push.norm();
    contacts.push_back({length, push / length});
  }
}

// ----------------------------------------------------------------------------------------------------------- STL

namespace {

constexpr std::size_t header_bytes = 80, count_bytes = 4, triangle_bytes = 50, normal_bytes = 12, corner_bytes = 12;

std::string read_all(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file || std::filesystem::is_directory(path))
    throw IoError(fmt::format("{}: cannot read the mesh: {}; give an STL file, its path from the scene's folder",
                              path.string(), file ? "it is a folder" : std::strerror(errno)));
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

template <class Number>
Number number_at(const std::string& bytes, std::size_t at) {
  Number value;
  std::memcpy(&value, bytes.data() + at, sizeof value);
  return value;
}

std::vector<Triangle> binary_triangles(const std::string& bytes) {
  const auto count = number_at<std::uint32_t>(bytes, header_bytes);
  std::vector<Triangle> triangles(count);
  for (std::size_t t = 0; t < count; ++t)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t at = header_bytes + count_bytes + t * triangle_bytes + normal_bytes + k * corner_bytes;
      for (std::size_t c = 0; c < 3; ++c)
        triangles[t][k][static_cast<int>(c)] = number_at<float>(bytes, at + c * sizeof(float));
    }
  return triangles;
}

// Words of a text, with the line they stand in.
class Words {
 public:
  explicit Words(const std::string& text) : text_(text) {}
  std::string_view next() {
    while (at_ < text_.size() && is_space(text_[at_])) line_ += text_[at_++] == '\n';
    const std::size_t begin = at_;
    while (at_ < text_.size() && !is_space(text_[at_])) ++at_;
    return std::string_view(text_).substr(begin, at_ - begin);
  }
  void skip_line() {
    while (at_ < text_.size() && text_[at_] != '\n') ++at_;
  }
  int line() const { return line_; }

 private:
  static bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; }
  const std::string& text_;
  std::size_t at_ = 0;
  int line_ = 1;
};

bool is_word(std::string_view word, std::string_view expected) {
  return std::equal(word.begin(), word.end(), expected.begin(), expected.end(),
                    [](char a, char b) { return (a >= 'A' && a <= 'Z' ? static_cast<char>(a - 'A' + 'a') : a) == b; });
}

double coordinate(Words& words, const std::string& name) {
  std::string_view word = words.next();
  const std::string_view shown = word;
  if (!word.empty() && word.front() == '+') word.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size())
    throw InputError(
        fmt::format("{}:{}: \"{}\" is no coordinate; a vertex needs three numbers", name, words.line(), shown));
  return value;
}

std::vector<Triangle> ascii_triangles(const std::string& text, const std::string& name) {
  std::vector<Triangle> triangles;
  Words words(text);
  std::size_t corner = 0;
  bool has_ended = false;
  Triangle triangle;
  for (std::string_view word = words.next(); !word.empty(); word = words.next()) {
    has_ended = false;
    if (is_word(word, "solid")) {
      words.skip_line();  // the solid's name
    } else if (is_word(word, "vertex")) {
      if (corner == 3)
        throw InputError(
            fmt::format("{}:{}: a facet with more than three vertices; write triangles", name, words.line()));
      for (int k = 0; k < 3; ++k) triangle[corner][k] = coordinate(words, name);
      ++corner;
    } else if (is_word(word, "endfacet")) {
      if (corner != 3)
        throw InputError(fmt::format("{}:{}: a facet with {} vertices; each needs three", name, words.line(), corner));
      triangles.push_back(triangle);
      corner = 0;
    } else if (is_word(word, "endsolid")) {
      words.skip_line();
      has_ended = true;
    } else if (is_word(word, "facet") || is_word(word, "outer") || is_word(word, "endloop")) {
      constexpr int words_of_normal = 4;  // "normal" and three numbers; the corners tell it as well
      for (int k = 0; k < (is_word(word, "facet") ? words_of_normal : 0); ++k) words.next();
      if (is_word(word, "outer")) words.next();  // "loop"
    } else {
      throw InputError(
          fmt::format("{}:{}: \"{}\" is no word of an STL file (solid, facet, outer loop, vertex, endloop, endfacet, "
                      "endsolid); give "
                      "an STL file, ASCII or binary",
                      name, words.line(), word.substr(0, 40)));
    }
  }
  if (!has_ended)
    throw InputError(fmt::format("{}: ends without \"endsolid\" after {} triangles: it is cut short; copy it anew",
                                 name, triangles.size()));
  return triangles;
}

}  // namespace

// A binary file may begin with "solid" too, and an ASCII one may have any length: the size that a binary file's count
// asks for decides first.
TriangleMesh read_stl(const std::filesystem::path& path, double scale, const Vec3& shift) {
  const std::string bytes = read_all(path);
  const std::string name = path.string();
  const bool has_count = bytes.size() >= header_bytes + count_bytes;
  const std::uint64_t count = has_count ? number_at<std::uint32_t>(bytes, header_bytes) : 0;
  const std::uint64_t binary_size = header_bytes + count_bytes + count * triangle_bytes;
  const bool is_binary = has_count && bytes.size() == binary_size;

  if (!is_binary && !is_word(std::string_view(bytes).substr(0, 5), "solid"))
    throw InputError(
        has_count
            ? fmt::format("{}: {} bytes, but a binary STL file of the {} triangles that it announces has {}; it is "
                          "cut short or no STL file",
                          name, bytes.size(), count, binary_size)
            : fmt::format("{}: {} bytes are no STL file: it neither begins with \"solid\" nor has a binary "
                          "file's header of {} bytes",
                          name, bytes.size(), header_bytes + count_bytes));
  std::vector<Triangle> triangles = is_binary ? binary_triangles(bytes) : ascii_triangles(bytes, name);
  for (Triangle& t : triangles)
    for (Vec3& x : t) x = scale * x + shift;
  return TriangleMesh(triangles, name);
}

}  // namespace lockstep::dem
