"""Forecasts of output intervals that are longer than the run, or that show a vibration at two phases only."""

from collections.abc import Iterator
from math import pi

from granflow.load import Scene
from granflow.plan.forecast.forecast import Forecast
from granflow.plan.walls import StageTimes
from granflow.scene.schema.motions import Vibration

TOLERANCE = 0.01
"""Largest relative deviation of an interval from an odd multiple of half a period."""

FRAMES_PER_PERIOD = 8
"""Number of frames per period that a message suggests."""

COARSE = 0.25
"""Interval over the period above which frames do not resolve a vibration."""


def interval_warnings(scene: Scene, times: StageTimes) -> Iterator[str]:
    """A sentence on an output interval above the duration of the run."""
    longest = max(end for _, end in times.values())
    if scene.output.interval > longest:
        yield (
            f"output.interval ({scene.where('output', 'interval')}) is {scene.output.interval:g} s, but the run lasts "
            f"at most {longest:g} s: only the first and the last state are written. Choose a shorter interval."
        )


def vibration_forecasts(scene: Scene) -> Iterator[Forecast]:
    """Frames per period of each vibration with less than four, and warnings on stroboscopic intervals.

        interval = (n + 1/2) T within 1 %:     sin(w t + phase) has the values +- sin(phase) only

    With the default phase of 0, the wall is at the same position in all frames. Multiples of the whole period are often
    intended, because they show the slow motion of a bed.
    """
    for period, name in _periods(scene).items():
        wall = f"walls.{name}.motion ({scene.where('walls', name, 'motion')})"
        for output, interval in _intervals(scene):
            ratio = interval / period
            if ratio <= COARSE * (1.0 + TOLERANCE):
                continue
            odd = round(2.0 * ratio) % 2 == 1 and abs(2.0 * ratio / round(2.0 * ratio) - 1.0) <= TOLERANCE
            warning = (
                f"{'.'.join(output)} ({scene.where(*output)}) is {interval:.4g} s, {0.5 * round(2.0 * ratio):g} times "
                f"the period {period:.4g} s of {wall}: the output shows this motion at two opposite phases only, which "
                f"can be the same position of the wall. Set the interval to {period / FRAMES_PER_PERIOD:.3g} s or "
                f"less, {FRAMES_PER_PERIOD} times per period, or to {period:.4g} s for one fixed phase."
            )
            remark = f"{'.'.join(output)}, of the period {period:.4g} s of {wall}"
            yield Forecast("vibration in the output", f"{1.0 / ratio:.3g} per period", remark, warning if odd else None)


def _periods(scene: Scene) -> dict[float, str]:
    """Each period [s] of the vibrations, with the name of the first wall."""
    found: dict[float, str] = {}
    for name, wall in scene.walls.items():
        for motion in wall.motion:
            if isinstance(motion, Vibration):
                amplitude, rate = motion.amplitude_and_angular_frequency(scene.gravity)
                if amplitude and rate:
                    found.setdefault(2.0 * pi / rate, name)
    return found


def _intervals(scene: Scene) -> Iterator[tuple[tuple[str, ...], float]]:
    """Paths of the keys of the output intervals, and the intervals [s]; those that are not given are `interval`."""
    yield ("output", "interval"), scene.output.interval
    if scene.is_given("output", "timeseries_interval"):
        yield ("output", "timeseries_interval"), scene.output.timeseries_interval
    for name, grid in scene.output.fields.items():
        if grid.interval is not None:
            yield ("output", "fields", name, "interval"), grid.interval
