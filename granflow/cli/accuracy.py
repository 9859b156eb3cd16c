"""`granflow accuracy`: error against run time.

Without a scene, collisions of two spheres are compared with exact solutions; with a scene, runs with several time steps
and seeds are compared with the finest time step.
"""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_out, add_overrides, add_verb, simulated_time
from granflow.cli.messages import exit_code_of, print_error, say, say_progress, show_table, write_study
from granflow.errors import GranflowError


def accuracy(options: argparse.Namespace) -> int:
    """`granflow accuracy`: measure error against run time, for binary collisions or for a scene.

    Writes a page, CSV files and figures, prints a recommendation and returns 0. Raises GranflowError for a target
    outside (0, 1), or for options that require a scene.
    """
    if not 0.0 < options.target < 1.0:
        raise GranflowError(f"--target is {options.target:g}, but must be between 0 and 1, such as 0.01.")
    return _binary_collisions(options) if options.scene is None else _scene(options)


def _binary_collisions(options: argparse.Namespace) -> int:
    """Measure head-on collisions of two spheres with all contact models, precisions and time steps.

    Raises GranflowError for options that require a scene.
    """
    for given, name in (
        (options.overrides, "--set"),
        (options.until, "--until"),
        (options.all_particles, "--all-particles"),
    ):
        if given:
            raise GranflowError(f"{name} requires a SCENE, which is missing.")
    from granflow.studies.accuracy.recommend import default_sentence, table_heads, table_rows
    from granflow.studies.accuracy.report import measure_two_bodies, write_two_bodies

    study = measure_two_bodies(options.target, options.full, say_progress)
    show_table("error against run time", table_heads(options.target), table_rows(study.lines, options.target))
    say(default_sentence(study.lines, options.target))
    write_study(options.out or Path("out/accuracy"), write_two_bodies, study)
    say(study.recommendation)
    return 0


def _scene(options: argparse.Namespace) -> int:
    """Measure a scene; it is reduced to a run time of minutes unless --all-particles is given."""
    from granflow.studies.accuracy.scene_points import measure_scene
    from granflow.studies.accuracy.scene_report import (
        noise_sentence,
        scene_heads,
        scene_recommendation,
        scene_rows,
        write_scene,
    )
    from granflow.studies.accuracy.scene_runs import KeptRuns, SceneTask, reduced_counts

    task = SceneTask(options.scene, tuple(options.overrides), options.until)
    reductions = [] if options.all_particles else reduced_counts(task.scene())
    if reductions:
        say(f"Reduced scene for a run time of minutes: {', '.join(reductions)}; --all-particles runs the full scene.")
    out = options.out or Path("out") / f"accuracy_{options.scene.stem}"
    kept = out / "accuracy_runs.json"
    try:
        study = measure_scene(
            task.with_overrides(*reductions), options.target, options.full, say_progress, kept=KeptRuns(kept)
        )
    except KeyboardInterrupt as stop:
        remedy = "repeat the command to continue"
        return print_error(f"stopped; the runs that have ended are in {kept}, {remedy}.", exit_code_of(stop))
    show_table(study.title, scene_heads(study), scene_rows(study))
    say(noise_sentence(study))
    write_study(out, write_scene, study)
    say(scene_recommendation(study))
    return 0


def add_accuracy(verbs: Any) -> None:
    """Add `granflow accuracy` and its arguments."""
    parser = add_verb(
        verbs, accuracy, "measure error against run time for every contact model, precision and time step"
    )
    add = parser.add_argument
    add("scene", metavar="SCENE", nargs="?", type=Path, help="scene to measure (default: binary collisions)")
    add_out(parser, "out/accuracy or out/accuracy_SCENE")
    add("--target", metavar="ERROR", type=float, default=0.01, help="target relative error (default: 0.01)")
    add("--full", action="store_true", help="more time steps, repetitions and seeds, and a finer reference")
    add("--all-particles", action="store_true", help="run the scene with all its particles, which may take hours")
    add("--until", metavar="T", type=simulated_time, help="stop the scene at this simulated time")
    add_overrides(parser, "override a value of the scene")
