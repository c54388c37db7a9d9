"""Reads what tools/run leaves in a folder: histories (.csv), states (.vtp, .vtu), series of states (.pvd), summaries, the scene."""

import base64
import binascii
import csv
import glob
import json
import math
import os
import re
import xml.etree.ElementTree as xml

import numpy as np

VTK_TYPES = {"Float64": "<f8", "Float32": "<f4", "Int64": "<i8", "Int32": "<i4", "UInt8": "<u1"}
# Edges of a hexahedron in VTK's node order: bottom square, top square, uprights.
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))


class Missing(Exception):
    """Something that is asked for is not in the run."""


# ------------------------------------------------------------------------------------------------------------- files


def read_history(path):
    """Columns of a CSV file by name."""
    if not os.path.isfile(path):
        raise Missing(f"no {os.path.basename(path)}")
    with open(path, newline="") as file:
        rows = list(csv.reader(file))
    # A run that was killed may leave half a line behind.
    values = [row for row in rows[1:] if len(row) == len(rows[0])]
    if not values:
        raise Missing(f"{os.path.basename(path)} has no rows")
    try:
        table = np.array(values, dtype=float)
    except ValueError as e:
        raise Missing(f"{os.path.basename(path)} has a row that is no numbers ({e})") from e
    return {name: table[:, i] for i, name in enumerate(rows[0])}


def column(history, name):
    if name not in history:
        raise Missing(f"no column \"{name}\"")
    return history[name]


def read_vtk(path):
    """Arrays of a .vtp or .vtu file (inline binary, uncompressed) by name, with "Points" among them."""
    name = os.path.basename(path)
    if not os.path.isfile(path):
        raise Missing(f"no {name}")
    try:
        root = xml.parse(path).getroot()
        header = {"UInt64": 8, "UInt32": 4}[root.get("header_type", "UInt32")]
        arrays = {}
        for element in root.iter("DataArray"):
            raw = base64.b64decode(element.text.strip())[header:]
            values = np.frombuffer(raw, dtype=VTK_TYPES[element.get("type")])
            components = int(element.get("NumberOfComponents", "1"))
            arrays[element.get("Name")] = values.reshape(-1, components) if components > 1 else values
    except (xml.ParseError, binascii.Error, KeyError, ValueError, AttributeError) as e:
        raise Missing(f"{name} is broken ({e})") from e
    if "Points" not in arrays:
        raise Missing(f"{name} has no points")
    return arrays


def read_series(folder, name):
    """Times [s] and paths of the states in NAME.pvd."""
    path = os.path.join(folder, f"{name}.pvd")
    if not os.path.isfile(path):
        raise Missing(f"no {name}.pvd")
    with open(path) as file:  # by pattern: a killed run leaves the file without its end
        entries = re.findall(r'timestep="([^"]+)"[^>]*file="([^"]+)"', file.read())
    if not entries:
        raise Missing(f"{name}.pvd names no state")
    return np.array([float(time) for time, _ in entries]), [os.path.join(folder, file) for _, file in entries]


def last_file(folder, pattern):
    paths = sorted(glob.glob(os.path.join(folder, pattern)))
    if not paths:
        raise Missing(f"no {pattern}")
    return paths[-1]


def read_summary(folder, name):
    try:
        with open(os.path.join(folder, name)) as file:
            return json.load(file)
    except (OSError, ValueError):
        return {}


def read_scene(folder):
    """Values of the scene's keys as they stand there, overrides in their place: {"grains.packing.count": "8000", ...}. Blocks and
    keys that come several times are numbered as in overrides: wall[0].name, wall[1].name."""
    try:
        with open(os.path.join(folder, "scene.txt"), errors="replace") as file:
            text = file.read()
    except OSError:  # programs started by hand leave none
        text = ""
    words = re.findall(r"#.*|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'|[\w.+-]+|[{}<>]", text)
    words = [word for word in words if not word.startswith("#")]
    found, place, counts = [], [], {}
    i = 0
    while i < len(words):
        if words[i] in "}>":
            place = place[:-1]
            i += 1
        elif i + 1 < len(words):
            key = tuple(place) + (words[i],)
            number = counts[key] = counts.get(key, -1) + 1
            if words[i + 1] in "{<":
                place.append(f"{words[i]}[{number}]")
            else:
                found.append((".".join(place + [f"{words[i]}[{number}]"]), words[i + 1].strip("\"'")))
            i += 2
        else:
            break
    repeated = {".".join(key) for key, number in counts.items() if number > 0}
    scene = {}
    for name, value in found:
        parts = name.split(".")
        scene[".".join(part if ".".join(parts[:n] + [part[: part.index("[")]]) in repeated else part[: part.index("[")]
                       for n, part in enumerate(parts))] = value
    for override in read_summary(folder, "manifest.json").get("overrides", []):
        name, _, value = override.partition("=")
        scene[name if name in scene else name.replace("[0]", "") if name.replace("[0]", "") in scene else name] = value.strip("\"'")
    return scene


def title_of(folder):
    return read_summary(folder, "dem_summary.json").get("title", os.path.basename(os.path.abspath(folder)))


# ---------------------------------------------------------------------------------------------------------- geometry


def cut(points, zones, y):
    """Polygons (x, z) in which the plane at `y` cuts the zones, and the zones' numbers."""
    level = points[zones][:, :, 1] - y
    polygons, numbers = [], []
    for zone in np.flatnonzero((level.min(axis=1) < 0) & (level.max(axis=1) > 0)):
        corners, side = points[zones[zone]], level[zone]
        crossing = [corners[a] + (corners[b] - corners[a]) * side[a] / (side[a] - side[b])
                    for a, b in EDGES if (side[a] < 0) != (side[b] < 0)]
        if len(crossing) < 3:
            continue
        polygon = np.array(crossing)[:, [0, 2]]
        outward = polygon - polygon.mean(axis=0)  # a section of a convex zone is convex: order its corners by angle
        polygons.append(polygon[np.argsort(np.arctan2(outward[:, 1], outward[:, 0]))])
        numbers.append(zone)
    return polygons, np.array(numbers, dtype=int)


def cut_in_the_middle(points, zones):
    """cut() at y = 0. Zones meet in that plane itself: a cut a little beside it goes through each zone once."""
    return cut(points, zones, 1e-6 * np.ptp(points[:, 1]))


def zone_stress(arrays, zone_count):
    """What the zones are coloured by [Pa], tension positive, and its name: the change of sigma_zz, or else sigma_zz itself."""
    for name, values in arrays.items():
        if name.startswith("vertical stress change") and len(values) == zone_count:
            return values, "change of vertical stress in the zones since Excavate [kPa]"
    for name, values in arrays.items():
        if "stress" in name and values.ndim == 2 and values.shape == (zone_count, 6):
            return values[:, 2], "vertical stress in the zones [kPa]"
    raise Missing("no stress in the zones' file")


def rounded_limit(values):
    """A round number that 98 % of the values lie within: the few zones under a pile's tip would drown all others."""
    size = np.percentile(np.abs(values), 98)
    if size <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(size))
    return next(step * power for step in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if step * power >= 0.999 * size)


def pebbles_behind_plane(arrays):
    """Pebbles from the plane y = 0 to four mean radii behind it, far ones first: centres (x, z), radii, bodies, depths as a share
    of those four radii."""
    center, radius = arrays["Points"].reshape(-1, 3), arrays["radius"]
    body = arrays.get("clump", np.arange(len(radius))).astype(int)
    if not len(radius):
        raise Missing("there are none")
    depth = 4 * np.mean(radius)
    shown = np.flatnonzero((center[:, 1] > -radius) & (center[:, 1] < depth))
    if not len(shown):
        raise Missing("none near the plane y = 0")
    shown = shown[np.argsort(-center[shown, 1], kind="stable")]
    return center[shown][:, [0, 2]], radius[shown], body[shown], np.clip(center[shown, 1] / depth, 0, 1)


def pile_outline(scene, radius, tip, top):
    """Corners (x, z) of the pile up to `top`. The tip's shape is an input: it stands in the scene."""
    is_cone = scene.get("pile.tip", "FLAT") == "CONE"
    shoulder = tip + (radius / math.tan(math.radians(float(scene.get("pile.cone_angle", 60)) / 2)) if is_cone else 0)
    return [(-radius, top), (-radius, shoulder), (0, tip), (radius, shoulder), (radius, top)]
