"""Results of a calibration, and its files: tables, scenes with the best values, and the page.

`result_of` makes the `CalibrationResult` of all trials so far: best values with uncertainties, targets at the
best values, and conflicts between targets.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import inf, nan, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow import Scene, load_scene
from granflow.io.files import replacing, write_text
from granflow.io.tables import write_table
from granflow.load import copied_scene
from granflow.scene.blocks.output import unit_of
from granflow.studies.calibration.response import (
    fewest_trials,
    fit_response,
    is_identified,
    sufficient_trials,
)
from granflow.studies.calibration.schema import (
    CalibrationInput,
    Target,
    deviation_in_units,
    from_unit,
    settings_of,
)
from granflow.studies.calibration.search import Search
from granflow.studies.calibration.trials import Measured, deviation, given_text
from granflow.studies.checked_run import overrides_of
from granflow.studies.figures import COLORS, POINTS, Drawing, PageTable, without_empty_ends, write_figures
from granflow.studies.interactive_plots import (
    COLOR_SCALE,
    Plot,
    escaped,
    express_library,
    plot_of_figure,
    short_names,
)
from granflow.studies.page import page_text
from granflow.units import factor_of, in_unit

# The result


@dataclass(frozen=True)
class BestValue:
    """Value of a parameter in the best trial, optimum of the fit near it, standard deviation of the latter.

    `optimum`: nan without a fit and for a parameter that the targets do not identify; `deviation`: nan
    without a fit; `importance`: share of the parameter in the response of the targets, 0 to 1, nan
    without a fit; `not_identified`: a sentence if the targets do not identify the parameter, otherwise empty;
    `shown`: texts of value, optimum and standard deviation in the unit of the bounds.
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
            "the tolerance, so its deviation says little: raise repeat.seeds, or simulate more particles, "
            "a larger region or a time average."
        )


@dataclass(frozen=True)
class CalibrationResult:
    """Best values, targets, sentences on targets that no trial reaches and on conflicts, and all trials of
    Optuna; `loss`: the smallest one.

    `warnings`: of the runs of the best trial.
    """

    loss: float
    parameters: tuple[BestValue, ...]
    targets: tuple[BestTarget, ...]
    out_of_reach: tuple[str, ...]
    conflicts: tuple[str, ...]
    trials: tuple[Any, ...]
    warnings: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on targets out of reach, on parameters that are not identified, on scatter above a
        tolerance, on conflicts, and warnings."""
        unidentified = [each.not_identified for each in self.parameters if each.not_identified]
        return (
            *self.out_of_reach,
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
    parameters = tuple(_best_values(search, completed, best))
    return CalibrationResult(
        completed[best].value,
        parameters,
        tuple(found),
        tuple(_out_of_reach(targets, completed)),
        tuple(_conflicts(targets, completed)),
        trials,
        warnings_of_trial(completed[best]),
    )


def _best_values(search: Search, completed: Sequence[Any], best: int) -> list[BestValue]:
    """Best values of all parameters, with their uncertainties."""
    parameters = search.calibration.parameters
    values = completed[best].params
    u, residuals = search.scaled(completed)
    response = fit_response(u, residuals, best)
    line = fit_response(u, residuals, best, search.standard_errors(completed), highest=1)
    deviations = optima = shares = np.full(len(parameters), nan)
    if response is not None and line is not None:
        optima = response.optimum(u[best])
        deviations = line.deviation(u[best])
        squares = (line.significant_gradient(u[best]) ** 2).sum(axis=0)
        shares = squares / (squares.sum() or 1.0)
    found = []
    for k, (name, each) in enumerate(parameters.items()):
        sentence = ""
        if response is None:
            sentence = (
                f"{name} cannot be identified from the targets: {len(completed)} completed trials are too "
                f"few, at least {fewest_trials(len(parameters))} are needed."
            )
        elif not is_identified(deviations[k]):
            enough = sufficient_trials(len(parameters))
            if line is not None and len(completed) < enough:
                sentence = (
                    f"{name} cannot be identified from {len(completed)} completed trials: with so few, an "
                    f"effect must be {line.least_ratio:.2g} times its standard error, with many 3 times. "
                    f"Raise search.trials until {enough} or more are completed."
                )
            else:
                sentence = (
                    f"{name} cannot be identified from the targets: near the best values, they respond to it "
                    "alone by too little, compared with their tolerances and the scatter between runs."
                )
        optimum = nan if sentence else from_unit(each, float(optima[k]))
        error = deviation_in_units(each, values[name], float(deviations[k]))
        shown = each.text(values[name], 5), each.text(optimum, 5), each.text(error, 2)
        found.append(BestValue(name, values[name], optimum, error, float(shares[k]), sentence, shown))
    return found


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


FEWEST_OF_REACH = 5
"""Smallest number of completed trials for a statement on targets out of reach."""


def _out_of_reach(targets: Mapping[str, Measured], completed: Sequence[Any]) -> list[str]:
    """Sentences on targets whose simulated values in all trials are on one side of the measured value, beyond
    its tolerance."""
    if len(completed) < FEWEST_OF_REACH:
        return []
    found = []
    for name, each in targets.items():
        if each.time is not None:
            continue
        measured = float(each.value[0])
        values = np.array([trial.user_attrs["simulated"][name] for trial in completed])
        nearest = min(deviation(each, trial.user_attrs["residuals"], name) for trial in completed)
        side = "below" if values.max() < measured else "above" if values.min() > measured else ""
        if side and nearest > 1.0:
            quantity = each.target.quantity
            ends = [given_text(each, float(end), quantity) for end in (values.min(), values.max())]
            found.append(
                f"{name} is out of reach: in all {len(completed)} trials {quantity} is {side} the measured "
                f"{given_text(each, measured, quantity)}, from {ends[0]} to {ends[1]}, at best by "
                f"{nearest:.2g} tolerances. Widen the bounds, vary another parameter, or check the scene and "
                "the measurement."
            )
    return found


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
    found: dict[str, list[Any]] = {"trial": [trial.number for trial in result.trials]}
    found["state"] = [state_of(trial) for trial in result.trials]
    found["loss"] = [trial.value if trial.state.name == "COMPLETE" else None for trial in result.trials]
    for name in names:
        found[name] = [trial.params.get(name) for trial in result.trials]
    for target in result.targets:
        unit = unit_of(target.quantity)
        heading = f"target.{target.name} [{unit}]" if unit else f"target.{target.name}"
        found[heading] = [trial.user_attrs.get("simulated", {}).get(target.name) for trial in result.trials]
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


def write_calibration_page(out: Path, calibration: CalibrationInput, result: CalibrationResult) -> None:
    """Write `calibration.html` and FIGURE to the directory of the calibration; without plotly, the page has
    tables only, and without matplotlib, there is no figure."""
    script = express_library()
    text = page_text(
        "calibration.html",
        plotly=script,
        title=calibration.title or f"Calibration of {' and '.join(calibration.scenes)}",
        lead=calibration.description or "Parameters from measured targets.",
        loss=result.loss,
        best=_best(result),
        targets=_targets(result, calibration.repeat.seeds),
        remarks=result.remarks,
        has_plots=bool(script),
        plots_of_trials=_plots(result, calibration) if script else [],
        trials=_trials(result, calibration),
    )
    write_text(out / PAGE, text)
    write_figures(out, {FIGURE: figure_of(result, calibration)})


FIGURE = "calibration.png"
"""Figure of the targets and the loss of the completed trials over all parameters."""
PANEL = (3.2, 2.2)
"""Width and height of a panel [inch]."""
MOST_PANELS = 6
"""Largest number of rows and of columns of panels: of targets and the loss, and of parameters."""


def figure_of(result: CalibrationResult, calibration: CalibrationInput) -> Drawing:
    """Each target, with standard errors and its tolerance as a band, and the loss over each parameter; the
    best trial is filled."""
    trials = [trial for trial in result.trials if trial.state.name == "COMPLETE"]
    best = min(range(len(trials)), key=lambda k: trials[k].value)
    parameters = dict(zip(calibration.parameters, _labels(calibration), strict=True))
    shown = dict(list(parameters.items())[:MOST_PANELS])
    targets = dict(list(calibration.targets.items())[: MOST_PANELS - 1])

    def draw(figure: Any) -> None:
        panels = figure.subplots(len(targets) + 1, len(shown), squeeze=False, sharey="row", sharex="col")
        for column, (name, label) in enumerate(shown.items()):
            each = calibration.parameters[name]
            at = np.array([each.in_unit(trial.params[name]) for trial in trials])
            for line, (key, target) in zip(panels, targets.items(), strict=False):
                values, errors, band, heading = _values_of_target(target, key, trials)
                line[column].axhspan(*band, color=COLORS[0], alpha=0.15, linewidth=0.0)
                _draw_trials(line[column], at, values, errors, best)
                if not column:
                    line[column].set_ylabel(heading)
            last = panels[-1][column]
            losses = np.array([trial.value for trial in trials])
            _draw_trials(last, at, losses, np.zeros(len(trials)), best)
            last.set_yscale("log")
            last.set_xlabel(label)
            if each.scale == "log":
                last.set_xscale("log")
        panels[-1][0].set_ylabel("loss")

    return Drawing(draw, 0.4 + PANEL[1] * (len(targets) + 1), 0.5 + PANEL[0] * len(shown))


def _values_of_target(
    target: Target, name: str, trials: Sequence[Any]
) -> tuple[np.ndarray, np.ndarray, tuple[float, float], str]:
    """Simulated values (trials,) of a target with their standard errors, its tolerance as a band, and its
    label, in the unit of the target; of a curve the root mean square difference."""
    unit = "" if target.value is None else target.value.unit
    values = [in_unit(trial.user_attrs["simulated"][name], unit) for trial in trials]
    factor = factor_of(unit, "any")
    tolerance = target.tolerance / factor
    if target.value is None:
        errors = [0.0] * len(trials)
        band, words = (0.0, tolerance), f"{name}, rms difference"
    else:
        share = [trial.user_attrs["errors"][name][0] / sqrt(target.weight) for trial in trials]
        errors = [tolerance * each for each in share]
        measured = in_unit(float(target.value), unit)
        band, words = (measured - tolerance, measured + tolerance), name
    shown = unit or unit_of(target.quantity)
    return np.array(values), np.array(errors), band, f"{words} [{shown}]" if shown else words


def _draw_trials(axes: Any, at: np.ndarray, values: np.ndarray, errors: np.ndarray, best: int) -> None:
    """Points of all trials with their standard errors; that of the best trial is filled."""
    axes.errorbar(at, values, errors, color=COLORS[0], marker="o", capsize=2.0, elinewidth=0.6, **POINTS)
    axes.plot(at[best], values[best], color=COLORS[1], marker="o", markersize=5.0, linestyle="none", zorder=5)


def _best(result: CalibrationResult) -> PageTable:
    """Best values, optima of the fit and their standard deviations."""
    rows = [(each.name, *each.shown, "no" if each.not_identified else "yes") for each in result.parameters]
    return PageTable(
        ("parameter", "best trial", "optimum of the fit", "standard deviation", "identified"), rows
    )


def _targets(result: CalibrationResult, seeds: int) -> PageTable:
    """Targets at the best values, means over the seeds."""
    simulated = "simulated" if seeds == 1 else f"simulated, mean of {seeds} seeds"
    rows = [
        (each.name, each.quantity, *each.shown, f"{each.error:.2g}", f"{each.deviation:.2g}")
        for each in result.targets
    ]
    ratios = ("standard error / tolerance", "deviation / tolerance")
    return PageTable(("target", "quantity", "measured", simulated, *ratios), rows)


def _plots(result: CalibrationResult, calibration: CalibrationInput) -> list[Plot]:
    """Loss of each completed trial with the smallest one so far, loss over each parameter, importances."""
    import pandas
    import plotly.express as px
    from plotly.subplots import make_subplots

    trials = [trial for trial in result.trials if trial.state.name == "COMPLETE"]
    labels = dict(zip(calibration.parameters, map(escaped, _labels(calibration)), strict=True))
    frame = pandas.DataFrame(
        {
            "trial": [trial.number for trial in trials],
            "loss": [trial.value for trial in trials],
            **{
                labels[name]: [each.in_unit(trial.params[name]) for trial in trials]
                for name, each in calibration.parameters.items()
            },
            "runs": [" ".join(runs_of(trial).values()) for trial in trials],
        }
    )
    convergence = px.scatter(
        frame, x="trial", y="loss", log_y=True, hover_data=[*labels.values(), "runs"], opacity=0.6
    )
    convergence.add_scatter(
        x=frame["trial"], y=frame["loss"].cummin(), name="smallest so far", mode="lines", line_shape="hv"
    )
    losses = make_subplots(1, len(labels), shared_yaxes=True)
    for k, (name, label) in enumerate(labels.items(), 1):
        points = px.scatter(frame, x=label, y="loss", color="trial", hover_data=["runs"])
        losses.add_trace(points.data[0], 1, k)
        is_logarithmic = calibration.parameters[name].scale == "log"
        losses.update_xaxes(title_text=label, type="log" if is_logarithmic else "linear", col=k)
    losses.update_yaxes(type="log")
    losses.update_yaxes(title_text="loss", col=1)
    found = [
        plot_of_figure("Convergence: loss of each trial and smallest loss so far", convergence),
        plot_of_figure(
            "Loss over each parameter, colored by the number of the trial",
            losses,
            coloraxis={"colorscale": COLOR_SCALE, "colorbar": {"title": {"text": "trial"}}},
        ),
    ]
    shares = {escaped(each.name): each.importance for each in result.parameters}
    if len(shares) > 1 and not any(share != share for share in shares.values()):
        bars = px.bar(x=list(shares), y=list(shares.values()), labels={"x": "", "y": "share"})
        caption = "Importance: share of each parameter in the response of the targets near the best trial"
        found.append(plot_of_figure(caption, bars))
    return found


def _labels(calibration: CalibrationInput) -> list[str]:
    """Short name of each parameter with its unit."""
    short = short_names(list(calibration.parameters))
    return [
        f"{short[name]} [{each.unit}]" if each.unit else short[name]
        for name, each in calibration.parameters.items()
    ]


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
