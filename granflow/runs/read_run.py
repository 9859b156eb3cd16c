"""Reads a run from the files in its directory, complete or not: scene, log, time series, frames, result."""

import os
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import numpy as np

from granflow.arguments import path_of
from granflow.errors import GranflowError, RunError
from granflow.fields import CONTACT_QUANTITIES
from granflow.geometry.sphere import sphere_mass
from granflow.io.files import read_text, resolved
from granflow.io.frames import frame_near, is_empty, listed_frames, read_mesh, require_directory
from granflow.io.lock import locked
from granflow.io.log import LOG, RECORD, Record, read_record
from granflow.io.tables import TimeSeriesTable, read_series
from granflow.io.vtu import VtuMesh
from granflow.load import Scene, load_scene
from granflow.observers.coarse_graining import of_bodies
from granflow.runs.result import Result, read_sections, result_of
from granflow.snapshot import Snapshot, body_ids
from granflow.visible_text import html_table, numbered, visible_line

if TYPE_CHECKING:
    from pandas import DataFrame


# Frames of a run in its directory: lazy sequences of arrays, read from the VTU files at each access.

T = TypeVar("T")


class Frames(Sequence[T], Generic[T]):
    """Frames of one kind, in order of time; `times`: (frames,) [s]. A frame is read at each access.

    An index is an int or a slice; `at` finds a frame by its time. Raises GranflowError for a file that cannot
    be read.

    >>> import granflow as gf
    >>> frames = gf.read_run("out/two").frames
    >>> len(frames), frames.times.round(3)[-1].item()
    (101, 0.02)
    >>> frames[-1].particles["velocity"].shape
    (2, 3)
    """

    def __init__(self, files: Sequence[tuple[float, Path]], read: Callable[[float, Path], T]) -> None:
        self._files = tuple(files)
        self._read = read

    @property
    def times(self) -> np.ndarray:
        """Simulated times of the frames (frames,) [s]."""
        return np.array([time for time, _ in self._files])

    @property
    def paths(self) -> tuple[Path, ...]:
        """VTU files of the frames."""
        return tuple(path for _, path in self._files)

    def __len__(self) -> int:
        return len(self._files)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> "Frames[T]": ...
    def __getitem__(self, index: int | slice) -> "T | Frames[T]":
        if isinstance(index, slice):
            return Frames(self._files[index], self._read)
        return self._read(*self._files[index])

    def __iter__(self) -> Iterator[T]:
        return (self._read(*file) for file in self._files)

    def at(self, time: float) -> T | None:
        """The frame nearest to `time` [s], at most half of the interval between frames away; else None.

        Frames are written at the first step after a multiple of the output interval, such as 0.5000033 s.
        """
        found = frame_near(self._files, time)
        return self._read(*found) if found else None

    def __repr__(self) -> str:
        """Number of frames and range of times."""
        span = f" from {self._files[0][0]:.4g} to {self._files[-1][0]:.4g} s" if self._files else ""
        return f"<Frames: {len(self)}{span}>"


def filled_frames(directory: Path, stem: str) -> list[tuple[float, Path]]:
    """Time [s] and file of each frame of a series, without frames that contain nothing."""
    return [(time, path) for time, path in listed_frames(directory, stem) if not is_empty(path)]


def particle_arrays(mesh: VtuMesh) -> dict[str, np.ndarray]:
    """Arrays of the particles by name (n,) or (n, k), in SI units, with `position` (n, 3) [m] in float64."""
    arrays = {name: np.asarray(values) for name, values in mesh.point_data.items()}
    return arrays | {"position": mesh.points.astype(np.float64)}


def contact_arrays(mesh: VtuMesh) -> dict[str, np.ndarray]:
    """Arrays of the contacts by name (c,) or (c, 3): CONTACT_QUANTITIES and history fields, in SI units."""
    lines = np.concatenate([np.zeros((0, 2), np.int64), *(b.data for b in mesh.cells if b.type == "line")])
    empty = (
        {}
        if len(lines)
        else {name: each.for_file(np.zeros(each.shape(0))) for name, each in CONTACT_QUANTITIES.items()}
    )
    found = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items() if parts}
    arrays = empty | found | {"position_i": mesh.points[lines[:, 0]], "position_j": mesh.points[lines[:, 1]]}
    return {name: arrays[name] for name in (*CONTACT_QUANTITIES, *arrays) if name in arrays}


def cell_arrays(mesh: VtuMesh) -> dict[str, np.ndarray]:
    """Fields on a grid by name (cells,) or (cells, k), in SI units.

    The `position` of the cells (cells, 3) [m] is one of them.
    """
    corners = [mesh.points[block.data].mean(axis=1) for block in mesh.cells]
    arrays = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items()}
    return arrays | {"position": np.concatenate([np.zeros((0, 3)), *corners])}


def array_frames(
    directory: Path, stem: str, arrays_of: Callable[[VtuMesh], dict[str, np.ndarray]]
) -> Frames[Mapping[str, np.ndarray]]:
    """Frames `STEM_NNNN.vtu` of a run; each is a mapping from names to arrays. Empty without such files."""
    return Frames(listed_frames(directory, stem), lambda time, path: arrays_of(read_mesh(path)))


# Columns of numbers by name, such as the rows of a time series, as numpy arrays or as a pandas DataFrame.


class Columns(Mapping[str, np.ndarray]):
    """Columns of equal length by name, (rows,) each, in SI units; `units`: unit by name, "" for a number.

    >>> import granflow as gf
    >>> columns = gf.read_run("out/two").timeseries_arrays
    >>> round(columns["time"][-1].item(), 3), columns.units["kinetic_energy"]
    (0.02, 'J')
    """

    def __init__(self, arrays: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
        self._arrays = dict(arrays)
        self.units = dict(units)

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        """Number of rows and names of the columns."""
        rows = len(next(iter(self._arrays.values()), ()))
        return f"<Columns: {rows} rows of {', '.join(self._arrays)}>"

    def part(self, name: str) -> "Columns":
        """The columns of a flow meter, wall or metric by quantity, with `time` and `stage`; else empty."""
        found = {key.partition(".")[0]: key for key in self._arrays if key.partition(".")[2] == name}
        keys = {key: key for key in ("time", "stage") if key in self._arrays} | found if found else {}
        return Columns(
            {quantity: self._arrays[key] for quantity, key in keys.items()},
            {quantity: self.units[key] for quantity, key in keys.items()},
        )

    def to_pandas(self) -> "DataFrame":
        """The columns as a pandas DataFrame; `attrs["units"]` has the units.

        Raises GranflowError without pandas.
        """
        try:
            import pandas
        except ImportError:
            raise GranflowError(
                "A DataFrame requires pandas, which is not installed: pip install pandas, or use the numpy "
                "arrays of timeseries_arrays."
            ) from None
        frame = pandas.DataFrame(dict(self._arrays))
        frame.attrs["units"] = dict(self.units)
        return frame


SCENE = "scene_as_run.yaml"
"""Name of the resolved scene in the directory of a run."""
RUN_FILES = (SCENE, LOG, "timeseries.csv", "result.json", "particles.pvd")
"""Files that identify the directory of a run; at least one must exist."""


def read_run(directory: str | os.PathLike[str]) -> "Run":
    """The run in a directory, such as "out/hopper"; it may be in progress, aborted or incomplete.

    Files are read at the first access of the corresponding attribute; Taichi is not imported. Raises
    GranflowError if the directory does not exist or contains no file of a run.

    >>> import granflow as gf
    >>> run = gf.read_run("out/two")
    >>> run
    <Run "Two steel spheres" in out/two: complete, 0.02 s, 101 frames>
    >>> float(run.timeseries_arrays["kinetic_energy"][-1]) > 0
    True
    """
    path = path_of("directory", directory)
    require_directory(path)
    if not any((path / name).exists() for name in RUN_FILES):
        raise GranflowError(
            f"{path} is not the directory of a run: it contains none of {', '.join(RUN_FILES)}."
        )
    return Run(path)


class Run:
    """A run in its directory; `read_run` creates it. All numbers are in SI units.

    Attributes that read a damaged file raise GranflowError with the file and the reason.

    >>> import granflow as gf
    >>> run = gf.read_run("out/two")
    >>> run.status, run.scene.gravity, round(run.time, 3)
    ('complete', (0.0, 0.0, 0.0), 0.02)
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    @cached_property
    def scene(self) -> Scene:
        """The resolved scene of the run. Raises SceneError if this version cannot read it."""
        return load_scene(self.directory / SCENE)

    @cached_property
    def scene_problem(self) -> str:
        """The reason why `scene` cannot be read; empty if it can."""
        try:
            return "" if self.scene else ""
        except GranflowError as error:
            return str(error)

    @property
    def scene_text(self) -> str:
        """The resolved scene as YAML; empty if its file is missing."""
        path = self.directory / SCENE
        return read_text(path) if path.exists() else ""

    @property
    def title(self) -> str:
        """Title of the scene, or name of the directory if the scene cannot be read."""
        return resolved(self.directory).name if self.scene_problem else self.scene.title

    @property
    def status(self) -> str:
        """State of the run: "complete", "running", "aborted" or "unfinished".

        An aborted run ended with RunError. An unfinished one stopped before its end and can be
        resumed.
        """
        if self.is_running:
            return "running"
        if self.result_sections:
            return "complete" if self.result_sections.get("complete", True) else "unfinished"
        last = next((entry.ended_by for entry in reversed(self.record) if entry.level == "ERROR"), "")
        return "aborted" if last == RunError.__name__ else "unfinished"

    @property
    def is_running(self) -> bool:
        """Whether a process is writing to the directory: it holds the lock."""
        if not (self.directory / ".lock").exists():
            return False
        try:
            with locked(self.directory):
                return False
        except (GranflowError, OSError):
            return True

    @property
    def time(self) -> float | None:
        """Simulated time [s] according to result or time series; None if the run has neither."""
        simulated = self.result_sections.get("run", {}).get("simulated_time")
        if simulated is not None:
            return float(simulated)
        return float(self.series.time[-1]) if self.series is not None else None

    @cached_property
    def record(self) -> Record:
        """Entries of `run.jsonl`: sessions, warnings and errors; empty without this file."""
        return read_record(self.directory / RECORD)

    @cached_property
    def result_sections(self) -> dict[str, Any]:
        """Sections of `result.json`; empty for a run that was aborted or killed."""
        return read_sections(self.directory / "result.json")

    @property
    def result(self) -> Result | None:
        """The numbers of the completed run; None if the run is not complete (see `status`)."""
        try:
            return result_of(self.result_sections) if self.result_sections else None
        except (AttributeError, KeyError, TypeError):
            path = self.directory / "result.json"
            raise GranflowError(
                f"{path} is damaged: a section is missing or of another type; run again."
            ) from None

    @cached_property
    def series(self) -> TimeSeriesTable | None:
        """The time series with units and stages; None without rows."""
        return read_series(self.directory / "timeseries.csv")

    @cached_property
    def timeseries_arrays(self) -> Columns:
        """Columns of `timeseries.csv` by name without unit, (rows,) each; `stage` is text.

        Empty without rows.
        """
        if self.series is None:
            return Columns({}, {})
        arrays = {each.name: each.values for each in self.series.columns}
        units = {each.name: each.unit for each in self.series.columns}
        first = {"time": self.series.time, "stage": self.series.stage}
        return Columns(first | arrays, {"time": "s", "stage": ""} | units)

    @property
    def timeseries(self) -> "DataFrame":
        """The time series as a pandas DataFrame with a row for each time; `attrs["units"]` has the units.

        Columns: `time` [s], `stage`, totals such as `kinetic_energy`, and `QUANTITY.NAME` of flow meters,
        walls and metrics. Raises GranflowError if pandas is not installed.
        """
        return self.timeseries_arrays.to_pandas()

    @property
    def flow_meters(self) -> dict[str, Columns]:
        """Time series of each flow meter by name: flow_mass [kg], flow_count, mass_flow [kg/s]."""
        return self._parts(self.scene.output.flow_meters)

    @property
    def wall_forces(self) -> dict[str, Columns]:
        """Time series of each measured wall by name: wall_force_x [N], wall_pressure [Pa], ..."""
        return self._parts(self.scene.measured_walls)

    @property
    def metrics(self) -> dict[str, Columns]:
        """Time series of each metric of the scene by name."""
        return self._parts(self.scene.output.metrics)

    def _parts(self, names: Any) -> dict[str, Columns]:
        return {name: self.timeseries_arrays.part(name) for name in names}

    @cached_property
    def frames(self) -> Frames[Snapshot]:
        """Particles at each output time that has some, as Snapshots with `time`, `stage` and `particles`.

        Masses [kg] follow from the densities of the scene, if it can be read. `contacts` is None: see
        `Run.contacts`. Walls and totals are empty, and the step number is 0.
        """
        return Frames(filled_frames(self.directory, "particles"), self._snapshot)

    @cached_property
    def contacts(self) -> Frames[Mapping[str, np.ndarray]]:
        """Contacts at each output time, as mappings from names to arrays (c,) or (c, 3).

        Empty if the run wrote no such files.
        """
        return array_frames(self.directory, "contacts", contact_arrays)

    @cached_property
    def fields(self) -> dict[str, Frames[Mapping[str, np.ndarray]]]:
        """Coarse-grained fields by name: frames of arrays (cells,) or (cells, k).

        The `position` of the cells [m] is one of them.
        """
        stems = sorted(path.stem for path in self.directory.glob("fields_*.pvd"))
        return {
            stem.removeprefix("fields_"): array_frames(self.directory, stem, cell_arrays) for stem in stems
        }

    def snapshot(self, index: int = -1) -> Snapshot:
        """One frame with particles and contacts.

        `contacts` is None if the run did not write them at its time.

        `index`: as in `frames`. Raises IndexError if there is no such frame.
        """
        frame = self.frames[index]
        return Snapshot(frame.time, 0, frame.stage, frame.particles, self.contacts.at(frame.time), {}, {})

    def _snapshot(self, time: float, path: Path) -> Snapshot:
        """Snapshot of the particles in a file."""
        arrays = particle_arrays(read_mesh(path))
        if "radius" in arrays and "material" in arrays and not self.scene_problem:
            density = np.array([material.density for material in self.scene.materials.values()])
            arrays["radius"] = arrays["radius"].astype(np.float64)
            bodies = [group.shape.body for group in self.scene.particles.values()]
            share = np.array([1.0 if body is None else body.volume_over_spheres for body in bodies])
            mass = sphere_mass(arrays["radius"], density[arrays["material"]])
            arrays["mass"] = mass * share[arrays["group"]]
            if "clump" in arrays:
                arrays |= self._clumps(arrays)
        return Snapshot(time, 0, self._stage_at(time), arrays, None, {}, {})

    def _clumps(self, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Mass, center of mass and its velocity of the clump of each sphere, as in snapshots of a program."""
        shapes = [group.shape for group in self.scene.particles.values()]
        bodies = of_bodies(arrays, shapes)
        first, body = np.unique(body_ids(arrays), return_inverse=True)
        return {
            "clump_mass": np.bincount(body, arrays["mass"], len(first))[body],
            "clump_position": self.scene.domain.periodic_box().wrap(bodies["position"]),
            "clump_velocity": bodies["velocity"],
        }

    def _stage_at(self, time: float) -> str:
        """Stage in the last row of the time series at or before `time` [s].

        Otherwise it is the first stage, or empty without stages.
        """
        first = "" if self.scene_problem else self.scene.schedule[0].name
        if self.series is None:
            return first
        row = bisect_right(self.series.time.tolist(), time) - 1
        return str(self.series.stage[max(row, 0)])

    def __repr__(self) -> str:
        """One line: title, directory, status, simulated time [s], number of frames."""
        shown = ", ".join(text for _, text in self._summary())
        return f'<Run "{visible_line(self.title)}" in {visible_line(self.directory)}: {shown}>'

    def _repr_html_(self) -> str:
        """Table of the run for notebooks: status and the main numbers of the result."""
        totals = self.result_sections.get("totals", {})
        numbers = [
            (name.replace("_", " "), f"{totals[name]:g}") for name in _SHOWN if totals.get(name) is not None
        ]
        return html_table(self.title, [("directory", str(self.directory)), *self._summary(), *numbers])

    def _summary(self) -> list[tuple[str, str]]:
        """Rows of the displays of a run: label and text."""
        time = "no time series" if self.time is None else f"{self.time:.4g} s"
        return [
            ("status", self.status),
            ("simulated time", time),
            ("frames", numbered(len(self.frames), "frame")),
        ]


_SHOWN = ("particle_count", "contact_count", "kinetic_energy", "energy_error")
"""Totals in the display of a run in notebooks."""
