"""The page of a calibration: best values, targets, conflicts, convergence, importance, all trials."""

from pathlib import Path
from typing import Any

import numpy as np

from granflow.fields import unit_of
from granflow.io.atomic_files import write_text
from granflow.scene.schema.given_numbers import in_unit
from granflow.studies.calibration.results import CalibrationResult, runs_of, state_of, warnings_of_trial
from granflow.studies.calibration.schema import CalibrationInput
from granflow.studies.figures import COLORS
from granflow.studies.page import page_text
from granflow.studies.report.plots import Plot, escaped, library
from granflow.studies.sweep.axes import axis, layout, plain, row_of_axes, short_names
from granflow.studies.tables import PageTable, without_empty_ends

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
    rows = [
        (each.name, *each.shown, "no" if each.not_identified else "yes") for each in result.parameters
    ]  # fmt: skip
    return PageTable(("parameter", "best trial", "optimum of the fit", "standard deviation", "identified"), rows)


def _targets(result: CalibrationResult) -> PageTable:
    """Targets at the best values."""
    rows = [(each.name, each.quantity, *each.shown, f"{each.deviation:.2g}") for each in result.targets]
    return PageTable(("target", "quantity", "measured", "simulated", "deviation / tolerance"), rows)


def _convergence(result: CalibrationResult, calibration: CalibrationInput) -> Plot:
    """Loss of each completed trial, and the smallest loss so far."""
    trials = [trial for trial in result.trials if trial.state.name == "COMPLETE"]
    numbers, losses = [trial.number for trial in trials], [trial.value for trial in trials]
    data = [
        {"type": "scatter", "mode": "markers", "name": "trial", "x": numbers, "y": [plain(each) for each in losses],
         "hovertext": [_hover(trial, calibration) for trial in trials], "hoverinfo": "text",
         "marker": {"color": COLORS[5]}},
        {"type": "scatter", "mode": "lines", "name": "smallest so far", "x": numbers, "line": {"shape": "hv"},
         "y": [plain(float(each)) for each in np.minimum.accumulate(losses)], "marker": {"color": COLORS[0]}},
    ]  # fmt: skip
    axes = {"xaxis": axis("trial"), "yaxis": axis("loss", type="log")}
    return Plot("Convergence: loss of each trial and smallest loss so far", {
        "data": data, "layout": layout(HEIGHT, **axes) | {"showlegend": True},
    })  # fmt: skip


def _losses(result: CalibrationResult, calibration: CalibrationInput) -> Plot:
    """Loss over each parameter."""
    trials = [trial for trial in result.trials if trial.state.name == "COMPLETE"]
    data = [
        {"type": "scatter", "mode": "markers", "x": [plain(each.in_unit(trial.params[name])) for trial in trials],
         "y": [plain(trial.value) for trial in trials], "hovertext": [_hover(trial, calibration) for trial in trials],
         "hoverinfo": "text", "xaxis": f"x{k + 1}" if k else "x", "yaxis": f"y{k + 1}" if k else "y",
         "marker": {"color": [trial.number for trial in trials], "colorscale": "Viridis", "size": 7,
                    "line": {"width": 1, "color": "#999999"}}}
        for k, (name, each) in enumerate(calibration.parameters.items())
    ]  # fmt: skip
    axes = row_of_axes(list(map(escaped, _labels(calibration))), "loss")
    for key, each in axes.items():
        is_log = key.startswith("y") or list(calibration.parameters.values())[int(key[5:] or 1) - 1].scale == "log"
        each["type"] = "log" if is_log else "linear"
    return Plot("Loss over each parameter, colored by the number of the trial", {
        "data": data, "layout": layout(HEIGHT, **axes),
    })  # fmt: skip


def _labels(calibration: CalibrationInput) -> list[str]:
    """Short name of each parameter with its unit."""
    short = short_names(list(calibration.parameters))
    return [
        f"{short[name]} [{each.unit}]" if each.unit else short[name] for name, each in calibration.parameters.items()
    ]


def _hover(trial: Any, calibration: CalibrationInput) -> str:
    """Text at the pointer: number, loss, parameters and run directories of a trial."""
    short = short_names(list(calibration.parameters))
    values = [
        f"{escaped(short[name])} = {each.text(trial.params[name])}" for name, each in calibration.parameters.items()
    ]
    runs = [f"runs/{name}" for name in runs_of(trial).values()]
    return "<br>".join([f"trial {trial.number}: loss {trial.value:.4g}", *values, *runs])


def _importance(result: CalibrationResult, calibration: CalibrationInput) -> Plot | None:
    """Share of each parameter in the squared gradients of the residuals at the best values; None without a fit."""
    shares = [each.importance for each in result.parameters]
    if any(share != share for share in shares) or len(shares) < 2:
        return None
    data = {
        "type": "bar", "marker": {"color": COLORS[0]}, "y": [plain(share) for share in shares],
        "x": list(map(escaped, short_names(list(calibration.parameters)).values())),
    }  # fmt: skip
    axes = {"xaxis": axis("", type="category"), "yaxis": axis("share")}
    caption = (
        "Importance: share of each parameter, scaled to its bounds, in the response of the targets near the best trial"
    )
    return Plot(caption, {"data": [data], "layout": layout(HEIGHT, **axes)})


def _trials(result: CalibrationResult, calibration: CalibrationInput) -> PageTable:
    """All trials: number, state, loss, parameters, simulated targets, runs and reasons."""
    rows = []
    units = {name: "" if each.value is None else each.value.unit for name, each in calibration.targets.items()}
    shown = {name: units[name] or unit_of(each.quantity) for name, each in calibration.targets.items()}
    for trial in result.trials:
        simulated = trial.user_attrs.get("simulated", {})
        loss = f"{trial.value:.4g}" if trial.state.name == "COMPLETE" else "–"
        parameters = [
            f"{each.in_unit(trial.params[name]):.4g}" if trial.params else "–"
            for name, each in calibration.parameters.items()
        ]
        targets = [
            f"{in_unit(simulated[name], unit):.4g}" if name in simulated else "–" for name, unit in units.items()
        ]
        ends = " ".join(runs_of(trial).values()), trial.user_attrs.get("reason", ""), " ".join(warnings_of_trial(trial))
        rows.append((str(trial.number), state_of(trial), loss, *parameters, *targets, *ends))
    targets = [f"{name} [{unit}]" if unit else name for name, unit in shown.items()]
    heads = ["trial", "state", "loss", *_labels(calibration), *targets, "runs", "reason", "warnings"]
    return without_empty_ends(heads, rows)
