"""`granflow.sweep`: a sweep from Python."""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

from granflow import Scene
from granflow.arguments import path_of, whole_number
from granflow.errors import FileError, GranflowError, SceneError
from granflow.io.lock import locked
from granflow.scene.reader import validated_source
from granflow.schema.faults import Fault
from granflow.schema.messages import problem_at
from granflow.studies.checked_run import CheckedRun, RunSettings, checked_run, relocated
from granflow.studies.figures import require_pandas
from granflow.studies.interactive_plots import level_text
from granflow.studies.run_pool import Driver, Progress, Report, Workers, executor_for
from granflow.studies.run_process import Outcome, naming_write_errors
from granflow.studies.sweep_design import DesignPoint, SweepInput, design_points
from granflow.studies.sweep_page import write_sweep_page
from granflow.studies.sweep_table import PointRow, SweepTable, run_texts, shown, table_of, write_tables
from granflow.studies.yield_locus import ShearTest, evaluate, faults_in, write_loci

# Runs a sweep: checks all points, carries out the missing runs, and writes tables and page.

STOP_FILE = ".stop"
"""File in the directory of a sweep whose presence stops its runs."""
TABLE_INTERVAL = 10.0
"""Shortest time [s] between two updates of the tables during the runs."""
CHECK_REPORT = 5.0
"""Time [s] between two reports while the points are checked."""
REMEDY = "The runs that have ended are kept: correct this, and repeat the command."
"""Sentence on an error of a file."""
Points = Sequence[tuple[DesignPoint, Sequence[CheckedRun | str]]]
"""Each point with its runs, or the reasons why these are refused."""


class SweepStopped(GranflowError):
    """A stop was requested while the points were checked; no file was changed."""


@dataclass(frozen=True)
class SweepFile:
    """A valid sweep: its content, the scene file, its name, and positions in the sweep file.

    `positions`: of each varied or set key of the scene; `read`: of each number that is read; `problem`:
    message of a fault, with its position.
    """

    content: SweepInput
    scene: Path
    name: str
    positions: Mapping[str, str] = field(default_factory=dict)
    read: Mapping[str, str] = field(default_factory=dict)
    problem: Callable[[Fault], Any] = str


def read_sweep(source: str | os.PathLike[str] | Mapping[str, Any]) -> SweepFile:
    """Read a sweep from a YAML file, or from a mapping with the same keys.

    The path of the scene is relative to the folder of the file, or to the present one. Raises FileError with
    all problems.
    """
    content, document, folder, name = validated_source(source, SweepInput, "sweep")
    scene = folder / content.scene
    if not scene.is_file():
        position = document.value_position(("scene",))
        raise FileError(f"{position}: scene is {content.scene}, but there is no file {scene}.")
    positions = {key: str(document.key_position(("set", key))) for key in content.settings}
    positions |= {key: str(document.key_position(("derive", key))) for key in content.derive}
    for parameter in content.vary:
        positions |= dict.fromkeys(
            content.keys_of(parameter), str(document.key_position(("vary", parameter)))
        )
    read = {each: str(document.value_position(("read", k))) for k, each in enumerate(content.read)}
    return SweepFile(content, scene, name, positions, read, partial(problem_at, document))


def checked_points(
    sweep: SweepFile,
    common: RunSettings,
    is_stopping: Callable[[], bool] = lambda: False,
    announce: Callable[[str], None] = lambda _: None,
) -> Points:
    """All points with their checked runs, one for each seed; a reason in place of a refused run.

    `announce` receives a line each CHECK_REPORT. Raises FileError if every run is refused, with the different
    reasons, at their positions in the sweep file, and SweepStopped as soon as `is_stopping` returns True.
    """
    points = design_points(sweep.content)
    found: list[tuple[DesignPoint, Sequence[CheckedRun | str]]] = []
    told = time.monotonic()
    for number, point in enumerate(points):
        checked = []
        for offset in range(sweep.content.repeat.seeds):
            if is_stopping():
                raise SweepStopped(
                    f"stopped: {number} of {len(points)} points are checked, and no run has begun."
                )
            checked.append(_checked(sweep, point, common, offset))
        found.append((point, checked))
        if time.monotonic() - told > CHECK_REPORT:
            told = time.monotonic()
            announce(f"{number + 1} of {len(points)} points are checked")
    runs = [run for _, each in found for run in each]
    reasons = [run for run in runs if isinstance(run, str)]
    if len(reasons) == len(runs):
        raise FileError(list(dict.fromkeys(line for reason in reasons for line in reason.splitlines())))
    return [
        (point, [" ".join(run.splitlines()) if isinstance(run, str) else run for run in each])
        for point, each in found
    ]


def _checked(sweep: SweepFile, point: DesignPoint, common: RunSettings, seed_offset: int) -> CheckedRun | str:
    """A checked run, or the reason why it is refused, a line for each problem."""
    try:
        return checked_run(
            sweep.scene, point.settings, sweep.read, common, seed_offset, partial(_evaluation_problems, sweep)
        )
    except SceneError as error:
        return "\n".join(relocated(error, sweep.positions).problems)
    except GranflowError as error:
        return str(error)


def _evaluation_problems(sweep: SweepFile, scene: Scene) -> Iterator[str]:
    """Why the evaluation of the sweep cannot use a run of a scene."""
    if sweep.content.evaluate is not None:
        for fault in faults_in(sweep.content.evaluate, scene):
            yield str(sweep.problem(replace(fault, path=("evaluate", *fault.path))))


def runs_of(points: Points) -> list[CheckedRun]:
    """The runs of all points that are not refused."""
    return [run for _, each in points for run in each if isinstance(run, CheckedRun)]


def texts_of(sweep: SweepFile, points: Points) -> dict[str, str]:
    """What identifies each run in reports, by its directory, see `run_texts`."""
    table = table_of(tuple(sweep.content.vary), sweep.content.read, points, {})
    return run_texts(shown(sweep.content, table))


def run_sweep(
    sweep: SweepFile,
    out: Path,
    workers: Workers,
    arch: str = "cpu",
    stop: Event | None = None,
    report: Report = lambda *_: None,
    announce: Callable[[str], None] = lambda _: None,
) -> SweepTable:
    """Carry out the runs of a sweep that have not ended, and write `sweep.csv`, `runs.csv` and `sweep.html`,
    and the files of the evaluation of all runs, if there is one.

    `stop`: stops all runs, each with a checkpoint, when it is set; `report` receives the progress of the
    runs, `announce` lines before them. Raises GranflowError if the sweep or the workers are not valid, or if
    another process runs a sweep in `out`, SweepStopped for a stop before the first run, OutputError for files
    that cannot be written.
    """
    stop = stop or Event()
    with naming_write_errors(out, REMEDY), locked(out):
        common = RunSettings(out / "runs", workers.threads, arch, out / STOP_FILE)
        common.stop_file.unlink(missing_ok=True)
        points = checked_points(sweep, common, stop.is_set, announce)
        runs = runs_of(points)
        names = (tuple(sweep.content.vary), sweep.content.read)
        with executor_for(workers) as (executor, slots):
            updates = _Updates(out, lambda outcomes: table_of(*names, points, outcomes), report)
            driver = Driver(executor, slots, stop, updates.report, texts_of(sweep, points))
            updates.outcomes = driver.outcomes
            try:
                driver.run(runs)
            finally:
                table = table_of(*names, points, driver.outcomes)
                write_tables(out, table)
        if sweep.content.evaluate is None:
            write_sweep_page(out, sweep.content, table)
            return table
        table = replace(
            table, loci=tuple(evaluate(sweep.content.evaluate, shear_tests(sweep.content, table)))
        )
        figures = write_loci(out, sweep.content.evaluate, table.loci)
        write_sweep_page(out, sweep.content, table, figures)
        return table


def shear_tests(sweep: SweepInput, table: SweepTable) -> list[ShearTest]:
    """The runs of a sweep that have reached their end."""
    in_units = shown(sweep, table)

    def texts(row: PointRow) -> dict[str, str]:
        return {
            name: f"{level_text(in_units.value(row, name))} {in_units.units[name]}".strip()
            for name in table.parameters
        }

    return [
        ShearTest(row.point.values, each.run.seed, each.run.directory, texts(row))
        for row in table.rows
        for each in row.runs
        if each.run is not None and each.outcome.has_numbers
    ]


@dataclass(frozen=True)
class Part:
    """Part `number` of `count` of the runs of a sweep: every `count`-th run, from the `number`-th on."""

    number: int
    count: int

    def of(self, runs: Sequence[CheckedRun]) -> list[CheckedRun]:
        """The runs of this part; runs of equal points count once."""
        distinct = list({run.request.directory: run for run in runs}.values())
        return distinct[self.number - 1 :: self.count]


def run_part(
    sweep: SweepFile,
    out: Path,
    workers: Workers,
    part: Part,
    arch: str = "cpu",
    stop: Event | None = None,
    report: Report = lambda *_: None,
    announce: Callable[[str], None] = lambda _: None,
) -> Mapping[str, Outcome]:
    """Carry out the runs of one part of a sweep; return the outcome of each by its directory.

    Parts write nothing but their runs, so that they can run at the same time on machines with a common file
    system, as an array of jobs; `run_sweep` then finds all runs ended, and writes tables and page. Raises as
    `run_sweep`.
    """
    stop = stop or Event()
    own = out / "parts" / f"{part.number}_of_{part.count}"
    with naming_write_errors(out, REMEDY), locked(own):
        common = RunSettings(out / "runs", workers.threads, arch, own / STOP_FILE)
        common.stop_file.unlink(missing_ok=True)
        points = checked_points(sweep, common, stop.is_set, announce)
        with executor_for(workers) as (executor, slots):
            driver = Driver(executor, slots, stop, report, texts_of(sweep, points))
            return driver.run(part.of(runs_of(points)))


class _Updates:
    """Updates the tables during the runs, at most every TABLE_INTERVAL."""

    def __init__(
        self, out: Path, table: Callable[[Mapping[str, Outcome]], SweepTable], report: Report
    ) -> None:
        self._out = out
        self._table = table
        self._report = report
        self._written = time.monotonic()
        self.outcomes: Mapping[str, Outcome] = {}

    def report(self, progress: Progress, event: str) -> None:
        """Report the progress, and write the tables if they are old."""
        self._report(progress, event)
        if time.monotonic() - self._written > TABLE_INTERVAL:
            with suppress(
                OSError
            ):  # a full disk is reported at the end, when the runs have ended in an orderly way
                write_tables(self._out, self._table(self.outcomes))
            self._written = time.monotonic()


def sweep(
    source: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str] | None = None,
    jobs: int | None = None,
    threads: int = 1,
    scheduler: str | None = None,
    arch: str = "cpu",
) -> Any:
    """Run a scene for many parameter values and return the table as a pandas DataFrame, one row per point.

        table = granflow.sweep("sweep.yaml", jobs=2)

    source:     sweep file (YAML), or a mapping with the same keys, where paths are relative to the working
                directory
    out:        directory of the results; default: out/NAME. Runs in it that have ended are not repeated
    jobs:       simultaneous runs; default: cores / threads, or as many as the workers of the scheduler take
    threads:    CPU threads of each run
    scheduler:  address of a Dask scheduler, such as tcp://10.0.0.1:8786; default: processes on this machine
    Returns:    columns as in sweep.csv: parameters, status, reason, seconds [s], quantities [SI], run
                directories
    Raises:     GranflowError with all problems of the sweep, or if pandas (pip install pandas) is missing
    """
    study = read_sweep(source)
    pandas = require_pandas("granflow.sweep")
    out = Path("out") / study.name if out is None else path_of("out", out)
    jobs = None if jobs is None else whole_number("jobs", jobs, 1)
    threads = whole_number("threads", threads, 1)
    table = run_sweep(study, out, Workers(jobs, threads, scheduler), arch)
    return pandas.DataFrame(table.columns())
