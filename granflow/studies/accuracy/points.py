"""Points of the two-particle study: errors and processor time of one kind of collision at one time step."""

from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cached_property

import numpy as np

from granflow import SceneError
from granflow.studies.accuracy.axes import PHASES, STEPS, CollisionKind, StudiedLaw
from granflow.studies.accuracy.collisions import REPEATS, AccuracyBench, CollisionResults

QUANTITIES = ("restitution", "duration", "overlap_max", "energy")
"""Quantities with an error relative to the exact solution."""

QUANTITY_LABELS = {
    "restitution": "restitution",
    "duration": "duration",
    "overlap_max": "maximum overlap",
    "energy": "energy",
}
"""Titles of the quantities in figures and tables."""


@dataclass(frozen=True)
class StudyPoint:
    """One row of the CSV, in SI units.

    `steps`: duration of the collision over the time step. `share`: time step over the shorter of loading and unloading,
    as `numerics.time_step_fraction` of a scene. Errors are relative to the exact value; the energy error is the error
    of the final kinetic energy over the initial one. `*_error`: root mean square over the phases of first contact;
    `*_error_worst`: maximum. `seconds_*`: processor time of one collision [s].
    """

    law: str
    precision: str
    steps: float
    time_step: float
    restitution: float
    velocity: float
    share: float
    restitution_error: float
    duration_error: float
    overlap_max_error: float
    energy_error: float
    restitution_error_worst: float
    duration_error_worst: float
    overlap_max_error_worst: float
    energy_error_worst: float
    seconds_median: float
    seconds_min: float
    seconds_max: float
    repeats: int


@dataclass(frozen=True)
class StudyLine:
    """All points of one contact model and precision: each number of steps for each kind of collision."""

    law: str
    precision: str
    points: tuple[StudyPoint, ...]

    @cached_property
    def steps(self) -> np.ndarray:
        """Steps per collision in ascending order (n,)."""
        return np.array(sorted({point.steps for point in self.points}))

    def error(self, quantity: str) -> np.ndarray:
        """Largest error of all kinds of collision (n,); nan where the end of a collision was not observed.

        `quantity`: one of QUANTITIES. The order is that of `steps`.
        """
        return self._over_kinds(f"{quantity}_error")

    def seconds(self, which: str = "median") -> np.ndarray:
        """Processor time per collision [s] (n,); `which`: median, min or max over the repeats."""
        return self._over_kinds(f"seconds_{which}")

    def kinds(self) -> list[list[StudyPoint]]:
        """Points of each kind of collision, in ascending order of steps."""
        names = dict.fromkeys((point.restitution, point.velocity) for point in self.points)
        matching = [[p for p in self.points if (p.restitution, p.velocity) == name] for name in names]
        return [sorted(points, key=lambda point: point.steps) for points in matching]

    def _over_kinds(self, name: str) -> np.ndarray:
        """Maximum of a field over the kinds of collision for each number of steps (n,)."""
        return np.array([max_or_nan(getattr(p, name) for p in self.points if p.steps == n) for n in self.steps])


def max_or_nan(values: Iterable[float]) -> float:
    """Maximum of the values; nan if any value is nan."""
    return float(np.max(np.array(list(values))))


def columns(points: Sequence[StudyPoint]) -> dict[str, np.ndarray]:
    """Columns of the CSV, one array (points,) per field of StudyPoint."""
    names = [each.name for each in fields(StudyPoint)]
    return dict(zip(names, map(np.array, zip(*map(astuple, points), strict=True)), strict=True))


def measured_line(
    studied_law: StudiedLaw,
    precision: str = "f64",
    steps: Sequence[float] = STEPS,
    repeats: int = REPEATS,
    threads: int | None = None,
) -> tuple[StudyLine, list[str]]:
    """Measure all points of one line; the second result describes the steps rejected as unstable.

    `steps`: numbers of steps per collision; `repeats`: number of timings of each; `threads`: as for Simulation.
    """
    bench = AccuracyBench(studied_law, precision, threads)
    points: list[StudyPoint] = []
    refused: list[float] = []
    for count in steps:
        try:
            points += _points(bench, bench.run(count, repeats))
        except SceneError:
            refused.append(count)
    bench.free()
    descriptions = [f"{studied_law.name} with {', '.join(f'{n:g}' for n in refused)} steps per collision"]
    return StudyLine(studied_law.name, precision, tuple(points)), descriptions if refused else []


def _points(bench: AccuracyBench, results: CollisionResults) -> list[StudyPoint]:
    """One point per kind of collision, with errors over the phases (PHASES,) and processor times.

    Processor times are equal for all kinds, because all collisions run simultaneously.
    """
    seconds = results.seconds
    shared = {"law": bench.studied_law.name, "precision": bench.precision,
              "steps": float(results.steps), "time_step": results.time_step, "repeats": len(seconds),
              "seconds_median": float(np.median(seconds)), "seconds_min": float(seconds.min()),
              "seconds_max": float(seconds.max())}  # fmt: skip
    found = []
    for index, kind in enumerate(bench.kinds):
        errors = dict(zip(QUANTITIES, _errors(results, kind, index), strict=True))
        rms = {f"{name}_error": float(np.sqrt(np.mean(error**2))) for name, error in errors.items()}
        worst = {f"{name}_error_worst": float(np.max(np.abs(error))) for name, error in errors.items()}
        given = {"restitution": kind.restitution, "velocity": kind.velocity,
               "share": results.time_step / _phase(bench, index)}  # fmt: skip
        found.append(StudyPoint(**shared, **given, **rms, **worst))  # type: ignore[arg-type]
    return found


def _errors(results: CollisionResults, kind: CollisionKind, index: int) -> tuple[np.ndarray, ...]:
    """Errors in the order of QUANTITIES, each (phases,): relative, except the energy.

    energy error = e^2 - e_exact^2, over the initial kinetic energy
    """
    exact, e = kind.exact, results.restitution[index]
    return (
        e / exact.restitution - 1.0,
        results.duration[index] / exact.duration - 1.0,
        results.overlap_max[index] / exact.overlap_max - 1.0,
        e**2 - exact.restitution**2,
    )


def _phase(bench: AccuracyBench, index: int) -> float:
    """Shorter of loading and unloading time of a kind of collision [s], by the formula of the plan.

    The time of the pair case is scaled with the diameter, to which it is proportional.
    """
    kind, group = bench.kinds[index], bench.bench.collisions[index * PHASES].first
    pair_case = next(each for each in bench.plan.pair_cases if each.name == f"{group}-{group}")
    return bench.plan.shortest_phase(pair_case, kind.velocity) / (2.0 * pair_case.radius) * kind.diameter
