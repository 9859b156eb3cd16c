"""A sheared box full of rough spheres of wide sizes."""

import numpy as np
from trials import balls, trial

RATE = 20.0
"""Rate of shear [1/s]."""

SIZE = 0.04
"""Width of the box [m]."""


def sheared_gas(height=0.0, duration=0.01, sizes=(0.0065, 0.0065), output=None, **run):
    """Spheres that stream with the shear about the middle of the box, everything moved up by `height` [m].

    Chunks of 16, so that pairs stand in one row and in two.
    """
    rng = np.random.default_rng(8)
    places = 0.008 * (np.argwhere(np.ones((5, 5, 5))) + 0.5)
    noise = rng.normal(0.0, 0.15, places.shape)
    velocity = noise - noise.mean(axis=0)
    velocity[:, 0] += RATE * (places[:, 1] - 0.5 * SIZE)
    moved = places[:, 1] + height
    velocity[:, 0] += RATE * height - RATE * SIZE * np.floor(moved / SIZE)
    places[:, 1] = moved % SIZE
    group = balls(places, rng.choice(sizes, len(places)), velocity=velocity)
    shear = {"velocity_along": "x", "gradient_along": "y", "rate": RATE}
    return trial(
        {"balls": group}, pair={"friction": 0.4, "restitution": 0.7}, numerics={"chunk_size": 16, "skin": 0.0005},
        domain={"min": [0.0] * 3, "max": [SIZE] * 3, "periodic": ["x", "y", "z"], "leaving": "error", "shear": shear},
        run={"duration": duration, "velocity_max": 3.0, "time_step": 4e-6} | run,
        output={"interval": 1.0, "energy": True} | (output or {}),
    )  # fmt: skip
