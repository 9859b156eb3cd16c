"""The schema of calibration files: scenes, parameters with bounds, and targets with tolerances.

The functions at the end convert a parameter between its value and its position between the bounds, 0 to 1, in
which the search and the fits work.
"""

from collections.abc import Iterator, Mapping
from math import log
from typing import Annotated, Any, Literal

from pydantic import Field

from granflow.scene.blocks.output import unit_of
from granflow.scene.blocks.scene import Seed
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, missing, redundant, whole
from granflow.schema.messages import suggestion_or_list
from granflow.schema.model import FileName, ListOf, Model, Name, Text
from granflow.schema.quantities import GivenQuantity, NumberWithUnit, bound_faults
from granflow.studies.sweep_design import Repeat
from granflow.units import ZERO_POINTS, GivenNumber, in_si, in_unit, mixed_units, unit_conflict

Keys = Annotated[tuple[Text, ...], ListOf(one=True, some="[pairs.glass-glass.friction]")]
Tolerance = Annotated[GivenNumber, NumberWithUnit("any", noun="a tolerance", above=0)]


class CalibrationScene(Model):
    """A scene that each trial runs."""

    scene: FileName = Field(description="scene file, relative to the folder of this file")
    settings: dict[Text, Any] = Field(
        {}, alias="set", description="values of other keys of the scene in all trials"
    )


class Parameter(Model):
    """A parameter to determine, between two bounds."""

    start: GivenQuantity = Field(alias="from", description="lower bound")
    stop: GivenQuantity = Field(alias="to", description="upper bound")
    scale: Literal["linear", "log"] = Field("linear", description="scale of the search: linear or log")
    keys: Keys | None = Field(None, description="keys of all scenes that get the value; default: the name")
    keys_in: dict[Name, Keys] = Field({}, description="further keys by scene, which only this scene has")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the upper bound is larger, both have one unit, and those of a logarithm are
        positive."""
        yield from bound_faults(self.start, self.stop, self.scale)

    @property
    def unit(self) -> str:
        """The unit in which the bounds are given; empty: SI."""
        return self.start.unit or self.stop.unit

    def in_unit(self, value: float) -> float:
        """The SI number `value` in the unit of the bounds."""
        return in_unit(value, self.unit)

    def text(self, value: float, digits: int = 4) -> str:
        """Text of the SI number `value` in the unit of the bounds; a dash for NaN."""
        return "–" if value != value else f"{self.in_unit(value):.{digits}g} {self.unit}".rstrip()


class Target(Model):
    """A measured number, or a measured curve over time, that the scene must reproduce."""

    scene: Name = Field(description="name of the scene, in scenes")
    quantity: Text = Field(description="number of the result, or for a curve column of the time series")
    value: GivenQuantity | None = Field(None, description="measured value")
    curve: FileName | None = Field(
        None, description="CSV file with the columns time and value, SI or with units, such as time [ms]"
    )
    stage: Name | None = Field(
        None, description="with curve: stage whose beginning is time 0; default: that of the run"
    )
    tolerance: Tolerance = Field(
        description="standard deviation of the measurement, in the unit of the quantity"
    )
    weight: q.Positive = Field(1.0, description="factor of the target in the loss")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of value and curve is given, with the units of the quantity."""
        if self.value is None and self.curve is None:
            yield missing(("value",), "the measured value, or curve with a CSV file")
        if self.value is not None and self.curve is not None:
            yield redundant("value", "curve")
        if self.stage is not None and self.curve is None:
            yield Fault(("stage",), "it requires curve; remove stage")
        if self.value is not None and (reason := mixed_units((self.value, self.tolerance))):
            yield Fault(("tolerance",), reason)
        for key in ("value", "tolerance"):
            given = getattr(self, key)
            if given is not None and given.unit in ZERO_POINTS:
                yield Fault(
                    (key,), f"targets are compared by differences, which have no {given.unit}: give K"
                )
                continue
            if given is not None and (reason := unit_conflict(given.unit, unit_of(self.quantity))):
                yield Fault((key,), f"{self.quantity} is {reason}")


class Search(Model):
    """The search for the best parameters."""

    method: Literal["tpe", "cma_es", "gp"] = Field("tpe", description="sampler of Optuna: tpe, cma_es or gp")
    trials: q.Count = Field(60, description="number of trials")
    seed: Seed = Field(1, description="seed of the sampler")


class CalibrationInput(Model):
    """A calibration: scenes, parameters with bounds, and targets with tolerances."""

    title: Text | None = Field(None, description="title of the calibration, one line")
    description: Text | None = Field(
        None, description="description of the calibration and its expected result"
    )
    scenes: dict[Name, CalibrationScene] = Field(description="scenes that each trial runs, by name")
    parameters: dict[Text, Parameter] = Field(description="parameters by name; the default key is the name")
    targets: dict[Name, Target] = Field(description="targets by name")
    search: Search = Field(Search(), description="method, number of trials and seed")
    repeat: Repeat = Field(
        Repeat(seeds=1),
        description="repetition of each trial with other seeds: the loss is that of the means",
    )

    def faults(self) -> Iterator[Fault]:
        """Yield faults between the parts: empty parts, unknown scenes, keys given twice."""
        for part in ("scenes", "parameters", "targets"):
            if not getattr(self, part):
                yield missing((part,), "at least one entry")
        for name, target in self.targets.items():
            yield from self._unknown_scene(("targets", name, "scene"), target.scene)
        used = {target.scene for target in self.targets.values()}
        for name in self.scenes:
            if name not in used:
                yield whole(("scenes", name), "has no target; remove it, or add a target")
        for name, parameter in self.parameters.items():
            for scene in parameter.keys_in:
                yield from self._unknown_scene(("parameters", name, "keys_in", scene), scene)
        yield from self._repeated_keys()

    def _unknown_scene(self, path: tuple[str, ...], name: str) -> Iterator[Fault]:
        """A fault if there is no scene of this name."""
        if name not in self.scenes:
            yield Fault(path, f"there is no such scene. {suggestion_or_list(name, self.scenes, 'scenes')}")

    def _repeated_keys(self) -> Iterator[Fault]:
        """Faults of keys of a scene that several entries set."""
        for scene, each in self.scenes.items():
            seen: dict[str, str] = dict.fromkeys(each.settings, f"scenes.{scene}.set")
            for name in self.parameters:
                for key in self.keys_of(name, scene):
                    if key in seen:
                        yield whole(
                            ("parameters", name), f"sets {key}, which {seen[key]} sets too; keep one of them"
                        )
                    seen[key] = f"parameters.{name}"
            if self.repeat.seeds > 1 and "seed" in seen:
                yield whole(("repeat",), f"changes the seed, which {seen['seed']} sets too; keep one of them")

    def keys_of(self, name: str, scene: str) -> tuple[str, ...]:
        """Keys of a scene that a parameter sets."""
        parameter = self.parameters[name]
        default = () if parameter.keys_in else (name,)
        return (*(default if parameter.keys is None else parameter.keys), *parameter.keys_in.get(scene, ()))


def settings_of(calibration: CalibrationInput, scene: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Values of the keys of a scene for values of the parameters [SI]; with a unit if the bounds have one."""
    given = {name: in_si(value, calibration.parameters[name].unit) for name, value in values.items()}
    keys = {key: value for name, value in given.items() for key in calibration.keys_of(name, scene)}
    return {**calibration.scenes[scene].settings, **keys}


# Positions of parameters between their bounds


def to_unit(parameter: Parameter, value: float) -> float:
    """Position of a value between the bounds of its parameter, 0 to 1."""
    if parameter.scale == "log":
        return log(value / parameter.start) / log(parameter.stop / parameter.start)
    return (value - parameter.start) / (parameter.stop - parameter.start)


def from_unit(parameter: Parameter, share: float) -> float:
    """Value at a position between the bounds of its parameter."""
    if parameter.scale == "log":
        value = parameter.start * (parameter.stop / parameter.start) ** share
    else:
        value = parameter.start + share * (parameter.stop - parameter.start)
    return float(min(max(value, parameter.start), parameter.stop))


def deviation_in_units(parameter: Parameter, value: float, share: float) -> float:
    """Standard deviation of a parameter in its own unit, at a value, from that of its position."""
    if parameter.scale == "log":
        return float(value * log(parameter.stop / parameter.start) * share)
    return (parameter.stop - parameter.start) * share
