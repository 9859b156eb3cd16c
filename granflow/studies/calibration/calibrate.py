"""`granflow.calibrate`: parameters of scenes from measured targets.

`read_calibration` reads the file; `run_calibration` carries out the trials by several threads, and writes
tables, page and scenes; `calibrate` does both from Python and returns a table of pandas. The same command in
other processes, also on other machines, adds workers.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Lock
from typing import Any

from granflow.arguments import path_of, whole_number
from granflow.errors import FileError, GranflowError, SceneError
from granflow.io.lock import locked
from granflow.io.machine import worker_count
from granflow.scene.reader import validated_source
from granflow.studies.calibration.results import (
    CalibrationResult,
    result_of,
    write_best_scenes,
    write_calibration_page,
    write_result,
)
from granflow.studies.calibration.schema import CalibrationInput, Target, from_unit
from granflow.studies.calibration.search import JOURNAL, Search, require_optuna
from granflow.studies.calibration.trials import Measured, TrialRunner, checked_scene, read_target
from granflow.studies.checked_run import RunSettings, relocated
from granflow.studies.figures import require_pandas
from granflow.studies.run_pool import local_jobs
from granflow.studies.run_process import naming_write_errors


def calibrate(
    source: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str] | None = None,
    jobs: int | None = None,
    threads: int = 1,
) -> Any:
    """Determine parameters of scenes from measured targets; return the best values as a pandas DataFrame.

        best = granflow.calibrate("calibration.yaml", jobs=2)

    source:   calibration file (YAML), or a mapping with the same keys, with paths relative to the working
              directory
    out:      directory of the results; default: out/NAME. Trials in it that have ended are not repeated
    jobs:     simultaneous trials; default: cores / threads
    threads:  CPU threads of each run
    Returns:  one row per parameter: value in the best trial, optimum_of_fit and its standard_deviation (SI),
              identified, remark. `attrs`: loss, and the lists targets and conflicts
    Raises:   GranflowError with all problems of the calibration, if no trial was completed, or if Optuna or
              pandas (pip install pandas) is missing
    """
    study = read_calibration(source)
    pandas = require_pandas("granflow.calibrate")
    out = Path("out") / study.name if out is None else path_of("out", out)
    jobs = None if jobs is None else whole_number("jobs", jobs, 1)
    result = run_calibration(study, out, jobs, whole_number("threads", threads, 1))
    if result is None:
        raise GranflowError("No trial was completed, so there are no best values.")
    table = pandas.DataFrame(
        [
            (each.value, each.optimum, each.deviation, not each.not_identified, each.not_identified)
            for each in result.parameters
        ],
        index=[each.name for each in result.parameters],
        columns=["value", "optimum_of_fit", "standard_deviation", "identified", "remark"],
    )
    table.attrs = {
        "loss": result.loss,
        "targets": [each._asdict() for each in result.targets],
        "conflicts": list(result.conflicts),
    }
    return table


# Reading the file


@dataclass(frozen=True)
class CalibrationFile:
    """A valid calibration: its content, scene files and targets by name, and the position of each key that it
    sets."""

    content: CalibrationInput
    name: str
    scenes: Mapping[str, Path]
    targets: Mapping[str, Measured]
    positions: Mapping[str, str]


def read_calibration(source: str | os.PathLike[str] | Mapping[str, Any]) -> CalibrationFile:
    """Read a calibration from a YAML file, or from a mapping with the same keys.

    Paths are relative to the folder of the file, or to the working directory. Raises FileError with all
    problems.
    """
    content, document, folder, name = validated_source(source, CalibrationInput, "calibration")
    scenes = {each: folder / given.scene for each, given in content.scenes.items()}
    missing = [
        f"{document.value_position(('scenes', each, 'scene'))}: scenes.{each}.scene is "
        f"{content.scenes[each].scene}, but there is no file {path}."
        for each, path in scenes.items()
        if not path.is_file()
    ]
    if missing:
        raise FileError(missing)
    targets = {
        each: read_target(target, folder, _position_of_target(document, each, target))
        for each, target in content.targets.items()
    }
    positions: dict[str, str] = {}
    for scene, given in content.scenes.items():
        positions |= {
            key: str(document.key_position(("scenes", scene, "set", key))) for key in given.settings
        }
        for parameter in content.parameters:
            position = str(document.key_position(("parameters", parameter)))
            positions |= dict.fromkeys(content.keys_of(parameter, scene), position)
    return CalibrationFile(content, name, scenes, targets, positions)


def _position_of_target(document: Any, name: str, target: Target) -> str:
    """Position of the file of a curve, otherwise of the quantity, in a `Document`."""
    return str(document.value_position(("targets", name, "curve" if target.curve else "quantity")))


# Carrying out the trials

REMEDY = "The trials that have ended are kept: correct this, and repeat the command."
"""Sentence on an error of a file."""
Report = Callable[[str], None]
"""Function that receives one line per trial."""


def run_calibration(
    file: CalibrationFile,
    out: Path,
    jobs: int | None = None,
    threads: int = 1,
    stop: Event | None = None,
    report: Report = lambda _: None,
) -> CalibrationResult | None:
    """Carry out the trials that have not ended, and write tables, page and the scenes with the best values.

    `jobs`: number of simultaneous trials, default cores / threads; `stop`: stops all runs when it is set. The
    same command in other processes adds workers. Returns None if no trial was completed. Raises GranflowError
    if the calibration is not valid, or if jobs * threads exceeds the cores, and OutputError for files that
    cannot be written.
    """
    require_optuna(file.content.search.method)
    count = local_jobs(jobs, threads, worker_count(None)[0])
    with naming_write_errors(out, REMEDY):
        return _run(file, out, count, threads, stop or Event(), report)


def _run(
    file: CalibrationFile, out: Path, count: int, threads: int, stop: Event, report: Report
) -> CalibrationResult | None:
    """As `run_calibration`, with `count` simultaneous trials.

    Raises OSError for files that cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    search = Search(file.content, out)
    stop_file = out / f".stop_{search.worker}"
    common = RunSettings(out / "runs", threads, "cpu", stop_file)
    runner = TrialRunner(search, file.scenes, file.targets, file.positions, common, stop.is_set)
    runner.check()
    with locked(search.lock):
        search.release_lost()
        _Workers(runner, count, stop, report).run()
    result = result_of(search, file.targets)
    if result is not None:
        write_result(out, result)
        best = {each.name: each.value for each in result.parameters}
        write_best_scenes(out, file.content, file.scenes, best)
        write_calibration_page(out, file.content, result)
    return result


@dataclass(frozen=True)
class TrialEstimate:
    """Estimated computing time [s] of the scenes of a trial by name: with the middle values of all
    parameters, and the shortest and the longest with one parameter at an end of its range. `ended`: number of
    trials that have ended."""

    scenes: Mapping[str, tuple[float, float, float]]
    ended: int


def estimate_trials(file: CalibrationFile, out: Path, threads: int = 1) -> TrialEstimate:
    """Check the scenes of a calibration with the values that `TrialEstimate` names, and estimate their time,
    without a run and without a file.

    Raises GranflowError for a scene that is invalid with one of the values, and if a package is missing that
    the method needs.
    """
    require_optuna(file.content.search.method)
    parameters = file.content.parameters
    middle = {name: from_unit(each, 0.5) for name, each in parameters.items()}
    points = {"": middle} | {
        f"{name} at {each.text(value)}": middle | {name: value}
        for name, each in parameters.items()
        for value in (float(each.start), float(each.stop))
    }
    common = RunSettings(out / "runs", threads, "cpu", out / ".stop")
    found = {}
    refused: dict[str, list[str]] = {}
    for scene, path in file.scenes.items():
        seconds = []
        for point, values in points.items():
            try:
                run = checked_scene(file.content, scene, path, file.targets, values, common)
                seconds.append(file.content.repeat.seeds * run.seconds)
            except SceneError as error:
                problems = relocated(error, file.positions).problems
                refused.setdefault(point, []).extend(problems)
        if seconds:
            found[scene] = seconds[0], min(seconds), max(seconds)
    if refused:
        raise FileError(_problems_at_ends(refused, file.positions))
    ended = 0
    if (out / JOURNAL).exists():
        trials = Search(file.content, out).study.get_trials(deepcopy=False)
        ended = sum(trial.state.is_finished() for trial in trials)
    return TrialEstimate(found, ended)


def _problems_at_ends(refused: Mapping[str, Sequence[str]], positions: Mapping[str, str]) -> list[str]:
    """The problems with parameters at their ends, by parameter and value; those with the middle values (""),
    which the file does not contain, only if there are no others.

    A problem in another file than that of the calibration names parameter and value.
    """
    middle = refused.get("", ())
    located = tuple(f"{position}: " for position in positions.values())
    found = [
        problem if problem.startswith(located) else f"{problem} This is with {point}."
        for point, problems in refused.items()
        for problem in problems
        if problem not in middle
    ]
    return list(dict.fromkeys(found or middle))


POLL = 0.5
"""Interval [s] at which a request to stop is checked."""
MOST_FAILURES = 8
"""Number of failed trials, without any completed one, after which a calibration ends."""


class _Workers:
    """Threads that carry out trials one after the other until all have begun, or until a stop is
    requested."""

    def __init__(self, runner: TrialRunner, count: int, stop: Event, report: Report) -> None:
        self._runner = runner
        self._count = count
        self._stop = stop
        self._report = report
        self._asking = Lock()

    def run(self) -> None:
        """Carry out the trials.

        KeyboardInterrupt stops the runs, and is raised again when all have stopped.
        """
        interrupt: KeyboardInterrupt | None = None
        with ThreadPoolExecutor(self._count) as executor:
            running: set[Future[None]] = {executor.submit(self._work) for _ in range(self._count)}
            while running:
                try:
                    done, running = wait(running, POLL, FIRST_COMPLETED)
                    for future in done:
                        future.result()
                except KeyboardInterrupt as error:
                    interrupt = error
                    self._stop.set()
                except BaseException:
                    self._stop.set()
                    raise
        if interrupt is not None:
            raise interrupt

    def _work(self) -> None:
        """Carry out trials in one thread.

        Raises GranflowError if the first trials all fail, or if a scene changes.
        """
        while not self._stop.is_set():
            with self._asking:
                self._refuse_failures()
                self._runner.check()  # a scene may be edited while trials run
                trial = self._runner.search.next_trial()
            if trial is None:
                return
            state = self._runner.run(trial)
            parameters = self._runner.search.calibration.parameters
            values = ", ".join(
                f"{name} {parameters[name].text(value)}" for name, value in trial.params.items()
            )
            self._report(f"trial {trial.number}: {values}: {state}")

    def _refuse_failures(self) -> None:
        """Raise GranflowError if all of the first trials have failed: the others would fail as well."""
        trials = self._runner.search.study.get_trials(deepcopy=False)
        reasons = [trial.user_attrs["reason"] for trial in trials if "reason" in trial.user_attrs]
        if len(reasons) >= MOST_FAILURES and len(reasons) == sum(
            trial.state.is_finished() for trial in trials
        ):
            raise GranflowError(f"The first {len(reasons)} trials failed. The last reason: {reasons[-1]}")
