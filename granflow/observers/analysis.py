"""Metrics and fields of a scene for a series of snapshots, such as those read from the files of a run."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from granflow.errors import GranflowError
from granflow.fields import METRIC_QUANTITIES
from granflow.observers.base import CONTACTS
from granflow.observers.build import field_frames
from granflow.observers.coarse_graining.field_frames import FieldFrames
from granflow.observers.metrics.build import metric_meters
from granflow.observers.metrics.meter import MetricMeter
from granflow.scene.schema.scene import Scene
from granflow.snapshot import Snapshot

MetricRow = dict[str, float | str]
"""Row of metrics.csv by column name."""


def analyze_snapshots(scene: Scene, snapshots: Iterable[Snapshot], out: Path, source: str = "") -> list[MetricRow]:
    """Compute the metrics of `scene` for each snapshot; write its fields and `metrics.csv` to `out`.

    A row contains the time [s], the stage and each value under its column name with the unit. `source` names the origin
    of the snapshots in messages.

    Raises GranflowError if the scene requests nothing, or if snapshots lack contacts.
    """
    meters = metric_meters(scene)
    fields = [field_frames(scene, name, spec, out) for name, spec in scene.output.fields.items()]
    if not meters and not fields:
        raise GranflowError(
            "Nothing to analyze: the scene has neither output.metrics nor output.fields. Add one, such as "
            "--set 'output.metrics.bed={kind: coordination}'."
        )
    readers: list[MetricMeter | FieldFrames] = [*meters.values(), *fields]
    rows = []
    for snapshot in snapshots:
        if snapshot.contacts is None and any(CONTACTS in each.wants for each in readers):
            raise GranflowError(
                f"{source} has no frames of contacts, which fabric and contact stress require: run the scene with "
                "output.contacts: true, or omit these quantities (quantities: [density, velocity])."
            )
        for frames in fields:
            frames.observe(snapshot)
        rows.append(_row(snapshot, meters))
    for frames in fields:
        frames.finish()
    if meters:
        _write(out / "metrics.csv", rows)
    return rows


def _row(snapshot: Snapshot, meters: dict[str, MetricMeter]) -> MetricRow:
    """Row of metrics.csv: time [s], stage, and the readings of all metrics for a snapshot."""
    row: MetricRow = {"time [s]": snapshot.time, "stage": snapshot.stage}
    for name, meter in meters.items():
        meter.update(snapshot)
        row |= {METRIC_QUANTITIES[each].label_of(name): number for each, number in meter.readings().items()}
    return row


def _write(path: Path, rows: Sequence[MetricRow]) -> None:
    """Write rows as CSV; the directory is created if necessary."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["time [s]"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
