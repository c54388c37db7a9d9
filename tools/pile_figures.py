"""Figures of tools/report: the paper's Figs. 8 to 13 from groups of runs (pile_runs.py). Each function takes the groups to show and
returns a figure as wide as a page of A4 between its margins."""

import textwrap

import numpy as np
from matplotlib import pyplot
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

import pile_claims as claims
from pile_runs import ALONE, COUPLED, GRAIN, PILE_CONTACT, RING, TRACE_PLACES, Missing
from run_files import pebbles_behind_plane, pile_outline, read_vtk, rounded_limit
from run_painting import PALE, PILE, paint_grains, paint_pile, paint_zones

WIDTH = 7.2  # [in]
COLORS = ("#1f5fa8", "#c0562f", "#3a8a4d", "#7a4fa0")
TRACE_COLORS = {1: "#b3202c", 2: "#d98a1f", 3: "#1f5fa8", 4: "#3a8a4d"}
NETWORK, AT_PILE = "#1d1d1d", "#b3202c"
LEVELS = (0.1, 0.3, 0.5, 0.7, 1.0)  # S/D of Fig. 10
BULB_LEVELS = (0.1, 0.5, 0.7, 1.0)  # of Fig. 9
POROSITY_LEVELS = (0.3, 0.7)  # of Fig. 11

pyplot.rcParams.update({"font.size": 8.5, "axes.titlesize": 8.5, "axes.labelsize": 8.5, "xtick.labelsize": 8, "ytick.labelsize": 8,
                        "legend.fontsize": 8, "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False,
                        "figure.titlesize": 10, "figure.titleweight": "bold", "svg.fonttype": "path", "axes.linewidth": 0.7})


def new_figure(height, rows=1, columns=1, **kinds):
    return pyplot.subplots(rows, columns, figsize=(WIDTH, height), squeeze=False, constrained_layout=True, **kinds)


def entitle(figure, text):
    figure.suptitle(textwrap.fill(text, 88))
    return figure


def seeds_of(group):
    return f"{len(group.runs)} seeds" if len(group.runs) > 1 else f"seed {group.first.seed}"


def label_of(group, groups):
    """As short as tells it from the others of the figure."""
    is_one = sum(other.kind == group.kind for other in groups) == 1
    return group.kind if is_one else textwrap.fill(group.label, 26, break_long_words=False)


def add_legend(axes, groups):
    """In the upper left corner, which curves that rise leave free for two names."""
    if len(groups) > 2:
        axes.set_ylim(None, axes.get_ylim()[1] * (1 + 0.15 * len(groups)))
    axes.legend(frameon=False, loc="upper left", labelspacing=0.3)


def color_of(groups, group):
    return COLORS[groups.index(group) % len(COLORS)]


def with_data(groups, test):
    """The groups for which test(group) does not raise Missing; Missing, with the last one's words, if there are none."""
    shown, words = [], "no run holds it"
    for group in groups:
        try:
            test(group)
            shown.append(group)
        except Missing as e:
            words = str(e)
    if not shown:
        raise Missing(words)
    return shown


def paint_band(axes, x, curves, color, label):
    """Mean as a line, standard deviation as a band, single runs thin."""
    mean = np.nanmean(curves, axis=0)
    if len(curves) > 1:
        spread = np.nanstd(curves, axis=0, ddof=1)
        axes.fill_between(x, mean - spread, mean + spread, color=color, alpha=0.2, linewidth=0)
        for curve in curves:
            axes.plot(x, curve, color=color, linewidth=0.4, alpha=0.6)
    axes.plot(x, mean, color=color, linewidth=1.8, label=label)


def finish_curve(axes, ylabel, end=1.0):
    axes.set_xlim(0, np.ceil(end / 0.05 - 0.1) * 0.05)
    axes.set_ylim(min(0, axes.get_ylim()[0]), None)
    axes.set_xlabel("penetration S/D [-]")
    axes.set_ylabel(ylabel)
    axes.grid(color=PALE)


def pile_in(axes, run, s_over_d, top, unit=1.0):
    """The pile, in lengths of `unit` [m] with z from `run.tip_start` where they are relative."""
    paint_pile(axes, [(x / unit, z / unit) for x, z in pile_outline(run.scene, run.diameter / 2, run.tip(s_over_d), top)])


# --------------------------------------------------------------------------------------------------------- the model


def network_lines(run, s_over_d, thickness):
    """Contacts between grains and with the pile in a slice around y = 0: lines (x, z) [m], forces [N], whether at the pile."""
    ends, force, family = run.contacts(run.state("contacts", s_over_d))
    shown = np.isin(family, (GRAIN, PILE_CONTACT)) & (np.abs(ends[:, :, 1].mean(axis=1)) < thickness / 2)
    return ends[shown][:, :, [0, 2]], force[shown], family[shown] == PILE_CONTACT


def paint_network(axes, lines, force, is_pile, scale, widest=5.0):
    strong = force > 0.01 * scale
    for chosen, color in ((strong & ~is_pile, NETWORK), (strong & is_pile, AT_PILE)):
        axes.add_collection(LineCollection(lines[chosen], linewidths=widest * force[chosen] / scale, colors=color, capstyle="round",
                                           zorder=4))


def slice_thickness(run):
    return 2 * run.summary.get("mean_radius_m", run.diameter / 8)  # one grain's diameter


def model_view(groups):
    """Grains with the forces they carry, and the ground around with its change of stress, at the end of the first run."""
    run = groups[0].first
    has_ground = run.kind == COUPLED
    at = run.end
    window = 1.75 * run.diameter
    low, high = run.tip(at) - 2.5 * run.diameter, run.tip_start + 1.5 * run.diameter
    figure, axes = new_figure(4.4, 1, 2 if has_ground else 1, gridspec_kw={"width_ratios": [1, 1.25]} if has_ground else None)
    grains = axes[0, 0]
    arrays = read_vtk(run.state("particles", at))
    paint_grains(grains, pebbles_behind_plane(arrays), 0.15, alpha=0.75)
    lines, force, is_pile = network_lines(run, at, slice_thickness(run))
    in_view = (lines[:, :, 1].min(axis=1) < high) & (lines[:, :, 1].max(axis=1) > low)
    scale = force[in_view].max(initial=1.0)
    paint_network(grains, lines[in_view], force[in_view], is_pile[in_view], scale)
    pile_in(grains, run, at, high + run.diameter)
    grains.plot([-run.diameter / 2, run.diameter / 2], [run.tip_start] * 2, color="white", linestyle="--", linewidth=1, zorder=5)
    grains.text(0, run.tip_start, "S = 0", color="white", ha="center", va="bottom", zorder=5)
    grains.set_title(f"grains just behind y = 0, forces between them\nas lines (thickest: {scale / 1e3:.3g} kN; at the pile red)")
    grains.set(xlim=(-window, window), ylim=(low, high), aspect="equal", xlabel="x [m]", ylabel="z [m]")
    if has_ground:
        ground = axes[0, 1]
        polygons, _, change = run.stress_section(at)
        limit = rounded_limit(change / 1e3)
        mesh = paint_zones(ground, polygons, change / 1e3, limit, linewidth=0.2)
        pile_in(ground, run, at, 0.5 * run.diameter)
        points = np.concatenate(polygons)
        ground.add_patch(Rectangle((-window, low), 2 * window, high - low, fill=False, linestyle=":", linewidth=0.9))
        ground.set(xlim=(points[:, 0].min(), points[:, 0].max()), ylim=(points[:, 1].min(), 0.5), aspect="equal", xlabel="x [m]")
        ground.set_title("zones, change of vertical stress since Excavate;\ndotted: the part on the left")
        bar = figure.colorbar(mesh, ax=ground, shrink=0.75, extend="both")
        bar.set_label("change [kPa], compression red")
    return entitle(figure, f"The model at S/D = {at:.2f}: {run.kind}, seed {run.seed}")


# -------------------------------------------------------------------------------------------------- Fig. 8: resistance


def resistance_curves(groups):
    figure, axes = new_figure(3.3, 1, 2)
    for panel, name, scale, label in ((axes[0, 0], claims.TIP, 1e-6, "tip resistance [MPa]"),
                                      (axes[0, 1], claims.SHAFT, 1e-3, "shaft force [kN]")):
        for group in groups:
            paint_band(panel, group.penetration, group.curves(name, scale), color_of(groups, group),
                       f"{label_of(group, groups)}, {seeds_of(group)}")
            for run in group.broken_off:
                reached = group.penetration[group.penetration <= run.end]
                panel.plot(reached, run.curve(name, reached) * scale, color=color_of(groups, group), linewidth=0.7, linestyle=":")
        finish_curve(panel, label, max(group.end for group in groups))
        panel.axvline(claims.LATE[0], color="0.5", linestyle=":", linewidth=1)
    axes[0, 0].text(claims.LATE[0] - 0.01, 0.02, "paper: limit", rotation=90, color="0.4", ha="right", va="bottom", fontsize=8,
                    transform=axes[0, 0].get_xaxis_transform())
    add_legend(axes[0, 0], groups)
    return entitle(figure, slope_title(groups))


def share_of_early(judge, group):
    """What a claim's late value is of the early one, in percent; None where the group does not tell."""
    numbers = claims.finding_of(judge, group).numbers
    return f"{100 * numbers['value'] / numbers['early']:.0f} %" if numbers else None


def slope_title(groups):
    shares = [(share_of_early(claims.plateau, group), group.label) for group in groups]
    told = [f"{share} ({label})" for share, label in shares if share]
    if not told:
        return "Tip resistance and shaft force against penetration"
    return f"Tip resistance: the slope after S/D = 0.7 is {', '.join(told)} of the first slope"


# ------------------------------------------------------------------------------------------------------- Fig. 9: bulb


def hole_of(polygons):
    """Radius and bottom of the hole in a section through its axis [m]."""
    points = np.concatenate(polygons)
    near_axis = points[np.abs(points[:, 0]) < 1e-6 + 0.01 * np.ptp(points[:, 0])]
    bottom = near_axis[:, 1].max() if len(near_axis) else points[:, 1].min()
    above = points[points[:, 1] > bottom + 1e-6]
    return (np.abs(above[:, 0]).min(), bottom) if len(above) else (0.0, np.inf)


def contour_levels(limit):
    """Round values of compression, from an eighth of the limit to the limit."""
    steps = np.outer(10.0 ** np.arange(-3, 7), (1, 2, 5)).ravel()
    return -steps[(steps >= limit / 8) & (steps < limit)][::-1]


def paint_contours(axes, polygons, values, levels):
    """Lines of equal value in the section, outside the hole, with their values."""
    center = np.array([polygon.mean(axis=0) for polygon in polygons])
    radius, bottom = hole_of(polygons)
    for side in (-1, 1):
        chosen = side * center[:, 0] > 0
        mesh = Triangulation(center[chosen, 0], center[chosen, 1])
        middle = center[chosen][mesh.triangles].mean(axis=1)
        mesh.set_mask((np.abs(middle[:, 0]) < radius) & (middle[:, 1] > bottom))
        if chosen.sum() < 4 or not ((levels > values[chosen].min()) & (levels < values[chosen].max())).any():
            continue
        lines = axes.tricontour(mesh, values[chosen], levels=levels, colors="black", linestyles="solid", linewidths=0.6)
        if side > 0:
            axes.clabel(lines, fmt="%g", fontsize=7, inline_spacing=1)


def bulb_sections(groups):
    group = with_data(groups, lambda g: g.first.stress_section(min(BULB_LEVELS)))[0]
    run = group.first
    levels = [at for at in BULB_LEVELS if at <= run.end + 0.03]
    sections = []
    for at in levels:
        polygons, stress, change = run.stress_section(at)
        sections.append((at, polygons, change / 1e3, stress / 1e3))
    half = 1.7
    low, high = run.tip(run.end) - 2.6, run.tip_start + 0.8
    # The scales are those of what is seen of the last state.
    center = np.array([polygon.mean(axis=0) for polygon in sections[-1][1]])
    seen = (np.abs(center[:, 0]) < half) & (center[:, 1] > low) & (center[:, 1] < high)
    if not seen.any():
        raise Missing("no zones around the tip")
    limit = rounded_limit(sections[-1][2][seen])
    deepest = rounded_limit(sections[-1][3][seen])
    figure, axes = new_figure(4.7, 2, len(levels), sharex=True, sharey=True)
    for column, (at, polygons, change, stress) in enumerate(sections):
        whole = paint_zones(axes[0, column], polygons, stress, deepest, linewidth=0)
        whole.set(cmap="YlOrRd_r", clim=(-deepest, 0), edgecolor="face")
        bulb = paint_zones(axes[1, column], polygons, change, limit, linewidth=0)
        bulb.set_edgecolor("face")
        paint_contours(axes[1, column], polygons, change, contour_levels(limit))
        for panel in axes[:, column]:
            pile_in(panel, run, at, high + 1)
            panel.set(xlim=(-half, half), ylim=(low, high), aspect="equal")
        axes[0, column].set_title(f"S/D = {at:g}")
        axes[1, column].set_xlabel("x [m]")
    for panel in axes[:, 0]:
        panel.set_ylabel("z [m]")
    figure.colorbar(whole, ax=list(axes[0]), extend="min", aspect=14).set_label("vertical stress [kPa]")
    figure.colorbar(bulb, ax=list(axes[1]), extend="both", aspect=14).set_label("its change [kPa]")
    share = share_of_early(claims.steady_bulb, group)
    rate = f"; after S/D = 0.7 it changes at {share} of its rate before" if share else ""
    return entitle(figure, f"The bulb of vertical stress in the ground{rate}")


def bulb_growth(groups):
    shown = with_data(groups, lambda g: g.first.bulb_sizes())
    figure, axes = new_figure(2.5, 1, 2)
    for group in shown:
        for panel, which in zip(axes[0], (0, 1)):
            at = group.first.bulb_sizes()[which][0]
            curves = [np.interp(at, *run.bulb_sizes()[which]) / 1e3 for run in group.runs]
            paint_band(panel, at, np.array(curves), color_of(groups, group), label_of(group, shown))
    for panel, label in ((axes[0, 0], "rms change of stress in the\nzones since Excavate [kPa]"),
                         (axes[0, 1], "rate of change of the stress,\nrms [kPa per unit of S/D]")):
        finish_curve(panel, label, max(group.end for group in shown))
        panel.axvline(claims.LATE[0], color="0.5", linestyle=":", linewidth=1)
    if len(shown) > 1:
        add_legend(axes[0, 0], shown)
    return entitle(figure, "How large the bulb is, and how fast it still changes")


# ----------------------------------------------------------------------------------------------------- Fig. 10: forces


def network_panels(groups):
    shown = with_data(groups, lambda g: g.first.state("contacts", LEVELS[0]))
    levels = [at for at in LEVELS if any(at <= g.first.end + 0.03 for g in shown)]
    drawn = {(group, at): network_lines(group.first, at, 2 * slice_thickness(group.first)) for group in shown for at in levels
             if at <= group.first.end + 0.03}
    window, low, high = 1.1, -2.1, 0.45  # [D]
    largest = 0.0
    for (group, at), (lines, force, _) in drawn.items():
        relative = (lines.mean(axis=1) - [0, group.first.tip_start]) / group.first.diameter
        seen = (np.abs(relative[:, 0]) < window) & (relative[:, 1] > low) & (relative[:, 1] < high)
        largest = max(largest, force[seen].max(initial=0))
    figure, axes = new_figure(0.75 + 1.6 * len(shown), len(shown), len(levels), sharex=True, sharey=True)
    for row, group in enumerate(shown):
        run = group.first
        for column, at in enumerate(levels):
            panel = axes[row, column]
            if (group, at) in drawn:
                lines, force, is_pile = drawn[group, at]
                paint_network(panel, (lines - [0, run.tip_start]) / run.diameter, force, is_pile, largest, widest=5.5)
                tip = -at
                panel.add_patch(Rectangle((-0.5, tip), 1, 9, facecolor=PILE, edgecolor="black", linewidth=0.6, zorder=3))
            panel.set(xlim=(-window, window), ylim=(low, high), aspect="equal")
            panel.xaxis.set_major_locator(MaxNLocator(3))
            if row == 0:
                panel.set_title(f"S/D = {at:g}")
        axes[row, 0].set_ylabel(f"{label_of(group, shown)}\nz from the tip at S = 0 [D]")
    for panel in axes[-1]:
        panel.set_xlabel("x [D]")
    return entitle(figure, f"Contact forces gather under the tip (thickest line {largest / 1e3:.3g} kN; at the pile red)")


def tip_force_curves(groups):
    shown = with_data(groups, lambda g: g.first.tip_forces())
    figure, axes = new_figure(2.7, 1, 3)
    for group in shown:
        at = group.first.tip_forces()["S/D"]
        for panel, name in zip(axes[0], ("largest at tip", "near tip", "away")):
            curves = [np.interp(at, run.tip_forces()["S/D"], run.tip_forces()[name]) / 1e3 for run in group.runs]
            paint_band(panel, at, np.array(curves), color_of(groups, group), label_of(group, shown))
    top = max(axes[0, 1].get_ylim()[1], axes[0, 2].get_ylim()[1])
    for panel, label in zip(axes[0], ("largest force, grain with tip [kN]", "mean force within D/2\nof the tip's centre [kN]",
                                      "mean force D to 3D/2\nfrom there [kN]")):
        finish_curve(panel, label, max(group.end for group in shown))
        panel.axvline(claims.LATE[0], color="0.5", linestyle=":", linewidth=1)
    for panel in axes[0, 1:]:
        panel.set_ylim(0, top)
    add_legend(axes[0, 2], shown)
    return entitle(figure, "Forces at the tip against penetration, and how far they decay in one diameter")


# --------------------------------------------------------------------------------------------------- Fig. 11: porosity


def porosity_fields(groups):
    """Porosity above its change, S/D side by side; the left half of each panel is the first group, the right one the last."""
    shown = with_data(groups, lambda g: g.rings(POROSITY_LEVELS[0], claims.FIELD_R, claims.FIELD_Z))
    halves = ((-1, shown[0]), (1, shown[-1]))
    levels = [at for at in POROSITY_LEVELS if at <= max(g.end for g in shown) + 0.03]
    figure, axes = new_figure(6.4, 2, len(levels), sharex=True, sharey=True)
    for column, at in enumerate(levels):
        for side, group in halves:
            try:
                now, start = (group.rings(s, claims.FIELD_R, claims.FIELD_Z) for s in (at, 0.0))
            except Missing:
                axes[0, column].text(side * 0.75, 1.5, f"{label_of(group, shown)}\nends at {group.end:.2f}", ha="center", va="bottom",
                                     fontsize=8)
                continue
            whole = axes[0, column].pcolormesh(side * claims.FIELD_R, claims.FIELD_Z, now, cmap="viridis", vmin=0.3, vmax=0.55)
            change = axes[1, column].pcolormesh(side * claims.FIELD_R, claims.FIELD_Z, now - start, cmap="PuOr_r", vmin=-0.12, vmax=0.12)
            for panel in axes[:, column]:
                for region in (claims.CORE, claims.SLEEVE):
                    panel.add_patch(Polygon(region.corners * [side, -1] - [0, at], fill=False, edgecolor="#d02030", linewidth=1, zorder=4))
                label = f"{label_of(group, shown)}\n{seeds_of(group)}" if len(shown) > 1 or side < 0 else "mirrored"
                panel.text(side * 0.75, 1.5, label, ha="center", va="bottom", fontsize=8)
        for panel in axes[:, column]:
            panel.add_patch(Rectangle((-0.5, -at), 1, 1.45 + at, facecolor=PILE, edgecolor="black", linewidth=0.6, zorder=3))
            panel.plot([0, 0], [-2.25, -at], color="black", linewidth=0.8, zorder=4)
            panel.set(xlim=(-claims.FIELD_R[-1], claims.FIELD_R[-1]), ylim=(-2.25, 1.45), aspect="equal")
            panel.spines["left"].set_visible(False)
        axes[0, column].set_title(f"S/D = {at:g}", pad=26, fontweight="bold")
        axes[1, column].set_xlabel("distance from the axis r [D]")
        axes[1, column].xaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
    for panel in axes[:, 0]:
        panel.set_ylabel("z from the tip at S = 0 [D]")
    figure.colorbar(whole, ax=list(axes[0]), extend="both", aspect=16).set_label("porosity [-]")
    figure.colorbar(change, ax=list(axes[1]), extend="both", aspect=16).set_label("change since S = 0 at the same place [-]")
    return entitle(figure, "Porosity around the pile; red frames: where core and sleeve are judged")


# ------------------------------------------------------------------------------------------------- Figs. 12, 13: traces


def trace_starts(groups):
    shown = with_data(groups, lambda g: g.first.traces())
    figure, axes = new_figure(3.6, 1, len(shown), sharex=True, sharey=True)
    for panel, group in zip(axes[0], shown):
        run = group.first
        panel.add_patch(Rectangle((-0.5, 0), 1, 9, facecolor=PILE, edgecolor="black", linewidth=0.6))
        panel.add_patch(Rectangle((-0.5, -run.end), 1, run.end, facecolor="none", edgecolor="black", linewidth=0.6, linestyle="--"))
        for role, traces in run.traces().items():
            r, depth = TRACE_PLACES[role]
            for side in (-1, 1) if r else (1,):
                panel.plot(side * r, -depth, "+", color="0.4", markersize=9)
            for number, trace in enumerate(traces):
                # In the plane of the axis and the start; the two of four sides that are left of it by x, or else by y.
                side = -1 if (trace.start[0] if abs(trace.start[0]) > abs(trace.start[1]) else trace.start[1]) < 0 else 1
                place = np.hypot(*trace.start[:2]) if role > 2 else abs(trace.start[0] or trace.start[1])
                sideways = trace.sideways if role > 2 else side * trace.way[:, 0]
                x, z = side * (place + sideways), trace.start[2] - trace.down
                panel.plot(x, z, color=TRACE_COLORS[role], linewidth=1)
                panel.plot(x[0], z[0], "o", color=TRACE_COLORS[role], markersize=6)
                panel.plot(x[-1], z[-1], "o", color=TRACE_COLORS[role], markersize=4, markerfacecolor="white")
                if number == 0:
                    panel.annotate(str(role), (x[0], z[0]), xytext=(6, 5), textcoords="offset points", fontweight="bold",
                                   color=TRACE_COLORS[role])
        panel.set(xlim=(-1.5, 1.5), ylim=(-2.2, 0.6), aspect="equal", xlabel="distance from the axis [D]")
        panel.set_title(f"{label_of(group, shown)}, seed {run.seed}")
        panel.grid(color=PALE)
    axes[0, 0].set_ylabel("z from the tip at S = 0 [D]")
    return entitle(figure, "Traced grains: start (full), way, end (open); crosses: the paper's places")


def trace_curves(groups):
    shown = with_data(groups, lambda g: [run.traces() for run in g.runs])
    figure, axes = new_figure(4.8, 2, 2 * len(shown), sharex=True, sharey="row")
    for block, (roles, letters) in enumerate((((1, 3, 4), "ab"), ((1, 2), "cd"))):
        for number, group in enumerate(shown):
            at = group.penetration
            for row, (way, sign) in enumerate((("sideways", 1), ("down", -1))):
                panel = axes[row, block * len(shown) + number]
                for role in roles:
                    singles = [np.interp(at, t.penetration, sign * getattr(t, way)) * run.diameter * 1e3 for run in group.runs
                               for t in run.traces()[role]]
                    for curve in singles:
                        panel.plot(at, curve, color=TRACE_COLORS[role], linewidth=0.4, alpha=0.5)
                    if singles:
                        panel.plot(at, np.mean(singles, axis=0), color=TRACE_COLORS[role], linewidth=1.9, label=f"grain {role}")
                panel.set_xlim(0, group.end)
                panel.grid(color=PALE)
                panel.set_title(f"{letters[row]}: {label_of(group, shown)}")
                if row == 1:
                    panel.set_xlabel("S/D [-]")
            axes[1, block * len(shown) + number].legend(frameon=False, loc="lower left")
    axes[0, 0].set_ylabel("displacement sideways [mm]")
    axes[1, 0].set_ylabel("displacement z [mm]")
    return entitle(figure, "Displacement of the traced grains: 1, 3, 4 on one level (a, b); 1, 2 on the axis (c, d)")


# --------------------------------------------------------------------------------------- beyond the paper: size of grains

SIZE_APART = 1.1  # ratio from which on grains count as of another size
AT_SHAFT = (0.25, 1.5)  # above the tip [D]: where porosity beside the shaft is looked at
SHAFT_R, UNDER_TIP = np.arange(0.5, 1.7505, RING), np.arange(-2, 0.0005, RING)  # edges of rings there, and under the tip [D]


def across_of(group):
    return float(np.mean([run.grains_across() or np.nan for run in group.runs]))


def of_sizes(groups):
    """Groups of one kind from the coarsest grains to the finest; Missing where they are all of one size."""
    for kind in (COUPLED, ALONE):
        alike = sorted((g for g in groups if g.kind == kind and np.isfinite(across_of(g))), key=across_of)
        if alike and across_of(alike[-1]) > SIZE_APART * across_of(alike[0]):
            return alike
    raise Missing("all grains are of one size")


def beside_shaft(group, s_over_d, tip_at):
    """Porosity in rings around the shaft, just above where the tip is at `tip_at`."""
    return group.rings(s_over_d, SHAFT_R, np.array(AT_SHAFT) - tip_at)[0]


def under_tip(group, s_over_d, tip_at):
    return group.rings(s_over_d, np.array([0, 0.5]), UNDER_TIP - tip_at)[:, 0]


def middles(edges):
    return (edges[1:] + edges[:-1]) / 2


def size_effects(groups):
    shown = of_sizes(groups)
    at = claims.LATE[0]
    figure, axes = new_figure(5.6, 2, 2)
    names = {group: f"{across_of(group):.1f} across, {seeds_of(group)}" for group in shown}
    for group in shown:
        paint_band(axes[0, 0], group.penetration, group.curves(claims.TIP, 1e-6), color_of(shown, group), names[group])
    finish_curve(axes[0, 0], "tip resistance [MPa]", max(group.end for group in shown))
    add_legend(axes[0, 0], shown)
    across = [across_of(group) for group in shown]
    for name, unit, words, marker in ((claims.TIP, 1e6, "tip, {} MPa", "o"), (claims.SHAFT, 1e3, "shaft, {} kN", "s")):
        values = [group.estimate(lambda run, n=name: claims.window_mean(run, n, (0.5, 1.0))) for group in shown]
        first = values[0].mean
        axes[0, 1].errorbar(across, [v.mean / first for v in values], [np.nan_to_num(v.error) / first for v in values], marker=marker,
                            capsize=3, color=COLORS[marker == "s"], label=words.format(f"{first / unit:.3g}"))
    axes[0, 1].set(xlabel="grains across the pile", ylabel=f"mean over S/D 0.5 to 1, of that\nwith {across[0]:.1f} across", xlim=(0, None),
                   ylim=(0, 1.1 * axes[0, 1].get_ylim()[1]))
    axes[0, 1].legend(frameon=False, loc="lower left", title=f"with {across[0]:.1f} across:", alignment="left")
    for panel, profile, edges, label in ((axes[1, 0], beside_shaft, SHAFT_R, "distance from the axis [D]"),
                                         (axes[1, 1], under_tip, UNDER_TIP, "z from the tip [D]")):
        for group in with_data(shown, lambda g, p=profile: p(g, at, at)):
            panel.plot(middles(edges), profile(group, at, at), color=color_of(shown, group), linewidth=1.8)
            panel.plot(middles(edges), profile(group, 0.0, at), color=color_of(shown, group), linewidth=1, linestyle="--")
        panel.set(xlabel=label, ylabel="porosity")
        panel.grid(color=PALE)
    axes[1, 0].set_title(f"beside the shaft, {AT_SHAFT[0]:g} to {AT_SHAFT[1]:g} D above the tip")
    axes[1, 1].set_title("under the tip, r < D/2")
    axes[0, 1].grid(color=PALE)
    return entitle(figure, f"{', '.join(f'{a:.1f}' for a in across[:-1])} and {across[-1]:.1f} grains across the pile: resistance, and "
                           f"porosity at S/D = {at:g} (dashed: there at S = 0)")
