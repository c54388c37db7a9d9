"""Zones, grains and pile in a vertical section, as tools/plots and tools/report paint them."""

import numpy as np
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.patches import Polygon

PALE, TIP, SHAFT, PILE = "0.88", "#1f5fa8", "#c0562f", "#59636e"
SANDS = np.array([[0.93, 0.80, 0.55], [0.88, 0.71, 0.42], [0.82, 0.64, 0.36], [0.91, 0.76, 0.48], [0.77, 0.60, 0.38]])


def paint_zones(axes, polygons, values, limit, linewidth=0.3):
    """Zones coloured from -limit (red: compression) to limit (blue). Returns what a colour bar needs."""
    mesh = PolyCollection(polygons, array=values, cmap="RdBu", edgecolors="0.75", linewidths=linewidth)
    mesh.set_clim(-limit, limit)
    return axes.add_collection(mesh)


def paint_grains(axes, pebbles, linewidth, alpha=None):
    """What pebbles_behind_plane() returns: far ones darker, pebbles of one clump in one colour."""
    place, radius, body, depth = pebbles
    colors = SANDS[body % len(SANDS)] * (1 - 0.45 * depth)[:, None]
    axes.add_collection(EllipseCollection(2 * radius, 2 * radius, np.zeros_like(radius), units="xy", offsets=place,
                                          transOffset=axes.transData, facecolors=colors, edgecolors="#4d3a1c",
                                          linewidths=linewidth, alpha=alpha))


def paint_pile(axes, outline):
    axes.add_patch(Polygon(outline, closed=True, facecolor=PILE, edgecolor="black", linewidth=0.8, zorder=3))
