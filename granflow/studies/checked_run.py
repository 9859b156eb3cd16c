"""Runs of a study that are checked before they start.

A study sets keys of a scene, in SI numbers or with units, and reads numbers of the result by name.
`checked_run` resolves the scene with these values and makes its plan, so that a sweep of a hundred runs
refuses a wrong value or name before the first run begins. The directory of a run is named by the hash of all
that determines its result.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from granflow import Scene, load_scene, plan_for
from granflow.errors import FileError, SceneError
from granflow.load import identity_of
from granflow.plan.cost import typical_run_time
from granflow.runs.initial_particles import checked_particles
from granflow.scene.run_numbers import reason_without
from granflow.studies.run_process import RunInputs, RunRequest, source_digest
from granflow.units import number_of


@dataclass(frozen=True)
class RunSettings:
    """Settings of all runs of a study.

    `runs`: directory that contains the run directories; `threads`: of each run; `arch`: compute device;
    `stop_file`:
    file whose presence stops all runs.
    """

    runs: Path
    threads: int
    arch: str
    stop_file: Path


@dataclass(frozen=True)
class CheckedRun:
    """A run that can start; `seed`: that of its scene; `seconds`: estimate of its computing time [s], without
    compilation and output."""

    request: RunRequest
    seed: int
    seconds: float

    @property
    def directory(self) -> Path:
        """Directory of the run."""
        return Path(self.request.directory)


def checked_run(
    path: Path,
    settings: Mapping[str, Any],
    read: Mapping[str, str],
    common: RunSettings,
    seed_offset: int = 0,
    problems_in: Callable[[Scene], Iterable[str]] = lambda _: (),
) -> CheckedRun:
    """Check a run of the scene in a file with other values of some keys, by key path.

    `read`: numbers of the result that are needed, and the position of each in its file; `seed_offset`: added
    to the seed of the scene; `problems_in`: other problems of the scene for the study. Raises SceneError if
    the scene with these values is invalid or its given positions overlap, FileError if it has no such number,
    other problems, or needs particles of a program.
    """
    overrides = overrides_of(settings)
    scene = load_scene(path, overrides)
    if seed_offset:
        overrides = (*overrides, f"seed={scene.seed + seed_offset}")
        scene = load_scene(path, overrides)
    problems = [
        f"{position}: {reason}"
        for name, position in read.items()
        if (reason := unknown_quantity(name, scene))
    ]
    problems += problems_in(scene)
    problems += scene.problems_without_program()
    if problems:
        raise FileError(problems)
    plan = plan_for(scene)
    if scene.start_from is None and any(group.insert.has_rows for group in scene.particles.values()):
        checked_particles(plan)
    inputs = RunInputs.of(scene)
    directory = (common.runs / run_identity(scene, common.arch)).resolve()
    request = RunRequest(
        str(path.resolve()),
        overrides,
        str(directory),
        common.threads,
        common.arch,
        str(common.stop_file.resolve()),
        inputs=inputs,
    )
    return CheckedRun(request, scene.seed, typical_run_time(plan))


HASH_DIGITS = 16
"""Hexadecimal digits of the name of a run directory."""


def run_identity(scene: Scene, arch: str) -> str:
    """Hash of all that determines the result of a run: program version, compute device, scene, contents of
    its inputs.

    The inputs are meshes, tables, particle files, and the particles of the run in `start_from`.
    """
    source = "" if scene.start_from is None else source_digest(Path(scene.start_from))
    text = f"{arch}\n{identity_of(scene)}\n{source}"
    return hashlib.sha256(text.encode()).hexdigest()[:HASH_DIGITS]


# Values of keys


def si_value(value: Any) -> Any:
    """The SI number of text with a unit such as "9 mm"; other values unchanged."""
    number = number_of(value) if isinstance(value, str) else None
    return value if number is None else float(number)


def overrides_of(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """The settings, values by key path, as arguments of --set.

    Values are in the notation of JSON, which YAML contains.
    """
    return tuple(f"{key}={json.dumps(value)}" for key, value in settings.items())


def relocated(error: SceneError, positions: Mapping[str, str]) -> FileError:
    """The error with its problems at the positions in the file of a study, where they concern settings of the
    study.

    `positions`: position in that file by key path of the scene.
    """
    return FileError([_relocated(problem, positions) for problem in error.problems])


def _relocated(problem: str, positions: Mapping[str, str]) -> str:
    for key, position in positions.items():
        prefix = f"--set {key}="
        if problem.startswith(prefix) and ": " in problem:
            return f"{position}: {problem.partition(': ')[2]}"
    return problem


# Names of the numbers in the result


def unknown_quantity(name: str, scene: Scene) -> str:
    """Why a run of the scene has no number of this name, in a sentence; empty if it has one."""
    reason = reason_without(scene, name)
    if not reason:
        return ""
    if name == "warnings":
        reason = "sweep.csv and runs.csv have a column with them in any case; their number is warning_count"
    ended = reason if reason.endswith("?") else f"{reason}."
    return f"{name} is not a number of a run of {scene.path.name or 'the scene'}: {ended}"
