"""Device data of ended simulations, kept with their kernels for later simulations of equal structure in this process.

Taichi numbers its fields consecutively over the whole process, and the key of a kernel in the cache on disk contains
these numbers. New fields therefore need new kernels, also if they equal earlier ones.
"""

import gc
import weakref
from collections.abc import Hashable

from granflow.engine.backend import Backend
from granflow.engine.state import State
from granflow.plan.memory_estimate import estimate_memory
from granflow.plan.plan import Plan
from granflow.plan.structure import fits_lists, structure_of

MOST_STATES = 4
"""Number of states that are kept; the oldest is freed first."""

MOST_BYTES = 250_000_000
"""Device memory [bytes] of all kept states; a larger state is freed at its end."""

_kept: list[State] = []
_in_use: "weakref.WeakSet[State]" = weakref.WeakSet()


def take_state(plan: Plan, backend: Backend) -> State:
    """The state for a plan: a kept one of equal structure, reset, or a new one.

    Simulations that nothing refers to any more return their states first.
    """
    structure = structure_of(plan)
    if not _matches(structure, plan, _kept) and _matches(structure, plan, _in_use):
        gc.collect()
    found = next(iter(_matches(structure, plan, _kept)), None)
    if found is None:
        _free_excess()
        found = State(plan, backend)
    else:
        _kept.remove(found)
        found.reset(plan)
    _in_use.add(found)
    return found


def return_state(state: State) -> None:
    """Keep a state for a later simulation. Garbage collection may call it, so that it frees nothing."""
    _in_use.discard(state)
    _kept.append(state)


def _matches(structure: Hashable, plan: Plan, states: "list[State] | weakref.WeakSet[State]") -> list[State]:
    return [state for state in states if state.structure == structure and fits_lists(state.capacities, plan.capacities)]


def _free_excess() -> None:
    """Free the oldest kept states above MOST_STATES or MOST_BYTES."""
    while _kept and (len(_kept) > MOST_STATES or sum(map(_size, _kept)) > MOST_BYTES):
        _kept.pop(0).free()


def _size(state: State) -> int:
    """Device memory [bytes]."""
    return estimate_memory(state.plan, state.plan.precision).total
