"""What a run has left in its directory, whole or not: scene, log, time series, result."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from granflow.errors import GranflowError
from granflow.observe import locked
from granflow.regular_files import read_regular_text, resolved
from granflow.scene import Scene, load
from granflow.study.report.log import LogEntry, RunSession, read_log, sessions
from granflow.study.report.series import TimeSeriesTable, read_series

SCENE = "scene_as_run.yaml"
RUN_FILES = (SCENE, "run.log", "timeseries.csv", "result.json")
"""Files of which a run has at least one."""


@dataclass(frozen=True)
class RunRecord:
    """All that a run has left.

    `scene`: none where its file is gone or cannot be read, `scene_problem` says why. `result`: the sections of
    `result.json`, empty for a run that did not come to its end. `is_running`: whether a run writes there now.
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
        """The scene's, or the name of the directory."""
        return self.scene.title if self.scene is not None else resolved(self.directory).name

    @property
    def sessions(self) -> list[RunSession]:
        """The stretches of the run: one, and one more for each time that it was gone on with."""
        return sessions(self.entries)

    @property
    def time(self) -> float | None:
        """Simulated time [s] that was reached, as far as the files say."""
        if "simulated_time" in self.result.get("run", {}):
            return self.result["run"]["simulated_time"]
        return float(self.series.time[-1]) if self.series is not None else None


def read_record(directory: Path) -> RunRecord:
    """Read what a run has left. Raises GranflowError for a directory that is not that of a run."""
    if not directory.is_dir():
        raise GranflowError(
            f"{directory}: there is no such directory; name the directory of a run, such as out/hopper."
        )
    if not any((directory / name).exists() for name in RUN_FILES):
        raise GranflowError(f"{directory} is not the directory of a run: it holds none of {', '.join(RUN_FILES)}.")
    scene, problem = _scene(directory / SCENE)
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


def _scene(path: Path) -> tuple[Scene | None, str]:
    try:
        return load(path), ""
    except GranflowError as error:
        return None, str(error)


def _result(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    try:
        found = json.loads(read_regular_text(path))
    except (ValueError, RecursionError, OSError) as error:
        raise GranflowError(f"{path} cannot be read ({error}): take it away, or run again.") from None
    return found if isinstance(found, dict) else {}


def _is_running(directory: Path) -> bool:
    if not (directory / ".lock").exists():
        return False
    try:
        with locked(directory):
            return False
    except (GranflowError, OSError):
        return True
