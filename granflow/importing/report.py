"""The report of an import: what became of each line of the script.

An `Entry` belongs to one executed command and collects remarks; the worst of them is its kind. The same line
in a loop has several entries, which are printed once if they are equal.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from granflow.importing.language import Command

TRANSLATED = "translated"
APPROXIMATED = "approximated"
NOT_NEEDED = "not needed"
NOT_POSSIBLE = "not possible"
KINDS = (NOT_NEEDED, TRANSLATED, APPROXIMATED, NOT_POSSIBLE)
"""Kinds of remarks, the worst last."""


@dataclass(frozen=True)
class Remark:
    """One thing that became of a command.

    text:     key of the scene (translated), difference and its size (approximated), or reason
    nearest:  the nearest alternative of something that is not possible
    """

    kind: str
    text: str
    nearest: str = ""

    def __str__(self) -> str:
        return f"{self.text}; nearest: {self.nearest}" if self.nearest else self.text


@dataclass
class Entry:
    """What became of one executed command."""

    command: Command
    remarks: list[Remark] = field(default_factory=list)

    def translated(self, *keys: str) -> None:
        """The command became these keys of the scene, such as `walls.floor`."""
        for key in keys:
            self._add(Remark(TRANSLATED, key))

    def approximated(self, difference: str) -> None:
        """The scene differs from the script; `difference` says how and by how much."""
        self._add(Remark(APPROXIMATED, difference))

    def not_needed(self, reason: str) -> None:
        """The command has no counterpart because granflow does without."""
        self._add(Remark(NOT_NEEDED, reason))

    def impossible(self, reason: str, nearest: str = "") -> None:
        """The scene cannot do this; `nearest`: what comes nearest, as an instruction."""
        self._add(Remark(NOT_POSSIBLE, reason, nearest))

    def _add(self, remark: Remark) -> None:
        if remark not in self.remarks:
            self.remarks.append(remark)

    @property
    def kind(self) -> str:
        """The worst kind of the remarks."""
        return max((each.kind for each in self.remarks), key=KINDS.index, default=NOT_NEEDED)

    @property
    def sentence(self) -> str:
        """All remarks in one line."""
        if not self.remarks:
            return "nothing that follows uses it"
        return "; ".join(map(str, self.remarks))


@dataclass
class Report:
    """All entries, in the order of execution."""

    entries: list[Entry] = field(default_factory=list)

    def entry(self, command: Command) -> Entry:
        """A new entry."""
        self.entries.append(Entry(command))
        return self.entries[-1]

    def lines(self) -> Iterator[tuple[str, str, str, str]]:
        """Position, text of the line, kind and sentence; without repetitions of a loop."""
        seen = set()
        for entry in self.entries:
            command = entry.command
            row = (command.where, command.text, entry.kind, entry.sentence)
            if row not in seen:
                seen.add(row)
                yield row

    def count(self, kind: str) -> int:
        """Number of lines of a kind."""
        return sum(1 for row in self.lines() if row[2] == kind)

    @property
    def is_complete(self) -> bool:
        """Whether nothing is impossible."""
        return not self.count(NOT_POSSIBLE)

    def text(self) -> str:
        """The report for a terminal, two rows per line of the script."""
        rows = [f"{where}: {text}\n    {kind}: {sentence}" for where, text, kind, sentence in self.lines()]
        counts = ", ".join(f"{self.count(kind)} {kind}" for kind in KINDS[1:] + KINDS[:1])
        return "\n".join([*rows, f"{len(rows)} lines: {counts}."])

    def to_dict(self) -> dict[str, Any]:
        """The report for --json."""
        names = ("position", "line", "kind", "remark")
        return {
            "lines": [dict(zip(names, row, strict=True)) for row in self.lines()],
            "counts": {kind: self.count(kind) for kind in KINDS},
        }
