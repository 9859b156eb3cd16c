"""How long contacts last, from looks at all contacts in quick succession."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from granflow.snapshot import Snapshot

PARTNERS = 2**32
"""More than there are ids: two of them make one number."""
WALLS_FROM = 2**31


@dataclass
class FollowedContacts:
    """Contacts that began under observation: how long each was seen [s], and whether it was seen to end."""

    observed: list[np.ndarray] = field(default_factory=list)
    has_ended: list[np.ndarray] = field(default_factory=list)

    def add(self, observed: np.ndarray, has_ended: bool) -> None:
        """Take in contacts that all ended, or that were all still there when observation ended."""
        self.observed.append(observed)
        self.has_ended.append(np.full(len(observed), has_ended))

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and whether they ended, of all contacts."""
        if not self.observed:
            return np.empty(0), np.empty(0, dtype=bool)
        return np.concatenate(self.observed), np.concatenate(self.has_ended)


class ContactFollower:
    """Follows contacts with a force through one burst of looks.

    A contact begins and ends half way between the two looks that saw the change. One that was there at the first look
    does not count, one that is there at the last is known to last longer.
    """

    def __init__(self, followed: FollowedContacts) -> None:
        self._followed = followed
        self._keys = np.empty(0, dtype=np.int64)
        self._since = np.empty(0)
        self._time = np.nan

    def update(self, snapshot: Snapshot) -> None:
        """See which contacts are there now; the snapshot must hold contacts."""
        keys = keys_of(snapshot)
        if np.isnan(self._time):
            since = np.full(len(keys), -np.inf)
        else:
            middle = 0.5 * (self._time + snapshot.time)
            self._record(~np.isin(self._keys, keys), middle, has_ended=True)
            since = np.full(len(keys), middle)
            _, old, new = np.intersect1d(self._keys, keys, assume_unique=True, return_indices=True)
            since[new] = self._since[old]
        self._keys, self._since, self._time = keys, since, snapshot.time

    def close(self) -> None:
        """The burst is over."""
        self._record(np.ones(len(self._keys), dtype=bool), self._time, has_ended=False)

    def _record(self, selected: np.ndarray, time: float, has_ended: bool) -> None:
        began = self._since[selected]
        self._followed.add(time - began[np.isfinite(began)], has_ended)


def keys_of(snapshot: Snapshot) -> np.ndarray:
    """One number for every contact with a force above zero, the same as long as the partners are."""
    contacts = snapshot.contacts
    assert contacts is not None
    first, second, wall = (contacts[name].astype(np.int64) for name in ("id_i", "id_j", "wall"))
    other = np.where(wall >= 0, WALLS_FROM + wall, second)
    low, high = np.minimum(first, other), np.maximum(first, other)
    return (low * PARTNERS + high)[contacts["normal_force"] > 0.0]


def survival(observed: np.ndarray, has_ended: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share of contacts that last longer than a time: the times [s] at which some ended, and the share from then on.

    The estimate of Kaplan and Meier (1958): contacts still there when observation ended count as long as they were
    seen and are then left out.
    """
    times = np.unique(observed[has_ended])
    at_risk = len(observed) - np.searchsorted(np.sort(observed), times)
    ended_count = np.array([np.count_nonzero(has_ended & (observed == time)) for time in times])
    return times, np.cumprod(1.0 - ended_count / at_risk) if len(times) else np.empty(0)


def median_of(times: np.ndarray, share: np.ndarray) -> float:
    """Time [s] that half of the contacts outlast; nan where more than half outlast all observation."""
    below = np.flatnonzero(share <= 0.5)
    return float(times[below[0]]) if len(below) else float("nan")


def bursts(end: float, count: int, samples: int, spacing: float) -> Iterable[list[float]]:
    """Times [s] of the looks of each burst, the bursts spread evenly over the run that ends at `end` [s]."""
    for number in range(count):
        start = (number + 0.5) / count * end
        yield [start + update * spacing for update in range(samples)]
