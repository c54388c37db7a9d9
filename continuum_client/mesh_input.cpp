#include "continuum_client/mesh_input.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iterator>

namespace lockstep::continuum {
namespace {

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; }

constexpr std::size_t longest_shown = 40;  // letters of a wrong word that a message repeats

// What a message may repeat of a file's bytes.
std::string shown(std::string_view word) {
  std::string text;
  for (const char c : word.substr(0, longest_shown)) text += c >= ' ' && c <= '~' ? c : '?';
  return text;
}

}  // namespace

void MeshCursor::fail(const std::string& text) const {
  if (is_binary) throw InputError(fmt::format("{}, byte {}: {}", name_, at_, text));
  const auto line = std::count(bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(at_), '\n') + 1;
  throw InputError(fmt::format("{}:{}: {}", name_, line, text));
}

bool MeshCursor::is_at_end() {
  while (at_ < bytes_.size() && is_space(bytes_[at_])) ++at_;
  return at_ == bytes_.size();
}

std::string_view MeshCursor::word() {
  if (is_at_end()) return {};
  const std::size_t begin = at_;
  while (at_ < bytes_.size() && !is_space(bytes_[at_])) ++at_;
  return bytes_.substr(begin, at_ - begin);
}

std::string_view MeshCursor::line() {
  const std::size_t begin = at_, end = std::min(bytes_.find('\n', at_), bytes_.size());
  at_ = std::min(end + 1, bytes_.size());
  std::string_view text = bytes_.substr(begin, end - begin);
  if (!text.empty() && text.back() == '\r') text.remove_suffix(1);
  return text;
}

double MeshCursor::real(const char* what) {
  const std::size_t before = at_;
  std::string_view text = word();
  if (text.empty()) fail(fmt::format("the file ends where {} is due; it is cut short: write or copy it anew", what));
  const std::string_view whole = text;
  if (text.front() == '+') text.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  const bool is_number = end == text.data() + text.size() && !text.empty();
  if (is_number && error == std::errc::result_out_of_range)
    return std::strtod(std::string(text).c_str(), nullptr);  // 0 or inf
  if (!is_number || error != std::errc()) {
    at_ = before;
    is_at_end();
    fail(fmt::format("\"{}\" stands where {} is due", shown(whole), what));
  }
  return value;
}

std::int64_t MeshCursor::whole(const char* what) {
  const std::size_t before = at_;
  const std::string_view text = word();
  if (text.empty()) fail(fmt::format("the file ends where {} is due; it is cut short: write or copy it anew", what));
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) {
    at_ = before;
    is_at_end();
    fail(fmt::format("\"{}\" stands where {}, a whole number, is due", shown(text), what));
  }
  return value;
}

void MeshCursor::demand(std::size_t count, std::size_t bytes_each, const char* what) const {
  if (count > left() / bytes_each)
    fail(
        fmt::format("{} {} are due, {} bytes at least for each, but the file has {} bytes left; it is cut short or "
                    "damaged: write or copy it anew",
                    count, what, bytes_each, left()));
}

std::size_t MeshCursor::count(std::int64_t number, std::size_t words_each, std::size_t bytes_each,
                              const char* what) const {
  if (number < 0) fail(fmt::format("a count of {} {}; the file is damaged: write or copy it anew", number, what));
  const auto n = static_cast<std::size_t>(number);
  if (n > std::numeric_limits<std::int32_t>::max())
    fail(fmt::format("{} {} are more than the {} that fit", n, what, std::numeric_limits<std::int32_t>::max()));
  // The last word of a text may end with the file.
  const std::size_t each = is_binary ? bytes_each : 2 * words_each;
  if (each > 0 && n > (left() + 1) / each) demand(n, each, what);
  return n;
}

FileMesh read_mesh(const std::filesystem::path& path, const std::string& cell_array) {
  std::ifstream file(path, std::ios::binary);
  if (!file || std::filesystem::is_directory(path))
    throw IoError(fmt::format("{}: cannot read the mesh: {}; give a Gmsh or VTK file, its path from the scene's folder",
                              path.string(), file ? "it is a folder" : std::strerror(errno)));
  const std::string bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  const std::string name = path.string();
  const std::size_t begin = bytes.find_first_not_of(" \t\r\n");
  if (begin == std::string::npos)
    throw InputError(fmt::format("{} is empty; give a Gmsh file (.msh) or a VTK file (.vtk, .vtu)", name));
  const auto begins_with = [&](std::string_view magic) { return bytes.compare(begin, magic.size(), magic) == 0; };
  if (begins_with("# vtk") || begins_with("<?xml") || begins_with("<VTKFile")) return read_vtk(bytes, name, cell_array);
  if (begins_with("$")) return read_gmsh(bytes, name);
  throw InputError(fmt::format(
      "{} begins with \"{}\"; a Gmsh file begins with \"$MeshFormat\", a VTK file with \"# vtk DataFile\" or "
      "\"<VTKFile\": give one of these",
      name,
      shown(std::string_view(bytes).substr(begin,
                                           std::min<std::size_t>(16, bytes.find_first_of("\r\n", begin) - begin)))));
}

}  // namespace lockstep::continuum
