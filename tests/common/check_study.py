#!/usr/bin/python3
"""What tools/study must say of curves whose means are known, and which cases may share a packing. Prints the errors; ends with 1
if something is wrong."""

import argparse
import csv
import importlib.machinery
import importlib.util
import json
import math
import os
import sys
import tempfile

TOOLS = os.path.join(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))), "tools")
sys.path.insert(0, TOOLS)
sys.dont_write_bytecode = True


def load(name):
    loader = importlib.machinery.SourceFileLoader(name, os.path.join(TOOLS, name))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(name, loader))
    loader.exec_module(module)
    return module


study = load("study")
np = study.np
failures = []


def check(what, error, bound):
    print(f"{what}: error {error:.2e}, allowed {bound:g}")
    if not abs(error) <= bound:
        failures.append(what)


def claim(what, holds):
    print(f"{what}: {'yes' if holds else 'NO'}")
    if not holds:
        failures.append(what)


def check_window_mean():
    # Uneven rows of q = 3 + 4 s: trapezoids are exact, the mean over [a, b] is 3 + 2 (a + b).
    s = np.sort(np.concatenate(([0.0, 1.0], np.random.default_rng(1).random(300))))
    check("mean of a line over 0.2-0.5", study.window_mean(s, 3 + 4 * s, (0.2, 0.5)) - 4.4, 1e-12)
    check("mean of a line over 0.5-1.0", study.window_mean(s, 3 + 4 * s, (0.5, 1.0)) - 6.0, 1e-12)
    claim("a curve that ends early has no mean", math.isnan(study.window_mean(s[s < 0.9], s[s < 0.9], (0.5, 1.0))))


def check_packing_names():
    base, late, soft = study.Case("base"), study.Case("late:fidelity.pile_velocity=0.2,run.damping=0.1"), study.Case("soft:grains.contact_modulus=1e7")
    claim("pile speed and damping leave the packing as it is", base.packing_name([], 1) == late.packing_name([], 1))
    claim("stiffness makes another packing", base.packing_name([], 1) != soft.packing_name([], 1))
    claim("so does a seed", base.packing_name([], 1) != base.packing_name([], 2))
    claim("and a key for all cases", base.packing_name([], 1) != base.packing_name(["grains.friction=0.1"], 1))


def write_run(folder, level, scale):
    """q = scale (level + s) MPa, shaft force 100 scale kN: means over 0.2-0.5 and 0.5-1 are scale (level + 0.35), scale (level + 0.75)."""
    os.makedirs(folder)
    with open(os.path.join(folder, "dem_history.csv"), "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["step", "S/D", "tip resistance [Pa]", "shaft force [N]"])
        writer.writerow([0, 0, 0, 0])  # Apply: the pile does not move
        for i in range(1, 102):
            writer.writerow([i, i / 101, 1e6 * scale * (level + i / 101), 1e5 * scale])
    with open(os.path.join(folder, "manifest.json"), "w") as file:
        json.dump({"exit_code": 0, "wall_seconds": 1.5}, file)


def check_study():
    # Seeds scatter by far more than the case does: its change is 10 % of each, so 10 % of the mean, and its error follows
    # from the differences 0.1 (level + 0.75) alone, where levels are 5, 7, 9.
    with tempfile.TemporaryDirectory() as folder:
        for seed, level in ((1, 5), (2, 7), (3, 9)):
            write_run(os.path.join(folder, f"base_seed{seed}"), level, 1.0)
            write_run(os.path.join(folder, f"more_seed{seed}"), level, 1.1)
        arguments = argparse.Namespace(scene="none", case=["base", "more"], seeds="1-3", windows="0.2-0.5,0.5-1.0", tolerance=0.08, out=folder,
                                       overrides=[], quiet=True)
        made = study.Study(arguments)
        table = made.write()
        with open(os.path.join(folder, "study.json")) as file:
            base, more = json.load(file)["cases"]
    late = base["quantities"][1]
    check("mean of three seeds", late["mean"] - 7.75, 1e-9)
    check("its standard error, 2/sqrt(3)", late["standard_error"] - 2 / math.sqrt(3), 1e-9)
    late = more["quantities"][1]
    check("paired change", late["change"] - 0.1, 1e-9)
    check("its standard error", late["change_standard_error"] - 0.1 * 2 / math.sqrt(3) / 7.75, 1e-9)
    claim("10 % is above the tolerance of 8 % and above two standard errors", not late["is_below_tolerance"] and not late["is_below_two_standard_errors"])
    claim("the table says so", "+10.0 % +- 1.5 of 3 pairs: it matters" in table)
    claim("shaft forces in kN", more["quantities"][3]["mean"] == 110 or abs(more["quantities"][3]["mean"] - 110) < 1e-9)


def check_refusals():
    for what, make in (("a case without a name", lambda: study.Case(":a=1")), ("a change without a value", lambda: study.Case("half:fidelity.step_fraction")),
                       ("seeds that are no numbers", lambda: study.seeds_of("1-x")), ("a window backwards", lambda: study.windows_of("0.5-0.2"))):
        try:
            make()
            claim(f"{what} is refused", False)
        except study.Failure as e:
            claim(f"{what} is refused: {e}", e.exit_code == 1)


check_window_mean()
check_packing_names()
check_study()
check_refusals()
if failures:
    print("wrong: " + ", ".join(failures))
sys.exit(1 if failures else 0)
