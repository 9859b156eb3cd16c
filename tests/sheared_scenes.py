"""A Lees-Edwards box filled with frictional particles of different sizes."""

import numpy as np
from scene_builders import build_scene, particle_group

RATE = 20.0
"""Shear rate [1/s]."""

SIZE = 0.04
"""Width of the box [m]."""


def sheared_gas(height=0.0, duration=0.01, sizes=(0.0065, 0.0065), output=None, chunk_size=16, **run):
    """Particles with the velocity profile of the shear about the center of the box, shifted by `height` [m]
    along y.

    With a chunk size of 16 the neighbor lists contain pairs within a chunk and pairs across two chunks.
    """
    rng = np.random.default_rng(8)
    positions = 0.008 * (np.argwhere(np.ones((5, 5, 5))) + 0.5)
    noise = rng.normal(0.0, 0.15, positions.shape)
    velocity = noise - noise.mean(axis=0)
    velocity[:, 0] += RATE * (positions[:, 1] - 0.5 * SIZE)
    shifted = positions[:, 1] + height
    velocity[:, 0] += RATE * height - RATE * SIZE * np.floor(shifted / SIZE)
    positions[:, 1] = shifted % SIZE
    group = particle_group(positions, rng.choice(sizes, len(positions)), velocity=velocity)
    shear = {"flow": "x", "gradient": "y", "rate": RATE}
    return build_scene(
        {"balls": group},
        pair={"friction": 0.4, "restitution": 0.7},
        numerics={"chunk_size": chunk_size, "skin": 0.0005},
        domain={
            "min": [0.0] * 3,
            "max": [SIZE] * 3,
            "periodic": ["x", "y", "z"],
            "on_exit": "error",
            "lees_edwards": shear,
        },
        run={"duration": duration, "velocity_max": 3.0, "time_step": 4e-6} | run,
        output={"interval": 1.0, "energy_budget": True} | (output or {}),
    )
