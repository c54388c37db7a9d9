#!/usr/bin/env python3
"""Writes ground.msh (Gmsh's MSH 4.1, ASCII): a brick of 1 x 1 x 1 m, 4 x 4 x 5 zones, of which no two are alike.

The outside and the border between clay and sand at z = -0.6 m are plane; all other nodes are twisted about the axis and
moved up and down, so that faces are warped. Volumes are the physical groups "clay" and "sand", the top is "top".
"""
import math
import pathlib

SIDE, LEVELS, BORDER = 4, 5, 2  # zones along x and y, along z, and levels of sand


def node(i, j, k):
    x, y, z = i / SIDE - 0.5, j / SIDE - 0.5, k / LEVELS - 1
    inside = (1 - 4 * x * x) * (1 - 4 * y * y)  # 0 on the sides, 1 on the axis
    turn = inside * (0.5 + 0.3 * z)
    lift = 0 if k in (0, BORDER, LEVELS) else 0.06 * inside * math.sin(7 * x + 3 * y + 5 * k)
    return (x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn), z + lift)


def number(i, j, k):
    return 1 + i + (SIDE + 1) * (j + (SIDE + 1) * k)


def main():
    nodes = [(number(i, j, k), node(i, j, k)) for k in range(LEVELS + 1) for j in range(SIDE + 1) for i in range(SIDE + 1)]
    bottoms = [(i, j, k) for k in range(LEVELS) for j in range(SIDE) for i in range(SIDE)]
    around = ((0, 0), (1, 0), (1, 1), (0, 1))
    zones = {name: [[number(i + di, j + dj, k + dk) for dk in (0, 1) for di, dj in around] for i, j, k in bottoms
                    if (k < BORDER) == (name == "sand")] for name in ("sand", "clay")}
    top = [[number(i + di, j + dj, LEVELS) for di, dj in around] for j in range(SIDE) for i in range(SIDE)]

    lines = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat"]
    lines += ["$PhysicalNames", "3", '2 1 "top"', '3 2 "sand"', '3 3 "clay"', "$EndPhysicalNames"]
    box = "-0.5 -0.5 -1 0.5 0.5 0"
    lines += ["$Entities", "0 0 1 2", f"1 {box} 1 1 0", f"1 {box} 1 2 0", f"2 {box} 1 3 0", "$EndEntities"]
    lines += ["$Nodes", f"1 {len(nodes)} 1 {len(nodes)}", f"3 1 0 {len(nodes)}"]
    lines += [str(n) for n, _ in nodes] + [" ".join(f"{c:.17g}" for c in x) for _, x in nodes] + ["$EndNodes"]
    blocks = [((2, 1, 3), top), ((3, 1, 5), zones["sand"]), ((3, 2, 5), zones["clay"])]
    count = sum(len(elements) for _, elements in blocks)
    lines += ["$Elements", f"{len(blocks)} {count} 1 {count}"]
    element = 0
    for head, elements in blocks:
        lines.append(" ".join(map(str, head + (len(elements),))))
        for nodes_of in elements:
            element += 1
            lines.append(" ".join(map(str, [element] + nodes_of)))
    lines.append("$EndElements")
    pathlib.Path(__file__).with_name("ground.msh").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
