"""What runs of the pile scenes hold, in the paper's terms (its Figs. 8 to 13, Table 3): curves against penetration S/D, forces at
the tip, stress in the zones, porosity in rings around the pile, traced grains, cost. Runs of one scene with different seeds are
repeats and make a group.

Lengths are relative to the pile: r from its axis, z from the tip at S = 0, both in diameters D unless a unit says otherwise. S = 0 is
the end of Apply: of the states before the pile moves the last one counts."""

import functools
import os
import re

import numpy as np

from run_files import (Missing, column, cut_in_the_middle, read_history, read_scene, read_series, read_summary, read_vtk, title_of,
                       zone_stress)

COUPLED, ALONE = "coupled", "particles only"
GRAIN, PILE_CONTACT = 0, 3  # "family" in contacts_NNNN.vtp
BIN = 0.01  # of S/D: rows of a history are averaged over it
STATE_REACH = 0.03  # a state that far in S/D from the one asked for still stands for it
RING = 0.125  # width and height of the rings that porosity is averaged over [D]
SAMPLES = 4  # to a grid cell's side, to share it out to the rings that cut it
LARGEST = 100  # contacts between grains that carry most: a count, since a share of all grows with the packing
TRACE_REACH = 0.25  # a traced grain that far from where the paper's stood at S = 0 still stands for it [D]
TRACE_PLACES = {1: (0.0, 0.5), 2: (0.0, 1.5), 3: (0.5, 0.5), 4: (1.0, 0.5)}  # the paper's grains: r, depth below the tip [D]


class Estimate:
    """Mean over runs and its standard error, which one run alone does not have (nan)."""

    def __init__(self, values, error=None):
        values = np.atleast_1d(np.asarray(values, dtype=float))
        self.mean = float(values.mean())
        over_runs = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else np.nan
        # Where each run tells an error of its own, the larger one counts.
        self.error = float(np.nanmax([over_runs, error])) if error is not None else over_runs

    def text(self, digits=3):
        return f"{self.mean:.{digits}g}" + (f" ± {self.error:.2g}" if np.isfinite(self.error) else "")


def slope(x, y):
    """Slope of the least-squares line and its standard error, for residuals that follow one another as a first-order process does."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if len(x) < 3:
        raise Missing("fewer than three points to fit a line to")
    lever = x - x.mean()
    gradient = lever @ y / (lever @ lever)
    rest = y - y.mean() - gradient * lever
    power = rest @ rest
    memory = np.clip(rest[1:] @ rest[:-1] / power, 0, 0.99) if power > 0 else 0.0
    variance = power / (len(x) - 2) / (lever @ lever) * (1 + memory) / (1 - memory)
    return float(gradient), float(np.sqrt(variance))


def within(x, window):
    return (x >= window[0] - 1e-9) & (x <= window[1] + 1e-9)


# --------------------------------------------------------------------------------------------------------- geometry


def zone_volumes(points, cells):
    """Volumes of hexahedra, from their mean edges [m3]."""
    corner = points[cells]
    a = (corner[:, [1, 2, 5, 6]] - corner[:, [0, 3, 4, 7]]).mean(axis=1)
    b = (corner[:, [3, 2, 7, 6]] - corner[:, [0, 1, 4, 5]]).mean(axis=1)
    c = (corner[:, 4:] - corner[:, :4]).mean(axis=1)
    return np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))


class Region:
    """A convex polygon in the plane of r and depth below the tip [D], turned around the axis."""

    def __init__(self, *corners):
        self.corners = np.array(corners, dtype=float)

    def contains(self, r, depth):
        point = np.stack([r, depth], axis=-1)
        sides = []
        for begin, end in zip(self.corners, np.roll(self.corners, -1, axis=0)):
            along, to = end - begin, point - begin
            sides.append(along[0] * to[..., 1] - along[1] * to[..., 0])
        return np.all(np.array(sides) >= 0, axis=0) | np.all(np.array(sides) <= 0, axis=0)


class Samples:
    """Points of a grid's cells in (r, z), so that a cell counts in each ring by its part there. Weights add up to the cell's room,
    which points inside the pile do not share."""

    def __init__(self, arrays, diameter, tip_start, tip_now, samples=SAMPLES):
        corner = arrays["Points"].reshape(-1, 3)[column(arrays, "connectivity").astype(int)].reshape(-1, 8, 3)
        low, high = corner.min(axis=1), corner.max(axis=1)
        steps = (np.arange(samples) + 0.5) / samples
        part = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        place = low[:, None] + part[None] * (high - low)[:, None]
        r = np.hypot(place[..., 0], place[..., 1])
        is_free = (r >= diameter / 2) | (place[..., 2] <= tip_now)
        room = column(arrays, "room") * np.prod(high - low, axis=1)
        weight = is_free * (room / np.maximum(is_free.sum(axis=1), 1))[:, None]
        self.cells = len(corner)
        self.cell = np.repeat(np.arange(self.cells), len(part))
        self.r, self.z, self.weight = r.ravel() / diameter, (place[..., 2].ravel() - tip_start) / diameter, weight.ravel()
        self.porosity = column(arrays, "porosity")
        self.tip = (tip_now - tip_start) / diameter

    def ring_means(self, r_edges, z_edges):
        """Porosity in rings, [z, r]; nan where no cell is. Each row is the azimuthal mean, weighted by room."""
        value, weight = self.porosity[self.cell] * self.weight, self.weight
        sums = [np.histogram2d(self.z, self.r, bins=(z_edges, r_edges), weights=w)[0] for w in (value, weight)]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(sums[1] > 0, sums[0] / sums[1], np.nan)

    def mean(self, region, tip=None):
        """Mean porosity in a region under the tip, where it is now or at the z given, and its standard error from the scatter of
        cells."""
        inside = region.contains(self.r, (self.tip if tip is None else tip) - self.z)
        weight = np.bincount(self.cell[inside], self.weight[inside], minlength=self.cells)
        used = weight > 0
        if used.sum() < 2:
            raise Missing("the grid has no two cells there")
        weight, porosity = weight[used] / weight[used].sum(), self.porosity[used]
        mean = weight @ porosity
        share = np.sum(weight**2)
        return float(mean), float(np.sqrt(share / (1 - share) * (weight @ (porosity - mean) ** 2)))


# -------------------------------------------------------------------------------------------------------------- run


class Run:
    """One folder."""

    def __init__(self, folder):
        self.folder = os.path.abspath(folder)
        self.name = os.path.basename(self.folder)
        self.scene = read_scene(folder)
        self.manifest = read_summary(folder, "manifest.json")
        self.summary = read_summary(folder, "dem_summary.json")
        self.ground = read_summary(folder, "continuum_summary.json")
        self.title = title_of(folder) if "title" in self.summary else self.scene.get("title", self.name)
        self.seed = int(self.summary.get("seed", self.manifest.get("seed", self.scene.get("seed", 1))))
        is_coupled = any(key.startswith("continuum.") for key in self.scene) or os.path.isfile(os.path.join(folder, "zones.pvd"))
        self.kind = COUPLED if is_coupled else ALONE
        history = read_history(os.path.join(folder, "dem_history.csv"))
        self.time, self.penetration = column(history, "time [s]"), column(history, "S/D")
        if not (self.penetration > 0).any():
            raise Missing("no pile moves in it")
        self.history = history
        self.end = float(self.penetration[-1])
        self.target = float(self.scene.get("pile.penetration", self.end))
        self.is_complete = self.end > self.target - STATE_REACH
        try:
            self.diameter = float(self.summary.get("pile_diameter") or self.scene["pile.diameter"])
            self.tip_start = float(self.summary.get("pile_tip_z_start") or -float(self.scene["pile.embedment"]))
        except KeyError as e:
            raise Missing(f"neither dem_summary.json nor scene.txt tells {e.args[0]}") from e

    def curve(self, name, s_over_d):
        """A column of the history, averaged over bins of S/D around the points asked for; nan beyond the run's end."""
        values = column(self.history, name)
        moves = self.penetration > 0
        start = values[~moves][-1] if not moves.all() else values[0]
        number = np.rint(self.penetration[moves] / BIN).astype(int)
        count = np.bincount(number)
        filled = np.flatnonzero(count * (np.arange(len(count)) > 0))
        means = np.bincount(number, values[moves])[filled] / count[filled]
        result = np.interp(s_over_d, np.r_[0, filled * BIN], np.r_[start, means])
        return np.where(s_over_d <= self.end + BIN / 2, result, np.nan)

    @functools.lru_cache(maxsize=None)
    def states(self, series):
        """S/D and paths of a series, from S = 0 on."""
        times, paths = read_series(self.folder, series)
        known = [i for i, path in enumerate(paths) if os.path.isfile(path)]
        if not known:
            raise Missing(f"no state of {series}.pvd")
        at = np.interp(times[known], self.time, self.penetration, left=0)
        first = max(np.flatnonzero(at < BIN), default=0)  # the last one before the pile has moved
        at[at < BIN] = 0
        keep = [i for i in range(first, len(at)) if i == first or at[i] > at[i - 1] + BIN]
        return at[keep], [paths[known[i]] for i in keep]

    def state(self, series, s_over_d):
        at, paths = self.states(series)
        nearest = int(np.argmin(np.abs(at - s_over_d)))
        if abs(at[nearest] - s_over_d) > STATE_REACH:
            raise Missing(f"no state at S/D = {s_over_d:g}" + (f": the run ends at {self.end:.2f}" if s_over_d > self.end else ""))
        return paths[nearest]

    def grains_across(self):
        """Mean grain diameters across the pile, None where the run does not tell."""
        radius = self.summary.get("mean_radius_m")
        return self.diameter / (2 * radius) if radius else None

    def threads(self):
        """Of dem_server."""
        return int((re.findall(r"--threads[= ](\d+)", " ".join(self.manifest.get("command_line", []))) or [1])[-1])

    def scene_name(self):
        path = self.manifest.get("scene", "")
        return os.path.basename(os.path.dirname(path)) if os.path.basename(path) == "scene.txt" else os.path.basename(path)

    def tip(self, s_over_d):
        return self.tip_start - s_over_d * self.diameter  # [m]

    def needs(self, s_over_d):
        if self.end < s_over_d - STATE_REACH:
            raise Missing(f"the run ends at S/D = {self.end:.2f}")

    # ---- Fig. 9

    @functools.lru_cache(maxsize=4)
    def ground_stress(self, s_over_d):
        """Corners and zones of the ground, vertical stress and its change since Excavate [Pa], tension positive."""
        if self.kind != COUPLED:
            raise Missing("no zones")
        arrays = read_vtk(self.state("zones", s_over_d))
        cells = column(arrays, "connectivity").astype(int).reshape(-1, 8)
        stress = next((v for n, v in arrays.items() if n.startswith("stress") and v.shape == (len(cells), 6)), None)
        if stress is None:
            raise Missing("no stress in the zones' files")
        return arrays["Points"], cells, stress[:, 2], zone_stress(arrays, len(cells))[0]

    def stress_section(self, s_over_d):
        """Polygons of the section y = 0, vertical stress and its change [Pa]."""
        points, cells, stress, change = self.ground_stress(s_over_d)
        polygons, numbers = cut_in_the_middle(points, cells)
        return polygons, stress[numbers], change[numbers]

    @functools.lru_cache(maxsize=None)
    def bulb_rate(self, begin, end):
        """Root mean square over the zones' volume of the change of stress from one S/D to another, per unit of S/D [Pa]."""
        points, cells, _, before = self.ground_stress(begin)
        after = self.ground_stress(end)[3]
        return rms(after - before, zone_volumes(points, cells)) / (end - begin)

    @functools.lru_cache(maxsize=None)
    def bulb_sizes(self):
        """Against S/D of the states: root mean square over the volume of the change of stress since Excavate [Pa], and bulb_rate from
        one state to the next, at S/D in the middle: (S/D, change), (S/D, rate)."""
        at = self.states("zones")[0]
        sizes, rates = [], []
        for number, here in enumerate(at):
            points, cells, _, change = self.ground_stress(here)
            sizes.append(rms(change, zone_volumes(points, cells)))
            if number:
                rates.append(self.bulb_rate(at[number - 1], here))
        return (at, np.array(sizes)), ((at[1:] + at[:-1]) / 2, np.array(rates))

    # ---- Fig. 10

    def contacts(self, path):
        arrays = read_vtk(path)
        ends = arrays["Points"].reshape(-1, 2, 3)
        force = np.hypot(column(arrays, "normal force"), column(arrays, "shear force"))
        return ends, force, column(arrays, "family").astype(int)

    @functools.lru_cache(maxsize=None)
    def tip_forces(self):
        """Against S/D of the states: the largest force of a contact at the tip, grain with pile; mean force of contacts between grains
        within D/2 of the tip's centre, and from D to 3D/2 [N]; share that lies within D of it, of the LARGEST contacts and of all."""
        rows = []
        for at, path in zip(*self.states("contacts")):
            ends, force, family = self.contacts(path)
            tip = np.array([0, 0, self.tip(at)])
            at_tip = (family == PILE_CONTACT) & (ends[:, 1, 2] < tip[2] + 0.02 * self.diameter)
            middle, grains = ends.mean(axis=1), family == GRAIN
            distance = np.linalg.norm(middle[grains] - tip, axis=1) / self.diameter
            between = force[grains]
            largest = np.argsort(-between, kind="stable")[:LARGEST]
            rows.append((at, force[at_tip].max(initial=0), mean_of(between[distance < 0.5]),
                         mean_of(between[(distance >= 1) & (distance < 1.5)]), np.mean(distance[largest] < 1), np.mean(distance < 1)))
        names = ("S/D", "largest at tip", "near tip", "away", "share of largest", "share of all")
        return dict(zip(names, np.array(rows).T))

    # ---- Fig. 11

    @functools.lru_cache(maxsize=4)
    def samples(self, s_over_d):
        return Samples(read_vtk(self.state("grid_0", s_over_d)), self.diameter, self.tip_start, self.tip(s_over_d))

    # ---- Figs. 12, 13

    @functools.lru_cache(maxsize=None)
    def traces(self):
        """The traced grains by the paper's number: lists of Trace."""
        found = {role: [] for role in TRACE_PLACES}
        seen = set()
        for path in tracked_paths(self.folder):
            try:
                trace = Trace(read_history(path), self.tip_start, self.diameter)
            except Missing:
                continue
            if trace.role and trace.grain not in seen:
                seen.add(trace.grain)
                found[trace.role].append(trace)
        if not any(found.values()):
            raise Missing("no traced grain where the paper's were")
        return found


class Trace:
    """One grain's way: `sideways` along its own direction from the axis (of those on the axis: however directed), `down`, both in D."""

    def __init__(self, rows, tip_start, diameter):
        self.penetration = column(rows, "S/D")
        self.grain = int(column(rows, "grain")[0])
        place = np.stack([column(rows, f"position {axis} [m]") for axis in "xyz"], axis=1)
        zero = max(np.flatnonzero(self.penetration <= 0), default=0)
        self.start = place[zero] - [0, 0, tip_start]
        self.start /= diameter
        self.way = (place - place[zero]) / diameter
        r, depth = np.hypot(*self.start[:2]), -self.start[2]
        gaps = {role: np.hypot(r - at[0], depth - at[1]) for role, at in TRACE_PLACES.items()}
        nearest = min(gaps, key=gaps.get)
        self.role = nearest if gaps[nearest] <= TRACE_REACH else None
        is_on_axis = self.role in (1, 2)
        horizontal = self.way[:, :2]
        self.sideways = np.hypot(*horizontal.T) if is_on_axis else horizontal @ (self.start[:2] / r)
        self.down = -self.way[:, 2]
        kept = self.penetration >= 0
        kept[:zero] = False
        self.penetration, self.sideways, self.down, self.way = (v[kept] for v in (self.penetration, self.sideways, self.down, self.way))


def tracked_paths(folder):
    names = [n for n in os.listdir(folder) if n.startswith("tracked_") and n.endswith(".csv")]
    return [os.path.join(folder, n) for n in sorted(names, key=lambda n: (len(n), n))]


def mean_of(values):
    return values.mean() if len(values) else 0.0


def rms(values, weights):
    return float(np.sqrt(weights @ values**2 / weights.sum()))


# ------------------------------------------------------------------------------------------------------------ group


class Group:
    """Runs of one scene that differ in the seed alone."""

    def __init__(self, runs):
        runs = sorted(runs, key=lambda run: run.seed)
        self.notes, seeds = [], {}
        for run in runs:
            if run.seed in seeds:
                self.notes.append(f"{run.name} has the seed of {seeds[run.seed].name}: left out")
            else:
                seeds[run.seed] = run
        runs = list(seeds.values())
        complete = [run for run in runs if run.is_complete]
        self.broken_off = [run for run in runs if complete and not run.is_complete]
        self.runs = complete or runs
        for run in runs:
            if not run.is_complete:
                self.notes.append(f"{run.name} ends at S/D = {run.end:.2f} of {run.target:g}" +
                                  (": drawn, but not in the means" if complete else ""))
        self.first = self.runs[0]
        self.kind, self.scene = self.first.kind, self.first.scene
        self.end = min(run.end for run in self.runs)
        self.label = self.kind  # told apart from others of its kind by name_groups()
        self.penetration = np.arange(0, self.end + BIN / 2, BIN)

    def curves(self, name, scale=1.0):
        """[run, S/D] at `penetration`."""
        return np.array([run.curve(name, self.penetration) for run in self.runs]) * scale

    def estimate(self, measure):
        """Mean and error over the runs of what measure(run) gives."""
        return Estimate([measure(run) for run in self.runs])

    def rings(self, s_over_d, r_edges, z_edges):
        """Porosity [z, r], mean over the runs."""
        return np.mean([run.samples(s_over_d).ring_means(r_edges, z_edges) for run in self.runs], axis=0)

    def seeds_text(self):
        seeds = ", ".join(str(run.seed) for run in self.runs)
        return f"seed {seeds}" if len(self.runs) == 1 else f"{len(self.runs)} seeds ({seeds})"


def group_key(run):
    """All keys of the scene but the seed; what is measured and written does not make another case."""
    return frozenset((key, value) for key, value in run.scene.items()
                     if key not in ("seed", "title") and not key.startswith(("measure.", "output.")))


def grouped(runs):
    """Groups, coupled ones first, else in the order given."""
    by_key = {}
    for run in runs:
        by_key.setdefault(group_key(run), []).append(run)
    groups = sorted((Group(members) for members in by_key.values()), key=lambda group: group.kind != COUPLED)
    name_groups(groups)
    return groups


def name_groups(groups):
    """Tells groups of one kind apart by their scenes' names, or else by what differs between them."""
    for kind in (COUPLED, ALONE):
        alike = [group for group in groups if group.kind == kind]
        if len(alike) < 2:
            continue
        names = [group.first.scene_name() for group in alike]
        if len(set(names)) < len(names):
            keys = sorted(set().union(*(dict(group_key(group.first)) for group in alike)))
            differ = [key for key in keys if len({group.scene.get(key) for group in alike}) > 1]
            names = [", ".join(f"{key.split('.')[-1]} {group.scene.get(key, 'default')}" for key in differ[:2]) for group in alike]
        for group, name in zip(alike, names):
            group.label = f"{kind}, {name}"
