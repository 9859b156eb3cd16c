"""Verbs for a scene: run, check, schema; and cache, for what is kept between runs."""

import argparse
import json
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_allow_long, add_machine, add_scene_verb, load, quantity, thread_count
from granflow.cli.messages import sigterm_as_exception, warn
from granflow.errors import GranflowError

RESULT_FILES = (
    *("particles.pvd", "contacts.pvd", "walls.pvd", "particles_*.vtu", "contacts_*.vtu", "walls_*.vtu"),
    *("fields_*.pvd", "fields_*.vtu", "measured/fields_*.pvd", "measured/fields_*.vtu", "measured/measured.csv"),
    *("timeseries.csv", "result.json", "scene_as_run.yaml", "run.log", "checkpoint_*.npz"),
    *("report.html", "pictures/picture_*.png", "pictures/film_*.mp4"),
)
"""What a run writes into its directory, as patterns: tells an earlier run from other files."""


def run(options: argparse.Namespace) -> int:
    """`granflow run`: simulate a scene into a directory, then show the numbers and the expectations."""
    scene = load(options)
    out = options.out or Path("out") / scene.path.stem
    make_room(out, options.force)
    from granflow.cli.resume import run_to_the_end
    from granflow.simulation import Simulation
    from granflow.study.restitution import warnings as restitution_warnings

    with sigterm_as_exception():
        simulation = Simulation(
            scene, arch=options.arch, threads=options.threads, out=out, progress=True, allow_long=options.allow_long
        )
        warn([*simulation.plan.warnings, *restitution_warnings(simulation.plan)])
    return run_to_the_end(simulation, scene, out, options.until)


def make_room(out: Path, force: bool) -> None:
    """Refuse a directory that holds an earlier run, or with `force` remove that run's files and no others."""
    from granflow.observe import locked

    if not out.exists():
        return
    with locked(out):
        earlier = [path for pattern in RESULT_FILES for path in out.glob(pattern)]
        if earlier and not force:
            raise GranflowError(
                f"{out} holds an earlier run: name another with --out, replace it with --force, or go on with it: "
                f"granflow resume {out}."
            )
        for path in earlier:
            path.unlink()


def check(options: argparse.Namespace) -> int:
    """`granflow check`: find every problem of a scene without running it: also too large a step, too little room."""
    scene = load(options)
    from granflow.observe import earlier_grains
    from granflow.plan import plan_for
    from granflow.plan.room import fits, memory_warning, refuse_too_many
    from granflow.plan.run_time import refuse_run_time
    from granflow.scene.generate import initial_grains, streams

    plan = plan_for(scene)
    refuse_too_many(plan)
    refuse_run_time(plan, options.allow_long)
    warn([*plan.warnings, *filter(None, [memory_warning(plan)])])
    for note in plan.mesh_notes:
        if not note.warning:
            print(f"walls.{note.wall}: {note.sentence}.")
    if not fits(plan):
        print(f"{options.scene}: no problems found, but placing the particles was not tried.")
        return 0
    initial_grains(scene, earlier_grains(scene))
    streams(scene)
    print(f"{options.scene}: no problems found.")
    return 0


def schema(options: argparse.Namespace) -> int:
    """`granflow schema`: the JSON Schema of scene files, for editors."""
    from granflow.scene import json_schema

    print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
    return 0


def cache(options: argparse.Namespace) -> int:
    """`granflow cache`: where compiled kernels are kept between runs, and how many; --clear deletes them."""
    from granflow.device.cache import VARIABLE, cache_folder, clear, contents

    held = clear() if options.clear else contents()
    done = "deleted" if options.clear else "kept"
    print(f"{cache_folder()}: {held.kernel_count} compiled kernels, {held.size / 1e6:.1f} MB {done}.")
    print(f"{VARIABLE} names another folder.")
    return 0


def add_check(verbs: Any) -> None:
    """`granflow check` and its arguments."""
    add_allow_long(add_scene_verb(verbs, check, "find every problem of a scene without running it"))


def add_run(verbs: Any) -> None:
    """`granflow run` and its arguments."""
    parser = add_scene_verb(verbs, run, "simulate a scene and write what ParaView opens")
    add_allow_long(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, help="where results go (out/ and the scene's name)")
    parser.add_argument("--until", metavar="T", type=quantity("time"), help="stop at this simulated time, such as 0.2s")
    parser.add_argument("--threads", metavar="N", type=thread_count, help="CPU threads (all)")
    parser.add_argument("--force", action="store_true", help="replace an earlier run in the same directory")
    add_machine(parser)


def add_cache(verbs: Any) -> None:
    """`granflow cache` and its argument."""
    summary = "show where compiled kernels are kept between runs"
    parser = verbs.add_parser("cache", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("--clear", action="store_true", help="delete them; the next run compiles anew")
    parser.set_defaults(verb=cache)
