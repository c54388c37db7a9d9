#include "dem_server/packing_file.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <type_traits>

#include "common/checks.hpp"
#include "common/results.hpp"
#include "dem_server/constants.hpp"

namespace lockstep::dem {

namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "packings are little-endian");

constexpr std::string_view magic = "LKPACK\r\n";
constexpr std::uint64_t format_version = 2;
constexpr std::size_t word = 8;  // [bytes]
constexpr std::size_t header_size = 4 * word;
constexpr const char* remedy = "remove the file and let a run make it anew, or give another --packing";

// The ground's solver stops at a small unbalanced ratio, so the same ground hands over the same stress up to this share
// of the largest. The packing meets it to balance.traction_tolerance anyway.
constexpr double traction_tolerance = 1e-3;

// ------------------------------------------------------------------------------------------------ words of 8 bytes

class Writer {
 public:
  std::string bytes;

  template <class Integer>
  requires std::is_integral_v<Integer>
  void put(Integer value) { put_word(static_cast<std::uint64_t>(static_cast<std::int64_t>(value))); }
  void put(std::uint64_t value) { put_word(value); }
  void put(double value) { put_word(std::bit_cast<std::uint64_t>(value)); }
  void put(const Vec3& v) { put(v.x()), put(v.y()), put(v.z()); }
  void put(const std::string& text) {
    put(static_cast<std::uint64_t>(text.size()));
    bytes += text;
    bytes.resize((bytes.size() + word - 1) / word * word, '\0');
  }
  template <class Element, class Each>
  void put_all(const std::vector<Element>& elements, Each&& each) {
    put(static_cast<std::uint64_t>(elements.size()));
    for (const Element& element : elements) each(element);
  }
  template <class Element>
  void put_all(const std::vector<Element>& elements) {
    put_all(elements, [&](const Element& element) { put(element); });
  }

 private:
  void put_word(std::uint64_t value) { bytes.append(reinterpret_cast<const char*>(&value), word); }
};

class Reader {
 public:
  Reader(std::string_view bytes, const fs::path& path) : bytes_(bytes), path_(path) {}

  void get(std::uint64_t& value) { std::memcpy(&value, take(word), word); }
  void get(double& value) { std::memcpy(&value, take(word), word); }
  template <class Integer>
  requires std::is_integral_v<Integer>
  void get(Integer& value) {
    std::uint64_t wide = 0;
    get(wide);
    value = static_cast<Integer>(static_cast<std::int64_t>(wide));
  }
  void get(Vec3& v) { get(v.x()), get(v.y()), get(v.z()); }
  void get(std::string& text) {
    const std::size_t size = count(1);
    text.assign(take((size + word - 1) / word * word), size);
  }
  template <class Element, class Each>
  void get_all(std::vector<Element>& elements, Each&& each) {
    elements.resize(count(word));
    for (Element& element : elements) each(element);
  }
  template <class Element>
  void get_all(std::vector<Element>& elements) {
    get_all(elements, [&](Element& element) { get(element); });
  }
  // A number of things that take at least `least` bytes each: more than the rest holds are not believed.
  std::size_t count(std::size_t least) {
    std::uint64_t number = 0;
    get(number);
    if (number > (bytes_.size() - at_) / least) fail();
    return static_cast<std::size_t>(number);
  }
  // An index of one of `count` things.
  std::size_t index(std::size_t count) {
    std::uint64_t number = 0;
    get(number);
    if (number >= count) fail();
    return static_cast<std::size_t>(number);
  }
  void expect_end() const {
    if (at_ != bytes_.size()) fail();
  }

 private:
  const char* take(std::size_t size) {
    if (size > bytes_.size() - at_) fail();
    const char* begin = bytes_.data() + at_;
    at_ += size;
    return begin;
  }
  [[noreturn]] void fail() const {
    throw InputError(fmt::format("{}: the packing's content makes no sense {} bytes from its beginning; {}",
                                 path_.string(), at_, remedy));
  }

  std::string_view bytes_;
  std::size_t at_ = 0;
  const fs::path& path_;
};

std::uint64_t hash_of(std::string_view bytes) {
  Hash hash;
  hash.add(static_cast<std::uint64_t>(bytes.size()));
  for (std::size_t at = 0; at < bytes.size(); at += word) {
    std::uint64_t value = 0;
    std::memcpy(&value, bytes.data() + at, std::min(word, bytes.size() - at));
    hash.add(value);
  }
  return hash.value();
}

// ------------------------------------------------------------------------------------------------------- sections
// Each is one function for both ways: `io(x)` puts x or gets it.

struct Put {
  static constexpr bool reads = false;
  Writer& writer;
  template <class Value>
  void operator()(const Value& value) const {
    writer.put(value);
  }
  template <class Element, class Each>
  void all(const std::vector<Element>& elements, Each&& each) const {
    writer.put_all(elements, each);
  }
  template <class Element>
  void all(const std::vector<Element>& elements) const {
    writer.put_all(elements);
  }
};

struct Get {
  static constexpr bool reads = true;
  Reader& reader;
  template <class Value>
  void operator()(Value& value) const {
    reader.get(value);
  }
  template <class Element, class Each>
  void all(std::vector<Element>& elements, Each&& each) const {
    reader.get_all(elements, each);
  }
  template <class Element>
  void all(std::vector<Element>& elements) const {
    reader.get_all(elements);
  }
};

template <class Io, class Keys>
void keys_section(const Io& io, Keys& keys) {
  io.all(keys, [&](auto& key) { io(key.first), io(key.second); });
}

template <class Io, class Ground>
void ground_section(const Io& io, Ground& ground) {
  io.all(ground.nodes);
  io.all(ground.facets, [&](auto& facet) {
    for (auto& node : facet) io(node);
  });
  io.all(ground.ring);
  io.all(ground.traction);
  io(ground.bulk_density), io(ground.tip_target);
}

template <class Io, class Figures>
void assembly_section(const Io& io, Figures& a) {
  io(a.mean_radius), io(a.solid_density), io(a.cube_porosity), io(a.overall_porosity), io(a.preparation_friction);
}

template <class Io, class Figures>
void figures_section(const Io& io, Figures& f) {
  io(f.unbalanced_ratio), io(f.porosity), io(f.cycles), io(f.has_servo);
  io.all(f.rings, [&](auto& ring) {
    io(ring.id);
    io.all(ring.facets);
    io(ring.area), io(ring.center_z), io(ring.target), io(ring.pressure), io(ring.velocity), io(ring.mean_velocity);
    io(ring.is_at_end), io(ring.travel);
  });
  io(f.tip_pressure), io(f.ring_mismatch), io(f.bottom_mismatch), io(f.bottom_force), io(f.weight), io(f.tip_force);
}

template <class Io, class History>
void history_section(const Io& io, History& history) {
  io(history.spring), io(history.normal);
}

template <class Io, class State>
void facets_section(const Io& io, State& state) {
  io.all(state.positions), io.all(state.offsets), io.all(state.velocity), io.all(state.offset_velocity);
  io.all(state.contacts, [&](auto& contact) {
    io(contact.pebble), io(contact.body), io(contact.share_count);
    for (auto& share : contact.shares) {
      io(share.facet), io(share.share);
      for (auto& weight : share.weights) io(weight);
    }
    io(contact.point), io(contact.foot), io(contact.overlap);
    io(contact.normal_stiffness), io(contact.shear_stiffness), io(contact.force);
    history_section(io, contact.history);
  });
}

template <class Io, class Contacts>
void wall_contacts_section(const Io& io, Contacts& contacts) {
  io.all(contacts, [&](auto& contact) {
    io(contact.pebble), io(contact.body), io(contact.part);
    io(contact.point), io(contact.overlap), io(contact.normal_stiffness), io(contact.shear_stiffness),
        io(contact.force);
    history_section(io, contact.history);
  });
}

template <class Io, class States>
void walls_section(const Io& io, States& states) {
  io.all(states, [&](auto& wall) {
    io(wall.center);
    for (auto& component : wall.attitude.coeffs()) io(component);
    io(wall.velocity), io(wall.spin), io(wall.servo_speed), io(wall.servo_way);
    io(wall.last_force), io(wall.last_torque), io(wall.last_pressing);
  });
}

template <class Io, class State>
void springs_section(const Io& io, State& springs) {
  io.all(springs, [&](auto& spring) { io(spring.i), io(spring.j), io(spring.force); });
}

// The records as they stand, since what follows from them (the place of a pebble, the mass) was rounded on other ways.
constexpr std::size_t sphere_numbers = 4, motion_numbers = 8;

template <class Record>
using Numbers = std::array<double, sizeof(Record) / sizeof(double)>;

template <class Record>
void put_record(Writer& writer, const Record& record) {
  for (const double number : std::bit_cast<Numbers<Record>>(record)) writer.put(number);
}

template <class Record>
Record get_record(Reader& reader) {
  Numbers<Record> numbers{};
  for (double& number : numbers) reader.get(number);
  return std::bit_cast<Record>(numbers);
}

template <class Io, class Shape>
void shape_section(const Io& io, Shape& shape) {
  io(shape.inertia_per_mass), io(shape.bounding_radius);
  io.all(shape.pebble_center, [&](auto& center) { io(center); });
  io.all(shape.pebble_radius, [&](auto& radius) { io(radius); });
}

void put_particles(Writer& writer, Particles particles) {
  const Put io{writer};
  writer.put(particles.has_clumps());
  const ShapeTable& shapes = particles.shapes();
  writer.put(static_cast<std::uint64_t>(shapes.size()));
  for (std::size_t k = 0; k < shapes.size(); ++k) shape_section(io, shapes[static_cast<std::int32_t>(k)]);
  writer.put(static_cast<std::uint64_t>(particles.body_count()));
  for (std::size_t b = 0; b < particles.body_count(); ++b) {
    put_record(writer, particles.bodies()[b]);
    put_record(writer, particles.motion()[b]);
    if (!particles.has_clumps()) continue;
    writer.put(particles.shape_numbers()[b]);
    put_record(writer, particles.attitudes()[b]);
    for (auto p = particles.pebble_begin(b); p < particles.pebble_end(b); ++p)
      put_record(writer, particles.pebbles()[p]);
  }
}

// Bodies are added for their arrays and shapes, and then overwritten.
void get_particles(Reader& reader, Particles& particles) {
  const Get io{reader};
  bool has_clumps = false;
  reader.get(has_clumps);
  std::vector<ClumpTemplate> shapes(reader.count(word));
  for (ClumpTemplate& shape : shapes) shape_section(io, shape);
  if (has_clumps) particles.become_clumps();
  const std::size_t bodies = reader.count((sphere_numbers + motion_numbers) * word);
  std::size_t most = 0;  // pebbles of a body
  for (const ClumpTemplate& shape : shapes) most = std::max(most, shape.pebble_center.size());
  particles.reserve(bodies, has_clumps ? bodies * most : 0);
  for (std::size_t b = 0; b < bodies; ++b) {
    const auto place = get_record<SphereRecord>(reader);
    const auto motion = get_record<MotionRecord>(reader);
    particles.add(has_clumps ? shapes[reader.index(shapes.size())] : unit_sphere(), 1, 1, Vec3::Zero(),
                  Quat::Identity());
    particles.bodies()[b] = place;
    particles.motion()[b] = motion;
    if (!has_clumps) continue;
    particles.attitudes()[b] = get_record<AttitudeRecord>(reader);
    for (auto p = particles.pebble_begin(b); p < particles.pebble_end(b); ++p)
      particles.pebbles()[p] = get_record<SphereRecord>(reader);
  }
}

template <class Io, class Packing>
void all_sections(const Io& io, Packing& packing) {
  keys_section(io, packing.keys);
  ground_section(io, packing.ground);
  assembly_section(io, packing.assembly);
  figures_section(io, packing.figures);
  auto& state = packing.state;
  if constexpr (Io::reads)
    get_particles(io.reader, state.particles);
  else
    put_particles(io.writer, state.particles);
  io.all(state.is_fixed);
  springs_section(io, state.springs);
  facets_section(io, state.facets);
  walls_section(io, state.walls);
  wall_contacts_section(io, state.wall_contacts);
  io(state.has_pile), io(state.tip_z);
  wall_contacts_section(io, state.pile_contacts);
}

// ----------------------------------------------------------------------------------------------------- the checks

// The hash shows that the content is what was written; this, that what was written can be walked.
void check_numbers(const BalancedPacking& packing, const fs::path& path) {
  const PackingState& state = packing.state;
  const auto bodies = static_cast<std::int64_t>(state.particles.body_count());
  const auto pebbles = static_cast<std::int64_t>(state.particles.pebble_count());
  const auto demand = [&](bool is_good, std::string_view what) {
    if (!is_good)
      throw InputError(fmt::format("{}: the packing's {} do not fit its grains; {}", path.string(), what, remedy));
  };
  const std::size_t facets = packing.ground.facets.size();
  demand(packing.ground.ring.size() == facets && packing.ground.traction.size() == facets, "facets");
  demand(state.is_fixed.empty() || static_cast<std::int64_t>(state.is_fixed.size()) == bodies, "marks of fixed grains");
  const auto is_pebble = [&](std::int64_t p) { return p >= 0 && p < pebbles; };
  const auto is_body = [&](std::int64_t b) { return b >= 0 && b < bodies; };
  for (const PairContacts::Spring& spring : state.springs)
    demand(is_pebble(spring.i) && is_pebble(spring.j), "springs");
  for (const FacetContact& contact : state.facets.contacts)
    demand(is_pebble(contact.pebble) && is_body(contact.body) && contact.share_count >= 0 &&
               contact.share_count <= static_cast<std::int32_t>(FacetContact::max_shares),
           "contacts with the interface");
  for (const std::vector<WallContact>* contacts : {&state.wall_contacts, &state.pile_contacts})
    for (const WallContact& contact : *contacts)
      demand(is_pebble(contact.pebble) && is_body(contact.body), "contacts with walls and pile");
}

std::string whole_file(const fs::path& path) {
  const auto fail = [&](int error) {
    throw IoError(
        fmt::format("{}: cannot read the packing: {}; give --packing another file, or one that does not exist "
                    "yet to have it made",
                    path.string(), std::strerror(error)));
  };
  std::error_code error;
  if (fs::is_directory(path, error)) fail(EISDIR);
  std::ifstream file(path, std::ios::binary);
  if (!file) fail(errno);
  std::string bytes(static_cast<std::size_t>(fs::file_size(path)), '\0');
  file.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!file) fail(EIO);
  return bytes;
}

// The content, once the header has been checked.
std::string_view content_of(std::string_view bytes, const fs::path& path) {
  const std::string name = path.string();
  if (bytes.substr(0, magic.size()) != magic.substr(0, bytes.size()) || bytes.empty())
    throw InputError(fmt::format("{}: is no packing that dem_server wrote; give --packing another name", name));
  const auto number = [&](std::size_t at) {
    std::uint64_t value = 0;
    std::memcpy(&value, bytes.data() + at, word);
    return value;
  };
  if (bytes.size() < header_size)
    throw IoError(
        fmt::format("{}: the packing is cut off after {} bytes, amid its header; {}", name, bytes.size(), remedy));
  if (number(word) != format_version)
    throw InputError(fmt::format("{}: the packing is of format version {}, this program reads version {}; {}", name,
                                 number(word), format_version, remedy));
  const std::string_view content = bytes.substr(header_size);
  if (content.size() != number(2 * word))
    throw IoError(fmt::format("{}: the packing has {} bytes of content instead of {}: it was cut off or added to; {}",
                              name, content.size(), number(2 * word), remedy));
  if (const std::uint64_t hash = hash_of(content); hash != number(3 * word))
    throw IoError(fmt::format("{}: the packing is damaged: its content hashes to {:016x}, its header says {:016x}; {}",
                              name, hash, number(3 * word), remedy));
  return content;
}

[[noreturn]] void misfit(const fs::path& path, const std::string& what, const std::string& packing,
                         const std::string& scene) {
  throw InputError(
      fmt::format("{}: the packing was made for another scene: {} is {} there and {} here; make the scene the same, or "
                  "give another --packing (a file that does not exist yet is written)",
                  path.string(), what, packing, scene));
}

std::string in_words(const Vec3& v) { return fmt::format("({:.9g}, {:.9g}, {:.9g})", v.x(), v.y(), v.z()); }

}  // namespace

PackingState state_of(const Model& m) {
  PackingState state;
  state.particles = m.particles;
  state.is_fixed = m.is_fixed;
  state.springs = m.contacts.springs();
  state.facets = m.facets.state();
  state.walls = m.walls.states();
  state.wall_contacts = m.walls.contacts();
  state.has_pile = m.pile.has_value();
  if (m.pile) state.tip_z = m.pile->tip_z(), state.pile_contacts = m.pile->contacts();
  return state;
}

void restore(Model& m, const PackingState& state) {
  LOCKSTEP_ASSERT(state.has_pile == m.pile.has_value() && state.walls.size() == m.walls.size(),
                  "a packing for another scene");
  m.particles = state.particles;
  m.is_fixed = state.is_fixed;
  m.contacts.restore(m.particles, state.springs);
  m.facets.restore(state.facets);
  std::vector<WallState> walls = state.walls;
  for (std::size_t k = 0; k < walls.size(); ++k)
    walls[k].velocity = m.walls.state(k).velocity, walls[k].spin = m.walls.state(k).spin;
  m.walls.restore(walls, state.wall_contacts);
  if (m.pile) m.pile->restore(state.tip_z, 0, state.pile_contacts);
}

void write_packing(const fs::path& path, const BalancedPacking& packing) {
  Writer content;
  all_sections(Put{content}, packing);
  Writer header;
  header.bytes = magic;
  header.put(format_version);
  header.put(static_cast<std::uint64_t>(content.bytes.size()));
  header.put(hash_of(content.bytes));
  write_file(path, header.bytes + content.bytes);
}

BalancedPacking read_packing(const fs::path& path) {
  const std::string bytes = whole_file(path);
  Reader reader(content_of(bytes, path), path);
  BalancedPacking packing;
  all_sections(Get{reader}, packing);
  reader.expect_end();
  check_numbers(packing, path);
  return packing;
}

std::optional<BalancedPacking> open_packing(const fs::path& path, const SceneKeys& keys) {
  std::error_code error;
  if (!fs::exists(path, error)) {
    prepare_folder(path.has_parent_path() ? path.parent_path() : fs::path("."));
    return {};
  }
  BalancedPacking packing = read_packing(path);
  check_fits(packing.keys, keys, path);
  return packing;
}

void check_fits(const SceneKeys& packing, const SceneKeys& scene, const fs::path& path) {
  auto theirs = packing.begin(), mine = scene.begin();
  while (theirs != packing.end() && mine != scene.end() && *theirs == *mine) ++theirs, ++mine;
  if (theirs == packing.end() && mine == scene.end()) return;
  // A key that only one side has: a block, or another wall, more.
  const auto has = [](const SceneKeys& keys, const std::string& name) {
    return std::any_of(keys.begin(), keys.end(), [&](const auto& key) { return key.first == name; });
  };
  if (theirs == packing.end() || (mine != scene.end() && theirs->first != mine->first && !has(packing, mine->first)))
    misfit(path, mine->first, "not", mine->second);
  if (mine == scene.end() || theirs->first != mine->first) misfit(path, theirs->first, theirs->second, "not");
  misfit(path, theirs->first, theirs->second, mine->second);
}

void check_fits(const HandedOver& packing, const HandedOver& ground, const fs::path& path) {
  const auto compare = [&](const std::string& what, auto theirs, auto mine) {
    if (theirs != mine) misfit(path, what, fmt::format("{}", theirs), fmt::format("{}", mine));
  };
  compare("the interface's number of nodes", packing.nodes.size(), ground.nodes.size());
  compare("the interface's number of facets", packing.facets.size(), ground.facets.size());
  for (std::size_t k = 0; k < ground.nodes.size(); ++k)
    if (packing.nodes[k] != ground.nodes[k])
      misfit(path, fmt::format("the interface's node {} [m]", k), in_words(packing.nodes[k]),
             in_words(ground.nodes[k]));
  for (std::size_t f = 0; f < ground.facets.size(); ++f) {
    for (std::size_t k = 0; k < ground.facets[f].size(); ++k)
      compare(fmt::format("node {} of the interface's facet {}", k, f), packing.facets[f][k], ground.facets[f][k]);
    compare(fmt::format("the ring of the interface's facet {}", f), packing.ring[f], ground.ring[f]);
  }
  double largest = 0;  // [Pa]
  for (const Vec3& t : ground.traction) largest = std::max(largest, t.norm());
  for (std::size_t f = 0; f < ground.traction.size(); ++f)
    if (!((packing.traction[f] - ground.traction[f]).norm() <= traction_tolerance * largest))
      misfit(path, fmt::format("the traction that the ground hands over at facet {} [Pa]", f),
             in_words(packing.traction[f]), in_words(ground.traction[f]));
  const auto near = [&](const std::string& what, double theirs, double mine) {
    if (!(std::abs(theirs - mine) <= traction_tolerance * std::abs(mine)))
      misfit(path, what, fmt::format("{:.9g}", theirs), fmt::format("{:.9g}", mine));
  };
  near("the ground's bulk density [kg/m3]", packing.bulk_density, ground.bulk_density);
  near("the pressure handed over at the pile's tip [Pa]", packing.tip_target, ground.tip_target);
}

}  // namespace lockstep::dem
