"""Contact durations from samples of all contacts in short intervals."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from granflow import Snapshot

KEY_BASE = 2**32
"""Exceeds every id, so that two ids combine into one integer key."""
FIRST_WALL_KEY = 2**31
"""Key of the first wall, above all ids."""


@dataclass
class FollowedContacts:
    """Contacts that began during a burst: observed duration of each, and whether its end was observed.

    `observed`: arrays of durations [s]; `has_ended`: bool arrays of the same lengths.
    """

    observed: list[np.ndarray] = field(default_factory=list)
    has_ended: list[np.ndarray] = field(default_factory=list)

    def add(self, observed: np.ndarray, has_ended: bool) -> None:
        """Add contacts that have all ended, or that all persist at the end of the burst (censored)."""
        self.observed.append(observed)
        self.has_ended.append(np.full(len(observed), has_ended))

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Observed durations [s] (n,) and ended flags (n,) of all contacts."""
        if not self.observed:
            return np.empty(0), np.empty(0, dtype=bool)
        return np.concatenate(self.observed), np.concatenate(self.has_ended)


class ContactFollower:
    """Tracks contacts with a nonzero force through one burst of samples.

    A contact begins and ends midway between the two samples that bracket the change. Contacts in the first sample are
    ignored; contacts in the last sample are censored. Contacts shorter than the interval between samples can be missed.
    """

    def __init__(self, followed: FollowedContacts) -> None:
        self._followed = followed
        self._keys = np.empty(0, dtype=np.int64)
        self._since = np.empty(0)
        self._time = np.nan

    def update(self, snapshot: Snapshot) -> None:
        """Add a sample; the snapshot must contain contacts."""
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
        """End the burst."""
        self._record(np.ones(len(self._keys), dtype=bool), self._time, has_ended=False)

    def _record(self, selected: np.ndarray, time: float, has_ended: bool) -> None:
        """Add the selected contacts that began within the burst, with durations up to `time` [s]."""
        began = self._since[selected]
        self._followed.add(time - began[np.isfinite(began)], has_ended)


def keys_of(snapshot: Snapshot) -> np.ndarray:
    """One integer key (n,) int64 per contact with a force above zero; it depends on the two partners only.

    Walls have numbers from FIRST_WALL_KEY on, above all ids.
    """
    contacts = snapshot.contacts
    assert contacts is not None
    first, second, wall = (contacts[name].astype(np.int64) for name in ("id_i", "id_j", "wall"))
    other = np.where(wall >= 0, FIRST_WALL_KEY + wall, second)
    low, high = np.minimum(first, other), np.maximum(first, other)
    return (low * KEY_BASE + high)[contacts["normal_force"] > 0.0]


def survival(observed: np.ndarray, has_ended: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Survival function of the contact duration: times (m,) of observed ends [s], and share (m,) that lasts longer.

        S(t) = product over t_i <= t of (1 - d_i / n_i)

    d_i: ended at t_i, n_i: at risk. Estimator of Kaplan and Meier (1958): a censored contact counts as at risk until
    its observation ends. `observed` (n,) [s], `has_ended` (n,) bool.
    """
    times = np.unique(observed[has_ended])
    at_risk = len(observed) - np.searchsorted(np.sort(observed), times)
    ended_count = np.array([np.count_nonzero(has_ended & (observed == time)) for time in times])
    return times, np.cumprod(1.0 - ended_count / at_risk) if len(times) else np.empty(0)


def median_of(times: np.ndarray, share: np.ndarray) -> float:
    """Median duration [s] of a survival function; nan if more than half of the contacts outlast the observation.

    `times` (m,) [s], `share` (m,): from `survival`.
    """
    below = np.flatnonzero(share <= 0.5)
    return float(times[below[0]]) if len(below) else float("nan")


def bursts(end: float, count: int, samples: int, spacing: float) -> Iterable[list[float]]:
    """Sample times [s] of each burst; the bursts are evenly spaced over a run that ends at `end` [s].

    `count`: number of bursts; `samples`: samples of each, with `spacing` [s] between them.
    """
    for number in range(count):
        start = (number + 0.5) / count * end
        yield [start + sample * spacing for sample in range(samples)]
