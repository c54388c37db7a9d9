#include "protocol/codec.hpp"

#include <google/protobuf/stubs/logging.h>
#include <google/protobuf/util/message_differencer.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <optional>
#include <type_traits>

#include "common/checks.hpp"
#include "protocol/coupling.pb.h"
#include "protocol/framing.hpp"

namespace lockstep::protocol {
namespace {

using Doubles = google::protobuf::RepeatedField<double>;
static_assert(sizeof(Vec3) == 3 * sizeof(double) && sizeof(Voigt) == 6 * sizeof(double));
static_assert(sizeof(StressProfilePoint) == 3 * sizeof(double));
static_assert(sizeof(std::array<std::int32_t, 4>) == 4 * sizeof(std::int32_t));

struct Mesh {
  std::size_t nodes = 0;
  std::size_t facets = 0;
};

// An infinity or NaN has all exponent bits set: adding one to the lowest of them carries into the sign bit. Written on
// integers so that the compiler runs it on whole vectors.
bool all_finite(std::span<const double> values) {
  std::uint64_t carry = 0;
  for (const double value : values)
    carry |= (std::bit_cast<std::uint64_t>(value) & 0x7fffffffffffffffull) + 0x0010000000000000ull;
  return (carry >> 63) == 0;
}

template <class Entry>
std::span<const double> numbers_of(const std::vector<Entry>& entries) {
  return {reinterpret_cast<const double*>(entries.data()), entries.size() * sizeof(Entry) / sizeof(double)};
}

// Collects the first thing that is wrong with a message.
class Findings {
 public:
  enum class Kind { None, NotFinite, Wrong };

  explicit Findings(MessageType type) : type_(type) {}

  void finite(std::string_view field, double value) {
    if (!std::isfinite(value)) note(Kind::NotFinite, fmt::format("{} = {} is not finite", field, value));
  }
  void not_negative(std::string_view field, double value) {
    finite(field, value);
    if (value < 0) note(Kind::Wrong, fmt::format("{} = {} is negative", field, value));
  }
  template <class Entry>
  void finite(std::string_view field, const std::vector<Entry>& entries) {
    const std::span<const double> numbers = numbers_of(entries);
    if (all_finite(numbers)) return;
    constexpr std::size_t width = sizeof(Entry) / sizeof(double);
    std::size_t i = 0;
    while (std::isfinite(numbers[i])) ++i;
    note(Kind::NotFinite, fmt::format("{}[{}], component {} of {}, = {} is not finite", field, i / width, i % width + 1,
                                      width, numbers[i]));
  }
  void finite(std::string_view field, const Vec3& value) {
    for (int i = 0; i < 3; ++i) {
      if (!std::isfinite(value[i]))
        note(Kind::NotFinite, fmt::format("{}, component {} of 3, = {} is not finite", field, i + 1, value[i]));
    }
  }
  void length(std::string_view field, std::size_t actual, std::size_t expected, std::string_view of) {
    if (actual != expected) note(Kind::Wrong, fmt::format("{} has {} entries for {} {}", field, actual, expected, of));
  }
  void energies(const Energies& e) {
    finite("energies.kinetic", e.kinetic);
    finite("energies.elastic", e.elastic);
    finite("energies.gravity_work", e.gravity_work);
    finite("energies.damped", e.damped);
    finite("energies.friction", e.friction);
    finite("energies.boundary_work", e.boundary_work);
    finite("energies.interface_work", e.interface_work);
  }
  void wrong(const std::string& words) { note(Kind::Wrong, words); }

  Kind kind() const { return kind_; }
  const std::string& words() const { return words_; }

 private:
  void note(Kind kind, const std::string& words) {
    if (kind_ != Kind::None) return;
    kind_ = kind;
    words_ = fmt::format("{}.{}", name_of(type_), words);
  }

  MessageType type_;
  Kind kind_ = Kind::None;
  std::string words_;
};

void inspect(const Hello&, const std::optional<Mesh>&, Findings&) {}

void inspect(const InitialStress& m, const std::optional<Mesh>&, Findings& f) {
  f.length("ring", m.ring.size(), m.facets.size(), "facets");
  f.length("traction", m.traction.size(), m.facets.size(), "facets");
  f.length("stress", m.stress.size(), m.facets.size(), "facets");
  f.finite("nodes", m.nodes);
  f.finite("traction", m.traction);
  f.finite("stress", m.stress);
  f.finite("profile", m.profile);
  f.finite("gravity", m.gravity);
  f.not_negative("bulk_density", m.bulk_density);
  f.finite("unbalanced_ratio", m.unbalanced_ratio);
  for (std::size_t i = 0; i < m.facets.size(); ++i) {
    for (std::size_t j = 0; j < 4; ++j) {
      if (const std::int32_t node = m.facets[i][j]; node < 0 || static_cast<std::size_t>(node) >= m.nodes.size())
        f.wrong(fmt::format("facets[{}], corner {}, = {} is not a node; there are {}", i, j, node, m.nodes.size()));
    }
  }
  for (std::size_t i = 1; i < m.profile.size(); ++i) {
    if (m.profile[i].z < m.profile[i - 1].z)
      f.wrong(
          fmt::format("profile[{}].z = {} lies below the point before it, {}", i, m.profile[i].z, m.profile[i - 1].z));
  }
}

void inspect(const Balance& m, const std::optional<Mesh>& mesh, Findings& f) {
  if (mesh) f.length("traction", m.traction.size(), mesh->facets, "facets");
  f.finite("traction", m.traction);
  f.finite("porosity", m.porosity);
  f.finite("unbalanced_ratio", m.unbalanced_ratio);
}

void inspect(const ContinuumExcavated& m, const std::optional<Mesh>& mesh, Findings& f) {
  f.finite("residual_ratio", m.residual_ratio);
  f.not_negative("stable_step", m.stable_step);
  f.not_negative("frequency_squared", m.stiffness.frequency_squared);
  if (mesh && !m.stiffness.node_mass.empty()) f.length("node_mass", m.stiffness.node_mass.size(), mesh->nodes, "nodes");
  f.finite("node_mass", m.stiffness.node_mass);
  f.not_negative("damping", m.stiffness.damping);
  f.not_negative("stiffness_damping", m.stiffness.stiffness_damping);
}

void inspect(const GrainsExcavated& m, const std::optional<Mesh>& mesh, Findings& f) {
  if (mesh) {
    f.length("offset", m.offset.size(), mesh->nodes, "nodes");
    f.length("node_stiffness", m.node_stiffness.size(), mesh->nodes, "nodes");
    f.length("nodal_force", m.nodal_force.size(), mesh->nodes, "nodes");
  }
  f.finite("offset", m.offset);
  f.not_negative("stable_step", m.stable_step);
  f.finite("node_stiffness", m.node_stiffness);
  f.finite("nodal_force", m.nodal_force);
}

void inspect(const Velocities& m, const std::optional<Mesh>& mesh, Findings& f) {
  if (m.stage != Stage::Apply && m.stage != Stage::Penetrate)
    f.wrong(fmt::format("stage = {} is neither Apply nor Penetrate", static_cast<int>(m.stage)));
  f.finite("time_step", m.time_step);
  if (!(m.time_step > 0)) f.wrong(fmt::format("time_step = {} is not above zero", m.time_step));
  if (mesh) f.length("velocity", m.velocity.size(), mesh->nodes, "nodes");
  f.finite("velocity", m.velocity);
  f.finite("unbalanced_ratio", m.unbalanced_ratio);
  f.energies(m.energies);
}

void inspect(const Forces& m, const std::optional<Mesh>& mesh, Findings& f) {
  if (mesh) {
    f.length("force", m.force.size(), mesh->nodes, "nodes");
    if (!m.node_stiffness.empty()) f.length("node_stiffness", m.node_stiffness.size(), mesh->nodes, "nodes");
  }
  f.finite("force", m.force);
  f.not_negative("stable_step", m.stable_step);
  f.finite("node_stiffness", m.node_stiffness);
  f.finite("unbalanced_ratio", m.unbalanced_ratio);
  if (m.energies) f.energies(*m.energies);
  f.finite("particle_force", m.particle_force);
  f.finite("neglected_moment", m.neglected_moment);
  f.finite("particle_moment", m.particle_moment);
}

void inspect(const Progress& m, const std::optional<Mesh>&, Findings& f) { f.finite("fraction", m.fraction); }
void inspect(const CheckpointRequest&, const std::optional<Mesh>&, Findings&) {}
void inspect(const CheckpointCommit&, const std::optional<Mesh>&, Findings&) {}
void inspect(const Finish&, const std::optional<Mesh>&, Findings&) {}
void inspect(const Abort&, const std::optional<Mesh>&, Findings&) {}

template <class Entry>
void copy(const std::vector<Entry>& from, Doubles& to) {
  const std::span<const double> numbers = numbers_of(from);
  to.Resize(static_cast<int>(numbers.size()), 0.0);
  if (!numbers.empty()) std::memcpy(to.mutable_data(), numbers.data(), numbers.size_bytes());
}

void copy(const Vec3& from, Doubles& to) {
  to.Resize(3, 0.0);
  std::memcpy(to.mutable_data(), from.data(), 3 * sizeof(double));
}

// Whole entries only: a list of vectors must hold a multiple of three numbers.
void check_multiple(MessageType type, std::string_view field, int numbers, std::size_t width) {
  if (static_cast<std::size_t>(numbers) % width != 0)
    throw PeerError(
        fmt::format("peer sent {}.{} with {} numbers, not a multiple of {}", name_of(type), field, numbers, width));
}

template <class Entry>
void copy(MessageType type, std::string_view field, const Doubles& from, std::vector<Entry>& to) {
  constexpr std::size_t width = sizeof(Entry) / sizeof(double);
  check_multiple(type, field, from.size(), width);
  to.resize(static_cast<std::size_t>(from.size()) / width);
  if (from.size() > 0)
    std::memcpy(static_cast<void*>(to.data()), from.data(), static_cast<std::size_t>(from.size()) * sizeof(double));
}

void copy(MessageType type, std::string_view field, const Doubles& from, Vec3& to) {
  if (from.size() != 0 && from.size() != 3)
    throw PeerError(fmt::format("peer sent {}.{} with {} numbers, not 3", name_of(type), field, from.size()));
  to = from.empty() ? Vec3::Zero() : Vec3(from.Get(0), from.Get(1), from.Get(2));
}

void to_wire(const Hello& m, wire::Hello& w) {
  w.set_major(m.major);
  w.set_minor(m.minor);
  w.set_role(m.role == Role::Continuum ? wire::CONTINUUM : wire::GRAINS);
  w.set_solver(m.solver);
  w.set_solver_version(m.solver_version);
  w.clear_capabilities();
  for (const std::string& capability : m.capabilities) w.add_capabilities(capability);
  w.set_scene_digest(m.scene_digest);
  w.set_resume_step(m.resume_step);
}

void from_wire(const wire::Hello& w, Hello& m) {
  m.major = w.major();
  m.minor = w.minor();
  if (w.role() != wire::CONTINUUM && w.role() != wire::GRAINS)
    throw PeerError(
        fmt::format("peer sent Hello.role = {}, neither 1 (continuum) nor 2 (grains)", static_cast<int>(w.role())));
  m.role = w.role() == wire::CONTINUUM ? Role::Continuum : Role::Grains;
  m.solver = w.solver();
  m.solver_version = w.solver_version();
  m.capabilities.assign(w.capabilities().begin(), w.capabilities().end());
  m.scene_digest = w.scene_digest();
  m.resume_step = w.resume_step();
}

void to_wire(const InitialStress& m, wire::InitialStress& w) {
  copy(m.nodes, *w.mutable_nodes());
  w.clear_facets();
  w.mutable_facets()->Reserve(static_cast<int>(4 * m.facets.size()));
  for (const auto& corners : m.facets) w.mutable_facets()->Add(corners.begin(), corners.end());
  w.mutable_ring()->Assign(m.ring.begin(), m.ring.end());
  copy(m.traction, *w.mutable_traction());
  copy(m.stress, *w.mutable_stress());
  copy(m.profile, *w.mutable_profile());
  copy(m.gravity, *w.mutable_gravity());
  w.set_bulk_density(m.bulk_density);
  w.set_unbalanced_ratio(m.unbalanced_ratio);
}

void from_wire(const wire::InitialStress& w, InitialStress& m) {
  constexpr MessageType type = MessageType::InitialStress;
  copy(type, "nodes", w.nodes(), m.nodes);
  check_multiple(type, "facets", w.facets_size(), 4);
  m.facets.resize(static_cast<std::size_t>(w.facets_size()) / 4);
  for (std::size_t i = 0; i < m.facets.size(); ++i) {
    for (std::size_t j = 0; j < 4; ++j) m.facets[i][j] = w.facets(static_cast<int>(4 * i + j));
  }
  m.ring.assign(w.ring().begin(), w.ring().end());
  copy(type, "traction", w.traction(), m.traction);
  copy(type, "stress", w.stress(), m.stress);
  copy(type, "profile", w.profile(), m.profile);
  copy(type, "gravity", w.gravity(), m.gravity);
  m.bulk_density = w.bulk_density();
  m.unbalanced_ratio = w.unbalanced_ratio();
}

void to_wire(const Balance& m, wire::Balance& w) {
  copy(m.traction, *w.mutable_traction());
  w.set_porosity(m.porosity);
  w.set_unbalanced_ratio(m.unbalanced_ratio);
  w.set_particles(m.particles);
  w.set_contacts(m.contacts);
}

void from_wire(const wire::Balance& w, Balance& m) {
  copy(MessageType::Balance, "traction", w.traction(), m.traction);
  m.porosity = w.porosity();
  m.unbalanced_ratio = w.unbalanced_ratio();
  m.particles = w.particles();
  m.contacts = w.contacts();
}

void to_wire(const ContinuumExcavated& m, wire::ContinuumExcavated& w) {
  w.set_zones_deleted(m.zones_deleted);
  w.set_residual_ratio(m.residual_ratio);
  w.set_stable_step(m.stable_step);
  w.set_position_hash(m.position_hash);
  w.set_frequency_squared(m.stiffness.frequency_squared);
  w.mutable_node_mass()->Assign(m.stiffness.node_mass.begin(), m.stiffness.node_mass.end());
  w.set_damping(m.stiffness.damping);
  w.set_stiffness_damping(m.stiffness.stiffness_damping);
}

void from_wire(const wire::ContinuumExcavated& w, ContinuumExcavated& m) {
  m.zones_deleted = w.zones_deleted();
  m.residual_ratio = w.residual_ratio();
  m.stable_step = w.stable_step();
  m.position_hash = w.position_hash();
  m.stiffness.frequency_squared = w.frequency_squared();
  m.stiffness.node_mass.assign(w.node_mass().begin(), w.node_mass().end());
  m.stiffness.damping = w.damping();
  m.stiffness.stiffness_damping = w.stiffness_damping();
}

void to_wire(const GrainsExcavated& m, wire::GrainsExcavated& w) {
  copy(m.offset, *w.mutable_offset());
  w.set_stable_step(m.stable_step);
  copy(m.node_stiffness, *w.mutable_node_stiffness());
  copy(m.nodal_force, *w.mutable_nodal_force());
  w.set_position_hash(m.position_hash);
  w.set_limited_by(m.limited_by);
}

void from_wire(const wire::GrainsExcavated& w, GrainsExcavated& m) {
  constexpr MessageType type = MessageType::GrainsExcavated;
  copy(type, "offset", w.offset(), m.offset);
  m.stable_step = w.stable_step();
  copy(type, "node_stiffness", w.node_stiffness(), m.node_stiffness);
  copy(type, "nodal_force", w.nodal_force(), m.nodal_force);
  m.position_hash = w.position_hash();
  m.limited_by = w.limited_by();
}

void to_wire(const Energies& m, wire::Energies& w) {
  w.set_kinetic(m.kinetic);
  w.set_elastic(m.elastic);
  w.set_gravity_work(m.gravity_work);
  w.set_damped(m.damped);
  w.set_friction(m.friction);
  w.set_boundary_work(m.boundary_work);
  w.set_interface_work(m.interface_work);
}

void from_wire(const wire::Energies& w, Energies& m) {
  m.kinetic = w.kinetic();
  m.elastic = w.elastic();
  m.gravity_work = w.gravity_work();
  m.damped = w.damped();
  m.friction = w.friction();
  m.boundary_work = w.boundary_work();
  m.interface_work = w.interface_work();
}

void to_wire(const Velocities& m, wire::Velocities& w) {
  w.set_step(m.step);
  w.set_stage(m.stage == Stage::Apply ? wire::APPLY : wire::PENETRATE);
  w.set_time_step(m.time_step);
  copy(m.velocity, *w.mutable_velocity());
  w.set_unbalanced_ratio(m.unbalanced_ratio);
  w.set_position_hash(m.position_hash);
  to_wire(m.energies, *w.mutable_energies());
}

void from_wire(const wire::Velocities& w, Velocities& m) {
  m.step = w.step();
  if (w.stage() != wire::APPLY && w.stage() != wire::PENETRATE)
    throw PeerError(fmt::format("peer sent Velocities.stage = {}, neither 1 (Apply) nor 2 (Penetrate)",
                                static_cast<int>(w.stage())));
  m.stage = w.stage() == wire::APPLY ? Stage::Apply : Stage::Penetrate;
  m.time_step = w.time_step();
  copy(MessageType::Velocities, "velocity", w.velocity(), m.velocity);
  m.unbalanced_ratio = w.unbalanced_ratio();
  m.position_hash = w.position_hash();
  from_wire(w.energies(), m.energies);
}

void to_wire(const Forces& m, wire::Forces& w) {
  w.set_step(m.step);
  copy(m.force, *w.mutable_force());
  w.set_stable_step(m.stable_step);
  copy(m.node_stiffness, *w.mutable_node_stiffness());
  w.set_unbalanced_ratio(m.unbalanced_ratio);
  w.set_is_done(m.is_done);
  if (m.energies)
    to_wire(*m.energies, *w.mutable_energies());
  else
    w.clear_energies();
  copy(m.particle_force, *w.mutable_particle_force());
  w.set_neglected_moment(m.neglected_moment);
  copy(m.particle_moment, *w.mutable_particle_moment());
  w.set_limited_by(m.limited_by);
}

void from_wire(const wire::Forces& w, Forces& m) {
  constexpr MessageType type = MessageType::Forces;
  m.step = w.step();
  copy(type, "force", w.force(), m.force);
  m.stable_step = w.stable_step();
  copy(type, "node_stiffness", w.node_stiffness(), m.node_stiffness);
  m.unbalanced_ratio = w.unbalanced_ratio();
  m.is_done = w.is_done();
  if (w.has_energies())
    from_wire(w.energies(), m.energies.emplace());
  else
    m.energies.reset();
  copy(type, "particle_force", w.particle_force(), m.particle_force);
  m.neglected_moment = w.neglected_moment();
  copy(type, "particle_moment", w.particle_moment(), m.particle_moment);
  m.limited_by = w.limited_by();
}

void to_wire(const Progress& m, wire::Progress& w) {
  w.set_text(m.text);
  w.set_fraction(m.fraction);
}
void from_wire(const wire::Progress& w, Progress& m) {
  m.text = w.text();
  m.fraction = w.fraction();
}

void to_wire(const CheckpointRequest& m, wire::CheckpointRequest& w) {
  w.set_step(m.step);
  w.set_name(m.name);
}
void from_wire(const wire::CheckpointRequest& w, CheckpointRequest& m) {
  m.step = w.step();
  m.name = w.name();
}

void to_wire(const CheckpointCommit& m, wire::CheckpointCommit& w) {
  w.set_step(m.step);
  w.set_state_hash(m.state_hash);
}
void from_wire(const wire::CheckpointCommit& w, CheckpointCommit& m) {
  m.step = w.step();
  m.state_hash = w.state_hash();
}

void to_wire(const Finish& m, wire::Finish& w) {
  w.set_step(m.step);
  w.set_text(m.text);
  w.set_is_interrupted(m.is_interrupted);
}
void from_wire(const wire::Finish& w, Finish& m) {
  m.step = w.step();
  m.text = w.text();
  m.is_interrupted = w.is_interrupted();
}

void to_wire(const Abort& m, wire::Abort& w) {
  w.set_exit_code(m.exit_code);
  w.set_reason(m.reason);
}
void from_wire(const wire::Abort& w, Abort& m) {
  m.exit_code = w.exit_code();
  m.reason = w.reason();
}

// The generated class of a struct, and its place in the Message variant.
template <class M>
struct Wire;
#define LOCKSTEP_WIRE(Name)                                  \
  template <>                                                \
  struct Wire<Name> {                                        \
    using type = wire::Name;                                 \
    static constexpr MessageType number = MessageType::Name; \
  }
LOCKSTEP_WIRE(Hello);
LOCKSTEP_WIRE(InitialStress);
LOCKSTEP_WIRE(Balance);
LOCKSTEP_WIRE(ContinuumExcavated);
LOCKSTEP_WIRE(GrainsExcavated);
LOCKSTEP_WIRE(Velocities);
LOCKSTEP_WIRE(Forces);
LOCKSTEP_WIRE(Progress);
LOCKSTEP_WIRE(CheckpointRequest);
LOCKSTEP_WIRE(CheckpointCommit);
LOCKSTEP_WIRE(Finish);
LOCKSTEP_WIRE(Abort);
#undef LOCKSTEP_WIRE

template <class M>
void encode_as(const M& message, const std::optional<Mesh>& mesh, typename Wire<M>::type& wire_message,
               std::vector<std::byte>& frame) {
  Findings findings(Wire<M>::number);
  inspect(message, mesh, findings);
  if (findings.kind() == Findings::Kind::NotFinite) throw NumericalError("not sent to the peer: " + findings.words());
  if (findings.kind() == Findings::Kind::Wrong) throw InternalError("not sent to the peer: " + findings.words());
  to_wire(message, wire_message);
  const std::size_t size = wire_message.ByteSizeLong();
  LOCKSTEP_ASSERT(size <= max_payload, "{} of {} bytes exceeds the largest frame, {} bytes", name_of(Wire<M>::number),
                  size, max_payload);
  frame.resize(header_size + size);
  wire_message.SerializeWithCachedSizesToArray(reinterpret_cast<std::uint8_t*>(frame.data() + header_size));
  write_header(frame, Wire<M>::number);
}

template <class WireMessage>
void parse(std::span<const std::byte> frame, WireMessage& wire_message) {
  const std::span<const std::byte> payload = payload_of(frame);
  if (!wire_message.ParseFromArray(payload.data(), static_cast<int>(payload.size())))
    throw PeerError(fmt::format("peer sent {} of {} bytes that is not a {} of coupling.proto", name_of(type_of(frame)),
                                payload.size(), name_of(type_of(frame))));
}

template <class M>
void decode_as(std::span<const std::byte> frame, const std::optional<Mesh>& mesh, typename Wire<M>::type& wire_message,
               M& message) {
  LOCKSTEP_ASSERT(type_of(frame) == Wire<M>::number, "{} taken for {}", name_of(type_of(frame)),
                  name_of(Wire<M>::number));
  parse(frame, wire_message);
  from_wire(wire_message, message);
  Findings findings(Wire<M>::number);
  inspect(message, mesh, findings);
  if (findings.kind() != Findings::Kind::None) throw PeerError("peer sent " + findings.words());
}

template <std::size_t I = 0>
Message decode_type(std::span<const std::byte> frame, const std::optional<Mesh>& mesh) {
  if constexpr (I < message_types) {
    if (static_cast<std::size_t>(type_of(frame)) != I) return decode_type<I + 1>(frame, mesh);
    using M = std::variant_alternative_t<I, Message>;
    M message;
    typename Wire<M>::type wire_message;
    decode_as(frame, mesh, wire_message, message);
    return message;
  } else {
    throw InternalError("a frame of unknown type passed the header's check");
  }
}

template <std::size_t I = 0>
std::string difference_of_type(std::span<const std::byte> a, std::span<const std::byte> b) {
  if constexpr (I < message_types) {
    if (static_cast<std::size_t>(type_of(a)) != I) return difference_of_type<I + 1>(a, b);
    typename Wire<std::variant_alternative_t<I, Message>>::type wire_a, wire_b;
    parse(a, wire_a);
    parse(b, wire_b);
    google::protobuf::util::MessageDifferencer differencer;
    std::string report;
    differencer.ReportDifferencesToString(&report);
    differencer.Compare(wire_a, wire_b);
    return report.substr(0, report.find('\n'));
  } else {
    return {};
  }
}

}  // namespace

struct Codec::Impl {
  std::optional<Mesh> mesh;
  wire::Velocities velocities_out, velocities_in;
  wire::Forces forces_out, forces_in;
};

Codec::Codec() : impl_(std::make_unique<Impl>()) {
  // What protobuf would print on standard error about a malformed message is said in this side's own errors.
  static const auto silenced [[maybe_unused]] = google::protobuf::SetLogHandler(nullptr);
}
Codec::~Codec() = default;

void Codec::set_mesh(std::size_t nodes, std::size_t facets) { impl_->mesh = Mesh{nodes, facets}; }

void Codec::encode(const Message& message, std::vector<std::byte>& frame) {
  std::visit(
      [&](const auto& m) {
        typename Wire<std::decay_t<decltype(m)>>::type wire_message;
        encode_as(m, impl_->mesh, wire_message, frame);
      },
      message);
}
void Codec::encode(const Velocities& message, std::vector<std::byte>& frame) {
  encode_as(message, impl_->mesh, impl_->velocities_out, frame);
}
void Codec::encode(const Forces& message, std::vector<std::byte>& frame) {
  encode_as(message, impl_->mesh, impl_->forces_out, frame);
}

Message Codec::decode(std::span<const std::byte> frame) { return decode_type(frame, impl_->mesh); }
void Codec::decode(std::span<const std::byte> frame, Velocities& into) {
  decode_as(frame, impl_->mesh, impl_->velocities_in, into);
}
void Codec::decode(std::span<const std::byte> frame, Forces& into) {
  decode_as(frame, impl_->mesh, impl_->forces_in, into);
}

std::string first_difference(std::span<const std::byte> a, std::span<const std::byte> b) {
  return difference_of_type(a, b);
}

}  // namespace lockstep::protocol
