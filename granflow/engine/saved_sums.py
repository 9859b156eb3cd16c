"""Sums over the chunks of particles, and force-controlled walls, in checkpoints."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.engine.exact_sums import canonical, chunk_words
from granflow.engine.field_kernels import write_field
from granflow.engine.state import State
from granflow.errors import GranflowError
from granflow.plan.device_arrays import DeviceArray, saved_arrays, sum_arrays, wall_dynamics_arrays
from granflow.plan.plan import Plan

OTHER_FEATURES = (
    "Friction, rolling friction, the energy budget, wall forces and collision energies cannot be switched on or off in "
    "a resumed run."
)
"""End of messages on arrays that do not match those of the scene."""


def saved_sums(state: State) -> dict[str, np.ndarray]:
    """Terms of the energy budget and of the wall forces by name, summed over chunks and MPI ranks, int64."""
    fields = {name: getattr(state.control, name) for name in _sums(state.plan)}
    totals = {
        name: state.ranks.total(field.to_numpy() if len(field.shape) > 1 else chunk_words(state, field))
        for name, field in fields.items()
    }
    return {name: canonical(words.sum(axis=0)) for name, words in totals.items()}


def load_sums(state: State, saved: Mapping[str, np.ndarray]) -> None:
    """Restore the sums that `saved_sums` returned; without them, as on all ranks but the root, the sums are zero.

    Raises GranflowError if an array is missing or unknown.
    """
    arrays = _sums(state.plan)
    if saved:
        refuse_other_names(saved, arrays)
    for name, array in arrays.items():
        _load(getattr(state.control, name), array, saved.get(name))


def saved_wall_dynamics(state: State) -> dict[str, Any]:
    """Keys of the force-controlled motions, and their arrays, forces summed over the chunks."""
    found: dict[str, Any] = {"controlled_motions": [each.key for each in state.plan.controlled_motions]}
    for name, array in _dynamics(state.plan).items():
        values = getattr(state.wall_dynamics, name).to_numpy()
        found[name] = values.sum(axis=0) if array.by_chunk else values
    return found


def load_wall_dynamics(state: State, saved: Mapping[str, Any]) -> None:
    """Restore what `saved_wall_dynamics` returned. Raises GranflowError if the scene has other motions."""
    before, now = saved["controlled_motions"], [controlled.key for controlled in state.plan.controlled_motions]
    if before != now:
        named = (", ".join(each) or "none" for each in (before, now))
        raise GranflowError(
            "The force-controlled wall motions are {} in the checkpoint and {} in the scene. A resumed run can change "
            "the parameters of such a motion but not add or remove one; use stages for that.".format(*named)
        )
    for name, array in _dynamics(state.plan).items():
        _load(getattr(state.wall_dynamics, name), array, saved[name])


def refuse_other_names(saved: Mapping[str, Any], names: Mapping[str, Any]) -> None:
    """Raise GranflowError if an array of a checkpoint is missing or unknown."""
    if set(saved) != set(names):
        present, needed = (", ".join(sorted(each)) or "none" for each in (saved, names))
        raise GranflowError(
            f"The checkpoint holds the arrays {present}, but this scene needs {needed}. {OTHER_FEATURES}"
        )


def _load(field: Any, array: DeviceArray, values: np.ndarray | None) -> None:
    """Write an array to a field; the sum over the chunks to the first chunk, and zeros to the others."""
    if array.by_chunk:
        write_field(field, np.zeros((0, *array.full_shape[1:]), np.int64) if values is None else values[None])
    else:
        field.from_numpy(values)


def _sums(plan: Plan) -> dict[str, DeviceArray]:
    """Saved sums by name."""
    return saved_arrays(sum_arrays(plan))


def _dynamics(plan: Plan) -> dict[str, DeviceArray]:
    """Saved arrays of the force-controlled walls by name; empty without such walls."""
    return saved_arrays(wall_dynamics_arrays(plan)) if plan.controlled_motions else {}
