"""Results of a calibration, and its files: tables, scenes with the best values, and the page.

`result_of` makes the `CalibrationResult` of all trials so far: best values with uncertainties, targets at the
best values, and conflicts between targets.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow import Scene, load_scene
from granflow.io.files import replacing, write_text
from granflow.io.tables import write_table
from granflow.load import copied_scene
from granflow.scene.blocks.output import unit_of
from granflow.studies.calibration.response import Effects, fewest_trials, identification
from granflow.studies.calibration.schema import (
    CalibrationInput,
    Parameter,
    deviation_in_units,
    from_unit,
    settings_of,
)
from granflow.studies.calibration.search import Search
from granflow.studies.calibration.trials import Measured, deviation, given_text
from granflow.studies.checked_run import overrides_of
from granflow.studies.figures import COLORS, PageTable, without_empty_ends
from granflow.studies.interactive_plots import (
    Plot,
    axis,
    escaped,
    layout,
    library,
    plain_number,
    row_of_axes,
    short_names,
)
from granflow.studies.page import page_text
from granflow.units import in_unit

# The result


@dataclass(frozen=True)
class BestValue:
    """Value of a parameter in the best trial, optimum of the fit to all trials, and standard deviation of the
    latter.

    `optimum`: nan without a fit and for a parameter that the targets do not identify; `deviation`: nan
    without a fit; `importance`: share of the parameter in the response of the targets, 0 to 1, nan without a
    fit; `not_identified`: a sentence if the targets do not identify the parameter, otherwise empty; `shown`:
    texts of value, optimum and standard deviation in the unit of the bounds.
    """

    name: str
    value: float
    optimum: float
    deviation: float
    importance: float
    not_identified: str
    shown: tuple[str, str, str]


class BestTarget(NamedTuple):
    """A target at the best values: measured (nan for a curve) and simulated value, deviation in tolerances.

    `error`: standard error that the run gives for the simulated value, in tolerances; 0 if it has none.
    `shown`: texts of the measured and the simulated value, with its error, in the unit in which the
    calibration gives the target.
    """

    name: str
    quantity: str
    measured: float
    simulated: float
    deviation: float
    error: float
    shown: tuple[str, str]

    @property
    def noise(self) -> str:
        """A sentence if the scatter of the simulated value exceeds the tolerance; otherwise empty."""
        if self.error <= 1.0:
            return ""
        return (
            f"{self.name}: the standard error of {self.quantity} in the best trial is {self.error:.2g} times "
            "the tolerance, so its deviation says little: simulate more particles, a larger region or a time "
            "average."
        )


@dataclass(frozen=True)
class CalibrationResult:
    """Best values, targets, sentences on conflicts, and all trials of Optuna; `loss`: the smallest one.

    `warnings`: of the runs of the best trial.
    """

    loss: float
    parameters: tuple[BestValue, ...]
    targets: tuple[BestTarget, ...]
    conflicts: tuple[str, ...]
    trials: tuple[Any, ...]
    warnings: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on parameters that are not identified, on scatter above a tolerance, on conflicts, and
        warnings."""
        unidentified = [each.not_identified for each in self.parameters if each.not_identified]
        return (
            *unidentified,
            *(each.noise for each in self.targets if each.noise),
            *self.conflicts,
            *(f"Warning of the best trial, {sentence}" for sentence in self.warnings),
        )

    @property
    def is_met(self) -> bool:
        """Whether each target is met within its tolerance."""
        return all(each.deviation <= 1.0 for each in self.targets)


def result_of(search: Search, targets: Mapping[str, Measured]) -> CalibrationResult | None:
    """The result of all trials so far; None without a completed trial."""
    completed = search.completed()
    if not completed:
        return None
    best = int(np.argmin([trial.value for trial in completed]))
    found = [_best_target(name, each, completed[best]) for name, each in targets.items()]
    trials = tuple(search.study.get_trials(deepcopy=False))
    parameters = tuple(_best_values(search, targets, completed, best))
    return CalibrationResult(
        completed[best].value,
        parameters,
        tuple(found),
        tuple(_conflicts(targets, completed)),
        trials,
        warnings_of_trial(completed[best]),
    )


def _best_values(
    search: Search, targets: Mapping[str, Measured], completed: Sequence[Any], best: int
) -> list[BestValue]:
    """Best values of all parameters, with their uncertainties."""
    parameters = search.calibration.parameters
    values = completed[best].params
    trials = [*completed, *search.stopped_early()]
    u, residuals = search.scaled(trials)
    known = identification(u, residuals, search.standard_errors(trials), best)
    if known is None:
        few = (
            f"{len(completed)} completed trials are too few, at least {fewest_trials(len(parameters))} are "
            "needed"
        )
        return [
            _best_value(
                name,
                each,
                values[name],
                (nan, nan, nan),
                f"{name} cannot be identified from the targets: {few}.",
            )
            for name, each in parameters.items()
        ]
    found = []
    for k, (name, each) in enumerate(parameters.items()):
        error = deviation_in_units(each, values[name], float(known.deviation[k]))
        optimum = from_unit(each, float(known.optimum[k])) if known.is_identified(k) else nan
        sentence = known.statement(list(parameters), k, _strongest_change(targets, known.effects, k))
        found.append(
            _best_value(name, each, values[name], (optimum, error, float(known.importance[k])), sentence)
        )
    return found


def _best_value(
    name: str, parameter: Parameter, value: float, fitted: tuple[float, float, float], not_identified: str
) -> BestValue:
    """The best value of a parameter with its texts; `fitted`: optimum, standard deviation, importance."""
    optimum, error, importance = fitted
    shown = parameter.text(value, 5), parameter.text(optimum, 5), parameter.text(error, 2)
    return BestValue(name, value, optimum, error, importance, not_identified, shown)


def _strongest_change(targets: Mapping[str, Measured], effects: Effects, index: int) -> str:
    """Text of the most significant effect of a parameter over its bounds, such as
    `angle changes by 2 ± 1 deg`."""
    names = [name for name, each in targets.items() for _ in each.value]
    strongest = effects.strongest(index)
    measured = targets[names[strongest]]
    change, error = (each[strongest, index] / measured.scale for each in (effects.change, effects.error))
    text = given_text(measured, change, measured.target.quantity, 2)
    return f"{names[strongest]} changes by {text} \N{PLUS-MINUS SIGN} {error / measured.factor:.2g}"


def _best_target(name: str, measured: Measured, trial: Any) -> BestTarget:
    """A target at the best trial."""
    value = float(measured.value[0]) if measured.time is None else nan
    size = deviation(measured, trial.user_attrs["residuals"], name)
    error = deviation(measured, trial.user_attrs["errors"], name)
    quantity = measured.target.quantity
    simulated = trial.user_attrs["simulated"][name]
    shown = given_text(measured, simulated, quantity)
    if error > 0.0 and measured.time is None:
        shown += f" \N{PLUS-MINUS SIGN} {error * measured.target.tolerance / measured.factor:.2g}"
    given = "curve" if measured.time is not None else given_text(measured, value, quantity)
    return BestTarget(name, quantity, value, simulated, size, error, (given, shown))


FEWEST_TRIALS = 20
"""Smallest number of completed trials for a statement on conflicts."""


def _conflicts(targets: Mapping[str, Measured], completed: Sequence[Any]) -> list[str]:
    """Sentences on pairs of targets of which trials meet each one, but none both."""
    if len(completed) < FEWEST_TRIALS:
        return []
    sizes = {
        name: np.array([deviation(each, trial.user_attrs["residuals"], name) for trial in completed])
        for name, each in targets.items()
    }
    found = []
    for first, second in combinations(targets, 2):
        met = sizes[first] <= 1.0, sizes[second] <= 1.0
        if met[0].any() and met[1].any() and not (met[0] & met[1]).any():
            found.append(
                f"{first} and {second} conflict: of {len(completed)} trials, {int(met[0].sum())} meet "
                f"{first} and {int(met[1].sum())} meet {second} within the tolerance, but none meets both."
            )
    return found


# Attributes of trials of Optuna


def runs_of(trial: Any) -> dict[str, str]:
    """Names of the run directories of a trial by scene."""
    return {key[4:]: value for key, value in trial.user_attrs.items() if key.startswith("run.")}


def warnings_of_trial(trial: Any) -> tuple[str, ...]:
    """Warnings of the runs of a trial, each with the name of its scene."""
    return tuple(trial.user_attrs.get("warnings", ()))


def state_of(trial: Any) -> str:
    """State of a trial in words."""
    words = {"COMPLETE": "completed", "PRUNED": "stopped early", "FAIL": "failed", "RUNNING": "running"}
    return words.get(trial.state.name, "waiting")


# Tables


def write_result(out: Path, result: CalibrationResult) -> None:
    """Write `trials.csv` and `best.csv`, each atomically."""
    best = {
        "parameter": [each.name for each in result.parameters],
        "value": [each.value for each in result.parameters],
        "optimum_of_fit": [_number(each.optimum) for each in result.parameters],
        "standard_deviation": [_number(each.deviation) for each in result.parameters],
        "identified": [not each.not_identified for each in result.parameters],
        "remark": [each.not_identified for each in result.parameters],
    }
    for name, columns in (("trials.csv", trial_columns(result)), ("best.csv", best)):
        with replacing(out / name) as temporary:
            write_table(temporary, columns, zip(*columns.values(), strict=True))


def trial_columns(result: CalibrationResult) -> dict[str, list[Any]]:
    """Columns of `trials.csv`: number, state, loss, parameters, simulated values, reason, warnings, runs.

    None if missing.
    """
    names = [each.name for each in result.parameters]
    targets = [each.name for each in result.targets]
    found: dict[str, list[Any]] = {"trial": [trial.number for trial in result.trials]}
    found["state"] = [state_of(trial) for trial in result.trials]
    found["loss"] = [trial.value if trial.state.name == "COMPLETE" else None for trial in result.trials]
    for name in names:
        found[name] = [trial.params.get(name) for trial in result.trials]
    for name in targets:
        found[f"target.{name}"] = [trial.user_attrs.get("simulated", {}).get(name) for trial in result.trials]
    found["reason"] = [trial.user_attrs.get("reason") for trial in result.trials]
    found["warnings"] = [" ".join(warnings_of_trial(trial)) for trial in result.trials]
    found["runs"] = [" ".join(runs_of(trial).values()) for trial in result.trials]
    return found


def _number(value: float) -> float | None:
    return value if -inf < value < inf else None


# Scenes with the best values


def write_best_scenes(
    out: Path, calibration: CalibrationInput, scenes: Mapping[str, Path], values: Mapping[str, float]
) -> list[Path]:
    """Write each scene with the best values, ready to run: `best.yaml`, or `best_NAME.yaml` of several
    scenes."""
    written = []
    taken = dict[str, Path]()
    for name, path in scenes.items():
        scene = load_scene(path, overrides_of(settings_of(calibration, name, values)))
        copied = copied_scene(scene, taken)
        target = out / ("best.yaml" if len(scenes) == 1 else f"best_{name}.yaml")
        write_text(target, copied.to_yaml())
        _copy_inputs(scene, copied, out)
        written.append(target)
    return written


def _copy_inputs(scene: Scene, copied: Scene, out: Path) -> None:
    """Copy the input files of a scene to the directory, to the paths that `copied` contains."""
    for (_, name), (_, copy) in zip(scene.input_names(), copied.input_names(), strict=True):
        source = (scene.folder / name).resolve()
        target = out / copy
        if source.exists() and target.resolve() != source:
            target.parent.mkdir(parents=True, exist_ok=True)
            with replacing(target) as temporary:
                shutil.copyfile(source, temporary)


# The page

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
            "y": [plain_number(each) for each in losses],
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
            "y": [plain_number(float(each)) for each in np.minimum.accumulate(losses)],
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
            "x": [plain_number(each.in_unit(trial.params[name])) for trial in trials],
            "y": [plain_number(trial.value) for trial in trials],
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
    """Share of each parameter in the squared gradients of the residuals at the best values.

    There is no plot without a fit.
    """
    shares = [each.importance for each in result.parameters]
    if any(share != share for share in shares) or len(shares) < 2:
        return None
    data = {
        "type": "bar",
        "marker": {"color": COLORS[0]},
        "y": [plain_number(share) for share in shares],
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
