"""Errors of the runs of a scene, their statistical noise, and the recommended time step.

Granular flow is chaotic: a difference between two runs is an error of the time step only if it exceeds the scatter over
several seeds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from granflow import plan_for
from granflow.errors import GranflowError
from granflow.studies.accuracy.axes import PRECISIONS
from granflow.studies.accuracy.scene_runs import (
    STEP_FAMILIES,
    KeptRuns,
    RunOutcome,
    SceneTask,
    StepFamily,
    common_quantities,
    phase_of,
    seeds_of,
)

SHARES = (0.1, 0.2, 0.28, 0.4)
"""Time steps over the shortest phase of a contact."""
SINGLE_SHARES = (0.2,)
"""Time steps over the shortest phase for runs in mixed and single precision."""
REFERENCE = 0.05
"""Share of the reference run in double precision."""
SEEDS = 3
"""Number of seeds of each combination; the noise is estimated from their scatter."""

FULL_SEEDS = 5
"""Number of seeds with `full`."""

FINER = 0.5
"""Factor on the time step of the reference with `full`."""
SIGMAS = 2.0
"""Reported noise, in standard errors."""
ENERGY_ERROR = "energy_error"
"""Quantity with an absolute target instead of a comparison with the reference run."""


@dataclass(frozen=True)
class ScenePoint:
    """Results of a scene with one time step and precision.

    `share`: time step over the shortest phase; `time_step` [s]; `values` and relative `errors` by quantity, empty after
    an abort; `seconds` (seeds,): processor time of each run [s]; `simulated` time [s]; `stopped`: reason of an abort,
    otherwise empty.
    """

    family: str
    precision: str
    share: float
    time_step: float
    restitution_error: float
    values: dict[str, float]
    errors: dict[str, float]
    seconds: np.ndarray
    simulated: float
    stopped: str

    @property
    def cost(self) -> tuple[float, float, float]:
        """Processor time per simulated time [s/s]: median, minimum, maximum."""
        if self.stopped:
            return inf, inf, inf
        shared = self.seconds / self.simulated
        return float(np.median(shared)), float(shared.min()), float(shared.max())


@dataclass(frozen=True)
class SceneStudy:
    """All points of a scene.

    `noise`: statistical difference of two means over the seeds by quantity (SIGMAS standard errors). `spread`:
    standard deviation over the seeds of the reference. Both are relative, like the errors. `own_share`, `own_time_step`
    [s]: values of the unmodified scene.
    """

    title: str
    points: tuple[ScenePoint, ...]
    noise: dict[str, float]
    spread: dict[str, float]
    own_share: float
    own_time_step: float
    particle_count: int
    seed_count: int
    target: float

    @property
    def quantities(self) -> list[str]:
        """Names of the quantities with an error relative to the reference."""
        return list(self.noise)

    def within_target(self, point: ScenePoint) -> bool:
        """Whether restitution, energy budget and every quantity are within the target or below the noise.

        The noise applies to the quantities of the bed only.
        """
        if point.stopped:
            return False
        inside = all(point.errors[name] <= max(self.target, self.noise[name]) for name in self.noise)
        return inside and max(point.restitution_error, point.errors[ENERGY_ERROR]) <= self.target

    @property
    def cheapest(self) -> list[ScenePoint]:
        """The cheapest point within the target, and those whose costs overlap with its costs, over all seeds.

        With more than one, the measured costs do not decide between them. Empty if no point is within the target.
        """
        inside = sorted(filter(self.within_target, self.points), key=lambda point: point.cost[0])
        return [point for point in inside if point.cost[1] <= inside[0].cost[2]]


@dataclass(frozen=True)
class _Runs:
    """Runs of all seeds with one time step and precision."""

    family: str
    precision: str
    share: float
    time_step: float
    restitution_error: float
    outcomes: list[RunOutcome]

    @property
    def stopped(self) -> str:
        """Reason of the first abort; empty if all runs finished."""
        return next((outcome.stopped for outcome in self.outcomes if outcome.stopped), "")

    def value(self, name: str) -> np.ndarray:
        """Values of a quantity for every seed (seeds,)."""
        return np.array([outcome.values[name] for outcome in self.outcomes])


def measure_scene(
    task: SceneTask,
    target: float,
    full: bool = False,
    report: Callable[[str], None] = lambda text: None,
    shares: Sequence[float] = SHARES,
    precisions: Sequence[str] = PRECISIONS,
    kept: KeptRuns | None = None,
) -> SceneStudy:
    """Run the scene with every time step and precision, the finest first.

    `target`: relative error; `full`: more seeds and a finer reference; `shares`: time steps over the shortest phase.
    `precisions` begin with f64. `report` receives progress messages. `kept`: runs of an earlier call, which are not
    repeated.

    Raises SceneError for an invalid scene, GranflowError if the run with the finest time step aborts.
    """
    task = task.with_overrides("output.energy_budget=true")
    scene = task.scene()
    phase, own_share = phase_of(scene)
    seeds = seeds_of(scene, FULL_SEEDS if full else SEEDS)
    finest = REFERENCE * (FINER if full else 1.0)
    planned: list[tuple[str, StepFamily, float]] = []
    for precision in precisions:
        wanted = list(shares) if precision == "f64" else [s for s in shares if s in SINGLE_SHARES]
        settings = [(family, share) for family in STEP_FAMILIES for share in wanted]
        if precision == "f64":
            settings = [(STEP_FAMILIES[0], finest), *[(STEP_FAMILIES[0], finest / FINER)] * full, *settings]
        planned += [(precision, family, share) for family, share in settings]
    progress = _Progress(len(planned) * len(seeds), report)
    runs: list[_Runs] = []
    for precision, family, share in planned:
        runs.append(_run(task, family, share, phase, precision, seeds, kept or KeptRuns(None), progress))
        if runs[0].stopped:
            raise GranflowError(f"The run with the finest time step of this study aborts. {runs[0].stopped}")
    count = sum(group.count for group in scene.particles.values())
    return _study(runs, finest, scene.title, (own_share, own_share * phase), count, len(seeds), target)


class _Progress:
    """Numbers the runs of a study in its messages."""

    def __init__(self, total: int, report: Callable[[str], None]) -> None:
        self._total, self._report = total, report
        self._number = 0

    def next(self, text: str, is_kept: bool) -> None:
        """Report that the next run begins, or that its outcome is kept from an earlier command."""
        self._number += 1
        self._report(f"run {self._number} of {self._total}: {text}{', kept' * is_kept}")


def _run(
    task: SceneTask, family: StepFamily, share: float, phase: float, precision: str, seeds: Sequence[int],
    kept: KeptRuns, progress: _Progress,
) -> _Runs:  # fmt: skip
    """Run all seeds and measure the restitution error.

    `share`: time step over the shortest phase; `phase` [s]. After an abort the restitution error is infinite. The time
    step of the adaptive family is that of the plan, which other limits can shorten.
    """
    stepped = task.with_overrides(f"run.precision={precision}", *family.overrides(share, phase))
    outcomes = []
    for seed in seeds:
        seeded = stepped.with_overrides(f"seed={seed}")
        known = kept.outcome(seeded)
        text = f"{family.name} time step, {share:g} of the shortest phase, {precision}, seed {seed}"
        progress.next(text, known is not None)
        outcomes.append(known or kept.run(seeded))
    error = inf if outcomes[0].stopped else kept.restitution_error(stepped)
    time_step = plan_for(stepped.scene()).time_step if family.name == "adaptive" else share * phase
    return _Runs(family.name, precision, share, time_step, error, outcomes)


def _study(
    runs: Sequence[_Runs], finest: float, title: str, given: tuple[float, float], count: int, seeds: int, target: float
) -> SceneStudy:
    """Combine the runs to errors, noise and spread relative to the reference run.

    `given`: share and time step [s] of the unmodified scene.
    """
    reference = next(each for each in runs if each.share == finest and each.precision == "f64")
    quantities = [name for name in common_quantities([o.values for r in runs for o in r.outcomes if not o.stopped])
                  if name != ENERGY_ERROR]  # fmt: skip
    scales = {name: abs(float(reference.value(name).mean())) or 1.0 for name in quantities}
    noise = {name: _noise(runs, reference, name) / scales[name] for name in quantities}
    spread = {name: float(reference.value(name).std(ddof=1)) / scales[name] for name in quantities}
    points = tuple(_point(each, reference, scales) for each in runs)
    return SceneStudy(title, points, noise, spread, *given, count, seeds, target)


def _noise(runs: Sequence[_Runs], reference: _Runs, name: str) -> float:
    """SIGMAS standard errors of the mean difference from the reference; variance averaged over all time steps.

    Absolute, in the unit of the quantity `name`; 0 if no other run is complete.
    """
    scatter = []
    for each in runs:
        if not each.stopped and each is not reference:
            differences = each.value(name) - reference.value(name)
            scatter.append(float(differences.var(ddof=1)))
    return SIGMAS * float(np.sqrt(np.mean(scatter) / len(reference.outcomes))) if scatter else 0.0


def _point(runs: _Runs, reference: _Runs, scales: dict[str, float]) -> ScenePoint:
    """Means over the seeds and relative errors of one time step; `scales`: reference values by quantity."""
    values, errors = {}, {}
    if not runs.stopped:
        values = {name: float(runs.value(name).mean()) for name in (ENERGY_ERROR, *scales)}
        errors = {ENERGY_ERROR: float(np.abs(runs.value(ENERGY_ERROR)).max())}
        errors |= {name: abs(values[name] - float(reference.value(name).mean())) / scales[name] for name in scales}
    return ScenePoint(
        runs.family, runs.precision, runs.share, runs.time_step, runs.restitution_error, values, errors,
        np.array([outcome.seconds for outcome in runs.outcomes]), runs.outcomes[0].simulated, runs.stopped,
    )  # fmt: skip
