"""An observer that calls a Python function at a regular interval."""

from collections.abc import Callable, Iterable
from inspect import (
    isasyncgen,
    isasyncgenfunction,
    iscoroutine,
    iscoroutinefunction,
    isgenerator,
    isgeneratorfunction,
)
from typing import Any

from granflow.arguments import items_of, refuse_other, shown
from granflow.errors import GranflowError, StopRun
from granflow.observers.base import CONTACTS, PARTICLES, TOTALS, WALLS
from granflow.observers.schedule import ScheduledObserver
from granflow.scene.schema.units import seconds_of
from granflow.snapshot import Snapshot


class on_interval(ScheduledObserver):
    """Calls `function(snapshot)` every `interval` from `start`, and at the end of the run.

    `interval`, `start`: simulated time, a number [s] or text with a unit ("1 ms"). `wants`: parts of the snapshot that
    the function reads; "contacts" must be added explicitly, because their output costs time. The arrays of the snapshot
    are read-only; the function may change the simulation itself (`simulation.particles`, `simulation.walls`), and
    raises `granflow.StopRun` to end the run. A second snapshot of the same time has no effect.

        simulation.observers.append(granflow.on_interval("1 ms", lambda snapshot: print(snapshot.time)))

    `name`: of the function, in messages and checkpoints; it and `wants` can be set, interval and function cannot. An
    observer belongs to one simulation at a time. Raises GranflowError for an interval that is not positive and finite,
    a unit that is not one of time, an unknown part, or an object that is not a function; generators and coroutines
    are none, because a call does not execute them.
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
            for unknown in value - {PARTICLES, CONTACTS, WALLS, TOTALS}:
                raise GranflowError(
                    f"wants contains {shown(unknown)}, but has parts of particles, contacts, walls, totals."
                )
        elif name == "name":
            refuse_other("name", value, str, 'a text, such as "report"')
        elif not name.startswith("_") and name != "interval":
            raise AttributeError(
                f"on_interval.{name} cannot be set: remove the observer from simulation.observers and append another "
                "one, granflow.on_interval(interval, function)."
            )
        super().__setattr__(name, value)

    def observe(self, snapshot: Snapshot) -> None:
        """Call the function with the snapshot; if it fails, the snapshot counts as not observed."""
        if snapshot.time == self._schedule.last_time:
            return
        try:
            returned = self._function(snapshot)
            if isgenerator(returned) or isasyncgen(returned) or iscoroutine(returned):
                raise GranflowError("it returns a generator or a coroutine, whose code is not executed; use no yield")
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
                f"{name} is a generator or a coroutine, whose code a call does not execute: use a function without "
                "yield and async."
            )
