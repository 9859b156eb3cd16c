"""`granflow analyze`: indices and fields of a run that is over."""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.messages import say, show_table
from granflow.errors import GranflowError

MAX_ROWS = 20
"""Rows of the table on the screen; the file has them all."""


def analyze(options: argparse.Namespace) -> int:
    """`granflow analyze`: mixing, angle of repose, fabric, fields from the frames of a run."""
    from granflow.scene import load
    from granflow.study.analyze import analyze as analyze_run

    scene_path = options.directory / "scene_as_run.yaml"
    if not scene_path.is_file():
        raise GranflowError(f"{options.directory} is no directory of a run: it has no scene_as_run.yaml.")
    out = options.out or options.directory / "analysis"
    if out.resolve() == options.directory.resolve():
        raise GranflowError(
            f"--out {out} is the directory of the run, whose fields would be overwritten: name another."
        )
    rows = analyze_run(options.directory, load(scene_path, options.overrides), out)
    if rows and len(rows[0]) > len(("time", "stage")):
        step = -(-len(rows) // MAX_ROWS)
        cells = [[value if isinstance(value, str) else f"{value:.4g}" for value in row.values()] for row in rows]
        show_table(f"{options.directory}, {len(rows)} frames", list(rows[0]), cells[::-1][::step][::-1])
    say(f"Written to {out}")
    return 0


def add_analyze(verbs: Any) -> None:
    """`granflow analyze` and its arguments."""
    summary = "measure indices and fields of a run that is over, from its frames"
    parser = verbs.add_parser("measure", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("directory", metavar="OUT", type=Path, help="directory that granflow run has written")
    parser.add_argument("--out", metavar="DIR", type=Path, help="where the results go (OUT/analysis)")
    parser.add_argument(
        "--set", dest="overrides", metavar="KEY.PATH=VALUE", action="append", default=[],
        help="what to measure, such as --set 'output.metrics.heap={kind: repose, surface: cone}'; may be repeated",
    )  # fmt: skip
    parser.set_defaults(verb=analyze)
