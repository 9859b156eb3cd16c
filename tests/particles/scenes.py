"""Small scenes, and brute-force checks of generated particles."""

import numpy as np
from scene_builders import build_scene, particle_group
from scipy.spatial import cKDTree

from granflow.load import Scene

BOX = {"box": {"min": [0, 0, 0], "max": [0.1, 0.1, 0.2]}}
TUBE = {"cylinder": {"from": [0, 0, 0.1], "to": [0.06, 0, 0.18], "radius": 0.05}}
UNIFORM = {"distribution": "uniform", "min": 0.003, "max": 0.005}


def scene_with(groups, seed=1, folder=None):
    """A scene with the given groups: mappings with insert, count, diameter and other keys."""
    groups = {name: {"material": "glass"} | group for name, group in groups.items()}
    both = {name: particle_group([[0, 0, 0]], material=name) for name in ("other", "glass")}
    domain = {"min": [-1] * 3, "max": [1] * 3, "on_exit": "delete"}
    scene = build_scene(both, gravity=[0, 0, -9.81], domain=domain).to_dict()
    return Scene.from_dict(scene | {"seed": seed, "particles": groups}, folder)


def smallest_gap(position, radius):
    """The smallest gap [m] between two particles; infinite without near pairs."""
    pairs = cKDTree(position).query_pairs(2.001 * radius.max(), output_type="ndarray")
    separation = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    return (separation - radius[pairs].sum(axis=1)).min(initial=np.inf)


def clearance(region, position, radius):
    """The smallest distance [m] between a particle surface and the boundary of the region."""
    if "box" in region:
        low, high = np.array(region["box"]["min"]), np.array(region["box"]["max"])
        return (np.minimum(position - low, high - position).min(axis=1) - radius).min()
    tube = region["cylinder"]
    start, end = np.array(tube["from"], float), np.array(tube["to"], float)
    length = np.linalg.norm(end - start)
    along = (position - start) @ (end - start) / length
    across = np.linalg.norm(np.cross(position - start, (end - start) / length), axis=1)
    return np.min([along - radius, length - along - radius, tube["radius"] - across - radius])
