"""`granflow report`: one HTML page about one run, complete or in progress, from the files in its directory."""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_verb, check_output_file
from granflow.cli.messages import say


def report(options: argparse.Namespace) -> int:
    """`granflow report`: write one self-contained page about a run, with interactive plots and images.

    The page requires no network. Raises GranflowError if the directory is not that of a run.
    """
    from granflow.studies.report.report import write_report

    check_output_file(options.out, (".html",), options.directory)
    path = write_report(options.directory, options.out, not options.no_pictures, say)
    say(f"Open {path} in a browser.")
    return 0


def add_report(verbs: Any) -> None:
    """Add `granflow report` and its arguments."""
    summary = "write one self-contained page about a run: interactive plots, flow, energies, plan, timings, images"
    parser = add_verb(verbs, report, summary)
    parser.add_argument("directory", metavar="DIR", type=Path, help="directory of the run, such as out/hopper")
    parser.add_argument("--out", metavar="FILE", type=Path, help="output file (default: DIR/report.html)")
    parser.add_argument("--no-pictures", action="store_true", help="omit images")
