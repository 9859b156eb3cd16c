"""Protocols of observers."""

from typing import Any, Protocol, runtime_checkable

from granflow.snapshot import Snapshot

PARTICLES, CONTACTS, WALLS, TOTALS = "particles", "contacts", "walls", "totals"
"""Parts of a snapshot that an observer can request."""


class Observer(Protocol):
    """Receives snapshots of a simulation at its due times.

    `wants`: required parts of the snapshot, out of "particles", "contacts", "walls", "totals".
    """

    wants: frozenset[str]

    def next_time(self) -> float:
        """Return the simulated time of the next snapshot [s]; infinity: only at the end."""

    def observe(self, snapshot: Snapshot) -> None:
        """Process a snapshot. A second snapshot of the same time has no effect.

        Snapshots arrive in order of time. The last one of a run may be earlier than `next_time`.
        """

    def finish(self) -> None:
        """Close files; called once, after the last snapshot."""


@runtime_checkable
class WritesFiles(Protocol):
    """An observer with files that belong to a checkpoint."""

    def sync(self) -> None:
        """Flush the files to the disk. Raises OSError."""


@runtime_checkable
class Checkpointable(Protocol):
    """An observer whose state is part of checkpoints."""

    def state_dict(self) -> dict[str, Any]:
        """Return the state: nested dictionaries of numbers, texts and numpy arrays."""

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`, which may come from another process; files are not modified yet."""

    def truncate(self) -> None:
        """Restore the files to their content at the time of the restored state."""
