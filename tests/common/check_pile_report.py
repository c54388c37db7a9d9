#!/usr/bin/python3
"""Answers that tools/report must give for runs made up with known ones: means around the axis, slopes, rates, roles of traced grains,
groups, and verdicts that turn when the data turn. Prints what was checked; ends with 1 if something is wrong."""

import base64
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile

TOOLS = os.path.join(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))), "tools")
sys.path.insert(0, TOOLS)
sys.dont_write_bytecode = True
import pile_claims as claims  # noqa: E402
import pile_figures as figures  # noqa: E402
import pile_runs  # noqa: E402
from run_files import read_scene  # noqa: E402

np = pile_runs.np
failures = []
D, TIP = 0.25, -1.0  # of the made-up pile [m]
AT = np.arange(0, 1.001, 0.1)  # S/D of states


def holds(what, is_true):
    print(f"{what}: {'yes' if is_true else 'NO'}")
    if not is_true:
        failures.append(what)


def close(what, value, truth, bound=1e-9):
    holds(f"{what} = {truth:.6g} (off by {abs(value - truth):.1e}, allowed {bound:g})", abs(value - truth) <= bound)


# ------------------------------------------------------------------------------------------------- made-up run folders


def write_vtk(path, arrays):
    kinds = {"float64": "Float64", "int64": "Int64"}
    with open(path, "w") as file:
        file.write('<VTKFile header_type="UInt64">\n')
        for name, values in arrays.items():
            raw = np.array([values.nbytes], dtype="<u8").tobytes() + values.tobytes()
            components = values.shape[1] if values.ndim > 1 else 1
            file.write(f'<DataArray type="{kinds[str(values.dtype)]}" Name="{name}" NumberOfComponents="{components}" format="binary">'
                       f"{base64.b64encode(raw).decode()}</DataArray>\n")
        file.write("</VTKFile>\n")


def write_series(folder, name, suffix, state, at=AT):
    """state(S/D): arrays of one state; time is S/D."""
    entries = []
    for number, at in enumerate(at):
        write_vtk(os.path.join(folder, f"{name}_{number:04d}.{suffix}"), state(at))
        entries.append(f'<DataSet timestep="{at}" file="{name}_{number:04d}.{suffix}"/>\n')
    with open(os.path.join(folder, f"{name}.pvd"), "w") as file:
        file.writelines(["<Collection>\n", *entries, "</Collection>\n"])


def boxes(low, high, counts):
    """Points and corners of a grid of bricks, each with eight points of its own."""
    edges = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts)]
    begin = np.stack(np.meshgrid(*(e[:-1] for e in edges), indexing="ij"), -1).reshape(-1, 3)
    size = np.array([e[1] - e[0] for e in edges])
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
    points = (begin[:, None] + corners * size).reshape(-1, 3)
    return points, np.arange(len(points), dtype=np.int64), begin + size / 2


def resistance(at, late):
    """30 MPa per unit of S/D up to 0.4, 5 to 0.7, then `late`."""
    return 1e6 * (30 * np.minimum(at, 0.4) + 5 * np.clip(at - 0.4, 0, 0.3) + late * np.clip(at - 0.7, 0, None))


def make_run(folder, seed=1, late=1.0, end=1.0, overrides=(), is_coupled=True, scene_text="", bulb=None, core=-0.05, sleeve=0.05, first=0.9,
             across=4.5):
    os.makedirs(folder)
    at = np.r_[0, np.arange(0, end + 0.0005, 0.001)]
    rows = np.stack([np.r_[-0.1, at[1:]], at, resistance(at, late), 1e5 * at], axis=1)
    with open(os.path.join(folder, "dem_history.csv"), "w") as file:
        file.write("time [s],S/D,tip resistance [Pa],shaft force [N]\n")
        file.writelines(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows)
    with open(os.path.join(folder, "scene.txt"), "w") as file:
        file.write('title: "made up # no comment"  # one\nseed: 7\n' + ("continuum { density: 1630 }\n" if is_coupled else "") +
                   "pile { diameter: 0.25 embedment: 1.0 penetration: 1.0 }\n" + scene_text)
    with open(os.path.join(folder, "manifest.json"), "w") as file:
        json.dump({"scene": "/scenes/made_up/scene.txt", "overrides": [f"seed={seed}", *overrides], "seed": seed}, file)
    if end >= 1:
        with open(os.path.join(folder, "dem_summary.json"), "w") as file:
            json.dump({"title": "made up", "seed": seed, "pile_diameter": D, "pile_tip_z_start": TIP, "steps": 1000, "grains": 10,
                       "mean_radius_m": D / (2 * across),
                       "seconds": 100.0 if is_coupled else 250.0,
                       "stages": {"Apply": {"seconds": 1.0}, "Penetrate": {"seconds": 9.0 if is_coupled else 29.0}}}, file)
    write_series(folder, "contacts", "vtp", contacts)
    write_series(folder, "grid_0", "vtu", lambda s: porosity(s, core, sleeve), (0.0, 0.3, 0.7, 1.0))
    if is_coupled:
        write_series(folder, "zones", "vtu", lambda s: zones(s, bulb or (lambda s: min(s, 0.7))))
    for number, (place, way) in enumerate(grains(first)):
        with open(os.path.join(folder, f"tracked_{number}.csv"), "w") as file:
            file.write("S/D,grain,position x [m],position y [m],position z [m]\n")
            for s in np.r_[0, AT]:
                file.write(",".join(f"{v:.9g}" for v in (s, number, *(np.array(place) * D + [0, 0, TIP] + s * D * np.array(way)))) + "\n")


def grains(first):
    """Places and ways of the paper's grains, in disorder, and one that none of them is [D]."""
    yield (0, 1.05, -0.5), (0, 0.05, -0.02)  # 4
    yield (0.02, 0, -1.5), (0, 0, -0.4)  # 2
    yield (-0.45, 0, -0.45), (-0.2, 0, -0.5)  # 3
    yield (3, 0, -0.5), (0, 0, 0)
    yield (0, 0, -0.5), (0.01, 0, -first)  # 1
    yield (0, 0.6, -0.5), (0.3, 0.1, -0.6)  # 3: 0.1 D outwards, 0.3 D around


def contacts(s):
    """One of grain and tip, 100 large ones under the tip, 900 small ones far away."""
    middle = np.r_[[[0, 0, 0]], np.tile([[0, 0, -0.2]], (100, 1)), np.tile([[0, 0, -3]], (880, 1)), np.tile([[0, 0, -1.2]], (20, 1))] * D
    middle[:, 2] += TIP - s * D
    force = np.r_[200 * min(s, 0.7), np.full(100, 100 * min(s, 0.7)), np.full(880, 1), np.full(20, 10 * min(s, 0.7))]
    ends = np.stack([middle, middle], axis=1)
    return {"Points": ends.reshape(-1, 3), "normal force": 0.6 * force, "shear force": 0.8 * force, "family": np.r_[3.0, np.zeros(1000)]}


def porosity(s, core, sleeve):
    """0.4 with a little noise; `core` more in the cone under the tip, `sleeve` more beside the shaft where the pile has moved."""
    points, connectivity, center = boxes((-0.5, -0.5, -2), (0.5, 0.5, 0), (20, 20, 40))
    value = 0.4 + 0.01 * np.sin(np.arange(len(center)) * 2.4)
    r, depth = np.hypot(*center[:, :2].T) / D, (TIP - s * D - center[:, 2]) / D
    if s > 0:
        value += core * claims.CORE.contains(r, depth) + sleeve * claims.SLEEVE.contains(r, depth)
    room = np.where((r < 0.5) & (depth < 0), 0.0, 1.0)
    return {"Points": points, "connectivity": connectivity, "porosity": value, "room": room}


def zones(s, bulb):
    """Two bricks, of 1 and 3 m3; the stress of the small one changes by bulb(S/D), that of the large one does not."""
    small, _, _ = boxes((-1, -0.5, -9), (0, 0.5, -8), (1, 1, 1))
    large, _, _ = boxes((0, -0.5, -9), (3, 0.5, -8), (1, 1, 1))
    stress = np.zeros((2, 6))
    return {"Points": np.r_[small, large], "connectivity": np.arange(16, dtype=np.int64), "stress xx yy zz xy yz zx [Pa]": stress,
            "vertical stress change since Excavate [Pa]": np.array([-1e5 * bulb(s), 0.0])}


# -------------------------------------------------------------------------------------------------------------- checks


def check_slope():
    # Residuals +e, -e, +e, ... of 1001 points follow one another without memory: the error is that of ordinary least squares.
    x = np.linspace(0, 1, 1001)
    noise = 0.5 * (-1.0) ** np.arange(len(x))
    gradient, error = pile_runs.slope(x, 3 * x + 2 + noise)
    close("slope of a line with noise", gradient, 3.0, 1e-3)
    close("its error", error, 0.5 * math.sqrt(1001 / 999) / math.sqrt(np.sum((x - 0.5) ** 2)), 1e-4)
    # Each residual twice: half as many independent ones, and so an error larger by the root of (1 + m)/(1 - m), m about 1/2.
    pairs = np.repeat(np.random.default_rng(1).normal(size=2000), 2)
    x = np.linspace(0, 1, len(pairs))
    plain = math.sqrt(np.var(pairs) / np.sum((x - 0.5) ** 2))
    close("error of a line whose residuals come in pairs, of the plain one", pile_runs.slope(x, pairs)[1] / plain, math.sqrt(3), 0.1)


def check_rings():
    # A field a + b x + c z has the azimuthal mean a + c z around the axis, whatever b is.
    points, connectivity, center = boxes((-0.5, -0.5, -2), (0.5, 0.5, 0), (20, 20, 64))
    r_edges, z_edges = np.arange(0, 1.6, 0.25), np.arange(-3, 3.1, 0.125)
    field = {"Points": points, "connectivity": connectivity, "porosity": 0.4 + 0.2 * center[:, 0] + 0.1 * center[:, 2],
             "room": np.ones(len(center))}
    rings = pile_runs.Samples(field, 1e-9 + D, TIP, 5.0).ring_means(r_edges, z_edges)
    truth = 0.4 + 0.1 * (TIP + D * 0.5 * (z_edges[1:] + z_edges[:-1]))
    close("largest error of a field's azimuthal mean", np.abs(rings - truth[:, None]).max(), 0.0, 1e-6)
    # Half of the room on one side, where the porosity is 0.5, all of it on the other, where it is 0.2: (0.5 0.5 + 0.2)/1.5.
    field.update(porosity=np.where(center[:, 0] > 0, 0.5, 0.2), room=np.where(center[:, 0] > 0, 0.5, 1.0))
    samples = pile_runs.Samples(field, D, TIP, 5.0)
    close("mean weighted by room", np.abs(samples.ring_means(r_edges, z_edges) - 0.3).max(), 0.0, 1e-9)
    mean, _ = samples.mean(pile_runs.Region((0, 0), (1, 0), (1, 2), (0, 2)), TIP)
    close("the same in a region", mean, 0.3)
    # Above its tip the pile leaves no room: no ring inside it has a mean, the one below it has.
    pile = pile_runs.Samples({**field, "room": np.ones(len(center))}, D, TIP, TIP).ring_means(np.array([0, 0.5]), np.array([-1, 0, 1]))
    holds("no porosity inside the pile", np.isnan(pile[1, 0]) and np.isfinite(pile[0, 0]))


def check_regions():
    inside = claims.CORE.contains(np.array([0, 0.2, 0.3, 0.1]), np.array([0.5, 0.5, 0.5, -0.1]))
    holds("a cone half as wide at half its depth", inside.tolist() == [True, True, False, False])


def check_run(folder):
    make_run(os.path.join(folder, "one"))
    run = pile_runs.Run(os.path.join(folder, "one"))
    close("tip resistance at S/D = 0.55 [MPa]", run.curve(claims.TIP, np.array([0.55]))[0] / 1e6, 30 * 0.4 + 5 * 0.15, 1e-6)
    holds("states from S = 0 on", np.allclose(run.states("zones")[0], AT))
    # The change of 1e5 Pa per unit of S/D in a quarter of the volume: rms 1e5 sqrt(1/4), and nothing from 0.7 on.
    close("rate of change of the bulb [Pa]", run.bulb_rate(0.1, 0.7), 5e4, 1e-6)
    close("and later", run.bulb_rate(0.7, 1.0), 0.0, 1e-6)
    forces = run.tip_forces()
    close("largest force at the tip [N]", forces["largest at tip"][-1], 140.0, 1e-9)
    close("mean force near it [N]", forces["near tip"][-1], 70.0, 1e-9)
    close("mean force away from it [N]", forces["away"][-1], 7.0, 1e-9)
    close("share of the largest that is near", forces["share of largest"][-1], 1.0)
    close("share of all that is near", forces["share of all"][-1], 0.1)
    traces = run.traces()
    holds("roles by place", [len(traces[role]) for role in (1, 2, 3, 4)] == [1, 1, 2, 1])
    close("way outwards of grain 3, mean of (0.2, 0.1) D", claims.trace_end(run, 3, "sideways"), 0.15, 1e-6)
    close("way down of grain 1 [D]", claims.trace_end(run, 1, "down"), 0.9, 1e-6)
    close("time of a step [s]", claims.step_seconds(run), 0.01)
    scene = read_scene(run.folder)
    holds("a scene's keys, a string with #, an override",
          (scene["title"], scene["pile.diameter"], scene["seed"]) == ("made up # no comment", "0.25", "1"))


def check_groups(folder):
    made = {"a1": {}, "a2": {"seed": 2}, "a2_again": {"seed": 2}, "a3": {"seed": 3, "end": 0.4},
            "measured": {"seed": 4, "overrides": ["measure.fabric=true"]},
            "fast": {"overrides": ["fidelity.pile_velocity=0.5"]}, "alone": {"is_coupled": False}}
    for name, how in made.items():
        make_run(os.path.join(folder, name), **how)
    order = ("alone", "a2", "a1", "a2_again", "a3", "measured", "fast")
    groups = pile_runs.grouped([pile_runs.Run(os.path.join(folder, name)) for name in order])
    holds("scenes apart, coupled first", [sorted(r.name for r in g.runs) for g in groups] == [["a1", "a2", "measured"], ["fast"], ["alone"]])
    holds("a seed that comes twice counts once, a run broken off does not",
          len(groups[0].notes) == 2 and "a3 ends at S/D = 0.40" in groups[0].notes[1])
    holds("groups of one kind have names of their own",
          [group.label for group in groups[:2]] == ["coupled, pile_velocity default", "coupled, pile_velocity 0.5"])
    early = pile_runs.grouped([pile_runs.Run(os.path.join(folder, "a3"))])[0]
    finding = claims.CLAIMS[1].finding(early)
    holds("a run that was broken off is not judged", finding.holds is None and "0.40" in finding.text)
    # Values 1, 2, 3: mean 2, error 1/sqrt(3).
    estimate = pile_runs.Estimate([1, 2, 3])
    close("standard error of a mean", estimate.error, 1 / math.sqrt(3))


def check_verdicts(folder):
    """Each claim must turn when its data do."""
    good = claims_of(os.path.join(folder, "good"))
    holds("a run made as the paper's agrees with all that it tells", all(good.values()) and len(good) >= 12)
    turned = {"late": dict(late=9.0), "falls": dict(late=-1.0), "bulb": dict(bulb=lambda s: s), "core": dict(core=0.0),
              "sleeve": dict(sleeve=0.0),
              "first": dict(first=0.3)}
    expected = {"late": {"plateau", "limit_reached"}, "falls": {"plateau"}, "bulb": {"steady_bulb"},
                "core": {"a dense core under the tip", "the core, taken as wide as the pile"},
                "sleeve": {"a loose (dilated) sleeve along the shaft"}, "first": {"down_in_order"}}
    for name, how in turned.items():
        found = claims_of(os.path.join(folder, name), **how)
        wrong = {claim for claim, verdict in found.items() if not verdict}
        holds(f"of the claims only {', '.join(expected[name])} turn with {name}", wrong == expected[name])
    for what, values, verdict in (("near a limit the verdict says so", (0.9, 1.3), "agrees, within its error"),
                                  ("far from it it does not", (1.9, 2.1), "agrees")):
        holds(what, claims.found("", lambda value: value > 1, pile_runs.Estimate(values), {}).verdict() == verdict)


def claims_of(folder, **how):
    make_run(folder, **how)
    group = pile_runs.grouped([pile_runs.Run(folder)])[0]
    found = [(claim, claim.finding(group)) for claim in claims.CLAIMS if not claim.is_pair]
    return {claim.saw if claim.judge.__name__ == "judge" else claim.judge.__name__: f.holds for claim, f in found if f.holds is not None}


def check_pair(folder):
    make_run(os.path.join(folder, "c"))
    make_run(os.path.join(folder, "p"), is_coupled=False, late=1.0)
    pair = claims.pair_of(pile_runs.grouped([pile_runs.Run(os.path.join(folder, n)) for n in ("p", "c")]))
    speed = claims.speed(*pair)
    close("particles only over coupled, wall time", speed.numbers["wall_time"], 2.5)
    close("and of what the push takes", speed.numbers["value"], 3.0)
    close("coupled over particles only, resistance", claims.resistance_alike(*pair).numbers["value"], 1.0)
    close("correlation of equal fields", claims.fields_alike(*pair).numbers["correlation_0.7"], 1.0)


def check_sizes(folder):
    for name, how in {"coarse": {}, "coarse_too": {"seed": 2}, "fine": {"across": 9.0, "overrides": ["grains.packing.count=9"]}}.items():
        make_run(os.path.join(folder, name), **how)
    groups = pile_runs.grouped([pile_runs.Run(os.path.join(folder, name)) for name in ("fine", "coarse", "coarse_too")])
    sizes = figures.of_sizes(groups)
    holds("from coarse grains to fine ones", [round(figures.across_of(group), 9) for group in sizes] == [4.5, 9.0])
    change = figures.beside_shaft(sizes[1], 0.7, 0.7) - figures.beside_shaft(sizes[1], 0.0, 0.7)
    # Cells of 0.2 D belong to the sleeve or not: its two rings have it but for their rims, rings a cell away have nothing of it.
    close("the sleeve beside the shaft", change[:2].mean(), 0.05, 0.01)
    close("and beyond", np.abs(change[4:7]).max(), 0.0, 1e-12)
    # The core's cone is 1 - depth of half a diameter wide: in the ring at depth y it fills (1 - y)^2 of the pile's section.
    change = (figures.under_tip(sizes[0], 0.7, 0.7) - figures.under_tip(sizes[0], 0.0, 0.7))[::-1]
    depth = -figures.middles(figures.UNDER_TIP)[::-1]
    close("the core under the tip", np.abs(change - np.where(depth < 1, -0.05 * (1 - depth) ** 2, 0))[1:].max(), 0.0, 0.01)
    try:
        figures.of_sizes(sizes[:1])
        holds("grains of one size are not compared", False)
    except pile_runs.Missing:
        holds("grains of one size are not compared", True)


def report(*words):
    return subprocess.run([os.path.join(TOOLS, "report"), *words], capture_output=True, text=True, check=False)


def check_page(folder):
    run, out = os.path.join(folder, "run"), os.path.join(folder, "page.html")
    make_run(run)
    done = report(run, "--out", out, "--figures", os.path.join(folder, "pictures"))
    print(done.stderr, end="")
    holds("one run alone makes a page", done.returncode == 0 and os.path.isfile(out))
    with open(out) as file:
        words = file.read()
    holds("that says what it lacks", "No run of particles only" in words and "model is not drawn: no particles.pvd" in words)
    holds("and needs nothing else", not re.search(r"(src|href)=.(?!data:|#)|<script", words))
    with open(os.path.join(folder, "page.json")) as file:
        holds("numbers stand beside it", any(claim["verdict"] == "agrees" for claim in json.load(file)["claims"]))
    sizes = [entry.stat().st_size for entry in os.scandir(os.path.join(folder, "pictures"))]
    holds("pictures below 150 kB", sizes and max(sizes) < 150_000)
    broken = os.path.join(folder, "broken")
    shutil.copytree(run, broken)
    with open(os.path.join(broken, "dem_history.csv"), "a") as file:
        file.write("0.1,0.2,x,1\n")
    for what, code, part, words in (("no folder", 2, "no such folder", [os.path.join(folder, "none")]),
                                    ("a broken row", 1, "dem_history.csv", [broken]), ("nothing in it", 1, "no dem_history.csv", [folder]),
                                    ("no run", 1, "--help", [])):
        refused = report(*words)
        holds(f"{what}: refused in words", refused.returncode == code and part in refused.stderr)


def main():
    check_slope()
    check_rings()
    check_regions()
    for check in (check_run, check_groups, check_verdicts, check_pair, check_sizes, check_page):
        with tempfile.TemporaryDirectory() as folder:
            check(folder)
    for failure in failures:
        print(f"wrong: {failure}", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
