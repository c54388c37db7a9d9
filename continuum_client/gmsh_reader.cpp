// Gmsh's MSH 2.2 and 4.1 (Gmsh reference manual, "MSH file format"), ASCII and binary in either byte order. A file is a row of
// sections $Name ... $EndName, of which this reads MeshFormat, PhysicalNames, Entities, Nodes and Elements.
//
// Groups are physical volumes and surfaces, and answer to their name and their number. 4.1 puts elements into entities, which
// may be in several groups; 2.2 writes an element once for each of its groups.
#include <fmt/ranges.h>
#include <cmath>
#include <map>
#include <set>
#include <utility>

#include "continuum_client/mesh_input.hpp"

namespace lockstep::continuum {
namespace {

struct ElementType {
  const char* name;
  int nodes;
  int dimension;
};

constexpr int hexahedron = 5, quadrilateral = 3;

const std::map<int, ElementType> element_types = {{1, {"line", 2, 1}},
                                                  {2, {"triangle", 3, 2}},
                                                  {3, {"quadrilateral", 4, 2}},
                                                  {4, {"tetrahedron", 4, 3}},
                                                  {5, {"hexahedron", 8, 3}},
                                                  {6, {"prism", 6, 3}},
                                                  {7, {"pyramid", 5, 3}},
                                                  {8, {"3-node line", 3, 1}},
                                                  {9, {"6-node triangle", 6, 2}},
                                                  {10, {"9-node quadrilateral", 9, 2}},
                                                  {11, {"10-node tetrahedron", 10, 3}},
                                                  {12, {"27-node hexahedron", 27, 3}},
                                                  {13, {"18-node prism", 18, 3}},
                                                  {14, {"14-node pyramid", 14, 3}},
                                                  {15, {"point", 1, 0}},
                                                  {16, {"8-node quadrilateral", 8, 2}},
                                                  {17, {"20-node hexahedron", 20, 3}},
                                                  {18, {"15-node prism", 15, 3}},
                                                  {19, {"13-node pyramid", 13, 3}},
                                                  {20, {"9-node triangle", 9, 2}},
                                                  {21, {"10-node triangle", 10, 2}},
                                                  {22, {"12-node triangle", 12, 2}},
                                                  {23, {"15-node triangle", 15, 2}},
                                                  {26, {"4-node line", 4, 1}},
                                                  {27, {"5-node line", 5, 1}},
                                                  {28, {"6-node line", 6, 1}},
                                                  {29, {"20-node tetrahedron", 20, 3}},
                                                  {30, {"35-node tetrahedron", 35, 3}},
                                                  {31, {"56-node tetrahedron", 56, 3}},
                                                  {92, {"64-node hexahedron", 64, 3}},
                                                  {93, {"125-node hexahedron", 125, 3}}};

class GmshReader {
 public:
  GmshReader(const std::string& bytes, const std::string& name) : in_(bytes, name), name_(name) {}

  FileMesh read() {
    while (!in_.is_at_end()) {
      const std::string_view word = in_.word();
      if (word.empty() || word.front() != '$')
        in_.fail("the name of a section, such as $Nodes, is due here; the file is damaged: write or copy it anew");
      const std::string section(word.substr(1));
      if (version_ == 0 && section != "MeshFormat" && section != "Comments")
        in_.fail(fmt::format("${} stands before $MeshFormat; this reads MSH 2.2 and 4.1: write one of them",
                             section.substr(0, 20)));
      in_.line();
      if (section == "MeshFormat")
        format();
      else if (section == "PhysicalNames")
        physical_names();
      else if (section == "Entities" && version_ == 4)
        entities();
      else if (section == "Nodes")
        version_ == 2 ? nodes_2() : nodes_4();
      else if (section == "Elements")
        version_ == 2 ? elements_2() : elements_4();
      else if (section == "PartitionedEntities")
        in_.fail("the mesh is cut into partitions; write it without them (in Gmsh: Mesh, Unpartition)");
      else
        skip(section);
      end(section);
    }
    if (version_ == 0) throw InputError(fmt::format("{} has no $MeshFormat; write it as MSH 4.1", name_));
    if (!has_elements_)
      throw InputError(fmt::format("{} has no $Elements; it is cut short: write or copy it anew", name_));
    if (mesh_.zone.empty())
      throw InputError(fmt::format(
          "{} holds no hexahedra ({}); mesh a volume with 8-node hexahedra (in Gmsh: transfinite volumes, or extrude "
          "with "
          "Layers and Recombine), and give it a physical group if there are any",
          name_,
          other_elements_.empty() ? "and no other elements" : fmt::format("but {}", fmt::join(other_elements_, ", "))));
    return std::move(mesh_);
  }

 private:
  void format() {
    const std::string_view version = in_.word();
    if (version == "2.2" || version == "2")
      version_ = 2;
    else if (version == "4.1")
      version_ = 4;
    else
      in_.fail(fmt::format("MSH version {}; this reads 2.2 and 4.1: write one of them (gmsh -format msh41)",
                           std::string(version.substr(0, 20))));
    const std::int64_t is_binary = in_.whole("the file type"), data_size = in_.whole("the data size");
    if (is_binary != 0 && is_binary != 1) in_.fail(fmt::format("file type {}; 0 is ASCII and 1 is binary", is_binary));
    if (data_size != 8)
      in_.fail(fmt::format("data size {}; this reads 8: write the mesh with a 64-bit Gmsh", data_size));
    in_.line();
    if (is_binary) {
      in_.is_binary = true;
      const auto one = in_.value<std::int32_t>("the number 1 that shows the order of bytes");
      constexpr std::int32_t swapped_one = 0x01000000;
      if (one != 1 && one != swapped_one) in_.fail("no number 1 to show the order of bytes; the file is damaged");
      in_.is_swapped = one == swapped_one;
    }
    mesh_.what = fmt::format("Gmsh {}, {}", version, is_binary ? "binary" : "ASCII");
  }

  void end(const std::string& section) {
    const std::string expected = "$End" + section;
    if (in_.word() != expected)
      in_.fail(fmt::format("{} is due here; the file is cut short or damaged: write or copy it anew",
                           expected.substr(0, 24)));
  }

  void skip(const std::string& section) {
    const std::size_t found = in_.rest().find("$End" + section);
    if (found == std::string_view::npos)
      in_.fail(fmt::format("${0} has no $End{0}; the file is cut short: write or copy it anew", section.substr(0, 20)));
    in_.go_to(in_.at() + found);
  }

  // Counts and dimensions stand as text, in binary files too.
  void physical_names() {
    const std::size_t count = in_.count(in_.whole("the number of physical names"), 3, 6, "physical names");
    for (std::size_t i = 0; i < count; ++i) {
      const std::int64_t dimension = in_.whole("a physical group's dimension"),
                         number = in_.whole("a physical group's number");
      std::string_view name = in_.line();
      const std::size_t begin = name.find('"'), last = name.rfind('"');
      if (begin == std::string_view::npos || last == begin) in_.fail("a physical group's name in quotes is due");
      names_[{dimension, number}] = name.substr(begin + 1, last - begin - 1);
    }
  }

  // The group of elements in these physical groups.
  std::int32_t group_of(int dimension, const std::vector<std::int64_t>& physical) {
    if (physical.empty()) return 0;
    const auto [found, is_new] = group_by_physical_.try_emplace({dimension, physical}, mesh_.groups.size());
    if (is_new) {
      std::vector<std::string> words;
      for (const std::int64_t number : physical) {
        const auto name = names_.find({dimension, number});
        if (name != names_.end()) words.push_back(name->second);
        words.push_back(fmt::format("{}", number));
      }
      mesh_.groups.push_back(std::move(words));
    }
    return static_cast<std::int32_t>(found->second);
  }

  void entities() {
    std::array<std::size_t, 4> counts;
    for (std::size_t& count : counts)
      count = in_.count(in_.value<std::int64_t>("a number of entities"), 4, 20, "entities");
    for (int dimension = 0; dimension < 4; ++dimension)
      for (std::size_t i = 0; i < counts[dimension]; ++i) {
        const auto tag = in_.value<std::int32_t>("an entity's number");
        for (int k = 0; k < (dimension == 0 ? 3 : 6); ++k) in_.value<double>("an entity's box");
        std::vector<std::int64_t> physical;
        const std::size_t groups =
            in_.count(in_.value<std::int64_t>("a number of physical groups"), 1, 4, "physical groups");
        for (std::size_t k = 0; k < groups; ++k)
          physical.push_back(std::abs(in_.value<std::int32_t>("a physical group's number")));
        physical_of_[{dimension, tag}] = std::move(physical);
        if (dimension == 0) continue;
        const std::size_t around =
            in_.count(in_.value<std::int64_t>("a number of bounding entities"), 1, 4, "bounding entities");
        for (std::size_t k = 0; k < around; ++k) in_.value<std::int32_t>("a bounding entity's number");
      }
  }

  void add_node(std::int64_t number, const Vec3& x) {
    if (!x.allFinite())
      in_.fail(fmt::format("node {} lies at ({}, {}, {}); coordinates must be finite", number, x.x(), x.y(), x.z()));
    mesh_.node_number.push_back(number), mesh_.node.push_back(x);
  }

  Vec3 point() {
    Vec3 x;
    for (int k = 0; k < 3; ++k) x[k] = in_.value<double>("a coordinate");
    return x;
  }

  // Whoever has read all nodes: their numbers may be in any order and have gaps.
  void sort_nodes() {
    for (std::size_t i = 0; i < mesh_.node.size(); ++i)
      node_index_.emplace_back(mesh_.node_number[i], static_cast<std::int32_t>(i));
    std::sort(node_index_.begin(), node_index_.end());
    for (std::size_t i = 1; i < node_index_.size(); ++i)
      if (node_index_[i].first == node_index_[i - 1].first)
        in_.fail(fmt::format("two nodes have the number {}; number them anew (in Gmsh: Mesh, Renumber)",
                             node_index_[i].first));
  }

  void only_once() {
    if (!mesh_.node.empty()) in_.fail("a second $Nodes; this reads one mesh a file");
  }

  void nodes_2() {
    only_once();
    const std::size_t count = in_.count(in_.whole("the number of nodes"), 4, 28, "nodes");
    in_.line();
    for (std::size_t i = 0; i < count; ++i) {
      const std::int64_t number = in_.value<std::int32_t>("a node's number");
      add_node(number, point());
    }
    sort_nodes();
  }

  void nodes_4() {
    only_once();
    const std::size_t blocks = in_.count(in_.value<std::int64_t>("the number of node blocks"), 4, 20, "node blocks");
    const std::size_t total = in_.count(in_.value<std::int64_t>("the number of nodes"), 4, 32, "nodes");
    for (int k = 0; k < 2; ++k) in_.value<std::int64_t>("the range of node numbers");
    for (std::size_t b = 0; b < blocks; ++b) {
      const auto dimension = in_.value<std::int32_t>("a node block's dimension");
      in_.value<std::int32_t>("a node block's entity");
      const auto is_parametric = in_.value<std::int32_t>("whether nodes are parametric");
      if (dimension < 0 || dimension > 3 || is_parametric < 0 || is_parametric > 1)
        in_.fail(fmt::format("a node block of dimension {}, parametric {}; the file is damaged: write it anew",
                             dimension, is_parametric));
      const std::size_t count = in_.count(in_.value<std::int64_t>("the number of a block's nodes"), 4, 32, "nodes");
      std::vector<std::int64_t> number(count);
      for (std::int64_t& n : number) n = in_.value<std::int64_t>("a node's number");
      for (const std::int64_t n : number) {
        add_node(n, point());
        for (int k = 0; k < is_parametric * dimension; ++k) in_.value<double>("a parametric coordinate");
      }
    }
    if (mesh_.node.size() != total)
      in_.fail(fmt::format("{} nodes are announced and {} are there; the file is damaged: write it anew", total,
                           mesh_.node.size()));
    sort_nodes();
  }

  const ElementType& type_of(std::int64_t type) {
    const auto found = element_types.find(static_cast<int>(type));
    if (found == element_types.end())
      in_.fail(fmt::format("element type {} is none that this knows; write 8-node hexahedra (type 5)", type));
    return found->second;
  }

  std::int32_t node_at(std::int64_t number, std::int64_t element) {
    const auto found = std::lower_bound(node_index_.begin(), node_index_.end(), std::pair(number, std::int32_t{0}));
    if (found == node_index_.end() || found->first != number)
      in_.fail(fmt::format("element {} names node {}, which the file does not have; write it anew", element, number));
    return found->second;
  }

  // `next` gives the element's nodes one by one.
  template <class Next>
  void add_element(std::int64_t number, int type_number, const ElementType& type, std::int32_t group,
                   const Next& next) {
    if (type_number == hexahedron) {
      FileMesh::Zone zone{{}, number, group};
      for (std::int32_t& n : zone.node) n = node_at(next(), number);
      mesh_.zone.push_back(zone);
    } else if (type_number == quadrilateral && group > 0) {
      FileMesh::Face face{{}, group};
      for (std::int32_t& n : face.node) n = node_at(next(), number);
      mesh_.face.push_back(face);
    } else if (type.dimension == 3) {
      in_.fail(
          fmt::format("element {} is a {}; zones are 8-node hexahedra: mesh the volume with those alone (in Gmsh: "
                      "transfinite volumes, or extrude with Layers and Recombine; Mesh.ElementOrder 1)",
                      number, type.name));
    } else {
      for (int k = 0; k < type.nodes; ++k) next();
      other_elements_.insert(fmt::format("{}s", type.name));
    }
  }

  void elements_2() {
    has_elements_ = true;
    const std::size_t total = in_.count(in_.whole("the number of elements"), 4, 8, "elements");
    in_.line();
    const auto next = [&] { return std::int64_t{in_.value<std::int32_t>("an element's node")}; };
    // A binary file has elements of one type together, behind a head; a text repeats it for each.
    for (std::size_t i = 0; i < total;) {
      std::int64_t number = 0, type_number, of_this_type = 1, tags;
      if (!in_.is_binary) number = in_.whole("an element's number");
      type_number = in_.value<std::int32_t>("an element's type");
      if (in_.is_binary) of_this_type = in_.value<std::int32_t>("a number of elements");
      tags = in_.value<std::int32_t>("a number of tags");
      const ElementType& type = type_of(type_number);
      const std::size_t tag_count = in_.count(tags, 1, 4, "tags");
      if (of_this_type < 1 || static_cast<std::size_t>(of_this_type) > total - i)
        in_.fail(fmt::format("a block of {} elements where {} are left; the file is damaged", of_this_type, total - i));
      for (std::int64_t k = 0; k < of_this_type; ++k, ++i) {
        if (in_.is_binary) number = in_.value<std::int32_t>("an element's number");
        std::vector<std::int64_t> physical;
        for (std::size_t t = 0; t < tag_count; ++t) {
          const auto tag = in_.value<std::int32_t>("a tag");
          if (t == 0 && tag != 0) physical = {std::abs(std::int64_t{tag})};
        }
        add_element(number, static_cast<int>(type_number), type, group_of(type.dimension, physical), next);
      }
    }
  }

  void elements_4() {
    has_elements_ = true;
    const std::size_t blocks =
        in_.count(in_.value<std::int64_t>("the number of element blocks"), 4, 20, "element blocks");
    const std::size_t total = in_.count(in_.value<std::int64_t>("the number of elements"), 2, 16, "elements");
    for (int k = 0; k < 2; ++k) in_.value<std::int64_t>("the range of element numbers");
    const auto next = [&] { return in_.value<std::int64_t>("an element's node"); };
    std::size_t read = 0;
    for (std::size_t b = 0; b < blocks; ++b) {
      const auto dimension = in_.value<std::int32_t>("an element block's dimension");
      const auto entity = in_.value<std::int32_t>("an element block's entity");
      const auto type_number = in_.value<std::int32_t>("an element's type");
      const ElementType& type = type_of(type_number);
      const std::size_t count =
          in_.count(in_.value<std::int64_t>("a number of elements"), static_cast<std::size_t>(type.nodes) + 1,
                    8 * (static_cast<std::size_t>(type.nodes) + 1), "elements");
      const auto physical = physical_of_.find({dimension, entity});
      const std::int32_t group = physical == physical_of_.end() ? 0 : group_of(dimension, physical->second);
      for (std::size_t i = 0; i < count; ++i) {
        const auto number = in_.value<std::int64_t>("an element's number");
        add_element(number, type_number, type, group, next);
      }
      read += count;
    }
    if (read != total)
      in_.fail(
          fmt::format("{} elements are announced and {} are there; the file is damaged: write it anew", total, read));
  }

  MeshCursor in_;
  const std::string& name_;
  int version_ = 0;
  bool has_elements_ = false;
  FileMesh mesh_;
  std::map<std::pair<std::int64_t, std::int64_t>, std::string> names_;             // by dimension and number
  std::map<std::pair<int, std::int32_t>, std::vector<std::int64_t>> physical_of_;  // by dimension and entity
  std::map<std::pair<int, std::vector<std::int64_t>>, std::size_t> group_by_physical_;
  std::vector<std::pair<std::int64_t, std::int32_t>> node_index_;  // by number
  std::set<std::string> other_elements_;
};

}  // namespace

FileMesh read_gmsh(const std::string& bytes, const std::string& name) { return GmshReader(bytes, name).read(); }

}  // namespace lockstep::continuum
