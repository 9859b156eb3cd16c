"""Flags and counters that the host reads after a launch: on a GPU one kernel and one transfer for all of
them."""

from collections.abc import Callable
from typing import Any, NamedTuple

from granflow.engine.codes import FORCES, INTEGRATION
from granflow.engine.state import State
from granflow.kernel_language import ti


class DeviceFlags(NamedTuple):
    """See `Control` and `CellSort`; on a CPU, the launches at which a phase halted are 0."""

    integration_halted_at: int
    forces_halted_at: int
    abort: int
    running: int
    list_length_needed: int
    present: int


def read_flags(state: State) -> DeviceFlags:
    """The present flags."""
    if state.control.halted_at is not None:
        return DeviceFlags(*(int(value) for value in state.built(_build_flags)()))
    control = state.control
    fields = (control.abort, control.running, control.list_length_needed, state.cell_sort.present)
    return DeviceFlags(0, 0, *(int(field[0]) for field in fields))


def _build_flags(state: State) -> Callable[[], Any]:
    """Kernel (): the flags as a vector, in the order of `DeviceFlags`.

    Reads:  halted_at, abort, running, list_length_needed, present
    """
    control = state.control
    sorting = state.cell_sort

    @ti.kernel
    def flags() -> ti.types.vector(6, ti.i32):
        return ti.Vector(
            [
                control.halted_at[INTEGRATION],
                control.halted_at[FORCES],
                control.abort[0],
                control.running[0],
                control.list_length_needed[0],
                sorting.present[0],
            ]
        )

    return flags
