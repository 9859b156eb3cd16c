"""What an observer is, when it is due, and the observer that calls a function of the user.

A run passes a snapshot to each observer at its due times. `Observer` is the protocol; `WritesFiles` and
`Checkpointable` are what an observer can do in addition. `ScheduledObserver` is the base class of all
observers of granflow: its `Schedule` gives due times at a regular interval. `on_interval` is the observer
that a Python program appends to `simulation.observers`.
"""

import math
import weakref
from collections.abc import Callable, Iterable
from inspect import (
    isasyncgen,
    isasyncgenfunction,
    iscoroutine,
    iscoroutinefunction,
    isgenerator,
    isgeneratorfunction,
)
from typing import Any, Protocol, runtime_checkable

from granflow.arguments import items_of, refuse_other, shown
from granflow.errors import GranflowError, StopRun
from granflow.snapshot import PARTICLES, PARTS, TOTALS, WALLS, Snapshot
from granflow.units import seconds_of


class Observer(Protocol):
    """Receives snapshots of a simulation at its due times.

    `wants`: required parts of the snapshot, out of "particles", "contacts", "walls", "totals".
    """

    wants: frozenset[str]

    def next_time(self) -> float:
        """Return the simulated time of the next snapshot [s]; infinity: only at the end."""

    def observe(self, snapshot: Snapshot) -> None:
        """Process a snapshot. A second snapshot of the same time has no effect.

        Snapshots arrive in order of time. The last one of a run may be earlier than `next_time`.
        """

    def finish(self) -> None:
        """Close files; called once, after the last snapshot."""


@runtime_checkable
class WritesFiles(Protocol):
    """An observer with files that belong to a checkpoint."""

    def sync(self) -> None:
        """Flush the files to the disk. Raises OSError."""


@runtime_checkable
class Checkpointable(Protocol):
    """An observer whose state is part of checkpoints."""

    def state_dict(self) -> dict[str, Any]:
        """Return the state: nested dictionaries of numbers, texts and numpy arrays."""

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`, which may come from another process; files are not modified
        yet."""

    def truncate(self) -> None:
        """Restore the files to their content at the time of the restored state."""


EARLY_FRACTION = 1e-3
"""A time that precedes a due time by less than this fraction of the interval counts as due: the simulated
clock is rounded, and a frame one step later would duplicate the state."""


class Schedule:
    """Due times `start + k * interval` [s], k = 0, 1, 2, ..., without accumulation of rounding errors.

    Raises GranflowError unless the interval is positive and finite.
    """

    def __init__(self, interval: float, start: float = 0.0) -> None:
        if not (interval > 0 and math.isfinite(interval)):
            raise GranflowError(f"interval is {interval} s, but must be positive and finite.")
        self.interval = interval
        self.start = start
        self._count = 0
        self._last_time: float | None = None

    def next_time(self) -> float:
        """Return the next due time [s]: the first one after the last time marked as done."""
        return self.start + self._count * self.interval

    @property
    def last_time(self) -> float | None:
        """The last time marked as done [s]: the only state of a schedule."""
        return self._last_time

    def reset(self) -> None:
        """Begin again."""
        self._count = 0
        self._last_time = None

    def resume_after(self, last_time: float | None) -> None:
        """Continue after a time [s] of an earlier run, which may have used another interval."""
        if last_time is not None:
            self.mark_done(last_time)

    def mark_done(self, time: float) -> bool:
        """Mark all due times up to `time` [s] as done; return False if this time was the last one marked.

        A due time within EARLY_FRACTION of the interval after `time` counts as done too.
        """
        if time == self._last_time:
            return False
        self._last_time = time
        passed = math.floor((time - self.start) / self.interval + EARLY_FRACTION) + 1
        self._count = max(self._count, passed)
        return True


class ScheduledObserver:
    """Base class of observers with a schedule: due times from `start` [s], every `interval` [s]; no files."""

    wants: frozenset[str] = frozenset()

    def __init__(self, interval: float, start: float = 0.0) -> None:
        self._schedule = Schedule(interval, start)
        self._run: weakref.ref[object] | None = None

    @property
    def interval(self) -> float:
        """Interval [s]; fixed: another observer has another one."""
        return self._schedule.interval

    @interval.setter
    def interval(self, value: object) -> None:
        raise AttributeError(
            f"interval of {getattr(self, 'name', type(self).__name__)} cannot be set: remove the observer "
            "from simulation.observers and append another one, granflow.on_interval(interval, function)."
        )

    def begin(self, run: object) -> bool:
        """Belong to a run from its start on; False if another run, which has not ended, already has this
        observer."""
        other = None if self._run is None else self._run()
        if other is not None and other is not run:
            return False
        if other is None:
            self._schedule.reset()
        self._run = weakref.ref(run)
        return True

    def end(self) -> None:
        """Belong to no run any more."""
        self._run = None

    def next_time(self) -> float:
        """Return the time of the next snapshot [s]."""
        return self._schedule.next_time()

    def skip_to(self, time: float) -> None:
        """Skip the due times up to `time` [s]."""
        self._schedule.mark_done(time)

    def finish(self) -> None:
        """Do nothing: no file is open."""

    def state_dict(self) -> dict[str, Any]:
        """Return the last time [s]."""
        return {"last_time": self._schedule.last_time}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue after the saved time."""
        self._schedule.resume_after(saved["last_time"])

    def truncate(self) -> None:
        """Do nothing: this observer has no files."""


class on_interval(ScheduledObserver):
    """Calls `function(snapshot)` every `interval` from `start`, and at the end of the run.

    `interval`, `start`: simulated time, a number [s] or text with a unit ("1 ms"). `wants`: parts of the
    snapshot that the function reads; "contacts" must be added explicitly, because their output costs time.
    The arrays of the snapshot are read-only; the function may change the simulation itself
    (`simulation.particles`, `simulation.walls`), and raises `granflow.StopRun` to end the run. A second
    snapshot of the same time has no effect.

        simulation.observers.append(granflow.on_interval("1 ms", lambda snapshot: print(snapshot.time)))

    `name`: of the function, in messages and checkpoints; it and `wants` can be set, interval and function
    cannot. An observer belongs to one simulation at a time. Raises GranflowError for an interval that is not
    positive and finite, a unit that is not one of time, an unknown part, or an object that is not a function;
    generators and coroutines are none, because a call does not execute them.
    """

    def __init__(
        self,
        interval: float | str,
        function: Callable[[Snapshot], object],
        wants: Iterable[str] = (PARTICLES, WALLS, TOTALS),
        start: float | str = 0.0,
    ) -> None:
        super().__init__(seconds_of("interval", interval), seconds_of("start", start))
        if not callable(function):
            raise GranflowError(f"function is {shown(function)}, but must be a function of a snapshot.")
        refuse_generator(function, getattr(function, "__call__", function))  # noqa: B004
        self._function = function
        self.wants = frozenset(items_of("wants", wants, "parts of a snapshot"))
        self.name = str(getattr(function, "__name__", type(function).__name__))

    def __setattr__(self, name: str, value: Any) -> None:
        """Set `wants` or `name`. Raises AttributeError for another attribute, which would have no effect."""
        if name == "wants":
            value = frozenset(items_of("wants", value, "parts of a snapshot"))
            for unknown in value - PARTS:
                raise GranflowError(
                    f"wants contains {shown(unknown)}, but has parts of particles, contacts, walls, totals."
                )
        elif name == "name":
            refuse_other("name", value, str, 'a text, such as "report"')
        elif not name.startswith("_") and name != "interval":
            raise AttributeError(
                f"on_interval.{name} cannot be set: remove the observer from simulation.observers and append "
                "another one, granflow.on_interval(interval, function)."
            )
        super().__setattr__(name, value)

    def observe(self, snapshot: Snapshot) -> None:
        """Call the function with the snapshot; if it fails, the snapshot counts as not observed."""
        if snapshot.time == self._schedule.last_time:
            return
        try:
            returned = self._function(snapshot)
            if isgenerator(returned) or isasyncgen(returned) or iscoroutine(returned):
                raise GranflowError(
                    "it returns a generator or a coroutine, whose code is not executed; use no yield"
                )
        except StopRun:
            self._schedule.mark_done(snapshot.time)
            raise
        self._schedule.mark_done(snapshot.time)


def refuse_generator(*functions: Any) -> None:
    """Raise GranflowError for a function whose call does not execute its code: a generator or a coroutine."""
    for function in functions:
        if isgeneratorfunction(function) or isasyncgenfunction(function) or iscoroutinefunction(function):
            name = getattr(function, "__qualname__", shown(function))
            raise GranflowError(
                f"{name} is a generator or a coroutine, whose code a call does not execute: use a function "
                "without yield and async."
            )
