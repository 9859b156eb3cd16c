"""Run of one variant to its end or abort, with all compared quantities.

The output of each run is that of `granflow run`, in a separate directory.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from granflow import (
    GranflowError,
    Plan,
    RunError,
    Scene,
    SceneError,
    Simulation,
    on_interval,
    read_run,
    steady_flow,
)
from granflow.contact import theory
from granflow.studies.compare.bed_statistics import BedHeights, ContactBursts, ForceHistogram
from granflow.studies.compare.contact_durations import FollowedContacts, bursts, median_of, survival
from granflow.studies.compare.variants import LawVariant, automatic_plan

BURSTS = 8
"""Number of bursts of contact samples in a run."""

SAMPLES = 48
"""Samples of each burst."""

SAMPLES_PER_CONTACT = 8
"""Samples per duration of an elastic Hertz contact at the reference velocity."""


@dataclass(frozen=True)
class VariantRun:
    """Result of one variant.

    `columns`: columns of timeseries.csv by name without unit, (rows,) each; `time`: simulated time [s].
    """

    variant: LawVariant
    plan: Plan
    step_count: int
    time: float
    seconds: float
    """Wall time of neighbor-list rebuilds and steps [s], without compilation and output."""
    compile_seconds: float
    stopped: str
    """Message of the abort; empty for a complete run."""
    columns: dict[str, np.ndarray]
    heights: np.ndarray
    """(rows, 3): time [s], height of the center of mass and of the surface [m]."""
    typical_speed: float
    """Upper end of the color scale [m/s]."""
    forces: ForceHistogram
    followed: FollowedContacts

    @property
    def meters(self) -> list[str]:
        """Names of the flow meters."""
        return [name.partition(".")[2] for name in self.columns if name.startswith("flow_mass.")]

    def mass_flow(self, meter: str) -> float:
        """Steady mass flow rate [kg/s] through a meter, as reported by `granflow run` (`flow_meters.steady_flow`)."""
        columns = (self.columns[name].tolist() for name in ("time", "stage", f"flow_mass.{meter}"))
        return steady_flow(list(zip(*columns, strict=True)))

    @cached_property
    def duration_survival(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and share of contacts that last longer, (n,) each."""
        return survival(*self.followed.arrays())

    @property
    def median_duration(self) -> float:
        """Median contact duration [s]."""
        return median_of(*self.duration_survival)

    def at_end_of(self, stage: str) -> int | None:
        """Last row of a stage; None if the run did not complete the stage."""
        rows = np.flatnonzero(self.columns["stage"] == stage)
        if not len(rows) or (self.stopped and rows[-1] + 1 == len(self.columns["stage"])):
            return None
        return int(rows[-1])


def run_variant(
    variant: LawVariant, out: Path, arch: str, reference_velocity: float, until: float | None
) -> VariantRun | str:
    """Run a variant with output into `out`; returns the reason if its contact model cannot run the scene.

    `arch`: backend; `reference_velocity` [m/s] determines the interval of contact samples; `until` [s]: end of the run,
    or None. An aborted run is returned with the message in `stopped`.
    """
    assert variant.scene is not None
    scene = variant.scene
    heights, forces = BedHeights.of(scene), ForceHistogram()
    end, output = min(scene.longest_duration, until or np.inf), scene.output
    try:
        spacing = hertz_duration(scene, reference_velocity) / SAMPLES_PER_CONTACT
        bursts_observer = ContactBursts(list(bursts(end, BURSTS, SAMPLES, spacing)), spacing)
        observers = [
            on_interval(output.timeseries_interval, heights.update),
            on_interval(output.interval, forces.update, ("contacts",)),
            bursts_observer,
        ]
        simulation = Simulation(scene, arch=arch, out=out, observers=observers, overwrite=True)  # type: ignore[arg-type]
    except SceneError as error:
        return "; ".join(error.problems)
    stopped = ""
    try:
        simulation.run(until, within_stages=True)
    except RunError as error:
        stopped = str(error)
    finally:
        simulation.free()
    timing = simulation.engine.timing
    return VariantRun(
        variant,
        simulation.plan,
        simulation.engine.step_count,
        simulation.time,
        timing.neighbor_list + timing.advance,
        timing.compile,
        stopped,
        dict(read_run(out).timeseries_arrays),
        np.array(heights.rows),
        heights.typical_speed,
        forces,
        bursts_observer.followed,
    )


def hertz_duration(scene: Scene, velocity: float) -> float:
    """Duration [s] of the shortest elastic collision in the scene at an approach velocity [m/s] (Eq. 13, e = 1)."""
    durations = []
    for pair_case in automatic_plan(scene).pair_cases:
        k = theory.hertz_stiffness(pair_case.pair.modulus_eff, pair_case.radius_eff)
        durations.append(float(theory.duration(1.0, k, pair_case.mass_eff, velocity)))
    return min(durations)


def run_all(
    variants: Sequence[LawVariant], directories: Sequence[Path], arch: str, reference_velocity: float,
    until: float | None, report: Callable[[str], None],
) -> tuple[list[VariantRun], dict[str, str]]:  # fmt: skip
    """Run every variant, each into the directory at the same position.

    Returns the runs, and the reasons of rejected variants by title. Raises GranflowError if no variant can run.
    """
    ran, refused = [], {each.title: each.refused for each in variants if each.scene is None}
    for variant, out in zip(variants, directories, strict=True):
        if variant.scene is None:
            continue
        report(f"running with {variant.title}")
        done = run_variant(variant, out, arch, reference_velocity, until)
        if isinstance(done, VariantRun):
            ran.append(done)
        else:
            refused[variant.title] = done
    if not ran:
        raise GranflowError(
            "No contact model can run this scene: " + " ".join(f"{n}: {why}" for n, why in refused.items())
        )
    return ran, refused
