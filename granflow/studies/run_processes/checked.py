"""Runs checked before they start: resolved scene, plan, directory by the identity of the run, and set of kernels."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from granflow import Plan, Scene, load_scene, plan_for
from granflow.errors import FileError
from granflow.load import identity_of
from granflow.studies.run_processes.inputs import RunInputs, source_digest
from granflow.studies.run_processes.process import RunRequest
from granflow.studies.run_processes.quantities import unknown_quantity
from granflow.studies.run_processes.settings import overrides_of

HASH_DIGITS = 16
"""Hexadecimal digits of the name of a run directory."""


@dataclass(frozen=True)
class CheckedRun:
    """A run that can start. `kernels`: equal for runs with equal compiled kernels; `seed`: that of its scene."""

    request: RunRequest
    seed: int
    kernels: str

    @property
    def directory(self) -> Path:
        """Directory of the run."""
        return Path(self.request.directory)


@dataclass(frozen=True)
class RunSettings:
    """Settings of all runs of a study.

    `runs`: directory that contains the run directories; `threads`: of each run; `arch`: compute device; `stop_file`:
    file whose presence stops all runs.
    """

    runs: Path
    threads: int
    arch: str
    stop_file: Path


def checked_run(
    path: Path, settings: Mapping[str, Any], read: Mapping[str, str], common: RunSettings, seed_offset: int = 0
) -> CheckedRun:
    """Check a run of the scene in a file with other values of some keys, by key path.

    `read`: numbers of the result that are needed, and the position of each in its file; `seed_offset`: added to the
    seed of the scene. Raises SceneError if the scene with these values is invalid, FileError if it has no such number
    or needs particles of a program.
    """
    overrides = overrides_of(settings)
    scene = load_scene(path, overrides)
    if seed_offset:
        overrides = (*overrides, f"seed={scene.seed + seed_offset}")
        scene = load_scene(path, overrides)
    problems = [f"{position}: {reason}" for name, position in read.items() if (reason := unknown_quantity(name, scene))]
    problems += scene.problems_without_program()
    if problems:
        raise FileError(problems)
    plan = plan_for(scene)
    inputs = RunInputs.of(scene)
    directory = (common.runs / run_identity(scene, common.arch)).resolve()
    request = RunRequest(
        str(path.resolve()), overrides, str(directory), common.threads, common.arch, str(common.stop_file.resolve()),
        inputs=inputs,
    )  # fmt: skip
    return CheckedRun(request, scene.seed, _kernel_set(scene, plan, common.arch))


def run_identity(scene: Scene, arch: str) -> str:
    """Hash of all that determines the result of a run: program version, compute device, scene, contents of its inputs.

    The inputs are meshes, tables, particle files, and the particles of the run in `start_from`.
    """
    source = "" if scene.start_from is None else source_digest(Path(scene.start_from))
    text = f"{arch}\n{identity_of(scene)}\n{source}"
    return hashlib.sha256(text.encode()).hexdigest()[:HASH_DIGITS]


def _kernel_set(scene: Scene, plan: Plan, arch: str) -> str:
    """Text that is equal for scenes whose compiled kernels are equal: contact models, features and precision."""
    return repr((arch, plan.precision, scene.contact, plan.features))
