"""From a scene's `output:` block to its observers."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granflow.observe.coarse import FieldFrames, Kernel, grid_in
from granflow.observe.indices.build import index_meters
from granflow.observe.loads import LoadMeter
from granflow.observe.meters import FlowMeter
from granflow.observe.observer import Observer
from granflow.observe.progress import ProgressDisplay
from granflow.observe.timeseries import TimeSeries
from granflow.observe.vtu import ContactFrames, ParticleFrames, WallFrames
from granflow.plan.sizes import diameter_range
from granflow.plan.walls import loaded_areas
from granflow.scene.border import Border


def observers_for(
    scene: Any, out_dir: Path, wall_triangles: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> list[Observer]:
    """Make the observers that the scene asks for, writing into `out_dir`; the time series is always the first.

    `wall_triangles`: name -> (rest points (m, 3) [m], corners (k, 3)) of every wall, in the order of the
    scene.
    """
    output = scene.output
    interval = output.interval
    observers: list[Observer] = [time_series_for(scene, out_dir)]
    if output.particles:
        observers.append(ParticleFrames(out_dir, interval, reach=_reach(scene)))
    if output.contacts:
        observers.append(ContactFrames(out_dir, interval))
    if output.walls and wall_triangles:
        observers.append(WallFrames(out_dir, interval, wall_triangles, loaded=loaded_areas(scene)))
    observers += [field_frames(scene, name, asked, out_dir) for name, asked in output.fields.items()]
    return observers


def time_series_for(scene: Any, out_dir: Path | None) -> TimeSeries:
    """Make the time series of the scene with its flow meters and wall loads."""
    border = Border.of(scene.domain)
    meters = {
        name: FlowMeter(meter.point, meter.normal, meter.radius, border, meter.sides, meter.by, scene.meter_parts(name))
        for name, meter in (scene.output.meters or {}).items()
    }
    loads = {name: LoadMeter(name, area) for name, area in loaded_areas(scene).items()}
    interval = scene.output.timeseries_interval or scene.output.interval
    return TimeSeries(out_dir, interval, meters, loads=loads, indices=index_meters(scene))


def field_frames(scene: Any, name: str, asked: Any, out_dir: Path) -> FieldFrames:
    """Make the frames of the fields `name` that the scene asks for."""
    grid = grid_in(scene.domain, asked)
    width = asked.width
    if width == "auto":
        width = 0.5 * max(diameter_range(group)[1] for group in scene.particles.values())
    interval = asked.interval or scene.output.interval
    return FieldFrames(
        out_dir, name, interval, grid, Kernel(width, asked.cut_off), asked.quantities, asked.stages or ()
    )


def progress_for(scene: Any) -> ProgressDisplay:
    """Make the progress display for the stages of the scene."""
    return ProgressDisplay(stage_durations(scene))


def stage_durations(scene: Any) -> list[tuple[str, float]]:
    """Name and longest duration [s] of every stage; without stages, one named "run"."""
    if not scene.stages:
        return [("run", scene.run.duration)]
    return [(stage.name, stage.duration if stage.duration is not None else stage.at_most) for stage in scene.stages]


def _reach(scene: Any) -> float | None:
    """Largest coordinate that occurs [m]; None where the domain grows."""
    if scene.domain.leaving == "grow":
        return None
    return float(np.abs([scene.domain.min, scene.domain.max]).max())
