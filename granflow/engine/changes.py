"""Particles that change during a run from Python: read in the order of ids, written and removed.

`Engine.begin_change` precedes each change, `Engine.refresh` follows the last one.
"""

from collections.abc import Mapping

import numpy as np

from granflow.engine.host_copy import copy_to_host, particle_table
from granflow.engine.state import State

REMOVED_BELOW = 0.0
"""Radius [m] at and below which a particle is deleted at the next neighbor-list rebuild."""


def present_indices(state: State) -> np.ndarray:
    """Device indices (n,) of the particles in the order of their ids, without those that are removed."""
    arrays = copy_to_host(state, ("id", "radius"))
    order = np.argsort(arrays["id"], kind="stable")
    return order[arrays["radius"][order] > REMOVED_BELOW]


def write_particles(state: State, indices: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
    """Write particle fields.

    indices:  device indices (k,)
    arrays:   arrays (k,) or (k, 3) by field; velocities are at the time of the positions
    """
    values = dict(arrays)
    if "velocity" in values and state.particles.velocity_synchronized is not None:
        values["velocity_synchronized"] = values["velocity"]
    state.built(particle_table, tuple(values)).put(indices, values)


def remove_particles(state: State, indices: np.ndarray) -> None:
    """Mark particles with these device indices (k,) for deletion at the next neighbor-list rebuild."""
    radius = copy_to_host(state, ("radius",))["radius"][indices]
    write_particles(state, indices, {"radius": -radius})
