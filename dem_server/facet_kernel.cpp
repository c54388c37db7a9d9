#include "dem_server/facet_kernel.hpp"

#include "common/lanes.hpp"

namespace lockstep::dem {

namespace {

static_assert(block == facet_block);

constexpr int pairs_ahead = 24;  // whose pebbles are fetched
// Newton's steps that lanes take together; a face that needs more is left to closest_point().
constexpr int newton_steps = 4;
constexpr double last_newton_step = 1e-8;  // as there
constexpr double convexity = 1 - 1e-9;     // as there
constexpr double largest_warp = 0.01;      // as there

LOCKSTEP_INLINE Lanes size_of(Lanes v) { return larger(v, -v); }
LOCKSTEP_INLINE Lanes3 over(const Lanes3& a, Lanes s) { return {a.x / s, a.y / s, a.z / s}; }

std::int32_t find_near(const FacetSurface& s, const FacetPairs& pairs, std::int32_t begin, std::int32_t end,
                       double reach, std::int32_t* near) {
  std::int32_t count = 0;
  for (std::int32_t k = begin; k < end; k += width) {
    const int filled = end - k < width ? end - k : width;
    const FacetBox* box[width];
    Row rows[width];
    for (int l = 0; l < width; ++l)
      __builtin_prefetch(&s.pebbles[pairs.pebble[k + l + pairs_ahead < end ? k + l + pairs_ahead : end - 1]]);
    for (int l = 0; l < width; ++l) {
      const std::int32_t pair = k + (l < filled ? l : 0);
      box[l] = &s.boxes[pairs.facet[pair]];
      rows[l] = row(&s.pebbles[pairs.pebble[pair]].x) - row(&box[l]->x) * Row{1, 1, 1, 0};
    }
    const Lanes4 gap = transpose(rows);
    Lanes square{};
    for (int a = 0; a < 3; ++a) {
      for (int l = 0; l < width; ++l) rows[l] = row(&box[l]->axis[a].x);
      const Lanes4 axis = transpose(rows);
      const Lanes outside = larger(lanes(0), size_of(dot(xyz(gap), xyz(axis))) - axis.w);
      square += outside * outside;
    }
    const unsigned is_near = bits(square <= (gap.w + reach) * (gap.w + reach));
    for (int l = 0; l < filled; ++l) near[count] = k + l, count += is_near >> l & 1;
  }
  return count;
}

// The foot by Newton's method from that on the parallelogram, all as closest_point() does it.
LOCKSTEP_INLINE void find_feet(const FacetSurface& s, const FacetPairs& pairs, const std::int32_t* near, int filled,
                               FaceFoot* feet, FaceContact* contacts) {
  Row rows[width];
  const std::int32_t* nodes[width];
  const auto pair = [&](int l) { return near[l < filled ? l : 0]; };
  for (int l = 0; l < width; ++l) nodes[l] = s.corners[pairs.facet[pair(l)]];
  Lanes3 x[4];
  for (int j = 0; j < 4; ++j) {
    for (int l = 0; l < width; ++l) rows[l] = row(&s.nodes[nodes[l][j]].x);
    x[j] = xyz(transpose(rows));
  }
  for (int l = 0; l < width; ++l) rows[l] = row(&s.pebbles[pairs.pebble[pair(l)]].x);
  const Lanes4 pebble = transpose(rows);
  const Lanes3 center = xyz(pebble);

  const Lanes one = lanes(1), quarter = lanes(0.25);
  const Lanes3 r = quarter * (x[0] + x[1] + x[2] + x[3]) - center;
  const Lanes3 b = quarter * (x[1] + x[2] - x[0] - x[3]);
  const Lanes3 c = quarter * (x[2] + x[3] - x[0] - x[1]);
  const Lanes3 e = quarter * (x[0] + x[2] - x[1] - x[3]);
  const Lanes bb = dot(b, b), cc = dot(c, c), bc = dot(b, c), rb = dot(r, b), rc = dot(r, c);
  const Lanes smallest = smaller(bb, cc);
  const Lanes start = bb * cc - bc * bc;
  Lanes xi = (bc * rc - cc * rb) / start, eta = (bc * rb - bb * rc) / start;
  Mask is_moving = (start > lanes(0)) & (dot(e, e) * (dot(r, r) + bb + cc) <= largest_warp * smallest * smallest);
  Mask has_settled = Mask{};
  for (int step = 0; step < newton_steps && any(is_moving); ++step) {
    const Lanes3 at = r + xi * b + eta * c + (xi * eta) * e, t_xi = b + eta * e, t_eta = c + xi * e;
    const Lanes g_xi = dot(at, t_xi), g_eta = dot(at, t_eta);
    const Lanes h_xi = dot(t_xi, t_xi), h_eta = dot(t_eta, t_eta), h_mixed = dot(t_xi, t_eta) + dot(at, e);
    const Lanes det = h_xi * h_eta - h_mixed * h_mixed;
    const Lanes d_xi = -(h_eta * g_xi - h_mixed * g_eta) / det, d_eta = -(h_xi * g_eta - h_mixed * g_xi) / det;
    is_moving &= h_mixed * h_mixed < convexity * h_xi * h_eta;
    xi = select(is_moving, xi + d_xi, xi), eta = select(is_moving, eta + d_eta, eta);
    const Mask is_last = is_moving & (larger(size_of(d_xi), size_of(d_eta)) < last_newton_step);
    has_settled |= is_last;
    is_moving &= ~is_last;
  }

  const Lanes weight[4] = {quarter * (one - xi) * (one - eta), quarter * (one + xi) * (one - eta),
                           quarter * (one + xi) * (one + eta), quarter * (one - xi) * (one + eta)};
  const Lanes3 foot = weight[0] * x[0] + weight[1] * x[1] + weight[2] * x[2] + weight[3] * x[3];
  const Lanes3 t_xi = quarter * ((one - eta) * (x[1] - x[0]) + (one + eta) * (x[2] - x[3]));
  const Lanes3 t_eta = quarter * ((one - xi) * (x[3] - x[0]) + (one + xi) * (x[2] - x[1]));
  const Lanes3 across = cross(t_xi, t_eta), away = center - foot;
  const Lanes area = square_root(dot(across, across));
  const Lanes3 normal = over(across, area);
  const unsigned is_inside = bits(has_settled & (larger(size_of(xi), size_of(eta)) < one) & (area > lanes(0)));
  const unsigned reaches = bits(square_root(dot(away, away)) < pebble.w);

  transpose({weight[0], weight[1], weight[2], weight[3]}, rows);
  for (int l = 0; l < width; ++l) *reinterpret_cast<Row*>(feet[l].weight) = rows[l];
  transpose({normal.x, normal.y, normal.z, pebble.w - dot(away, normal)}, rows);
  for (int l = 0; l < width; ++l) *reinterpret_cast<Row*>(&feet[l].nx) = rows[l];
  for (int l = 0; l < width; ++l)
    contacts[l] = !(is_inside >> l & 1) ? FaceContact::Unknown
                  : reaches >> l & 1    ? FaceContact::Touching
                                        : FaceContact::None;
}

void find_all_feet(const FacetSurface& s, const FacetPairs& pairs, const std::int32_t* near, std::int32_t count,
                   FaceFoot* feet, FaceContact* contacts) {
  for (std::int32_t k = 0; k < count; k += width)
    find_feet(s, pairs, near + k, count - k < width ? count - k : width, feet + k, contacts + k);
}

}  // namespace

FacetKernels LOCKSTEP_FACET_KERNEL() { return {find_near, find_all_feet}; }

}  // namespace lockstep::dem
