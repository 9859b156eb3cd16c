"""Script for the Python of YADE: yade -jN -n -x yade_case.py CASE.npz MESH.stl SKIN WARM WINDOW SETTINGS.

SETTINGS: material and time step as JSON. The result is one JSON line at the end of the output.
"""

import json
import math
import os
import resource
import sys
import time

import numpy as np
from yade import config, utils, ymport
from yade.wrapper import (
    Bo1_Facet_Aabb,
    Bo1_Sphere_Aabb,
    Bo1_Wall_Aabb,
    ForceResetter,
    FrictMat,
    Ig2_Facet_Sphere_ScGeom,
    Ig2_Sphere_Sphere_ScGeom,
    Ig2_Wall_Sphere_ScGeom,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_FrictMat_FrictMat_MindlinPhys,
    Law2_ScGeom_MindlinPhys_Mindlin,
    NewtonIntegrator,
    Omega,
)

case_file, mesh, skin, warm, window, setting = sys.argv[1:7]
settings = json.loads(setting)
held = np.load(case_file)
omega, count = Omega(), len(held["diameter"])
omega.materials.append(
    FrictMat(
        young=settings["young_modulus"],
        poisson=settings["poisson_ratio"],
        density=settings["density"],
        frictionAngle=math.atan(settings["friction"]),
        label="m",
    )
)
for diameter, position in zip(held["diameter"], held["position"], strict=True):
    omega.bodies.append(utils.sphere([float(each) for each in position], 0.5 * float(diameter), material="m"))
if str(held["kind"]) == "bed":
    sides = held["sides"]
    for axis, place, sense in ((0, 0, 1), (0, sides[0], -1), (1, 0, 1), (1, sides[1], -1), (2, 0, 1)):
        omega.bodies.append(utils.wall(float(place), axis=axis, sense=sense, material="m"))
else:
    omega.bodies.append(ymport.stl(mesh, material="m"))
collider = InsertionSortCollider(
    [Bo1_Sphere_Aabb(), Bo1_Wall_Aabb(), Bo1_Facet_Aabb()], verletDist=float(skin)
)
restitution = settings["restitution"]
omega.engines = [
    ForceResetter(),
    collider,
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom(), Ig2_Wall_Sphere_ScGeom(), Ig2_Facet_Sphere_ScGeom()],
        [Ip2_FrictMat_FrictMat_MindlinPhys(en=restitution, es=restitution)],
        [Law2_ScGeom_MindlinPhys_Mindlin()],
    ),
    NewtonIntegrator(damping=0.0, gravity=(0.0, 0.0, -settings["gravity"])),
]
omega.dt = settings["time_step"]
omega.run(1, True)
first_step = time.time()
omega.run(int(warm), True)
rebuilds, began = collider.numReinit, time.perf_counter()
omega.run(int(window), True)
seconds = time.perf_counter() - began
rebuilds = collider.numReinit - rebuilds
memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
contacts = sum(1 for each in omega.interactions if each.isReal and each.id1 < count and each.id2 < count)
print()
print(
    json.dumps(
        {
            "version": config.version,
            "rate": count * int(window) / seconds,
            "first_step": first_step,
            "memory": memory,
            "contacts": contacts / count,
            "rebuilds": 1000.0 * rebuilds / int(window),
            "mass_flow": None,
        }
    ),
    flush=True,
)
os._exit(0)  # the regular exit of YADE waits for its window and may crash
