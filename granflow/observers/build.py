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
from granflow.plan.size_classes import diameter_range
from granflow.plan.walls import measured_areas


def observers_for(
    scene: Any, out_dir: Path, wall_triangles: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> list[Observer]:
    """Return the observers that the scene specifies, which write into `out_dir`.

    Order: time series (always), particle frames, contact frames, wall frames, and one per block of `output.fields`.

    `scene`: resolved scene.
    `wall_triangles`: name -> (points at rest (m, 3) [m], corners (k, 3), indices of points) of each wall, in the order
    of the scene; without walls, no wall frames are written.
    """
    output = scene.output
    interval = output.interval
    observers: list[Observer] = [time_series_for(scene, out_dir)]
    if output.particles:
        observers.append(ParticleFrames(out_dir, interval, reach=_max_coordinate(scene)))
    if output.contacts:
        observers.append(ContactFrames(out_dir, interval))
    if output.walls and wall_triangles:
        observers.append(WallFrames(out_dir, interval, wall_triangles, measured=measured_areas(scene)))
    observers += [field_frames(scene, name, spec, out_dir) for name, spec in output.fields.items()]
    return observers


def time_series_for(scene: Any, out_dir: Path | None) -> TimeSeries:
    """Return the time series of the scene with its flow meters, wall forces and metrics.

    `out_dir`: directory of `timeseries.csv`; without it no file is written, but the meters are updated. The interval is
    `output.timeseries_interval`, or `output.interval` if that is not given [s].
    """
    periodic_box = scene.domain.periodic_box()
    flow_meters = {
        name: FlowMeter(
            meter.point,
            meter.normal,
            meter.radius,
            periodic_box,
            meter.sides,
            meter.group_by,
            scene.flow_meter_parts(name),
        )
        for name, meter in (scene.output.flow_meters or {}).items()
    }
    wall_forces = {name: WallForceMeter(name, area) for name, area in measured_areas(scene).items()}
    interval = scene.output.timeseries_interval or scene.output.interval
    return TimeSeries(out_dir, interval, flow_meters, wall_forces=wall_forces, metrics=metric_meters(scene))


def field_frames(scene: Any, name: str, spec: Any, out_dir: Path) -> FieldFrames:
    """Return the frames of the coarse-grained fields `name`.

    `spec`: entry of `output.fields`. With `width: auto`, the kernel width is half the largest diameter of the scene
    [m].
    """
    grid = grid_for(scene.domain, spec)
    width = spec.width
    if width == "auto":
        width = 0.5 * max(diameter_range(group)[1] for group in scene.particles.values())
    interval = spec.interval or scene.output.interval
    return FieldFrames(
        out_dir, name, interval, grid, GaussianKernel(width, spec.cutoff), spec.quantities, spec.stages or ()
    )


def progress_for(scene: Any) -> ProgressDisplay:
    """Return the progress display for the stages of the scene."""
    return ProgressDisplay(stage_durations(scene))


def stage_durations(scene: Any) -> list[tuple[str, float]]:
    """Return the name and maximum duration [s] of each stage; without stages, one stage named "run"."""
    if not scene.stages:
        return [("run", scene.run.duration)]
    return [
        (stage.name, stage.duration if stage.duration is not None else stage.max_duration) for stage in scene.stages
    ]


def _max_coordinate(scene: Any) -> float | None:
    """Return the largest absolute coordinate of the domain [m]; None if the domain expands."""
    if scene.domain.on_exit == "expand":
        return None
    return float(np.abs([scene.domain.min, scene.domain.max]).max())
