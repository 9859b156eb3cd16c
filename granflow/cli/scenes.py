"""The verbs run, check, schema, and cache (compiled kernels).

`check` reports the errors of a scene, its time step and its packing without a run.
"""

import argparse
import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import (
    add_allow_long,
    add_machine,
    add_mpi,
    add_scene_verb,
    load,
    load_runnable,
    simulated_time,
    thread_count,
)
from granflow.cli.messages import say, say_checked, warned
from granflow.cli.quick_start import quick_start
from granflow.errors import GranflowError

if TYPE_CHECKING:
    from granflow.load import Scene
    from granflow.parallel.communicator import Communicator
    from granflow.plan.plan import Plan


def run(options: argparse.Namespace) -> int:
    """`granflow run`: simulate a scene, write the results to a directory, and print the numbers and expectations.

    Returns the exit code of `run_to_end`. Raises SceneError for a group without particles, and GranflowError if the
    directory contains an earlier run, unless --overwrite is given, or if the launch does not match --mpi.
    """
    from granflow.cli.ranks import on_ranks
    from granflow.parallel.launch import refuse_without_mpi_flag

    if options.mpi:
        return on_ranks(options, partial(run_scene, options), partial(scene_and_plan, options))
    refuse_without_mpi_flag()
    return run_scene(options)


def scene_and_plan(options: argparse.Namespace) -> "tuple[Scene, Plan]":
    """The scene of a run and its plan."""
    from granflow.plan.build import plan_for

    scene = load_runnable(options)
    return scene, plan_for(scene)


def run_scene(options: argparse.Namespace, communicator: "Communicator | None" = None) -> int:
    """Run a scene, on the ranks of the communicator if there is one. Returns and raises as `run`."""
    with quick_start():
        scene = load_runnable(options)
        out = options.out or Path("out") / scene.path.stem
        printed = prepare_output(out, scene, options.overwrite)
        from granflow.cli.resume import run_to_end
        from granflow.io.lock import locked
        from granflow.simulation import Simulation

        simulation = Simulation(
            scene, arch=options.arch, threads=options.threads, out=out, progress=True, allow_long=options.allow_long,
            communicator=communicator, overwrite=options.overwrite,
        )  # fmt: skip
        simulation.warnings.extend(restitution_warnings(scene, simulation.plan))
    with locked(out):
        # another process may have used the directory in the meantime
        printed += prepare_output(out, scene, options.overwrite)
        return run_to_end(simulation, scene, out, options.until, printed)


def prepare_output(out: Path, scene: "Scene", overwrite: bool) -> list[str]:
    """Check the output directory of a new run; print and return warnings about it.

    Raises GranflowError if it contains an earlier run, unless `overwrite` is set and the scene reads no file from it.
    The new run replaces the earlier one after its first frame.
    """
    from granflow.io.lock import locked
    from granflow.runs.previous import refuse_inputs_inside, restore_previous_run, results_in

    if not out.exists():
        return []
    with locked(out):
        notes = warned(restore_previous_run(out))
        if not results_in(out):
            return notes
        refuse_inputs_inside(scene, out)
        if not overwrite:
            raise GranflowError(
                f"{out} contains an earlier run: give another directory with --out, replace it with --overwrite, or "
                f"continue it with granflow resume {out}."
            )
        return notes


@quick_start()
def check(options: argparse.Namespace) -> int:
    """`granflow check`: report all errors of a scene, also of time step, packing and memory, without a run.

    The first line has the number of warnings, which follow on stderr. Returns 0; raises SceneError with the problems.
    If the particles do not fit into the memory, their packing is not checked.
    """
    scene = load(options)
    from granflow.particles.generate import initial_particles
    from granflow.particles.insertion import inserters
    from granflow.plan.build import plan_for
    from granflow.plan.forecast.initial_overlaps import refuse_initial_overlaps
    from granflow.plan.forecast.regions import particle_warnings
    from granflow.plan.memory_check import fits, memory_warning, refuse_too_many
    from granflow.plan.run_time import refuse_run_time
    from granflow.runs.initial_from_run import particles_from_run
    from granflow.runs.ranks import refuse_on_ranks

    plan = plan_for(scene)
    if options.mpi:
        refuse_on_ranks(scene=scene)
    else:  # a rank has a part of the particles only
        refuse_too_many(plan)
    refuse_run_time(plan, options.allow_long)
    found = [*scene.problems_without_program(), *plan.warnings, *filter(None, [memory_warning(plan)])]
    found += restitution_warnings(scene, plan)
    for note in plan.mesh_notes:
        if not note.warning:
            say(f"walls.{note.wall}: {note.sentence}.")
    if not fits(plan):
        return say_checked(options.scene, found, ", but the packing of the particles was not checked")
    particles = initial_particles(scene, particles_from_run(scene))
    refuse_initial_overlaps(scene, particles)
    found += particle_warnings(scene, plan, particles)
    inserters(scene)
    return say_checked(options.scene, found)


def restitution_warnings(scene: "Scene", plan: "Plan") -> list[str]:
    """Sentences on restitutions that the time step does not reproduce."""
    from granflow.studies.restitution import warnings

    return warnings(scene, plan)


def schema(options: argparse.Namespace) -> int:
    """`granflow schema`: print the JSON Schema of scene files (draft 2020-12), for editors.

    `granflow schema KEY.PATH`: print the reference of a key or block. Raises GranflowError for an unknown key.
    """
    if options.key is not None:
        from granflow.scene.reference.terminal import reference_of

        try:
            say(reference_of("" if options.key == "scene" else options.key))
        except KeyError as error:
            raise GranflowError(error.args[0]) from None
        return 0
    from granflow.scene.jsonschema import json_schema

    say(json.dumps(json_schema(), indent=2, ensure_ascii=False))
    return 0


def cache(options: argparse.Namespace) -> int:
    """`granflow cache`: print the directory of compiled kernels, their number and size [MB]; --clear deletes them."""
    from granflow.engine.kernel_cache import VARIABLE, cache_contents, cache_folder, clear_cache

    cached = clear_cache() if options.clear else cache_contents()
    done = "deleted" if options.clear else "cached"
    say(f"{cache_folder()}: {cached.kernel_count} compiled kernels, {cached.size / 1e6:.1f} MB {done}.")
    say(f"The environment variable {VARIABLE} selects another directory.")
    return 0


def add_check(verbs: Any) -> None:
    """Add `granflow check` and its arguments."""
    parser = add_scene_verb(verbs, check, "report all errors of a scene without running it")
    add_allow_long(parser)
    parser.add_argument("--mpi", action="store_true", help="for a run on MPI ranks, each with a part of the particles")


def add_run(verbs: Any) -> None:
    """Add `granflow run` and its arguments."""
    parser = add_scene_verb(verbs, run, "run a simulation and write the results as files for ParaView")
    add_allow_long(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, help="output directory (default: out/SCENE)")
    parser.add_argument("--until", metavar="T", type=simulated_time, help="stop at this simulated time, such as 0.2s")
    parser.add_argument(
        "--threads", metavar="N", type=thread_count, help="CPU threads (default: cores available to this process)"
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace an earlier run in the same directory after the first frame of the new run",
    )
    add_mpi(parser)
    add_machine(parser)


def add_schema(verbs: Any) -> None:
    """Add `granflow schema` and its argument."""
    summary = "print the reference of a scene key or block, or the JSON Schema of scene files for editors"
    parser = verbs.add_parser("schema", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument(
        "key", metavar="KEY.PATH", nargs="?",
        help="key such as run.time_step, walls.rectangle.sides or motion.servo; a block lists its keys; "
        "scene: the first level; without it, the JSON Schema",
    )  # fmt: skip
    parser.set_defaults(verb=schema)


def add_cache(verbs: Any) -> None:
    """Add `granflow cache` and its argument."""
    summary = "print the path of the kernel cache (compiled kernels, reused to shorten the start of later runs)"
    parser = verbs.add_parser("cache", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("--clear", action="store_true", help="delete the compiled kernels; the next run compiles again")
    parser.set_defaults(verb=cache)
