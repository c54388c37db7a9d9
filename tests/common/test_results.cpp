#include "common/results.hpp"

#include <unistd.h>

#include <array>
#include <catch2/catch.hpp>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "common/checks.hpp"

namespace {

using namespace lockstep;
namespace fs = std::filesystem;

constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();

// A folder of its own that is gone when the test is over.
struct TemporaryFolder {
  fs::path path = fs::temp_directory_path() / fmt::format("lockstep_results_{}", ::getpid());
  TemporaryFolder() { fs::create_directories(path); }
  ~TemporaryFolder() { fs::remove_all(path); }
};

std::string read(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  REQUIRE(stream);
  std::stringstream text;
  text << stream.rdbuf();
  return text.str();
}

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

// Decodes base64 by looking each letter up (RFC 4648, section 4).
std::vector<unsigned char> decoded(const std::string& text) {
  const std::string letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  REQUIRE(text.size() % 4 == 0);
  std::vector<unsigned char> bytes;
  std::uint32_t bits = 0;
  int held = 0;
  for (char c : text) {
    if (c == '=') break;
    REQUIRE(letters.find(c) != std::string::npos);
    bits = bits << 6 | static_cast<std::uint32_t>(letters.find(c));
    held += 6;
    if (held >= 8) bytes.push_back(static_cast<unsigned char>(bits >> (held -= 8) & 255u));
  }
  return bytes;
}

// The values of the array of that name.
template <class T>
std::vector<T> payload(const std::string& xml, const std::string& name) {
  const std::size_t head = xml.find("Name=\"" + name + "\"");
  REQUIRE(head != std::string::npos);
  const std::size_t begin = xml.find('\n', head) + 1, end = xml.find('\n', begin);
  const std::vector<unsigned char> bytes = decoded(xml.substr(begin, end - begin));
  std::uint64_t size = 0;
  REQUIRE(bytes.size() >= sizeof size);
  std::memcpy(&size, bytes.data(), sizeof size);
  REQUIRE(bytes.size() == sizeof size + size);
  std::vector<T> values(size / sizeof(T));
  if (size > 0) std::memcpy(values.data(), bytes.data() + sizeof size, size);
  return values;
}

// The text of the error that `action` throws, which must be an E.
template <class E, class Action>
std::string complaint(Action action) {
  try {
    action();
  } catch (const E& e) {
    return e.what();
  }
  FAIL("no error of the expected kind");
  return "";
}

}  // namespace

TEST_CASE("Every double of a ParaView file comes back with the same bits") {
  const TemporaryFolder folder;
  const fs::path path = folder.path / "p.vtp";
  const Vec3s points = {{0.1, -1e-300, 3}, {4, 5e200, -0.0}};
  const std::vector<double> radius = {1.0 / 3.0, 0.028};
  write_vtp_points(path, points, {{"radius", 1, radius}, {"force <N>", 3, {1, 2, 3, 4, 5, 6}}});
  const std::string xml = read(path);
  CHECK(payload<double>(xml, "Points") == std::vector<double>{0.1, -1e-300, 3, 4, 5e200, -0.0});
  CHECK(payload<double>(xml, "radius") == radius);
  CHECK(payload<double>(xml, "force &lt;N&gt;") == std::vector<double>{1, 2, 3, 4, 5, 6});
  CHECK(payload<std::int64_t>(xml, "connectivity") == std::vector<std::int64_t>{0, 1});
  CHECK(payload<std::int64_t>(xml, "offsets") == std::vector<std::int64_t>{1, 2});
  CHECK(contains(xml, "NumberOfPoints=\"2\" NumberOfVerts=\"2\""));
}

TEST_CASE("Payloads of every length modulo three are padded so that they decode") {
  const TemporaryFolder folder;
  const fs::path path = folder.path / "z.vtu";
  const Vec3s corners = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
  // The cell types are one byte each: 8 + n bytes with n = 0..3 meet every padding.
  for (std::size_t n = 0; n <= 3; ++n) {
    write_vtu_hexahedra(path, corners, std::vector<std::array<std::int32_t, 8>>(n, {0, 1, 2, 3, 4, 5, 6, 7}), {},
                        {{"stress", 6, std::vector<double>(6 * n, 2.5)}});
    const std::string xml = read(path);
    CAPTURE(n);
    CHECK(payload<std::uint8_t>(xml, "types") == std::vector<std::uint8_t>(n, 12));
    CHECK(payload<double>(xml, "stress") == std::vector<double>(6 * n, 2.5));
    CHECK(payload<std::int64_t>(xml, "offsets").size() == n);
  }
}

TEST_CASE("Lines join their own two points, and facets their own four nodes") {
  const TemporaryFolder folder;
  const fs::path path = folder.path / "l.vtp";
  write_vtp_lines(path, {{0, 0, 0}, {1, 0, 0}}, {{0, 0, 1}, {1, 0, 2}}, {{"force", 1, {7, 8}}});
  CHECK(payload<double>(read(path), "Points") == std::vector<double>{0, 0, 0, 0, 0, 1, 1, 0, 0, 1, 0, 2});
  CHECK(payload<std::int64_t>(read(path), "offsets") == std::vector<std::int64_t>{2, 4});
  write_vtp_facets(path, {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}, {{3, 2, 1, 0}}, {},
                   {{"traction", 3, {1, 2, 3}}});
  CHECK(payload<std::int64_t>(read(path), "connectivity") == std::vector<std::int64_t>{3, 2, 1, 0});
  CHECK(contains(read(path), "NumberOfPolys=\"1\""));
}

TEST_CASE("Polygons of any number of nodes stand one behind the other, and a node that is not there is our error") {
  const TemporaryFolder folder;
  const fs::path path = folder.path / "polygons.vtp";
  const Vec3s points = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {2, 0, 0}};
  write_vtp_polygons(path, points, {{0, 1, 2, 3}, {1, 4, 2}}, {}, {});
  CHECK(payload<std::int64_t>(read(path), "connectivity") == std::vector<std::int64_t>{0, 1, 2, 3, 1, 4, 2});
  CHECK(payload<std::int64_t>(read(path), "offsets") == std::vector<std::int64_t>{4, 7});
  CHECK_THROWS_AS(write_vtp_polygons(path, points, {{0, 1, 5}}, {}, {}), InternalError);
}

TEST_CASE("No result file takes a value that is not finite, and the error names file and field") {
  const TemporaryFolder folder;
  const fs::path path = folder.path / "p.vtp";
  write_vtp_points(path, {{0, 0, 0}}, {});
  const std::string before = read(path);
  const std::string text = complaint<NumericalError>([&] {
    write_vtp_points(path, {{1, 1, 1}}, {{"velocity", 3, {0, not_a_number, 0}}});
  });
  CAPTURE(text);
  CHECK(contains(text, path.string()));
  CHECK(contains(text, "field \"velocity\" entry 0 component 1"));
  CHECK(read(path) == before);
  CHECK(contains(complaint<NumericalError>([&] {
                   write_vtp_points(path, {{1, not_a_number, 1}}, {});
                 }),
                 "point 0 component 1"));

  History history(folder.path / "h.csv", {"time [s]", "tip [N]"});
  history.add({0.0, 1.0});
  CHECK(contains(complaint<NumericalError>([&] { history.add({1.0, not_a_number}); }), "row 1 column \"tip [N]\""));
  CHECK(contains(complaint<NumericalError>([&] { Json().add("ratio", not_a_number); }), "\"ratio\""));
  CHECK(contains(complaint<NumericalError>([&] {
                   Json().add("list", std::vector<double>{1, not_a_number});
                 }),
                 "\"list\"[1]"));
  CHECK_THROWS_AS(Series(folder.path / "s.pvd").add(not_a_number, "p.vtp"), NumericalError);
  CHECK_THROWS_AS(write_vtp_points(path, {{0, 0, 0}}, {{"radius", 1, {1, 2}}}), InternalError);
}

TEST_CASE("A history is a table whose numbers read back exactly, row by row while the run goes on") {
  const TemporaryFolder folder;
  History history(folder.path / "h.csv", {"time [s]", "a, quoted \"name\""});
  history.add({0.1, 1.0 / 3.0});
  CHECK(read(folder.path / "h.csv") == "time [s],\"a, quoted \"\"name\"\"\"\n0.1,0.3333333333333333\n");
  CHECK_THROWS_AS(history.add({1.0}), InternalError);
}

TEST_CASE("A full disk is an IoError that says so, and the device is left as it is") {
  if (!fs::is_character_file("/dev/full")) return;
  const std::string text = complaint<IoError>([] { write_file("/dev/full", "words"); });
  CAPTURE(text);
  CHECK(contains(text, "/dev/full"));
  CHECK(contains(text, "No space left on device"));
  CHECK(contains(text, "free some space"));
  CHECK(fs::is_character_file("/dev/full"));
  CHECK(contains(complaint<IoError>([] { History("/dev/full", {"time [s]"}); }), "No space left on device"));
}

TEST_CASE("A folder that cannot be made, or a name that is taken, is an IoError with the reason") {
  const TemporaryFolder folder;
  CHECK(contains(complaint<IoError>([] { prepare_folder("/proc/lockstep"); }), "/proc/lockstep"));
  write_file(folder.path / "file", "x");
  CHECK(contains(complaint<IoError>([&] { prepare_folder(folder.path / "file"); }),
                 "a file has the name of that folder"));
  CHECK(contains(complaint<IoError>([&] { prepare_folder(folder.path / "file" / "below"); }), "Not a directory"));
  CHECK(contains(complaint<IoError>([&] { write_file(folder.path, "x"); }), "Is a directory"));
  CHECK(contains(complaint<IoError>([&] { write_file(folder.path / "none" / "f", "x"); }), "make its folder first"));
  CHECK_NOTHROW(prepare_folder(folder.path / "a" / "b"));
  CHECK(fs::is_empty(folder.path / "a" / "b"));
}

TEST_CASE("A file is replaced whole, and no temporary file stays behind") {
  const TemporaryFolder folder;
  write_file(folder.path / "f", "first");
  write_file(folder.path / "f", "second");
  CHECK(read(folder.path / "f") == "second");
  CHECK(std::distance(fs::directory_iterator(folder.path), fs::directory_iterator()) == 1);
}

TEST_CASE("JSON escapes what must be escaped and keeps its order") {
  CHECK(Json().text() == "{}");
  CHECK(Json()
            .add("text", "a \"quoted\" \\ line\nwith\ttab \x01 and \xc3\xa9")
            .add("number", 0.1)
            .add("count", 3)
            .add("flag", true)
            .add("list", std::vector<double>{1, 2.5})
            .add("inner", Json().add("k", "v"))
            .text() ==
        "{\n  \"text\": \"a \\\"quoted\\\" \\\\ line\\nwith\\ttab \\u0001 and \xc3\xa9\",\n  \"number\": 0.1,\n  "
        "\"count\": 3,\n"
        "  \"flag\": true,\n  \"list\": [1, 2.5],\n  \"inner\": {\n    \"k\": \"v\"\n  }\n}");
  CHECK_THROWS_AS(Json().add("k", 1).add("k", 2), InternalError);
}

TEST_CASE("A series lists its files with their times") {
  const TemporaryFolder folder;
  Series series(folder.path / "s.pvd");
  series.add(0, "a.vtp");
  series.add(0.25, "b.vtp");
  CHECK(contains(read(folder.path / "s.pvd"),
                 "<DataSet timestep=\"0\" file=\"a.vtp\"/>\n<DataSet timestep=\"0.25\" file=\"b.vtp\"/>"));
}
