// Writes meshes in each form that mesh files have, so that what is read can be compared with what was written.
#pragma once
#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/checks.hpp"
#include "common/random.hpp"
#include "continuum_client/grid.hpp"
#include "continuum_client/zone_adjacency.hpp"

namespace lockstep::continuum {

struct PlainMesh {
  Vec3s node;
  std::vector<ZoneNodes> zone;
  std::vector<int> group;                         // per zone, from 1
  std::vector<std::array<std::int32_t, 4>> face;  // of group 7, Gmsh only
};

// Group 1; 2 in the discrete domain.
inline PlainMesh plain(const Grid& grid) {
  PlainMesh m{grid.node, grid.zone, {}, {}};
  for (const char inside : grid.in_discrete_domain) m.group.push_back(inside ? 2 : 1);
  return m;
}

inline std::vector<std::int32_t> shuffled(std::size_t count, Random& random) {
  std::vector<std::int32_t> order(count);
  for (std::size_t i = 0; i < count; ++i) order[i] = static_cast<std::int32_t>(i);
  for (std::size_t i = count; i > 1; --i)
    std::swap(order[i - 1], order[static_cast<std::size_t>(random.uniform(0, static_cast<double>(i))) % i]);
  return order;
}

// Nodes and zones in any order, zones turned at random.
inline PlainMesh shuffled(const PlainMesh& from, std::uint64_t seed) {
  Random random(seed);
  const std::vector<std::int32_t> node = shuffled(from.node.size(), random), zone = shuffled(from.zone.size(), random);
  PlainMesh m;
  std::vector<std::int32_t> place(node.size());
  for (std::size_t i = 0; i < node.size(); ++i)
    m.node.push_back(from.node[node[i]]), place[node[i]] = static_cast<std::int32_t>(i);
  constexpr int about_z[8] = {1, 2, 3, 0, 5, 6, 7, 4}, about_x[8] = {4, 5, 1, 0, 7, 6, 2, 3};
  for (const std::int32_t z : zone) {
    ZoneNodes nodes = from.zone[z];
    for (int turn = 0; turn < 6; ++turn) {
      const auto& turned = random.uniform(0, 1) < 0.5 ? about_z : about_x;
      ZoneNodes next;
      for (int a = 0; a < 8; ++a) next[a] = nodes[turned[a]];
      nodes = next;
    }
    for (std::int32_t& n : nodes) n = place[n];
    m.zone.push_back(nodes), m.group.push_back(from.group[z]);
  }
  for (auto face : from.face) {
    for (std::int32_t& n : face) n = place[n];
    m.face.push_back(face);
  }
  return m;
}

// Numbers as text, or as bytes of either order.
class NumberWriter {
 public:
  bool is_binary = false, is_swapped = false;
  std::string out;

  template <class T>
  void put(T value) {
    if (!is_binary) {
      out += fmt::format("{} ", value);
      return;
    }
    std::array<char, sizeof(T)> raw;
    std::memcpy(raw.data(), &value, sizeof(T));
    if (is_swapped) std::reverse(raw.begin(), raw.end());
    out.append(raw.data(), raw.size());
  }
  void text(const std::string& words) { out += words; }
  void end_line() {
    if (!is_binary) out += '\n';
  }
};

inline std::string msh_names() {
  return "$PhysicalNames\n3\n2 7 \"top\"\n3 1 \"ground\"\n3 2 \"grains here\"\n$EndPhysicalNames\n";
}

// Node i has the number 10 + 3 i, zone z the number 1000 + z.
inline std::string msh_2(const PlainMesh& m, bool is_binary, bool is_swapped = false) {
  NumberWriter w{is_binary, is_swapped, fmt::format("$MeshFormat\n2.2 {} 8\n", is_binary ? 1 : 0)};
  if (is_binary) w.put(std::int32_t{1}), w.text("\n");
  w.text("$EndMeshFormat\n" + msh_names() + fmt::format("$Nodes\n{}\n", m.node.size()));
  const auto number = [](std::int32_t n) { return std::int32_t{10 + 3 * n}; };
  for (std::size_t i = 0; i < m.node.size(); ++i) {
    w.put(number(static_cast<std::int32_t>(i)));
    for (int k = 0; k < 3; ++k) w.put(m.node[i][k]);
    w.end_line();
  }
  w.text(fmt::format("\n$EndNodes\n$Elements\n{}\n", m.zone.size() + m.face.size() + 1));
  const auto element = [&](std::int32_t of, std::int32_t type, std::int32_t group, const auto& nodes) {
    if (is_binary)
      w.put(type), w.put(std::int32_t{1}), w.put(std::int32_t{2}), w.put(of);
    else
      w.put(of), w.put(type), w.put(std::int32_t{2});
    w.put(group), w.put(std::int32_t{1});
    for (const std::int32_t n : nodes) w.put(number(n));
    w.end_line();
  };
  element(1, 15, 0, std::array<std::int32_t, 1>{0});
  for (const auto& face : m.face) element(2, 3, 7, face);
  for (std::size_t z = 0; z < m.zone.size(); ++z)
    element(static_cast<std::int32_t>(1000 + z), 5, m.group[z], m.zone[z]);
  w.text("\n$EndElements\n");
  return w.out;
}

// One entity a group; nodes in two blocks, the second parametric.
inline std::string msh_4(const PlainMesh& m, bool is_binary, bool is_swapped = false) {
  NumberWriter w{is_binary, is_swapped, fmt::format("$MeshFormat\n4.1 {} 8\n", is_binary ? 1 : 0)};
  if (is_binary) w.put(std::int32_t{1}), w.text("\n");
  w.text("$EndMeshFormat\n" + msh_names() + "$Entities\n");
  const auto whole = [&](auto value) { w.put(static_cast<std::int64_t>(value)); };
  const auto number = [](std::size_t n) { return 10 + 3 * n; };
  for (const int count : {1, 0, 1, 2}) whole(count);
  w.end_line();
  w.put(std::int32_t{1});
  for (int k = 0; k < 3; ++k) w.put(0.0);
  whole(0), w.end_line();
  for (const std::int32_t tag : {7, 1, 2}) {
    w.put(tag + 20);
    for (int k = 0; k < 6; ++k) w.put(0.5);
    whole(1), w.put(tag), whole(1), w.put(std::int32_t{-3}), w.end_line();
  }
  w.text("\n$EndEntities\n$Nodes\n");
  whole(2), whole(m.node.size()), whole(10), whole(number(m.node.size())), w.end_line();
  const std::size_t half = m.node.size() / 2;
  for (const bool second : {false, true}) {
    const std::size_t begin = second ? half : 0, end = second ? m.node.size() : half;
    w.put(std::int32_t{second ? 2 : 3}), w.put(std::int32_t{21}), w.put(std::int32_t{second ? 1 : 0}),
        whole(end - begin), w.end_line();
    for (std::size_t i = begin; i < end; ++i) whole(number(i));
    w.end_line();
    for (std::size_t i = begin; i < end; ++i) {
      for (int k = 0; k < 3; ++k) w.put(m.node[i][k]);
      for (int k = 0; second && k < 2; ++k) w.put(0.25);
      w.end_line();
    }
  }
  w.text("\n$EndNodes\n$Elements\n");
  whole(4), whole(m.zone.size() + m.face.size() + 1), whole(1), whole(2000), w.end_line();
  w.put(std::int32_t{0}), w.put(std::int32_t{1}), w.put(std::int32_t{15}), whole(1), whole(1), whole(10), w.end_line();
  w.put(std::int32_t{2}), w.put(std::int32_t{27}), w.put(std::int32_t{3}), whole(m.face.size()), w.end_line();
  for (const auto& face : m.face) {
    whole(2);
    for (const std::int32_t n : face) whole(number(static_cast<std::size_t>(n)));
    w.end_line();
  }
  for (const int group : {1, 2}) {
    w.put(std::int32_t{3}), w.put(std::int32_t{20 + group}), w.put(std::int32_t{5});
    whole(std::count(m.group.begin(), m.group.end(), group)), w.end_line();
    for (std::size_t z = 0; z < m.zone.size(); ++z) {
      if (m.group[z] != group) continue;
      whole(1000 + z);
      for (const std::int32_t n : m.zone[z]) whole(number(static_cast<std::size_t>(n)));
      w.end_line();
    }
  }
  w.text("\n$EndElements\n$NodeData\nsomething else\n$EndNodeData\n");
  return w.out;
}

// Every other zone as a voxel, whose nodes run along x, y and z.
inline std::string vtk_legacy(const PlainMesh& m, int version, bool is_binary) {
  NumberWriter w{false, std::endian::native == std::endian::little,
                 fmt::format("# vtk DataFile Version {}\na mesh\n{}\nDATASET UNSTRUCTURED_GRID\nPOINTS {} double\n",
                             version == 5 ? "5.1" : "3.0", is_binary ? "BINARY" : "ASCII", m.node.size())};
  const auto lines = [&](const auto& write) { w.is_binary = is_binary, write(), w.is_binary = false, w.text("\n"); };
  const auto nodes = [&](std::size_t z) {
    ZoneNodes n = m.zone[z];
    if (z % 2) std::swap(n[2], n[3]), std::swap(n[6], n[7]);
    return n;
  };
  lines([&] {
    for (const Vec3& x : m.node)
      for (int k = 0; k < 3; ++k) w.put(x[k]);
  });
  if (version == 5) {
    w.text("METADATA\nINFORMATION 0\n\n");
    w.text(fmt::format("CELLS {} {}\nOFFSETS vtktypeint64\n", m.zone.size() + 1, 8 * m.zone.size()));
    lines([&] {
      for (std::size_t z = 0; z <= m.zone.size(); ++z) w.put(static_cast<std::int64_t>(8 * z));
    });
    w.text("CONNECTIVITY vtktypeint64\n");
    lines([&] {
      for (std::size_t z = 0; z < m.zone.size(); ++z)
        for (const std::int32_t n : nodes(z)) w.put(std::int64_t{n});
    });
  } else {
    w.text(fmt::format("CELLS {} {}\n", m.zone.size(), 9 * m.zone.size()));
    lines([&] {
      for (std::size_t z = 0; z < m.zone.size(); ++z) {
        w.put(std::int32_t{8});
        for (const std::int32_t n : nodes(z)) w.put(n);
      }
    });
  }
  w.text(fmt::format("CELL_TYPES {}\n", m.zone.size()));
  lines([&] {
    for (std::size_t z = 0; z < m.zone.size(); ++z) w.put(std::int32_t{z % 2 ? 11 : 12});
  });
  w.text(fmt::format("POINT_DATA {}\nVECTORS v float\n", m.node.size()));
  lines([&] {
    for (std::size_t i = 0; i < 3 * m.node.size(); ++i) w.put(0.5f);
  });
  w.text(fmt::format("CELL_DATA {}\n", m.zone.size()));
  if (version == 5)
    w.text(fmt::format("FIELD FieldData 1\nregion 1 {} int\n", m.zone.size()));
  else
    w.text("SCALARS region int 1\nLOOKUP_TABLE default\n");
  lines([&] {
    for (const int g : m.group) w.put(std::int32_t{g});
  });
  return w.out;
}

inline std::string base64(const std::string& bytes) {
  constexpr char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t bits = 0;
    for (std::size_t k = 0; k < 3; ++k)
      bits = bits << 8 | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) text += k <= bytes.size() - i ? letters[bits >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

enum class VtuForm { Ascii, Inline, AppendedRaw, AppendedBase64 };

inline std::string vtu(const PlainMesh& m, VtuForm form, bool is_swapped = false) {
  const bool is_big = (std::endian::native == std::endian::big) != is_swapped;
  std::string appended;
  std::string text = fmt::format(
      "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"{}\" "
      "header_type=\"UInt32\">\n"
      "<!-- a > comment --><UnstructuredGrid><Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n",
      is_big ? "BigEndian" : "LittleEndian", m.node.size(), m.zone.size());
  const auto array = [&](const std::string& type, const std::string& name, const auto& write) {
    NumberWriter w{form != VtuForm::Ascii, is_swapped, ""};
    write(w);
    NumberWriter head{true, is_swapped, ""};
    head.put(static_cast<std::uint32_t>(w.out.size()));
    text += fmt::format("<DataArray type=\"{}\" Name=\"{}\" NumberOfComponents=\"1\" ", type, name);
    switch (form) {
      case VtuForm::Ascii:
        text += "format=\"ascii\">\n" + w.out + "\n</DataArray>\n";
        return;
      case VtuForm::Inline:
        text += "format=\"binary\">\n" + base64(head.out + w.out) + "\n</DataArray>\n";
        return;
      case VtuForm::AppendedRaw:
      case VtuForm::AppendedBase64:
        text += fmt::format("format=\"appended\" offset=\"{}\"/>\n", appended.size());
        appended += form == VtuForm::AppendedRaw ? head.out + w.out : base64(head.out) + base64(w.out);
    }
  };
  text += "<PointData></PointData><CellData Scalars='region'>\n";
  array("Int32", "region", [&](NumberWriter& w) {
    for (const int g : m.group) w.put(std::int32_t{g});
  });
  text += "</CellData><Points>\n";
  array("Float64", "Points", [&](NumberWriter& w) {
    for (const Vec3& x : m.node)
      for (int k = 0; k < 3; ++k) w.put(x[k]);
  });
  text += "</Points><Cells>\n";
  array("Int64", "connectivity", [&](NumberWriter& w) {
    for (const ZoneNodes& zone : m.zone)
      for (const std::int32_t n : zone) w.put(std::int64_t{n});
  });
  array("Int64", "offsets", [&](NumberWriter& w) {
    for (std::size_t z = 1; z <= m.zone.size(); ++z) w.put(static_cast<std::int64_t>(8 * z));
  });
  array("UInt8", "types", [&](NumberWriter& w) {
    for (std::size_t z = 0; z < m.zone.size(); ++z) w.put(std::uint8_t{12});
  });
  text += "</Cells></Piece></UnstructuredGrid>\n";
  if (!appended.empty())
    text += fmt::format("<AppendedData encoding=\"{}\">\n_", form == VtuForm::AppendedRaw ? "raw" : "base64") +
            appended + "\n</AppendedData>\n";
  return text + "</VTKFile>\n";
}

// A file that goes with its test.
class MeshOnDisk {
 public:
  explicit MeshOnDisk(const std::string& bytes = "") {
    std::string name = (std::filesystem::temp_directory_path() / "lockstep_mesh_XXXXXX").string();
    const int handle = ::mkstemp(name.data());
    if (handle < 0) throw std::runtime_error("no temporary file");
    ::close(handle);
    path_ = name;
    write(bytes);
  }
  ~MeshOnDisk() { std::remove(path_.c_str()); }
  MeshOnDisk(const MeshOnDisk&) = delete;
  MeshOnDisk& operator=(const MeshOnDisk&) = delete;

  void write(const std::string& bytes) { std::ofstream(path_, std::ios::binary | std::ios::trunc) << bytes; }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace lockstep::continuum
