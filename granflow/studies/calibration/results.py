"""Results of a calibration: best values with uncertainties, targets, conflicts, and the scenes with the best values."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow import Scene, load_scene
from granflow.io.atomic_files import replacing, write_text
from granflow.io.tables import write_table
from granflow.load import copied_scene
from granflow.studies.calibration.identification import Effects, identification
from granflow.studies.calibration.response import fewest_trials
from granflow.studies.calibration.schema import CalibrationInput, Parameter
from granflow.studies.calibration.search import Search, deviation_in_units, from_unit, settings_of
from granflow.studies.calibration.targets import Measured, deviation, given_text
from granflow.studies.run_processes.settings import overrides_of

FEWEST_TRIALS = 20
"""Smallest number of completed trials for a statement on conflicts."""


@dataclass(frozen=True)
class BestValue:
    """Value of a parameter in the best trial, optimum of the fit to all trials, and standard deviation of the latter.

    `optimum`: nan without a fit and for a parameter that the targets do not identify; `deviation`: nan without a fit;
    `importance`: share of the parameter in the response of the targets, 0 to 1, nan without a fit; `not_identified`: a
    sentence if the targets do not identify the parameter, otherwise empty; `shown`: texts of value, optimum and
    standard deviation in the unit of the bounds.
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

    `error`: standard error that the run gives for the simulated value, in tolerances; 0 if it has none. `shown`: texts
    of the measured and the simulated value, with its error, in the unit in which the calibration gives the target.
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
            f"{self.name}: the standard error of {self.quantity} in the best trial is {self.error:.2g} times the "
            "tolerance, so its deviation says little: simulate more particles, a larger region or a time average."
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
        """Sentences on parameters that are not identified, on scatter above a tolerance, on conflicts, and warnings."""
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
        completed[best].value, parameters, tuple(found), tuple(_conflicts(targets, completed)), trials,
        warnings_of_trial(completed[best]),
    )  # fmt: skip


def _best_values(
    search: Search, targets: Mapping[str, Measured], completed: Sequence[Any], best: int
) -> list[BestValue]:
    """Best values of all parameters, with their uncertainties."""
    parameters, values = search.calibration.parameters, completed[best].params
    trials = [*completed, *search.stopped_early()]
    u, residuals = search.scaled(trials)
    known = identification(u, residuals, search.standard_errors(trials), best)
    if known is None:
        few = f"{len(completed)} completed trials are too few, at least {fewest_trials(len(parameters))} are needed"
        return [
            _best_value(
                name, each, values[name], (nan, nan, nan), f"{name} cannot be identified from the targets: {few}."
            )
            for name, each in parameters.items()
        ]
    found = []
    for k, (name, each) in enumerate(parameters.items()):
        error = deviation_in_units(each, values[name], float(known.deviation[k]))
        optimum = from_unit(each, float(known.optimum[k])) if known.is_identified(k) else nan
        sentence = known.statement(list(parameters), k, _strongest_change(targets, known.effects, k))
        found.append(_best_value(name, each, values[name], (optimum, error, float(known.importance[k])), sentence))
    return found


def _strongest_change(targets: Mapping[str, Measured], effects: Effects, index: int) -> str:
    """Text of the most significant effect of a parameter over its bounds, such as `angle changes by 2 ± 1 deg`."""
    names = [name for name, each in targets.items() for _ in each.value]
    strongest = effects.strongest(index)
    measured = targets[names[strongest]]
    change, error = (each[strongest, index] / measured.scale for each in (effects.change, effects.error))
    text = given_text(measured, change, measured.target.quantity, 2)
    return f"{names[strongest]} changes by {text} \N{PLUS-MINUS SIGN} {error / measured.factor:.2g}"


def _best_value(
    name: str, parameter: Parameter, value: float, fitted: tuple[float, float, float], not_identified: str
) -> BestValue:
    """The best value of a parameter with its texts; `fitted`: optimum, standard deviation, importance."""
    optimum, error, importance = fitted
    shown = parameter.text(value, 5), parameter.text(optimum, 5), parameter.text(error, 2)
    return BestValue(name, value, optimum, error, importance, not_identified, shown)


def _best_target(name: str, measured: Measured, trial: Any) -> BestTarget:
    """A target at the best trial."""
    value = float(measured.value[0]) if measured.time is None else nan
    size = deviation(measured, trial.user_attrs["residuals"], name)
    error = deviation(measured, trial.user_attrs["errors"], name)
    quantity, simulated = measured.target.quantity, trial.user_attrs["simulated"][name]
    shown = given_text(measured, simulated, quantity)
    if error > 0.0 and measured.time is None:
        shown += f" \N{PLUS-MINUS SIGN} {error * measured.target.tolerance / measured.factor:.2g}"
    given = "curve" if measured.time is not None else given_text(measured, value, quantity)
    return BestTarget(name, quantity, value, simulated, size, error, (given, shown))


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
                f"{first} and {second} conflict: of {len(completed)} trials, {int(met[0].sum())} meet {first} and "
                f"{int(met[1].sum())} meet {second} within the tolerance, but none meets both."
            )
    return found


def write_best_scenes(
    out: Path, calibration: CalibrationInput, scenes: Mapping[str, Path], values: Mapping[str, float]
) -> list[Path]:
    """Write each scene with the best values, ready to run: `best.yaml`, or `best_NAME.yaml` of several scenes."""
    written, taken = [], dict[str, Path]()
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
        source, target = (scene.folder / name).resolve(), out / copy
        if source.exists() and target.resolve() != source:
            target.parent.mkdir(parents=True, exist_ok=True)
            with replacing(target) as temporary:
                shutil.copyfile(source, temporary)


def trial_columns(result: CalibrationResult) -> dict[str, list[Any]]:
    """Columns of `trials.csv`: number, state, loss, parameters, simulated values, reason, warnings, runs.

    None if missing.
    """
    names, targets = [each.name for each in result.parameters], [each.name for each in result.targets]
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


def _number(value: float) -> float | None:
    return value if -inf < value < inf else None
