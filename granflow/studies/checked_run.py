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
from granflow.fields import (
    FLOW_METER_QUANTITIES,
    INSERTION_QUANTITIES,
    OUTLET_QUANTITIES,
    RESIDENCE_QUANTITIES,
    RUN_QUANTITIES,
    STAGE_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_FLOW_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    WALL_QUANTITIES,
    WEAR_QUANTITIES,
)
from granflow.load import identity_of
from granflow.plan.cost import typical_run_time
from granflow.runs.initial_particles import checked_particles
from granflow.schema.messages import nearest
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
    """Why a run of the scene has no number of this name, with the closest name; empty if it has one."""
    known = result_names(scene)
    if name in known:
        return ""
    near = nearest(name, known)
    reason = f"{name} is not a number of a run of {scene.path.name or 'the scene'}."
    if name == "warnings":
        return (
            f"{reason} sweep.csv and runs.csv have a column with the warnings in any case; their number is "
            "warning_count."
        )
    if near:
        return f"{reason} Did you mean {near}?"
    means = tuple(f"{each}." for each in STAGE_QUANTITIES)
    with_parts = ", ".join(
        each for each in known if "." in each and not each.startswith(("timings.", *means))
    )
    stage = scene.stage_names[-1]
    return (
        f"{reason} It has totals such as kinetic_energy, their means and largest values such as "
        f"kinetic_energy_mean.{stage}{f', and {with_parts}' if with_parts else ''}."
    )


PHASES = ("neighbor_list", "forces", "integration", "output", "compile", "exchange", "waiting")
"""Phases of a run with a wall-clock time, `timings.PHASE`; the last two on MPI ranks."""


def result_names(scene: Scene) -> tuple[str, ...]:
    """The names that a run of the scene can have, as in its `expect:` block."""
    names = [*TOTAL_QUANTITIES, *RUN_QUANTITIES, *(f"timings.{phase}" for phase in PHASES)]
    for meter in scene.output.flow_meters:
        parts = [meter, *(f"{meter}.{part}" for part in scene.flow_meter_parts(meter))]
        names += [f"{quantity}.{part}" for quantity in FLOW_METER_QUANTITIES for part in parts]
    for each in STAGE_QUANTITIES:
        names += [each, *(f"{each}.{stage}" for stage in scene.stage_names)]
    if (given := scene.output.residence_time) is not None:
        names += [f"{quantity}.{given.to}" for quantity in RESIDENCE_QUANTITIES]
    for name, metric in scene.output.metrics.items():
        names += [f"{each.name}{end}.{name}" for each in metric.quantities for end in ("", "_mean")]
    names += [f"{quantity}.{wall}" for quantity in WALL_FORCE_QUANTITIES for wall in scene.measured_walls]
    names += [
        f"{quantity}.{wall}"
        for quantity in WALL_QUANTITIES
        for wall, each in scene.walls.items()
        if each.motion
    ]
    names += [f"{quantity}.{wall}" for quantity in WALL_FLOW_QUANTITIES for wall in scene.walls]
    worn = [wall for wall, each in scene.walls.items() if each.wear is not None]
    names += [f"{quantity}.{wall}" for quantity in WEAR_QUANTITIES for wall in worn]
    names += [f"{quantity}.{outlet}" for quantity in OUTLET_QUANTITIES for outlet in scene.outlets]
    names += [f"{quantity}.{group}" for quantity in INSERTION_QUANTITIES for group in scene.particles]
    return tuple(names)
