"""`granflow plot`: columns of time series over time or over each other, of one or more runs."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_verb, check_output_file
from granflow.cli.messages import say, show_table

TYPES = (".png", ".svg", ".pdf", ".html")
"""Possible ends of the name of --out."""


def plot(options: argparse.Namespace) -> int:
    """`granflow plot`: write an image or a page with curves of time series; without --y, list the columns.

    Raises GranflowError for a file without rows, an unknown column or stage, and a type of file that is not supported.
    """
    from granflow.studies.plot.curves import panels_of
    from granflow.studies.plot.plot import default_path, write_plot
    from granflow.studies.plot.source import series_of

    check_output_file(options.out, TYPES, options.sources[0])
    if not options.y:
        path, series = series_of(options.sources[0], options.x)
        columns = [("time", "s"), *((each.name, each.unit) for each in series.columns)]
        show_table(f"Columns of {path}; choose with --y, and --x", ("column", "unit"), columns)
        return 0
    titles = {"x_title": options.x_label, "y_title": options.y_label}
    given = {name: text for name, text in titles.items() if text is not None}
    panels = [replace(panel, **given) for panel in panels_of(options.sources, options.x, options.y, options.stages)]
    out = options.out or default_path(options.sources[0], options.x, options.y)
    write_plot(out, panels, options.log, f"Time series of {', '.join(map(str, options.sources))}")
    say(f"Written to {out}")
    return 0


def add_plot(verbs: Any) -> None:
    """Add `granflow plot` and its arguments."""
    summary = "plot columns of time series over time or over each other, of one or more runs"
    parser = add_verb(verbs, plot, summary)
    parser.add_argument(
        "sources", metavar="RUN", type=Path, nargs="+",
        help="directory of a run, or a CSV file with times such as OUT/analysis/metrics.csv or "
        "OUT/collision_energies.csv; of the latter, --x energy draws the distribution at the end",
    )  # fmt: skip
    parser.add_argument(
        "--y", metavar="COLUMN", nargs="+", default=[],
        help="columns, or arithmetic expressions of columns in SI units such as 'wall_pressure.lid / 1e3'; one plot "
        "for each unit (default: list the columns of the first RUN)",
    )  # fmt: skip
    parser.add_argument(
        "--x", metavar="COLUMN", default="time",
        help="horizontal axis: a column or an expression, such as 'wall_displacement.lid / 0.05' (default: time)",
    )  # fmt: skip
    parser.add_argument("--x-label", metavar="TEXT", help="title of the horizontal axis")
    parser.add_argument("--y-label", metavar="TEXT", help="title of the vertical axis")
    parser.add_argument("--stages", metavar="NAME", nargs="+", default=[], help="only rows of these stages")
    parser.add_argument("--log", choices=("x", "y", "xy"), default="", help="axes with a logarithmic scale")
    parser.add_argument(
        "--out", metavar="FILE", type=Path,
        help="image .png, .svg or .pdf, or interactive page .html (default: plot_Y_over_X.png in the first RUN)",
    )  # fmt: skip
