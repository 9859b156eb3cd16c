"""Flags and counters of the device that the host reads after a launch."""

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
    """The present flags; on a GPU one kernel and one transfer for all of them."""
    control = state.control
    if control.halted_at is not None:
        return DeviceFlags(*(int(value) for value in state.built(_build_flags)()))
    return DeviceFlags(
        integration_halted_at=0,
        forces_halted_at=0,
        abort=int(control.abort[0]),
        running=int(control.running[0]),
        list_length_needed=int(control.list_length_needed[0]),
        present=int(state.cell_sort.present[0]),
    )


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
