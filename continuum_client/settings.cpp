#include "continuum_client/settings.hpp"

#include <fmt/ranges.h>
#include <algorithm>
#include <cmath>
#include <set>

#include "common/checks.hpp"

namespace lockstep::continuum {
namespace {

int refined(std::uint32_t count, double refinement) {
  return std::max(1, static_cast<int>(std::lround(count * refinement)));
}

CylinderMesh cylinder_mesh(const scene::CylinderInBrick& c, double refinement, const SceneFile& file) {
  const std::string key = "continuum.cylinder_in_brick";
  if (c.zones_around() % 8 != 0)
    throw InputError(fmt::format(
        "{}: zones_around is {}; it must be a multiple of 8, so that the mesh meets the corners of the brick",
        file.where(key + ".zones_around"), c.zones_around()));
  if (!(c.hole_diameter() < c.width()))
    throw InputError(fmt::format("{}: hole_diameter {} m does not fit into a brick of width {} m; make it smaller",
                                 file.where(key + ".hole_diameter"), c.hole_diameter(), c.width()));
  if (!(c.hole_depth() < c.depth()))
    throw InputError(fmt::format("{}: hole_depth {} m does not fit into a brick of depth {} m; make it smaller",
                                 file.where(key + ".hole_depth"), c.hole_depth(), c.depth()));
  CylinderMesh m;
  m.width = c.width(), m.depth = c.depth();
  m.hole_diameter = c.hole_diameter(), m.hole_depth = c.hole_depth();
  m.zones_around = 8 * refined(c.zones_around() / 8, refinement);
  m.zones_radial = refined(c.zones_radial(), refinement);
  m.zones_hole_depth = refined(c.zones_hole_depth(), refinement);
  m.zones_below = refined(c.zones_below(), refinement);
  m.radial_growth = std::pow(c.radial_growth(), 1 / refinement);
  m.depth_growth = std::pow(c.depth_growth(), 1 / refinement);
  m.where = file.where(key);
  return m;
}

BlockMesh block_mesh(const scene::Block& b, double refinement, const SceneFile& file) {
  BlockMesh m;
  m.width_x = b.width_x(), m.width_y = b.width_y(), m.height = b.height(), m.top_z = b.top_z();
  m.zones_x = refined(b.zones_x(), refinement);
  m.zones_y = refined(b.zones_y(), refinement);
  m.zones_z = refined(b.zones_z(), refinement);
  m.where = file.where("continuum.block");
  return m;
}

Vec3 to_vector(const scene::Point& p) { return {p.x(), p.y(), p.z()}; }

FileMeshSettings file_mesh(const scene::MeshFile& f, const SceneFile& file) {
  FileMeshSettings m;
  m.path = file.resolve(f.file());
  m.scale = f.scale(), m.shift = to_vector(f.shift());
  m.merge_distance = f.merge_distance();
  m.cell_array = f.cell_array();
  m.discrete_domain.assign(f.discrete_domain().begin(), f.discrete_domain().end());
  m.interface.assign(f.interface().begin(), f.interface().end());
  m.has_free_faces = f.free_faces();
  if (f.has_hole()) m.hole = {f.hole().diameter(), f.hole().depth()};
  m.where = file.where("continuum.mesh_file");
  return m;
}

Supports to_supports(scene::Continuum::Supports s) {
  switch (s) {
    case scene::Continuum::ALL_FIXED:
      return Supports::AllFixed;
    case scene::Continuum::ROLLERS:
      return Supports::Rollers;
    case scene::Continuum::BOTTOM_FIXED:
      return Supports::BottomFixed;
    case scene::Continuum::BOTTOM_ROLLER:
      return Supports::BottomRoller;
    case scene::Continuum::QUIET:
      return Supports::Quiet;
    case scene::Continuum::QUIET_SIDES:
      return Supports::QuietSides;
  }
  throw InternalError("unknown kind of supports");
}

ZoneKind to_zone_kind(scene::Continuum::ZoneKind kind) {
  switch (kind) {
    case scene::Continuum::MIXED_DISCRETIZATION:
      return ZoneKind::MixedDiscretization;
    case scene::Continuum::B_BAR:
      return ZoneKind::BBar;
    case scene::Continuum::ONE_POINT:
      return ZoneKind::OnePoint;
  }
  throw InternalError("unknown kind of zones");
}

std::optional<MohrCoulomb> yield_law(const scene::MohrCoulomb& m, const std::string& key, const SceneFile& file) {
  if (!(m.friction_angle() > 0 || m.cohesion() > 0))
    throw InputError(
        fmt::format("{}: friction_angle and cohesion are both 0, so the ground would bear no shear at all; "
                    "give one of them",
                    file.where(key)));
  if (m.dilation_angle() > m.friction_angle())
    throw InputError(
        fmt::format("{}: dilation_angle {} degrees is above friction_angle {}: yielding would give energy "
                    "instead of taking it; give a smaller one",
                    file.where(key + ".dilation_angle"), m.dilation_angle(), m.friction_angle()));
  return mohr_coulomb(m.friction_angle() * pi / 180, m.dilation_angle() * pi / 180, m.cohesion());
}

std::optional<MohrCoulomb> yield_law(const scene::Continuum& c, const SceneFile& file) {
  if (!c.has_mohr_coulomb()) return {};
  return yield_law(c.mohr_coulomb(), "continuum.mohr_coulomb", file);
}

// What a layer or a region says, and the ground's own for the rest.
template <class Part>
Material material_of(const Part& part, const std::string& key, const scene::Continuum& c, const SceneFile& file) {
  return {elastic_moduli(part.has_youngs_modulus() ? part.youngs_modulus() : c.youngs_modulus(),
                         part.has_poisson_ratio() ? part.poisson_ratio() : c.poisson_ratio()),
          part.has_density() ? part.density() : c.density(),
          part.has_mohr_coulomb() ? yield_law(part.mohr_coulomb(), key + ".mohr_coulomb", file) : yield_law(c, file)};
}

void read_regions(const scene::Continuum& c, const SceneFile& file, Settings& r) {
  auto& mesh = std::get<FileMeshSettings>(r.mesh);
  for (int i = 0; i < c.mesh_file().region_size(); ++i) {
    const scene::Region& region = c.mesh_file().region(i);
    mesh.regions.push_back({region.name(), static_cast<std::int32_t>(r.materials.size())});
    r.materials.push_back(material_of(region, fmt::format("continuum.mesh_file.region[{}]", i), c, file));
  }
  if (mesh.regions.empty()) return;
  if (c.layer_size() > 0)
    throw InputError(
        fmt::format("{}: materials by depth (continuum.layer) and by group (mesh_file.region) are both given; "
                    "give one of the two",
                    file.where("continuum.layer[0]")));
  if (c.has_initial_stress())
    throw InputError(
        fmt::format("{}: a prescribed stress takes the weight above from continuum.layer, not from "
                    "mesh_file.region; give layers, or leave initial_stress out",
                    file.where("continuum.initial_stress")));
}

void read_layers(const scene::Continuum& c, const SceneFile& file, Settings& r) {
  for (int i = 0; i < c.layer_size(); ++i) {
    const scene::Layer& l = c.layer(i);
    const std::string where = file.where(fmt::format("continuum.layer[{}].top", i));
    const std::string name = l.name().empty() ? fmt::format("layer {}", i + 1) : l.name();
    r.layers.push_back({l.top(), static_cast<std::int32_t>(r.materials.size()), where + ": " + name});
    r.materials.push_back(material_of(l, fmt::format("continuum.layer[{}]", i), c, file));
  }
  std::stable_sort(r.layers.begin(), r.layers.end(), [](const Layer& a, const Layer& b) { return a.top > b.top; });
  for (std::size_t i = 1; i < r.layers.size(); ++i)
    if (r.layers[i].top == r.layers[i - 1].top)
      throw InputError(fmt::format("{}: two layers have their top at {} m; give one another or leave it out",
                                   r.layers[i].where, r.layers[i].top));
}

SurfaceLoad surface_load(const scene::SurfaceLoad& l, int index, const SceneFile& file) {
  SurfaceLoad load{to_vector(l.low()), to_vector(l.high()), to_vector(l.traction()),
                   l.ramp(),           l.duration(),        file.where(fmt::format("continuum.load[{}]", index))};
  if (!(load.low.array() <= load.high.array()).all())
    throw InputError(fmt::format("{}: the box from ({}) to ({}) is empty; low must be below high in each direction",
                                 load.where, fmt::join(load.low, ", "), fmt::join(load.high, ", ")));
  return load;
}

// A name that can be part of a file's name and that no block of the same kind has had.
std::string result_name(const std::string& name, const std::string& key, std::set<std::string>& taken,
                        const SceneFile& file) {
  constexpr std::size_t longest = 64;
  const bool is_plain = std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
  });
  if (name.empty() || name.size() > longest || !is_plain)
    throw InputError(fmt::format("{}: name \"{}\" becomes part of a file's name; give 1 to {} letters, digits, - or _",
                                 file.where(key + ".name"), name, longest));
  if (!taken.insert(name).second)
    throw InputError(
        fmt::format("{}: name \"{}\" is taken by another block of its kind, whose file it would overwrite; "
                    "give another",
                    file.where(key + ".name"), name));
  return name;
}

void read_results(const scene::ContinuumResults& c, const SceneFile& file, ResultSettings& r) {
  const std::string block = "continuum.results";
  r.strain = c.strain(), r.unbalanced_force = c.unbalanced_force(), r.reactions = c.reactions();
  std::set<std::string> points, sections, lines;
  for (int i = 0; i < c.point_size(); ++i) {
    const std::string key = fmt::format("{}.point[{}]", block, i);
    r.points.push_back(
        {result_name(c.point(i).name(), key, points, file), to_vector(c.point(i).near()), file.where(key + ".near")});
  }
  for (int i = 0; i < c.section_size(); ++i) {
    const std::string key = fmt::format("{}.section[{}]", block, i);
    const scene::ResultSection& s = c.section(i);
    r.sections.push_back(
        {result_name(s.name(), key, sections, file), to_vector(s.point()), to_vector(s.normal()), file.where(key)});
    if (!(r.sections.back().normal.norm() > 0))
      throw InputError(
          fmt::format("{}: normal is zero, so the plane has no direction; give one, such as "
                      "normal {{ y: 1 }}",
                      file.where(key + ".normal")));
  }
  for (int i = 0; i < c.line_size(); ++i) {
    const std::string key = fmt::format("{}.line[{}]", block, i);
    const scene::ResultLine& l = c.line(i);
    r.lines.push_back({result_name(l.name(), key, lines, file), to_vector(l.begin()), to_vector(l.end()),
                       static_cast<int>(l.points()), file.where(key)});
    if (r.lines.back().begin == r.lines.back().end)
      throw InputError(fmt::format("{}: begin and end are the same point ({}) m; give two", file.where(key + ".end"),
                                   fmt::join(r.lines.back().end, ", ")));
  }
}

void check_density_scaling(const scene::Continuum& c, const Settings& r, const SceneFile& file) {
  const char* what = nullptr;
  if (c.dynamic()) what = "continuum.dynamic is true";
  if (r.scales_density && c.has_rayleigh()) what = "continuum.rayleigh damps motion";
  if (r.scales_density && (r.supports == Supports::Quiet || r.supports == Supports::QuietSides))
    what = "continuum.supports absorb waves";
  if (what)
    throw InputError(
        fmt::format("{}: density_scaling gives nodes another inertia than they have, so that waves travel at other "
                    "speeds; it is for states of rest, but {}; leave one of them out",
                    file.where("fidelity.density_scaling"), what));
}

}  // namespace

double Settings::largest_damping() const {
  return apply_max_steps > 0 ? std::max(apply_damping, run_damping) : run_damping;
}

bool Settings::may_yield() const {
  return std::any_of(materials.begin(), materials.end(), [](const Material& m) { return m.yield_law.has_value(); });
}

Settings read_settings(const SceneFile& file) {
  const scene::Scene& s = file.scene;
  if (!s.has_continuum())
    throw InputError(
        fmt::format("{}: the scene has no continuum block, so there is nothing for continuum_client to do; "
                    "run dem_server alone, or add continuum {{ block {{ }} }}",
                    file.path.string()));
  const scene::Continuum& c = s.continuum();
  const double refinement = s.fidelity().mesh_refinement();
  Settings r;
  r.title = s.title();
  switch (c.mesh_case()) {
    case scene::Continuum::kCylinderInBrick:
      r.mesh = cylinder_mesh(c.cylinder_in_brick(), refinement, file);
      break;
    case scene::Continuum::kBlock:
      r.mesh = block_mesh(c.block(), refinement, file);
      break;
    case scene::Continuum::kMeshFile:
      r.mesh = file_mesh(c.mesh_file(), file);
      break;
    case scene::Continuum::MESH_NOT_SET:
      throw InputError(
          fmt::format("{}: the continuum has no mesh; add cylinder_in_brick {{ }}, block {{ }} or mesh_file {{ }}",
                      file.where("continuum")));
  }
  r.zone_kind = to_zone_kind(c.zone_kind());
  r.materials = {{elastic_moduli(c.youngs_modulus(), c.poisson_ratio()), c.density(), yield_law(c, file)}};
  r.is_incremental = c.route() == scene::Continuum::INCREMENTAL;
  r.has_large_strain = c.large_strain();
  if (r.has_large_strain && !r.is_incremental)
    throw InputError(
        fmt::format("{}: large_strain needs route: INCREMENTAL; the assembled operator keeps the shape that "
                    "the mesh has at the start",
                    file.where("continuum.large_strain")));
  read_layers(c, file, r);
  if (c.has_mesh_file()) read_regions(c, file, r);
  if (r.is_incremental && r.may_yield())
    throw InputError(
        fmt::format("{}: mohr_coulomb goes with route: ASSEMBLED; stored stresses know the elastic law only",
                    file.where("continuum.route")));
  if (c.has_initial_stress()) r.k0 = c.initial_stress().k0();
  if (c.has_rayleigh()) {
    const double omega = 2 * pi * c.rayleigh().frequency();
    r.mass_damping = c.rayleigh().damping_ratio() * omega;
    r.stiffness_damping = c.rayleigh().damping_ratio() / omega;
  }
  for (int i = 0; i < c.load_size(); ++i) r.loads.push_back(surface_load(c.load(i), i, file));
  r.gravity = s.gravity();
  r.initial_supports = to_supports(c.initial_supports());
  r.supports = to_supports(c.supports());
  r.is_free_direction = {c.held().x() ? 0.0 : 1.0, c.held().y() ? 0.0 : 1.0, c.held().z() ? 0.0 : 1.0};
  if (s.has_packet()) r.packet = s.packet();
  r.equilibrium.damping = c.initial_damping();
  r.equilibrium.tolerance = c.equilibrium_tolerance();
  r.equilibrium.max_cycles = c.equilibrium_max_cycles();
  r.equilibrium.step_fraction = std::min(1.0, s.fidelity().step_fraction());
  r.equilibrium.is_solved = c.equilibrium() == scene::Continuum::SOLVE;
  r.equilibrium.scales_density = s.fidelity().density_scaling();

  r.holds_baseline = s.apply().baseline() == scene::Apply::HOLD;
  r.ramp_transits = s.apply().ramp_transits();
  r.apply_damping = s.apply().damping();
  r.apply_tolerance = s.apply().tolerance();
  r.apply_max_steps = s.apply().max_steps();
  r.run_damping = s.run().continuum_damping();
  if (c.dynamic()) {
    if (s.run().has_continuum_damping() && r.run_damping > 0)
      throw InputError(fmt::format(
          "{}: continuum_damping is {}, but continuum.dynamic is true: local damping takes the same share of every "
          "force, whatever its frequency, and eats waves; leave it out or 0, and damp with continuum.rayleigh",
          file.where("run.continuum_damping"), r.run_damping));
    r.run_damping = 0;
  }
  r.duration = s.run().duration();
  r.run_tolerance = s.run().tolerance();
  r.scales_density = s.fidelity().density_scaling() && !s.has_grains();
  if (s.fidelity().density_scaling()) check_density_scaling(c, r, file);
  r.step_fraction = s.fidelity().step_fraction();
  r.is_step_strict = s.coupling().when_limit_drops() == scene::Coupling::STOP;
  r.keeps_ledger = s.coupling().ledger();
  r.stop_if_energy_error = s.coupling().stop_if_energy_error();
  r.exchange_interval = s.fidelity().exchange_interval();

  r.has_grains = s.has_grains();
  r.has_pile = s.has_pile();
  if (r.has_pile) {
    r.pile_velocity = s.fidelity().pile_velocity();
    r.pile_diameter = s.pile().diameter();
    r.pile_speed_ramp = s.pile().speed_ramp();
  }
  r.peer_timeout = s.coupling().peer_timeout();
  r.hash_interval = s.coupling().hash_interval();
  r.history_interval = s.output().history_interval();
  r.snapshot_interval = s.output().snapshot_interval();
  r.writes_zones = s.output().zones();
  if (c.has_results()) read_results(c.results(), file, r.results);
  return r;
}

}  // namespace lockstep::continuum
