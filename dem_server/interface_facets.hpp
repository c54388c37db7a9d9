// The boundary between grains and zones: 4-node facets that the continuum moves and that grains press on (paper,
// section 2.2.1). What grains feel and what nodes get is the same force with opposite sign, each step, to round-off.
//
//          c  centre of a pebble, radius R     contact point  x_C = x_B + (R - U/2) n            (eq. 1)
//         /|\                                   overlap        U = R - d                          (eq. 1)
//        / | \  d = |c - p|                     velocity       V = sum N_j v_j - v_grain(x_C)     (eqs 4, 6, 7)
//   3 ---- p ---- 2   p(xi, eta) closest point  force          k_n U, shear spring, friction      (eqs 3, 8-11)
//    \    (+)    /    n from grain to facet     node j gets    N_j(xi, eta) x force on the facet  (eq. 13)
//     0 ------- 1     (+) facet normal, into the grains         k_n = facet_stiffness_factor E* 2 R_eq
//
// ONE CONTACT ON A SMOOTH SURFACE. The closest points of a sphere on each facet alone are too many: over a shared edge
// of a plane there would be two, over a node four, and force and stiffness would double there. Two rules make them one:
//
//   1. Local minima only. A contact is a local minimum of the distance to the WHOLE surface. A closest point on an edge
//      or a node of a facet counts only if no facet that shares the edge or node comes closer; of equals one stays. So
//      a convex corner gives one contact, whose normal turns with the sphere, and a plane gives one wherever the sphere
//      rolls.
//   2. One push. At a concave edge two minima remain, one on either facet. If their normals differ by less than
//      merge_angle, the edge stands for a smooth curved surface (the hole's side: 11 degrees between 32 facets), and
//      they become one contact: its overlap and normal are length and direction of the SHORTEST PUSH t that frees the
//      sphere of all of them,
//          |t| -> min  with  t . n_i >= U_i,     t = sum lambda_i n_i, lambda >= 0,
//      and facet i takes the share lambda_i / sum lambda. Where U_1 cos theta >= U_2, theta the angle between them,
//      that is facet 1 alone, and so it is before the foot on facet 2 leaves that facet: the contact goes from facet to
//      facet over a band U theta wide in which the normal turns. t is the way from the centre to a convex set, so it
//      changes by no more than the centre moves, and |t|^2 / 2 is its potential: the force neither jumps nor pumps
//      energy. At a right angle t is what two contacts give; beyond merge_angle (the rim where side meets bottom) they
//      are two, with a spring each.
//
//   Rejected: the sum of all minima doubles the stiffness at shallow edges and jumps where a foot leaves its facet; the
//   deepest one alone has a potential but its direction jumps by theta, 20 % of the force across the edge, where every
//   grain of the ring comes to rest; weights by place on the facet are continuous but pump energy; a fillet of fixed
//   radius adds overlap to grains that have none; smoothed (Phong) normals are not the surface's own.
//
// THE SHEAR SPRING belongs to pebble and contact. When a contact moves over an edge, the neighbour takes the spring
// over, and contact_force() turns it with the normal.
//
// SIDES. On a face the side is the sign of (c - p) . facet normal; on an edge or node shared by facets that disagree,
// of the sum of normals (weighted with angles at a node: Baerentzen and Aanaes, IEEE TVCG 11, 2005). A centre on the
// wrong side by less than R is a deep overlap U = R + |d| and is pushed back through its closest point; deeper than R/2
// it is counted as tunnelled. Open edges have no wrong side.
//
// COLLAR. Grains heave above the ground surface. Along the highest open edges the facets go on straight upwards by
// collar_height; the collar's upper nodes are virtual: they move with the real node below and hand their forces to it,
// and to the moment that eq. (13) neglects comes that of lifting the force down to the edge.
//
// MOMENTS. A contact's force acts at x_C, half an overlap above (or below) the facet, and eq. (13) puts it down to the facet: the
// moment of that lever a, M = a x F, is dropped, and so is that of a collar's lift. With transfers_moment the facet's nodes
// get it as forces that add up to none,
//   f_j = (I^-1 M) x r_j,   r_j = x_j - mean x,   I = sum |r_j|^2 - r_j r_j^T:   sum f_j = 0, sum r_j x f_j = M,
// the smallest ones that do (least squares). For the work to match, the contact sees the velocity at x_C of a facet that turns:
//   v = sum N_j v_j + w x a,   w = I^-1 sum r_j x v_j,
// since then sum f_j . v_j = w . M = F . (w x a). Both sides' moments then balance as their forces do. Along the normal nothing changes.
//
// WHICH PEBBLES. Each pebble keeps the facets nearer than a skin, and how far it may move before any other could be
// touched; those that can touch one before the pair lists are renewed are candidates, and the step looks at no others.
// The result does not depend on the lists.
//
// THREADS own bodies. Each finds the contacts of its pebbles and loads its bodies; the nodes, which many contacts share,
// and the totals are summed afterwards, in the order of pebbles.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/hash.hpp"
#include "common/instructions.hpp"
#include "common/parallel.hpp"
#include "common/shape_functions.hpp"
#include "common/vectors.hpp"
#include "dem_server/contact_law.hpp"
#include "dem_server/facet_kernel.hpp"
#include "dem_server/particles.hpp"
#include "dem_server/travel.hpp"
#include "dem_server/wall_candidates.hpp"

namespace lockstep::dem {

// ---------------------------------------------------------------------------------- closest point on one facet

enum class FacetFeature : std::uint8_t { Face, Edge, Vertex };

struct FacetPoint {
  double xi = 0;
  double eta = 0;
  std::array<double, 4> weights{};   // N_j(xi, eta), in [0, 1], sum 1
  Vec3 point = Vec3::Zero();         // sum N_j x_j [m]
  double distance = 0;               // |c - point| [m]
  Vec3 facet_normal = Vec3::Zero();  // unit, of the bilinear surface at the point
  FacetFeature feature = FacetFeature::Face;
  std::int32_t feature_index = 0;  // edge k joins nodes k and k+1; vertex k is node k
};

// The point of the bilinear facet closest to `center`, warped or not, edges included. Newton's method on (xi, eta) held
// inside
// [-1, 1]^2, in closed form for parallelograms; where the distance may have several minima (strong warp, or far away)
// the edges are searched too. Same bits for the same input. A degenerate facet (zero area) has an arbitrary
// facet_normal.
FacetPoint closest_point(const FacetCorners& corners, const Vec3& center);

// ---------------------------------------------------------------------------------------------------- the surface

struct FacetMaterial {
  double contact_modulus = 94e6;      // E* of the grains [Pa]
  double stiffness_ratio = 8;         // k_n / k_s [-]
  double friction = 1;                // grain against zone (paper, Table 1) [-]
  double damping_ratio = 0;           // of the normal dashpot, against the grain's mass [-]
  double facet_stiffness_factor = 2;  // over the stiffness of a pair of such grains; 2 matches waves [-]
  bool transfers_moment = false;      // nodes get the moment too that eq. (13) drops

  double normal_stiffness(double equivalent_radius) const {
    return facet_stiffness_factor * contact_modulus * 2 * equivalent_radius;
  }
};

FacetKernels facet_kernels(InstructionSet instructions);

struct FacetTotals {
  std::size_t contacts = 0;
  Vec3 particle_force = Vec3::Zero();   // sum of the facets' forces on the grains [N]
  Vec3 particle_moment = Vec3::Zero();  // of these about the origin, at the contact points [N m]
  double normal_force = 0;              // sum of |F_n| [N]
  double neglected_moment = 0;          // sum of |F_s| U/2, which eq. 13 drops; 0 where it is transferred [N m]
  double elastic_energy = 0;            // [J]
  double slip_work = 0;                 // taken out by sliding in this step [J]
  double dashpot_work = 0;              // taken out by dashpots in this step [J]
  double power = 0;                     // of the facets on the grains, sum of F_grain . v_facet [W]
  double max_overlap = 0;               // largest U / R of a pebble
  std::size_t tunnelled = 0;            // pebbles whose centre is deeper than R/2 behind the surface
};

// One contact: a pebble and one facet, or the few facets that meet at a shallow concave edge. As files and tests see it;
// inside it takes less room.
struct FacetContact {
  static constexpr std::size_t max_shares = 3;
  struct Share {
    std::int32_t facet = -1;          // collar facets count on after the real ones
    double share = 0;                 // w_i; the shares of a contact sum to 1
    std::array<double, 4> weights{};  // N_j at the foot on this facet
  };
  std::int32_t pebble = -1;
  std::int32_t body = -1;
  std::int32_t share_count = 0;
  std::array<Share, max_shares> shares{};  // nearest facet first
  Vec3 point = Vec3::Zero();               // x_C [m]
  Vec3 foot = Vec3::Zero();                // on the surface, sum w_i p_i [m]
  double overlap = 0;                      // U [m]
  double normal_stiffness = 0;             // [N/m]
  double shear_stiffness = 0;              // [N/m]
  Vec3 force = Vec3::Zero();               // on the grain [N]
  ContactHistory history;                  // normal from grain to facet

  ContactView view() const {
    return {body, -1, point, history.normal, overlap, normal_stiffness, shear_stiffness, force};
  }
};

// Everything that decides the future of the facets.
struct FacetState {
  Vec3s positions, offsets, velocity, offset_velocity;
  std::vector<FacetContact> contacts;
};

class InterfaceFacets {
 public:
  static constexpr double merge_angle =
      pi / 3;  // between the hole's coarsest side (8 facets, pi/4) and its rim (pi/2) [rad]

  // No facets: nothing is computed.
  InterfaceFacets() = default;
  // `facets` index `nodes`; their order gives the normal into the grains. `collar_height` 0: no collar [m]. InputError
  // when an index is out of range or a facet has no area.
  InterfaceFacets(const Vec3s& nodes, const std::vector<std::array<std::int32_t, 4>>& facets, double collar_height,
                  FacetKernels kernels = facet_kernels(best_instructions()));

  // Continuum's positions: x += v dt, per component and in this order, as the continuum does it, and v becomes the
  // velocity for the contact law. One velocity a node. [m/s], [s]
  void advance(std::span<const Vec3> velocity, double dt);
  // The same motion in equal parts, part 1 .. parts; the last ends where advance() would, to the bit.
  void advance_part(std::span<const Vec3> velocity, double dt, std::uint32_t part, std::uint32_t parts);
  // Velocity for the contact law without motion [m/s].
  void set_velocity(std::span<const Vec3> velocity);
  // The servo's part: offset += v dt, and v adds to the velocity for the contact law.
  void move_offsets(std::span<const Vec3> velocity, double dt);
  // Puts the offsets in place, with an offset velocity of zero [m].
  void set_offsets(std::span<const Vec3> offsets);

  const Vec3s& positions() const { return position_; }  // continuum's, t_n [m]
  const Vec3s& offsets() const { return offset_; }      // contact geometry = position + offset [m]
  const Vec3s& velocity() const { return velocity_; }   // continuum's, t_{n-1/2} [m/s]
  std::uint64_t position_hash() const;                  // of positions(), in order; offsets do not count

  std::size_t node_count() const { return position_.size(); }
  std::size_t facet_count() const { return real_facet_count_; }
  std::size_t collar_count() const { return facets_.size() - real_facet_count_; }
  const std::array<std::int32_t, 4>& nodes_of(std::size_t facet) const { return facet_nodes_[facet]; }
  // Contact geometry; collar facets follow the real ones.
  FacetCorners corners(std::size_t facet) const;
  Vec3 area_vector(std::size_t facet) const { return facet_area_vector(corners(facet)); }  // into the grains [m2]
  Vec3 center(std::size_t facet) const { return interpolate(bilinear_weights(0, 0), corners(facet)); }

  // Contacts at t_n: adds force and torque to the bodies and fills the outputs below. `dt` is the step over which shear
  // springs have grown; 0 leaves them as they are but for the turn with the normal. [s]
  FacetTotals compute(Particles& particles, const FacetMaterial& material, double dt, const TravelLimits& limits = {},
                      Team& team = Team::alone(), const Partition& partition = {});

  // Of the last compute(). Forces are ON THE CONTINUUM; a collar facet's count for the facet below it.
  const Vec3s& nodal_force() const { return nodal_force_; }                        // per node [N]
  const Vec3s& facet_force() const { return facet_force_; }                        // per facet [N]
  const std::vector<double>& node_stiffness() const { return node_stiffness_; }    // per node, sum of k_n N_j [N/m]
  const std::vector<double>& facet_stiffness() const { return facet_stiffness_; }  // per facet, sum of k_n [N/m]
  std::size_t tunnelled() const { return tunnelled_; }
  std::size_t contact_count() const { return contacts_.size(); }
  std::vector<FacetContact> contacts() const;  // by pebble, then by depth
  template <class Visitor>
  void for_each_contact(Visitor&& visit) const {
    for (const Contact& contact : contacts_) visit(contact.view());
  }

  // Positions, offsets, velocities and springs.
  void hash(Hash& h) const;
  // Forgets the springs and the candidate lists; needed after pebbles were renumbered.
  void clear_history();
  FacetState state() const { return {position_, offset_, velocity_, offset_velocity_, contacts()}; }
  // InputError when the sizes do not fit this surface.
  void restore(const FacetState& state);

 private:
  struct Facet {
    std::array<std::int32_t, 4> real_nodes{};  // the nodes that a force counts for
    std::array<bool, 4> is_open_edge{};        // edge k is used by no other facet
    std::int32_t below = -1;                   // the facet that a force counts for: itself, or the one under the collar
  };
  struct Sphere {
    Vec3 center = Vec3::Zero();  // [m]
    double radius = 0;           // [m]
  };
  // Which facets a pebble may touch while it moves less than `reach` says.
  struct Neighborhood {
    Vec3 center = Vec3::Zero();  // where it was listed [m]
    double reach = -1;           // distance to the nearest facet not listed + travel then; negative: not listed [m]
    std::vector<std::int32_t> facets;
  };
  // The foot of one pebble on one facet.
  struct Foot {
    FacetPoint at;
    std::int32_t facet = -1;
    double distance = 0;         // signed [m]
    Vec3 normal = Vec3::Zero();  // unit, into the grains
    bool is_taken = false;
  };
  using Share = FacetContact::Share;
  // A contact without its shares: those stand one after the other in an array of their own.
  struct Contact {
    ContactHistory history;
    std::int32_t pebble = -1, body = -1;
    std::int32_t first_share = 0, share_count = 0;
    Vec3 point = Vec3::Zero(), force = Vec3::Zero();   // [m], [N]
    double overlap = 0;                                // [m]
    double normal_stiffness = 0, shear_stiffness = 0;  // [N/m]

    ContactView view() const {
      return {body, -1, point, history.normal, overlap, normal_stiffness, shear_stiffness, force};
    }
  };
  // The shortest push that frees a pebble of the facets of one contact, whose shares are the last ones found.
  struct Push {
    double overlap;  // its length [m]
    Vec3 normal;     // unit, from grain to facet
    std::int32_t share_count;
  };
  // A pebble that touches.
  struct Toucher {
    std::int32_t pebble, body;
    Vec3 center;    // [m]
    double radius;  // [m]
    ContactMaterial law;
    double time_step;  // [s]
    bool transfers_moment;
    std::size_t first_previous, end_previous;  // its contacts of the last step
  };
  // What a contact adds to the totals beside its force.
  struct Sums {
    double normal_force, neglected_moment, elastic_energy, slip_work, dashpot_work, power, overlap_ratio;
  };
  // What contacts put on a node or a facet, in half a cache line.
  struct alignas(32) Load {
    Vec3 force = Vec3::Zero();  // [N]
    double stiffness = 0;       // [N/m]
    void add(double share, const Contact& contact) {
      force -= share * contact.force;
      stiffness += share * contact.normal_stiffness;
    }
  };
  // What one thread finds in a step; its memory is kept.
  struct Part {
    std::vector<std::int32_t> near;          // pairs that may touch
    std::vector<FaceFoot> face_feet;         // of a block of them
    std::vector<FaceContact> face_contacts;  // of the same
    std::vector<Foot> feet, minima;          // of a pebble for which these do not say all
    std::vector<Contact> contacts;
    std::vector<Share> shares;
    std::vector<Sums> sums;  // of each contact
    std::size_t tunnelled = 0;
    bool is_first = false;  // its contacts come first: they are booked at once
  };
  // How the four nodes of a real facet turn.
  struct Turn {
    Vec3 mean = Vec3::Zero();     // of the nodes [m]
    Mat3 inverse = Mat3::Zero();  // I^-1 [1/m2]
    Vec3 spin = Vec3::Zero();     // w [rad/s]
  };

  Vec3 place_of(std::int32_t node) const { return {nodes_[node].x, nodes_[node].y, nodes_[node].z}; }
  Vec3 velocity_of(std::int32_t node) const { return {nodes_[node].vx, nodes_[node].vy, nodes_[node].vz}; }
  void place_nodes();
  void update_boxes();
  void list_facets(Neighborhood& near, const Vec3& center, double radius) const;
  void renew_candidates(const Particles& particles, const TravelLimits& limits, Team& team, const Partition& partition);
  void find_feet(const std::int32_t* near, const std::int32_t* end, const Vec3& center, double radius,
                 Part& part) const;
  bool shares_feature(const Foot& foot, std::int32_t facet) const;
  bool is_open(const Foot& foot) const;
  bool are_adjacent(std::int32_t facet_a, std::int32_t facet_b) const;
  void set_side(Foot& foot, const Vec3& center, double radius, const std::vector<Foot>& feet) const;
  Push merge(Part& part, std::size_t seed, double radius) const;
  void find_contacts(Particles& particles, const FacetMaterial& material, double dt, const PebbleRange& range,
                     Part& part);
  void press(Particles& particles, const Toucher& pebble, const Push& push, Part& part);
  ContactHistory inherited(const Toucher& pebble, std::int32_t facet, const Vec3& normal);
  void find_turns();
  Vec3 lever_of(const Share& share, const Vec3& point) const;
  void book(const Contact& contact, const Share* shares, const Sums& sums, bool transfers_moment);

  FacetKernels kernels_{};
  // Real nodes.
  Vec3s position_;                  // t_n [m]
  Vec3s base_;                      // before the first of several parts [m]
  Vec3s offset_;                    // [m]
  Vec3s velocity_;                  // t_{n-1/2} [m/s]
  Vec3s offset_velocity_;           // [m/s]
  std::vector<char> is_open_node_;  // contact nodes: on an open edge
  // Contact geometry: real nodes, then the collar's virtual ones. Velocities are those of the last compute().
  std::vector<FacetNode> nodes_;
  std::vector<std::int32_t> real_node_;                   // itself, or the node below
  double collar_height_ = 0;                              // [m]
  std::vector<std::array<std::int32_t, 4>> facet_nodes_;  // of contact geometry; facets: real, then collar
  std::vector<Facet> facets_;
  std::size_t real_facet_count_ = 0;

  double travel_ = 0;      // at least as far as any node has moved since the start [m]
  double box_travel_ = 0;  // travel_ when the boxes were made [m]
  std::vector<FacetBox> boxes_;
  std::vector<Sphere> spheres_;  // around the facets
  double smallest_ = 0;          // radius of the smallest of them [m]
  std::vector<Neighborhood> neighborhoods_;
  WallCandidates candidates_;  // with the facets that each may touch: pairs
  std::vector<std::int32_t> pair_pebble_, pair_body_;
  double candidate_travel_ = 0;  // travel_ that the candidates know of [m]

  std::vector<Contact> contacts_, previous_;
  std::vector<Share> shares_, previous_shares_;
  std::vector<Turn> turns_;         // per real facet; where moments are transferred
  std::vector<char> is_inherited_;  // per previous contact: its spring has found a heir
  std::vector<Part> parts_;         // one a thread

  std::vector<Load> node_load_, facet_load_;  // while they are summed
  Vec3s nodal_force_;                         // [N]
  Vec3s facet_force_;                         // [N]
  std::vector<double> node_stiffness_;        // [N/m]
  std::vector<double> facet_stiffness_;       // [N/m]
  FacetTotals totals_;
  std::size_t tunnelled_ = 0;
};

}  // namespace lockstep::dem
