"""The numbers of a completed run: `result.json`, and the table printed at the end."""

import json
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from granflow.errors import GranflowError
from granflow.fields import ENERGY_BUDGET_QUANTITIES
from granflow.io.files import read_text, write_text
from granflow.scene.blocks.output import unit_of
from granflow.visible_text import html_table, in_degrees, readable

if TYPE_CHECKING:
    from rich.table import Table


class Expectation(Protocol):
    """One entry of the `expect:` block of a scene; exactly one of the four bounds is not None.

    `tolerance`: relative, for `equals`; None requires equality.
    """

    @property
    def quantity(self) -> str:
        """Name of the quantity, as in `Result.numbers`."""

    @property
    def between(self) -> tuple[float, float] | None:
        """Smallest and largest permitted value."""

    @property
    def below(self) -> float | None:
        """Strict upper bound."""

    @property
    def above(self) -> float | None:
        """Strict lower bound."""

    @property
    def equals(self) -> float | None:
        """Target value, within the tolerance."""

    @property
    def tolerance(self) -> float | None:
        """Largest relative difference for `equals`."""


class ExpectationResult(NamedTuple):
    """Result of one expectation: a sentence with the value and its unit, and whether it is satisfied."""

    sentence: str
    met: bool


@dataclass(frozen=True, repr=False)
class Result:
    """Numbers of a completed run, in SI units.

    `run`: simulated_time, step_count, time_step, steps_per_second, particle_steps_per_second, ...
    `timings`: wall clock by phase [s], in display order: neighbor_list, forces, integration, exchange (only
    on MPI ranks), output, compile.
    `totals`: those of the last snapshot. `flow_meters`: flow_mass, flow_count, mass_flow, mass_flow_error by
    name of the meter. `wall_forces`: wall_force_x, ... by name of the wall. `metrics`: by name of the metric.
    `stages`: kinetic_energy_mean, kinetic_energy_largest, ... of the rows of a stage, by its name.
    `residence_time`: residence_mean, tanks_in_series, ... by name of the flow meter at the end.
    `insertion`: inserted_count, inserted_mass and not_inserted_count by name of the inserted group.

    >>> result = gf.read_run("out/two").result
    >>> result.totals["particle_count"], result.numbers["simulated_time"] == result.run["simulated_time"]
    (2, True)
    """

    run: Mapping[str, float]
    timings: Mapping[str, float]
    totals: Mapping[str, float]
    stages: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    flow_meters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    wall_forces: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    residence_time: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    metrics: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    insertion: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    expectations: tuple[ExpectationResult, ...] = ()
    warnings: tuple[str, ...] = ()
    """All warnings of the run, each once."""
    is_complete: bool = True
    """Whether the last stage has ended."""

    def with_expectations(self, expectations: Iterable[Expectation]) -> "Result":
        """Return this result with the evaluated expectations of the scene; the other fields are the same."""
        return replace(self, expectations=tuple(evaluate(expectations, self.numbers)))

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only mappings cannot be pickled.
        return Result, tuple(_plain(getattr(self, each.name)) for each in fields(self))

    def __repr__(self) -> str:
        """One line: simulated time [s], steps, particles, expectations."""
        return f"<Result: {', '.join(f'{label} {text}' for label, text in self._summary())}>"

    def _repr_html_(self) -> str:
        """Table of all numbers with units for notebooks."""
        rows = [
            (name, f"{readable(number)} {_unit_text(name, number)}") for name, number in self.numbers.items()
        ]
        expectations = [(each.sentence, "met" if each.met else "missed") for each in self.expectations]
        return html_table("Result", [*rows, *expectations])

    def _summary(self) -> list[tuple[str, str]]:
        """Labels and texts of the numbers that `repr` shows, if the result has them."""
        named = {"simulated_time": ("simulated time", " s"), "step_count": ("steps", "")}
        named["particle_count"] = ("particles", "")
        numbers = self.numbers
        rows = [
            (label, readable(numbers[name]) + unit)
            for name, (label, unit) in named.items()
            if name in numbers
        ]
        met = sum(each.met for each in self.expectations)
        return (
            [*rows, ("expectations", f"{met} of {len(self.expectations)} met")] if self.expectations else rows
        )

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers by their names in the `expect:` block of a scene.

        Totals and `run` without prefix (`kinetic_energy`, `simulated_time`), wall clock as
        `timings.neighbor_list`; means and largest values of totals over a stage as
        `kinetic_energy_mean.shake`, of
        the last stage as `kinetic_energy_mean`; flow meters, walls and inserted groups as `mass_flow.outlet`,
        `wall_force.floor`, `inserted_mass.beads`.
        """
        named = {**self.run, **self.totals}
        named.update({f"timings.{part}": seconds for part, seconds in self.timings.items()})
        for stage_numbers in list(self.stages.values())[-1:]:
            named.update(stage_numbers)
        parts = (
            self.stages,
            self.flow_meters,
            self.residence_time,
            self.wall_forces,
            self.metrics,
            self.insertion,
        )
        for part, readings in (reading for each in parts for reading in each.items()):
            named.update({f"{quantity}.{part}": number for quantity, number in readings.items()})
        return named


# Written to and read from result.json.


def write_result(directory: Path, result: Result) -> Path:
    """Write `result.json` atomically; a number that is not finite becomes null. Return its path.

    Sections: complete (whether the last stage has ended), run, timings [s], totals, stages, flow_meters,
    residence_time, wall_forces, metrics, insertion, expect and warnings, both lists of sentences.
    All numbers are in SI units; whole numbers are written without decimals.
    """
    sections = {
        "complete": result.is_complete,
        "run": _finite(result.run),
        "timings": _finite(result.timings),
        "totals": _finite(result.totals),
        "stages": {name: _finite(readings) for name, readings in result.stages.items()},
        "flow_meters": {name: _finite(readings) for name, readings in result.flow_meters.items()},
        "residence_time": {name: _finite(readings) for name, readings in result.residence_time.items()},
        "wall_forces": {name: _finite(readings) for name, readings in result.wall_forces.items()},
        "metrics": {name: _finite(readings) for name, readings in result.metrics.items()},
        "insertion": {name: _finite(readings) for name, readings in result.insertion.items()},
        "expect": [{"sentence": sentence, "met": met} for sentence, met in result.expectations],
        "warnings": list(result.warnings),
    }
    path = Path(directory) / "result.json"
    write_text(path, json.dumps(sections, indent=2) + "\n")
    return path


STAGE_ENDS = "stages.csv"
"""Name of the file with the last row of each stage."""


def write_stage_ends(directory: Path) -> None:
    """Write `stages.csv` atomically: the rows of `timeseries.csv` at the ends of the stages.

    A run with a single stage has no such file.
    """
    series = directory / "timeseries.csv"
    if not series.is_file():
        return
    rows: dict[str, str] = {}
    with series.open(encoding="utf-8") as file:
        heading = file.readline()
        for line in file:
            rows[line.split(",", 2)[1]] = line
    if len(rows) > 1:
        write_text(directory / STAGE_ENDS, heading + "".join(rows.values()))


def read_sections(path: Path) -> dict[str, Any]:
    """The sections of `result.json`; empty if it does not exist.

    Raises GranflowError if it cannot be read.
    """
    if not path.exists():
        return {}
    try:
        found = json.loads(read_text(path))
    except (ValueError, RecursionError, OSError) as error:
        raise GranflowError(f"{path} cannot be read ({error}); remove it, or run again.") from None
    return found if isinstance(found, dict) else {}


def result_of(sections: Mapping[str, Any]) -> Result:
    """The result in the sections of `result.json`; null becomes nan, missing sections are empty."""

    def parts(name: str) -> dict[str, dict[str, float]]:
        return {part: _numbers(readings) for part, readings in sections.get(name, {}).items()}

    return Result(
        run=_numbers(sections.get("run", {})),
        timings=_numbers(sections.get("timings", {})),
        totals=_numbers(sections.get("totals", {})),
        stages=parts("stages"),
        flow_meters=parts("flow_meters"),
        residence_time=parts("residence_time"),
        wall_forces=parts("wall_forces"),
        metrics=parts("metrics"),
        insertion=parts("insertion"),
        expectations=tuple(
            ExpectationResult(each["sentence"], each["met"]) for each in sections.get("expect", ())
        ),
        warnings=tuple(sections.get("warnings", ())),
        is_complete=bool(sections.get("complete", True)),
    )


def _numbers(readings: Mapping[str, float | None]) -> dict[str, float]:
    """The numbers of a section. Raises AttributeError or TypeError for a section that is none."""
    if not all(number is None or isinstance(number, int | float) for number in readings.values()):
        raise TypeError("a reading is not a number")
    return {name: math.nan if number is None else number for name, number in readings.items()}


def _plain(value: Any) -> Any:
    """A value with mappings as dictionaries."""
    return {key: _plain(each) for key, each in value.items()} if isinstance(value, Mapping) else value


def _finite(numbers: Mapping[str, float]) -> dict[str, float | None]:
    # The module json writes NaN as invalid JSON and does not accept numpy numbers.
    return {name: _json_number(number) for name, number in numbers.items()}


def _json_number(number: float) -> float | None:
    """Return a Python number for JSON: an int if it is whole and below 2^53, None if it is not finite."""
    if not math.isfinite(number):
        return None
    return int(number) if float(number).is_integer() and abs(number) < 2**53 else float(number)


# The table at the end of a run.

_RUN = ("simulated_time", "step_count", "time_step", "particle_steps_per_second", "warning_count")
_ALWAYS = ("particle_count", "contact_count")
_FLOWS = ("inserted_count", "queued_count", "deleted_count")
"""Counts that are shown if particles have been inserted during the run, are queued, or have been deleted."""
_STATE = ("kinetic_energy", "overlap_largest", "coordination_number")
_LAST = ("wall_work", "energy_error")
"""Totals after those of the features of the scene, which are all that are not in the other tuples here."""
_HIDDEN = {
    *("rotational_energy", "overlap_mean", "wall_contact_count", "deleted_mass"),
    *(f"{name}_{axis}" for name in ("box_width", "box_strain", "box_pressure", "gravity") for axis in "xyz"),
    *ENERGY_BUDGET_QUANTITIES,
}
_WORK = ("wear_normal_work", "wear_tangential_work")
_AXES = "xyz"
_AT_REST = {"wall force (x, y, z)": tuple(f"wall_force_{axis}" for axis in _AXES)}
"""Rows of the closing table for each measured wall, and the numbers in each."""
_MOVING = _AT_REST | {
    "wall torque (x, y, z)": tuple(f"wall_torque_{axis}" for axis in _AXES),
    "wall pressure": ("wall_pressure",),
}
"""The same for walls that move; `result.json` contains all numbers of all measured walls."""
_DRIVING = {"wall power": ("wall_power",)}
"""Row of a wall with a power, such as a belt, which does not move."""


def closing_table(result: Result, title: str = "Result", moving: Collection[str] = ()) -> "Table":
    """Return the table at the end of a run: speed, counts, state, meters, wall forces, metrics, insertion.

    `moving`: names of the walls that move, which have rows of torque and pressure too. Numbers of walls are
    means over the last stage.
    """
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), show_header=False, title_justify="left")
    table.add_column(justify="left")
    table.add_column(justify="right", no_wrap=True)
    table.add_column(justify="left")
    for section in (
        _run_rows(result),
        _total_rows(result),
        _part_rows(result.flow_meters),
        _part_rows(result.residence_time),
        _wall_force_rows(result, moving),
        _part_rows(result.metrics),
        _insertion_rows(result),
    ):
        for row in section:
            table.add_row(*row)
        table.add_section()
    return table


def _run_rows(result: Result) -> list[tuple[str, str, str]]:
    """Return the rows of steps and speed, and of the wall clock [s] with the phase that takes most of it."""
    rows = [(_label(name), readable(result.run[name]), unit_of(name)) for name in _RUN if name in result.run]
    named = sum(result.timings.values())
    total = max(result.run.get("wall_clock", named), named)
    unit = "s"
    if result.timings and total > 0.0:
        part, seconds = max(result.timings.items(), key=lambda each: each[1])
        unit = f"s ({seconds / total:.0%} of it {_label(part)})"
    return [*rows, ("wall clock", f"{total:.2f}", unit)]


def _total_rows(result: Result) -> list[tuple[str, str, str]]:
    """Return the rows of counts, state numbers, and totals of single outlets and walls, with their units."""
    totals = result.totals
    counts = [name for name in _FLOWS if totals.get(name)]
    if totals.get("inserted_count") == totals.get("particle_count") and "inserted_count" in counts:
        counts.remove("inserted_count")
    single = [name for name in totals if "." not in name]
    others = [name for name in single if name not in {*_ALWAYS, *_FLOWS, *_STATE, *_LAST, *_HIDDEN}]
    names = [
        *(name for name in _ALWAYS if name in totals),
        *counts,
        *(name for name in _STATE if name in totals),
        *(name for name in others if totals[name] != 0.0),
        *(name for name in _LAST if name in totals and totals[name] != 0.0),
        *(name for name in totals if "." in name and not name.startswith((*_WORK, "inserted_count."))),
    ]
    return [(_label(name).replace(".", ", "), *_value_and_unit(name, totals[name])) for name in names]


def _part_rows(parts: Mapping[str, Mapping[str, float]]) -> list[tuple[str, str, str]]:
    """Return the rows of meters, metrics or walls by name."""
    return [
        (f"{_label(quantity)}, {part}", *_value_and_unit(f"{quantity}.{part}", number))
        for part, readings in parts.items()
        for quantity, number in readings.items()
    ]


def _insertion_rows(result: Result) -> list[tuple[str, str, str]]:
    """Return the rows of inserted groups, without those that are 0, and without the count of a single group,
    which the totals have."""
    known = {"inserted_count"} if len(result.insertion) == 1 else set()
    return _part_rows(
        {
            group: {name: number for name, number in readings.items() if number and name not in known}
            for group, readings in result.insertion.items()
        }
    )


def _value_and_unit(name: str, number: float) -> tuple[str, str]:
    """Texts of a number and its unit; a dash for a quantity without a value."""
    return ("-", "") if math.isnan(number) else (readable(number), _unit_text(name, number))


def _wall_force_rows(result: Result, moving: Collection[str]) -> list[tuple[str, str, str]]:
    """Return the rows of forces, torques and pressures, with the stage of their means at their units."""
    stages = list(result.stages)
    over = f"mean of {stages[-1]}" if len(stages) > 1 else "mean of the run"
    return [
        (
            f"{words}, {wall}",
            ", ".join(readable(readings[name]) for name in names),
            f"{unit_of(f'{names[0]}.{wall}')}, {over}",
        )
        for wall, readings in result.wall_forces.items()
        for words, names in _rows_of_wall(readings, wall in moving).items()
        if readings.keys() >= set(names)
    ]


def _rows_of_wall(readings: Mapping[str, float], is_moving: bool) -> dict[str, tuple[str, ...]]:
    """Words and numbers of the rows of a measured wall."""
    rows = _MOVING if is_moving else _AT_REST
    return rows | _DRIVING if readings.get("wall_power") else rows


def _unit_text(name: str, number: float) -> str:
    """Return the unit of a number, followed by the number in degrees if it is an angle."""
    return unit_of(name) + in_degrees(number, unit_of(name))


_WORDS = {
    "mass_flow_error": "mass flow, standard error",
    "mass_flow_mean": "mass flow, mean of the last stage",
    "mass_flow_error_mean": "mass flow, standard error of this mean",
    "residence_time_mean": "residence time in the last stage, by number",
    "residence_time": "residence time, mean by number",
    "residence_time_deviation": "residence time, deviation by number",
    "residence_mean": "residence time, mean by mass",
    "residing_mass": "hold-up",
    "residing_mass_mean": "hold-up, mean of the last stage",
    "residing_count_mean": "residing count, mean of the last stage",
    "residence_deviation": "residence time, deviation by mass",
    "residence_stage_mean": "residence time in the last stage, by mass",
}
"""Words for numbers whose names do not tell how they differ."""


def _label(name: str) -> str:
    return _WORDS.get(name, name.replace("_", " "))


# Evaluates the `expect:` block of a scene with the numbers of the completed run.


def evaluate(expectations: Iterable[Expectation], numbers: Mapping[str, float]) -> list[ExpectationResult]:
    """Evaluate all expectations with the numbers of the completed run (`Result.numbers`), in the same order.

    An expectation on NaN, or on a quantity that the run lacks, is not satisfied. The check of a scene refuses
    such quantities, but for those of a program. Raises ValueError for an expectation without any bound.
    """
    return [_evaluate_one(expectation, numbers) for expectation in expectations]


def _evaluate_one(expectation: Expectation, numbers: Mapping[str, float]) -> ExpectationResult:
    """Evaluate one expectation; numbers in the sentence have six digits."""
    name = expectation.quantity
    if name not in numbers:
        return ExpectationResult(f"{name} is not a number of this run; result.json has all of them.", False)
    number = numbers[name]
    unit = f" {unit_of(name)}".rstrip()
    met, requirement = _compare(expectation, number, unit)
    relation = "as expected" if met else "but should be"
    degrees = in_degrees(number, unit.strip())
    return ExpectationResult(f"{name} is {number:.6g}{unit}{degrees}, {relation} {requirement}.", met)


def _compare(expectation: Expectation, number: float, unit: str) -> tuple[bool, str]:
    """Return whether the number satisfies the bound of the expectation, and the text of the bound.

    `unit`: empty, or a space and the unit. `between` includes both ends, `below` and `above` exclude the
    bound.
    """
    if expectation.between is not None:
        low, high = expectation.between
        return low <= number <= high, f"between {low:g} and {high:g}{unit}"
    if expectation.below is not None:
        return number < expectation.below, f"below {expectation.below:g}{unit}"
    if expectation.above is not None:
        return number > expectation.above, f"above {expectation.above:g}{unit}"
    if expectation.equals is None:
        raise ValueError(f"The expectation on {expectation.quantity} has no bound.")
    return _compare_equal(number, expectation.equals, expectation.tolerance or 0.0, unit)


def _compare_equal(number: float, target: float, tolerance: float, unit: str) -> tuple[bool, str]:
    """Return whether |number - target| <= tolerance |target|, and the text of the requirement."""
    within = f" within {100.0 * tolerance:g} %" if tolerance else ""
    return abs(number - target) <= tolerance * abs(target), f"equal to {target:.10g}{unit}{within}"
