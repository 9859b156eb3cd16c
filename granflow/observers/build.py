"""Builds the observers that the `output:` block of a scene specifies."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granflow.observers.base import Observer
from granflow.observers.coarse_graining.field_frames import FieldFrames
from granflow.observers.coarse_graining.field_grid import grid_for
from granflow.observers.coarse_graining.kernel import GaussianKernel
from granflow.observers.flow_meters import FlowMeter
from granflow.observers.metrics.build import metric_meters
from granflow.observers.progress import ProgressDisplay
from granflow.observers.timeseries import TimeSeries
from granflow.observers.vtu import ContactFrames, ParticleFrames, WallFrames
from granflow.observers.wall_forces import WallForceMeter
from granflow.plan.plan import Plan


def observers_for(
    plan: Plan, out_dir: Path, wall_triangles: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> list[Observer]:
    """Return the observers that the plan specifies, which write into `out_dir`.

    Order: time series (always), particle frames, contact frames, wall frames, and one per block of `output.fields`.

    `wall_triangles`: name -> (points at rest (m, 3) [m], corners (k, 3), indices of points) of each wall, in the order
    of the scene; without walls, no wall frames are written.
    """
    output = plan.output
    interval = output.interval
    observers: list[Observer] = [time_series_for(plan, out_dir)]
    if output.particles:
        observers.append(ParticleFrames(out_dir, interval, reach=_max_coordinate(plan)))
    if output.contacts:
        observers.append(ContactFrames(out_dir, interval))
    if output.walls and wall_triangles:
        observers.append(WallFrames(out_dir, interval, wall_triangles, measured=plan.measured_areas))
    observers += [field_frames(plan, name, spec, out_dir) for name, spec in output.fields.items()]
    return observers


def time_series_for(plan: Plan, out_dir: Path | None) -> TimeSeries:
    """Return the time series of a run with its flow meters, wall forces and metrics.

    `out_dir`: directory of `timeseries.csv`; without it no file is written, but the meters are updated. The interval is
    `output.timeseries_interval`, or `output.interval` if that is not given [s].
    """
    flow_meters = {
        name: FlowMeter(
            meter.point,
            meter.normal,
            meter.radius,
            plan.periodic_box,
            meter.sides,
            meter.group_by,
            plan.flow_meter_parts[name],
        )
        for name, meter in plan.output.flow_meters.items()
    }
    wall_forces = {name: WallForceMeter(name, area) for name, area in plan.measured_areas.items()}
    interval = plan.output.timeseries_interval or plan.output.interval
    return TimeSeries(out_dir, interval, flow_meters, wall_forces=wall_forces, metrics=metric_meters(plan))


def field_frames(plan: Plan, name: str, spec: Any, out_dir: Path) -> FieldFrames:
    """Return the frames of the coarse-grained fields `name`.

    `spec`: entry of `output.fields`. With `width: auto`, the kernel width is half the largest diameter [m].
    """
    grid = grid_for(plan.domain, spec)
    width = spec.width
    if width == "auto":
        width = plan.radius_max
    interval = spec.interval or plan.output.interval
    return FieldFrames(
        out_dir, name, interval, grid, GaussianKernel(width, spec.cutoff), spec.quantities, spec.stages or ()
    )


def progress_for(plan: Plan) -> ProgressDisplay:
    """Return the progress display for the stages of a run."""
    return ProgressDisplay([(stage.name, stage.longest) for stage in plan.stages])


def _max_coordinate(plan: Plan) -> float | None:
    """Return the largest absolute coordinate of the domain [m]; None if the domain expands."""
    if plan.domain.on_exit == "expand":
        return None
    return float(np.abs([plan.domain.min, plan.domain.max]).max())
