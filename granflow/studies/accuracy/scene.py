"""`granflow accuracy SCENE`: which time step and precision a scene needs, and what they cost.

`measure_scene` runs a scene with several time steps, precisions and seeds. The run with the finest time step
is the reference of the errors. Granular flow is chaotic: a difference between two runs is an error of the
time step only if it exceeds the scatter over the seeds, so that the study has a noise for each quantity. The
restitution error of each time step is measured on the collision bench (`granflow.studies.restitution`).
`write_scene` writes `accuracy.csv`, the figure and the page. The outcomes of the runs are kept in
`accuracy_runs.json`, so that a study that was stopped continues with the missing runs.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields
from math import inf
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from granflow import RunError, Scene, SceneError, Simulation, Snapshot, load_scene, on_interval, plan_for
from granflow.errors import GranflowError
from granflow.io.files import write_text
from granflow.plan.restitution import QUICK_VELOCITIES
from granflow.studies.accuracy.report import LINE_STYLES, loglog
from granflow.studies.accuracy.two_particles import PRECISIONS
from granflow.studies.checked_run import run_identity
from granflow.studies.figures import COLORS, Drawing, PageTable, percent, stacked_panels
from granflow.studies.page import write_study
from granflow.studies.restitution import measure as measure_restitution
from granflow.studies.run_process import read_json

# ---------------------------------------------------------------- the scene, and its time steps

MAX_PARTICLES = 1000
"""Particle count to which a scene is reduced, unless all particles are requested."""


@dataclass(frozen=True)
class SceneTask:
    """A scene file with overrides, and the simulated end time [s] or None for the complete run."""

    path: Path
    overrides: tuple[str, ...]
    until: float | None

    def with_overrides(self, *more: str) -> "SceneTask":
        """The same task with additional overrides."""
        return SceneTask(self.path, (*self.overrides, *more), self.until)

    def scene(self) -> Scene:
        """Load the scene. Raises SceneError if it is invalid, or if a program adds its particles."""
        scene = load_scene(self.path, self.overrides)
        scene.refuse_program()
        return scene


def reduced_counts(scene: Scene, most: int = MAX_PARTICLES) -> list[str]:
    """Overrides that reduce the groups with an explicit `count` to at most `most` particles, in proportion.

    Each group keeps at least one particle. Empty if the scene is small enough.
    """
    counted = {
        name: group.count
        for name, group in scene.particles.items()
        if scene.is_given("particles", name, "count")
    }
    total = sum(counted.values())
    if total <= most:
        return []
    return [
        f"particles.{name}.count={max(round(count * most / total), 1)}" for name, count in counted.items()
    ]


def phase_of(scene: Scene) -> tuple[float, float]:
    """Shortest phase of any contact [s], and the time step of the scene over this phase.

    At the maximum impact velocity of the plan.
    """
    plan = plan_for(scene)
    velocity = plan.impact_velocity.value
    phase = min(pair_case.shortest_phase(plan.laws.normal, velocity) for pair_case in plan.pair_cases)
    return phase, plan.time_step / phase


@dataclass(frozen=True)
class StepFamily:
    """A choice of the time step: its name, and the overrides for a share of the shortest phase [s]."""

    name: str
    overrides: Callable[[float, float], list[str]]


def _fixed(share: float, phase: float) -> list[str]:
    """Overrides for a fixed time step."""
    return [f"run.time_step={float(share * phase)!r}"]


def _adaptive(share: float, _phase: float) -> list[str]:
    """Overrides for an adaptive time step; it does not depend on the phase."""
    return ["run.time_step=adaptive", f"numerics.time_step_fraction={share!r}"]


STEP_FAMILIES = (StepFamily("fixed", _fixed), StepFamily("adaptive", _adaptive))
"""Fixed and adaptive time step."""


# ---------------------------------------------------------------- one run

SAMPLES = 200
"""Number of samples for the means of center of mass and coordination number."""


@dataclass(frozen=True)
class RunOutcome:
    """Result of a run, or the reason of its abort (`stopped`).

    `values` by quantity; `seconds`: processor time of the run without compilation [s], which other programs
    on the machine change less than the wall time; `simulated` time [s].
    """

    values: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    step_count: float = 0.0
    simulated: float = 0.0
    stopped: str = ""


def run_task(task: SceneTask) -> RunOutcome:
    """Run a task. The outcome reports an unstable time step or an abort.

    Raises SceneError only if the scene cannot be loaded. The mean values are sampled SAMPLES times.
    """
    scene = task.scene()
    means = _RunMeans(scene)
    total_duration = scene.longest_duration
    interval = min(total_duration, task.until or total_duration) / SAMPLES
    observer = on_interval(interval, means.update, ("particles", "totals"))
    try:
        with Simulation(scene, observers=[observer]) as simulation:
            timing = simulation.engine.timing
            began = process_time() - timing.compile
            result = simulation.run(until=task.until, within_stages=True)
            seconds = process_time() - timing.compile - began
    except SceneError as error:
        return RunOutcome(stopped=str(error).partition(": ")[2])  # the prefix names an override of this study
    except RunError as error:
        return RunOutcome(stopped=str(error))
    numbers = result.numbers
    flows = {f"mass_flow.{name}": readings["mass_flow"] for name, readings in result.flow_meters.items()}
    values = {"energy_error": numbers["energy_error"], **means.values(), **flows}
    return RunOutcome(values, seconds, numbers["step_count"], numbers["simulated_time"])


class _RunMeans:
    """Means over the run of center height [m] and coordination number.

    The height is that of the center of mass above the bottom of the domain, opposite to gravity (z without
    gravity).
    """

    def __init__(self, scene: Scene) -> None:
        gravity = np.array(scene.usual_gravity)
        strength = float(np.linalg.norm(gravity))
        self._up = -gravity / strength if strength > 0.0 else np.array([0.0, 0.0, 1.0])
        corners = np.array([scene.domain.min, scene.domain.max]) * self._up
        self._ground = float(corners.min(axis=0).sum())
        self._samples: dict[str, list[float]] = {"center_height": [], "coordination_number": []}

    def update(self, snapshot: Snapshot) -> None:
        """Add a snapshot; a snapshot without particles is ignored."""
        mass = snapshot.particles["mass"] if snapshot.particles else np.zeros(0)
        if not len(mass):
            return
        heights = snapshot.particles["position"] @ self._up
        self._samples["center_height"].append(float(mass @ heights / mass.sum()) - self._ground)
        self._samples["coordination_number"].append(snapshot.totals["coordination_number"])

    def values(self) -> dict[str, float]:
        """Means by quantity."""
        return {name: float(np.mean(seen)) for name, seen in self._samples.items() if seen}


def restitution_error(task: SceneTask) -> float:
    """Largest relative restitution error of any pair of materials, for velocities from a tenth of the
    largest.

    Measured by head-on collisions at the time step and the precision of the task.
    """
    rows, _ = measure_restitution(task.scene())
    fastest = max(row.velocity for row in rows)
    slowest = min(QUICK_VELOCITIES) * (1.0 - 1e-9) * fastest
    return max(abs(row.difference) for row in rows if row.velocity >= slowest)


class KeptRuns:
    """Outcomes of the runs of a study in a file, so that a study that was stopped continues with the missing
    runs.

    `path`: JSON file; None: in memory only. The key of an outcome is the identity of its run: resolved scene,
    contents of its inputs, version of granflow, end time. A damaged file, or a damaged outcome, counts as
    missing.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        content = read_json(path) if path is not None else None
        self._content: dict[str, Any] = content if isinstance(content, dict) else {}

    def outcome(self, task: SceneTask) -> RunOutcome | None:
        """The outcome of a task; None if it has not been run."""
        found = self._content.get(self._key(task))
        if not isinstance(found, dict) or set(found) != {each.name for each in fields(RunOutcome)}:
            return None
        return RunOutcome(**found)

    def run(self, task: SceneTask) -> RunOutcome:
        """Run a task with `run_task` and keep its outcome."""
        found = run_task(task)
        self._keep(self._key(task), asdict(found))
        return found

    def restitution_error(self, task: SceneTask) -> float:
        """The kept `restitution_error` of a task, or that of now."""
        key = f"restitution {self._key(task)}"
        found = self._content.get(key)
        if not isinstance(found, float):
            found = restitution_error(task)
            self._keep(key, found)
        return found

    def _key(self, task: SceneTask) -> str:
        text = f"{run_identity(task.scene(), 'cpu')} until {task.until} with {SAMPLES} samples"
        return hashlib.sha256(text.encode()).hexdigest()

    def _keep(self, key: str, value: Any) -> None:
        """Add a value to the file. Raises OSError if it cannot be written."""
        self._content[key] = value
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_text(self._path, json.dumps(self._content, indent=1) + "\n")


# ---------------------------------------------------------------- the study

SHARES = (0.1, 0.2, 0.28, 0.4)
"""Time steps over the shortest phase of a contact."""
SINGLE_SHARES = (0.2,)
"""Time steps over the shortest phase for runs in mixed and single precision."""
REFERENCE = 0.05
"""Share of the reference run in double precision."""
FINER = 0.5
"""Factor on the time step of the reference with `full`."""
SEEDS = 3
"""Number of seeds of each combination; the noise is estimated from their scatter."""
FULL_SEEDS = 5
"""Number of seeds with `full`."""
SIGMAS = 2.0
"""Reported noise, in standard errors."""
ENERGY_ERROR = "energy_error"
"""Quantity with an absolute target instead of a comparison with the reference run."""


@dataclass(frozen=True)
class ScenePoint:
    """Results of a scene with one time step and precision.

    `share`: time step over the shortest phase; `time_step` [s]; `values` and relative `errors` by quantity,
    empty after an abort; `seconds` (seeds,): processor time of each run [s]; `simulated` time [s]; `stopped`:
    reason of an abort, otherwise empty.
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

    `noise`: statistical difference of two means over the seeds by quantity (SIGMAS standard errors).
    `spread`:
    standard deviation over the seeds of the reference. Both are relative, like the errors. `own_share`,
    `own_time_step` [s]: values of the unmodified scene.
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

        With more than one, the measured costs do not decide between them. Empty if no point is within the
        target.
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


class _Progress:
    """Numbers the runs of a study in its messages."""

    def __init__(self, total: int, report: Callable[[str], None]) -> None:
        self._total = total
        self._report = report
        self._number = 0

    def next(self, text: str, is_kept: bool) -> None:
        """Report that the next run begins, or that its outcome is kept from an earlier command."""
        self._number += 1
        kept = ", kept" if is_kept else ""
        self._report(f"run {self._number} of {self._total}: {text}{kept}")


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

    `target`: relative error; `full`: more seeds and a finer reference; `shares`: time steps over the shortest
    phase. `precisions` begin with f64. `report` receives progress messages. `kept`: runs of an earlier call,
    which are not repeated.

    Raises SceneError for an invalid scene, GranflowError if the run with the finest time step aborts.
    """
    task = task.with_overrides("output.energy_budget=true")
    scene = task.scene()
    phase, own_share = phase_of(scene)
    seeds = seeds_of(scene, FULL_SEEDS if full else SEEDS)
    finest = REFERENCE * (FINER if full else 1.0)
    fixed = STEP_FAMILIES[0]
    planned: list[tuple[str, StepFamily, float]] = []
    for precision in precisions:
        chosen = shares
        if precision == "f64":
            planned.append((precision, fixed, finest))
            if full:
                planned.append((precision, fixed, finest / FINER))
        else:
            chosen = [share for share in shares if share in SINGLE_SHARES]
        planned += [(precision, family, share) for family in STEP_FAMILIES for share in chosen]
    kept = kept or KeptRuns(None)
    progress = _Progress(len(planned) * len(seeds), report)
    runs: list[_Runs] = []
    for precision, family, share in planned:
        runs.append(_run(task, family, share, phase, precision, seeds, kept, progress))
        if runs[0].stopped:
            raise GranflowError(f"The run with the finest time step of this study aborts. {runs[0].stopped}")
    count = sum(group.count for group in scene.particles.values())
    return _study(runs, finest, scene.title, (own_share, own_share * phase), count, len(seeds), target)


def seeds_of(scene: Scene, count: int) -> list[Any]:
    """Consecutive seeds that start with the seed of the scene."""
    return [scene.seed + k for k in range(count)]


def _run(
    task: SceneTask,
    family: StepFamily,
    share: float,
    phase: float,
    precision: str,
    seeds: Sequence[int],
    kept: KeptRuns,
    progress: _Progress,
) -> _Runs:
    """Run all seeds and measure the restitution error.

    `share`: time step over the shortest phase; `phase` [s]. After an abort the restitution error is infinite.
    The time step of the adaptive family is that of the plan, which other limits can shorten.
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
    runs: Sequence[_Runs],
    finest: float,
    title: str,
    given: tuple[float, float],
    count: int,
    seeds: int,
    target: float,
) -> SceneStudy:
    """Combine the runs to errors, noise and spread relative to the reference run.

    `given`: share and time step [s] of the unmodified scene.
    """
    reference = next(each for each in runs if each.share == finest and each.precision == "f64")
    quantities = [
        name
        for name in common_quantities([o.values for r in runs for o in r.outcomes if not o.stopped])
        if name != ENERGY_ERROR
    ]
    scales = {name: abs(float(reference.value(name).mean())) or 1.0 for name in quantities}
    noise = {name: _noise(runs, reference, name) / scales[name] for name in quantities}
    spread = {name: float(reference.value(name).std(ddof=1)) / scales[name] for name in quantities}
    points = tuple(_point(each, reference, scales) for each in runs)
    return SceneStudy(title, points, noise, spread, *given, count, seeds, target)


def common_quantities(values: Sequence[dict[str, float]]) -> list[str]:
    """Quantities that are present in all runs, in the order of the first.

    `values`: quantity -> value of each run; at least one run.
    """
    return [name for name in values[0] if all(name in each for each in values)]


def _noise(runs: Sequence[_Runs], reference: _Runs, name: str) -> float:
    """SIGMAS standard errors of the mean difference from the reference; variance averaged over all time
    steps.

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
    values = {}
    errors = {}
    if not runs.stopped:
        values = {name: float(runs.value(name).mean()) for name in (ENERGY_ERROR, *scales)}
        errors = {ENERGY_ERROR: float(np.abs(runs.value(ENERGY_ERROR)).max())}
        errors |= {
            name: abs(values[name] - float(reference.value(name).mean())) / scales[name] for name in scales
        }
    return ScenePoint(
        runs.family,
        runs.precision,
        runs.share,
        runs.time_step,
        runs.restitution_error,
        values,
        errors,
        np.array([outcome.seconds for outcome in runs.outcomes]),
        runs.outcomes[0].simulated,
        runs.stopped,
    )


# ---------------------------------------------------------------- sentences and table

MOST_CHOICES = 3
"""Choices with equal costs that the conclusion names; the table has all."""


def scene_recommendation(study: SceneStudy) -> str:
    """Concluding sentence of the study."""
    requested = f"{100.0 * study.target:g} % error in restitution"
    if not study.cheapest:
        return (
            f"No time step of this study satisfies {requested} with all other errors within that limit or "
            "the noise."
        )
    best, *others = study.cheapest
    own = (
        f"The unmodified scene uses dt = {study.own_time_step:.3g} s (time_step_fraction "
        f"{study.own_share:.3g}). Costs are processor time."
    )
    if others:
        found = "; ".join(f"{_step(point)}, {_cost(point)}" for point in study.cheapest[:MOST_CHOICES])
        if len(study.cheapest) > MOST_CHOICES:
            found += f"; and {len(study.cheapest) - MOST_CHOICES} more of the table"
        return (
            f"For {requested}, the cheapest choices are not distinguished by their costs per simulated "
            f"second, which overlap: {found}. Take any of them, or repeat on an idle machine with more seeds "
            f"(--full). {own}"
        )
    return (
        f"For {requested} use {_step(best)}: it costs {_cost(best)} per simulated second of this "
        f"scene with {study.particle_count} particles. {own}"
    )


def _step(point: ScenePoint) -> str:
    """Time step and precision of a point, as keys of a scene."""
    step = f"dt = {point.time_step:.3g} s (time_step_fraction {point.share:g})"
    if point.family != "fixed":
        step = f"run.time_step {point.family} with time_step_fraction {point.share:g}"
    return f"{step}, precision {point.precision}"


def _cost(point: ScenePoint) -> str:
    """Median and range of the cost of a point over the seeds."""
    median, least, most = point.cost
    return f"{median:.3g} s ({least:.3g} to {most:.3g})"


def noise_sentence(study: SceneStudy) -> str:
    """Spread over the seeds, and the number of errors above the noise."""
    significant = [
        point.errors[name] > study.noise[name]
        for point in study.points
        if not point.stopped
        for name in study.quantities
    ]
    spreads = ", ".join(f"{_label(name)} {percent(spread)}" for name, spread in study.spread.items())
    return (
        f"Granular flow is chaotic. Standard deviation over {study.seed_count} seeds with the finest time "
        f"step: {spreads}. Errors of these quantities above the noise of {SIGMAS:g} standard errors: "
        f"{sum(significant)} of {len(significant)}; the others, marked n, are not significant."
    )


def _label(name: str) -> str:
    """Display name of a quantity, with its flow meter."""
    kind, _, meter = name.partition(".")
    return kind.replace("_", " ") + (f", {meter}" if meter else "")


def scene_heads(study: SceneStudy) -> tuple[str, ...]:
    """Column headings of `scene_rows`."""
    return (
        "time step",
        "precision",
        "fraction",
        "dt s",
        "restitution",
        "energy budget",
        *(_label(name) for name in study.quantities),
        "s per simulated s",
        "within target",
    )


def scene_rows(study: SceneStudy) -> list[tuple[str, ...]]:
    """Table rows, one per point: relative errors; n marks errors below the noise."""
    return [_row(study, point) for point in study.points]


def _row(study: SceneStudy, point: ScenePoint) -> tuple[str, ...]:
    """Table cells of one point."""
    first = (point.family, point.precision, f"{point.share:g}", f"{point.time_step:.3g}")
    if point.stopped:
        return (*first, *["–"] * (2 + len(study.quantities)), "–", "aborted")
    errors = []
    for name in study.quantities:
        below = point.errors[name] <= study.noise[name]
        errors.append(percent(point.errors[name]) + (" n" if below else ""))
    median, least, most = point.cost
    return (
        *first,
        percent(point.restitution_error),
        percent(point.errors[ENERGY_ERROR]),
        *errors,
        f"{median:.3g} ({least:.3g}–{most:.3g})",
        "yes" if study.within_target(point) else "no",
    )


# ---------------------------------------------------------------- files and figure

LOWEST = 1e-7
"""Smaller errors are drawn at this value."""


def write_scene(out: Path, study: SceneStudy) -> None:
    """Write CSV and page, with a figure if matplotlib is installed.

    Raises GranflowError at the end if matplotlib is not installed.
    """
    missing = write_study(
        out / "accuracy.html",
        "accuracy_scene.html",
        tables={"accuracy.csv": scene_columns(study)},
        figures={"accuracy.png": Drawing(draw_scene(study), 6.4)},
        study=study,
        recommendation=scene_recommendation(study),
        noise=noise_sentence(study),
        errors=PageTable(scene_heads(study), scene_rows(study)),
    )
    if missing:
        raise GranflowError(missing)


def scene_columns(study: SceneStudy) -> dict[str, np.ndarray]:
    """Columns of the CSV, one row per point; nan for aborted runs.

    Values in SI units, errors, noise and spread relative, costs in processor time per simulated time [s/s].
    """
    rows = []
    for point in study.points:
        row: dict[str, Any] = {
            name: getattr(point, name)
            for name in ("family", "precision", "share", "time_step", "restitution_error")
        }
        row["energy_error"] = point.errors.get(ENERGY_ERROR, np.nan)
        for name in study.quantities:
            row |= {name: point.values.get(name, np.nan), f"{name}_error": point.errors.get(name, np.nan)}
            row |= {f"{name}_noise": study.noise[name], f"{name}_spread": study.spread[name]}
        row |= dict(zip(("seconds_median", "seconds_min", "seconds_max"), point.cost, strict=True))
        rows.append(row | {"seeds": study.seed_count, "stopped": point.stopped})
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def draw_scene(study: SceneStudy) -> Callable[[Any], None]:
    """Draw every error against processor time, for all precisions."""

    def draw(figure: Any) -> None:
        from matplotlib.ticker import LogLocator

        above, below = stacked_panels(figure, 2, sharex=True, sharey=True)
        for name, color in zip(("restitution", ENERGY_ERROR, *study.quantities), COLORS, strict=False):
            for precision in LINE_STYLES:
                _draw_errors(below if name in study.quantities else above, study, name, precision, color)
        loglog(above, study.target, title="(a) restitution and energy budget")
        loglog(below, study.target, title="(b) bed quantities and their noise")
        below.set_xlabel("processor time (s per simulated s); filled: adaptive time step")
        for axes in (above, below):
            axes.set_ylabel("relative error")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter("")
            axes.legend(loc="best")

    return draw


def _draw_errors(axes: Any, study: SceneStudy, name: str, precision: str, color: str) -> None:
    """Plot one error of one precision against processor time; thin line: noise in double precision.

    Points with fixed and with adaptive time step form two lines.
    """
    style, marker = LINE_STYLES[precision]
    label = f"{'energy budget' if name == ENERGY_ERROR else _label(name)}, {precision}"
    line = {"linestyle": style, "marker": marker, "color": color, "markersize": 3.5, "linewidth": 0.9}
    for family in dict.fromkeys(point.family for point in study.points):
        points = [p for p in study.points if (p.precision, p.family) == (precision, family) and not p.stopped]
        errors = [p.restitution_error if name == "restitution" else p.errors[name] for p in points]
        shown = [
            (p.cost[0], max(error, LOWEST)) for p, error in zip(points, errors, strict=True) if error > 0.0
        ]
        if shown:
            is_fixed = family == "fixed"
            face = {"markerfacecolor": "white"} if is_fixed else {}
            axes.plot(*zip(*sorted(shown), strict=True), label=label if is_fixed else None, **line, **face)
    if precision == "f64" and name in study.quantities:
        axes.axhline(study.noise[name], color=color, linewidth=0.6, alpha=0.6)
