"""Builds the observers of the `output:` block of a scene, for a run or for a series of snapshots."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granflow.arguments import path_of, refuse_other, shown
from granflow.errors import GranflowError
from granflow.fields import FIELD_QUANTITIES, METRIC_QUANTITIES
from granflow.geometry.coarse_grid import GaussianKernel
from granflow.geometry.periodic_box import AXES
from granflow.io.files import BackgroundWriter
from granflow.io.tables import write_table
from granflow.load import Scene
from granflow.observers.frames import ContactFrames, FieldFrames, ParticleFrames, WallFrames
from granflow.observers.meters import FlowCounter, WallForceMeter
from granflow.observers.metrics import MetricMeter, metric_meters
from granflow.observers.observer import Observer
from granflow.observers.passages import PassageTable, ResidenceTimes
from granflow.observers.progress import ProgressDisplay
from granflow.observers.timeseries import CollisionEnergies, TimeSeries
from granflow.plan.build import plan_for
from granflow.plan.plan import Plan
from granflow.snapshot import CONTACTS, Snapshot

if TYPE_CHECKING:
    from granflow.engine.engine import Engine


def observers_for(
    plan: Plan,
    out_dir: Path | None,
    progress: bool = False,
    writer: BackgroundWriter | None = None,
    rank_engine: "Engine | None" = None,
) -> list[Observer]:
    """Return the observers of the output block, and the progress display if `progress`.

    out_dir:      directory of the files; None: only the time series, without a file, if it has meters
    writer:       writes the frames; at once by default
    rank_engine:  engine of MPI ranks, which can write their particles; None without MPI

    Order: time series, particle frames, contact frames, wall frames, one per block of `output.fields`,
    collisions.
    """
    output = plan.scene.output
    observers: list[Observer] = []
    has_conditions = any(stage.until for stage in plan.stages)
    if (
        out_dir is not None
        or output.flow_meters
        or output.metrics
        or plan.scene.measured_walls
        or has_conditions
    ):
        observers.append(time_series_for(plan, out_dir))
    if out_dir is not None and output.particles:
        observers.append(
            ParticleFrames(
                out_dir,
                output.interval,
                writer=writer,
                reach=_max_coordinate(plan),
                engine=rank_engine if output.frames_per_rank else None,
                compression=output.compression,
                totals=[f"box_width_{AXES[k]}" for k in plan.periodic_box.axes]
                if plan.features.deforming_box
                else (),
            )
        )
    if out_dir is not None and output.contacts:
        observers.append(
            ContactFrames(
                out_dir,
                output.interval,
                writer=writer,
                history_units=_history_units(plan),
                compression=output.compression,
            )
        )
    if out_dir is not None and output.walls and plan.walls:
        observers.append(
            WallFrames(
                out_dir,
                output.interval,
                _wall_triangles(plan),
                writer=writer,
                measured=plan.measured_areas,
                unbounded=[wall.name for wall in plan.walls if not wall.spec.is_bounded],
                has_belts=plan.features.surface_velocity,
                wear_areas=plan.wear_areas,
                temperatures=_wall_temperatures(plan),
                compression=output.compression,
            )
        )
    if out_dir is not None:
        observers += [field_frames(plan, name, spec, out_dir, writer) for name, spec in output.fields.items()]
    if out_dir is not None and output.collision_energies is not None:
        observers.append(CollisionEnergies(out_dir, output.interval, plan.collision_edges))
    if progress:
        observers.append(ProgressDisplay([(stage.name, stage.longest) for stage in plan.stages]))
    return observers


def _max_coordinate(plan: Plan) -> float | None:
    """Return the largest absolute coordinate of the domain [m]; None if the domain expands."""
    if plan.scene.domain.on_exit == "expand":
        return None
    return float(np.abs([plan.scene.domain.min, plan.scene.domain.max]).max())


def _wall_temperatures(plan: Plan) -> dict[str, float]:
    """Temperatures [K] of the walls that have one, by name."""
    found = {wall.name: getattr(wall.spec, "temperature", None) for wall in plan.walls}
    return {name: temperature for name, temperature in found.items() if temperature is not None}


def _history_units(plan: Plan) -> dict[str, str]:
    """Units of the history fields of the contact models by name, without those of dimensionless ones."""
    return {
        each.name: each.unit for fields in plan.laws.history.values() for each in fields if each.unit != "1"
    }


def _wall_triangles(plan: Plan) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return points at rest (m, 3) [m] and corners (k, 3), indices of points, of each wall by name."""
    center = 0.5 * (plan.domain_low + plan.domain_high)
    extent = 0.5 * float(np.max(plan.domain_high - plan.domain_low))
    return {wall.name: wall.surface.triangles(center, extent) for wall in plan.walls}


def time_series_for(plan: Plan, out_dir: Path | None) -> TimeSeries:
    """Return the time series of a run with its flow meters, wall forces and metrics.

    `out_dir`: directory of `timeseries.csv`; without it no file is written, but the meters are updated. The
    interval is `output.timeseries_interval`, or `output.interval` if that is not given [s].
    """
    gravity = plan.scene.largest_gravity
    flow_meters = {
        name: FlowCounter(meter, plan.periodic_box, plan.scene.flow_meter_parts(name), gravity)
        for name, meter in plan.scene.output.flow_meters.items()
    }
    wall_forces = {
        wall.name: WallForceMeter(wall.name, plan.measured_areas[wall.name], wall.spec.stages)
        for wall in plan.walls
        if wall.name in plan.measured_areas
    }
    interval = plan.scene.output.timeseries_interval or plan.scene.output.interval
    scene = plan.scene
    names = {"group": list(scene.particles), "material": list(scene.materials)}
    passages = {
        name: PassageTable(out_dir, name, names)
        for name, meter in scene.output.flow_meters.items()
        if meter.passages and out_dir is not None
    }
    given = scene.output.residence_time
    residence = None
    if given is not None:
        begins_at = given.from_ if given.from_ in flow_meters else None
        residence = ResidenceTimes(given, names, begins_at, out_dir)
    return TimeSeries(
        out_dir,
        interval,
        flow_meters,
        wall_forces=wall_forces,
        metrics=metric_meters(plan),
        passages=passages,
        residence=residence,
    )


def field_frames(
    plan: Plan, name: str, spec: Any, out_dir: Path, writer: BackgroundWriter | None = None
) -> FieldFrames:
    """Return the frames of the coarse-grained fields `name`.

    `writer`: see `observers_for`; `spec`: entry of `output.fields`. With `width: auto`, the kernel width is
    half the largest diameter [m].
    """
    grid = spec.grid_in(plan.scene.domain)
    width = plan.radius_max if spec.width == "auto" else spec.width
    return FieldFrames(
        out_dir,
        name,
        spec.interval or plan.scene.output.interval,
        grid,
        GaussianKernel(width, spec.cutoff),
        spec.quantities or tuple(FIELD_QUANTITIES),
        spec.stages or (),
        writer,
        plan.scene.output.compression,
        [group.spec.shape for group in plan.groups],
    )


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
