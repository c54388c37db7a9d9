#!/usr/bin/python3
"""Answers that tools/triaxial_fit.py and the search of tools/calibrate must give for tests made up with known ones. Prints the
errors; ends with 1 if one is too large."""

import argparse
import importlib.machinery
import importlib.util
import math
import os
import sys

TOOLS = os.path.join(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))), "tools")
sys.path.insert(0, TOOLS)
sys.dont_write_bytecode = True
import triaxial_fit as fit  # noqa: E402

np = fit.np
failures = []


def check(what, error, bound):
    print(f"{what}: error {error:.2e}, allowed {bound:g}")
    if not abs(error) <= bound:
        failures.append(what)


def elastic_curve(youngs, poisson, servo_error):
    """Hooke's law under an axial stress that grows by 100 kPa and a radial one that drifts by a share of it."""
    s1 = np.linspace(0, 100e3, 200)
    s3 = servo_error * s1
    return fit.Curve((s1 - 2 * poisson * s3) / youngs, (s3 - poisson * (s1 + s3)) / youngs, 100e3 + s1, 100e3 + s3)


def check_moduli():
    for servo_error in (0.0, 0.05, -0.05):
        youngs, poisson = fit.moduli(elastic_curve(44.3e6, 0.3, servo_error), fit.SECANT)
        check(f"E with a servo off by {servo_error:g}", youngs / 44.3e6 - 1, 1e-9)
        check(f"nu with a servo off by {servo_error:g}", poisson - 0.3, 1e-9)


def check_strength():
    # A friction angle that rises to 37 degrees at 3 % of strain and falls to 30 at 10 %, cosines that are flat at both; volume
    # falls by sin psi as psi = 15 degrees has it.
    strain = np.arange(0, 0.15, 1e-4)
    up, down = np.minimum(strain / 0.03, 1), np.clip((strain - 0.03) / 0.07, 0, 1)
    angle = np.radians(37 * np.sin(0.5 * np.pi * up) - 3.5 * (1 - np.cos(np.pi * down)))
    radial_stress = np.full_like(strain, 100e3)
    axial_stress = radial_stress * (1 + np.sin(angle)) / (1 - np.sin(angle))
    sine = math.sin(math.radians(15))
    k = 2 * sine / (1 - sine)  # sin psi = k/(2 + k)
    strength = fit.Strength(fit.Curve(strain, -0.5 * (1 + k) * strain, axial_stress, radial_stress))
    # Over the window of 0.002 around the peak the mean is 37/24 (pi/2 0.002/0.03)^2 / 2 = 8.5e-3 degrees lower where it rises.
    check("peak friction angle [degrees]", strength.peak - 37, 0.01)
    check("strain at the peak", strength.peak_strain - 0.03, 2e-3)
    check("residual friction angle [degrees]", strength.residual - 30, 1e-9)
    check("dilatancy angle [degrees]", strength.dilatancy - 15, 1e-9)


def check_mohr_coulomb():
    # s1 = N s3 + 2 c sqrt(N), N = (1 + sin)/(1 - sin); noise whose mean and first moment are zero leaves the line alone.
    angle, cohesion = 37.0, 5e3
    sine = math.sin(math.radians(angle))
    slope = (1 + sine) / (1 - sine)
    radial = np.array([100e3, 200e3, 300e3])
    axial = slope * radial + 2 * cohesion * math.sqrt(slope) + 2e3 * np.array([1, -2, 1])
    found, found_cohesion = fit.mohr_coulomb(axial, radial)
    check("Mohr-Coulomb friction angle [degrees]", found - angle, 1e-9)
    check("Mohr-Coulomb cohesion [Pa]", found_cohesion - cohesion, 1e-5)


def check_search():
    """Grains that answer by powers and logarithms other than the search's first guess."""
    loader = importlib.machinery.SourceFileLoader("calibrate", os.path.join(TOOLS, "calibrate"))
    calibrate = importlib.util.module_from_spec(importlib.util.spec_from_loader("calibrate", loader))
    loader.exec_module(calibrate)

    truth = np.log([80e6, 5.0, 0.5])

    class MadeUp(calibrate.Search):
        def trial(self):
            self.trials += 1
            if self.x is None:
                self.x = np.log([94e6, 8.0, 0.7])
            away = self.x - truth
            return np.array([math.log(44.3e6) + 0.95 * away[0] - 0.3 * away[1], 0.3 + 0.09 * away[1] - 0.02 * away[1] ** 2,
                             37 + 9 * away[2] - 2 * away[2] ** 2])

    arguments = argparse.Namespace(youngs_modulus=44.3e6, poisson_ratio=0.3, friction_angle=37.0, tolerance=1e-4, poisson_tolerance=1e-5,
                                   angle_tolerance=1e-3, most_trials=12)
    search = MadeUp(arguments, 1, None)
    parameters, _ = search.run()
    print(f"the search took {search.trials} trials")
    for name, error in zip(("contact modulus", "k_n/k_s", "friction"), np.log(parameters) - truth):
        check(f"ln {name}", error, 1e-3)


check_moduli()
check_strength()
check_mohr_coulomb()
check_search()
if failures:
    print("wrong: " + "; ".join(failures))
sys.exit(1 if failures else 0)
