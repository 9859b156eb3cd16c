"""Metrics and fields of a finished run, computed from its frames."""

import csv
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError
from granflow.fields import CONTACT_QUANTITIES, METRIC_QUANTITIES, PARTICLE_QUANTITIES
from granflow.io.regular_files import read_regular_text
from granflow.load import Scene
from granflow.observers.base import CONTACTS
from granflow.observers.build import field_frames
from granflow.observers.coarse_graining.field_frames import FieldFrames
from granflow.observers.metrics.build import metric_meters
from granflow.observers.metrics.meter import MetricMeter
from granflow.plan.build import plan_for
from granflow.snapshot import Snapshot
from granflow.studies.render.frames import Frame, frames_of, is_empty, read_mesh, read_particles

MetricRow = dict[str, float | str]
"""Row of metrics.csv by column name."""


def analyze(directory: Path, scene: Scene, out: Path) -> list[MetricRow]:
    """Compute the metrics of `scene` for each frame of a run; write its fields and `metrics.csv` to `out`.

    `scene` is that of the run; its `output.metrics` and `output.fields` may differ. A row contains the time [s], the
    stage and each value under its column name with the unit. Frames without particles are skipped.

    Raises GranflowError if the scene requests nothing, if frames lack contacts, or if files cannot be read.
    """
    plan = plan_for(scene)
    meters = metric_meters(plan)
    fields = [field_frames(plan, name, spec, out) for name, spec in scene.output.fields.items()]
    if not meters and not fields:
        raise GranflowError(
            "Nothing to analyze: the scene has neither output.metrics nor output.fields. Add one, such as "
            "--set 'output.metrics.bed={kind: coordination}'."
        )
    rows = []
    for snapshot in snapshots_of(directory, scene):
        _refuse_without_contacts(directory, snapshot, [*meters.values(), *fields])
        for frames in fields:
            frames.observe(snapshot)
        rows.append(_row(snapshot, meters))
    for frames in fields:
        frames.finish()
    if meters:
        _write(out / "metrics.csv", rows)
    return rows


def snapshots_of(directory: Path, scene: Scene) -> Iterator[Snapshot]:
    """Snapshots from the frames of a run, with contacts if they were written; masses [kg] follow from the scene.

    In order of time; without walls and totals, and with step number 0.
    """
    stage_at = _stages(directory / "timeseries.csv", scene)
    density = np.array([material.density for material in scene.materials.values()])
    for frame in frames_of(directory):
        if is_empty(frame.particles):
            continue
        particles = read_particles(frame)
        arrays = {name: particles.arrays[name] for name in PARTICLE_QUANTITIES if name in particles.arrays}
        radius = particles.radius.astype(float)
        mass = 4.0 / 3.0 * np.pi * radius**3 * density[arrays["material"]]
        arrays |= {"position": particles.position, "radius": radius, "mass": mass}
        yield Snapshot(frame.time, 0, stage_at(frame.time), arrays, _contacts(frame), {}, {})


def _contacts(frame: Frame) -> dict[str, np.ndarray] | None:
    """Contacts of a frame as in a Snapshot, or None if the run did not write them."""
    if frame.contacts is None:
        return None
    mesh = read_mesh(frame.contacts)
    lines = mesh.cells_dict.get("line", np.zeros((0, 2), np.int64))
    found = {name: parts[0] for name, parts in mesh.cell_data.items() if name in CONTACT_QUANTITIES}
    empty_contacts = {"wall": np.zeros(0, np.int32), "force": np.zeros((0, 3))}
    return empty_contacts | found | {"position_i": mesh.points[lines[:, 0]], "position_j": mesh.points[lines[:, 1]]}


def _stages(path: Path, scene: Scene) -> "_StageAt":
    """Stage as a function of time [s]: that of the last row of the time series at or before it.

    Without a time series, the first stage. Raises GranflowError if the file cannot be read.
    """
    if not path.exists():
        return _StageAt([0.0], [scene.schedule[0].name])
    try:
        lines = read_regular_text(path).splitlines()
        rows = [(float(row["time [s]"]), row["stage"]) for row in csv.DictReader(lines)]
    except (csv.Error, ValueError, TypeError, KeyError) as error:
        raise GranflowError(f"{path} cannot be read ({error}): remove it, or run again.") from None
    return _StageAt([time for time, _ in rows], [stage for _, stage in rows])


class _StageAt:
    """Names of stages as a function of time."""

    def __init__(self, times: list[float], names: list[str]) -> None:
        self._times, self._names = times, names

    def __call__(self, time: float) -> str:
        return self._names[max(bisect_right(self._times, time) - 1, 0)]


def _refuse_without_contacts(directory: Path, snapshot: Snapshot, readers: list[MetricMeter | FieldFrames]) -> None:
    """Raise GranflowError if a metric or field requires contacts that the run did not write."""
    if snapshot.contacts is None and any(CONTACTS in each.wants for each in readers):
        raise GranflowError(
            f"{directory} has no frames of contacts, which fabric and contact stress require: run the scene with "
            "output.contacts: true, or omit these quantities (quantities: [density, velocity])."
        )


def _row(snapshot: Snapshot, meters: dict[str, MetricMeter]) -> MetricRow:
    """Row of metrics.csv: time [s], stage, and the readings of all metrics for a snapshot."""
    row: MetricRow = {"time [s]": snapshot.time, "stage": snapshot.stage}
    for name, meter in meters.items():
        meter.update(snapshot)
        row |= {METRIC_QUANTITIES[each].label_of(name): number for each, number in meter.readings().items()}
    return row


def _write(path: Path, rows: list[MetricRow]) -> None:
    """Write rows as CSV; the directory is created if necessary."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["time [s]"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
