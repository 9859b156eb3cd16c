"""Run of one variant to its end or abort, with all compared quantities.

The output of each run is that of `granflow run`, in a separate directory, and a record with the other quantities: a
comparison that was stopped continues with the missing runs.
"""

import hashlib
import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from granflow import (
    GranflowError,
    RunError,
    Scene,
    SceneError,
    Simulation,
    on_interval,
    read_run,
    steady_flow,
)
from granflow.contact import theory
from granflow.io.atomic_files import replacing
from granflow.io.regular_files import file_digest
from granflow.load import copied_scene
from granflow.studies.compare.bed_statistics import FORCE_EDGES, BedHeights, ContactBursts, ForceHistogram
from granflow.studies.compare.contact_durations import FollowedContacts, bursts, median_of, survival
from granflow.studies.compare.variants import LawVariant, automatic_plan
from granflow.studies.run_processes.checked import run_identity

SERIES = "timeseries.csv"

RECORD = "compare_run.npz"
"""File in the directory of a run with what the comparison needs of it, apart from timeseries.csv."""

BURSTS = 8
"""Number of bursts of contact samples in a run."""

SAMPLES = 48
"""Samples of each burst."""

SAMPLES_PER_CONTACT = 8
"""Samples per duration of an elastic Hertz contact at the reference velocity."""


@dataclass(frozen=True)
class VariantRun:
    """Result of one variant.

    `columns`: columns of timeseries.csv by name without unit, (rows,) each; `time`: simulated time [s]; `time_step` [s]
    and `step_limit`: time step of the plan, and what limits it.
    """

    variant: LawVariant
    time_step: float
    step_limit: str
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
        simulation.plan.time_step,
        simulation.plan.step.limited_by,
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


def identity_of_run(variant: LawVariant, arch: str, reference_velocity: float, until: float | None) -> str:
    """Hash of all that determines a run of a variant and its samples; arguments as for `run_variant`."""
    assert variant.scene is not None
    samples = (reference_velocity, until, BURSTS, SAMPLES, SAMPLES_PER_CONTACT, FORCE_EDGES.tolist())
    return hashlib.sha256(f"{run_identity(variant.scene, arch)} {samples}".encode()).hexdigest()


def record_start(out: Path, identity: str) -> None:
    """Record that the run with this identity begins in a directory, which is created."""
    out.mkdir(parents=True, exist_ok=True)
    _write_record(out, {"identity": identity})


def record_run(out: Path, identity: str, run: VariantRun) -> None:
    """Record a run that has ended."""
    numbers = {
        "identity": identity, "series": file_digest(out / SERIES), "time_step": run.time_step,
        "step_limit": run.step_limit,
        "step_count": run.step_count, "time": run.time, "seconds": run.seconds,
        "compile_seconds": run.compile_seconds, "stopped": run.stopped, "typical_speed": run.typical_speed,
        "stages": list(run.forces.counts),
    }  # fmt: skip
    observed, has_ended = run.followed.arrays()
    counts = {f"force_counts_{k}": each for k, each in enumerate(run.forces.counts.values())}
    _write_record(out, numbers, heights=run.heights, observed=observed, has_ended=has_ended, **counts)


def _write_record(out: Path, numbers: dict[str, Any], **arrays: np.ndarray) -> None:
    """Write numbers and arrays atomically."""
    content: dict[str, Any] = {"numbers": np.array(json.dumps(numbers)), **arrays}
    with replacing(out / RECORD) as temporary, temporary.open("wb") as file:
        np.savez(file, **content)


def has_begun(variant: LawVariant, out: Path, identity: str) -> bool:
    """Whether the results in a directory are those of a run with this identity that was stopped."""
    assert variant.scene is not None
    found = _record(out)
    try:
        scene = (out / "scene_as_run.yaml").read_text(encoding="utf-8")
    except OSError:
        scene = ""
    return (
        found is not None
        and found[0] == {"identity": identity}
        and scene in ("", copied_scene(variant.scene).to_yaml())
    )


def kept_run(variant: LawVariant, out: Path, identity: str) -> VariantRun | None:
    """The run with this identity that has ended in a directory; None without, or if its files have changed."""
    found = _record(out)
    if found is None or found[0].get("identity") != identity or found[0].get("series") != file_digest(out / SERIES):
        return None
    numbers, arrays = found
    forces, followed = ForceHistogram(), FollowedContacts([arrays["observed"]], [arrays["has_ended"]])
    forces.counts = {stage: arrays[f"force_counts_{k}"] for k, stage in enumerate(numbers["stages"])}
    keys = ("time_step", "step_limit", "step_count", "time", "seconds", "compile_seconds", "stopped", "typical_speed")
    columns = dict(read_run(out).timeseries_arrays)
    return VariantRun(
        variant, **{key: numbers[key] for key in keys}, columns=columns, heights=arrays["heights"], forces=forces,
        followed=followed,
    )  # fmt: skip


def _record(out: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Numbers and arrays of the record in a directory; None without one, or if it is damaged."""
    try:
        with np.load(out / RECORD, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        numbers = json.loads(str(arrays.pop("numbers")))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return (numbers, arrays) if isinstance(numbers, dict) else None


def hertz_duration(scene: Scene, velocity: float) -> float:
    """Duration [s] of the shortest elastic collision in the scene at an approach velocity [m/s] (Eq. 13, e = 1)."""
    durations = []
    for pair_case in automatic_plan(scene).pair_cases:
        k = theory.hertz_stiffness(pair_case.pair.modulus_eff, pair_case.radius_eff)
        durations.append(float(theory.duration(1.0, k, pair_case.mass_eff, velocity)))
    return min(durations)


def run_all(
    variants: Sequence[LawVariant], directories: Sequence[Path], arch: str, reference_velocity: float,
    until: float | None, report: Callable[[str], None], prepare: Callable[[Path], None], repeat: bool,
) -> tuple[list[VariantRun], dict[str, str]]:  # fmt: skip
    """Run every variant, each into the directory at the same position; runs of an earlier call are kept.

    `prepare`: called before the first run with each directory that does not contain the run of its variant, which may
    be a stopped one; it raises an error for other results. `repeat`: no run is kept.
    Returns the runs, and the reasons of rejected variants by title. Raises GranflowError if no variant can run.
    """
    ran, refused = [], {each.title: each.refused for each in variants if each.scene is None}
    planned = []
    for variant, out in zip(variants, directories, strict=True):
        if variant.scene is None:
            continue
        identity = identity_of_run(variant, arch, reference_velocity, until)
        kept = None if repeat else kept_run(variant, out, identity)
        if kept is None and (repeat or not has_begun(variant, out, identity)):
            prepare(out)
        planned.append((variant, out, identity, kept))
    for number, (variant, out, identity, kept) in enumerate(planned, 1):
        report(f"run {number} of {len(planned)}: {variant.title}{'' if kept is None else ', kept'}")
        if kept is not None:
            ran.append(kept)
            continue
        record_start(out, identity)
        done = run_variant(variant, out, arch, reference_velocity, until)
        if isinstance(done, VariantRun):
            record_run(out, identity, done)
            ran.append(done)
        else:
            refused[variant.title] = done
    if not ran:
        raise GranflowError(
            "No contact model can run this scene: " + " ".join(f"{n}: {why}" for n, why in refused.items())
        )
    return ran, refused
