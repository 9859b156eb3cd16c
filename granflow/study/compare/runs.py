"""One variant run to its end, or to the guard that stops it, with everything that is compared."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError, RunError, SceneError
from granflow.laws import theory
from granflow.observe import every
from granflow.observe.build import stage_durations
from granflow.observe.meters import steady_flow
from granflow.plan import Plan
from granflow.plan.plan import meetings_of
from granflow.scene import Scene
from granflow.simulation import Simulation
from granflow.study.compare.durations import Followed, bursts, median_of, survival
from granflow.study.compare.variants import Variant
from granflow.study.compare.watch import Bursts, Forces, Heights

BURSTS = 8
LOOKS = 48
LOOKS_PER_CONTACT = 8
"""Looks in a burst, and in the duration of a Hertz contact at the reference velocity."""


@dataclass(frozen=True)
class Run:
    """What one variant did. `columns`: timeseries.csv by name without units, (rows,) each."""

    variant: Variant
    plan: Plan
    step_count: int
    time: float
    seconds: float
    """Wall clock of search and steps, without compilation and output."""
    compile_seconds: float
    stopped: str
    """What the guard said that ended the run early; empty if none did."""
    columns: dict[str, np.ndarray]
    heights: np.ndarray
    """(rows, 3): time [s], height of the centre of mass and of the surface [m]."""
    fast: float
    """Speed [m/s] that a colour scale should reach."""
    forces: Forces
    followed: Followed

    @property
    def meters(self) -> list[str]:
        """Names of the flow meters."""
        return [name.partition(".")[2] for name in self.columns if name.startswith("flow_mass.")]

    def mass_flow(self, meter: str) -> float:
        """Steady mass flow [kg/s] through a meter, as `granflow run` gives it."""
        columns = (self.columns[name].tolist() for name in ("time", "stage", f"flow_mass.{meter}"))
        return steady_flow(list(zip(*columns, strict=True)))

    @cached_property
    def lasting(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and the share of contacts that last longer."""
        return survival(*self.followed.arrays())

    @property
    def median_duration(self) -> float:
        """Time [s] that half of the contacts outlast."""
        return median_of(*self.lasting)

    def at_end_of(self, stage: str) -> int | None:
        """Row of the last moment of a stage, None where the run did not finish it."""
        rows = np.flatnonzero(self.columns["stage"] == stage)
        if not len(rows) or (self.stopped and rows[-1] + 1 == len(self.columns["stage"])):
            return None
        return int(rows[-1])


def run_variant(variant: Variant, out: Path, arch: str, reference_velocity: float, until: float | None) -> Run | str:
    """Run a variant into a directory; the reason in words where its law cannot serve the scene."""
    assert variant.scene is not None
    scene = variant.scene
    heights, forces = Heights.of(scene), Forces()
    end = min(sum(longest for _, longest in stage_durations(scene)), until or np.inf)
    spacing = hertz_duration(scene, reference_velocity) / LOOKS_PER_CONTACT
    looks = Bursts(list(bursts(end, BURSTS, LOOKS, spacing)), spacing)
    output = scene.output
    watching = [
        every(output.timeseries_interval, heights.look),
        every(output.interval, forces.look, ("contacts",)),
        looks,
    ]
    try:
        simulation = Simulation(scene, arch=arch, out=out, observers=watching)  # type: ignore[arg-type]
    except SceneError as error:
        return "; ".join(error.problems)
    stopped = ""
    try:
        simulation.run(until)
    except RunError as error:
        stopped = str(error)
    finally:
        simulation.free()
    timing = simulation.engine.timing
    return Run(
        variant, simulation.plan, simulation.engine.step_count, simulation.time, timing.search + timing.advance,
        timing.compile, stopped, read_time_series(out / "timeseries.csv"), np.array(heights.rows), heights.fast,
        forces, looks.followed,
    )  # fmt: skip


def hertz_duration(scene: Scene, velocity: float) -> float:
    """Duration [s] of the shortest elastic collision that the scene can have at an approach velocity (Eq. 13)."""
    durations = []
    for meeting in meetings_of(scene):
        k = theory.hertz_stiffness(meeting.pair.modulus_eff, meeting.radius_eff)
        durations.append(float(theory.duration(1.0, k, meeting.mass_eff, velocity)))
    return min(durations)


def read_time_series(path: Path) -> dict[str, np.ndarray]:
    """Columns of a timeseries.csv by their names without units; `stage` as words, all others as numbers."""
    with path.open(newline="", encoding="utf-8") as file:
        heads, *rows = csv.reader(file)
    found = {}
    for head, cells in zip(heads, zip(*rows, strict=True), strict=True):
        name = head.partition(" [")[0]
        found[name] = np.array(cells) if name == "stage" else np.array([float(cell or "nan") for cell in cells])
    return found


def run_all(
    variants: Sequence[Variant], directories: Sequence[Path], arch: str, reference_velocity: float,
    until: float | None, say: Callable[[str], None],
) -> tuple[list[Run], dict[str, str]]:  # fmt: skip
    """Run every variant; what ran, and why others could not. Raises GranflowError where none could."""
    ran, refused = [], {each.title: each.refused for each in variants if each.scene is None}
    for variant, out in zip(variants, directories, strict=True):
        if variant.scene is None:
            continue
        say(f"running with {variant.title}")
        done = run_variant(variant, out, arch, reference_velocity, until)
        if isinstance(done, Run):
            ran.append(done)
        else:
            refused[variant.title] = done
    if not ran:
        raise GranflowError("No law can run this scene: " + " ".join(f"{n}: {why}" for n, why in refused.items()))
    return ran, refused
