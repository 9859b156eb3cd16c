"""Runs of one scene with several time steps and seeds: values and wall time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from granflow import RunError, Scene, SceneError, Simulation, Snapshot, load_scene, on_interval, plan_for
from granflow.studies.restitution import QUICK_VELOCITIES
from granflow.studies.restitution import measure as measure_restitution

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

    `values` by quantity; `seconds`: wall time of neighbor list, forces and integration [s]; `simulated` time [s].
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
            result = simulation.run(until=task.until, within_stages=True)
    except SceneError as error:
        return RunOutcome(stopped=str(error).partition(": ")[2])  # the prefix names an override of this study
    except RunError as error:
        return RunOutcome(stopped=str(error))
    numbers = result.numbers
    flows = {f"mass_flow.{name}": readings["mass_flow"] for name, readings in result.flow_meters.items()}
    values = {"energy_error": numbers["energy_error"], **means.values(), **flows}
    seconds = numbers["step_count"] / numbers["steps_per_second"]
    return RunOutcome(values, seconds, numbers["step_count"], numbers["simulated_time"])


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
