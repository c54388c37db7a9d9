#include "continuum_client/stiffness_product.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <numeric>
#include <span>

#include "common/checks.hpp"
#include "continuum_client/internal_force.hpp"

namespace lockstep::continuum {
namespace {

// A neighbour of a node: node plus offset, the block in the matrix, and whether it is that block's transpose.
struct Neighbour {
  std::int32_t offset;
  std::int64_t block;
  bool is_transposed;
};

// Rows of both halves, columns rising.
class WholeRows {
 public:
  explicit WholeRows(const StiffnessMatrix& k) : matrix_(k), lower_begin_(k.node_count() + 1, 0) {
    const auto count = static_cast<std::int32_t>(k.node_count());
    for (std::int32_t i = 0; i < count; ++i)
      for (std::int64_t b = k.row_begin[i]; b < k.row_begin[i + 1]; ++b)
        if (k.column[b] > i) ++lower_begin_[k.column[b] + 1];
    std::partial_sum(lower_begin_.begin(), lower_begin_.end(), lower_begin_.begin());
    lower_.resize(lower_begin_.back());
    std::vector<std::int64_t> next(lower_begin_.begin(), lower_begin_.end() - 1);
    for (std::int32_t i = 0; i < count; ++i)
      for (std::int64_t b = k.row_begin[i]; b < k.row_begin[i + 1]; ++b)
        if (k.column[b] > i) lower_[next[k.column[b]]++] = {i - k.column[b], b, true};
  }

  void get(std::int32_t i, std::vector<Neighbour>& row) const {
    row.assign(lower_.begin() + lower_begin_[i], lower_.begin() + lower_begin_[i + 1]);
    for (std::int64_t b = matrix_.row_begin[i]; b < matrix_.row_begin[i + 1]; ++b)
      row.push_back({matrix_.column[b] - i, b, false});
  }

 private:
  const StiffnessMatrix& matrix_;
  std::vector<std::int64_t> lower_begin_;
  std::vector<Neighbour> lower_;
};

bool are_same_bits(const Mat3& a, const Mat3& b) { return std::memcmp(a.data(), b.data(), 9 * sizeof(double)) == 0; }

bool are_same_rows(const StiffnessMatrix& k, const std::vector<Neighbour>& a, const std::vector<Neighbour>& b) {
  return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin(), [&](const Neighbour& p, const Neighbour& q) {
           return p.offset == q.offset && p.is_transposed == q.is_transposed &&
                  are_same_bits(k.block[p.block], k.block[q.block]);
         });
}

bool has_same_offsets(const StiffnessMatrix& k, std::int32_t i, std::int32_t j) {
  const std::int64_t count = k.row_begin[i + 1] - k.row_begin[i];
  if (count != k.row_begin[j + 1] - k.row_begin[j]) return false;
  for (std::int64_t n = 0; n < count; ++n)
    if (k.column[k.row_begin[i] + n] - i != k.column[k.row_begin[j] + n] - j) return false;
  return true;
}

// The stretches of nodes that are alike one after the other.
template <class Alike>
std::vector<std::pair<std::int32_t, std::int32_t>> stretches(std::int32_t nodes, const Alike& is_like_last) {
  std::vector<std::pair<std::int32_t, std::int32_t>> found;
  for (std::int32_t i = 0; i < nodes; ++i) {
    if (i > 0 && is_like_last(i))
      ++found.back().second;
    else
      found.emplace_back(i, i + 1);
  }
  return found;
}

std::int64_t eights(std::int32_t nodes) { return (nodes + nodes_at_once - 1) / nodes_at_once; }

// Rough costs in cycles of a core with eight lanes: nine products and sums for a block and eight nodes, twice that and
// the sums' way through memory for half rows, and eight bytes a cycle from a shared cache.
double shared_cost(std::int32_t nodes, std::size_t neighbours) {
  return static_cast<double>(neighbours) * (9.0 * static_cast<double>(eights(nodes)) + 9);
}
double half_cost(std::int32_t nodes, std::size_t neighbours) {
  const double blocks = static_cast<double>(neighbours) * nodes;
  return nodes < fewest_lanes ? 25 * blocks : (25.0 / nodes_at_once + 9) * blocks;
}

struct Costs {
  double shared = 0, half = 0;
};

Costs costs_of(const StiffnessMatrix& matrix) {
  const WholeRows rows(matrix);
  const auto nodes = static_cast<std::int32_t>(matrix.node_count());
  std::vector<Neighbour> row, last;
  Costs costs;
  for (const auto& [begin, end] : stretches(nodes, [&](std::int32_t i) {
         rows.get(i - 1, last), rows.get(i, row);
         return are_same_rows(matrix, last, row);
       })) {
    rows.get(begin, row);
    costs.shared += shared_cost(end - begin, row.size());
  }
  for (const auto& [begin, end] : stretches(nodes, [&](std::int32_t i) { return has_same_offsets(matrix, i - 1, i); }))
    costs.half +=
        half_cost(end - begin, static_cast<std::size_t>(matrix.row_begin[begin + 1] - matrix.row_begin[begin]));
  return costs;
}

}  // namespace

StiffnessKernel stiffness_kernel(InstructionSet set) { return LOCKSTEP_KERNEL_FOR(set, stiffness_kernel)(); }

StiffnessProduct::StiffnessProduct(const StiffnessMatrix& matrix, InstructionSet instructions)
    : kernel_(stiffness_kernel(instructions)) {
  const Costs costs = costs_of(matrix);
  arrange(matrix, costs.shared <= costs.half ? Format::SharedRows : Format::HalfRows);
}

StiffnessProduct::StiffnessProduct(const StiffnessMatrix& matrix, const Grid& grid,
                                   const std::vector<char>& is_included, InstructionSet instructions)
    : kernel_(stiffness_kernel(instructions)) {
  const Costs costs = costs_of(matrix);
  if (ZoneProduct::has_kernel(grid.zone_kind) &&
      ZoneProduct::cost(grid, is_included) < std::min(costs.shared, costs.half))
    *this = of_zones(grid, is_included, instructions);
  else
    arrange(matrix, costs.shared <= costs.half ? Format::SharedRows : Format::HalfRows);
}

StiffnessProduct::StiffnessProduct(const StiffnessMatrix& matrix, Format format, InstructionSet instructions)
    : kernel_(stiffness_kernel(instructions)) {
  LOCKSTEP_ASSERT(format != Format::Zones, "a matrix has no zones");
  arrange(matrix, format);
}

StiffnessProduct StiffnessProduct::of_zones(const Grid& grid, const std::vector<char>& is_included,
                                            InstructionSet instructions) {
  StiffnessProduct product;
  product.kernel_ = stiffness_kernel(instructions);
  product.format_ = Format::Zones;
  product.allocate(grid.node_count());
  product.zones_ = ZoneProduct(grid, is_included, instructions);
  return product;
}

void StiffnessProduct::allocate(std::size_t nodes) {
  nodes_ = static_cast<std::int32_t>(nodes);
  stride_ = nodes + nodes_at_once;
  u_.assign(3 * stride_, 0.0);
  zero_.assign(nodes, Vec3::Zero());
}

void StiffnessProduct::arrange(const StiffnessMatrix& matrix, Format format) {
  format_ = format;
  allocate(matrix.node_count());
  if (format == Format::SharedRows)
    arrange_shared(matrix);
  else
    arrange_half(matrix);
}

void StiffnessProduct::arrange_shared(const StiffnessMatrix& matrix) {
  const WholeRows rows(matrix);
  std::vector<Neighbour> row, last;
  std::vector<std::int64_t> cost;
  for (const auto& [begin, end] : stretches(nodes_, [&](std::int32_t i) {
         rows.get(i - 1, last), rows.get(i, row);
         return are_same_rows(matrix, last, row);
       })) {
    rows.get(begin, row);
    runs_.push_back({begin, end - begin, static_cast<std::int32_t>(row.size()),
                     static_cast<std::int32_t>(offsets_.size()), static_cast<std::int64_t>(blocks_.size())});
    for (const Neighbour& n : row) {
      offsets_.push_back(n.offset);
      const Mat3 b = n.is_transposed ? Mat3(matrix.block[n.block].transpose()) : matrix.block[n.block];
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) blocks_.push_back(b(r, c));
    }
    cost.push_back(1 + static_cast<std::int64_t>(shared_cost(end - begin, row.size())));
  }
  cut_chunks(0, cost);
}

void StiffnessProduct::arrange_half(const StiffnessMatrix& matrix) {
  std::vector<std::int64_t> cost;
  std::int32_t reach = 0;
  for (const auto& [begin, end] :
       stretches(nodes_, [&](std::int32_t i) { return has_same_offsets(matrix, i - 1, i); })) {
    const std::int64_t row = matrix.row_begin[begin];
    const auto neighbours = static_cast<std::int32_t>(matrix.row_begin[begin + 1] - row);
    const auto offset = static_cast<std::int32_t>(offsets_.size());
    for (std::int32_t n = 0; n < neighbours; ++n) {
      offsets_.push_back(matrix.column[row + n] - begin);
      reach = std::max(reach, offsets_.back());
    }
    const bool is_interleaved = end - begin >= fewest_lanes;
    const std::int32_t step = is_interleaved ? nodes_at_once : 1;
    // One run for each eight nodes, so that a chunk may begin at any of them.
    for (std::int32_t first = begin; first < end; first += step) {
      const std::int32_t nodes = std::min(step, end - first);
      runs_.push_back({first, is_interleaved ? std::max(nodes, fewest_lanes) : 1, neighbours, offset,
                       static_cast<std::int64_t>(blocks_.size())});
      cost.push_back(1 + static_cast<std::int64_t>(half_cost(nodes, static_cast<std::size_t>(neighbours))));
      for (std::int32_t n = 0; n < neighbours; ++n)
        for (int e = 0; e < 9; ++e)
          for (std::int32_t k = 0; k < step; ++k)
            blocks_.push_back(k < nodes ? matrix.block[matrix.row_begin[first + k] + n](e / 3, e % 3) : 0.0);
    }
  }
  cut_chunks(reach, cost);
  std::vector<NodeRange> ranges;
  for (Chunk& chunk : chunks_) {
    NodeRange& range = chunk.nodes;
    range.reach = range.end;
    for (std::int32_t r = chunk.run_begin; r < chunk.run_end; ++r) {
      const StiffnessRun& run = runs_[r];
      if (run.neighbours > 0)
        range.reach = std::max(range.reach, run.first + run.nodes + offsets_[run.offset + run.neighbours - 1]);
    }
    range.reach = std::min(range.reach, nodes_);
    ranges.push_back(range);
  }
  partial_ = PartialForces(ranges);
}

void StiffnessProduct::cut_chunks(std::int32_t reach, const std::vector<std::int64_t>& cost) {
  const std::int64_t all = std::accumulate(cost.begin(), cost.end(), std::int64_t{0});
  const std::int32_t fewest = format_ == Format::HalfRows ? std::max(fewest_range_nodes, 2 * reach) : 1;
  std::int64_t so_far = 0;
  for (std::size_t r = 0; r < runs_.size(); ++r) {
    const auto run = static_cast<std::int32_t>(r);
    const bool is_full = !chunks_.empty() &&
                         so_far * ranges_wanted >= all * static_cast<std::int64_t>(chunks_.size()) &&
                         runs_[r].first - chunks_.back().nodes.begin >= fewest;
    if (chunks_.empty() || is_full) {
      Chunk chunk;
      chunk.nodes.begin = runs_[r].first, chunk.run_begin = run;
      chunks_.push_back(chunk);
    }
    so_far += cost[r];
    chunks_.back().nodes.end = r + 1 < runs_.size() ? runs_[r + 1].first : nodes_;
    chunks_.back().run_end = run + 1;
  }
}

std::size_t StiffnessProduct::bytes() const {
  if (format_ == Format::Zones) return zones_.bytes();
  return blocks_.size() * sizeof(double) + offsets_.size() * sizeof(std::int32_t) + runs_.size() * sizeof(StiffnessRun);
}

void StiffnessProduct::evaluate(const Vec3s& u, const Vec3s& reference, Vec3s& f, Team& team) {
  LOCKSTEP_ASSERT(u.size() == node_count() && f.size() == node_count(), "{} and {} vectors for {} nodes", u.size(),
                  f.size(), node_count());
  const double* const from = reinterpret_cast<const double*>(u.data());
  const double* const base = reinterpret_cast<const double*>((reference.empty() ? zero_ : reference).data());
  double* const to = reinterpret_cast<double*>(f.data());
  const Components all{u_.data(), u_.data() + stride_, u_.data() + 2 * stride_};
  team.run([&](int thread) {
    const auto [begin, end] = share_of(nodes_, thread, team.size());
    kernel_.split(from, begin, end, {all.x + begin, all.y + begin, all.z + begin});
  });
  if (format_ == Format::Zones) {
    zones_.evaluate(all, base, to, team);
    return;
  }
  const auto for_each_chunk = [&](const auto& visit) {
    team.run([&](int thread) {
      const auto [begin, end] = share_of(static_cast<std::int32_t>(chunks_.size()), thread, team.size());
      for (std::int32_t c = begin; c < end; ++c) visit(chunks_[c], static_cast<std::size_t>(c));
    });
  };
  if (format_ == Format::SharedRows) {
    for_each_chunk([&](const Chunk& c, std::size_t) {
      kernel_.shared_rows(runs_.data() + c.run_begin, c.run_end - c.run_begin, offsets_.data(), blocks_.data(), all,
                          base, to);
    });
    return;
  }
  for_each_chunk([&](const Chunk& c, std::size_t index) {
    kernel_.half_rows(runs_.data() + c.run_begin, c.run_end - c.run_begin, offsets_.data(), blocks_.data(), all,
                      partial_.clear(index), c.nodes.begin);
  });
  for_each_chunk([&](const Chunk&, std::size_t index) { partial_.join(index, kernel_, base, to); });
}

}  // namespace lockstep::continuum
