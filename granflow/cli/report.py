"""The verb report: one page about one run."""

import argparse
from pathlib import Path
from typing import Any

from granflow.cli.messages import say


def report(options: argparse.Namespace) -> int:
    """`granflow report`: everything about a run on one page, with plots to hover over and pictures."""
    from granflow.study.report import write_report

    path = write_report(options.directory, options.out, not options.no_pictures)
    say(f"Open {path} in a browser.")
    return 0


def add_report(verbs: Any) -> None:
    """`granflow report` and its arguments."""
    summary = "put all about a run on one page: plots, flow, energies, plan, pictures"
    parser = verbs.add_parser("report", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("directory", metavar="DIR", type=Path, help="the directory of the run, such as out/hopper")
    parser.add_argument("--out", metavar="FILE", type=Path, help="where the page goes (report.html in that directory)")
    parser.add_argument("--no-pictures", action="store_true", help="leave pictures out")
    parser.set_defaults(verb=report)
