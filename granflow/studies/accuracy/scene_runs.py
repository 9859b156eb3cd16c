"""Runs of one scene with several time steps and seeds: values and processor time."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from granflow import RunError, Scene, SceneError, Simulation, Snapshot, load_scene, on_interval, plan_for
from granflow.io.atomic_files import write_text
from granflow.studies.restitution import QUICK_VELOCITIES
from granflow.studies.restitution import measure as measure_restitution
from granflow.studies.run_processes.checked import run_identity
from granflow.studies.run_processes.outcome import read_json

MAX_PARTICLES = 1000
"""Particle count to which a scene is reduced, unless all particles are requested."""
SAMPLES = 200
"""Number of samples for the means of center of mass and coordination number."""


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


@dataclass(frozen=True)
class RunOutcome:
    """Result of a run, or the reason of its abort (`stopped`).

    `values` by quantity; `seconds`: processor time of the run without compilation [s], which other programs on the
    machine change less than the wall time; `simulated` time [s].
    """

    values: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    step_count: float = 0.0
    simulated: float = 0.0
    stopped: str = ""


def reduced_counts(scene: Scene, most: int = MAX_PARTICLES) -> list[str]:
    """Overrides that reduce the groups with an explicit `count` to at most `most` particles, in proportion.

    Each group keeps at least one particle. Empty if the scene is small enough.
    """
    counted = {
        name: group.count for name, group in scene.particles.items() if scene.is_given("particles", name, "count")
    }
    total = sum(counted.values())
    if total <= most:
        return []
    return [f"particles.{name}.count={max(round(count * most / total), 1)}" for name, count in counted.items()]


def phase_of(scene: Scene) -> tuple[float, float]:
    """Shortest phase of any contact [s], and the time step of the scene over this phase.

    At the maximum impact velocity of the plan.
    """
    plan = plan_for(scene)
    phase = min(plan.shortest_phase(pair_case, plan.velocity_max) for pair_case in plan.pair_cases)
    return phase, plan.time_step / phase


class _RunMeans:
    """Means over the run of center height [m] and coordination number.

    The height is that of the center of mass above the bottom of the domain, opposite to gravity (z without gravity).
    """

    def __init__(self, scene: Scene) -> None:
        gravity = np.array(scene.gravity)
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


class KeptRuns:
    """Outcomes of the runs of a study in a file, so that a study that was stopped continues with the missing runs.

    `path`: JSON file; None: in memory only. The key of an outcome is the identity of its run: resolved scene, contents
    of its inputs, version of granflow, end time. A damaged file, or a damaged outcome, counts as missing.
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


def restitution_error(task: SceneTask) -> float:
    """Largest relative restitution error of any pair of materials, for velocities from a tenth of the largest.

    Measured by head-on collisions at the time step and the precision of the task.
    """
    rows, _ = measure_restitution(task.scene())
    fastest = max(row.velocity for row in rows)
    slowest = min(QUICK_VELOCITIES) * (1.0 - 1e-9) * fastest
    return max(abs(row.difference) for row in rows if row.velocity >= slowest)


def seeds_of(scene: Scene, count: int) -> list[Any]:
    """Consecutive seeds that start with the seed of the scene."""
    return [scene.seed + k for k in range(count)]


def common_quantities(values: Sequence[dict[str, float]]) -> list[str]:
    """Quantities that are present in all runs, in the order of the first.

    `values`: quantity -> value of each run; at least one run.
    """
    return [name for name in values[0] if all(name in each for each in values)]
