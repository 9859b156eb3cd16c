"""`granflow analyze`: computes metrics and fields of a completed run.

The frames of the run are read; nothing is simulated. The run must have written particles, and contacts for some
quantities.
"""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_out, add_overrides, add_verb
from granflow.cli.messages import say, show_table
from granflow.errors import GranflowError
from granflow.visible_text import in_degrees

MAX_ROWS = 20
"""Largest number of rows printed; the file contains all rows."""


def analyze(options: argparse.Namespace) -> int:
    """`granflow analyze`: compute metrics and fields of a completed run from its frames.

    Writes `metrics.csv` and VTU files, and prints at most MAX_ROWS rows, the last one included. Raises GranflowError if
    the directory is not that of a run, or if --out is that directory.
    """
    from granflow.load import load
    from granflow.studies.analyze import analyze as analyze_run

    scene_path = options.directory / "scene_as_run.yaml"
    if not scene_path.is_file():
        raise GranflowError(f"{options.directory} is not the directory of a run: it contains no scene_as_run.yaml.")
    out = options.out or options.directory / "analysis"
    if out.resolve() == options.directory.resolve():
        raise GranflowError(
            f"--out {out} is the directory of the run, whose fields would be overwritten: give another directory."
        )
    rows = analyze_run(options.directory, load(scene_path, options.overrides), out)
    if rows and len(rows[0]) > len(("time", "stage")):
        step = -(-len(rows) // MAX_ROWS)
        cells = [[_cell(name, value) for name, value in row.items()] for row in rows]
        show_table(f"{options.directory}, {len(rows)} frames", list(rows[0]), cells[::-1][::step][::-1])
    say(f"Written to {out}")
    return 0


def _cell(name: str, value: float | str) -> str:
    """Text of a value of the column `name`; of an angle with degrees."""
    from granflow.fields import unit_of

    return value if isinstance(value, str) else f"{value:.4g}" + in_degrees(value, unit_of(name.partition(" [")[0]))


def add_analyze(verbs: Any) -> None:
    """Add `granflow analyze` and its arguments."""
    summary = "compute metrics (mixing, angle of repose, coordination, fabric) or fields of a completed run"
    parser = add_verb(verbs, analyze, summary)
    parser.add_argument("directory", metavar="OUT", type=Path, help="directory of the run")
    add_out(parser, "OUT/analysis")
    add_overrides(parser, "metric or field to compute, such as 'output.metrics.heap={kind: repose, surface: cone}'")
