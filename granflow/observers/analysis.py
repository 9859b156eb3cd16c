"""Metrics and fields of a scene for a series of snapshots, such as those read from the files of a run."""

from collections.abc import Iterable
from pathlib import Path

from granflow.arguments import path_of, refuse_other, shown
from granflow.errors import GranflowError
from granflow.fields import METRIC_QUANTITIES
from granflow.io.tables import write_table
from granflow.load import Scene
from granflow.observers.build import field_frames
from granflow.observers.frames import FieldFrames
from granflow.observers.metrics import MetricMeter, metric_meters
from granflow.observers.observer import CONTACTS
from granflow.plan.build import plan_for
from granflow.snapshot import Snapshot

MetricRow = dict[str, float | str]
"""Row of metrics.csv by column name."""


def analyze_snapshots(
    scene: Scene, snapshots: Iterable[Snapshot], out: Path, source: str = ""
) -> list[MetricRow]:
    """Compute the metrics of `scene` for each snapshot; write its fields and `metrics.csv` to `out`.

    A row contains the time [s], the stage and each value under its column name with the unit. `source` names
    the origin of the snapshots in messages.

        run = granflow.read_run("out/hopper")
        snapshots = [run.snapshot(index) for index in range(len(run.frames))]
        rows = granflow.analyze_snapshots(run.scene, snapshots, Path("out/analysis"))

    Raises GranflowError if the scene requests nothing, or if snapshots lack contacts.
    """
    plan = plan_for(scene)
    out = path_of("out", out)
    if isinstance(snapshots, Snapshot) or not isinstance(snapshots, Iterable):
        raise GranflowError(
            f"snapshots is {shown(snapshots)}, but must be a list of snapshots of granflow.read_run."
        )
    meters = metric_meters(plan)
    fields = [field_frames(plan, name, spec, out) for name, spec in scene.output.fields.items()]
    if not meters and not fields:
        raise GranflowError(
            "Nothing to analyze: the scene has neither output.metrics nor output.fields. Add one, such as "
            "--set 'output.metrics.bed={kind: coordination}'."
        )
    readers: list[MetricMeter | FieldFrames] = [*meters.values(), *fields]
    rows = []
    for snapshot in snapshots:
        refuse_other("a snapshot", snapshot, Snapshot, "one of granflow.read_run or Simulation.snapshot")
        if snapshot.contacts is None and any(CONTACTS in each.wants for each in readers):
            raise GranflowError(
                f"{source} has no frames of contacts, which fabric and contact stress require: run the scene "
                "with output.contacts: true, or omit these quantities (quantities: [density, velocity])."
            )
        for frames in fields:
            frames.observe(snapshot)
        rows.append(_row(snapshot, meters))
    for frames in fields:
        frames.finish()
    if meters:
        names = rows[0] if rows else ["time [s]"]
        write_table(out / "metrics.csv", names, (row.values() for row in rows))
    return rows


def _row(snapshot: Snapshot, meters: dict[str, MetricMeter]) -> MetricRow:
    """Row of metrics.csv: time [s], stage, and the readings of all metrics for a snapshot."""
    row: MetricRow = {"time [s]": snapshot.time, "stage": snapshot.stage}
    for name, meter in meters.items():
        meter.update(snapshot)
        for quantity, number in meter.readings().items():
            row[METRIC_QUANTITIES[quantity].label_of(name)] = number
    return row
