"""Points of a sweep: combinations of the parameter values by grid, Latin hypercube or Saltelli's design."""

import ast
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import product
from math import nan, prod, ulp
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, Tag
from scipy.stats import qmc

from granflow.scene.blocks.scene import Seed
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, missing, whole
from granflow.schema.model import FileName, ListOf, Model, Text, choose_by, choose_by_key, shorthand
from granflow.schema.quantities import GivenQuantity, Number, bound_faults
from granflow.studies.checked_run import si_value
from granflow.studies.yield_locus import YieldLocusEvaluation
from granflow.units import in_si, mixed_units

# Schema of sweep files.

MOST_RUNS = 100_000
"""Largest number of runs of a sweep. Each is checked before the first one begins, which takes some
milliseconds."""
Keys = Annotated[tuple[Text, ...], ListOf(one=True, some="[walls.plug.radius, walls.floor.hole_radius]")]
AnyValues = Annotated[tuple[Any, ...], ListOf(some="[0.1, 0.3, 0.5]")]
SeedCount = Annotated[int, Number(noun="a number of seeds", at_least=1, at_most=1000, whole=True)]


class ValueRange(Model):
    """Values of a parameter between two bounds, evenly spaced or on a logarithmic scale."""

    start: GivenQuantity = Field(alias="from", description="lower bound")
    stop: GivenQuantity = Field(alias="to", description="upper bound")
    count: q.Count | None = Field(None, description="number of values, both bounds included; only in a grid")
    scale: Literal["linear", "log"] = Field("linear", description="spacing of the values: linear or log")
    keys: Keys | None = Field(
        None, description="keys of the scene that get the value; default: the parameter name"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the upper bound is larger, both have one unit, and those of a logarithm are
        positive."""
        yield from bound_faults(self.start, self.stop, self.scale)


class ValueList(Model):
    """Listed values of a parameter, and values of other keys that change with it."""

    values: AnyValues = Field(description="values of the parameter")
    keys: Keys | None = Field(
        None, description="keys of the scene that get the value; default: the parameter name"
    )
    along: dict[Text, AnyValues] = Field(
        {},
        alias="with",
        description="other keys of the scene, each with one value for each value of the parameter",
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for values of different dimensions, and for each list of other values of another
        length."""
        if reason := mixed_units(self.values):
            yield Fault(("values",), reason)
        for key, values in self.along.items():
            if len(values) != len(self.values):
                needed = f"it needs {len(self.values)} values, one for each value of the parameter"
                yield Fault(("with", key), f"this list has {len(values)} values; {needed}")


def _form(value: Any) -> str | None:
    """Tag of the form in which a parameter is given."""
    if isinstance(value, list | tuple):
        return "<list>"
    if isinstance(value, ValueRange | ValueList):
        return "<from>" if isinstance(value, ValueRange) else "<values>"
    if isinstance(value, Mapping):
        return "<values>" if "values" in value else "<from>"
    return None


Variation = Annotated[
    Annotated[AnyValues, Tag("<list>")]
    | Annotated[ValueRange, Tag("<from>")]
    | Annotated[ValueList, Tag("<values>")],
    choose_by(_form, "a list of values or a range is expected, such as {from: 0.1, to: 0.7, count: 7}"),
]


class Grid(Model):
    """All combinations of the values."""

    kind: Literal["grid"] = "grid"


class LatinHypercube(Model):
    """Points of a Latin hypercube: each parameter has one value in each of `count` equal intervals."""

    kind: Literal["latin_hypercube"]
    count: q.Count = Field(description="number of points")
    seed: Seed = Field(1, description="seed of the sampling")


class SobolSampling(Model):
    """Saltelli's design on a Sobol sequence, for sensitivity indices: count (d + 2) points for d
    parameters."""

    kind: Literal["sobol"]
    count: q.Count = Field(description="number of base points, a power of 2")
    seed: Seed = Field(1, description="seed of the scrambling of the sequence")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the number of base points is a power of 2."""
        if self.count & (self.count - 1):
            below = 1 << (self.count.bit_length() - 1)
            yield Fault(
                ("count",),
                f"a Sobol sequence is balanced for powers of 2 only, such as {below} or {2 * below}",
            )


Sampling = Annotated[Grid | LatinHypercube | SobolSampling, choose_by_key("kind"), shorthand("kind")]


class Repeat(Model):
    """Repetition of each point with other random numbers."""

    seeds: SeedCount = Field(
        description="number of runs of each point, with the seed of the scene and those after it"
    )


# Formulas: values of keys that follow from the parameters.

_OPERATORS: Mapping[type[ast.AST], Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS: Mapping[str, Callable[..., float]] = {
    **{name: getattr(math, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "atan")},
    **{each.__name__: each for each in (abs, min, max)},
}
FORMULA_WORDS = "numbers, parameters, pi, + - * / **, parentheses, and " + ", ".join(_FUNCTIONS)


@cache
def _tree(formula: str) -> ast.expr:
    """The parsed formula: a sweep evaluates it at each point. Raises ValueError if it is not a formula."""
    try:
        return ast.parse(formula.strip(), mode="eval").body
    except (SyntaxError, ValueError):
        raise ValueError("is not a formula") from None


@cache
def names_in(formula: str) -> tuple[str, ...]:
    """Names of the parameters in a formula, each once. Raises ValueError if it is not a formula."""
    return tuple(dict.fromkeys(_names(_tree(formula))))


def _names(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.Constant(value=int() | float()):
            return
        case ast.Name(id=name):
            if name != "pi":
                yield name
            return
        case ast.BinOp(op=sign) | ast.UnaryOp(op=sign) if type(sign) in _OPERATORS:
            parts = [child for child in ast.iter_child_nodes(node) if child is not sign]
        case ast.Call(func=ast.Name(id=function), args=[_, *_] as parts, keywords=[]) if (
            function in _FUNCTIONS
        ):
            pass
        case _:
            raise ValueError(f"has {ast.unparse(node)}, but a formula consists of {FORMULA_WORDS}")
    for part in parts:
        yield from _names(part)


def formula_value(formula: str, values: Mapping[str, float]) -> float:
    """Value of a formula, NaN if it has none, such as sqrt(-1); the scene refuses that."""

    def value(node: ast.AST) -> float:
        match node:
            case ast.Constant(value=number):
                return float(number)  # type: ignore[arg-type]
            case ast.Name(id=name):
                return math.pi if name == "pi" else values[name]
            case ast.BinOp(left=left, op=sign, right=right):
                return _OPERATORS[type(sign)](value(left), value(right))
            case ast.UnaryOp(op=sign, operand=operand):
                return _OPERATORS[type(sign)](value(operand))
            case ast.Call(func=ast.Name(id=function), args=arguments):
                return _FUNCTIONS[function](*map(value, arguments))
        raise AssertionError(ast.dump(node))

    try:
        return value(_tree(formula))
    except (ArithmeticError, ValueError, TypeError):
        return nan


class SweepInput(Model):
    """A sweep: a scene, the parameters that vary, and the numbers to read from each run."""

    title: Text | None = Field(None, description="title of the sweep, one line")
    description: Text | None = Field(None, description="description of the sweep and its expected result")
    scene: FileName = Field(description="scene file, relative to the folder of this file")
    settings: dict[Text, Any] = Field(
        {}, alias="set", description="values of other keys of the scene in all runs"
    )
    vary: dict[Text, Variation] = Field(
        {},
        description=(
            "values of each parameter; its name is a key path of the scene; without parameters, repeat gives "
            "the scatter of one scene"
        ),
    )
    derive: dict[Text, Text] = Field(
        {},
        description=(
            "keys of the scene that follow from the parameters: KEY: formula, SI units; a parameter in a "
            "formula sets no key by its name"
        ),
    )
    sampling: Sampling = Field(Grid(), description="grid, latin_hypercube or sobol")
    repeat: Repeat = Field(Repeat(seeds=1), description="repetition of each point with other seeds")
    read: Annotated[tuple[Text, ...], ListOf(one=True, some="[mass_flow.outlet]")] = Field(
        (),
        description="numbers of the result to read, as in the expect block of a scene; evaluate needs none",
        examples=[["mass_flow.outlet"]],
    )
    evaluate: YieldLocusEvaluation | None = Field(
        None, description="evaluation of all runs together: yield loci and flow functions of shear tests"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield faults between the parts: counts that are missing or have no effect, keys given twice."""
        gridded = isinstance(self.sampling, Grid)
        if not self.vary and not (gridded and self.repeat.seeds > 1):
            yield missing(
                ("vary",),
                "at least one parameter, such as pairs.glass-glass.friction: [0.1, 0.3, 0.5], or instead of "
                "it repeat: {seeds: 3}",
            )
        for name, variation in self.vary.items():
            if isinstance(variation, tuple) and (reason := mixed_units(variation)):
                yield Fault(("vary", name), reason)
            if not isinstance(variation, ValueRange):
                continue
            if gridded and variation.count is None:
                yield missing(("vary", name, "count"), "the number of values of this parameter in the grid")
            if not gridded and variation.count is not None:
                yield whole(
                    ("vary", name, "count"),
                    "has no effect: sampling.count is the number of points; remove it",
                )
        yield from self._formula_faults()
        yield from self._repeated_keys()
        if not self.read and self.evaluate is None:
            yield missing(("read",), "numbers of the result to read, such as [mass_flow.outlet]")
        if self.evaluate is not None:
            for fault in self.evaluate.faults_of_parameters(tuple(self.vary)):
                yield replace(fault, path=("evaluate", *fault.path))
        if self.run_count > MOST_RUNS:
            path = ("vary",) if gridded else ("sampling", "count")
            yield whole(
                path, f"gives {self.run_count} runs, but a sweep has at most {MOST_RUNS}; give fewer values"
            )

    @property
    def run_count(self) -> int:
        """Number of points times seeds."""
        if isinstance(self.sampling, Grid):
            return prod(map(_value_count, self.vary.values())) * self.repeat.seeds
        designs = len(self.vary) + 2 if isinstance(self.sampling, SobolSampling) else 1
        return self.sampling.count * designs * self.repeat.seeds

    def _formula_faults(self) -> Iterator[Fault]:
        """Faults of formulas: other words, names that are no parameters, parameters without numbers."""
        for key, formula in self.derive.items():
            path = ("derive", key)
            try:
                names = names_in(formula)
            except ValueError as error:
                yield Fault(path, f"{formula!r} {error}; a formula is 2 * pi * x, for example")
                continue
            for name in names:
                if name not in self.vary:
                    yield Fault(path, f"{name} is not a parameter of vary; these are {', '.join(self.vary)}")
                elif not _has_numbers(self.vary[name]):
                    yield Fault(path, f"a formula needs numbers, and vary.{name} has other values")

    def keys_of(self, name: str) -> tuple[str, ...]:
        """Keys of the scene that a parameter sets, those in `with` last.

        By its name it sets that key, unless it has `keys`, or is part of a formula.
        """
        variation = self.vary[name]
        along = tuple(variation.along) if isinstance(variation, ValueList) else ()
        if not isinstance(variation, tuple) and variation.keys:
            return (*variation.keys, *along)
        return along if name in self._names_in_formulas() else (name, *along)

    def _names_in_formulas(self) -> set[str]:
        """Names of the parameters that a formula contains."""
        found: set[str] = set()
        for formula in self.derive.values():
            with suppress(ValueError):  # reported by `faults`
                found.update(names_in(formula))
        return found

    def _repeated_keys(self) -> Iterator[Fault]:
        """Faults of keys of the scene that several entries set."""
        seen: dict[str, str] = dict.fromkeys(self.settings, "set")
        for key in self.derive:
            if key in seen:
                yield whole(("derive", key), f"sets {key}, which {seen[key]} sets too; keep one of them")
            seen[key] = f"derive.{key}"
        for name in self.vary:
            for key in self.keys_of(name):
                if key in seen:
                    yield whole(("vary", name), f"sets {key}, which {seen[key]} sets too; keep one of them")
                seen[key] = f"vary.{name}"
        if self.repeat.seeds > 1 and "seed" in seen:
            yield whole(("repeat",), f"changes the seed, which {seen['seed']} sets too; keep one of them")


def _value_count(variation: Any) -> int:
    """Number of values of a parameter in a grid."""
    if isinstance(variation, ValueRange):
        return variation.count or 1
    return len(variation.values if isinstance(variation, ValueList) else variation)


def _has_numbers(variation: Any) -> bool:
    """Whether all values of a parameter are numbers, in SI or with a unit."""
    if isinstance(variation, ValueRange):
        return True
    values = variation.values if isinstance(variation, ValueList) else variation
    return all(isinstance(si_value(each), int | float) for each in values)


@dataclass(frozen=True)
class DesignPoint:
    """One point: value of each parameter by its name, SI, and value of each key of the scene, which may have
    a unit."""

    values: Mapping[str, Any]
    settings: Mapping[str, Any]


class _Level(NamedTuple):
    """One value of a parameter, and the values of the keys of the scene that it sets."""

    value: Any
    settings: Mapping[str, Any]


def design_points(sweep: SweepInput) -> list[DesignPoint]:
    """All points in a fixed order; of a grid, the last parameter varies fastest.

    Values of parameters are SI numbers where the text is a number with a unit; the scene gets values with
    units, so that it refuses those of another dimension. The points of a Sobol sampling are in the order of
    SALib without second-order indices: for each base point A, each A with one value of B, and B.
    """
    if isinstance(sweep.sampling, Grid):
        levels = [list(_grid_levels(sweep, name)) for name in sweep.vary]
        return [_point(sweep, combination) for combination in product(*levels)]
    return [
        _point(sweep, [_level_at(sweep, name, share) for name, share in zip(sweep.vary, row, strict=True)])
        for row in unit_samples(sweep.sampling, len(sweep.vary)).tolist()
    ]


def _point(sweep: SweepInput, levels: Any) -> DesignPoint:
    """The point with one level of each parameter."""
    settings = dict(sweep.settings)
    for level in levels:
        settings.update(level.settings)
    values = {name: level.value for name, level in zip(sweep.vary, levels, strict=True)}
    settings.update({key: formula_value(formula, values) for key, formula in sweep.derive.items()})
    return DesignPoint(values, settings)


def unit_samples(sampling: LatinHypercube | SobolSampling, parameters: int) -> np.ndarray:
    """Samples (points, parameters) in [0, 1).

    Saltelli's design (Saltelli et al., Comput. Phys. Commun. 181 (2010) 259): rows A_i, AB_i1, ..., AB_id,
    B_i for each base point i, where AB_ij is A_i with component j of B_i; A and B are the halves of a Sobol
    sequence.
    """
    if isinstance(sampling, LatinHypercube):
        return np.asarray(qmc.LatinHypercube(parameters, seed=sampling.seed).random(sampling.count))
    both = qmc.Sobol(2 * parameters, scramble=True, seed=sampling.seed).random(sampling.count)
    first = both[:, :parameters]
    second = both[:, parameters:]
    mixed = np.repeat(first[:, None, :], parameters + 2, axis=1)
    for j in range(parameters):
        mixed[:, 1 + j, j] = second[:, j]
    mixed[:, -1] = second
    return np.asarray(mixed.reshape(-1, parameters))


def _grid_levels(sweep: SweepInput, name: str) -> Iterator[_Level]:
    """All values of a parameter in a grid."""
    variation = sweep.vary[name]
    if isinstance(variation, ValueRange):
        count = variation.count or 1
        yield from (_level_at(sweep, name, Fraction(k, max(count - 1, 1))) for k in range(count))
    else:
        values = variation.values if isinstance(variation, ValueList) else variation
        yield from (_listed(sweep, name, k) for k in range(len(values)))


def _level_at(sweep: SweepInput, name: str, share: float | Fraction) -> _Level:
    """The value at a fraction `share` of the range, or of the list, in which all values are equally
    probable."""
    variation = sweep.vary[name]
    if isinstance(variation, ValueRange):
        value = value_at(variation, share)
        given = in_si(value, variation.start.unit or variation.stop.unit)
        return _Level(value, dict.fromkeys(sweep.keys_of(name), given))
    values = variation.values if isinstance(variation, ValueList) else variation
    return _listed(sweep, name, int(share * len(values)))


SHORT = 9
"""Significant digits of a value that a person would type."""


def value_at(bounds: ValueRange, share: float | Fraction) -> float:
    """The value at a fraction of a range; fractions 0 and 1 give the bounds exactly.

    Linear values are those of exact arithmetic with the decimals of the bounds: 0.3, not 0.30000000000000004,
    and between 10 deg and 30 deg the same number as for 20 deg.
    Logarithmic values that differ from a decimal of SHORT digits by rounding only are that decimal.
    """
    if share in (0.0, 1.0):
        return float(bounds.stop if share else bounds.start)
    if bounds.scale == "log":
        value = float(bounds.start * (bounds.stop / bounds.start) ** float(share))
        short = float(f"{value:.{SHORT}g}")
        return short if abs(short - value) <= 4.0 * ulp(value) else value
    start, stop = bounds.start.exact, bounds.stop.exact
    return float(start + Fraction(share) * (stop - start))


def _listed(sweep: SweepInput, name: str, index: int) -> _Level:
    """The value of a list at an index, and the values that change with it."""
    variation = sweep.vary[name]
    assert not isinstance(variation, ValueRange)
    along = {}
    if isinstance(variation, ValueList):
        along = {key: values[index] for key, values in variation.along.items()}
    value = (variation.values if isinstance(variation, ValueList) else variation)[index]
    return _Level(si_value(value), dict.fromkeys(sweep.keys_of(name), value) | along)
