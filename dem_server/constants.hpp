// Numbers of the grains' solver that are no scene's business, each with its reason.
#pragma once
#include <cstdint>

namespace lockstep::dem {

// Outer list's skin over the inner list's: one cell build serves tens of refreshes, and the outer list has about three
// times the contacts.
inline constexpr double outer_skin_factor = 6;

// Up to this share of the pebbles are listed anew one by one; beyond it the outer list is made anew from cells. Each one is
// compared with all earlier ones, and leaves pairs behind that no longer matter: both must stay small beside a whole list.
// The pile of the paper's case makes do with one build in 900 steps so, instead of one in 85. Other shares were not tried.
inline constexpr double most_strays = 0.005;

// The inner list's skin: by this factor wider when a list has lasted fewer updates than the first number, tighter when it
// has lasted more than the second, and never further than skin_range from where it began. The kernel study has 2.5 to
// 3.6 steps for a refresh and 1.12 to 1.23 entries a contact for skins of 0.02 to 0.06 R: some tens of steps are right.
inline constexpr double skin_step = 1.25;
inline constexpr int short_list_age = 30;
inline constexpr int long_list_age = 120;
inline constexpr double skin_range = 3;

// A pebble's limit in the inner list: this many times what it used of the last one, but at least this share of the last one
// for each short_list_age that it lasted, so that a burst is remembered for 300 steps, and this share of half the skin. In
// the paper's case up to S/D = 0.06 these have 1.4 entries a contact and a list in 40 steps; a margin of 2 and a share of
// 0.02 have 1.24 and one in 20, at the same cost of contacts and a higher one of lists.
inline constexpr double limit_margin = 3;
inline constexpr double limit_memory = 0.9;
inline constexpr double tightest_limit = 0.1;

// A stretched cloud (a grain that flew away) may not ask for more cells than this many a pebble; cells grow instead.
inline constexpr double cells_per_pebble = 4;

// Moment of inertia of a sphere over m R^2.
inline constexpr double sphere_inertia = 0.4;

// The same of a sphere whose spin is held: it turns 4e-13 of what a free one would, and rotational energy is a number still.
inline constexpr double held_inertia = 1e12;

// Where the records behind the last one stand: its square is still a number [m].
inline constexpr double far_away = 1e150;

// Sweeps that scale Gershgorin's rows; further ones gain less than a percent.
inline constexpr int bound_sweeps = 12;

// Products of the power iteration, and the share of its estimate of the stable step that is returned: the Rayleigh
// quotient is below the largest eigenvalue, by 2 to 6 % after 30 products.
inline constexpr int power_products = 30;
inline constexpr double power_margin = 0.95;

// Bodies of a chunk of the contact list: what threads share out and sums are taken over.
inline constexpr std::size_t chunk_bodies = 256;

// Parts of the contact list for each thread, where there are several: enough that one may take what another does not get to,
// and few, since contacts across a border are computed twice. Paper's case to S/D = 0.1 on two threads: 11.7 and 11.9 s of
// Penetrate with three a thread, 12.3 with two, 12.2 to 12.3 with four, 12.2 with six; little more than the scatter.
inline constexpr int parts_a_thread = 3;

// Pebbles whose radii differ by less than this share one grid of cells.
inline constexpr double grid_size_ratio = 2.5;

// Cutting a packing: pebbles whose centre is nearer to a wall than this many radii are left out. At 0.8 the packing has
// gaps along the walls and collapses; at 0.45 it is just not jammed once relaxed.
inline constexpr double clip_distance = 0.45;

// Walls order the grains beside them over this many radii; bulk porosity is measured farther away.
inline constexpr double wall_order = 3;

// Trials of the cube's magnification until the count is met, and how near is near enough.
inline constexpr int count_trials = 40;
inline constexpr int lead_trials = 12;  // of them with the cube in its first place
inline constexpr double count_tolerance = 0.001;

// Relaxing the cut: at most these cycles, with bodies no faster than this [m/s], until no overlap exceeds this share of
// R (under gravity overlaps are some 1e-3 R).
inline constexpr int relax_cycles = 3000;
inline constexpr double relax_speed = 0.3;
inline constexpr double relaxed_overlap = 0.005;

// Growing into the gaps: relative rates of the radii up and down [1/s], steps between two changes, the pressures on the
// facets that end the growth and the letting down [Pa], steps that they are averaged over, and a bound. Growing to a
// few kPa would stop on the pressure of grains still in motion; keeping tens of kPa would lock stress into the sides.
inline constexpr double grow_rate = 0.1;
inline constexpr double release_rate = 0.02;
inline constexpr int grow_interval = 10;
inline constexpr double grown_pressure = 20e3;
inline constexpr double released_pressure = 2e3;
inline constexpr double grow_averaging = 50;
inline constexpr int grow_cycles = 20000;

// Balance: cycles under gravity before the servo may start, and the unbalanced ratio that it starts at. A servo on a
// packing that still falls would spend its travel on what is not there yet.
inline constexpr std::uint32_t settle_cycles = 1000;
inline constexpr double servo_start_ratio = 0.02;

// A Balance that ends above its tolerance goes on with a warning, but not above this ratio: such a packing is in motion.
inline constexpr double hopeless_ratio = 0.05;

// Inner list's skin over the mean radius, to begin with: nine of ten entries touch.
inline constexpr double list_skin = 0.03;

// Of sqrt(m/k_n) of the smallest grain: a step for packings in the making; 0.6 is the last quiet one.
inline constexpr double quiet_share = 0.3;

// Steps between renewals of the grains' stable step: contacts come and go slowly beside a step, and the limit has its
// margin.
inline constexpr std::uint32_t limit_interval = 100;
inline constexpr std::uint32_t heartbeat_interval = 50;

// Steps between sums of energies in a coupled run. Works are summed in each step whatever this is, so a ledger closes as
// well; an instability grows by a few times to many orders of magnitude in so many steps.
inline constexpr std::uint32_t ledger_interval = 20;

// A node's contact stiffness is told anew when it has grown by this factor.
inline constexpr double stiffness_growth = 1.1;

// A body that travels more than this many of its radii in one step is not followed by contacts any more: the run is
// stopped.
inline constexpr double fastest_travel = 0.5;

// A body this many times farther from the middle than the scene is wide has left it: the run is stopped.
inline constexpr double farthest = 3;

// An overlap of this many radii is no contact any more: the run is stopped. The paper's contact stiffness is soft: 0.3 is reached
// under its pile's tip.
inline constexpr double alarming_overlap = 0.9;

}  // namespace lockstep::dem
