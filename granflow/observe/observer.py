"""What everything that watches a simulation has in common."""

from typing import Protocol

from granflow.snapshot import Snapshot

PARTICLES, CONTACTS, WALLS, TOTALS = "particles", "contacts", "walls", "totals"


class Observer(Protocol):
    """Says when it is due and what it wants, and does something with the snapshot it is shown.

    `wants`: those of "particles", "contacts", "walls", "totals" that must be in the snapshot.
    """

    wants: frozenset[str]

    def next_time(self) -> float:
        """Simulated time [s] at which it next wants a snapshot; infinity: only at the end."""

    def observe(self, snapshot: Snapshot) -> None:
        """Take in one snapshot. The same moment shown twice counts once."""

    def finish(self) -> None:
        """Close what is open; called once, after the last snapshot."""
