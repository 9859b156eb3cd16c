"""`granflow.calibrate`: a calibration from Python."""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Lock
from typing import Any

import numpy as np

from granflow.arguments import path_of, refuse_other, whole_number
from granflow.errors import FileError, GranflowError
from granflow.fields import unit_of
from granflow.io.files import write_text
from granflow.io.lock import locked
from granflow.io.machine import worker_count
from granflow.scene.validated_file import validated_file, validated_mapping
from granflow.studies.calibration.results import (
    CalibrationResult,
    result_of,
    runs_of,
    state_of,
    warnings_of_trial,
    write_best_scenes,
    write_result,
)
from granflow.studies.calibration.schema import CalibrationInput, Target
from granflow.studies.calibration.search import Search, require_optuna
from granflow.studies.calibration.trials import Measured, TrialRunner, read_target
from granflow.studies.figures import COLORS
from granflow.studies.page import page_text
from granflow.studies.report.plots import Plot, escaped, library
from granflow.studies.run_pool import local_jobs
from granflow.studies.run_process import RunSettings, close_workers, naming_write_errors
from granflow.studies.sweep.table import axis, layout, plain, row_of_axes, short_names
from granflow.studies.tables import PageTable, without_empty_ends
from granflow.units import in_unit

# The page of a calibration: best values, targets, conflicts, convergence, importance, all trials.

PAGE = "calibration.html"
HEIGHT = 340
"""Height of a plot [pixels]."""


def write_calibration_page(out: Path, calibration: CalibrationInput, result: CalibrationResult) -> None:
    """Write `calibration.html` to the directory of the calibration; without plotly, it has tables only."""
    script = library()
    text = page_text(
        "calibration.html",
        plotly=script,
        title=calibration.title or f"Calibration of {' and '.join(calibration.scenes)}",
        lead=calibration.description or "Parameters from measured targets.",
        loss=result.loss,
        best=_best(result),
        targets=_targets(result),
        remarks=result.remarks,
        has_plots=bool(script),
        convergence=_convergence(result, calibration),
        losses=_losses(result, calibration),
        importance=_importance(result, calibration),
        trials=_trials(result, calibration),
    )
    write_text(out / PAGE, text)


def _best(result: CalibrationResult) -> PageTable:
    """Best values, optima of the fit and their standard deviations."""
    rows = [(each.name, *each.shown, "no" if each.not_identified else "yes") for each in result.parameters]
    return PageTable(
        ("parameter", "best trial", "optimum of the fit", "standard deviation", "identified"), rows
    )


def _targets(result: CalibrationResult) -> PageTable:
    """Targets at the best values."""
    rows = [(each.name, each.quantity, *each.shown, f"{each.deviation:.2g}") for each in result.targets]
    return PageTable(("target", "quantity", "measured", "simulated", "deviation / tolerance"), rows)


def _convergence(result: CalibrationResult, calibration: CalibrationInput) -> Plot:
    """Loss of each completed trial, and the smallest loss so far."""
    trials = [trial for trial in result.trials if trial.state.name == "COMPLETE"]
    numbers = [trial.number for trial in trials]
    losses = [trial.value for trial in trials]
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "trial",
            "x": numbers,
            "y": [plain(each) for each in losses],
            "hovertext": [_hover(trial, calibration) for trial in trials],
            "hoverinfo": "text",
            "marker": {"color": COLORS[5]},
        },
        {
            "type": "scatter",
            "mode": "lines",
            "name": "smallest so far",
            "x": numbers,
            "line": {"shape": "hv"},
            "y": [plain(float(each)) for each in np.minimum.accumulate(losses)],
            "marker": {"color": COLORS[0]},
        },
    ]
    axes = {"xaxis": axis("trial"), "yaxis": axis("loss", type="log")}
    return Plot(
        "Convergence: loss of each trial and smallest loss so far",
        {
            "data": data,
            "layout": layout(HEIGHT, **axes) | {"showlegend": True},
        },
    )


def _losses(result: CalibrationResult, calibration: CalibrationInput) -> Plot:
    """Loss over each parameter."""
    trials = [trial for trial in result.trials if trial.state.name == "COMPLETE"]
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "x": [plain(each.in_unit(trial.params[name])) for trial in trials],
            "y": [plain(trial.value) for trial in trials],
            "hovertext": [_hover(trial, calibration) for trial in trials],
            "hoverinfo": "text",
            "xaxis": f"x{k + 1}" if k else "x",
            "yaxis": f"y{k + 1}" if k else "y",
            "marker": {
                "color": [trial.number for trial in trials],
                "colorscale": "Viridis",
                "size": 7,
                "line": {"width": 1, "color": "#999999"},
            },
        }
        for k, (name, each) in enumerate(calibration.parameters.items())
    ]
    axes = row_of_axes(list(map(escaped, _labels(calibration))), "loss")
    for key, each in axes.items():
        is_log = (
            key.startswith("y") or list(calibration.parameters.values())[int(key[5:] or 1) - 1].scale == "log"
        )
        each["type"] = "log" if is_log else "linear"
    return Plot(
        "Loss over each parameter, colored by the number of the trial",
        {
            "data": data,
            "layout": layout(HEIGHT, **axes),
        },
    )


def _labels(calibration: CalibrationInput) -> list[str]:
    """Short name of each parameter with its unit."""
    short = short_names(list(calibration.parameters))
    return [
        f"{short[name]} [{each.unit}]" if each.unit else short[name]
        for name, each in calibration.parameters.items()
    ]


def _hover(trial: Any, calibration: CalibrationInput) -> str:
    """Text at the pointer: number, loss, parameters and run directories of a trial."""
    short = short_names(list(calibration.parameters))
    values = [
        f"{escaped(short[name])} = {each.text(trial.params[name])}"
        for name, each in calibration.parameters.items()
    ]
    runs = [f"runs/{name}" for name in runs_of(trial).values()]
    return "<br>".join([f"trial {trial.number}: loss {trial.value:.4g}", *values, *runs])


def _importance(result: CalibrationResult, calibration: CalibrationInput) -> Plot | None:
    """Share of each parameter in the squared gradients of the residuals at the best values; None without a
    fit."""
    shares = [each.importance for each in result.parameters]
    if any(share != share for share in shares) or len(shares) < 2:
        return None
    data = {
        "type": "bar",
        "marker": {"color": COLORS[0]},
        "y": [plain(share) for share in shares],
        "x": list(map(escaped, short_names(list(calibration.parameters)).values())),
    }
    axes = {"xaxis": axis("", type="category"), "yaxis": axis("share")}
    caption = (
        "Importance: share of each parameter, scaled to its bounds, in the response of the targets near the "
        "best trial"
    )
    return Plot(caption, {"data": [data], "layout": layout(HEIGHT, **axes)})


def _trials(result: CalibrationResult, calibration: CalibrationInput) -> PageTable:
    """All trials: number, state, loss, parameters, simulated targets, runs and reasons."""
    rows = []
    units = {
        name: "" if each.value is None else each.value.unit for name, each in calibration.targets.items()
    }
    shown = {name: units[name] or unit_of(each.quantity) for name, each in calibration.targets.items()}
    for trial in result.trials:
        simulated = trial.user_attrs.get("simulated", {})
        loss = f"{trial.value:.4g}" if trial.state.name == "COMPLETE" else "–"
        parameters = [
            f"{each.in_unit(trial.params[name]):.4g}" if trial.params else "–"
            for name, each in calibration.parameters.items()
        ]
        targets = [
            f"{in_unit(simulated[name], unit):.4g}" if name in simulated else "–"
            for name, unit in units.items()
        ]
        ends = (
            " ".join(runs_of(trial).values()),
            trial.user_attrs.get("reason", ""),
            " ".join(warnings_of_trial(trial)),
        )
        rows.append((str(trial.number), state_of(trial), loss, *parameters, *targets, *ends))
    targets = [f"{name} [{unit}]" if unit else name for name, unit in shown.items()]
    heads = ["trial", "state", "loss", *_labels(calibration), *targets, "runs", "reason", "warnings"]
    return without_empty_ends(heads, rows)


# Runs a calibration: trials by several workers, then best values, tables and page.

POLL = 0.5
"""Interval [s] at which a request to stop is checked."""
MOST_FAILURES = 8
"""Number of failed trials, without any completed one, after which a calibration ends."""
REMEDY = "The trials that have ended are kept: correct this, and repeat the command."
"""Sentence on an error of a file."""
Report = Callable[[str], None]
"""Function that receives one line per trial."""


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
    refuse_other(
        "source", source, (str, os.PathLike, Mapping), "the path of a file, or a mapping with its keys"
    )
    if isinstance(source, Mapping):
        content, document = validated_mapping(source, CalibrationInput)
        folder = Path()
        name = "calibration"
    else:
        content, document = validated_file(Path(source), CalibrationInput, "calibration")
        folder = Path(source).parent
        name = Path(source).stem
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
    """As `run_calibration`, with `count` simultaneous trials; raises OSError for files that cannot be
    written."""
    out.mkdir(parents=True, exist_ok=True)
    search = Search(file.content, out)
    stop_file = out / f".stop_{search.worker}"
    common = RunSettings(out / "runs", threads, "cpu", stop_file)
    runner = TrialRunner(search, file.scenes, file.targets, file.positions, common, stop.is_set)
    runner.check()
    with locked(search.lock):
        search.release_lost()
        try:
            _Workers(runner, count, stop, report).run()
        finally:
            close_workers()
    result = result_of(search, file.targets)
    if result is not None:
        write_result(out, result)
        best = {each.name: each.value for each in result.parameters}
        write_best_scenes(out, file.content, file.scenes, best)
        write_calibration_page(out, file.content, result)
    return result


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
        """Carry out the trials. KeyboardInterrupt stops the runs, and is raised again when all have
        stopped."""
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
        """Carry out trials in one thread. Raises GranflowError if the first trials all fail, or if a scene
        changes."""
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
    try:
        import pandas
    except ImportError:
        raise GranflowError(
            "granflow.calibrate returns a DataFrame of pandas, which is not installed: pip install pandas"
        ) from None
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
