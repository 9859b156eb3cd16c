"""Files of a run in its directory, complete or not: scene, log, time series, result."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from granflow import Scene
from granflow import load_scene as load
from granflow.errors import GranflowError
from granflow.io.lock import locked
from granflow.io.regular_files import read_regular_text, resolved
from granflow.studies.report.log import LogEntry, RunSession, read_log, sessions
from granflow.studies.report.series import TimeSeriesTable, read_series

SCENE = "scene_as_run.yaml"
"""Name of the resolved scene in the directory of a run."""

RUN_FILES = (SCENE, "run.log", "timeseries.csv", "result.json")
"""Files that identify the directory of a run; at least one must exist."""


@dataclass(frozen=True)
class RunRecord:
    """Data of a run.

    `scene`: None if its file is missing or invalid; `scene_problem` is the reason. `result`: the sections of
    `result.json`, empty if the run did not finish. `is_running`: whether a run is writing to the directory.
    """

    directory: Path
    scene: Scene | None
    scene_problem: str
    text: str
    entries: list[LogEntry]
    series: TimeSeriesTable | None
    result: dict[str, Any]
    is_running: bool

    @property
    def title(self) -> str:
        """Title of the scene, or name of the directory."""
        return self.scene.title if self.scene is not None else resolved(self.directory).name

    @property
    def sessions(self) -> list[RunSession]:
        """Sessions of the run: one, plus one for each time it was resumed."""
        return sessions(self.entries)

    @property
    def time(self) -> float | None:
        """Simulated time [s] according to the files; None if unknown."""
        if "simulated_time" in self.result.get("run", {}):
            return self.result["run"]["simulated_time"]
        return float(self.series.time[-1]) if self.series is not None else None


def read_record(directory: Path) -> RunRecord:
    """Read the data of a run, which may be in progress.

    Raises GranflowError if the directory is not that of a run, or if the time series or the result cannot be read.
    """
    require_directory(directory)
    if not any((directory / name).exists() for name in RUN_FILES):
        raise GranflowError(f"{directory} is not the directory of a run: it contains none of {', '.join(RUN_FILES)}.")
    scene, problem = scene_as_run(directory)
    path = directory / SCENE
    return RunRecord(
        directory,
        scene,
        problem,
        read_regular_text(path) if path.exists() else "",
        read_log(directory / "run.log"),
        read_series(directory / "timeseries.csv"),
        _result(directory / "result.json"),
        _is_running(directory),
    )


def require_directory(directory: Path) -> None:
    """Raise GranflowError if the directory of a run does not exist."""
    if not directory.is_dir():
        raise GranflowError(
            f"{directory}: there is no such directory; give the directory of a run, such as out/hopper."
        )


def scene_as_run(directory: Path) -> tuple[Scene | None, str]:
    """Scene of a run, or None with the reason if its file is missing or cannot be read."""
    try:
        return load(directory / SCENE), ""
    except GranflowError as error:
        return None, str(error)


def _result(path: Path) -> dict[str, Any]:
    """Sections of result.json; empty if it does not exist. Raises GranflowError if it cannot be read."""
    if not path.exists():
        return {}
    try:
        found = json.loads(read_regular_text(path))
    except (ValueError, RecursionError, OSError) as error:
        raise GranflowError(f"{path} cannot be read ({error}); remove it, or run again.") from None
    return found if isinstance(found, dict) else {}


def _is_running(directory: Path) -> bool:
    """Whether a run holds the lock of the directory."""
    if not (directory / ".lock").exists():
        return False
    try:
        with locked(directory):
            return False
    except (GranflowError, OSError):
        return True
