"""Times of `Simulation.run`: text with units, durations, and their limits."""

from math import inf, isfinite

from granflow.errors import GranflowError
from granflow.scene.schema.units import seconds_of


def end_of_run(until: float | str | None, duration: float | str | None, now: float, time_step: float) -> float:
    """End [s] of a run until a time or for a duration, numbers in s or text with units; infinite without both.

    now:        present time [s]
    time_step:  present time step [s]
    Raises:     GranflowError
    """
    until, duration = (
        None if time is None else seconds_of(name, time) for name, time in (("until", until), ("duration", duration))
    )
    if until is not None and duration is not None:
        raise GranflowError("run takes until or duration, not both.")
    if until is not None and until < now - time_step:
        raise GranflowError(f"until is {until:g} s, but the simulation is at {now:g} s.")
    for name, time in (("until", until), ("duration", duration)):
        if time is not None and not isfinite(now + time):
            raise GranflowError(f"{name} is {time} s, but must be finite.")
    if duration is not None and duration < 0.0:
        raise GranflowError(f"duration is {duration:g} s, but must not be negative.")
    return now + duration if duration is not None else inf if until is None else until
