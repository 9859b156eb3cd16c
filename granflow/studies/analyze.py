"""Metrics and fields of a finished run, computed from its frames."""

from bisect import bisect_right
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from granflow import GranflowError, Scene, Snapshot, analyze_snapshots
from granflow.errors import FileError
from granflow.fields import CONTACT_QUANTITIES, PARTICLE_QUANTITIES
from granflow.io.tables import read_table
from granflow.studies.render.frames import Frame, frames_of, is_empty, read_mesh, read_particles


def analyze(directory: Path, scene: Scene, out: Path) -> list[dict[str, float | str]]:
    """Compute the metrics of `scene` for each frame of a run; write its fields and `metrics.csv` to `out`.

    `scene` is that of the run; its `output.metrics` and `output.fields` may differ. Returns the rows of metrics.csv by
    column name. Frames without particles are skipped. Raises the errors of `analyze_snapshots`, and GranflowError if
    files cannot be read.
    """
    return analyze_snapshots(scene, snapshots_of(directory, scene), out, str(directory))


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
    lines: np.ndarray = np.concatenate([np.zeros((0, 2), np.int64), *(b.data for b in mesh.cells if b.type == "line")])
    found = {name: parts[0] for name, parts in mesh.cell_data.items() if name in CONTACT_QUANTITIES}
    empty_contacts: dict[str, np.ndarray] = {
        "wall": np.zeros(0, np.int32),
        "force": np.zeros((0, 3)),
        "sliding": np.zeros(0, np.uint8),
    }
    return empty_contacts | found | {"position_i": mesh.points[lines[:, 0]], "position_j": mesh.points[lines[:, 1]]}


def _stages(path: Path, scene: Scene) -> Callable[[float], str]:
    """Stage as a function of time [s]: that of the last row of the time series at or before it.

    Without a time series, the first stage. Raises GranflowError if the file cannot be read.
    """
    times, names = [0.0], [scene.schedule[0].name]
    if path.exists():
        try:
            table = read_table(path)
            if table is None:
                return lambda time: names[0]
            time, stage = table.names.index("time [s]"), table.names.index("stage")
            times, names = [float(cells[time]) for _, cells in table.rows], [cells[stage] for _, cells in table.rows]
        except (FileError, ValueError, IndexError) as error:
            raise GranflowError(f"{path} cannot be read ({error}): remove it, or run again.") from None
    return lambda time: names[max(bisect_right(times, time) - 1, 0)]
