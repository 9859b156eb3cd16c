"""The verb explain: what will be run and why, and with --measure what each part of it costs."""

import argparse
import atexit
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from granflow.cli.arguments import add_machine, add_scene_verb, load, simulated_time, thread_count
from granflow.cli.messages import say, show_table
from granflow.errors import GranflowError


def explain(options: argparse.Namespace) -> int:
    """`granflow explain`: features, defaults, time step, memory, run time; or time and memory of every feature."""
    scene = load(options)
    if options.measure:
        return measure(options, scene)
    given = [name for name in ("until", "threads", "out") if getattr(options, name) is not None]
    if given:
        raise GranflowError(f"--{given[0]} goes only with --measure: give both or neither.")
    from granflow.plan import explain as explain_plan
    from granflow.plan import plan_for

    say(explain_plan(plan_for(scene, on_gpu=options.arch != "cpu")))
    say(f"\nWhat each feature costs: granflow explain --measure {options.scene}")
    return 0


def measure(options: argparse.Namespace, scene: Any) -> int:
    """Time the scene with every feature on and off, and show the table."""
    use_fresh_kernel_cache()
    from granflow.study.feature_cost import HEADS, cost_rows, feature_costs, remarks, write_feature_costs

    found = feature_costs(
        scene, options.arch, options.threads, options.until, lambda words: say(f"{words} ...", flush=True)
    )
    show_table(f"{scene.title}: a step as it stands, and with one feature off or on", HEADS, cost_rows(found))
    say(*remarks(found), sep="\n")
    if options.out is not None:
        write_feature_costs(options.out, found, scene.title)
        say(f"Written to {options.out}")
    return 0


def use_fresh_kernel_cache() -> None:
    """Keep kernels of this process in a folder of its own, so that compiling takes as long as the first time."""
    from granflow.device.kernel_cache import VARIABLE

    folder = TemporaryDirectory()
    atexit.register(folder.cleanup)  # before Taichi registers its own end, which writes into the folder
    os.environ[VARIABLE] = folder.name


def add_explain(verbs: Any) -> None:
    """`granflow explain` and its arguments."""
    parser = add_scene_verb(verbs, explain, "show what would be run and why: features, defaults, time step, memory")
    parser.add_argument("--measure", action="store_true", help="time a step with every feature on and off instead")
    parser.add_argument("--until", metavar="T", type=simulated_time, help="with --measure: run to this time before")
    parser.add_argument(
        "--threads",
        metavar="N",
        type=thread_count,
        help="with --measure: CPU threads (cores that this process may use)",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="with --measure: write the table as CSV and Markdown")
    add_machine(parser)
