"""Writes the table of docs/pages/guides/parallel.md from the newest results of `bench.py --ranks`."""

import json
from pathlib import Path
from typing import Any

from benchmark import page, tables
from benchmark.codes import GRANFLOW, ON_RANKS
from benchmark.machine import ROOT

GUIDE = ROOT / "docs" / "pages" / "guides" / "parallel.md"
BEGIN, END = "<!-- begin: bench.py --ranks -->\n", "<!-- end: bench.py --ranks -->\n"
"""Lines of the guide between which the table is written."""
COLUMNS = (
    "particles",
    "code",
    "M particle-steps/s",
    "messages",
    "waiting",
    "rebuilds/1000 steps",
    "memory [MB]",
)


def write(folder: Path, guide: Path = GUIDE) -> Path | None:
    """Writes the table of the newest results of ranks in a folder to the guide; None if there are no such
    results."""
    found = page.newest(folder, "ranks", "")
    if found is None:
        return None
    before, after = guide.read_text(encoding="utf-8").split(BEGIN)
    after = after.split(END)[1]
    guide.write_text(before + BEGIN + section(json.loads(found.read_text())) + END + after, encoding="utf-8")
    return guide


def section(result: dict[str, Any]) -> str:
    """Machine, commit and table."""
    return (
        f"Medians (smallest to largest) of {rounds_of(result)} rounds in which the codes ran in turn. "
        f"{page.machine_lines(result)}\n\n{tables.markdown(COLUMNS, [*map(row, tables.groups(result))])}\n"
    )


def rounds_of(result: dict[str, Any]) -> int:
    """Number of rounds."""
    return max(point["round"] for point in result["points"])


def row(group: tables.Group) -> list[str]:
    """Row of one code."""
    rates = tables.Spread.of([point["rate"] / 1e6 for point in group.points])
    rebuilds, memory = map(group.spread, ("rebuilds", "memory"))
    on_ranks = group.code == ON_RANKS
    shares = [group.spread(phase) if on_ranks else None for phase in ("exchange", "waiting")]
    return [
        str(group.count),
        f"{GRANFLOW if on_ranks else group.code}, {processes(group.code, group.threads)}",
        rates.text(),
        *(f"{100.0 * share.middle:.1f} %" if share else "" for share in shares),
        f"{rebuilds.middle:.1f}" if rebuilds else "",
        f"{memory.middle / 1e6:.0f}" if memory else "",
    ]


def processes(code: str, number: int) -> str:
    """Number of threads or ranks."""
    kind = "thread" if code in (GRANFLOW, "yade") else "rank"
    return f"{number} {kind}{'s' if number > 1 else ''}"
