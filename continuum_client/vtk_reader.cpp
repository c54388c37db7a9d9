// VTK's unstructured grids (VTK file formats, "Simple Legacy Formats" and "XML Formats"): .vtk of versions 1 to 4 and 5.1,
// ASCII and binary (big-endian), and .vtu with ASCII, base64 and raw data, not compressed, of one piece.
//
// Zones are cells of type 12 (hexahedron) and 11 (voxel); cells of fewer dimensions do not count. A zone's group answers to its
// value in the cell array that the scene names. The file has no numbers for nodes and cells: they are counted from 0, as
// ParaView does.
#include <fmt/ranges.h>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "continuum_client/mesh_input.hpp"

namespace lockstep::continuum {
namespace {

constexpr int voxel = 11, hexahedron = 12;
const std::map<int, const char*> solid_cells = {{10, "tetrahedron"},
                                                {13, "wedge"},
                                                {14, "pyramid"},
                                                {15, "pentagonal prism"},
                                                {16, "hexagonal prism"},
                                                {24, "10-node tetrahedron"},
                                                {25, "20-node hexahedron"},
                                                {26, "15-node wedge"},
                                                {27, "13-node pyramid"},
                                                {29, "27-node hexahedron"},
                                                {32, "18-node wedge"},
                                                {33, "24-node hexahedron"},
                                                {42, "polyhedron"},
                                                {71, "Lagrange tetrahedron"},
                                                {72, "Lagrange hexahedron"},
                                                {73, "Lagrange wedge"},
                                                {78, "Bezier tetrahedron"},
                                                {79, "Bezier hexahedron"}};

// What either form of file gives.
struct Cells {
  std::vector<double> coordinates;  // three a point
  std::vector<std::int64_t> begin;  // per cell, and one more, into nodes
  std::vector<std::int64_t> nodes;
  std::vector<std::int64_t> type;            // per cell
  std::optional<std::vector<double>> group;  // per cell
  std::vector<std::string> arrays;           // names of the cell arrays
};

FileMesh mesh_of(const Cells& cells, const std::string& name, const std::string& cell_array) {
  FileMesh mesh;
  mesh.cell_arrays = cells.arrays;
  const std::size_t points = cells.coordinates.size() / 3;
  for (std::size_t i = 0; i < points; ++i) {
    const Vec3 x(cells.coordinates[3 * i], cells.coordinates[3 * i + 1], cells.coordinates[3 * i + 2]);
    if (!x.allFinite())
      throw InputError(
          fmt::format("{}: point {} lies at ({}, {}, {}); coordinates must be finite", name, i, x.x(), x.y(), x.z()));
    mesh.node.push_back(x), mesh.node_number.push_back(static_cast<std::int64_t>(i));
  }
  if (cells.begin.size() != cells.type.size() + 1)
    throw InputError(fmt::format("{} has {} cells and {} cell types; it is damaged: write it anew", name,
                                 cells.begin.size() - 1, cells.type.size()));
  if (cells.group && cells.group->size() != cells.type.size())
    throw InputError(fmt::format("{}: its cell array \"{}\" has {} values for {} cells; give one value a cell", name,
                                 cell_array, cells.group->size(), cells.type.size()));
  std::map<std::int64_t, std::int32_t> group_of;
  std::set<std::int64_t> other_types;
  for (std::size_t c = 0; c < cells.type.size(); ++c) {
    const std::int64_t begin = cells.begin[c], end = cells.begin[c + 1];
    if (begin < 0 || end < begin || end > static_cast<std::int64_t>(cells.nodes.size()))
      throw InputError(
          fmt::format("{}: cell {} has the places {} to {} of {} in the list of points; the file is damaged: "
                      "write it anew",
                      name, c, begin, end, cells.nodes.size()));
    const auto type = cells.type[c];
    if (const auto solid = solid_cells.find(static_cast<int>(type)); solid != solid_cells.end())
      throw InputError(
          fmt::format("{}: cell {} is a {}; zones are 8-node hexahedra (types 12 and 11): mesh the volume with "
                      "those alone",
                      name, c, solid->second));
    if (type != hexahedron && type != voxel) {
      other_types.insert(type);
      continue;
    }
    if (end - begin != 8)
      throw InputError(fmt::format("{}: cell {}, a hexahedron, has {} points instead of 8", name, c, end - begin));
    FileMesh::Zone zone{{}, static_cast<std::int64_t>(c), 0};
    for (int a = 0; a < 8; ++a) {
      // A voxel's points run along x, then y, then z.
      const int from = type == voxel && (a == 2 || a == 3 || a == 6 || a == 7) ? a ^ 1 : a;
      const std::int64_t node = cells.nodes[static_cast<std::size_t>(begin + from)];
      if (node < 0 || node >= static_cast<std::int64_t>(points))
        throw InputError(fmt::format("{}: cell {} names point {}, but the file has {} of them, from 0; write it anew",
                                     name, c, node, points));
      zone.node[a] = static_cast<std::int32_t>(node);
    }
    if (cells.group) {
      const double value = (*cells.group)[c];
      constexpr double largest_group = 1e15;
      if (!(std::abs(value) <= largest_group) || value != std::round(value))
        throw InputError(fmt::format("{}: cell {} has {} in the cell array \"{}\"; groups are whole numbers", name, c,
                                     value, cell_array));
      const auto number = static_cast<std::int64_t>(value);
      const auto [found, is_new] = group_of.try_emplace(number, static_cast<std::int32_t>(mesh.groups.size()));
      if (is_new) mesh.groups.push_back({fmt::format("{}", number)});
      zone.group = found->second;
    }
    mesh.zone.push_back(zone);
  }
  if (mesh.zone.empty())
    throw InputError(fmt::format("{} holds no hexahedra ({}); mesh a volume with 8-node hexahedra, type 12", name,
                                 other_types.empty()
                                     ? "and no other cells"
                                     : fmt::format("but cells of type {}", fmt::join(other_types, ", "))));
  return mesh;
}

// -------------------------------------------------------------------------------------------------------- legacy

class LegacyReader {
 public:
  LegacyReader(const std::string& bytes, const std::string& name, const std::string& cell_array)
      : in_(bytes, name), name_(name), cell_array_(cell_array) {}

  FileMesh read() {
    in_.is_at_end();
    const std::string_view head = in_.line();
    in_.line();  // the title
    const std::string form(in_.word());
    if (form != "ASCII" && form != "BINARY") in_.fail("ASCII or BINARY is due in the third line of a VTK file");
    is_binary_ = form == "BINARY";
    if (in_.word() != "DATASET" || in_.word() != "UNSTRUCTURED_GRID")
      in_.fail(
          "DATASET UNSTRUCTURED_GRID is due; write the mesh as an unstructured grid (in ParaView: Append Datasets)");
    while (!in_.is_at_end()) section();
    if (cells_.begin.empty() || cells_.type.empty())
      throw InputError(fmt::format("{} has no {}; it is cut short: write or copy it anew", name_,
                                   cells_.begin.empty() ? "CELLS" : "CELL_TYPES"));
    FileMesh mesh = mesh_of(cells_, name_, cell_array_);
    mesh.what = fmt::format("VTK legacy {}, {}", head.substr(std::min<std::size_t>(head.size(), 23)), form);
    return mesh;
  }

 private:
  std::int64_t whole(const char* what) { return in_.whole(what); }

  // `count` numbers of a type that the file names.
  template <class To>
  std::vector<To> numbers(std::size_t count, const std::string& type, const char* what) {
    std::vector<To> values;
    const auto read = [&]<class From>(From) {
      if (is_binary_)
        in_.demand(count, sizeof(From), what);
      else
        in_.count(static_cast<std::int64_t>(count), 1, 1, what);
      in_.is_binary = is_binary_, in_.is_swapped = std::endian::native == std::endian::little;
      values.reserve(count);
      for (std::size_t i = 0; i < count; ++i) values.push_back(static_cast<To>(in_.value<From>(what)));
      in_.is_binary = false;
    };
    if (is_binary_) in_.line();
    if (type == "double")
      read(double{});
    else if (type == "float")
      read(float{});
    else if (type == "int" || type == "vtkIdType")
      read(std::int32_t{});
    else if (type == "unsigned_int")
      read(std::uint32_t{});
    else if (type == "long" || type == "vtktypeint64")
      read(std::int64_t{});
    else if (type == "unsigned_long" || type == "vtktypeuint64")
      read(std::uint64_t{});
    else if (type == "short")
      read(std::int16_t{});
    else if (type == "unsigned_short")
      read(std::uint16_t{});
    else if (type == "char" || type == "signed_char")
      read(std::int8_t{});
    else if (type == "unsigned_char")
      read(std::uint8_t{});
    else
      in_.fail(fmt::format("numbers of type \"{}\"; this reads float, double and whole numbers", type.substr(0, 20)));
    return values;
  }

  std::size_t count(const char* what) { return in_.count(in_.whole(what), 0, 0, what); }
  std::string word() { return std::string(in_.word().substr(0, 200)); }

  void section() {
    const std::string name = word();
    if (name == "POINTS") {
      const std::size_t points = count("points");
      cells_.coordinates = numbers<double>(3 * points, word(), "coordinates");
    } else if (name == "CELLS") {
      cells();
    } else if (name == "CELL_TYPES") {
      const std::size_t types = count("cell types");
      cells_.type = numbers<std::int64_t>(types, "int", "cell types");
    } else if (name == "CELL_DATA" || name == "POINT_DATA") {
      is_cell_data_ = name == "CELL_DATA";
      tuples_ = count("values");
    } else if (name == "FIELD") {
      field();
    } else if (name == "METADATA") {
      in_.line();
      while (!in_.is_at_end_of_block()) in_.line();
    } else if (name == "SCALARS") {
      const std::string array = word(), type = word();
      std::string next = word();
      std::size_t components = 1;
      if (next != "LOOKUP_TABLE") {
        components = next == "1" ? 1 : next == "2" ? 2 : next == "3" ? 3 : next == "4" ? 4 : 0;
        if (components == 0) in_.fail("a number of components from 1 to 4, or LOOKUP_TABLE, is due");
        next = word();
      }
      if (next != "LOOKUP_TABLE") in_.fail("LOOKUP_TABLE is due");
      in_.word();
      take(array, components, type);
    } else if (name == "VECTORS" || name == "NORMALS" || name == "TENSORS") {
      const std::string array = word(), type = word();
      take(array, name == "TENSORS" ? 9 : 3, type);
    } else if (name == "GLOBAL_IDS" || name == "PEDIGREE_IDS") {
      const std::string array = word(), type = word();
      take(array, 1, type);
    } else {
      in_.fail(fmt::format(
          "\"{}\" is no section that this reads; write the mesh with POINTS, CELLS, CELL_TYPES and CELL_DATA alone",
          name.substr(0, 20)));
    }
  }

  void cells() {
    const std::size_t first = count("cells"), second = count("numbers of cells");
    // Version 5: `first` offsets, one more than cells, and `second` points. Before: `first` cells, each with its count before
    // its points, `second` numbers in all.
    const std::size_t here = in_.at();
    if (in_.word() == "OFFSETS") {
      const std::string offset_type = word();
      cells_.begin = numbers<std::int64_t>(first, offset_type, "offsets of cells");
      if (in_.word() != "CONNECTIVITY") in_.fail("CONNECTIVITY is due");
      const std::string type = word();
      cells_.nodes = numbers<std::int64_t>(second, type, "points of cells");
      if (cells_.begin.empty()) in_.fail("CELLS needs one offset more than cells");
      return;
    }
    in_.go_to(here);
    const std::vector<std::int64_t> all = numbers<std::int64_t>(second, "int", "points of cells");
    cells_.begin = {0};
    for (std::size_t at = 0; at < all.size();) {
      const std::int64_t points = all[at++];
      if (points < 0 || static_cast<std::size_t>(points) > all.size() - at)
        in_.fail(fmt::format("a cell of {} points where {} numbers are left; the file is damaged: write it anew",
                             points, all.size() - at));
      cells_.nodes.insert(cells_.nodes.end(), all.begin() + static_cast<std::ptrdiff_t>(at),
                          all.begin() + static_cast<std::ptrdiff_t>(at) + static_cast<std::ptrdiff_t>(points));
      at += static_cast<std::size_t>(points);
      cells_.begin.push_back(static_cast<std::int64_t>(cells_.nodes.size()));
    }
    if (cells_.begin.size() != first + 1)
      in_.fail(
          fmt::format("{} cells are announced and {} are there; the file is damaged", first, cells_.begin.size() - 1));
  }

  void field() {
    in_.word();  // its name
    const std::size_t arrays = count("arrays");
    for (std::size_t i = 0; i < arrays && !in_.is_at_end(); ++i) {
      const std::string array = word();
      if (array == "METADATA") {
        in_.line();
        while (!in_.is_at_end_of_block()) in_.line();
        --i;
        continue;
      }
      const std::size_t components = count("components"), tuples = count("values");
      const std::string type = word();
      if (type == "string") in_.fail(fmt::format("array \"{}\" holds words; write the mesh without it", array));
      take(array, components, type, tuples);
    }
  }

  void take(const std::string& array, std::size_t components, const std::string& type,
            std::optional<std::size_t> tuples = {}) {
    const std::size_t n = tuples.value_or(tuples_);
    if (components > 0 && n > in_.left() / components) in_.demand(n, components, "values");
    std::vector<double> values = numbers<double>(n * components, type, "values");
    if (!is_cell_data_) return;
    cells_.arrays.push_back(array);
    if (array == cell_array_ && components == 1) cells_.group = std::move(values);
  }

  MeshCursor in_;
  const std::string& name_;
  const std::string& cell_array_;
  bool is_binary_ = false, is_cell_data_ = false;
  std::size_t tuples_ = 0;
  Cells cells_;
};

// ----------------------------------------------------------------------------------------------------------- XML

struct Tag {
  std::string name;  // "/Points" where it closes
  std::map<std::string, std::string> attributes;
  bool is_empty = false;  // <.../>
};

class XmlReader {
 public:
  XmlReader(const std::string& bytes, const std::string& name, const std::string& cell_array)
      : bytes_(bytes), name_(name), cell_array_(cell_array) {}

  FileMesh read() {
    const std::size_t appended = bytes_.find("<AppendedData");
    markup_end_ = std::min(appended, bytes_.size());
    if (appended != std::string::npos) {
      std::size_t at = appended;
      const Tag tag = next_tag(at, bytes_.size());
      appended_is_raw_ = attribute(tag, "encoding") == "raw";
      const std::size_t mark = bytes_.find('_', at);
      if (mark == std::string::npos) fail(at, "AppendedData without its mark _; the file is cut short");
      appended_ = mark + 1;
    }
    std::string section;  // Points, Cells, CellData: where arrays count
    int pieces = 0;
    bool is_closed = false, is_grid = false;
    for (std::size_t at = 0; bytes_.find('<', at) < markup_end_;) {
      const Tag tag = next_tag(at, markup_end_);
      if (tag.name == "VTKFile") {
        head(tag, at);
        is_grid = true;
      } else if (tag.name == "Piece") {
        if (++pieces > 1) fail(at, "a second Piece; write the mesh as one piece (in ParaView: Merge Blocks)");
        point_count_ = size(tag, "NumberOfPoints", at), cell_count_ = size(tag, "NumberOfCells", at);
      } else if (tag.name == "Points" || tag.name == "Cells" || tag.name == "CellData" || tag.name == "PointData" ||
                 tag.name == "FieldData") {
        section = tag.is_empty ? "" : tag.name;
      } else if (tag.name == "/" + section) {
        section.clear();
      } else if (tag.name == "DataArray") {
        if (!is_grid) fail(at, "a DataArray outside VTKFile");
        array(section, tag, at);
      } else if (tag.name == "/VTKFile") {
        is_closed = true;
      }
    }
    if (!is_grid || pieces == 0)
      throw InputError(fmt::format("{} has no UnstructuredGrid with a Piece; write it anew", name_));
    if (!is_closed && appended == std::string::npos)
      throw InputError(fmt::format("{} ends before </VTKFile>: it is cut short; write or copy it anew", name_));
    if (cells_.coordinates.size() != 3 * point_count_ || cells_.type.size() != cell_count_)
      throw InputError(
          fmt::format("{} announces {} points and {} cells but holds {} and {}; it is damaged: write it anew", name_,
                      point_count_, cell_count_, cells_.coordinates.size() / 3, cells_.type.size()));
    FileMesh mesh = mesh_of(cells_, name_, cell_array_);
    mesh.what = "VTK XML";
    return mesh;
  }

 private:
  [[noreturn]] void fail(std::size_t at, const std::string& text) const {
    throw InputError(fmt::format("{}, byte {}: {}", name_, at, text));
  }

  static std::string attribute(const Tag& tag, const std::string& key) {
    const auto found = tag.attributes.find(key);
    return found == tag.attributes.end() ? std::string() : found->second;
  }

  std::size_t size(const Tag& tag, const char* key, std::size_t at) const {
    const std::string text = attribute(tag, key);
    MeshCursor cursor(text, name_);
    const std::int64_t value = cursor.whole(key);
    // A byte at least for each of them.
    if (value < 0 || static_cast<std::size_t>(value) > bytes_.size())
      fail(at,
           fmt::format("{} is {}, but the file has {} bytes; it is cut short or damaged", key, value, bytes_.size()));
    return static_cast<std::size_t>(value);
  }

  // The tag that begins at the first < from `at` on; `at` moves behind it. Comments and <?xml ...?> come as tags too.
  Tag next_tag(std::size_t& at, std::size_t end) const {
    const std::size_t begin = bytes_.find('<', at);
    if (begin >= end) fail(at, "a tag is due; the file is cut short");
    const bool is_comment = bytes_.compare(begin, 4, "<!--") == 0;
    const std::size_t close = is_comment ? bytes_.find("-->", begin) : bytes_.find('>', begin);
    if (close >= end) fail(begin, "a tag without its end; the file is cut short");
    Tag tag;
    at = close + (is_comment ? 3 : 1);
    if (is_comment) return tag;
    std::string_view text = std::string_view(bytes_).substr(begin + 1, close - begin - 1);
    if (!text.empty() && text.back() == '/') tag.is_empty = true, text.remove_suffix(1);
    const std::size_t name_end = std::min(text.find_first_of(" \t\r\n"), text.size());
    tag.name = text.substr(0, name_end);
    for (text = text.substr(name_end);;) {
      const std::size_t equals = text.find('=');
      if (equals == std::string_view::npos) break;
      std::string_view key = text.substr(0, equals);
      while (!key.empty() && key.find_first_of(" \t\r\n") == 0) key.remove_prefix(1);
      while (!key.empty() && key.find_last_of(" \t\r\n") == key.size() - 1) key.remove_suffix(1);
      const std::size_t open = text.find_first_of("\"'", equals);
      if (open == std::string_view::npos) break;
      const std::size_t last = text.find(text[open], open + 1);
      if (last == std::string_view::npos) break;
      tag.attributes[std::string(key)] = text.substr(open + 1, last - open - 1);
      text = text.substr(last + 1);
    }
    return tag;
  }

  void head(const Tag& tag, std::size_t at) {
    if (attribute(tag, "type") != "UnstructuredGrid")
      fail(at, fmt::format("a VTK file of type \"{}\"; write an UnstructuredGrid (.vtu)",
                           attribute(tag, "type").substr(0, 20)));
    if (!attribute(tag, "compressor").empty())
      fail(at,
           "compressed data; write it without compression (in ParaView: Compressor Type None; in meshio: "
           "compression=None)");
    const std::string order = attribute(tag, "byte_order");
    is_swapped_ = (order == "BigEndian") != (std::endian::native == std::endian::big);
    header_bytes_ = attribute(tag, "header_type") == "UInt64" ? 8 : 4;
  }

  void array(const std::string& section, const Tag& tag, std::size_t& at) {
    const std::string name = attribute(tag, "Name");
    const bool is_points = section == "Points";
    const bool is_wanted = is_points || section == "Cells" || (section == "CellData" && name == cell_array_);
    if (section == "CellData") cells_.arrays.push_back(name);
    const std::string format = attribute(tag, "format");
    std::string_view content;
    if (!tag.is_empty) {
      const std::size_t close = bytes_.find("</DataArray>", at);
      if (close >= markup_end_) fail(at, fmt::format("array \"{}\" has no end; the file is cut short", name));
      content = std::string_view(bytes_).substr(at, close - at);
      at = close;
    }
    if (!is_wanted) return;
    std::string decoded;
    if (format == "appended") {
      decoded = appended(tag, at);
      content = decoded;
    } else if (format == "binary") {
      decoded = block_of_base64(content, at);
      content = decoded;
    } else if (format != "ascii") {
      fail(at, fmt::format("array \"{}\" has the format \"{}\"; this reads ascii, binary and appended", name,
                           format.substr(0, 20)));
    }
    const bool is_text = format == "ascii";
    const std::string type = attribute(tag, "type");
    if (is_points)
      cells_.coordinates = numbers<double>(content, is_text, type);
    else if (name == "connectivity")
      cells_.nodes = numbers<std::int64_t>(content, is_text, type);
    else if (name == "types")
      cells_.type = numbers<std::int64_t>(content, is_text, type);
    else if (name == "offsets") {
      cells_.begin = numbers<std::int64_t>(content, is_text, type);
      cells_.begin.insert(cells_.begin.begin(), 0);
    } else if (section == "CellData") {
      cells_.group = numbers<double>(content, is_text, type);
    }
  }

  template <class To>
  std::vector<To> numbers(std::string_view content, bool is_text, const std::string& type) const {
    MeshCursor in(content, name_);
    in.is_binary = !is_text, in.is_swapped = is_swapped_;
    std::vector<To> values;
    const auto read = [&]<class From>(From) {
      if (!is_text && content.size() % sizeof(From) != 0)
        in.fail(fmt::format("{} bytes are no whole number of {}", content.size(), type));
      while (is_text ? !in.is_at_end() : in.left() > 0)
        values.push_back(static_cast<To>(in.value<From>("a number of a DataArray")));
    };
    if (type == "Float64")
      read(double{});
    else if (type == "Float32")
      read(float{});
    else if (type == "Int64")
      read(std::int64_t{});
    else if (type == "UInt64")
      read(std::uint64_t{});
    else if (type == "Int32")
      read(std::int32_t{});
    else if (type == "UInt32")
      read(std::uint32_t{});
    else if (type == "Int16")
      read(std::int16_t{});
    else if (type == "UInt16")
      read(std::uint16_t{});
    else if (type == "Int8")
      read(std::int8_t{});
    else if (type == "UInt8")
      read(std::uint8_t{});
    else
      in.fail(
          fmt::format("a DataArray of type \"{}\"; this reads Float64, Float32 and whole numbers", type.substr(0, 20)));
    return values;
  }

  std::string appended(const Tag& tag, std::size_t at) const {
    const std::string text = attribute(tag, "offset");
    MeshCursor cursor(text, name_);
    const std::int64_t offset = cursor.whole("an array's offset");
    if (appended_ == 0) fail(at, "an appended array, but the file has no AppendedData; it is cut short");
    if (offset < 0 || static_cast<std::size_t>(offset) > bytes_.size() - appended_)
      fail(at, fmt::format("an array at offset {} of {} bytes of AppendedData; the file is cut short", offset,
                           bytes_.size() - appended_));
    const std::size_t begin = appended_ + static_cast<std::size_t>(offset);
    const std::string_view rest = std::string_view(bytes_).substr(begin);
    if (!appended_is_raw_) return block_of_base64(rest, begin);
    return std::string(sized_block(rest, begin));
  }

  // What stands behind the number of its bytes.
  std::string_view sized_block(std::string_view data, std::size_t at) const {
    MeshCursor in(data, name_);
    in.is_binary = true, in.is_swapped = is_swapped_;
    const std::uint64_t size = header_bytes_ == 8 ? in.value<std::uint64_t>("the size of an array")
                                                  : in.value<std::uint32_t>("the size of an array");
    if (size > in.left())
      fail(at, fmt::format("an array of {} bytes where {} are left; the file is cut short", size, in.left()));
    return in.rest().substr(0, size);
  }

  // Letters up to the first that is none of base64. Head and data are one run, or each padded for itself.
  std::string block_of_base64(std::string_view letters, std::size_t at) const {
    std::string bytes;
    std::uint32_t bits = 0;
    int count = 0;
    std::size_t wanted = std::string::npos;
    for (const char c : letters) {
      if (c == ' ' || c == '\t' || c == '\r' || c == '\n') continue;
      const int six = c >= 'A' && c <= 'Z'   ? c - 'A'
                      : c >= 'a' && c <= 'z' ? c - 'a' + 26
                      : c >= '0' && c <= '9' ? c - '0' + 52
                      : c == '+'             ? 62
                      : c == '/'             ? 63
                                             : -1;
      if (c == '=') {
        bits = 0, count = 0;  // what follows begins a group of its own
        continue;
      }
      if (six < 0) break;
      bits = (bits << 6 | static_cast<std::uint32_t>(six)) & 0xffffffu;
      if (++count % 4 == 1) continue;
      bytes += static_cast<char>(bits >> (count % 4 == 2 ? 4 : count % 4 == 3 ? 2 : 0) & 0xff);
      if (bytes.size() == header_bytes_) {
        MeshCursor head(bytes, name_);
        head.is_binary = true, head.is_swapped = is_swapped_;
        const std::uint64_t size =
            header_bytes_ == 8 ? head.value<std::uint64_t>("a size") : head.value<std::uint32_t>("a size");
        if (size > letters.size())
          fail(at, fmt::format("an array of {} bytes in {} letters; the file is cut short", size, letters.size()));
        wanted = header_bytes_ + size;
      }
      if (bytes.size() == wanted) break;
    }
    return std::string(sized_block(bytes, at));
  }

  const std::string& bytes_;
  const std::string& name_;
  const std::string& cell_array_;
  std::size_t markup_end_ = 0, appended_ = 0, point_count_ = 0, cell_count_ = 0;
  std::size_t header_bytes_ = 4;
  bool appended_is_raw_ = false, is_swapped_ = false;
  Cells cells_;
};

}  // namespace

FileMesh read_vtk(const std::string& bytes, const std::string& name, const std::string& cell_array) {
  const bool is_legacy = bytes.find("# vtk") < bytes.find('<');
  return is_legacy ? LegacyReader(bytes, name, cell_array).read() : XmlReader(bytes, name, cell_array).read();
}

}  // namespace lockstep::continuum
