"""Groups of clumps for tests."""

import numpy as np

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


def about(axis, degrees):
    """The orientation of a rotation about an axis."""
    return {"axis": list(axis), "angle": float(np.deg2rad(degrees))}
