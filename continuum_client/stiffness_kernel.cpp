#include "continuum_client/stiffness_kernel.hpp"

#include "common/lanes.hpp"

namespace lockstep::continuum {
namespace {

static_assert(block == nodes_at_once);
constexpr int parts = block / width;                  // vectors for eight nodes
constexpr int parts_at_once = parts < 2 ? parts : 2;  // as many as registers hold
constexpr int pieces = parts / parts_at_once;

void split(const double* from, std::int32_t begin, std::int32_t end, const Components& to) {
  std::int32_t i = begin;
  for (; i + width <= end; i += width) {
    const Lanes3 v = load_vectors(from + 3 * static_cast<std::int64_t>(i));
    store_loose(to.x + (i - begin), v.x), store_loose(to.y + (i - begin), v.y), store_loose(to.z + (i - begin), v.z);
  }
  for (; i < end; ++i) {
    const double* v = from + 3 * static_cast<std::int64_t>(i);
    to.x[i - begin] = v[0], to.y[i - begin] = v[1], to.z[i - begin] = v[2];
  }
}

void join(const double* reference, const Components* part, const std::int32_t* part_begin, std::int32_t count,
          std::int32_t begin, std::int32_t end, double* f) {
  std::int32_t i = begin;
  for (; i + width <= end; i += width) {
    Lanes3 sum = load_vectors(reference + 3 * static_cast<std::int64_t>(i));
    for (std::int32_t p = 0; p < count; ++p) {
      const std::int32_t at = i - part_begin[p];
      sum = sum + Lanes3{loose(part[p].x + at), loose(part[p].y + at), loose(part[p].z + at)};
    }
    store_vectors(f + 3 * static_cast<std::int64_t>(i), sum);
  }
  for (; i < end; ++i) {
    const std::int64_t k = 3 * static_cast<std::int64_t>(i);
    double x = reference[k], y = reference[k + 1], z = reference[k + 2];
    for (std::int32_t p = 0; p < count; ++p) {
      const std::int32_t at = i - part_begin[p];
      x += part[p].x[at], y += part[p].y[at], z += part[p].z[at];
    }
    f[k] = x, f[k + 1] = y, f[k + 2] = z;
  }
}

LOCKSTEP_INLINE Lanes3 vectors(const Components& u, std::int64_t i) {
  return {loose(u.x + i), loose(u.y + i), loose(u.z + i)};
}

// A block times the vectors of several nodes; rows of the block one after the other, each entry for all lanes.
LOCKSTEP_INLINE Lanes3 times(const double* b, const Lanes3& u) {
  return {b[0] * u.x + b[1] * u.y + b[2] * u.z, b[3] * u.x + b[4] * u.y + b[5] * u.z,
          b[6] * u.x + b[7] * u.y + b[8] * u.z};
}

void shared_rows(const StiffnessRun* runs, std::int32_t count, const std::int32_t* offsets, const double* blocks,
                 const Components& u, const double* reference, double* f) {
  for (std::int32_t r = 0; r < count; ++r) {
    const StiffnessRun run = runs[r];
    // The last eight nodes overlap those before; all of them come out alike.
    const std::int32_t most = run.nodes < block ? run.nodes : block;
    for (std::int32_t k = 0; k < run.nodes; k += block) {
      const std::int64_t first = run.first + (k + block <= run.nodes ? k : run.nodes - most);
      alignas(64) double result[3 * block] = {};
      for (int piece = 0; piece < pieces; ++piece) {
        const std::int64_t begin = first + piece * parts_at_once * width;
        Lanes3 sum[parts_at_once] = {};
        const double* b = blocks + run.block;
        for (std::int32_t n = 0; n < run.neighbours; ++n, b += 9) {
          const std::int64_t j = begin + offsets[run.offset + n];
          for (int p = 0; p < parts_at_once; ++p) sum[p] = sum[p] + times(b, vectors(u, j + p * width));
        }
        for (int p = 0; p < parts_at_once; ++p) store_vectors(result + 3 * (piece * parts_at_once + p) * width, sum[p]);
      }
      const std::int64_t at = 3 * first;
      for (std::int32_t c = 0; c < 3 * most; ++c) f[at + c] = reference[at + c] + result[c];
    }
  }
}

LOCKSTEP_INLINE void add(double* to, Lanes value) { store_loose(to, loose(to) + value); }

// Eight nodes of a run; entry e of their blocks at b[8 e ..]. Neighbour by neighbour for all eight, since a node gets
// forces from several of them and the order of its sum must not depend on the width.
void half_rows_of_eight(const StiffnessRun& run, std::int64_t first, const std::int32_t* offsets, const double* b,
                        const Components& u, const Components& f, std::int32_t f_begin) {
  Lanes3 sum[parts] = {};
  for (std::int32_t n = 0; n < run.neighbours; ++n, b += 9 * block)
    for (int p = 0; p < parts; ++p) {
      const std::int64_t i = first + p * width, j = i + offsets[run.offset + n];
      const double* entry = b + p * width;
      const Lanes xx = loose(entry), xy = loose(entry + block), xz = loose(entry + 2 * block);
      const Lanes yx = loose(entry + 3 * block), yy = loose(entry + 4 * block), yz = loose(entry + 5 * block);
      const Lanes zx = loose(entry + 6 * block), zy = loose(entry + 7 * block), zz = loose(entry + 8 * block);
      const Lanes3 uj = vectors(u, j);
      sum[p].x += xx * uj.x + xy * uj.y + xz * uj.z;
      sum[p].y += yx * uj.x + yy * uj.y + yz * uj.z;
      sum[p].z += zx * uj.x + zy * uj.y + zz * uj.z;
      if (n == 0) continue;
      const Lanes3 ui = vectors(u, i);
      add(f.x + (j - f_begin), xx * ui.x + yx * ui.y + zx * ui.z);
      add(f.y + (j - f_begin), xy * ui.x + yy * ui.y + zy * ui.z);
      add(f.z + (j - f_begin), xz * ui.x + yz * ui.y + zz * ui.z);
    }
  for (int p = 0; p < parts; ++p) {
    const std::int64_t at = first + p * width - f_begin;
    add(f.x + at, sum[p].x), add(f.y + at, sum[p].y), add(f.z + at, sum[p].z);
  }
}

void half_row(const StiffnessRun& run, std::int64_t i, const std::int32_t* offsets, const double* b,
              const Components& u, const Components& f, std::int32_t f_begin) {
  const double ux = u.x[i], uy = u.y[i], uz = u.z[i];
  double x = 0, y = 0, z = 0;
  for (std::int32_t n = 0; n < run.neighbours; ++n, b += 9) {
    const std::int64_t j = i + offsets[run.offset + n], at = j - f_begin;
    x += b[0] * u.x[j] + b[1] * u.y[j] + b[2] * u.z[j];
    y += b[3] * u.x[j] + b[4] * u.y[j] + b[5] * u.z[j];
    z += b[6] * u.x[j] + b[7] * u.y[j] + b[8] * u.z[j];
    if (n == 0) continue;
    f.x[at] += b[0] * ux + b[3] * uy + b[6] * uz;
    f.y[at] += b[1] * ux + b[4] * uy + b[7] * uz;
    f.z[at] += b[2] * ux + b[5] * uy + b[8] * uz;
  }
  f.x[i - f_begin] += x, f.y[i - f_begin] += y, f.z[i - f_begin] += z;
}

void half_rows(const StiffnessRun* runs, std::int32_t count, const std::int32_t* offsets, const double* blocks,
               const Components& u, const Components& f, std::int32_t f_begin) {
  for (std::int32_t r = 0; r < count; ++r) {
    const StiffnessRun run = runs[r];
    const double* b = blocks + run.block;
    if (run.nodes < fewest_lanes) {
      for (std::int32_t k = 0; k < run.nodes; ++k, b += 9 * run.neighbours)
        half_row(run, run.first + k, offsets, b, u, f, f_begin);
    } else {
      for (std::int32_t k = 0; k < run.nodes; k += block, b += 9 * block * run.neighbours)
        half_rows_of_eight(run, run.first + k, offsets, b, u, f, f_begin);
    }
  }
}

}  // namespace

StiffnessKernel LOCKSTEP_STIFFNESS_KERNEL() { return {split, shared_rows, half_rows, join}; }

}  // namespace lockstep::continuum
