#include "common/results.hpp"

#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstring>

#include "common/checks.hpp"

namespace lockstep {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "the VTK files are marked little-endian");
static_assert(sizeof(Vec3) == 3 * sizeof(double), "points are written as they lie in memory");

// -------------------------------------------------------------------------------------------------------- files

std::string remedy(int error) {
  switch (error) {
    case ENOSPC:
    case EDQUOT:
      return "free some space there, or choose a folder on another disk";
    case EACCES:
    case EPERM:
    case EROFS:
      return "choose a folder that you may write to";
    case EISDIR:
      return "a folder has that name; move it away, or choose another place";
    case EEXIST:
    case ENOTDIR:
      return "a file has the name of that folder; move it away, or choose another place";
    case ENOENT:
      return "make its folder first, or choose another place";
    default:
      return "choose another place";
  }
}

[[noreturn]] void fail(const fs::path& path, const std::string& what, int error) {
  throw IoError(fmt::format("{}: cannot {}: {}; {}", path.string(), what, std::strerror(error), remedy(error)));
}

struct Closer {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, Closer>;

void write_and_close(const fs::path& path, const std::string& content) {
  File file(std::fopen(path.c_str(), "wb"));
  if (!file) fail(path, "open the file", errno);
  if (std::fwrite(content.data(), 1, content.size(), file.get()) != content.size()) fail(path, "write", errno);
  // What fwrite kept in its buffer meets a full disk only here.
  if (std::fflush(file.get()) != 0) fail(path, "write", errno);
  if (std::fclose(file.release()) != 0) fail(path, "write", errno);
}

void require_finite(double value, const std::string& place) {
  if (!std::isfinite(value))
    throw NumericalError(
        fmt::format("{}: {} is not finite, and no result file holds such a value; the run has become unstable: "
                    "lower fidelity.step_fraction",
                    place, value));
}

// ---------------------------------------------------------------------------------------------------------- VTK

std::string base64(std::span<const unsigned char> bytes) {
  static constexpr char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t count = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = 0;  // three bytes, the first one highest, as four groups of six bits
    for (std::size_t j = 0; j < 3; ++j) group = group << 8 | (j < count ? bytes[i + j] : 0u);
    for (std::size_t j = 0; j < 4; ++j) text += j <= count ? letters[group >> (18 - 6 * j) & 63u] : '=';
  }
  return text;
}

std::string xml_escaped(const std::string& text) {
  std::string out;
  for (char c : text) switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  return out;
}

// One <DataArray>: the byte count as UInt64 and the values, encoded together (VTK's inline binary format,
// uncompressed).
template <class T>
std::string data_array(const std::string& name, const char* type, int components, std::span<const T> values) {
  const std::uint64_t size = values.size_bytes();
  std::vector<unsigned char> bytes(sizeof size + size);
  std::memcpy(bytes.data(), &size, sizeof size);
  if (size > 0) std::memcpy(bytes.data() + sizeof size, values.data(), size);
  return fmt::format(
      "<DataArray type=\"{}\" Name=\"{}\" NumberOfComponents=\"{}\" format=\"binary\">\n{}\n</DataArray>\n", type,
      xml_escaped(name), components, base64(bytes));
}

std::string points_section(const fs::path& path, const Vec3s& points) {
  for (std::size_t i = 0; i < points.size(); ++i)
    for (int c = 0; c < 3; ++c)
      require_finite(points[i][c], fmt::format("{}: point {} component {}", path.string(), i, c));
  const double* first = points.empty() ? nullptr : points.front().data();
  return fmt::format("<Points>\n{}</Points>\n",
                     data_array("Points", "Float64", 3, std::span<const double>(first, 3 * points.size())));
}

// <PointData> or <CellData> with all fields; `count` entries each.
std::string data_section(const fs::path& path, const char* section, const std::vector<Field>& fields,
                         std::size_t count) {
  std::string text = fmt::format("<{}>\n", section);
  for (const Field& field : fields) {
    const auto components = static_cast<std::size_t>(field.components);
    LOCKSTEP_ASSERT(field.components >= 1 && field.values.size() == components * count,
                    "{}: field \"{}\" has {} values, not {} x {}", path.string(), field.name, field.values.size(),
                    count, components);
    for (std::size_t i = 0; i < field.values.size(); ++i)
      require_finite(field.values[i], fmt::format("{}: field \"{}\" entry {} component {}", path.string(), field.name,
                                                  i / components, i % components));
    text += data_array(field.name, "Float64", field.components, std::span<const double>(field.values));
  }
  return text + fmt::format("</{}>\n", section);
}

// Connectivity and offsets of cells, each a list of nodes.
template <class Cells>
std::string cell_arrays(const fs::path& path, const Cells& cells, std::size_t point_count) {
  std::vector<std::int64_t> nodes, offsets;
  for (const auto& cell : cells) {
    for (const std::int32_t node : cell) {
      LOCKSTEP_ASSERT(node >= 0 && static_cast<std::size_t>(node) < point_count, "{}: a cell names node {} of {}",
                      path.string(), node, point_count);
      nodes.push_back(node);
    }
    offsets.push_back(static_cast<std::int64_t>(nodes.size()));
  }
  return data_array("connectivity", "Int64", 1, std::span<const std::int64_t>(nodes)) +
         data_array("offsets", "Int64", 1, std::span<const std::int64_t>(offsets));
}

std::string vtk_file(const char* type, const std::string& piece_attributes, const std::string& content) {
  return fmt::format(
      "<?xml version=\"1.0\"?>\n"
      "<VTKFile type=\"{0}\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n"
      "<{0}>\n<Piece {1}>\n{2}</Piece>\n</{0}>\n</VTKFile>\n",
      type, piece_attributes, content);
}

// Cells of N points each, in the points' order.
template <std::size_t N>
std::vector<std::array<std::int32_t, N>> counting(std::size_t count) {
  std::vector<std::array<std::int32_t, N>> cells(count);
  std::int32_t next = 0;
  for (auto& cell : cells)
    for (std::int32_t& node : cell) node = next++;
  return cells;
}

// Polygons, whatever their number of nodes.
template <class Polygons>
void write_polygons(const fs::path& path, const Vec3s& points, const Polygons& polygons,
                    const std::vector<Field>& point_data, const std::vector<Field>& cell_data) {
  write_file(
      path,
      vtk_file("PolyData", fmt::format("NumberOfPoints=\"{}\" NumberOfPolys=\"{}\"", points.size(), polygons.size()),
               data_section(path, "PointData", point_data, points.size()) +
                   data_section(path, "CellData", cell_data, polygons.size()) + points_section(path, points) +
                   "<Polys>\n" + cell_arrays(path, polygons, points.size()) + "</Polys>\n"));
}

// --------------------------------------------------------------------------------------------------- CSV and JSON

std::string csv_quoted(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (char c : text) {
    if (c == '"') out += '"';
    out += c;
  }
  out += '"';
  return out;
}

std::string json_quoted(const std::string& text) {
  std::string out = "\"";
  for (char c : text) switch (c) {
      case '"':
        out += "\\\"";
        break;
      case '\\':
        out += "\\\\";
        break;
      case '\n':
        out += "\\n";
        break;
      case '\r':
        out += "\\r";
        break;
      case '\t':
        out += "\\t";
        break;
      default:
        if (static_cast<unsigned char>(c) < 0x20)
          out += fmt::format("\\u{:04x}", static_cast<unsigned>(static_cast<unsigned char>(c)));
        else
          out += c;
    }
  out += '"';
  return out;
}

}  // namespace

void prepare_folder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) fail(folder, "make the folder", error.value());
  if (!fs::is_directory(folder, error)) fail(folder, "make the folder", ENOTDIR);
  const fs::path probe = folder / fmt::format(".write_probe_{}", ::getpid());
  write_and_close(probe, "probe");
  fs::remove(probe, error);
}

void write_file(const fs::path& path, const std::string& content) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (fs::is_directory(status)) fail(path, "write the file", EISDIR);
  // A device or pipe is written to as it is: a rename would put a plain file in its place.
  if (fs::exists(status) && !fs::is_regular_file(status)) return write_and_close(path, content);
  fs::path temporary = path;
  temporary += fmt::format(".tmp{}", ::getpid());
  try {
    write_and_close(temporary, content);
  } catch (const IoError&) {
    fs::remove(temporary, error);
    throw;
  }
  if (std::rename(temporary.c_str(), path.c_str()) != 0) {
    const int reason = errno;
    fs::remove(temporary, error);
    fail(path, "put the finished file in place", reason);
  }
}

History::History(const fs::path& path, const std::vector<std::string>& columns) : path_(path), columns_(columns) {
  file_ = std::fopen(path.c_str(), "wb");
  if (!file_) fail(path, "open the file", errno);
  std::string line;
  for (const std::string& column : columns) line += fmt::format("{}{}", line.empty() ? "" : ",", csv_quoted(column));
  write_line(line);
}

History::~History() {
  if (file_) std::fclose(file_);
}

void History::add(std::span<const double> row) {
  LOCKSTEP_ASSERT(row.size() == columns_.size(), "{}: a row of {} values for {} columns", path_.string(), row.size(),
                  columns_.size());
  std::string line;
  for (std::size_t c = 0; c < row.size(); ++c) {
    require_finite(row[c], fmt::format("{}: row {} column \"{}\"", path_.string(), rows_, columns_[c]));
    line += fmt::format("{}{}", c == 0 ? "" : ",", row[c]);
  }
  write_line(line);
  ++rows_;
}

void History::write_line(std::string line) {
  line += '\n';
  if (std::fwrite(line.data(), 1, line.size(), file_) != line.size() || std::fflush(file_) != 0)
    fail(path_, "write", errno);
}

void write_vtp_points(const fs::path& path, const Vec3s& points, const std::vector<Field>& point_data) {
  const std::size_t n = points.size();
  write_file(path, vtk_file("PolyData", fmt::format("NumberOfPoints=\"{}\" NumberOfVerts=\"{}\"", n, n),
                            data_section(path, "PointData", point_data, n) + points_section(path, points) +
                                "<Verts>\n" + cell_arrays(path, counting<1>(n), n) + "</Verts>\n"));
}

void write_vtp_lines(const fs::path& path, const Vec3s& begin, const Vec3s& end, const std::vector<Field>& cell_data) {
  LOCKSTEP_ASSERT(begin.size() == end.size(), "{}: {} begins and {} ends", path.string(), begin.size(), end.size());
  Vec3s points;
  points.reserve(2 * begin.size());
  for (std::size_t i = 0; i < begin.size(); ++i) points.push_back(begin[i]), points.push_back(end[i]);
  write_file(
      path, vtk_file("PolyData", fmt::format("NumberOfPoints=\"{}\" NumberOfLines=\"{}\"", points.size(), begin.size()),
                     data_section(path, "CellData", cell_data, begin.size()) + points_section(path, points) +
                         "<Lines>\n" + cell_arrays(path, counting<2>(begin.size()), points.size()) + "</Lines>\n"));
}

void write_vtp_polygons(const fs::path& path, const Vec3s& points,
                        const std::vector<std::vector<std::int32_t>>& polygons, const std::vector<Field>& point_data,
                        const std::vector<Field>& cell_data) {
  write_polygons(path, points, polygons, point_data, cell_data);
}

void write_vtp_facets(const fs::path& path, const Vec3s& points, const std::vector<std::array<std::int32_t, 4>>& facets,
                      const std::vector<Field>& point_data, const std::vector<Field>& cell_data) {
  write_polygons(path, points, facets, point_data, cell_data);
}

void write_vtu_hexahedra(const fs::path& path, const Vec3s& points,
                         const std::vector<std::array<std::int32_t, 8>>& zones, const std::vector<Field>& point_data,
                         const std::vector<Field>& cell_data) {
  constexpr std::uint8_t vtk_hexahedron = 12;
  const std::vector<std::uint8_t> types(zones.size(), vtk_hexahedron);
  write_file(path, vtk_file("UnstructuredGrid",
                            fmt::format("NumberOfPoints=\"{}\" NumberOfCells=\"{}\"", points.size(), zones.size()),
                            data_section(path, "PointData", point_data, points.size()) +
                                data_section(path, "CellData", cell_data, zones.size()) + points_section(path, points) +
                                "<Cells>\n" + cell_arrays(path, zones, points.size()) +
                                data_array("types", "UInt8", 1, std::span<const std::uint8_t>(types)) + "</Cells>\n"));
}

void Series::add(double time, const std::string& file_name) {
  require_finite(time, fmt::format("{}: time of {}", path_.string(), file_name));
  entries_.emplace_back(time, file_name);
  std::string text =
      "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" "
      "byte_order=\"LittleEndian\">\n<Collection>\n";
  for (const auto& [at, name] : entries_)
    text += fmt::format("<DataSet timestep=\"{}\" file=\"{}\"/>\n", at, xml_escaped(name));
  write_file(path_, text + "</Collection>\n</VTKFile>\n");
}

void Json::raw(const std::string& key, const std::string& value) {
  for (const auto& entry : entries_) LOCKSTEP_ASSERT(entry.first != key, "the object has \"{}\" already", key);
  entries_.emplace_back(key, value);
}

Json& Json::add(const std::string& key, double value) {
  require_finite(value, fmt::format("\"{}\"", key));
  raw(key, fmt::format("{}", value));
  return *this;
}

Json& Json::add(const std::string& key, std::int64_t value) {
  raw(key, fmt::format("{}", value));
  return *this;
}

Json& Json::add(const std::string& key, bool value) {
  raw(key, value ? "true" : "false");
  return *this;
}

Json& Json::add(const std::string& key, const std::string& value) {
  raw(key, json_quoted(value));
  return *this;
}

Json& Json::add(const std::string& key, const Json& object) {
  std::string nested;
  for (char c : object.text()) nested += c == '\n' ? std::string("\n  ") : std::string(1, c);
  raw(key, nested);
  return *this;
}

Json& Json::add(const std::string& key, const std::vector<double>& values) {
  std::string list;
  for (std::size_t i = 0; i < values.size(); ++i) {
    require_finite(values[i], fmt::format("\"{}\"[{}]", key, i));
    list += fmt::format("{}{}", i == 0 ? "" : ", ", values[i]);
  }
  raw(key, fmt::format("[{}]", list));
  return *this;
}

std::string Json::text() const {
  if (entries_.empty()) return "{}";
  std::string text = "{";
  for (const auto& [key, value] : entries_)
    text += fmt::format("{}\n  {}: {}", text == "{" ? "" : ",", json_quoted(key), value);
  return text + "\n}";
}

}  // namespace lockstep
