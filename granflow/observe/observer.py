"""What everything that watches a simulation has in common."""

from typing import Any, Protocol, runtime_checkable

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


@runtime_checkable
class Checkpointable(Protocol):
    """An observer whose state goes into checkpoints, so that a run can go on where it was."""

    def state_dict(self) -> dict[str, Any]:
        """What it must know to go on: numbers, texts, numpy arrays, and dictionaries of them."""

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Go on from what was kept; files are not touched yet."""

    def truncate(self) -> None:
        """Bring its files back to what they held when that was kept."""
