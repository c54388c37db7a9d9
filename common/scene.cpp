#include "common/scene.hpp"

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <functional>
#include <optional>
#include <regex>
#include <sstream>

#include "common/checks.hpp"
#include "common/hash.hpp"
#include "common/vectors.hpp"

namespace lockstep {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;
using google::protobuf::TextFormat;

constexpr int override_line = 0;  // stands in key_lines for a key that came from the command line

// ------------------------------------------------------------------------------------------------- names of keys

bool is_block(const FieldDescriptor& field) { return field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE; }

std::string join(const std::string& block, const std::string& key) { return block.empty() ? key : block + "." + key; }

std::string indexed(const std::string& key, int index) { return fmt::format("{}[{}]", key, index); }

// Number of single-letter insertions, deletions and replacements that turn `a` into `b` (Levenshtein), by rows.
std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, replaced});
    }
  }
  return row.back();
}

std::optional<std::string> nearest(const std::string& word, const std::vector<std::string>& candidates) {
  std::optional<std::string> best;
  std::size_t best_distance = std::max<std::size_t>(2, word.size() / 2) + 1;
  for (const std::string& candidate : candidates) {
    const std::size_t distance = edit_distance(word, candidate);
    if (distance < best_distance) best = candidate, best_distance = distance;
  }
  return best;
}

std::vector<std::string> keys_of(const Descriptor& block) {
  std::vector<std::string> names;
  for (int i = 0; i < block.field_count(); ++i) names.push_back(block.field(i)->name());
  return names;
}

std::vector<std::string> values_of(const google::protobuf::EnumDescriptor& type) {
  std::vector<std::string> names;
  for (int i = 0; i < type.value_count(); ++i) names.push_back(type.value(i)->name());
  return names;
}

// Calls `visit(field, dotted key, depth)` for every key of the schema, blocks before their keys. The schema is a tree.
void walk_schema(const Descriptor& block, const std::string& prefix, int depth,
                 const std::function<void(const FieldDescriptor&, const std::string&, int)>& visit) {
  for (int i = 0; i < block.field_count(); ++i) {
    const FieldDescriptor& field = *block.field(i);
    const std::string key = join(prefix, field.name());
    visit(field, key, depth);
    if (is_block(field)) walk_schema(*field.message_type(), key, depth + 1, visit);
  }
}

// What to write instead of `name`, which `block` does not have.
std::string advice_for_key(const std::string& name, const Descriptor& block) {
  std::string elsewhere;
  walk_schema(*scene::Scene::descriptor(), "", 0, [&](const FieldDescriptor& field, const std::string& key, int) {
    if (elsewhere.empty() && field.name() == name) elsewhere = key;
  });
  if (!elsewhere.empty()) return fmt::format("the key is {}", elsewhere);
  if (const auto guess = nearest(name, keys_of(block))) return fmt::format("did you mean \"{}\"?", *guess);
  return fmt::format("the keys are {}", fmt::join(keys_of(block), ", "));
}

std::string block_name(const Descriptor& block) {
  return &block == scene::Scene::descriptor() ? "the scene" : fmt::format("a block {}", block.name());
}

std::string unit_of(const FieldDescriptor& field) {
  return field.options().HasExtension(scene::unit) ? field.options().GetExtension(scene::unit) : "";
}

std::string effect_of(const FieldDescriptor& field) {
  return field.options().HasExtension(scene::effect) ? field.options().GetExtension(scene::effect) : "";
}

std::string number(double value) { return fmt::format("{:.10g}", value); }

std::string range_of(const FieldDescriptor& field) {
  const auto& options = field.options();
  if (!options.HasExtension(scene::min) && !options.HasExtension(scene::max)) return "";
  return fmt::format("[{}, {}]", options.HasExtension(scene::min) ? number(options.GetExtension(scene::min)) : "-inf",
                     options.HasExtension(scene::max) ? number(options.GetExtension(scene::max)) : "inf");
}

// ------------------------------------------------------------------------------------------------------- parsing

// Keeps the first complaint of the text-format parser and puts it into a user's words.
class FirstError : public google::protobuf::io::ErrorCollector {
 public:
  void AddError(int line, int column, const std::string& message) override {
    if (message_.empty()) line_ = line, column_ = column, message_ = message;
  }
  void AddWarning(int, int, const std::string&) override {}

  bool is_set() const { return !message_.empty(); }

  // "scene.txt:12:5: what is wrong", line and column from 1.
  std::string text(const std::string& file, const std::string& scene_text) const {
    std::smatch match;
    static const std::regex unknown_key("Message type \"([^\"]*)\" has no field named \"([^\"]*)\".*");
    if (std::regex_match(message_, match, unknown_key))
      if (const Descriptor* block = scene::Scene::descriptor()->file()->pool()->FindMessageTypeByName(match[1].str())) {
        const std::string key = match[2].str();
        return fmt::format("{}{}: \"{}\" is no key of {}; {}", file, place_of(key, scene_text), key, block_name(*block),
                           advice_for_key(key, *block));
      }
    static const std::regex unknown_value("Unknown enumeration value of \"([^\"]*)\" for field \"([^\"]*)\".*");
    if (std::regex_match(message_, match, unknown_value)) {
      const std::string value = match[1].str(), key = match[2].str();
      std::vector<std::string> values;
      walk_schema(*scene::Scene::descriptor(), "", 0, [&](const FieldDescriptor& field, const std::string&, int) {
        if (values.empty() && field.name() == key && field.enum_type()) values = values_of(*field.enum_type());
      });
      return fmt::format("{}{}: {} = {} is no choice; give one of {}", file, place_of(value, scene_text), key, value,
                         fmt::join(values, ", "));
    }
    const std::string place = line_ < 0 ? "" : fmt::format(":{}:{}", line_ + 1, column_ + 1);
    return fmt::format("{}{}: {}", file, place, message_);
  }

 private:
  // ":12:5" of the last `word` before the place that the parser names, which is the token after the wrong one.
  std::string place_of(const std::string& word, const std::string& scene_text) const {
    if (line_ < 0) return "";
    std::size_t end = 0;
    for (int i = 0; i < line_; ++i) end = scene_text.find('\n', end) + 1;
    const std::size_t at = scene_text.rfind(word, end + static_cast<std::size_t>(column_));
    if (at == std::string::npos) return fmt::format(":{}", line_ + 1);
    const std::string before = scene_text.substr(0, at);
    return fmt::format(":{}:{}", std::count(before.begin(), before.end(), '\n') + 1, at - (before.rfind('\n') + 1) + 1);
  }

  int line_ = -1, column_ = -1;
  std::string message_;
};

// Lines of all set keys, from the parser's own record.
void collect_lines(const Message& block, const TextFormat::ParseInfoTree& tree, const std::string& prefix,
                   std::vector<std::pair<std::string, int>>& lines) {
  std::vector<const FieldDescriptor*> fields;
  const Reflection& reflection = *block.GetReflection();
  reflection.ListFields(block, &fields);
  for (const FieldDescriptor* field : fields) {
    const int count = field->is_repeated() ? reflection.FieldSize(block, field) : 1;
    for (int i = 0; i < count; ++i) {
      const int index = field->is_repeated() ? i : -1;
      const std::string key = join(prefix, field->is_repeated() ? indexed(field->name(), i) : field->name());
      const int line = tree.GetLocation(field, index).line;
      if (line >= 0) lines.emplace_back(key, line + 1);
      if (!is_block(*field)) continue;
      const Message& child =
          field->is_repeated() ? reflection.GetRepeatedMessage(block, field, i) : reflection.GetMessage(block, field);
      if (const TextFormat::ParseInfoTree* nested = tree.GetTreeForNested(field, index))
        collect_lines(child, *nested, key, lines);
    }
  }
}

// ----------------------------------------------------------------------------------------------------- overrides

// A block whose presence alone adds something to the model: an override must not bring it in by the way.
bool adds_to_model(const Descriptor& type) {
  static const std::array<const Descriptor*, 11> types = {
      scene::Continuum::descriptor(), scene::CylinderInBrick::descriptor(),
      scene::Block::descriptor(),     scene::MeshFile::descriptor(),
      scene::Hole::descriptor(),      scene::Grains::descriptor(),
      scene::Packing::descriptor(),   scene::Lattice::descriptor(),
      scene::Box::descriptor(),       scene::Pile::descriptor(),
      scene::Packet::descriptor()};
  return std::find(types.begin(), types.end(), &type) != types.end();
}

struct KeyPart {
  std::string name;
  int index = -1;  // of a repeated block, else -1
};

std::vector<KeyPart> split_key(const std::string& key, const std::string& message_head) {
  static const std::regex pattern("([A-Za-z_][A-Za-z0-9_]*)(\\[([0-9]{1,6})\\])?");
  std::vector<KeyPart> parts;
  std::stringstream stream(key);
  for (std::string part; std::getline(stream, part, '.');) {
    std::smatch match;
    if (!std::regex_match(part, match, pattern))
      throw InputError(message_head + ": a key looks like fidelity.pile_velocity or grains.grain[0].radius");
    parts.push_back({match[1].str(), match[3].matched ? std::stoi(match[3].str()) : -1});
  }
  return parts;
}

void apply_override(const std::string& text, SceneFile& file) {
  const std::string head = fmt::format("{}: --set {}", file.path.string(), text);
  const std::size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0)
    throw InputError(head + ": give key=value, such as fidelity.pile_velocity=0.3");
  const std::string key = text.substr(0, equals), value = text.substr(equals + 1);
  const std::vector<KeyPart> parts = split_key(key, head);

  Message* block = &file.scene;
  std::string path;
  for (std::size_t p = 0; p < parts.size(); ++p) {
    const Descriptor& type = *block->GetDescriptor();
    const Reflection& reflection = *block->GetReflection();
    const FieldDescriptor* field = type.FindFieldByName(parts[p].name);
    if (!field)
      throw InputError(fmt::format("{}: \"{}\" is no key of {}; {}", head, parts[p].name, block_name(type),
                                   advice_for_key(parts[p].name, type)));
    path = join(path, parts[p].index < 0 ? parts[p].name : indexed(parts[p].name, parts[p].index));
    const bool is_last = p + 1 == parts.size();
    if (is_block(*field) && is_last)
      throw InputError(fmt::format("{}: {} is a block; name one of its keys: {}", head, path,
                                   fmt::join(keys_of(*field->message_type()), ", ")));
    if (!is_block(*field) && !is_last)
      throw InputError(fmt::format("{}: {} is a value and has no keys in it", head, path));

    if (!is_last) {
      if (field->is_repeated()) {
        const int size = reflection.FieldSize(*block, field);
        if (parts[p].index < 0 || parts[p].index >= size)
          throw InputError(fmt::format("{}: the scene has {} blocks {}; count them from {}[0]", head, size,
                                       parts[p].name, parts[p].name));
        block = reflection.MutableRepeatedMessage(block, field, parts[p].index);
        continue;
      }
      if (!reflection.HasField(*block, field) && adds_to_model(*field->message_type()))
        throw InputError(fmt::format("{}: the scene has no block {}; write {} {{ }} into the scene file to have one",
                                     head, path, parts[p].name));
      block = reflection.MutableMessage(block, field);
      continue;
    }

    if (field->cpp_type() == FieldDescriptor::CPPTYPE_STRING && field->is_repeated()) {
      reflection.ClearField(block, field);
      reflection.AddString(block, field, value);
    } else if (field->cpp_type() == FieldDescriptor::CPPTYPE_STRING) {
      reflection.SetString(block, field, value);
    } else {
      FirstError error;
      TextFormat::Parser parser;
      parser.RecordErrorsTo(&error);
      if (!parser.ParseFieldValueFromString(value, field, block)) {
        const std::string wanted = field->enum_type()
                                       ? fmt::format("one of {}", fmt::join(values_of(*field->enum_type()), ", "))
                                       : std::string(field->type_name());
        throw InputError(fmt::format("{}: \"{}\" is no value of {}; give {}", head, value, path, wanted));
      }
    }
  }
  std::erase_if(file.key_lines, [&](const auto& entry) { return entry.first == path; });
  file.key_lines.emplace_back(path, override_line);
}

// -------------------------------------------------------------------------------------------------------- checks

std::optional<double> number_of(const Message& block, const FieldDescriptor& field) {
  const Reflection& r = *block.GetReflection();
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return r.GetDouble(block, &field);
    case FieldDescriptor::CPPTYPE_FLOAT:
      return static_cast<double>(r.GetFloat(block, &field));
    case FieldDescriptor::CPPTYPE_INT32:
      return static_cast<double>(r.GetInt32(block, &field));
    case FieldDescriptor::CPPTYPE_UINT32:
      return static_cast<double>(r.GetUInt32(block, &field));
    case FieldDescriptor::CPPTYPE_INT64:
      return static_cast<double>(r.GetInt64(block, &field));
    case FieldDescriptor::CPPTYPE_UINT64:
      return static_cast<double>(r.GetUInt64(block, &field));
    default:
      return std::nullopt;
  }
}

// Every number that the scene gives is finite and inside its range; every required key of a block that is there is
// given.
void check_ranges(const Message& block, const std::string& prefix, const SceneFile& file) {
  const Descriptor& type = *block.GetDescriptor();
  const Reflection& reflection = *block.GetReflection();
  for (int f = 0; f < type.field_count(); ++f) {
    const FieldDescriptor& field = *type.field(f);
    const std::string key = join(prefix, field.name());
    if (is_block(field)) {
      if (field.is_repeated())
        for (int i = 0; i < reflection.FieldSize(block, &field); ++i)
          check_ranges(reflection.GetRepeatedMessage(block, &field, i), indexed(key, i), file);
      else if (reflection.HasField(block, &field))
        check_ranges(reflection.GetMessage(block, &field), key, file);
      continue;
    }
    if (field.is_repeated()) continue;  // of words
    const std::string unit = unit_of(field).empty() ? "" : fmt::format(" ({})", unit_of(field));
    if (!reflection.HasField(block, &field)) {
      if (field.options().GetExtension(scene::required))
        throw InputError(
            fmt::format("{} is missing{}: {}; it has no default, give it", file.where(key), unit, effect_of(field)));
      continue;
    }
    const std::optional<double> value = number_of(block, field);
    if (!value) continue;
    const std::string effect = effect_of(field).empty() ? "" : fmt::format(": {}", effect_of(field));
    if (!std::isfinite(*value))
      throw InputError(fmt::format("{} = {} is not finite{}{}; give a number {}", file.where(key), *value, unit, effect,
                                   range_of(field).empty() ? "" : "in " + range_of(field)));
    const bool is_low = field.options().HasExtension(scene::min) && *value < field.options().GetExtension(scene::min);
    const bool is_high = field.options().HasExtension(scene::max) && *value > field.options().GetExtension(scene::max);
    if (is_low || is_high)
      throw InputError(fmt::format("{} = {} is out of range {}{}{}; give a value inside", file.where(key), *value,
                                   range_of(field), unit, effect));
  }
}

// Mean equivalent radius of a packing in `volume`: from the count, where one is given, by
//   count * 4/3 pi R^3 = (1 - porosity) volume,
// else the scene's radius; fidelity.particle_scale multiplies either. [m]
double mean_grain_radius(const scene::Scene& s, double volume) {
  const scene::Packing& packing = s.grains().packing();
  const double radius = packing.count() > 0
                            ? std::cbrt((1 - packing.porosity()) * volume / (packing.count() * 4.0 / 3.0 * pi))
                            : packing.radius();
  return radius * s.fidelity().particle_scale();
}

void check_cylinder(const SceneFile& file) {
  const scene::CylinderInBrick& brick = file.scene.continuum().cylinder_in_brick();
  const std::string at = "continuum.cylinder_in_brick.";
  if (brick.hole_diameter() >= brick.width())
    throw InputError(fmt::format("{} = {} m does not fit into {}width = {} m; give a narrower hole or a wider brick",
                                 file.where(at + "hole_diameter"), brick.hole_diameter(), at, brick.width()));
  if (brick.hole_depth() >= brick.depth())
    throw InputError(fmt::format("{} = {} m reaches through {}depth = {} m; give a shallower hole or a deeper brick",
                                 file.where(at + "hole_depth"), brick.hole_depth(), at, brick.depth()));
  if (brick.zones_around() % 8 != 0)
    throw InputError(
        fmt::format("{} = {} is no multiple of 8, which the square outline and its symmetry need; give {} or {}",
                    file.where(at + "zones_around"), brick.zones_around(), brick.zones_around() / 8 * 8,
                    brick.zones_around() / 8 * 8 + 8));
}

void check_mesh_file(const SceneFile& file) {
  const scene::MeshFile& mesh = file.scene.continuum().mesh_file();
  if (file.scene.fidelity().mesh_refinement() != 1)
    throw InputError(
        fmt::format("{} = {}, but the zones of continuum.mesh_file are those of its file; leave the key out and "
                    "write a finer or coarser mesh",
                    file.where("fidelity.mesh_refinement"), file.scene.fidelity().mesh_refinement()));
  if (mesh.has_hole() && mesh.discrete_domain_size() == 0)
    throw InputError(
        fmt::format("{} describes the discrete domain, but discrete_domain names no group of zones; name it, "
                    "or leave out hole",
                    file.where("continuum.mesh_file.hole")));
  if (mesh.interface_size() > 0 && mesh.discrete_domain_size() > 0)
    throw InputError(fmt::format(
        "{} and discrete_domain are both given; the interface is where the zones of the discrete domain meet "
        "the others: leave out interface",
        file.where("continuum.mesh_file.interface")));
}

void check_grains(const SceneFile& file) {
  const scene::Scene& s = file.scene;
  const scene::Grains& grains = s.grains();
  if (grains.arrangement_case() == scene::Grains::ARRANGEMENT_NOT_SET && grains.grain_size() == 0)
    throw InputError(fmt::format(
        "{}: the block holds no grain; give packing {{ }}, lattice {{ }} or grain {{ }} in it, or leave out grains",
        file.where("grains")));
  if (grains.has_lattice() && grains.lattice().overlap() >= grains.lattice().radius())
    throw InputError(
        fmt::format("{} = {} m is no less than grains.lattice.radius = {} m; an overlap is a small part of a radius",
                    file.where("grains.lattice.overlap"), grains.lattice().overlap(), grains.lattice().radius()));
  if (grains.has_lattice() && grains.lattice().side_overlap() >= grains.lattice().radius())
    throw InputError(fmt::format(
        "{} = {} m is no less than grains.lattice.radius = {} m; an overlap is a small part of a radius",
        file.where("grains.lattice.side_overlap"), grains.lattice().side_overlap(), grains.lattice().radius()));
  if (!grains.has_packing()) return;

  const scene::Packing& packing = grains.packing();
  const scene::MeshFile& mesh_file = s.continuum().mesh_file();
  const char* hole = s.continuum().has_cylinder_in_brick() ? "continuum.cylinder_in_brick"
                     : mesh_file.has_hole()                ? "continuum.mesh_file.hole"
                                                           : nullptr;
  if (!packing.has_box()) {
    const bool has_walls =
        !s.has_continuum() && s.wall_size() + s.plane_size() > 0;  // dem_server looks what they enclose
    if (!hole && !has_walls)
      throw InputError(fmt::format(
          "{}: the packing has no container; give continuum.cylinder_in_brick, continuum.mesh_file.hole, or "
          "grains.packing.box, or to grains alone walls around them",
          file.where("grains.packing")));
    return;
  }
  const scene::Box& box = packing.box();
  if (hole)
    throw InputError(fmt::format("{}: {} is the container already; leave out one of the two",
                                 file.where("grains.packing.box"), hole));
  if (!packing.has_count() && !packing.has_radius())
    throw InputError(fmt::format(
        "{} = {} x {} x {} m, but neither grains.packing.count nor grains.packing.radius is given; give one",
        file.where("grains.packing.box"), box.width_x(), box.width_y(), box.fill_height()));
  if (!s.continuum().has_block()) return;
  const scene::Block& block = s.continuum().block();
  if (box.width_x() > block.width_x())
    throw InputError(
        fmt::format("{} = {} m is wider than continuum.block.width_x = {} m; grains would fall beside the block",
                    file.where("grains.packing.box.width_x"), box.width_x(), block.width_x()));
  if (box.width_y() > block.width_y())
    throw InputError(
        fmt::format("{} = {} m is wider than continuum.block.width_y = {} m; grains would fall beside the block",
                    file.where("grains.packing.box.width_y"), box.width_y(), block.width_y()));
  if (box.bottom() < block.top_z())
    throw InputError(fmt::format("{} = {} m is below continuum.block.top_z = {} m; grains would start inside the block",
                                 file.where("grains.packing.box.bottom"), box.bottom(), block.top_z()));
}

// The pile and its whole way fit into the discrete zone, with a grain's diameter to spare.
void check_pile(const SceneFile& file) {
  const scene::Scene& s = file.scene;
  const scene::Pile& pile = s.pile();
  if (!s.grains().has_packing())
    throw InputError(
        fmt::format("{}: a pile is pushed into a packing; give grains.packing, or leave out pile", file.where("pile")));
  const double final_depth = pile.embedment() + pile.penetration() * pile.diameter();  // [m]
  std::string width_key, depth_key;
  double width = 0, depth = 0, volume = 0;  // of the discrete zone [m, m, m3]
  if (s.continuum().has_cylinder_in_brick()) {
    const scene::CylinderInBrick& brick = s.continuum().cylinder_in_brick();
    width_key = "continuum.cylinder_in_brick.hole_diameter", depth_key = "continuum.cylinder_in_brick.hole_depth";
    width = brick.hole_diameter(), depth = brick.hole_depth(), volume = pi / 4 * width * width * depth;
  } else if (s.continuum().mesh_file().has_hole()) {
    const scene::Hole& hole = s.continuum().mesh_file().hole();
    width_key = "continuum.mesh_file.hole.diameter", depth_key = "continuum.mesh_file.hole.depth";
    width = hole.diameter(), depth = hole.depth(), volume = pi / 4 * width * width * depth;
  } else if (!s.grains().packing().has_box()) {
    return;  // dem_server knows what the walls enclose
  } else {
    const scene::Box& box = s.grains().packing().box();
    width_key = box.width_x() <= box.width_y() ? "grains.packing.box.width_x" : "grains.packing.box.width_y";
    depth_key = "grains.packing.box.fill_height";
    width = std::min(box.width_x(), box.width_y()), depth = box.fill_height(),
    volume = box.width_x() * box.width_y() * depth;
  }
  const double radius = mean_grain_radius(s, volume);
  if (pile.diameter() >= width - 2 * radius)
    throw InputError(fmt::format(
        "{} = {} m leaves no room for grains of radius {:.3g} m in {} = {} m; give a thinner pile or a wider zone",
        file.where("pile.diameter"), pile.diameter(), radius, width_key, width));
  if (final_depth >= depth)
    throw InputError(
        fmt::format("{} = {} m and pile.penetration = {} D (pile.diameter = {} m) bring the tip to {} m, which is not "
                    "above {} = {} m; "
                    "give less penetration or a deeper zone",
                    file.where("pile.embedment"), pile.embedment(), pile.penetration(), pile.diameter(),
                    number(final_depth), depth_key, depth));
}

// Averaged forces come half an interval late on the mean, which pumps energy into what nothing damps.
constexpr double exchange_damping = 0.3;

void check_exchange(const SceneFile& file) {
  const scene::Scene& s = file.scene;
  const std::uint32_t interval = s.fidelity().exchange_interval();
  if (interval < 2) return;
  const std::string where = fmt::format("{} = {}", file.where("fidelity.exchange_interval"), interval);
  if (s.continuum().dynamic())
    throw InputError(
        fmt::format("{}: forces averaged over several steps change waves, but continuum.dynamic is true; "
                    "leave one of them out",
                    where));
  const auto damps = [&](const char* key, double damping) {
    if (damping < exchange_damping)
      throw InputError(fmt::format(
          "{}: forces that are the mean of several steps come late and take damping away; {} = {} would let "
          "oscillations grow: give {} or more, or exchange at each step",
          where, file.where(key), damping, exchange_damping));
  };
  damps("run.damping", s.run().damping()), damps("run.continuum_damping", s.run().continuum_damping());
  if (s.apply().max_steps() > 0) damps("apply.damping", s.apply().damping());
}

void check_consistency(const SceneFile& file) {
  const scene::Scene& s = file.scene;
  if (!s.has_continuum() && !s.has_grains())
    throw InputError(
        fmt::format("{}: the scene models nothing; give continuum {{ }}, grains {{ }} or both", file.path.string()));
  if (s.has_continuum() && s.continuum().mesh_case() == scene::Continuum::MESH_NOT_SET)
    throw InputError(fmt::format(
        "{}: the ground has no shape; give cylinder_in_brick {{ }} or block {{ }} in it, or mesh_file {{ }}",
        file.where("continuum")));
  if (s.continuum().has_cylinder_in_brick()) check_cylinder(file);
  if (s.continuum().has_mesh_file()) check_mesh_file(file);
  if (s.has_grains()) check_grains(file);
  if (s.has_pile()) check_pile(file);
  check_exchange(file);
  if (s.has_packet() && s.has_grains() && s.apply().max_steps() > 0)
    throw InputError(
        fmt::format("{}: the packet starts with the stage Apply, which damps what moves; give apply.max_steps = 0 (now "
                    "{}), or leave out the packet",
                    file.where("packet"), s.apply().max_steps()));
  for (int i = 0; i < s.plane_size(); ++i) {
    const scene::Point& normal = s.plane(i).normal();
    if (normal.x() == 0 && normal.y() == 0 && normal.z() == 0)
      throw InputError(
          fmt::format("{} = (0, 0, 0) is no direction; give one that points to the grains, such as {{ z: 1 }}",
                      file.where(indexed("plane", i) + ".normal")));
  }
}

std::string digest_of(const scene::Scene& s) {
  std::string bytes;
  {
    google::protobuf::io::StringOutputStream stream(&bytes);
    google::protobuf::io::CodedOutputStream coded(&stream);
    coded.SetSerializationDeterministic(true);
    s.SerializeToCodedStream(&coded);
  }
  Hash hash;
  hash.add(std::string_view(bytes));
  return fmt::format("{:016x}", hash.value());
}

std::string default_of(const FieldDescriptor& field) {
  if (!field.has_default_value()) return "";
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return number(field.default_value_double());
    case FieldDescriptor::CPPTYPE_UINT32:
      return fmt::format("{}", field.default_value_uint32());
    case FieldDescriptor::CPPTYPE_UINT64:
      return fmt::format("{}", field.default_value_uint64());
    case FieldDescriptor::CPPTYPE_INT32:
      return fmt::format("{}", field.default_value_int32());
    case FieldDescriptor::CPPTYPE_BOOL:
      return field.default_value_bool() ? "true" : "false";
    case FieldDescriptor::CPPTYPE_ENUM:
      return field.default_value_enum()->name();
    case FieldDescriptor::CPPTYPE_STRING:
      return fmt::format("\"{}\"", field.default_value_string());
    default:
      return "";
  }
}

std::string effect_with_choices(const FieldDescriptor& field) {
  std::vector<std::string> parts;
  if (!effect_of(field).empty()) parts.push_back(effect_of(field));
  if (field.enum_type()) parts.push_back(fmt::format("one of {}", fmt::join(values_of(*field.enum_type()), ", ")));
  if (field.real_containing_oneof()) {
    std::vector<std::string> members;
    const auto& oneof = *field.real_containing_oneof();
    for (int i = 0; i < oneof.field_count(); ++i) members.push_back(oneof.field(i)->name());
    parts.push_back(fmt::format("at most one of {}", fmt::join(members, ", ")));
  }
  if (field.is_repeated()) parts.push_back("any number of them");
  if (field.options().GetExtension(scene::required)) parts.push_back("has no default: required");
  return fmt::format("{}", fmt::join(parts, "; "));
}

}  // namespace

std::string SceneFile::where(const std::string& key) const {
  // A key that the scene leaves to its default stands in the nearest block above it.
  for (std::string at = key;; at.resize(at.rfind('.'))) {
    for (const auto& [known, line] : key_lines)
      if (known == at)
        return line == override_line ? fmt::format("{} (--set): {}", path.string(), key)
                                     : fmt::format("{}:{}: {}", path.string(), line, key);
    if (at.find('.') == std::string::npos) break;
  }
  return fmt::format("{}: {}", path.string(), key);
}

std::filesystem::path SceneFile::resolve(const std::string& file) const {
  const std::filesystem::path folder = std::filesystem::is_directory(path) ? path : path.parent_path();
  return folder / file;
}

SceneFile parse_scene(const std::string& text, const std::filesystem::path& name,
                      const std::vector<std::string>& overrides) {
  SceneFile file;
  file.path = name;
  FirstError error;
  TextFormat::ParseInfoTree tree;
  TextFormat::Parser parser;
  parser.RecordErrorsTo(&error);
  parser.WriteLocationsTo(&tree);
  if (!parser.ParseFromString(text, &file.scene) || error.is_set()) throw InputError(error.text(name.string(), text));
  collect_lines(file.scene, tree, "", file.key_lines);
  for (const std::string& text_of_override : overrides) apply_override(text_of_override, file);
  check_ranges(file.scene, "", file);
  check_consistency(file);
  file.digest = digest_of(file.scene);
  return file;
}

SceneFile read_scene(const std::filesystem::path& path, const std::vector<std::string>& overrides) {
  std::error_code ignored;
  const std::filesystem::path file = std::filesystem::is_directory(path, ignored) ? path / "scene.txt" : path;
  errno = 0;
  std::ifstream stream(file, std::ios::binary);
  std::stringstream text;
  if (stream) text << stream.rdbuf();
  if (!stream || stream.bad())
    throw IoError(fmt::format("{}: cannot read the scene: {}; give a scene file, or a folder that holds scene.txt",
                              file.string(), errno ? std::strerror(errno) : "read error"));
  return parse_scene(text.str(), file, overrides);
}

std::string list_keys() {
  struct Row {
    std::string key, type, default_value, unit, range, effect;
  };
  std::vector<Row> rows;
  walk_schema(*scene::Scene::descriptor(), "", 0, [&](const FieldDescriptor& field, const std::string&, int depth) {
    const std::string indent(2 * static_cast<std::size_t>(depth), ' ');
    rows.push_back({indent + field.name() + (is_block(field) ? " { }" : ""),
                    is_block(field) ? "block" : field.type_name(), default_of(field), unit_of(field), range_of(field),
                    effect_with_choices(field)});
  });
  Row heading{"key", "type", "default", "unit", "range", "effect"};
  rows.insert(rows.begin(), heading);
  const auto width = [&](std::string Row::*column) {
    std::size_t widest = 0;
    for (const Row& row : rows) widest = std::max(widest, (row.*column).size());
    return widest;
  };
  const std::size_t key = width(&Row::key), type = width(&Row::type), value = width(&Row::default_value),
                    unit = width(&Row::unit), range = width(&Row::range);
  std::string text;
  for (const Row& row : rows) {
    std::string line = fmt::format("{:<{}}  {:<{}}  {:>{}}  {:<{}}  {:<{}}  {}", row.key, key, row.type, type,
                                   row.default_value, value, row.unit, unit, row.range, range, row.effect);
    line.erase(line.find_last_not_of(' ') + 1);
    text += line + "\n";
  }
  return text;
}

std::string lockstep_version() { return LOCKSTEP_VERSION; }

}  // namespace lockstep
