// Result files: histories as CSV, particles, contacts and zones as ParaView files, summaries as JSON. Every file is
// written under a temporary name and renamed, so that a reader never meets half a file (histories are appended to and
// flushed by line). A value that is not finite is an error here: no result file ever holds NaN.
#pragma once
#include <array>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/vectors.hpp"

namespace lockstep {

// Creates the folder if need be and proves that it can be written; IoError names it.
void prepare_folder(const std::filesystem::path& folder);

// Writes `content` under a temporary name beside `path` and renames it. IoError with the system's reason.
void write_file(const std::filesystem::path& path, const std::string& content);

// A table with named columns ("time [s]", "tip [N]"), one row a call.
class History {
 public:
  History(const std::filesystem::path& path, const std::vector<std::string>& columns);
  ~History();
  void add(std::span<const double> row);
  void add(std::initializer_list<double> row) { add(std::span<const double>(row.begin(), row.size())); }
  History(const History&) = delete;
  History& operator=(const History&) = delete;

 private:
  void write_line(std::string line);

  std::filesystem::path path_;
  std::vector<std::string> columns_;
  std::size_t rows_ = 0;
  std::FILE* file_ = nullptr;
};

// A named array with 1, 3, 6 or 9 components per point or cell.
struct Field {
  std::string name;
  int components = 1;
  std::vector<double> values;
};

// Points with point data (.vtp). Inline binary (base64): ParaView 5.11 on Debian fails on appended data.
void write_vtp_points(const std::filesystem::path& path, const Vec3s& points, const std::vector<Field>& point_data);
// Lines between pairs of points with cell data (.vtp).
void write_vtp_lines(const std::filesystem::path& path, const Vec3s& begin, const Vec3s& end,
                     const std::vector<Field>& cell_data);
// Quadrilaterals and polygons (.vtp) and 8-node hexahedra (.vtu) with point and cell data.
void write_vtp_polygons(const std::filesystem::path& path, const Vec3s& points,
                        const std::vector<std::vector<std::int32_t>>& polygons, const std::vector<Field>& point_data,
                        const std::vector<Field>& cell_data);
void write_vtp_facets(const std::filesystem::path& path, const Vec3s& points,
                      const std::vector<std::array<std::int32_t, 4>>& facets, const std::vector<Field>& point_data,
                      const std::vector<Field>& cell_data);
void write_vtu_hexahedra(const std::filesystem::path& path, const Vec3s& points,
                         const std::vector<std::array<std::int32_t, 8>>& zones, const std::vector<Field>& point_data,
                         const std::vector<Field>& cell_data);

// A series of files over time (.pvd), rewritten at each addition.
class Series {
 public:
  explicit Series(std::filesystem::path path) : path_(std::move(path)) {}
  void add(double time, const std::string& file_name);

 private:
  std::filesystem::path path_;
  std::vector<std::pair<double, std::string>> entries_;
};

// A JSON object, built in order; numbers that are not finite are an error.
class Json {
 public:
  Json& add(const std::string& key, double value);
  Json& add(const std::string& key, std::int64_t value);
  Json& add(const std::string& key, std::uint64_t value) { return add(key, static_cast<std::int64_t>(value)); }
  Json& add(const std::string& key, int value) { return add(key, static_cast<std::int64_t>(value)); }
  Json& add(const std::string& key, bool value);
  Json& add(const std::string& key, const std::string& value);
  Json& add(const std::string& key, const char* value) { return add(key, std::string(value)); }
  Json& add(const std::string& key, const Json& object);
  Json& add(const std::string& key, const std::vector<double>& values);
  std::string text() const;

 private:
  void raw(const std::string& key, const std::string& value);
  std::vector<std::pair<std::string, std::string>> entries_;
};

}  // namespace lockstep
