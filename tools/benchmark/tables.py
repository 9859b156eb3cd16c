"""Medians, spreads and ratios of measured points."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import median
from typing import Any

COLUMNS = (
    "case", "threads", "code", "M particle-steps/s", "granflow / code", "C++ loops / step", "memory [MB]",
    "bytes/particle", "start [s]", "contacts/particle", "rebuilds/1000 steps", "skin [mm]", "mass flow [kg/s]",
)  # fmt: skip


@dataclass(frozen=True)
class Spread:
    """Median, minimum and maximum of a few values."""

    middle: float
    low: float
    high: float

    @classmethod
    def of(cls, values: list[float]) -> "Spread":
        """Spread of at least one value."""
        return cls(median(values), min(values), max(values))

    def text(self, digits: int = 2) -> str:
        """`middle (low-high)`."""
        return f"{self.middle:.{digits}f} ({self.low:.{digits}f}-{self.high:.{digits}f})"


@dataclass(frozen=True)
class Group:
    """Measurements of one code and contact model in one case with one number of threads, for all rounds."""

    case: str
    count: int
    threads: int
    code: str
    law: str
    points: list[dict[str, Any]]

    @property
    def label(self) -> str:
        """Code; for granflow with the contact model."""
        return f"{self.code} {self.law}" if self.code == "granflow" else self.code

    def spread(self, key: str) -> Spread | None:
        """Spread of one quantity over the rounds, or None if the code does not report it."""
        values = [point[key] for point in self.points if point.get(key) is not None]
        return Spread.of(values) if values else None


def groups(result: dict[str, Any]) -> list[Group]:
    """All groups in the order of their first point, cases by size."""
    found: dict[tuple[str, int, int, str, str], list[dict[str, Any]]] = {}
    for point in result["points"]:
        key = (point["case"], point["count"], point["threads"], point["code"], point["law"])
        found.setdefault(key, []).append(point)
    listed = [Group(*key, points) for key, points in found.items()]
    order = {"granflow": 0}
    return sorted(listed, key=lambda g: (g.case == "hopper", g.count, g.threads, order.get(g.code, 1)))


def ratio(result: dict[str, Any], other: Group) -> Spread | None:
    """Rate of granflow with `hertz` over that of another group, computed within each round."""
    granflow_rates = {
        point["round"]: point["rate"]
        for point in result["points"]
        if (point["code"], point["law"]) == ("granflow", "hertz")
        and (point["case"], point["threads"]) == (other.case, other.threads)
    }
    pairs = [
        granflow_rates[point["round"]] / point["rate"]
        for point in other.points
        if point["round"] in granflow_rates
    ]
    return Spread.of(pairs) if pairs else None


def rows(result: dict[str, Any]) -> Iterator[list[str]]:
    """Rows of the table as text."""
    for group in groups(result):
        reference = (group.code, group.law) == ("granflow", "hertz")
        rate_ratio = None if reference else ratio(result, group)
        rates = Spread.of([point["rate"] / 1e6 for point in group.points])
        fields = _number(group, "field_bytes", "{:.0f}".format)
        yield [
            group.case, str(group.threads), group.label, rates.text(), rate_ratio.text() if rate_ratio else "",
            _number(group, "share_of_loops", "{:.0%}".format),
            _number(group, "memory", lambda value: f"{value / 1e6:.0f}"), fields,
            _number(group, "start", "{:.1f}".format), _number(group, "contacts", "{:.2f}".format),
            _number(group, "rebuilds", "{:.1f}".format),
            _number(group, "skin", lambda value: f"{1e3 * value:g}"), _number(group, "mass_flow", "{:.3f}".format),
        ]  # fmt: skip


def _number(group: Group, key: str, show: Callable[[float], str]) -> str:
    found = group.spread(key)
    return show(found.middle) if found else ""


def text(result: dict[str, Any]) -> str:
    """Table and notes as text."""
    table = [list(COLUMNS), *rows(result)]
    widths = [max(len(row[k]) for row in table) for k in range(len(COLUMNS))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    ]
    return "\n".join(["", *lines, *result["notes"]])


def markdown(head: tuple[str, ...], body: list[list[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in body])
