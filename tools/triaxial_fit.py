"""What a triaxial test says: moduli, strength, and the line through several tests. Used by tools/triaxial and tools/calibrate.

Strains are logarithmic, strains and stresses positive in compression; SI."""

import csv
import json
import math
import os
import subprocess
import sys

try:
    import numpy as np
except ImportError as e:
    print(f"{os.path.basename(sys.argv[0])}: {e}; install with tools/setup --pictures --no-build", file=sys.stderr)
    sys.exit(1)

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
CELL = os.path.join(ROOT, "build", "release", "bin", "triaxial_cell")

TANGENT = (2e-5, 1e-4)  # axial strains between which E and nu are tangents: before contacts slide
SECANT = (0.0, 1e-3)  # and secants
PEAK_WINDOW = 2e-3  # axial strain over which a friction angle is averaged before its peak is looked for
RESIDUAL_WINDOW = 0.02  # the last strains, whose mean is the residual angle


class Failure(Exception):
    def __init__(self, exit_code, text):
        super().__init__(text)
        self.exit_code = exit_code


def read_table(path):
    """Columns of a CSV file by name."""
    try:
        with open(path, newline="") as file:
            rows = list(csv.reader(file))
    except OSError as e:
        raise Failure(2, f"{path}: {e.strerror}") from e
    values = [row for row in rows[1:] if len(row) == len(rows[0])]
    if not values:
        raise Failure(2, f"{path} has no rows; the run that wrote it did not get anywhere")
    table = np.array(values, dtype=float)
    return {name: table[:, k] for k, name in enumerate(rows[0])}


class Curve:
    """One test: arrays of axial strain, radial strain, axial stress and radial stress."""

    def __init__(self, axial_strain, radial_strain, axial_stress, radial_stress):
        self.axial_strain, self.radial_strain = axial_strain, radial_strain
        self.axial_stress, self.radial_stress = axial_stress, radial_stress
        self.volume_strain = axial_strain + 2 * radial_strain
        self.deviator = axial_stress - radial_stress

    def friction_angle(self):
        """Mobilised, secant through the origin [degrees]."""
        return np.degrees(np.arcsin(self.deviator / (self.axial_stress + self.radial_stress)))


def curve_of_cell(path):
    t = read_table(path)
    return Curve(t["axial strain"], t["radial strain"], t["axial stress [Pa]"], t["radial stress [Pa]"])


def curve_of_cylinder(folder):
    """From the walls `top`, `bottom` and `mantle` of a run: platens' mean force over the present cross-section, mantle's
    pressure, height and radius where the walls stand."""
    t = read_table(os.path.join(folder, "wall_history.csv"))
    try:
        height = t["top centre z [m]"] - t["top servo way [m]"] - t["bottom centre z [m]"]
        radius = t["mantle radius [m]"]
        force = 0.5 * (t["top force z [N]"] - t["bottom force z [N]"])
        pressure = t["mantle pressure [Pa]"]
    except KeyError as e:
        raise Failure(1, f"{folder}: wall_history.csv has no column {e}; a triaxial scene has planes \"top\" and \"bottom\" and "
                         "a cylinder \"mantle\" with a servo") from e
    return Curve(-np.log(height / height[0]), -np.log(radius / radius[0]), force / (math.pi * radius**2), pressure)


def moduli(curve, strains):
    """E [Pa] and nu between two axial strains, of an isotropic elastic body under the stresses that acted, a servo's error
    included:  e1 = s1/E - 2 nu/E s3,  e3 = (s3 - nu (s1 + s3))/E  for the changes, linear in 1/E and nu/E."""

    def at(values, strain):
        return np.interp(strain, curve.axial_strain, values)

    if curve.axial_strain[-1] < strains[1]:
        raise Failure(1, f"the test ended at an axial strain of {curve.axial_strain[-1]:.2g}; E is measured up to {strains[1]:g}")
    change = [at(v, strains[1]) - at(v, strains[0])
              for v in (curve.axial_strain, curve.radial_strain, curve.axial_stress, curve.radial_stress)]
    e1, e3, s1, s3 = change
    compliance, cross = np.linalg.solve([[s1, -2 * s3], [s3, -(s1 + s3)]], [e1, e3])
    return 1 / compliance, cross / compliance


class Strength:
    """Peak and residual friction angle [degrees], strain, stresses and dilatancy angle at the peak."""

    def __init__(self, curve):
        strain = curve.axial_strain
        angle = curve.friction_angle()
        smooth = self.mean_over(strain, angle)
        peak = int(np.argmax(smooth))
        self.peak, self.peak_strain = smooth[peak], strain[peak]
        self.peak_axial = self.mean_over(strain, curve.axial_stress)[peak]
        self.peak_radial = self.mean_over(strain, curve.radial_stress)[peak]
        self.is_past_peak = strain[-1] > self.peak_strain + PEAK_WINDOW
        last = strain > strain[-1] - RESIDUAL_WINDOW
        self.residual = float(np.mean(angle[last]))
        self.residual_axial, self.residual_radial = (float(np.mean(v[last])) for v in (curve.axial_stress, curve.radial_stress))
        # sin psi = k/(2 + k), k = -d ev/d e1, over half the strain at the peak on either side of it.
        near = np.abs(strain - self.peak_strain) < 0.5 * self.peak_strain
        k = -np.polyfit(strain[near], curve.volume_strain[near], 1)[0] if np.count_nonzero(near) > 2 else float("nan")
        self.dilatancy = math.degrees(math.asin(k / (2 + k))) if k > -1 else float("nan")

    @staticmethod
    def mean_over(strain, values):
        """Of each row, over PEAK_WINDOW of strain around it."""
        low = np.searchsorted(strain, strain - 0.5 * PEAK_WINDOW)
        high = np.searchsorted(strain, strain + 0.5 * PEAK_WINDOW, side="right")
        sums = np.concatenate([[0], np.cumsum(values)])
        return (sums[high] - sums[low]) / (high - low)


def mohr_coulomb(axial, radial):
    """Friction angle [degrees] and cohesion [Pa] of the line s1 = N s3 + 2 c sqrt(N) of least squares, N = (1 + sin)/(1 - sin)."""
    slope, offset = np.polyfit(radial, axial, 1)
    if slope <= 0:
        raise Failure(4, f"the axial stress does not rise with the radial one (slope {slope:.3g}): no friction angle fits")
    return math.degrees(math.asin((slope - 1) / (slope + 1))), offset / (2 * math.sqrt(slope))


def run_cell(scene, out, pressure, strain, overrides=(), options=()):
    """A test in the periodic cell: its curve, and what was tested (radius_m, contact_modulus_pa, ...)."""
    if not os.path.isfile(CELL):
        raise Failure(2, f"{CELL}: not there; build first with tools/setup")
    command = [CELL, scene, "--out", out, "--pressure", repr(pressure), "--strain", repr(strain)]
    # Packed at the pressure of the test: packed at less, the cell would be denser than asked for once it is pressed.
    for override in [f"grains.packing.cube_pressure={pressure!r}", *overrides]:
        command += ["--set", override]
    done = subprocess.run(command + [str(o) for o in options], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise Failure(done.returncode if done.returncode > 0 else 5, (done.stderr or done.stdout).strip())
    return curve_of_cell(out), json.loads(done.stdout)
