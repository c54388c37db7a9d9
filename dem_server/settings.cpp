#include "dem_server/settings.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/checks.hpp"
#include "dem_server/generation.hpp"

namespace lockstep::dem {

double Container::cross_section() const { return kind == Kind::Cylinder ? pi * radius * radius : 4 * half_x * half_y; }

double Container::surface() const {
  const double around = kind == Kind::Cylinder ? 2 * pi * radius : 4 * (half_x + half_y);
  return around * (top - bottom) + 2 * cross_section();
}

double Container::volume() const { return cross_section() * (top - bottom); }

double Container::depth_inside(const Vec3& p) const {
  const double side = kind == Kind::Cylinder ? radius - std::hypot(p.x(), p.y())
                                             : std::min(half_x - std::abs(p.x()), half_y - std::abs(p.y()));
  const double nearest = std::min(side, p.z() - bottom);
  return has_lid ? std::min(nearest, top - p.z()) : nearest;
}

std::vector<WallSettings> Settings::all_walls() const {
  std::vector<WallSettings> all = walls;
  for (const PlaneSettings& plane : planes) all.push_back(plane_wall(plane));
  return all;
}

namespace {

Vec3 to_vector(const scene::Point& p) { return {p.x(), p.y(), p.z()}; }

constexpr double degrees = pi / 180;

constexpr double aligned = 1 - 1e-12;  // least cosine between directions that count as one
constexpr double centred = 1e-9;       // of the container's width: how far its middle may be off x = y = 0

// What the walls of a scene without continuum enclose. Slanted planes, cones and meshes bound nothing here: what they
// cut of the packing is pushed out of them when it is relaxed.
Container enclosed_by(const std::vector<WallSettings>& walls, const SceneFile& file) {
  constexpr double infinite = std::numeric_limits<double>::infinity();
  Vec3 low = Vec3::Constant(-infinite), high = Vec3::Constant(infinite);
  double radius = infinite;
  const auto take_cylinder = [&](const Vec3& point, const Vec3& axis, double r, Side side) {
    if (side == Side::Outside || std::abs(axis.z()) < aligned || std::hypot(point.x(), point.y()) > centred * r) return;
    radius = std::min(radius, r);
  };
  for (const WallSettings& wall : walls) {
    if (const auto* plane = std::get_if<PlaneShape>(&wall.shape)) {
      for (int axis = 0; axis < 3; ++axis) {
        if (plane->normal[axis] > aligned) low[axis] = std::max(low[axis], plane->point[axis]);
        if (plane->normal[axis] < -aligned) high[axis] = std::min(high[axis], plane->point[axis]);
      }
    } else if (const auto* cylinder = std::get_if<CylinderShape>(&wall.shape)) {
      take_cylinder(cylinder->point, cylinder->axis, cylinder->radius, cylinder->side);
    } else if (const auto* tube = std::get_if<FrustumShape>(&wall.shape); tube && tube->is_cylinder()) {
      take_cylinder(tube->point, tube->axis, tube->begin_radius, tube->side);
    }
  }
  const bool has_sides = std::isfinite(radius) || (low.head<2>().allFinite() && high.head<2>().allFinite());
  if (!has_sides || !std::isfinite(low.z()))
    throw InputError(fmt::format(
        "{}: the walls enclose nothing that a packing could fill: {}; give an upright cylinder {{ axis {{ z: 1 }} }} "
        "around x = y = 0 with the grains INSIDE or four planes across x and y, and below them a plane {{ normal {{ z: "
        "1 "
        "}} }}, or grains.packing.box",
        file.where("grains.packing"), has_sides ? "they have no bottom" : "they have no sides"));
  Container c;
  if (std::isfinite(radius)) {
    c.kind = Container::Kind::Cylinder;
    c.radius = radius;
  } else {
    c.kind = Container::Kind::Box;
    c.half_x = 0.5 * (high.x() - low.x());
    c.half_y = 0.5 * (high.y() - low.y());
    for (int axis = 0; axis < 2; ++axis)
      if (std::abs(low[axis] + high[axis]) > centred * (high[axis] - low[axis]))
        throw InputError(
            fmt::format("{0}: the walls across {1} stand at {1} = {2} and {3} m; the packing's box is centred: "
                        "move both to the same distance from {1} = 0",
                        file.where("grains.packing"), "xy"[axis], low[axis], high[axis]));
  }
  const double fill_height = file.scene.grains().packing().fill_height();
  c.bottom = low.z();
  c.top = fill_height > 0 ? c.bottom + fill_height : std::isfinite(high.z()) ? high.z() : 0.0;
  c.has_lid = c.top == high.z();
  if (!(c.top > c.bottom) || c.top > high.z() || !(c.half_x >= 0 && c.half_y >= 0))
    throw InputError(
        fmt::format("{} = {} m leaves nothing to fill: the bottom is at z = {} m, the fill level at {} m, the lid at "
                    "{} m; give a height "
                    "between",
                    file.where("grains.packing.fill_height"), fill_height, c.bottom, c.top, high.z()));
  return c;
}

// `walls` are the scene's, planes included.
Container container_of(const SceneFile& file, const std::vector<WallSettings>& walls) {
  const scene::Scene& scene = file.scene;
  const scene::Packing& packing = scene.grains().packing();
  Container c;
  if (scene.continuum().has_cylinder_in_brick()) {
    const auto& mesh = scene.continuum().cylinder_in_brick();
    // The hole is a polygon: its flats stand nearer to the axis than its corners.
    const double around = std::max(8.0, 8 * std::round(mesh.zones_around() * scene.fidelity().mesh_refinement() / 8));
    c.kind = Container::Kind::Cylinder;
    c.radius = 0.5 * mesh.hole_diameter() * std::cos(pi / around);
    c.bottom = -mesh.hole_depth();
    c.top = 0;
  } else if (scene.continuum().mesh_file().has_hole()) {
    const auto& hole = scene.continuum().mesh_file().hole();
    c.kind = Container::Kind::Cylinder;
    c.radius = 0.5 * hole.diameter();
    c.bottom = -hole.depth();
    c.top = 0;
  } else if (packing.has_box()) {
    c.kind = Container::Kind::Box;
    c.half_x = 0.5 * packing.box().width_x();
    c.half_y = 0.5 * packing.box().width_y();
    c.bottom = packing.box().bottom();
    c.top = c.bottom + packing.box().fill_height();
  } else {
    c = enclosed_by(walls, file);
  }
  return c;
}

// A pile among grains alone: z = 0 is their surface, and the pile's whole way stays inside.
void check_pile_alone(const SceneFile& file, const PileSettings& pile, const Container& c) {
  const double width = 2 * (c.kind == Container::Kind::Cylinder ? c.radius : std::min(c.half_x, c.half_y));
  const double final_depth = pile.embedment + pile.penetration;
  if (std::abs(c.top) > centred * (c.top - c.bottom))
    throw InputError(
        fmt::format("{} = {} m is counted from z = 0, but the packing is filled to z = {:.6g} m; move its walls by "
                    "{:.6g} m, or change the "
                    "fill height",
                    file.where("pile.embedment"), pile.embedment, c.top, -c.top));
  if (2 * pile.shape.radius >= width)
    throw InputError(fmt::format("{} = {} m leaves no room in a container of {} m; give a thinner pile or wider walls",
                                 file.where("pile.diameter"), 2 * pile.shape.radius, width));
  if (final_depth >= -c.bottom)
    throw InputError(fmt::format(
        "{} = {} m and pile.penetration bring the tip to {} m, which is not above the bottom at {} m; give less "
        "penetration or a deeper bottom",
        file.where("pile.embedment"), pile.embedment, -final_depth, c.bottom));
}

PackingSettings packing_of(const SceneFile& file, const std::vector<WallSettings>& walls) {
  const scene::Packing& from = file.scene.grains().packing();
  PackingSettings to;
  const double scale = file.scene.fidelity().particle_scale();
  to.count = static_cast<std::uint32_t>(std::lround(from.count() / (scale * scale * scale)));
  to.radius = from.radius() * scale;
  to.radius_ratio = from.radius_ratio();
  to.porosity = from.porosity();
  to.match_continuum_density = from.bulk_density() == scene::Packing::MATCH_CONTINUUM;
  to.cube_grains = from.cube_grains();
  to.cube_pressure = from.cube_pressure();
  to.container = container_of(file, walls);
  return to;
}

PileSettings pile_of(const SceneFile& file) {
  const scene::Pile& from = file.scene.pile();
  PileSettings to;
  to.shape.radius = 0.5 * from.diameter();
  to.shape.tip = from.tip() == scene::Pile::CONE ? PileTip::Cone : PileTip::Flat;
  to.shape.cone_angle = from.cone_angle() * degrees;
  to.embedment = from.embedment();
  to.friction = from.friction();
  to.penetration = from.penetration() * from.diameter();
  to.velocity = file.scene.fidelity().pile_velocity();
  to.speed_ramp = from.speed_ramp();
  return to;
}

LatticeSettings lattice_of(const scene::Lattice& from) {
  return {from.count_x(),      from.count_y(),      from.count_z(),      from.radius(),
          from.overlap(),      from.bottom(),       from.fix_top(),      from.pulse_velocity(),
          from.pulse_length(), from.pulse_center(), from.side_overlap(), from.hold_spins()};
}

MeasureSettings measure_of(const SceneFile& file) {
  const scene::Measure& from = file.scene.measure();
  MeasureSettings to;
  to.interval = from.interval();
  to.fabric = from.fabric();
  to.force_network = from.force_network();
  to.energy_by_kind = from.energy_by_kind();
  for (const scene::MeasureBall& ball : from.ball()) {
    if (ball.follows_pile() && !file.scene.has_pile())
      throw InputError(fmt::format("{} = true, but the scene has no pile; leave the key out, or give the scene a pile",
                                   file.where(fmt::format("measure.ball[{}].follows_pile", to.balls.size()))));
    to.balls.push_back({{to_vector(ball.center()), ball.radius()}, ball.follows_pile()});
  }
  for (const scene::MeasureGrid& grid : from.grid()) {
    const std::string key = fmt::format("measure.grid[{}]", to.grids.size());
    if (grid.has_low() != grid.has_high())
      throw InputError(
          fmt::format("{} has only one of its corners low and high; give both, or none for all that the "
                      "packing fills",
                      file.where(key)));
    std::optional<Box> box;
    if (grid.has_low()) {
      box = Box{to_vector(grid.low()), to_vector(grid.high())};
      for (int axis = 0; axis < 3; ++axis)
        if (!(box->low[axis] < box->high[axis]))
          throw InputError(fmt::format("{}: high.{} = {} m is not above low.{} = {} m; give a box with a volume",
                                       file.where(key), "xyz"[axis], box -> high[axis], "xyz"[axis], box -> low[axis]));
    }
    to.grids.push_back({grid.cell(), box, grid.points(), file.where(key)});
  }
  for (const scene::TrackedGrain& grain : from.tracked()) {
    const std::string key = fmt::format("measure.tracked[{}]", to.tracked.size());
    if (grain.which_case() == scene::TrackedGrain::WHICH_NOT_SET)
      throw InputError(fmt::format("{} says of no grain; give near {{ x y z }}, or grain", file.where(key)));
    TrackedSettings tracked;
    if (grain.has_grain()) tracked.grain = grain.grain();
    tracked.near = to_vector(grain.near());
    tracked.where = file.where(key);
    to.tracked.push_back(std::move(tracked));
  }
  return to;
}

PlaneShape plane_of(const scene::Plane& from, const std::string& where) {
  PlaneShape plane{to_vector(from.point()), to_vector(from.normal())};
  check(plane, where);
  return plane;
}

Side side_of(scene::GrainsSide side) { return side == scene::INSIDE ? Side::Inside : Side::Outside; }

// A cylinder with a length is a frustum of two equal radii.
WallShape cylinder_of(const scene::Cylinder& from, const std::string& where) {
  const Vec3 point = to_vector(from.point()), axis = to_vector(from.axis());
  if (from.length() > 0) {
    FrustumShape tube{point, axis, from.radius(), from.radius(), from.length(), side_of(from.side())};
    check(tube, where + "cylinder.");
    return tube;
  }
  CylinderShape cylinder{point, axis, from.radius(), side_of(from.side())};
  check(cylinder, where);
  return cylinder;
}

WallShape cone_of(const scene::Cone& from, const std::string& where) {
  FrustumShape cone{to_vector(from.point()), to_vector(from.axis()), from.begin_radius(),
                    from.end_radius(),       from.length(),          side_of(from.side())};
  check(cone, where + "cone.");
  return cone;
}

WallShape mesh_of(const scene::Mesh& from, const SceneFile& file) {
  return MeshShape{
      std::make_shared<const TriangleMesh>(read_stl(file.resolve(from.file()), from.scale(), to_vector(from.shift()))),
      Vec3::Zero()};
}

WallSettings wall_of(const SceneFile& file, int index) {
  const scene::Wall& from = file.scene.wall(index);
  const std::string key = fmt::format("wall[{}]", index);
  const std::string where = file.where(key) + ".";
  WallSettings wall;
  wall.name = from.name().empty() ? fmt::format("wall {}", index + 1) : from.name();
  switch (from.shape_case()) {
    case scene::Wall::kPlane:
      wall.shape = plane_of(from.plane(), where);
      break;
    case scene::Wall::kCylinder:
      wall.shape = cylinder_of(from.cylinder(), where);
      break;
    case scene::Wall::kCone:
      wall.shape = cone_of(from.cone(), where);
      break;
    case scene::Wall::kMesh:
      wall.shape = mesh_of(from.mesh(), file);
      break;
    case scene::Wall::SHAPE_NOT_SET:
      throw InputError(
          fmt::format("{}: the wall has no shape; give one of plane, cylinder, cone and mesh", file.where(key)));
  }
  wall.velocity = to_vector(from.velocity());
  wall.spin = to_vector(from.spin());
  wall.speed_ramp = from.speed_ramp();
  if (from.has_spin_center()) wall.center = to_vector(from.spin_center());
  if (from.has_friction()) wall.friction = from.friction();
  if (from.has_servo()) {
    const scene::WallServo& servo = from.servo();
    wall.servo = WallServoSettings{
        servo.pressure(),    servo.area(), servo.top_speed(), servo.closing(), to_vector(servo.direction()),
        servo.balance_only()};
  }
  return wall;
}

// Keys that matter from Apply on only, so that a packing may be taken whatever they are: motion and friction of what
// stands still and is smooth in Balance.
bool is_later_key(const std::string& key) {
  static const std::vector<std::string> keys = {"grains.interface_friction", "grains.wall_friction", "pile.friction",
                                                "pile.penetration", "pile.speed_ramp"};
  static const std::vector<std::string> of_walls = {".name",        ".velocity", ".speed_ramp",        ".spin",
                                                    ".spin_center", ".friction", ".servo.balance_only"};
  return std::find(keys.begin(), keys.end(), key) != keys.end() ||
         (key.starts_with("wall[") &&
          std::any_of(of_walls.begin(), of_walls.end(), [&](const std::string& end) { return key.ends_with(end); }));
}

std::string in_words(const google::protobuf::Message& block, const google::protobuf::FieldDescriptor& field) {
  using Field = google::protobuf::FieldDescriptor;
  const google::protobuf::Reflection& values = *block.GetReflection();
  switch (field.cpp_type()) {
    case Field::CPPTYPE_DOUBLE:
      return fmt::format("{}", values.GetDouble(block, &field));
    case Field::CPPTYPE_UINT32:
      return fmt::format("{}", values.GetUInt32(block, &field));
    case Field::CPPTYPE_UINT64:
      return fmt::format("{}", values.GetUInt64(block, &field));
    case Field::CPPTYPE_BOOL:
      return values.GetBool(block, &field) ? "true" : "false";
    case Field::CPPTYPE_ENUM:
      return std::string(values.GetEnum(block, &field)->name());
    case Field::CPPTYPE_STRING:
      return fmt::format("\"{}\"", values.GetString(block, &field));
    default:
      LOCKSTEP_ASSERT(false, "{} is of a type that no scene has", field.full_name());
      return "";
  }
}

// The keys of a block that is there, defaults included, in the order of scene.proto.
void add_keys(const google::protobuf::Message& block, const std::string& name, SceneKeys& keys) {
  const google::protobuf::Descriptor& type = *block.GetDescriptor();
  const google::protobuf::Reflection& values = *block.GetReflection();
  for (int f = 0; f < type.field_count(); ++f) {
    const google::protobuf::FieldDescriptor& field = *type.field(f);
    const std::string key = name + "." + std::string(field.name());
    if (is_later_key(key)) continue;
    if (field.is_repeated())
      for (int i = 0; i < values.FieldSize(block, &field); ++i)
        add_keys(values.GetRepeatedMessage(block, &field, i), fmt::format("{}[{}]", key, i), keys);
    else if (field.cpp_type() != google::protobuf::FieldDescriptor::CPPTYPE_MESSAGE)
      keys.emplace_back(key, in_words(block, field));
    else if (values.HasField(block, &field))
      add_keys(values.GetMessage(block, &field), key, keys);
  }
}

SceneKeys packing_keys_of(const scene::Scene& scene) {
  SceneKeys keys = {{"seed", fmt::format("{}", scene.seed())}, {"gravity", fmt::format("{}", scene.gravity())}};
  keys.emplace_back("fidelity.pebbles_per_clump", fmt::format("{}", scene.fidelity().pebbles_per_clump()));
  keys.emplace_back("fidelity.particle_scale", fmt::format("{}", scene.fidelity().particle_scale()));
  add_keys(scene.grains(), "grains", keys);
  if (scene.has_pile()) add_keys(scene.pile(), "pile", keys);
  for (int i = 0; i < scene.plane_size(); ++i) add_keys(scene.plane(i), fmt::format("plane[{}]", i), keys);
  for (int i = 0; i < scene.wall_size(); ++i) add_keys(scene.wall(i), fmt::format("wall[{}]", i), keys);
  add_keys(scene.balance(), "balance", keys);
  return keys;
}

}  // namespace

Settings make_settings(const SceneFile& file) {
  const scene::Scene& scene = file.scene;
  if (!scene.has_grains())
    throw InputError(fmt::format("{}: the scene has no `grains` block, so dem_server has nothing to model; add one",
                                 file.path.string()));
  const scene::Grains& grains = scene.grains();
  Settings s;
  s.title = scene.title();
  s.is_alone = !scene.has_continuum();
  s.gravity = scene.gravity();
  s.seed = scene.seed();

  s.material.contact_modulus = grains.contact_modulus();
  s.material.stiffness_ratio = grains.stiffness_ratio();
  s.material.friction = grains.friction();
  s.material.damping_ratio = damping_ratio(grains.restitution());
  s.density = grains.density();
  s.interface_friction = grains.interface_friction();
  s.wall_friction = grains.wall_friction();
  s.facet_stiffness_factor = grains.facet_stiffness_factor();
  s.elongation = grains.elongation();
  const auto pebbles = scene.fidelity().pebbles_per_clump();
  s.pebbles = static_cast<int>(pebbles ? pebbles : grains.pebbles());

  for (int i = 0; i < scene.wall_size(); ++i) s.walls.push_back(wall_of(file, i));
  for (std::size_t i = 0; i < s.walls.size(); ++i)
    if (s.walls[i].servo) check_servo(s.walls, i, file.where(fmt::format("wall[{}]", i)) + ".");
  for (const scene::Plane& p : scene.plane()) {
    const Vec3 normal = to_vector(p.normal());
    if (normal.norm() == 0)
      throw InputError(fmt::format("{}: plane.normal = 0 0 0 has no direction; give the side where the grains are",
                                   file.where("plane.normal")));
    s.planes.push_back({to_vector(p.point()), normal.normalized(), Vec3::Zero()});
  }

  if (grains.has_packing()) {
    s.packing = packing_of(file, s.all_walls());
    const PorosityRange range = reachable_porosity(s.pebbles, s.elongation);
    if (s.packing->porosity < range.low || s.packing->porosity > range.high)
      throw InputError(fmt::format(
          "{} = {}: grains of {} pebbles and elongation {} pack to porosities of {:.3f} to {:.3f}; give one of these, "
          "or "
          "another number of pebbles",
          file.where("grains.packing.porosity"), s.packing->porosity, s.pebbles, s.elongation, range.low, range.high));
  }
  if (grains.has_lattice()) s.lattice = lattice_of(grains.lattice());
  if (scene.has_packet()) s.packet = scene.packet();
  for (const scene::Grain& g : grains.grain())
    s.grains.push_back({to_vector(g.center()), to_vector(g.velocity()), to_vector(g.spin()), g.radius(), g.is_clump()});
  if (scene.has_pile()) s.pile = pile_of(file);
  if (s.pile && s.packing && s.is_alone) check_pile_alone(file, *s.pile, s.packing->container);
  if (grains.packing().has_box()) {
    const Container& box = s.packing->container;
    const auto is_bottom = [&](const PlaneSettings& p) {
      return p.normal.z() > aligned && p.point.z() >= box.bottom - centred * (box.top - box.bottom);
    };
    if (s.is_alone && std::none_of(s.planes.begin(), s.planes.end(), is_bottom))
      s.planes.push_back({{0, 0, box.bottom}, Vec3::UnitZ(), Vec3::Zero()});
    s.planes.push_back({{-box.half_x, 0, 0}, Vec3::UnitX(), Vec3::Zero()});
    s.planes.push_back({{box.half_x, 0, 0}, -Vec3::UnitX(), Vec3::Zero()});
    s.planes.push_back({{0, -box.half_y, 0}, Vec3::UnitY(), Vec3::Zero()});
    s.planes.push_back({{0, box.half_y, 0}, -Vec3::UnitY(), Vec3::Zero()});
  }

  const scene::Balance& balance = scene.balance();
  const bool has_target = !s.is_alone || s.pile;  // grains alone have no rings, and a tip only with a pile
  s.balance = {balance.servo() == scene::Balance::RINGS && has_target,
               balance.damping(),
               balance.tolerance(),
               balance.servo_tolerance(),
               balance.traction_tolerance(),
               balance.max_servo_travel(),
               balance.max_cycles(),
               balance.has_friction() ? balance.friction() : grains.friction()};
  s.has_apply = scene.apply().max_steps() > 0;
  s.apply_damping = scene.apply().damping();
  s.run_damping = scene.run().damping();
  s.run_duration = scene.run().duration();
  s.step_damping = std::max(s.run_damping, s.has_apply ? s.apply_damping : 0.0);

  s.step_fraction = scene.fidelity().step_fraction();
  s.exchange_interval = scene.fidelity().exchange_interval();
  s.transfers_moment = scene.coupling().moment_transfer() == scene::Coupling::EXACT;
  s.keeps_ledger = scene.coupling().ledger();
  s.stop_if_energy_error = scene.coupling().stop_if_energy_error();
  s.history_interval = scene.output().history_interval();
  s.snapshot_interval = scene.output().snapshot_interval();
  s.peer_timeout = scene.coupling().peer_timeout();
  s.write_particles = scene.output().particles();
  s.write_contacts = scene.output().contacts();
  s.measure = measure_of(file);
  s.packing_keys = packing_keys_of(scene);
  return s;
}

}  // namespace lockstep::dem
