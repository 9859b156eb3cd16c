"""The verbs that concern a scene: run, resume, check, explain, schema, examples, example; and cache.

`run` and `resume` end in `run_to_end`, which runs a simulation with signal handling and prints its results.
With --mpi, the root rank carries out the verb, and the other ranks compute their part of each step.
`check` and `explain` make the plan of a run without starting it.
"""

import argparse
import json
import logging
import os
import shutil
from collections.abc import Callable, Sequence
from filecmp import cmp
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import (
    add_machine,
    add_overrides,
    add_scene_verb,
    add_verb,
    load,
    load_runnable,
    print_error,
    say,
    simulated_time,
    thread_count,
    warn,
    warned,
)
from granflow.cli.process import compiling_shown, deferred_to, exit_code_of, pass_stops_to, quick_start
from granflow.errors import GranflowError
from granflow.visible_text import numbered, visible

if TYPE_CHECKING:
    from granflow.io.checkpoint import Checkpoint
    from granflow.load import Scene
    from granflow.parallel.communicator import Communicator
    from granflow.parallel.rank_engine import RankEngine
    from granflow.plan.plan import Plan
    from granflow.runs.result import Result
    from granflow.simulation import Simulation

EXIT_EXPECTATIONS_FAILED = 1
"""Exit code of a complete run with an expectation that is not satisfied."""
LONG_RUN = 60.0
"""Wall-clock time of steps [s] from which faster kernels are worth an installation."""

# run


def run(options: argparse.Namespace) -> int:
    """`granflow run`: simulate a scene, write the results to a directory, and print numbers and expectations.

    Returns the exit code of `run_to_end`. Raises SceneError for a group without particles, and GranflowError
    if the directory contains an earlier run, unless --overwrite is given, or if the launch does not match
    --mpi.
    """
    from granflow.parallel.refusals import refuse_without_mpi_flag

    if options.mpi:
        return on_ranks(options, partial(run_scene, options), partial(plan_of_run, options))
    refuse_without_mpi_flag()
    return run_scene(options)


def add_run(verbs: Any) -> None:
    """Add `granflow run` and its arguments."""
    parser = add_scene_verb(verbs, run, "run a simulation and write the results as files for ParaView")
    add_allow_long(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, help="output directory (default: out/SCENE)")
    parser.add_argument(
        "--until", metavar="T", type=simulated_time, help="stop at this simulated time, such as 0.2s"
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        type=thread_count,
        help="CPU threads (default: cores available to this process)",
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace an earlier run in the same directory after the first frame of the new run",
    )
    add_mpi(parser)
    add_machine(parser)


def run_scene(options: argparse.Namespace, communicator: "Communicator | None" = None) -> int:
    """Run a scene, on the ranks of the communicator if there is one. Returns and raises as `run`."""
    with quick_start():
        scene = load_runnable(options)
        out = options.out or Path("out") / scene.path.stem
        printed = prepare_output(out, scene, options.overwrite)
        from granflow.io.lock import locked

        # After the checks of scene and directory, because its import of Taichi takes most of the time.
        simulation = simulation_of(scene, options, out, communicator, overwrite=options.overwrite)
    with locked(out):
        # Another process may have used the directory in the meantime.
        printed += prepare_output(out, scene, options.overwrite)
        return run_to_end(simulation, scene, out, options.until, printed)


def simulation_of(
    scene: "Scene",
    options: argparse.Namespace,
    out: Path,
    communicator: "Communicator | None",
    overwrite: bool,
    resume: "Checkpoint | None" = None,
    allow_changes: bool = False,
) -> "Simulation":
    """The simulation of `granflow run` and of `granflow resume`; arguments as those of `Simulation`."""
    from granflow.simulation import Simulation

    with compiling_shown():
        return Simulation(
            scene,
            arch=options.arch,
            threads=options.threads,
            out=out,
            progress=True,
            resume=resume,
            allow_changes=allow_changes,
            allow_long=options.allow_long,
            communicator=communicator,
            overwrite=overwrite,
        )


def prepare_output(out: Path, scene: "Scene", overwrite: bool) -> list[str]:
    """Check the output directory of a new run; print and return warnings about it.

    Raises GranflowError if it contains an earlier run, unless `overwrite` is set and the scene reads no file
    from it. The new run replaces the earlier one after its first frame.
    """
    from granflow.io.lock import locked
    from granflow.runs.run_directory import refuse_inputs_inside, restore_previous_run, results_in

    if not out.exists():
        return []
    with locked(out):
        notes = warned(restore_previous_run(out))
        if not results_in(out):
            return notes
        refuse_inputs_inside(scene, out)
        if not overwrite:
            raise GranflowError(
                f"{out} contains an earlier run: give another directory with --out, replace it with "
                f"--overwrite, or continue it with granflow resume {out}."
            )
        return notes


def run_to_end(
    simulation: "Simulation", scene: "Scene", out: Path, until: float | None, printed: Sequence[str] = ()
) -> int:
    """Print the warnings, run with signal handling, print the numbers, and return the exit code.

    until:    simulated time at which the run ends [s], or None
    printed:  warnings on stderr so far, which run.log and result.json contain too
    Returns:  0, or 1 if an expectation is not satisfied, 130 or 143 after a stop signal
    """
    say_checked(scene.path, simulation.warnings)
    simulation.warnings.extend(printed)
    try:
        from granflow.io.log import warnings_shown

        with deferred_to(simulation.request_stop), warnings_shown(simulation.warnings):
            result = simulation.run(until=until, within_stages=True)
            result = simulation.close() or result
    except KeyboardInterrupt as stop:
        return print_error(stopped_where(simulation, out), exit_code_of(stop))
    show_result(scene, result, out)
    say_of_faster_kernels(simulation, result)
    if until is not None and simulation.is_complete and simulation.time < until - simulation.time_step:
        say(f"The last stage ended at {simulation.time:.6g} s, before --until {until:.6g} s.")
    if scene.expect and not result.expectations:
        say(f"Expectations are not evaluated: --until ended the run at {simulation.time:.6g} s.")
    return 0 if all(met for _, met in result.expectations) else EXIT_EXPECTATIONS_FAILED


def say_of_faster_kernels(simulation: "Simulation", result: "Result") -> None:
    """Print that Quadrants is faster on this processor, after a run that is long against its start."""
    from granflow.kernel_language import slower_than_quadrants

    steps = sum(result.timings.get(phase, 0.0) for phase in ("neighbor_list", "forces", "integration"))
    if steps > LONG_RUN and simulation.engine.state.backend.on_cpu and (sentence := slower_than_quadrants()):
        say(sentence)


def stopped_where(simulation: "Simulation", out: Path) -> str:
    """Return a sentence with the time [s] at which a run stopped and that of its last checkpoint."""
    at = f"stopped at {simulation.time:.6g} s"
    saved = simulation.files.checkpoint_time
    if saved == simulation.time:
        return f"{at}; granflow resume {out} continues. {out} contains the run up to this time."
    if saved is None:
        return f"{at}, before the first checkpoint."
    return f"{at}; the last checkpoint is at {saved:.6g} s, and granflow resume {out} continues from there."


def show_result(scene: "Scene", result: "Result", out: Path) -> None:
    """Print the table of results, the expectations, and the files to open.

    `out`: output directory of the run. Expectations that are not satisfied begin with NOT AS EXPECTED.
    """
    from rich.console import Console

    from granflow.runs.result import STAGE_ENDS, closing_table

    moving = {name for name, wall in scene.walls.items() if any(not each.is_belt for each in wall.motion)}
    Console().print(closing_table(result, visible(scene.title), moving))
    for sentence, met in result.expectations:
        say(sentence if met else f"NOT AS EXPECTED: {sentence}")
    series = sorted(str(path) for path in out.glob("*.pvd"))
    if series:
        say(f"For ParaView: {', '.join(series)}")
    ends = out / STAGE_ENDS
    stages = f"; at the end of each stage: {ends}" if ends.exists() else ""
    say(f"All numbers: {out / 'result.json'}; over time: {out / 'timeseries.csv'}{stages}")


# resume

SCENE = "scene_as_run.yaml"
"""Name of the resolved scene in the output directory."""
RESULT_SUFFIXES = (".vtu", ".pvtu", ".csv", ".npz")
"""File types of results that take computing time."""
CHANGES = """\
These keys may change, with --set or in scene_as_run.yaml; a change of any other key is an error:
  output.interval, .timeseries_interval, .particles, .frames_per_rank, .contacts, .walls, .checkpoint
  run.duration; duration, kinetic_energy_below, until, min_duration and max_duration of the current stage \
and later
    ones, or of the last stage of a completed run
  a new stage at the end, such as --set 'stages.2={name: more, duration: 0.5 s}' after stages 0 and 1
  stages, appears_at and vanishes_at of walls: opening a gate
  motion of walls, if the position remains continuous: end a motion with end: and add another with start:
  friction and rolling_friction of pairs, if both the old and the new value are above 0
  numerics.max_overlap, title, description, expect
"""
"""End of the help text; `granflow.runs.resume.ALLOWED_CHANGES` defines the keys."""


def resume(options: argparse.Namespace) -> int:
    """`granflow resume`: continue from the newest intact checkpoint, bit-identical to an uninterrupted run.

    Raises GranflowError if the directory does not exist, is locked by another run, contains no usable
    checkpoint, or if the scene has changes that are not permitted.
    """
    if not options.directory.is_dir():
        raise GranflowError(f"{options.directory}: no such directory; give the directory of a run.")
    from granflow.parallel.refusals import refuse_without_mpi_flag

    if options.mpi:
        return on_ranks(options, partial(resume_locked, options), partial(resumed_plan, options))
    refuse_without_mpi_flag()
    return resume_locked(options)


def add_resume(verbs: Any) -> None:
    """Add `granflow resume` and its arguments; the help text ends with the keys that may change."""
    summary = (
        "continue a stopped or killed run, bit-identical to an uninterrupted one, or extend a completed run"
    )
    parser = add_verb(verbs, resume, summary)
    parser.epilog = CHANGES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("directory", metavar="DIR", type=Path, help="directory of the run")
    add_overrides(parser, "override a value that may change, such as --set walls.gate.vanishes_at=1.2s")
    parser.add_argument(
        "--allow-changes",
        action="store_true",
        help="continue even if the scene or the time series has changed",
    )
    parser.add_argument(
        "--from-start",
        action="store_true",
        help="run the scene from the start, without a checkpoint; replaces the results",
    )
    parser.add_argument(
        "--until",
        metavar="T",
        type=simulated_time,
        help="stop at this simulated time, such as 0.2s, between that of the checkpoint and the end of the "
        "run; to continue beyond the end, change the scene, such as --set run.duration=2s",
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        type=thread_count,
        help="CPU threads (default: cores available to this process)",
    )
    add_mpi(parser)
    add_allow_long(parser)
    add_machine(parser)


def resume_locked(options: argparse.Namespace, communicator: "Communicator | None" = None) -> int:
    """Resume, on the ranks of the communicator if there is one, in the locked directory.

    The lock prevents that another process continues or replaces the run at the same time.
    """
    from granflow.io.lock import locked

    with locked(options.directory):
        return _resume(options, communicator)


def _resume(options: argparse.Namespace, communicator: "Communicator | None") -> int:
    """Raises GranflowError if rows of the time series are missing, unless --allow-changes is given."""
    out: Path = options.directory
    printed: list[str] = []
    checkpoint = checkpoint_to_resume(out, options.from_start, printed, communicator is not None)
    scene = scene_to_resume(options, checkpoint)
    simulation = simulation_of(
        scene,
        options,
        out,
        communicator,
        overwrite=True,
        resume=checkpoint,
        allow_changes=options.allow_changes,
    )
    if not (simulation.observers.rows_intact or options.allow_changes):
        raise GranflowError(
            f"{out / 'timeseries.csv'} lacks rows that were written before the checkpoint: restore the file, "
            "or continue with the remaining rows with --allow-changes."
        )
    if checkpoint:
        say_start(simulation, scene, checkpoint, options.until)
    return run_to_end(simulation, scene, out, options.until, printed)


def checkpoint_to_resume(
    out: Path, from_start: bool, printed: list[str], on_ranks: bool = False
) -> "Checkpoint | None":
    """Return the newest intact checkpoint, or None to run from the start.

    from_start:  whether the user wants a run from the start, also if there are results
    printed:     gets the warnings on damaged checkpoints and on a restored previous run, printed to stderr
    on_ranks:    whether each rank reads its part of the particles later
    Raises:      GranflowError if there are results without a usable checkpoint, unless `from_start` is set
    """
    from granflow.io.checkpoint import newest_checkpoint
    from granflow.runs.run_directory import restore_previous_run, results_in

    printed += warned(restore_previous_run(out))
    if from_start:
        return None
    checkpoint, skipped = newest_checkpoint(out, "root" if on_ranks else "all")
    printed += warned(skipped)
    results = [path for path in results_in(out) if path.suffix in RESULT_SUFFIXES]
    if checkpoint is None and results and (out / SCENE).exists():
        raise GranflowError(
            f"{out} contains no usable checkpoint, but {len(results)} result files: to replace them and run "
            f"the scene from the start, use granflow resume {out} --from-start."
        )
    if checkpoint is None and (out / SCENE).exists():
        printed += warned(
            [f"{out} contains neither a checkpoint nor results: the run begins from the start."]
        )
    return checkpoint


def scene_to_resume(options: argparse.Namespace, checkpoint: "Checkpoint | None") -> "Scene":
    """Return the resolved scene, or that of the checkpoint if the file is missing, with the overrides.

    Raises GranflowError if neither exists.
    """
    from granflow.load import load_scene, scene_of

    path = options.directory / SCENE
    overrides = list(options.overrides)
    if options.precision:
        overrides.append(f"run.precision={options.precision}")
    if path.exists():
        return load_scene(path, overrides)
    if checkpoint is None:
        raise GranflowError(f"{options.directory} contains no run: neither a usable checkpoint nor {SCENE}.")
    return scene_of(checkpoint.scene, str(checkpoint.path), overrides)


def say_start(
    simulation: "Simulation", scene: "Scene", checkpoint: "Checkpoint", until: float | None
) -> None:
    """Print the checkpoint and its time, and whether no step is left; `until`: end of the run [s] or None.

    Raises GranflowError if `until` is before the checkpoint, or after the end of a complete run.
    """
    time = simulation.time
    step = simulation.time_step
    if until is not None and until < time - step:
        raise GranflowError(
            f"--until is {until:.6g} s, but {checkpoint.path} is at {time:.6g} s: give a later time, or omit "
            "--until."
        )
    if until is not None and until > time + step and simulation.is_complete:
        raise GranflowError(
            f"--until is {until:.6g} s, but the run is complete at {time:.6g} s: "
            f"{extension(scene, checkpoint, until)}."
        )
    say(f"Continues from {checkpoint.path} at {time:.6g} s.")
    if simulation.is_complete:
        longer = extension(scene, checkpoint, float(f"{2.0 * time:.2g}"))
        say(f"The run is complete, so no step is taken. To continue it, {longer}.")
    elif until is not None and until <= time + 0.5 * step:
        say(f"The run is at --until {until:.6g} s, so no step is taken.")


def extension(scene: "Scene", checkpoint: "Checkpoint", until: float) -> str:
    """Instruction that extends a complete run to the time `until` [s]."""
    if not scene.stages:
        return f"extend it with --set run.duration={until:.6g}s"
    index = len(scene.stages) - 1
    stage = scene.stages[-1]
    if stage.duration is None:  # one of its conditions is satisfied
        return f"add a stage after {stage.name} in {checkpoint.path.with_name(SCENE)}"
    began = checkpoint.saved["stage_progress"]["stage_times"][stage.name][0]
    return f"extend it with --set stages.{index}.duration={until - began:.6g}s"


# --mpi of run and resume


def add_mpi(parser: argparse.ArgumentParser) -> None:
    """Add --mpi."""
    parser.add_argument(
        "--mpi", action="store_true", help="distribute the particles over the ranks of mpirun; needs mpi4py"
    )


def on_ranks(
    options: argparse.Namespace, run: "Callable[[Communicator], int]", plan: "Callable[[], Plan]"
) -> int:
    """Run a scene on all ranks and return the exit code; 0 on all but the root.

    run:   what the root does, with the communicator
    plan:  what the others read when the root has a plan

    Raises GranflowError without mpi4py, and on the root the exceptions of `run`.
    """
    from granflow.parallel.communicator import Communicator
    from granflow.parallel.rank_engine import controlling, serve

    communicator = Communicator()
    options.threads = options.threads or threads_per_rank(communicator)
    if communicator.is_root:
        with controlling(communicator):
            return run(communicator)
    stop = RankStop()
    pass_stops_to(stop.request)
    logging.getLogger("granflow").setLevel(logging.CRITICAL)
    serve(communicator, lambda: stop.applied_to(_rank_engine(options, communicator, plan())))
    return 0


def plan_of_run(options: argparse.Namespace) -> "Plan":
    """The plan of the scene of a run."""
    from granflow.plan.build import plan_for

    return plan_for(load_runnable(options))


def resumed_plan(options: argparse.Namespace) -> "Plan":
    """The plan of the run that the root resumes, on another rank."""
    from granflow.io.checkpoint import newest_checkpoint
    from granflow.plan.build import plan_for
    from granflow.runs.resume import changed_plan

    checkpoint = None if options.from_start else newest_checkpoint(options.directory, "header")[0]
    plan = plan_for(scene_to_resume(options, checkpoint))
    return plan if checkpoint is None else changed_plan(plan, checkpoint)


def _rank_engine(options: argparse.Namespace, communicator: "Communicator", plan: "Plan") -> "RankEngine":
    """The engine of a rank that is not the root."""
    from granflow.engine.state_cache import start
    from granflow.parallel.rank_engine import RankEngine

    return RankEngine(plan, start("cpu", plan.scene.run.precision, options.threads), communicator)


class RankStop:
    """A stop signal that a rank other than the root has received; in the next step all ranks agree on it."""

    def __init__(self) -> None:
        self._number = 0
        self._engine: RankEngine | None = None

    def request(self, number: int) -> None:
        """Request the stop of the run; `number`: of the signal."""
        self._number = number
        if self._engine is not None:
            self._engine.stepper.requested_stop = number

    def applied_to(self, engine: "RankEngine") -> "RankEngine":
        """The engine of this rank, with the request that came before it."""
        self._engine = engine
        engine.stepper.requested_stop = self._number
        return engine


def threads_per_rank(communicator: "Communicator") -> int:
    """CPU threads of each rank.

    They are its cores if mpirun has bound it to some, otherwise an equal part of those of the machine.
    """
    from granflow.io.machine import allowed_cores

    cores = allowed_cores()
    ranks = communicator.local_size()
    return max(cores // ranks if cores == os.cpu_count() else cores, 1)


# check


@quick_start()
def check(options: argparse.Namespace) -> int:
    """`granflow check`: report all errors of a scene, also of time step, packing and memory, without a run.

    The first line has the number of warnings, which follow on stderr. Returns 0; raises SceneError with the
    problems. If the particles do not fit into the memory, their packing is not checked.
    """
    scene = load(options)
    from granflow.parallel.refusals import refuse_on_ranks
    from granflow.particles.insertion import inserters
    from granflow.plan.build import plan_for
    from granflow.plan.cost import fits, memory_warning, refuse_run_time, refuse_too_many
    from granflow.plan.restitution import restitution_warnings
    from granflow.runs.initial_particles import checked_particles

    plan = plan_for(scene)
    if options.mpi:
        refuse_on_ranks(scene=scene)
    else:  # a rank has a part of the particles only
        refuse_too_many(plan)
    refuse_run_time(plan, options.allow_long)
    found = [*scene.problems_without_program(), *plan.warnings, *filter(None, [memory_warning(plan)])]
    found += restitution_warnings(plan)
    for note in plan.wall_notes:
        if not note.warning:
            say(f"walls.{note.wall}: {note.sentence}.")
    if not fits(plan):
        return say_checked(options.scene, found, ", but the packing of the particles was not checked")
    found += checked_particles(plan)
    inserters(scene)
    return say_checked(options.scene, found)


def add_check(verbs: Any) -> None:
    """Add `granflow check` and its arguments."""
    parser = add_scene_verb(verbs, check, "report all errors of a scene without running it")
    add_allow_long(parser)
    parser.add_argument(
        "--mpi", action="store_true", help="for a run on MPI ranks, each with a part of the particles"
    )


def add_allow_long(parser: argparse.ArgumentParser) -> None:
    """Add --allow-long."""
    parser.add_argument(
        "--allow-long", action="store_true", help="accept a run estimated to take more than a year"
    )


def say_checked(path: Path, warnings: Sequence[str], remark: str = "") -> int:
    """Print that the scene at `path` has no errors and how many warnings, then the warnings; return 0."""
    result = f"no errors, {numbered(len(warnings), 'warning')}" if warnings else "no problems found"
    say(f"{path}: {result}{remark}.", flush=True)
    warn(warnings)
    return 0


# explain


def explain(options: argparse.Namespace) -> int:
    """`granflow explain`: print features, defaults, time step, memory and run time."""
    from granflow.plan.build import plan_for
    from granflow.plan.explain import explain as explain_plan
    from granflow.plan.restitution import restitution_remarks

    plan = plan_for(load(options), on_gpu=options.arch != "cpu")
    say(explain_plan(plan))
    if found := restitution_remarks(plan):
        say("\nRestitution at this time step")
        for each in found:
            say(f"  {each}")
    return 0


def add_explain(verbs: Any) -> None:
    """Add `granflow explain` and its arguments."""
    parser = add_scene_verb(
        verbs,
        explain,
        "print features with their reasons, defaults, the time step and its limit, the memory estimate",
    )
    add_machine(parser)


# schema


def schema(options: argparse.Namespace) -> int:
    """`granflow schema`: print the JSON Schema of scene files (draft 2020-12), for editors.

    `granflow schema KEY.PATH`: print the reference of a key or block. Raises GranflowError for an unknown
    key.
    """
    if options.key is not None:
        from granflow.scene.reference import reference_of

        try:
            say(reference_of("" if options.key == "scene" else options.key))
        except KeyError as error:
            raise GranflowError(error.args[0]) from None
        return 0
    from granflow.scene.reference import json_schema

    say(json.dumps(json_schema(), indent=2, ensure_ascii=False))
    return 0


def add_schema(verbs: Any) -> None:
    """Add `granflow schema` and its argument."""
    summary = "print the reference of a scene key or block, or the JSON Schema of scene files for editors"
    parser = add_verb(verbs, schema, summary)
    parser.add_argument(
        "key",
        metavar="KEY.PATH",
        nargs="?",
        help="key such as run.time_step, walls.rectangle.sides or motion.servo; a block lists its keys; "
        "scene: the first level; without it, the JSON Schema",
    )


# examples and example

VERBS = {"sweeps": "sweep", "calibration": "calibrate"}
"""Folders of shipped files that are not scenes, and the verbs that run them."""


def examples(options: argparse.Namespace) -> int:
    """`granflow examples`: list the names and titles of the shipped scenes, sweeps and calibrations."""
    from granflow.io.files import example_paths
    from granflow.schema.document import parse

    paths = example_paths()
    width = max(map(len, paths))
    for name, path in paths.items():
        title = parse(path.read_text(encoding="utf-8"), str(path), with_positions=False).find(("title",))
        say(f"{name:{width}}  {title.scalar if title else ''}")
    return 0


def add_examples(verbs: Any) -> None:
    """Add `granflow examples`."""
    add_verb(verbs, examples, "list the scenes that are part of the package")


def example(options: argparse.Namespace) -> int:
    """`granflow example NAME`: copy a shipped scene and its input files.

    Returns 0. Raises GranflowError for an unknown name, and for a file that exists with other contents.
    """
    from granflow.load import load_scene
    from granflow.runs.run_directory import input_files

    source = example_path(options.name)
    scenes = _scenes_of(source)
    inputs = [path for scene in scenes for _, path in input_files(load_scene(scene))]
    folder = source.parent if source in scenes else source.parents[1]
    targets = {path: options.out / path.relative_to(folder) for path in (source, *scenes, *inputs)}
    for path, target in targets.items():
        if target.exists() and not cmp(path, target, shallow=False):
            raise GranflowError(
                f"{target} exists with other contents: remove it, or give another directory with --out."
            )
    for path, target in targets.items():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
        say(str(target))
    say(f"Run it with granflow {VERBS.get(source.parent.name, 'run')} {targets[source]}")
    return 0


def add_example(verbs: Any) -> None:
    """Add `granflow example` and its arguments."""
    parser = add_verb(
        verbs, example, "copy a scene that is part of the package, with its meshes and particle files"
    )
    parser.add_argument("name", metavar="NAME", help="name of the scene, such as hopper")
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        default=Path(),
        help="directory of the copies (default: working directory)",
    )


def _scenes_of(source: Path) -> list[Path]:
    """The scene itself, or the scenes of a sweep or a calibration."""
    verb = VERBS.get(source.parent.name)
    if verb == "sweep":
        from granflow.studies.sweep import read_sweep

        return [read_sweep(source).scene.resolve()]
    if verb == "calibrate":
        from granflow.studies.calibration.calibrate import read_calibration

        return [path.resolve() for path in read_calibration(source).scenes.values()]
    return [source]


def example_path(name: str) -> Path:
    """Path of a shipped scene, such as hopper or verification/incline.

    Raises GranflowError for an unknown name.
    """
    from granflow.io.files import example_paths
    from granflow.schema.messages import suggestion_or_list

    paths = example_paths()
    known = name.removesuffix(".yaml")
    if known not in paths:
        raise GranflowError(
            f"{name} is not one of the shipped scenes. {suggestion_or_list(known, paths, 'scenes')}"
        )
    return paths[known]


def scene_paths() -> dict[str, Path]:
    """Paths of the shipped scenes by name, without sweeps and calibrations."""
    from granflow.io.files import example_paths

    return {name: path for name, path in example_paths().items() if path.parent.name not in VERBS}


# cache


def cache(options: argparse.Namespace) -> int:
    """`granflow cache`: print the directory of compiled kernels, their number and size [MB].

    With --clear, they are deleted.
    """
    from granflow.engine.kernel_cache import CACHE_VARIABLE, cache_contents, cache_folder, clear_cache

    if options.clear:
        cached = clear_cache()
        done = "deleted"
    else:
        cached = cache_contents()
        done = "cached"
    say(f"{cache_folder()}: {cached.kernel_count} compiled kernels, {cached.size / 1e6:.1f} MB {done}.")
    say(f"The environment variable {CACHE_VARIABLE} selects another directory.")
    return 0


def add_cache(verbs: Any) -> None:
    """Add `granflow cache` and its argument."""
    summary = (
        "print the path of the kernel cache (compiled kernels, reused to shorten the start of later runs)"
    )
    parser = add_verb(verbs, cache, summary)
    parser.add_argument(
        "--clear", action="store_true", help="delete the compiled kernels; the next run compiles again"
    )
