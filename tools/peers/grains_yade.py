# YADE: the exported packing itself, spheres or clumps, in a box of six walls; local damping as ours.
# Run by tools/bench_dem_peers as  yade -j1 -n -x grains_yade.py,  with its wishes in the environment variable WISHES (JSON):
# packing, settle, steps, blocks, skin [m], damping.
import json
import math
import os
import time

wishes = json.loads(os.environ["WISHES"])
facts, pebbles = {}, []
with open(wishes["packing"]) as packing:
    part = ""
    for line in packing:
        words = line.split()
        if line.startswith("#"):
            continue
        if words[0] in ("clumps", "pebbles"):
            part = words[0]
        elif part == "":
            facts[words[0]] = words[1:]
        elif part == "pebbles":
            pebbles.append((int(words[0]), tuple(map(float, words[1:4])), float(words[4])))
number = lambda key: float(facts[key][0])

# A pair's stiffness here is 2 E1 r1 E2 r2 / (E1 r1 + E2 r2): k_n for two pebbles of mean size.
mean_pebble = sum(p[2] for p in pebbles) / len(pebbles)
grain = O.materials.append(FrictMat(young=number("mean_stiffness") / mean_pebble, poisson=1 / number("stiffness_ratio"),
                                    frictionAngle=math.atan(number("friction")), density=number("density")))
if number("pebbles_per_grain") == 1:
    for _, center, radius in pebbles:
        O.bodies.append(sphere(center, radius, material=grain))
else:
    clumps = {}
    for clump, center, radius in pebbles:
        clumps.setdefault(clump, []).append(sphere(center, radius, material=grain))
    for clump in sorted(clumps):
        O.bodies.appendClumped(clumps[clump], discretization=0)
for axis in range(3):
    O.bodies.append(wall(float(facts["box_low"][axis]), axis=axis, sense=1, material=grain))
    O.bodies.append(wall(float(facts["box_high"][axis]), axis=axis, sense=-1, material=grain))

collider = InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Wall_Aabb()], verletDist=wishes["skin"])
motion = NewtonIntegrator(damping=0.7, gravity=(0, 0, -number("gravity")))
O.engines = [
    ForceResetter(),
    collider,
    InteractionLoop([Ig2_Sphere_Sphere_ScGeom(), Ig2_Wall_Sphere_ScGeom()], [Ip2_FrictMat_FrictMat_FrictPhys()],
                    [Law2_ScGeom_FrictPhys_CundallStrack()]),
    motion,
]
O.dt = number("time_step")
O.run(wishes["settle"], True)
motion.damping = wishes["damping"]
for _ in range(wishes["blocks"]):
    before = time.process_time()
    O.run(wishes["steps"], True)
    print("BLOCK %.6f" % (time.process_time() - before), flush=True)
spheres = len(pebbles)
real = sum(1 for i in O.interactions if i.isReal and i.id1 < len(O.bodies) - 6 and i.id2 < len(O.bodies) - 6)
print("NEIGHBOURS %.3f" % (2 * real / spheres), flush=True)
os._exit(0)
