"""Groups of clumps for tests."""

import numpy as np
from scene_builders import particle_group

ROD = [[-3e-3, 0.0, 0.0], [-1e-3, 0.0, 0.0], [1e-3, 0.0, 0.0], [3e-3, 0.0, 0.0]]
"""Centers [m] of the spheres of a rod with a radius of 2 mm and a length of 10 mm."""


def clump_group(positions, centers=ROD, radius=0.002, orientation=None, material="glass", **more):
    """A group of clumps at positions (n, 3) [m] of their centers of mass.

    centers:      (k, 3) of the spheres [m]
    radius:       of all spheres, or one of each [m]
    orientation:  as in scenes
    more:         further keys, also as arrays
    """
    positions = np.atleast_2d(np.asarray(positions, float))
    radii = np.broadcast_to(radius, len(centers))
    spheres = [
        {"position": [*map(float, c)], "radius": float(r)} for c, r in zip(centers, radii, strict=True)
    ]
    clump = {"spheres": spheres} | ({} if orientation is None else {"orientation": orientation})
    given = {name: np.asarray(value, float).tolist() for name, value in more.items()}
    insertion = {"kind": "positions", "positions": positions.tolist()}
    return {"material": material, "count": len(positions), "clump": clump, "insert": insertion} | given


def falling_clumps(centers, radius):
    """16 rods and 16 clumps of spheres at `centers` in a box of 55 mm with rain of the latter and 9 spheres; all
    fall."""
    rng = np.random.default_rng(8)
    sites = 0.012 * (np.argwhere(np.ones((4, 4, 2))) + 0.5) + [0.003, 0.003, 0.002]
    velocity = rng.normal([0.0, 0.0, -0.8], 0.3, (16, 3))
    rods = clump_group(sites[:16], velocity=velocity, angular_velocity=rng.normal(0, 50, (16, 3)))
    others = clump_group(sites[16:], centers, radius, "random", "steel", velocity=velocity)
    balls = particle_group(0.012 * np.argwhere(np.ones((3, 3, 1))) + [0.01, 0.01, 0.035], 0.005)
    region = {"box": {"min": [0.002, 0.002, 0.042], "max": [0.052, 0.052, 0.054]}}
    rain = {
        "material": "steel", "count": 12, "clump": others["clump"], "velocity": [0.0, 0.0, -0.5],
        "insert": {"kind": "rain", "region": region, "rate": 1500.0},
    }  # fmt: skip
    return {"rods": rods, "others": others, "balls": balls, "rain": rain}


def about(axis, degrees):
    """The orientation of a rotation about an axis."""
    return {"axis": list(axis), "angle": float(np.deg2rad(degrees))}
