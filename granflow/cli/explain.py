"""`granflow explain`: prints the decisions of the plan with their reasons.

With --measure, it prints the measured cost of each feature instead.
"""

import argparse
import atexit
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from granflow.cli.arguments import add_machine, add_scene_verb, load, load_runnable, simulated_time, thread_count
from granflow.cli.messages import say, show_table
from granflow.errors import GranflowError


def explain(options: argparse.Namespace) -> int:
    """`granflow explain`: print features, defaults, time step, memory and run time, or the cost of each feature.

    Raises GranflowError for options that require --measure.
    """
    if options.measure:
        return measure(options, load_runnable(options))
    scene = load(options)
    given = [name for name in ("until", "threads", "out") if getattr(options, name) is not None]
    if given:
        raise GranflowError(f"--{given[0]} requires --measure: give both or neither.")
    from granflow.plan.build import plan_for
    from granflow.plan.explain import explain as explain_plan

    on_gpu = options.arch != "cpu"
    say(explain_plan(plan_for(scene, on_gpu=on_gpu), on_gpu))
    say(f"\nCost of each feature: granflow explain --measure {options.scene}")
    return 0


def measure(options: argparse.Namespace, scene: Any) -> int:
    """Time the scene with each feature on and off, and print the table of times per step.

    `scene`: resolved scene. With --out, the table is also written as CSV and Markdown.
    """
    use_fresh_kernel_cache()
    from granflow.studies.feature_cost.measure import feature_costs
    from granflow.studies.feature_cost.report import HEADS, cost_rows, remarks, write_feature_costs

    found = feature_costs(
        scene, options.arch, options.threads, options.until, lambda message: say(f"{message} ...", flush=True)
    )
    show_table(f"{scene.title}: cost of a step, as in the scene and with one feature switched", HEADS, cost_rows(found))
    say(*remarks(found), sep="\n")
    if options.out is not None:
        write_feature_costs(options.out, found, scene.title)
        say(f"Written to {options.out}")
    return 0


def use_fresh_kernel_cache() -> None:
    """Use an empty temporary kernel cache in this process, so that compilation takes as long as the first time.

    Sets the environment variable of the cache; must be called before Taichi is initialized.
    """
    from granflow.engine.kernel_cache import VARIABLE

    folder = TemporaryDirectory()
    atexit.register(folder.cleanup)  # before Taichi registers its exit handler, which writes into the folder
    os.environ[VARIABLE] = folder.name


def add_explain(verbs: Any) -> None:
    """Add `granflow explain` and its arguments."""
    parser = add_scene_verb(
        verbs, explain, "print features with their reasons, defaults, the time step and its limit, the memory estimate"
    )
    parser.add_argument(
        "--measure",
        action="store_true",
        help="measure the cost of each feature instead of printing the plan: time per step with and without it",
    )
    parser.add_argument(
        "--until", metavar="T", type=simulated_time, help="with --measure: simulated time to run before the measurement"
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        type=thread_count,
        help="with --measure: CPU threads (default: cores available to this process)",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="with --measure: write the table as CSV and Markdown")
    add_machine(parser)
