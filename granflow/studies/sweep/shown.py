"""Parameters and quantities of a sweep as its page shows them: in the unit of the sweep file, and angles in degrees."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from granflow.fields import unit_of
from granflow.scene.schema.given_numbers import common_unit, in_unit
from granflow.studies.report.plots import escaped
from granflow.studies.sweep.axes import level_text, short_names
from granflow.studies.sweep.schema import SweepInput, ValueList, ValueRange
from granflow.studies.sweep.table import PointRow, SweepTable


@dataclass(frozen=True)
class ShownTable:
    """A sweep whose numbers are in the units of the page.

    `units`: unit in which the sweep file gives the values of each parameter; empty: SI. `logarithmic`: parameters with
    `scale: log`. `in_plots`: names and values are escaped, because plotly reads markup; tables of a page are not.
    """

    table: SweepTable
    units: Mapping[str, str]
    logarithmic: frozenset[str]
    in_plots: bool = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.table.parameters

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities."""
        return self.table.quantities

    @property
    def rows(self) -> tuple[PointRow, ...]:
        """The points, with SI numbers."""
        return self.table.rows

    def value(self, row: PointRow, parameter: str) -> Any:
        """The value of a parameter; text unchanged."""
        found = row.point.values[parameter]
        return in_unit(found, self.units[parameter]) if isinstance(found, float) else self._text(found)

    def _text(self, value: Any) -> Any:
        """A text as the page shows it; other values unchanged."""
        return escaped(value) if self.in_plots and isinstance(value, str) else value

    def mean(self, row: PointRow, quantity: str) -> float:
        """Mean of a quantity over the seeds."""
        return _in_unit(row.mean(quantity), quantity)

    def standard_error(self, row: PointRow, quantity: str) -> float:
        """Standard error of the mean of a quantity."""
        return _in_unit(row.standard_error(quantity), quantity)

    def short_name(self, parameter: str) -> str:
        """The last keys of the path of a parameter."""
        return str(self._text(short_names(self.parameters)[parameter]))

    def parameter_label(self, parameter: str) -> str:
        """Short name of a parameter with its unit, for an axis."""
        return _with_unit(self.short_name(parameter), str(self._text(self.units[parameter])))

    def label(self, quantity: str) -> str:
        """Name of a quantity with its unit."""
        return _with_unit(quantity, _unit(quantity))


def shown(sweep: SweepInput, table: SweepTable) -> ShownTable:
    """The table of a sweep in the units of the page."""
    units = {name: _given_unit(variation) for name, variation in sweep.vary.items()}
    ranges = {name: each for name, each in sweep.vary.items() if isinstance(each, ValueRange)}
    return ShownTable(table, units, frozenset(name for name, each in ranges.items() if each.scale == "log"))


def run_texts(table: ShownTable) -> dict[str, str]:
    """Parameter values and name of each run, and its seed if there are several, by its directory."""
    found = {}
    for row in table.rows:
        values = {table.parameter_label(name): level_text(table.value(row, name), 4) for name in table.parameters}
        for run in (each.run for each in row.runs if each.run is not None):
            own = values | ({"seed": str(run.seed)} if table.table.seed_count > 1 else {})
            text = ", ".join(f"{name} = {value}" for name, value in own.items())
            found[run.request.directory] = f"{text} ({run.directory.name})"
    return found


def _given_unit(variation: Any) -> str:
    """The unit of the values of a parameter in the sweep file, if it is the same for all."""
    if isinstance(variation, ValueRange):
        return common_unit((variation.start, variation.stop))
    return common_unit(variation.values if isinstance(variation, ValueList) else variation)


def _unit(quantity: str) -> str:
    """Unit of a quantity on the page: deg for angles, otherwise SI."""
    unit = unit_of(quantity)
    return "deg" if unit == "rad" else unit


def _in_unit(value: float, quantity: str) -> float:
    """An SI number in the unit of the page."""
    return in_unit(value, "deg") if unit_of(quantity) == "rad" else value


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
