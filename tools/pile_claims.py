"""What the paper saw in its pile's Figs. 8 to 13 and Table 3, one claim each: a number that runs give, a criterion that it must meet,
and the verdict that follows from both. Criteria are written out from the constants that judge."""

import dataclasses

import numpy as np

from pile_runs import ALONE, COUPLED, LARGEST, RING, TRACE_PLACES, Estimate, Missing, Region, mean_of, slope, within

EARLY, LATE = (0.0, 0.4), (0.7, 1.0)  # S/D in which the paper's curves rise, in which they have levelled off
BULB_EARLY = (0.1, 0.7)
PLATEAU_SHARE = 0.25  # of the early slope: what counts as a slight rise
AT_LIMIT = 0.1  # of the resistance at the end: how near it is at S/D = 0.7
STEADY_SHARE = 0.5  # of the early rate of change: a bulb that stands
CLOSE_SHARE = 0.5  # of the largest contacts: most of them
DECAY_SHARE = 0.5  # of the mean force within D/2: what is left from D to 3D/2
# The wedge that a footing drives before it: with 45 degrees and half of a friction angle of 35 at its sides it is 0.96 D deep.
CORE = Region((0, 0), (0.5, 0), (0, 1))
COLUMN = Region((0, 0.25), (0.5, 0.25), (0.5, 1), (0, 1))
SLEEVE = Region((0.5, 0), (0.75, 0), (0.75, -2), (0.5, -2))
ERRORS = 2  # standard errors that a change must exceed
ON_AXIS, AT_LEVEL = 0.1, 0.1  # of S: what counts as unmoved
ALIKE = 1.25  # ratio up to which two results are alike
CORRELATED = 0.5  # of two fields of porosity's change
CHEAPER = 1.25  # half of the paper's 2.5
PAPER_SPEED = 55 / 22
FIELD_R, FIELD_Z = np.arange(0, 1.5 + RING / 2, RING), np.arange(-2.5, 2.0 + RING / 2, RING)  # rings of Fig. 11 [D]
TIP, SHAFT = "tip resistance [Pa]", "shaft force [N]"


@dataclasses.dataclass
class Finding:
    """What a claim's number is here; `holds` is None where the runs do not tell, `is_narrow` says that another value within a standard
    error would be judged otherwise."""

    text: str
    holds: bool | None
    numbers: dict = dataclasses.field(default_factory=dict)
    why: str = ""
    is_narrow: bool = False

    def verdict(self):
        words = {True: "agrees", False: "does not agree", None: "not in this run"}[self.holds]
        return words + (", within its error" if self.is_narrow else "")


def found(words, test, number, numbers, why=""):
    """The finding that test(number's mean) decides."""
    holds = bool(test(number.mean))
    is_narrow = bool(np.isfinite(number.error)) and any(bool(test(number.mean + e)) != holds for e in (-number.error, number.error))
    error = number.error if np.isfinite(number.error) else None  # JSON has no nan
    return Finding(words, holds, {**numbers, "value": number.mean, "error": error}, why, is_narrow)


@dataclasses.dataclass
class Claim:
    figure: str
    saw: str  # the paper
    criterion: str
    judge: object  # of a group; of two where is_pair
    is_pair: bool = False

    def finding(self, *groups):
        try:
            return self.judge(*groups)
        except Missing as e:
            return Finding(str(e), None)


def percent(share):
    return f"{100 * share:g} %"


def text_of(window):
    return f"{window[0]:g} to {window[1]:g}"


def ratio(above, below):
    """Ratio of two means and its standard error; the parts' errors are taken as independent."""
    result = Estimate(above.mean / below.mean)
    parts = [e.error / e.mean for e in (above, below) if np.isfinite(e.error)]
    result.error = abs(result.mean) * float(np.hypot(*parts)) if len(parts) == 2 else np.nan
    return result


# ------------------------------------------------------------------------------------------------- Fig. 8: resistance


def window_slope(run, name, window):
    run.needs(window[1])
    at = np.arange(window[0], window[1] + 0.005, 0.01)
    at = at[at <= run.end]
    return slope(at, run.curve(name, at))


def slopes(group, window):
    each = [window_slope(run, TIP, window) for run in group.runs]
    return Estimate([s / 1e6 for s, _ in each], np.sqrt(sum(e**2 for _, e in each)) / len(each) / 1e6)


def is_slight_rise(early, late, error):
    """From slopes and the late one's standard error."""
    return bool(early > 0 and late < PLATEAU_SHARE * early and late > -error)


def plateau(group):
    early, late = slopes(group, EARLY), slopes(group, LATE)
    across = group.first.grains_across()
    return found(f"{late.text()} MPa per unit of S/D, {percent(round(late.mean / early.mean, 2))} of {early.text()}",
                 lambda value: is_slight_rise(early.mean, value, late.error), late, {"early": early.mean},
                 f"{across:.1f} grains across the pile" if across else "")


def window_mean(run, name, window):
    run.needs(window[1])
    return float(np.nanmean(run.curve(name, np.arange(window[0], min(window[1], run.end) + 0.005, 0.01))))


def resistance(group, window):
    return group.estimate(lambda run: window_mean(run, TIP, window) / 1e6)


def limit_reached(group):
    share = group.estimate(lambda run: window_mean(run, TIP, (0.65, 0.75)) / window_mean(run, TIP, (0.95, 1.0)))
    return found(share.text(), lambda value: abs(value - 1) < AT_LIMIT, share, {})


# ------------------------------------------------------------------------------------------------------- Fig. 9: bulb


def is_steady(early, late):
    return bool(late < STEADY_SHARE * early)


def steady_bulb(group):
    early = group.estimate(lambda run: run.bulb_rate(*BULB_EARLY) / 1e3)
    late = group.estimate(lambda run: run.bulb_rate(*LATE) / 1e3)
    return found(f"{late.text()} kPa per unit of S/D, {percent(round(late.mean / early.mean, 2))} of {early.text()}",
                 lambda value: is_steady(early.mean, value), late, {"early": early.mean},
                 f"the tip goes on by {LATE[1] - LATE[0]:.1g} D meanwhile, and the bulb goes with it")


# ----------------------------------------------------------------------------------------------------- Fig. 10: forces


def force_at(run, name, s_over_d):
    run.needs(s_over_d)
    forces = run.tip_forces()
    return float(forces[name][np.argmin(np.abs(forces["S/D"] - s_over_d))])


def largest_are_close(group):
    share = group.estimate(lambda run: force_at(run, "share of largest", LATE[1]))
    everywhere = group.estimate(lambda run: force_at(run, "share of all", LATE[1]))
    return found(f"{percent(round(share.mean, 3))}, and {percent(round(everywhere.mean, 3))} of all contacts",
                 lambda value: value > CLOSE_SHARE, share, {"of_all": everywhere.mean})


def forces_decay(group):
    share = group.estimate(lambda run: force_at(run, "away", LATE[1]) / force_at(run, "near tip", LATE[1]))
    return found(share.text(), lambda value: value < DECAY_SHARE, share, {})


def force_slope(run, window):
    run.needs(window[1])
    forces = run.tip_forces()
    chosen = within(forces["S/D"], (window[0] - 0.02, window[1] + 0.02))
    return slope(forces["S/D"][chosen], forces["near tip"][chosen])[0] / 1e3


def forces_slow_down(group):
    early, late = (group.estimate(lambda run, w=w: force_slope(run, w)) for w in (EARLY, LATE))
    return found(f"{late.text()} kN per unit of S/D, {percent(round(late.mean / early.mean, 2))} of {early.text()}",
                 lambda value: early.mean > 0 and value < PLATEAU_SHARE * early.mean, late, {"early": early.mean})


# --------------------------------------------------------------------------------------------------- Fig. 11: porosity


def porosity_change(group, region, s_over_d, is_same_place):
    """Mean porosity of a region that has gone with the tip, less that at S = 0: of the same place, or as far from the tip. The larger
    one of the errors from runs and from cells counts."""
    changes, errors = [], []
    for run in group.runs:
        run.needs(s_over_d)
        now, start = run.samples(s_over_d), run.samples(0.0)
        means = now.mean(region), start.mean(region, now.tip if is_same_place else start.tip)
        changes.append(means[0][0] - means[1][0])
        errors.append(np.hypot(means[0][1], means[1][1]))
    return Estimate(changes, np.sqrt(np.sum(np.square(errors))) / len(errors))


def has_changed(change, error, direction):
    return bool(direction * change > ERRORS * error)


def porosity_claim(region, direction):
    """Both comparisons must hold: beside pile and tip grains are looser than in bulk whatever the pile has done, which helps one and
    hinders the other."""

    def judge(group):
        here, along = (porosity_change(group, region, LATE[0], is_same_place) for is_same_place in (True, False))
        return Finding(f"{here.mean:+.3f} ± {here.error:.3f} at the place, {along.mean:+.3f} ± {along.error:.3f} as far from the tip",
                       all(has_changed(e.mean, e.error, direction) for e in (here, along)),
                       {"change_at_place": here.mean, "error_at_place": here.error, "change_along": along.mean, "error_along": along.error})

    return judge


def field_change(group, s_over_d):
    return group.rings(s_over_d, FIELD_R, FIELD_Z) - group.rings(0.0, FIELD_R, FIELD_Z)


def correlation(a, b):
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < 3:
        raise Missing("the two fields of porosity do not overlap")
    return float(np.corrcoef(a[both], b[both])[0, 1]), float(np.sqrt(np.mean((a[both] - b[both]) ** 2)))


def fields_alike(coupled, alone):
    each = [correlation(field_change(coupled, at), field_change(alone, at)) for at in (0.3, 0.7)]
    return Finding(f"correlation {each[0][0]:.2f} and {each[1][0]:.2f} at S/D = 0.3 and 0.7, rms difference {each[0][1]:.3f} and "
                   f"{each[1][1]:.3f}", all(c > CORRELATED for c, _ in each),
                   {"correlation_0.3": each[0][0], "correlation_0.7": each[1][0], "rms_0.3": each[0][1], "rms_0.7": each[1][1]},
                   f"means of {len(coupled.runs)} and {len(alone.runs)} packings")


# ------------------------------------------------------------------------------------------------- Figs. 12, 13: traces


def trace_end(run, role, way, s_over_d=1.0):
    """Mean over the grains of a role at an S/D [D]."""
    run.needs(s_over_d)
    traces = run.traces()[role]
    if not traces:
        raise Missing(f"no traced grain {role}")
    return mean_of(np.array([np.interp(s_over_d, t.penetration, getattr(t, way)) for t in traces]))


def trace(group, role, way, s_over_d=1.0):
    return group.estimate(lambda run: trace_end(run, role, way, s_over_d))


def down_in_order(group):
    down = {role: trace(group, role, "down") for role in TRACE_PLACES}
    ahead = group.estimate(lambda run: trace_end(run, 1, "down") - max(trace_end(run, role, "down") for role in (2, 3, 4)))
    return found(", ".join(f"{role}: {e.text(2)}" for role, e in down.items()) + " D", lambda value: value > 0, ahead,
                 {f"down_{role}": e.mean for role, e in down.items()})


def third_goes_down(group):
    down = trace(group, 3, "down")
    return found(f"{down.text(2)} D", lambda value: value > AT_LEVEL, down, {})


def fourth_stays_level(group):
    down = trace(group, 4, "down")
    return found(f"{down.text(2)} D", lambda value: value < AT_LEVEL, down, {})


def first_stays_on_axis(group):
    sideways = trace(group, 1, "sideways")
    off = np.mean([np.hypot(*t.start[:2]) for run in group.runs for t in run.traces()[1]])
    return found(f"{sideways.text(2)} D", lambda value: value < ON_AXIS, sideways, {"start_off_axis": float(off)},
                 f"the grain nearest to the axis starts {off:.2f} D off it")


def third_moves_outwards(group):
    third, fourth = trace(group, 3, "sideways"), trace(group, 4, "sideways")
    ahead = group.estimate(lambda run: trace_end(run, 3, "sideways") - trace_end(run, 4, "sideways"))
    return found(f"3: {third.text(2)}, 4: {fourth.text(2)} D", lambda value: value > 0 and fourth.mean > 0, ahead,
                 {"sideways_3": third.mean, "sideways_4": fourth.mean})


# ------------------------------------------------------------------------------------------------------------ the pair


def is_alike(value):
    return bool(1 / ALIKE < value < ALIKE)


def resistance_alike(coupled, alone):
    share = ratio(resistance(coupled, LATE), resistance(alone, LATE))
    return found(share.text(), is_alike, share, {})


def forces_alike(coupled, alone):
    mean = [group.estimate(lambda run: np.mean([force_at(run, "near tip", at) for at in (0.7, 0.8, 0.9, 1.0)])) for group in (coupled, alone)]
    share = ratio(*mean)
    return found(share.text(), is_alike, share, {})


def wall_seconds(run):
    seconds = run.summary.get("seconds") or run.manifest.get("wall_seconds")
    if not seconds:
        raise Missing(f"{run.name} tells no wall time")
    return float(seconds)


def stage_seconds(run):
    stages = run.summary.get("stages", {})
    return {stage: float(tells["seconds"]) for stage, tells in stages.items() if "seconds" in tells}


def push_seconds(run):
    """Apply and Penetrate: what does not depend on whether a packing was made or taken from a file."""
    stages = stage_seconds(run)
    if not run.summary.get("steps") or "Penetrate" not in stages:
        raise Missing(f"{run.name} does not tell steps and seconds of Penetrate")
    return stages["Penetrate"] + stages.get("Apply", 0.0)


def step_seconds(run):
    return push_seconds(run) / run.summary["steps"]


def fastest(group):
    """The run that other work on the machine has held up least: what runs cost is told of it, not of the mean."""
    return min(group.runs, key=push_seconds)


def speed(coupled, alone):
    push, step, whole = (Estimate(measure(fastest(alone)) / measure(fastest(coupled))) for measure in (push_seconds, step_seconds, wall_seconds))
    grains = alone.first.summary.get("grains", np.nan) / coupled.first.summary.get("grains", np.nan)
    return found(f"{push.text()}; of one step {step.mean:.2f}, of the whole wall time {whole.mean:.2f}, of the grains {grains:.2f}",
                 lambda value: value > CHEAPER, push, {"step_time": step.mean, "wall_time": whole.mean, "grains": grains},
                 f"dem_server with {fastest(coupled).threads()} and {fastest(alone).threads()} threads on "
                 f"{fastest(coupled).manifest.get('cores', '?')} cores, beside it continuum_client in the coupled run")


CLAIMS = (
    Claim("Fig. 8", "tip resistance tends to a limit near S/D = 0.7",
          f"mean over S/D 0.65 to 0.75 within {percent(AT_LIMIT)} of that over 0.95 to 1.0", limit_reached),
    Claim("Fig. 8", "and then rises slightly",
          f"slope over S/D {text_of(LATE)} below {percent(PLATEAU_SHARE)} of that over {text_of(EARLY)}, and not below 0 by more than its "
          "standard error", plateau),
    Claim("Fig. 8", "both methods give similar results (told of Figs. 10 and 11)",
          f"mean tip resistance over S/D {text_of(LATE)}: coupled over particles only between {1 / ALIKE:g} and {ALIKE:g}",
          resistance_alike, True),
    Claim("Fig. 9", "the bulb of vertical stress grows, then is steady from S/D = 0.7",
          f"rms change of stress in the zones, by volume, per unit of S/D over {text_of(LATE)} below {percent(STEADY_SHARE)} of that over "
          f"{text_of(BULB_EARLY)}", steady_bulb),
    Claim("Fig. 10", "the largest contact forces are close to the tip",
          f"of the {LARGEST} largest contacts between grains more than {percent(CLOSE_SHARE)} within D of the tip's centre, "
          "S/D = 1", largest_are_close),
    Claim("Fig. 10", "and decrease quickly away from it",
          f"mean force from D to 3D/2 of the tip's centre below {DECAY_SHARE:g} of that within D/2, S/D = 1", forces_decay),
    Claim("Fig. 10", "contact forces at the tip grow, then slow down at the limit",
          f"growth of the mean force within D/2 of the tip's centre over S/D {text_of(LATE)} below {percent(PLATEAU_SHARE)} of that over "
          f"{text_of(EARLY)}", forces_slow_down),
    Claim("Fig. 10", "both methods show the same forces",
          f"mean force within D/2 of the tip's centre, S/D {text_of(LATE)}: coupled over particles only between {1 / ALIKE:g} and {ALIKE:g}",
          forces_alike, True),
    Claim("Fig. 11", "a dense core under the tip",
          f"porosity in the cone under the tip, {CORE.corners[:, 1].max():g} D deep, S/D = {LATE[0]:g}: lower than at S = 0 at the same "
          f"place, and than under the tip then, each by more than {ERRORS} standard errors", porosity_claim(CORE, -1)),
    Claim("Fig. 11", "the core, taken as wide as the pile",
          f"the same of the column under the tip, {COLUMN.corners[:, 1].min():g} to {COLUMN.corners[:, 1].max():g} D deep and as wide as the pile",
          porosity_claim(COLUMN, -1)),
    Claim("Fig. 11", "a loose (dilated) sleeve along the shaft",
          f"porosity within {np.ptp(SLEEVE.corners[:, 0]):g} D of the shaft, 0 to {-SLEEVE.corners[:, 1].min():g} D above the tip, S/D = "
          f"{LATE[0]:g}: higher than at S = 0 at the same place, and than as far from the tip then, each by more than {ERRORS} standard errors",
          porosity_claim(SLEEVE, 1)),
    Claim("Fig. 11", "both methods show similar porosity",
          f"change of porosity since S = 0, in rings of {RING:g} D: correlation above {CORRELATED:g}", fields_alike, True),
    Claim("Fig. 13", "1 goes down most, more than 2 below it and 3 beside it",
          "way down at S/D = 1, mean over sides: 1 above 2, 3 and 4", down_in_order),
    Claim("Fig. 13", "3 goes down too", f"way down at S/D = 1 above {AT_LEVEL:g} S", third_goes_down),
    Claim("Fig. 13", "4 does not go down", f"way down at S/D = 1 below {AT_LEVEL:g} S", fourth_stays_level),
    Claim("Fig. 13", "3 moves sideways more than 4, both outwards", "way outwards at S/D = 1, mean over sides: 3 above 4 above 0",
          third_moves_outwards),
    Claim("Fig. 13", "1 stays on the axis", f"horizontal way at S/D = 1 below {ON_AXIS:g} S", first_stays_on_axis),
    Claim("Table 3", f"the coupled run is {PAPER_SPEED:g} times cheaper than particles only",
          f"time of Apply and Penetrate, fastest runs, particles only over coupled, above {CHEAPER:g}", speed, True),
)


def finding_of(judge, *groups):
    """What the claim that judge decides finds."""
    return next(claim for claim in CLAIMS if claim.judge is judge).finding(*groups)


def pair_of(groups):
    """The first coupled group and the first of particles only, or None."""
    first = [next((group for group in groups if group.kind == kind), None) for kind in (COUPLED, ALONE)]
    return first if all(first) else None


def judged(groups):
    """[(claim, [(label, finding), ...]), ...]"""
    pair, table = pair_of(groups), []
    lacks = "needs a run of particles only" if groups[0].kind == COUPLED else "needs a coupled run"
    for claim in CLAIMS:
        if claim.is_pair:
            table.append((claim, [("both", claim.finding(*pair) if pair else Finding(lacks, None))]))
        else:
            table.append((claim, [(group.label, claim.finding(group)) for group in groups]))
    return table
