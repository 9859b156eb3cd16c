"""Starts and restarts Taichi, and keeps the device data of ended simulations with their kernels.

A later simulation of equal structure in this process takes the data of an ended one and compiles nothing.

Taichi numbers its fields consecutively from its start, and the key of a kernel in the cache on disk contains
these numbers. Fields that are added to others therefore need new kernels, also if they equal earlier ones. If
no simulation is in use, Taichi is restarted instead (about 0.1 s): each structure is compiled once per
machine, and architecture, precision and threads can change.
"""

import gc
import threading
import weakref
from collections.abc import Hashable
from typing import get_args

from granflow.engine import backend as taichi
from granflow.engine.backend import Arch, Backend, Precision
from granflow.engine.state import State, wants_optimization
from granflow.errors import GranflowError
from granflow.io.machine import worker_count
from granflow.plan.arrays import fits_lists, structure_of
from granflow.plan.cost import estimate_memory
from granflow.plan.plan import Plan

MOST_STATES = 4
"""Number of states that are kept; the oldest is freed first."""
MOST_BYTES = 250_000_000
"""Device memory [bytes] of all kept states; a larger state is freed at its end."""
restarts_for_structures = True
"""Whether Taichi is restarted for a new structure. The tests keep states instead."""
_kept: list[State] = []
_in_use: "weakref.WeakSet[State]" = weakref.WeakSet()


def start(arch: Arch = "cpu", precision: Precision = "f64", threads: int | None = None) -> Backend:
    """Start Taichi, or restart it if it runs with other settings and no simulation is in use.

        granflow.start("cpu", precision="mixed", threads=2)

    threads:  CPU threads; None: as many as this process may use
    Raises:   GranflowError for unknown settings, if the architecture is absent or lacks float64, or if Taichi
              runs with other settings, or in another thread, and a simulation, or a field of the program
              itself, is in use
    """
    worker_count(threads)  # refuses what is no number of threads before anything is stopped
    for name, value, known in (("arch", arch, get_args(Arch)), ("precision", precision, get_args(Precision))):
        if value not in known:
            raise GranflowError(f"{name} is {value!r}; give one of {', '.join(known)}.")
    taichi.refuse_forked_process()
    running = taichi.running()
    if running is not None:
        is_same = running.owner is threading.current_thread() and taichi.is_running_with(
            arch, precision, threads
        )
        if not is_same and _is_unused():
            _stop()
    return taichi.start(arch, precision, threads)


def take_state(plan: Plan, backend: Backend) -> State:
    """The state for a plan: a kept one of equal structure, reset, or a new one.

    Simulations that nothing refers to any more return their states first.
    """
    structure = structure_of(plan)
    if not _matches(structure, plan, _kept) and _matches(structure, plan, _in_use):
        gc.collect()
    found = next(iter(_matches(structure, plan, _kept)), None)
    if found is None:
        found = State(plan, _fresh(backend))
    else:
        _kept.remove(found)
        found.reset(plan)
    taichi.optimize_kernels(found.optimized)
    _in_use.add(found)
    return found


def return_state(state: State) -> None:
    """Keep a state for a later simulation. Garbage collection may call it, so that it frees nothing."""
    _in_use.discard(state)
    _kept.append(state)


def _fresh(backend: Backend) -> Backend:
    """The backend, restarted if it has been used and nothing of it is in use."""
    if not taichi.is_used() or backend is not taichi.running():
        return backend
    if not (restarts_for_structures and _is_unused()):
        _free_excess()
        return backend
    _stop()
    return taichi.start(backend.arch, backend.precision, backend.threads)  # type: ignore[arg-type]


def _is_unused() -> bool:
    """Whether neither a simulation nor a field of the program itself is in use."""
    if _in_use:
        gc.collect()
    return not _in_use and not taichi.foreign_fields_exist()


def _stop() -> None:
    """Free the kept states and stop Taichi."""
    while _kept:
        _kept.pop().free()
    taichi.stop()


def _matches(structure: Hashable, plan: Plan, states: "list[State] | weakref.WeakSet[State]") -> list[State]:
    return [
        state
        for state in states
        if state.structure == structure
        and state.optimized >= wants_optimization(plan, state.backend)
        and fits_lists(state.capacities, plan.capacities)
    ]


def _free_excess() -> None:
    """Free the oldest kept states above MOST_STATES or MOST_BYTES."""
    while _kept and (len(_kept) > MOST_STATES or sum(map(_size, _kept)) > MOST_BYTES):
        _kept.pop(0).free()


def _size(state: State) -> int:
    """Device memory [bytes]."""
    return estimate_memory(state.plan, state.plan.scene.run.precision).total
