"""`granflow calibrate`: determines parameters of scenes from measured targets."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import add_out, add_verb, count, thread_count
from granflow.cli.messages import exit_code_of, print_error, say, show_table
from granflow.cli.signals import deferred_to_event

if TYPE_CHECKING:
    from granflow.studies.calibration.results import CalibrationResult


def calibrate(options: argparse.Namespace) -> int:
    """`granflow calibrate`: carry out the trials that have not ended, and write best values, scenes and a page.

    Returns 0 if the best trial meets all targets within their tolerances, 1 otherwise, and 130 or 143 after a stop
    signal; the same command then continues the calibration.
    """
    from granflow.studies.calibration.run import read_calibration, run_calibration

    study = read_calibration(options.file)
    out = options.out or Path("out") / study.name
    with deferred_to_event() as (stop, signals):
        result = run_calibration(study, out, options.jobs, options.threads, stop, lambda line: say(line, flush=True))
    if signals and isinstance(signals[0], KeyboardInterrupt):
        return print_error("stopped; repeat the command to continue the calibration.", exit_code_of(signals[0]))
    if result is None:
        return print_error("no trial was completed, so there are no best values; see trials.csv.", 1)
    show_calibration(result)
    say(f"Written to {out / 'best.csv'}; open {out / 'calibration.html'} in a browser.")
    return 0 if result.is_met else 1


def show_calibration(result: "CalibrationResult") -> None:
    """Print best values and targets, parameters that cannot be identified, noise, and conflicts of targets."""
    rows = [(each.name, *each.shown) for each in result.parameters]
    show_table(
        f"Best values, loss {result.loss:.4g}", ("", "best trial", "optimum of the fit", "standard deviation"), rows
    )
    targets = [(each.name, *each.shown, f"{each.deviation:.2g}") for each in result.targets]
    show_table("Targets", ("", "measured", "simulated", "deviation / tolerance"), targets)
    for sentence in result.remarks:
        say(sentence)


def add_calibrate(verbs: Any) -> None:
    """Add `granflow calibrate` and its arguments."""
    summary = "determine parameters of scenes from measured targets; repeat the command to continue"
    parser = add_verb(verbs, calibrate, summary)
    parser.add_argument("file", metavar="CALIBRATION.yaml", type=Path, help="calibration file")
    add_out(parser, "out/CALIBRATION")
    jobs = "simultaneous trials (default: cores / threads)"
    parser.add_argument("--jobs", metavar="N", type=count, help=jobs)
    threads = "CPU threads of each run (default: 1)"
    parser.add_argument("--threads", metavar="T", type=thread_count, default=1, help=threads)
