"""`granflow sweep`: runs a scene for many parameter values."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import ARCHITECTURES, add_out, add_verb, count, thread_count
from granflow.cli.messages import exit_code_of, print_error, say, say_progress, show_table
from granflow.cli.signals import deferred_to_event

if TYPE_CHECKING:
    from granflow.studies.run_processes.driver import Progress
    from granflow.studies.run_processes.executors import Workers

BATCH_SYSTEMS = ("slurm", "pbs", "lsf", "sge")
"""Batch systems that can run the workers."""


def sweep(options: argparse.Namespace) -> int:
    """`granflow sweep`: carry out the runs of a sweep that have not ended, and write tables and a page.

    Returns 0 if all runs are done and meet their expectations, 1 otherwise, and 130 or 143 after a stop signal; the
    same command then continues the sweep.
    """
    from granflow.studies.sweep.run import SweepStopped, read_sweep, run_sweep

    study = read_sweep(options.file)
    out = options.out or Path("out") / study.name
    with deferred_to_event() as (stop, signals):
        try:
            table = run_sweep(study, out, workers_of(options), options.arch, stop, say_run, say_progress)
        except SweepStopped as error:
            return print_error(str(error), exit_code_of(signals[0]))
    if signals:
        remedy = "repeating the command continues it"
        return print_error(
            f"stopped; {out / 'sweep.csv'} has the completed runs, and {remedy}.", exit_code_of(signals[0])
        )
    statuses = [row.outcome.status for row in table.rows]
    show_table(
        f"{len(statuses)} points", ("status", "points"), [(s, str(statuses.count(s))) for s in dict.fromkeys(statuses)]
    )
    for reason in dict.fromkeys(row.outcome.reason for row in table.rows if row.outcome.reason):
        say(reason)
    warned = [row for row in table.rows if row.warnings]
    if warned:
        say(f"{len(warned)} of {len(statuses)} points have warnings, see sweep.csv; the first: {warned[0].warnings}")
    say(f"Written to {out / 'sweep.csv'}; open {out / 'sweep.html'} in a browser.")
    return 0 if table.is_complete else 1


def say_run(progress: "Progress", event: str) -> None:
    """Print the progress, and the parameter values and status of a run that has ended."""
    say(f"{progress}{event and '; '}{event}", flush=True)


def workers_of(options: argparse.Namespace) -> "Workers":
    """The workers that the options select."""
    from granflow.studies.run_processes.executors import Workers

    batch = next(((name, getattr(options, name)) for name in BATCH_SYSTEMS if getattr(options, name)), None)
    return Workers(options.jobs, options.threads, options.scheduler, options.scheduler_file, batch)


def add_sweep(verbs: Any) -> None:
    """Add `granflow sweep` and its arguments."""
    parser = add_verb(verbs, sweep, "run a scene for many parameter values; repeat the command to continue")
    parser.add_argument("file", metavar="SWEEP.yaml", type=Path, help="sweep file")
    add_out(parser, "out/SWEEP")
    add = parser.add_argument
    add("--jobs", metavar="N", type=count, help="simultaneous runs (default: cores / threads, or those of the workers)")
    add("--threads", metavar="T", type=thread_count, default=1, help="CPU threads of each run (default: 1)")
    add("--arch", choices=ARCHITECTURES, default="cpu", help="compute device or backend (default: cpu)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler, such as tcp://10.0.0.1:8786")
    where.add_argument("--scheduler-file", metavar="FILE", type=Path, help="file with the address of a Dask scheduler")
    for name in BATCH_SYSTEMS:
        text = f"start workers as {name.upper()} jobs with this profile"
        where.add_argument(f"--{name}", metavar="PROFILE.yaml", type=Path, help=text)
