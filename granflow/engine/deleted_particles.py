"""Deleted particles: their arrays, and their part of the accounting."""

from collections.abc import Mapping

import numpy as np

from granflow.engine.accounting import Accounting
from granflow.engine.changes import REMOVED_BELOW
from granflow.engine.clump_arrays import CLUMP_MOTION, of_clumps
from granflow.engine.host_copy import copy_to_host
from granflow.engine.limits import ABORT_LEFT_DOMAIN
from granflow.engine.state import State
from granflow.plan.outlets import outlet_of
from granflow.plan.plan import Plan

DELETED_FIELDS = tuple(
    dict.fromkeys(("id", "mass", "radius", "position", "velocity", "angular_velocity", "fixed", *CLUMP_MOTION))
)
"""Fields of deleted particles that their accounting needs."""


def deleted_particles(state: State, first: int, last: int) -> dict[str, np.ndarray]:
    """DELETED_FIELDS of the particles with the indices `first` to `last`, exclusive, in the order of their ids.

    Particles that a program has removed are left out: they are counted where it removes them.
    """
    arrays = copy_to_host(state, DELETED_FIELDS, first, last)
    by_id = np.argsort(arrays["id"])
    arrays = {name: values[by_id] for name, values in arrays.items()}
    return {name: values[arrays["radius"] > REMOVED_BELOW] for name, values in arrays.items()}


def account_deleted(state: State, accounting: Accounting, arrays: Mapping[str, np.ndarray]) -> None:
    """Add deleted particles with the fields DELETED_FIELDS to the accounting.

    With `on_exit: error`, sets the abort code if one of them left the domain.
    """
    position = of_clumps(arrays)["position"].astype(float)
    outlet_index = _outlets_of(state.plan, position)
    left_domain = outlet_index < 0
    if state.plan.domain.on_exit == "error" and left_domain.any():
        state.control.abort[0] = ABORT_LEFT_DOMAIN
        state.control.abort_particle[0] = int(arrays["id"][left_domain].min())
    accounting.delete(arrays, outlet_index, np.array(state.plan.gravity))
    accounting.count_exits(_exit_faces(state.plan, position[left_domain]))


def _exit_faces(plan: Plan, position: np.ndarray) -> np.ndarray:
    """Index in EXIT_FACES (n,) of the face of the domain that is farthest behind each position (n, 3) [m]."""
    beyond = np.concatenate([plan.domain_low - position, position - plan.domain_high], axis=1)
    return np.asarray(beyond.argmax(axis=1))


def _outlets_of(plan: Plan, position: np.ndarray) -> np.ndarray:
    """Index of the outlet (n,) that deletes each particle at a position (n, 3) [m], -1 for none."""
    checked_axes = [axis for axis in range(3) if plan.domain.on_exit != "expand"]
    low, high = plan.domain_low[checked_axes], plan.domain_high[checked_axes]
    in_domain = np.all((position[:, checked_axes] >= low) & (position[:, checked_axes] <= high), axis=1)
    return outlet_of(plan.outlets, position, in_domain)
