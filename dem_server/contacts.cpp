#include "dem_server/contacts.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>

#include "common/checks.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

// ------------------------------------------------------------------------------------------------------- the lists

// Fills a chunk entry by entry, and its last tile with entries that name nobody.
class PairContacts::Writer {
 public:
  Writer(Chunk& chunk, const Particles& particles, bool is_periodic)
      : chunk_(chunk), particles_(particles), has_clumps_(particles.has_clumps()), is_periodic_(is_periodic) {
    chunk_.pairs.clear(), chunk_.bodies.clear(), chunk_.shifts.clear(), chunk_.springs.clear();
    chunk_.count = 0;
    chunk_.last_body = -1;
  }
  ~Writer() {
    const std::size_t count = chunk_.count;
    const auto nobody = static_cast<std::int32_t>(particles_.pebble_count());
    while (chunk_.count % tile_size != 0) add(nobody, nobody, Vec3::Zero(), Vec3::Zero());
    chunk_.count = count;
  }
  void add(std::int32_t i, std::int32_t j, const Vec3& shift, const Vec3& spring) {
    const std::size_t lane = chunk_.count++ % tile_size;
    if (lane == 0) {
      chunk_.pairs.emplace_back();
      chunk_.springs.emplace_back();
      if (has_clumps_) chunk_.bodies.emplace_back();
      if (is_periodic_) chunk_.shifts.emplace_back();
    }
    const std::int32_t b = particles_.pebble_body(j);
    if (b > chunk_.last_body && b < static_cast<std::int32_t>(particles_.body_count())) chunk_.last_body = b;
    chunk_.pairs.back().i[lane] = i;
    chunk_.pairs.back().j[lane] = j;
    SpringTile& springs = chunk_.springs.back();
    springs.x[lane] = spring.x(), springs.y[lane] = spring.y(), springs.z[lane] = spring.z();
    if (has_clumps_) {
      chunk_.bodies.back().a[lane] = particles_.pebble_body(i);
      chunk_.bodies.back().b[lane] = b;
    }
    if (!is_periodic_) return;
    ShiftTile& shifts = chunk_.shifts.back();
    shifts.x[lane] = shift.x(), shifts.y[lane] = shift.y(), shifts.z[lane] = shift.z();
  }

 private:
  Chunk& chunk_;
  const Particles& particles_;
  bool has_clumps_, is_periodic_;
};

namespace {

// Growth of the radii that renews the inner list, over its skin.
constexpr double growth_share = 0.25;

// Ways are counted a bit longer than they are: their sums are rounded.
constexpr double way_margin = 1 + 1e-6;

Vec3 spring_of(const std::vector<SpringTile>& springs, std::size_t k) {
  const SpringTile& tile = springs[k / tile_size];
  return {tile.x[k % tile_size], tile.y[k % tile_size], tile.z[k % tile_size]};
}

Vec3 shift_of(const std::vector<ShiftTile>& shifts, std::size_t k) {
  if (shifts.empty()) return Vec3::Zero();
  const ShiftTile& tile = shifts[k / tile_size];
  return {tile.x[k % tile_size], tile.y[k % tile_size], tile.z[k % tile_size]};
}

double squared_distance(const SphereRecord& a, const SphereRecord& b) {
  const double x = a.x - b.x, y = a.y - b.y, z = a.z - b.z;
  return x * x + y * y + z * z;
}

}  // namespace

PairContacts::PairContacts(double skin, std::optional<Vec3> period, InstructionSet instructions)
    : first_skin_(skin), skin_(skin), period_(period), instructions_(instructions) {
  LOCKSTEP_ASSERT(skin > 0, "skin {}", skin);
}

std::size_t PairContacts::chunk_count(const Particles& particles) const {
  return (particles.body_count() + chunk_bodies - 1) / chunk_bodies;
}

std::int32_t PairContacts::chunk_body(const Particles& particles, std::size_t chunk) const {
  return static_cast<std::int32_t>(std::min(chunk * chunk_bodies, particles.body_count()));
}

std::int32_t PairContacts::chunk_pebble(const Particles& particles, std::size_t chunk) const {
  return particles.pebble_begin(static_cast<std::size_t>(chunk_body(particles, chunk)));
}

TravelLimits PairContacts::limits() const {
  return {static_cast<std::uint64_t>(refreshes_), marks_.data(), growth_share * skin_};
}

void PairContacts::update(const Particles& particles, Team& team, std::span<const double> ways) {
  LOCKSTEP_ASSERT(!has_lists_ || marks_.size() == particles.pebble_count(),
                  "pebbles were added or removed without clear_history");
  const bool is_shared_out = partition_.size() == parts_for(team);
  ++age_;
  const bool has_learned = are_limits_guesses_ && age_ >= short_list_age;
  if (has_lists_ && is_shared_out && !has_left(particles, team, ways) && !has_learned) return;
  const double ended_skin = skin_;
  const int ended_age = age_;
  if (has_lists_) adapt_skin();
  age_ = 0;
  renew_outer(particles, ended_skin, team);
  refresh_inner(particles, ended_skin, ended_age, team);
}

void PairContacts::adapt_skin() {
  if (age_ < short_list_age) skin_ = std::min(skin_step * skin_, skin_range * first_skin_);
  if (age_ > long_list_age) skin_ = std::max(skin_ / skin_step, first_skin_ / skin_range);
}

double PairContacts::used_up(const Particles& particles) const {
  return particles.growth() - growth_ + (strained_ - strain_mark_) * half_reach_;
}

double PairContacts::outer_used_up(const Particles& particles) const {
  return particles.growth() - outer_growth_ + (strained_ - outer_strain_) * half_reach_;
}

void PairContacts::strain(Particles& particles, const Vec3& rate, double time_step) {
  LOCKSTEP_ASSERT(period_, "only a periodic cell strains");
  strain_rate_ = rate;
  const Vec3 stretch = Vec3::Ones() + rate * time_step;
  *period_ = period_->cwiseProduct(stretch);
  strained_ += (rate * time_step).cwiseAbs().maxCoeff();
  for (std::size_t b = 0; b < particles.body_count(); ++b) {
    const Vec3 way = (rate * time_step).cwiseProduct(std::as_const(particles).position(b));
    particles.position(b) += way;
    if (!particles.has_clumps()) continue;
    for (std::int32_t p = particles.pebble_begin(b); p < particles.pebble_end(b); ++p) {
      SphereRecord& pebble = particles.pebbles()[p];
      pebble.x += way.x(), pebble.y += way.y(), pebble.z += way.z();
    }
  }
  for (LargeArray<SphereRecord>* marks : {&marks_, &outer_marks_})
    for (SphereRecord& mark : *marks) mark.x *= stretch.x(), mark.y *= stretch.y(), mark.z *= stretch.z();
  for (std::vector<Chunk>* group : {&chunks_, &borders_})
    for (Chunk& chunk : *group)
      for (ShiftTile& shift : chunk.shifts)
        for (int l = 0; l < tile_size; ++l)
          shift.x[l] *= stretch.x(), shift.y[l] *= stretch.y(), shift.z[l] *= stretch.z();
}

// Whether any pebble has gone beyond its limit, or to no finite place.
bool PairContacts::has_left(const Particles& particles, Team& team, std::span<const double> ways) {
  const double used = used_up(particles);
  if (used > growth_share * skin_) return true;
  const bool knows_ways = ways.size() == slack_.size() && used == slack_use_ && particles.placements() == placements_;
  slack_use_ = used;
  placements_ = particles.placements();
  std::atomic<bool> any = false;
  team.run_parts(partition_.size(), [&](int part) {
    const auto k = static_cast<std::size_t>(part);
    for (std::size_t c = part_chunk_[k]; c < part_chunk_[k + 1]; ++c) {
      slack_[c] = knows_ways ? slack_[c] - way_margin * ways[c] : 0.0;
      if (slack_[c] > 0) continue;
      slack_[c] = slack(particles, c, used);
      if (slack_[c] < 0) any.store(true, std::memory_order_relaxed);
    }
  });
  return any;
}

// The shortest way that would bring a pebble of the chunk to its limit [m]; negative where one is beyond it or nowhere.
double PairContacts::slack(const Particles& particles, std::size_t chunk, double used) const {
  const SphereRecord* pebbles = particles.pebbles();
  const auto end = static_cast<std::size_t>(chunk_pebble(particles, chunk + 1));
  double least = std::numeric_limits<double>::infinity();
  int left = 0;
  for (auto p = static_cast<std::size_t>(chunk_pebble(particles, chunk)); p < end; ++p) {
    const double rest = marks_[p].radius - used - std::sqrt(squared_distance(pebbles[p], marks_[p]));
    left |= !(rest >= 0);
    least = rest < least ? rest : least;
  }
  return left ? -1 : least;
}

// The inner list takes pairs with gaps up to the skin, and all partners of fast pebbles: none of them may be missing from
// the outer list. While few pebbles have gone too far from their marks in it, these alone are listed anew; fast ones
// already half-way, so that they need not be looked at again so soon. `ended_skin` is that of the inner list that ends.
void PairContacts::renew_outer(const Particles& particles, double ended_skin, Team& team) {
  const double limit = 0.5 * (outer_reach_ - skin_) - outer_used_up(particles);
  const double calm = 0.5 * ended_skin - used_up(particles);
  // The skin has changed since. Too tight a list would be used up at once; one too wide costs little, and spares rattlers.
  const double wanted_reach = outer_skin_factor * skin_;
  const bool fits = outer_reach_ < 4 * wanted_reach && wanted_reach < 2 * outer_reach_;
  if (!has_lists_ || !fits || limit <= 0 || calm <= 0) {
    rebuild_outer(particles, team);
    return;
  }
  struct Strays {
    std::vector<std::int32_t> pebbles;
    bool is_any_late = false;
  };
  std::vector<Strays> found(static_cast<std::size_t>(team.size()));
  team.run([&](int thread) {
    Strays& strays = found[static_cast<std::size_t>(thread)];
    const SphereRecord* pebbles = particles.pebbles();
    const auto [begin, end] = share_of(outer_marks_.size(), thread, team.size());
    for (std::size_t p = begin; p < end; ++p) {
      const double way = squared_distance(pebbles[p], outer_marks_[p]);
      if (way <= 0.25 * limit * limit) continue;
      const bool is_late = !(way <= limit * limit);  // or nowhere
      if (!is_late && squared_distance(pebbles[p], marks_[p]) <= calm * calm) continue;
      strays.pebbles.push_back(static_cast<std::int32_t>(p));
      strays.is_any_late |= is_late;
    }
  });
  std::vector<std::int32_t> strays;
  bool is_any_late = false;
  for (const Strays& of_thread : found) {
    strays.insert(strays.end(), of_thread.pebbles.begin(), of_thread.pebbles.end());
    is_any_late |= of_thread.is_any_late;
  }
  std::size_t relisted = relisted_.size();
  bool are_finite = true;
  for (const std::int32_t p : strays) {
    relisted += std::find(relisted_.begin(), relisted_.end(), p) == relisted_.end();
    are_finite &= particles.pebble_center(p).allFinite();
  }
  const auto most = static_cast<std::size_t>(most_strays * static_cast<double>(particles.pebble_count()));
  if (!period_ && are_finite && relisted <= most)
    list_anew(particles, strays);
  else if (is_any_late)
    rebuild_outer(particles, team);
}

// Puts the strays' pairs into the outer list; pairs that they had before stay, and do no harm. The cells know the others
// where they were sorted, which is where their marks are unless they were strays themselves.
void PairContacts::list_anew(const Particles& particles, const std::vector<std::int32_t>& strays) {
  const SphereRecord* pebbles = particles.pebbles();
  for (const std::int32_t p : strays) {
    outer_marks_[p] = pebbles[p];
    if (std::find(relisted_.begin(), relisted_.end(), p) == relisted_.end()) relisted_.push_back(p);
  }
  std::vector<std::pair<std::int32_t, std::int32_t>> pairs;
  std::vector<std::int32_t> near;
  for (const std::int32_t p : strays) {
    search_.partners(particles, p, near);
    for (const std::int32_t q : relisted_) {
      const double range = outer_reach_ + pebbles[p].radius + pebbles[q].radius;
      if (particles.pebble_body(q) != particles.pebble_body(p) &&
          squared_distance(outer_marks_[p], outer_marks_[q]) < range * range)
        near.push_back(q);
    }
    for (const std::int32_t q : near) pairs.emplace_back(std::min(p, q), std::max(p, q));
  }
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  for (auto next = pairs.begin(); next != pairs.end();) {
    const std::size_t c = static_cast<std::size_t>(particles.pebble_body(next->first)) / chunk_bodies;
    OuterChunk merged;
    const OuterChunk& old = outer_[c];
    std::int32_t i = chunk_pebble(particles, c);
    for (std::size_t n = 0; n + 1 < old.begin.size(); ++n, ++i) {
      merged.begin.push_back(static_cast<std::int32_t>(merged.partners.size()));
      near.clear();
      for (; next != pairs.end() && next->first == i; ++next) near.push_back(next->second);
      std::set_union(old.partners.begin() + old.begin[n], old.partners.begin() + old.begin[n + 1], near.begin(),
                     near.end(), std::back_inserter(merged.partners));
    }
    merged.begin.push_back(static_cast<std::int32_t>(merged.partners.size()));
    outer_[c] = std::move(merged);
  }
}

void PairContacts::rebuild_outer(const Particles& particles, Team& team) {
  outer_reach_ = outer_skin_factor * skin_;
  relisted_.clear();
  search_.sort(particles, outer_reach_, period_);
  const std::size_t chunks = chunk_count(particles);
  outer_.resize(chunks);
  std::atomic<std::size_t> next = 0;
  team.run([&](int) {
    std::vector<std::int32_t> near;
    for (std::size_t c = next++; c < chunks; c = next++) {
      OuterChunk& chunk = outer_[c];
      chunk.begin.clear(), chunk.partners.clear();
      for (std::int32_t i = chunk_pebble(particles, c); i < chunk_pebble(particles, c + 1); ++i) {
        chunk.begin.push_back(static_cast<std::int32_t>(chunk.partners.size()));
        search_.partners_after(particles, i, near);
        chunk.partners.insert(chunk.partners.end(), near.begin(), near.end());
      }
      chunk.begin.push_back(static_cast<std::int32_t>(chunk.partners.size()));
      chunk.partners.shrink_to_fit();
    }
  });
  outer_marks_.assign(particles.pebbles(), particles.pebbles() + particles.pebble_count());
  outer_growth_ = particles.growth();
  outer_strain_ = strained_;
  double largest = 0;
  for (std::size_t p = 0; p < particles.pebble_count(); ++p) largest = std::max(largest, particles.pebbles()[p].radius);
  half_reach_ = largest + 0.5 * outer_reach_;
  has_lists_ = true;
  ++rebuilds_;
}

// Limits follow what each pebble used of its last one. `ended_skin` is that of the list that ends: a pebble that has used its
// half of it up is fast.
void PairContacts::refresh_inner(const Particles& particles, double ended_skin, int ended_age, Team& team) {
  const std::size_t pebbles = particles.pebble_count();
  const SphereRecord* record = particles.pebbles();
  const double growth = used_up(particles), outer_growth = outer_used_up(particles);
  const double widest = 0.5 * skin_, tightest = tightest_limit * widest;
  const double memory =
      are_limits_guesses_ ? 0 : std::pow(limit_memory, static_cast<double>(ended_age) / short_list_age);
  const bool has_marks = marks_.size() == pebbles;
  marks_.resize(pebbles);
  reach_.resize(pebbles);
  team.run([&](int thread) {
    const auto [begin, end] = share_of(pebbles, thread, team.size());
    for (std::size_t p = begin; p < end; ++p) {
      SphereRecord& mark = marks_[p];
      double limit = widest, reach = record[p].radius + widest;
      if (has_marks) {
        const double used = std::sqrt(squared_distance(record[p], mark)) + growth;
        const bool is_fast = !(used <= 0.5 * ended_skin);
        if (is_fast) {
          limit = 0.5 * outer_reach_ - std::sqrt(squared_distance(record[p], outer_marks_[p])) - outer_growth;
          reach = far_away;
        } else {
          limit = std::clamp(std::max(limit_margin * used, memory * mark.radius), tightest, widest);
          reach = record[p].radius + limit;
        }
      }
      reach_[p] = reach;
      mark = record[p];
      mark.radius = limit;
    }
  });
  are_limits_guesses_ = !has_marks;
  growth_ = particles.growth();
  strain_mark_ = strained_;
  slack_.assign(chunk_count(particles), 0);

  chunks_.resize(chunk_count(particles));
  sums_.resize(chunks_.size());
  scratch_.resize(static_cast<std::size_t>(team.size()));
  borders_.resize(static_cast<std::size_t>(parts_for(team)));
  std::atomic<std::size_t> next = 0;
  team.run([&](int thread) {
    for (std::size_t c = next++; c < chunks_.size(); c = next++)
      fill_chunk(particles, c, scratch_[static_cast<std::size_t>(thread)]);
  });
  share_out(particles, parts_for(team));
  team.run_parts(partition_.size(), [&](int part) { fill_border(particles, part); });
  ++refreshes_;
}

Vec3 PairContacts::shift_between(const Particles& particles, std::int32_t i, std::int32_t j) const {
  return nearest_image(particles.pebble_center(j) - particles.pebble_center(i), *period_);
}

// Those of `partners`, as many as fit into `near`, that the inner list takes.
std::span<const std::int32_t> PairContacts::near_partners(const Particles& particles, std::int32_t i,
                                                          const std::int32_t* partners,
                                                          std::span<std::int32_t> near) const {
  const SphereRecord* pebbles = particles.pebbles();
  const double* reach = reach_.data();
  const SphereRecord own = pebbles[i];
  std::size_t kept = 0;
  for (std::size_t k = 0; k < near.size(); ++k) {
    const std::int32_t j = partners[k];
    double x = pebbles[j].x - own.x, y = pebbles[j].y - own.y, z = pebbles[j].z - own.z;
    if (period_) {
      const Vec3 shift = nearest_image({x, y, z}, *period_);
      x += shift.x(), y += shift.y(), z += shift.z();
    }
    const double range = reach[i] + reach[j];
    near[kept] = j;
    kept += x * x + y * y + z * z < range * range;
  }
  return near.first(kept);
}

void PairContacts::fill_chunk(const Particles& particles, std::size_t c, Chunk& scratch) {
  const OuterChunk& outer = outer_[c];
  Chunk& old = chunks_[c];
  {
    Writer writer(scratch, particles, period_.has_value());
    std::size_t known = 0;  // walks the present list along with the outer one: both are sorted by (i, j)
    const auto pair_at = [&](std::size_t k) {
      const PairTile& tile = old.pairs[k / tile_size];
      return std::pair(tile.i[k % tile_size], tile.j[k % tile_size]);
    };
    const std::int32_t first = chunk_pebble(particles, c);
    std::vector<std::int32_t> near;  // which of i's partners are
    for (std::size_t n = 0; n + 1 < outer.begin.size(); ++n) {
      const std::int32_t i = first + static_cast<std::int32_t>(n);
      near.resize(static_cast<std::size_t>(outer.begin[n + 1] - outer.begin[n]));
      for (const std::int32_t j : near_partners(particles, i, outer.partners.data() + outer.begin[n], near)) {
        while (known < old.count && pair_at(known) < std::pair(i, j)) ++known;
        const bool is_known = known < old.count && pair_at(known) == std::pair(i, j);
        writer.add(i, j, period_ ? shift_between(particles, i, j) : Vec3::Zero(),
                   is_known ? spring_of(old.springs, known) : Vec3::Zero());
      }
    }
  }
  // Copied, not swapped: a chunk keeps no more memory than it needs.
  old = scratch;
}

int PairContacts::parts_for(const Team& team) { return team.size() > 1 ? parts_a_thread * team.size() : 1; }

// Parts get chunks of about equal numbers of tiles.
void PairContacts::share_out(const Particles& particles, int parts) {
  std::size_t tiles = 0;
  for (const Chunk& chunk : chunks_) tiles += chunk.pairs.size();
  part_chunk_.assign(1, 0);
  partition_.body_begin.assign(1, 0);
  std::size_t chunk = 0, taken = 0;
  for (int part = 1; part <= parts; ++part) {
    const std::size_t share = tiles * static_cast<std::size_t>(part) / static_cast<std::size_t>(parts);
    while (chunk < chunks_.size() && (part == parts || taken + chunks_[chunk].pairs.size() / 2 < share))
      taken += chunks_[chunk++].pairs.size();
    part_chunk_.push_back(chunk);
    partition_.body_begin.push_back(chunk_body(particles, chunk));
  }
}

// Copies of the entries whose A belongs to a lower part and whose B to this one.
void PairContacts::fill_border(const Particles& particles, int part) {
  const auto p = static_cast<std::size_t>(part);
  Writer writer(borders_[p], particles, period_.has_value());
  const std::int32_t first = partition_.body_begin[p], end = partition_.body_begin[p + 1];
  for (std::size_t c = 0; c < part_chunk_[p]; ++c) {
    const Chunk& chunk = chunks_[c];
    if (chunk.last_body < first) continue;
    for (std::size_t k = 0; k < chunk.count; ++k) {
      const PairTile& tile = chunk.pairs[k / tile_size];
      const std::int32_t j = tile.j[k % tile_size], b = particles.pebble_body(j);
      if (b >= first && b < end)
        writer.add(tile.i[k % tile_size], j, shift_of(chunk.shifts, k), spring_of(chunk.springs, k));
    }
  }
}

// -------------------------------------------------------------------------------------------------------- the forces

ContactTotals PairContacts::compute(Particles& particles, const GrainMaterial& material, double time_step,
                                    Detail detail, Team& team) {
  LOCKSTEP_ASSERT(has_lists_ && marks_.size() == particles.pebble_count(), "compute without update");
  if (material.friction == 0 && material_.friction != 0)  // a kernel without friction leaves springs as they are
    for (std::vector<Chunk>* group : {&chunks_, &borders_})
      for (Chunk& chunk : *group) std::fill(chunk.springs.begin(), chunk.springs.end(), SpringTile{});
  material_ = material;

  PairKernelTraits traits;
  traits.has_clumps = particles.has_clumps();
  traits.has_friction = material.friction > 0;
  traits.has_dashpot = material.damping_ratio > 0;
  traits.is_periodic = period_.has_value();
  traits.detail = detail;
  const PairKernels kernels = LOCKSTEP_KERNEL_FOR(instructions_, pair_kernel)(traits);
  const PairLaw law = {material.contact_modulus,
                       1 / material.stiffness_ratio,
                       material.friction,
                       material.damping_ratio,
                       time_step,
                       strain_rate_.x(),
                       strain_rate_.y(),
                       strain_rate_.z()};
  const auto stretch = [](Chunk& chunk) {
    return PairStretch{chunk.pairs.data(), chunk.bodies.data(), chunk.shifts.data(), chunk.springs.data(),
                       chunk.pairs.size()};
  };
  const Particles& grains = particles;
  particles.want_twists(kernels.make_twists, team);
  team.run_parts(partition_.size(), [&](int part) {
    const auto p = static_cast<std::size_t>(part);
    const PairState state = {grains.pebbles(),
                             grains.bodies(),
                             grains.motion(),
                             grains.twists(),
                             particles.loads(),
                             partition_.body_begin[p],
                             partition_.body_begin[p + 1]};
    PairSums counted_elsewhere;
    kernels.bounded(state, stretch(borders_[p]), law, counted_elsewhere);
    for (std::size_t c = part_chunk_[p]; c < part_chunk_[p + 1]; ++c) {
      Chunk& chunk = chunks_[c];
      sums_[c] = PairSums{};
      const bool crosses = chunk.last_body >= state.end_body;
      (crosses ? kernels.bounded : kernels.free)(state, stretch(chunk), law, sums_[c]);
    }
  });

  ContactTotals totals;
  double active = 0;
  for (const PairSums& sums : sums_) {
    totals.slip_work += sums.slip_work;
    totals.dashpot_work += sums.dashpot_work;
    active += sums.active;
    totals.normal_force += sums.normal_force;
    totals.contact_force += sums.contact_force;
    totals.normal_energy += sums.normal_energy;
    totals.shear_energy += sums.shear_energy;
    totals.virial += Vec3(sums.virial_x, sums.virial_y, sums.virial_z);
    totals.largest_overlap_ratio = std::max(totals.largest_overlap_ratio, sums.largest_overlap_ratio);
  }
  totals.active = static_cast<std::int64_t>(active);
  return totals;
}

PairContacts::Entry PairContacts::entry_of(const Particles& particles, const Chunk& chunk, std::size_t k) const {
  const PairTile& tile = chunk.pairs[k / tile_size];
  const std::int32_t i = tile.i[k % tile_size], j = tile.j[k % tile_size];
  const Vec3 center_i = particles.pebble_center(i), center_j = particles.pebble_center(j) + shift_of(chunk.shifts, k);
  const double radius_i = particles.pebble_radius(i), radius_j = particles.pebble_radius(j);
  const Vec3 d = center_j - center_i;
  const double distance = d.norm();
  Entry entry;
  ContactView& c = entry.contact;
  c.overlap = radius_i + radius_j - distance;
  if (!(c.overlap > 0)) return entry;
  c.body_a = particles.pebble_body(i);
  c.body_b = particles.pebble_body(j);
  const Vec3 position_a = particles.position(c.body_a), position_b = particles.position(c.body_b);
  entry.branch = d + (position_b - particles.pebble_center(j)) - (position_a - center_i);
  c.normal = distance > 0 ? Vec3(d / distance) : Vec3(Vec3::UnitZ());
  c.point = center_i + (radius_i - 0.5 * c.overlap) * c.normal;
  const double radius_a = particles.equivalent_radius(c.body_a), radius_b = particles.equivalent_radius(c.body_b);
  c.normal_stiffness = material_.normal_stiffness(radius_a, radius_b);
  c.shear_stiffness = c.normal_stiffness / material_.stiffness_ratio;
  double normal_force = c.normal_stiffness * c.overlap;
  if (material_.damping_ratio > 0) {
    const Vec3 lever_b = c.point - position_a - entry.branch;
    const Vec3 approach = particles.velocity(c.body_b) + particles.spin(c.body_b).cross(lever_b) -
                          particles.velocity_at(c.body_a, c.point) + strain_rate_.cwiseProduct(entry.branch);
    const double dashpot =
        pair_dashpot(material_.damping_ratio, c.normal_stiffness, particles.mass(c.body_a), particles.mass(c.body_b));
    normal_force = std::max(0.0, normal_force - dashpot * approach.dot(c.normal));
  }
  c.force_on_a = spring_of(chunk.springs, k) - normal_force * c.normal;
  return entry;
}

// ------------------------------------------------------------------------------------------------- state and memory

std::vector<PairContacts::Spring> PairContacts::springs() const {
  std::vector<Spring> all;
  for (const Chunk& chunk : chunks_)
    for (std::size_t k = 0; k < chunk.count; ++k)
      if (const Vec3 spring = spring_of(chunk.springs, k); spring != Vec3::Zero()) {
        const PairTile& tile = chunk.pairs[k / tile_size];
        all.push_back({tile.i[k % tile_size], tile.j[k % tile_size], spring});
      }
  return all;
}

void PairContacts::hash(Hash& h) const {
  for (const Spring& spring : springs()) {
    h.add(static_cast<std::uint64_t>(spring.i));
    h.add(static_cast<std::uint64_t>(spring.j));
    h.add(spring.force);
  }
}

void PairContacts::restore(const Particles& particles, const std::vector<Spring>& springs) {
  clear_history();
  chunks_.resize(chunk_count(particles));
  auto next = springs.begin();
  for (std::size_t c = 0; c < chunks_.size(); ++c) {
    Writer writer(chunks_[c], particles, period_.has_value());
    for (; next != springs.end() && next->i < chunk_pebble(particles, c + 1); ++next)
      writer.add(next->i, next->j, Vec3::Zero(), next->force);
  }
}

void PairContacts::clear_history() {
  chunks_.clear();
  borders_.clear();
  outer_.clear();
  marks_.clear();
  outer_marks_.clear();
  part_chunk_.clear();
  partition_.body_begin.clear();
  has_lists_ = false;
}

std::size_t PairContacts::memory() const {
  const auto bytes = [](const auto& values) { return values.capacity() * sizeof(values[0]); };
  std::size_t sum = search_.memory() + bytes(marks_) + bytes(outer_marks_) + bytes(reach_) + bytes(sums_);
  for (const auto* group : {&chunks_, &borders_, &scratch_})
    for (const Chunk& chunk : *group)
      sum += bytes(chunk.pairs) + bytes(chunk.bodies) + bytes(chunk.shifts) + bytes(chunk.springs);
  for (const OuterChunk& chunk : outer_) sum += bytes(chunk.begin) + bytes(chunk.partners);
  return sum;
}

}  // namespace lockstep::dem
