// What a mesh file holds, before any of it is believed, and the cursor that its bytes are read with.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <limits>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "common/checks.hpp"
#include "common/vectors.hpp"

namespace lockstep::continuum {

// Zones in the node order of zone_kinematics.hpp; every index is valid and every coordinate finite.
struct FileMesh {
  struct Zone {
    std::array<std::int32_t, 8> node;
    std::int64_t number;  // the file's
    std::int32_t group;   // of `groups`
  };
  struct Face {
    std::array<std::int32_t, 4> node;
    std::int32_t group;
  };
  Vec3s node;                                           // as in the file
  std::vector<std::int64_t> node_number;                // the file's
  std::vector<Zone> zone;                               // at least one
  std::vector<Face> face;                               // quadrilaterals that are in a group
  std::vector<std::vector<std::string>> groups = {{}};  // words that each answers to; the first answers to none
  std::vector<std::string> cell_arrays;                 // that a VTK file has
  std::string what;                                     // "Gmsh 4.1, ASCII", for messages
};

// Both throw InputError with file, place and remedy. No count is believed before the file has the bytes for it.
FileMesh read_gmsh(const std::string& bytes, const std::string& name);
FileMesh read_vtk(const std::string& bytes, const std::string& name, const std::string& cell_array);

// By the file's first bytes. IoError if it cannot be read.
FileMesh read_mesh(const std::filesystem::path& path, const std::string& cell_array);

// A place in the bytes of a file. Whatever it is asked for, it gives it whole or throws InputError with name and place.
class MeshCursor {
 public:
  MeshCursor(std::string_view bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  bool is_binary = false;   // how values() and value() read
  bool is_swapped = false;  // the bytes of a number stand in the other order

  std::size_t at() const { return at_; }
  void go_to(std::size_t at) { at_ = at; }
  std::size_t left() const { return bytes_.size() - at_; }
  std::string_view rest() const { return bytes_.substr(at_); }
  bool is_at_end();  // but for white space

  std::string_view word();  // the next one; empty at the end
  std::string_view line();  // what is left of this line
  bool is_at_end_of_block() const {
    return at_ == bytes_.size() || bytes_[at_] == '\n' || bytes_[at_] == '\r';
  }  // an empty line
  double real(const char* what);
  std::int64_t whole(const char* what);  // from text

  // One number as it is stored: in binary of type T, else a word.
  template <class T>
  T value(const char* what) {
    if (!is_binary) {
      if constexpr (std::is_floating_point_v<T>)
        return static_cast<T>(real(what));
      else
        return narrow<T>(whole(what), what);
    }
    demand(1, sizeof(T), what);
    std::array<char, sizeof(T)> raw;
    std::memcpy(raw.data(), bytes_.data() + at_, sizeof(T));
    if (is_swapped) std::reverse(raw.begin(), raw.end());
    at_ += sizeof(T);
    return std::bit_cast<T>(raw);
  }
  // A count of things that take at least `bytes_each` each in binary, a digit and a space for each of `words_each` in text;
  // 0: what they take is not known yet.
  std::size_t count(std::int64_t number, std::size_t words_each, std::size_t bytes_each, const char* what) const;
  void demand(std::size_t count, std::size_t bytes_each, const char* what) const;

  [[noreturn]] void fail(const std::string& text) const;

 private:
  template <class T>
  T narrow(std::int64_t number, const char* what) const {
    if (number < static_cast<std::int64_t>(std::numeric_limits<T>::min()) ||
        (sizeof(T) < 8 && number > static_cast<std::int64_t>(std::numeric_limits<T>::max())))
      fail(fmt::format("{} {} is out of range", what, number));
    return static_cast<T>(number);
  }

  std::string_view bytes_;
  const std::string& name_;
  std::size_t at_ = 0;
};

}  // namespace lockstep::continuum
