"""What a comparison observes in the bed of each run, apart from `timeseries.csv`.

Three observers hold their results in memory: the heights of the bed, the distribution of the normal forces,
and the durations of contacts. A duration needs samples in short intervals, which would be too many for a
whole run: all contacts are followed in several short bursts, and contacts that outlast a burst are accounted
for by the estimator of Kaplan and Meier.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

import numpy as np

from granflow import Scene, Snapshot

# ---------------------------------------------------------------- heights and forces

SURFACE_PERCENTILE = 95.0
"""Percentile of the particle tops that defines the surface of the bed."""
FORCE_EDGES = np.concatenate([np.arange(0.0, 8.01, 0.2), [np.inf]])
"""Bin edges of force over mean force."""
MIN_CONTACTS = 10
"""Minimum number of particle-particle contacts of a frame for a meaningful mean force."""


@dataclass
class BedHeights:
    """Heights of the center of mass and of the surface [m] above the origin, opposite to gravity.

    `rows`: time [s], height of the center of mass [m] and of the surface [m] of each snapshot.
    """

    up: np.ndarray
    """Unit vector opposite to gravity (3,); zero without gravity."""
    rows: list[tuple[float, float, float]] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    """Percentile SURFACE_PERCENTILE of the particle speeds [m/s] in each snapshot."""

    @property
    def typical_speed(self) -> float:
        """Median of `speeds` [m/s], the upper end of the color scale."""
        return float(np.median(self.speeds)) if self.speeds else 0.0

    @classmethod
    def of(cls, scene: Scene) -> "BedHeights":
        """Create the observer for a scene."""
        gravity = np.array(scene.usual_gravity, dtype=float)
        strength = float(np.linalg.norm(gravity))
        return cls(-gravity / strength if strength > 0.0 else gravity)

    def update(self, snapshot: Snapshot) -> None:
        """Add a row: time [s], center [m], surface [m]; nan without particles or without gravity.

        The surface is the percentile SURFACE_PERCENTILE of the tops of the particles.
        """
        particles = snapshot.particles
        if len(particles["mass"]):
            speed = np.linalg.norm(particles["velocity"], axis=1)
            self.speeds.append(float(np.percentile(speed, SURFACE_PERCENTILE)))
        if not len(particles["mass"]) or not self.up.any():
            self.rows.append((snapshot.time, np.nan, np.nan))
            return
        height = particles["position"] @ self.up
        center = float(np.average(height, weights=particles["mass"]))
        self.rows.append(
            (snapshot.time, center, float(np.percentile(height + particles["radius"], SURFACE_PERCENTILE)))
        )


@dataclass
class ForceHistogram:
    """Histogram of the normal forces between particles over their mean in the same frame, by stage.

    `counts`: stage -> numbers of contacts (bins,) with the bin edges FORCE_EDGES; the last bin is open.
    """

    counts: dict[str, np.ndarray] = field(default_factory=dict)

    def update(self, snapshot: Snapshot) -> None:
        """Add the contacts of a frame with at least MIN_CONTACTS contacts."""
        contacts = snapshot.contacts
        assert contacts is not None
        force = contacts["normal_force"][contacts["id_j"] >= 0]
        force = force[force > 0.0]
        if len(force) < MIN_CONTACTS:
            return
        found, _ = np.histogram(force / force.mean(), FORCE_EDGES)
        self.counts[snapshot.stage] = self.counts.get(snapshot.stage, 0) + found

    def density(self, stage: str) -> np.ndarray:
        """P(f/<f>) in all bins except the last, open one (bins - 1,); nan for a stage without frames.

        The integral over all bins, the open one included, is 1.
        """
        found = self.counts.get(stage)
        if found is None:
            return np.full(len(FORCE_EDGES) - 2, np.nan)
        return np.asarray(found[:-1] / (found.sum() * np.diff(FORCE_EDGES[:-1])))

    def share_above(self, stage: str, multiple: float) -> float:
        """Share of contacts of a stage with more than this multiple of the mean force, which must be a bin
        edge.

        Between 0 and 1; nan for a stage without frames.
        """
        found = self.counts.get(stage)
        if found is None:
            return float("nan")
        return float(found[FORCE_EDGES[:-1] > multiple - 1e-9].sum() / found.sum())


# ---------------------------------------------------------------- contact durations


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


def bursts(end: float, count: int, samples: int, spacing: float) -> Iterable[list[float]]:
    """Sample times [s] of each burst; the bursts are evenly spaced over a run that ends at `end` [s].

    `count`: number of bursts; `samples`: samples of each, with `spacing` [s] between them.
    """
    for number in range(count):
        start = (number + 0.5) / count * end
        yield [start + sample * spacing for sample in range(samples)]


class ContactBursts:
    """Samples all contacts in short bursts at several times of the run; see `ContactFollower`.

    `times`: sample times [s] of each burst, in ascending order; `spacing` [s]: time between the samples of a
    burst. `followed`: the observed contacts.
    """

    wants = frozenset({"contacts"})

    def __init__(self, times: list[list[float]], spacing: float) -> None:
        self.followed = FollowedContacts()
        self._pending = [list(burst) for burst in times]
        self._spacing = spacing
        self._follower: ContactFollower | None = None

    def next_time(self) -> float:
        """Time of the next sample [s]; inf after the last."""
        return self._pending[0][0] if self._pending else inf

    def observe(self, snapshot: Snapshot) -> None:
        """Sample the contacts if a sample is due; a run calls every observer at its start."""
        if not self._pending or snapshot.time < self.next_time() - 0.5 * self._spacing:
            return
        if self._follower is None:
            self._follower = ContactFollower(self.followed)
        self._follower.update(snapshot)
        remaining = [time for time in self._pending[0] if time > snapshot.time + 0.5 * self._spacing]
        self._pending[0] = remaining
        if not remaining:
            self._pending.pop(0)
            self._close()

    def finish(self) -> None:
        """End the current burst at the end of the run."""
        self._close()

    def _close(self) -> None:
        """End the current burst; its remaining contacts are censored."""
        if self._follower is not None:
            self._follower.close()
            self._follower = None


class ContactFollower:
    """Tracks contacts with a nonzero force through one burst of samples.

    A contact begins and ends midway between the two samples that bracket the change. Contacts in the first
    sample are ignored; contacts in the last sample are censored. Contacts shorter than the interval between
    samples can be missed.
    """

    def __init__(self, followed: FollowedContacts) -> None:
        self._followed = followed
        self._contacts = ActingContacts(np.empty(0, dtype=np.int64), np.empty((0, 3)))
        self._since = np.empty(0)
        self._time = np.nan

    def update(self, snapshot: Snapshot) -> None:
        """Add a sample; the snapshot must contain contacts."""
        contacts = acting_contacts(snapshot)
        if np.isnan(self._time):
            since = np.full(len(contacts.keys), -np.inf)
        else:
            middle = 0.5 * (self._time + snapshot.time)
            old, new = continued(self._contacts, contacts)
            has_ended = np.ones(len(self._contacts.keys), dtype=bool)
            has_ended[old] = False
            self._record(has_ended, middle, has_ended=True)
            since = np.full(len(contacts.keys), middle)
            since[new] = self._since[old]
        self._contacts = contacts
        self._since = since
        self._time = snapshot.time

    def close(self) -> None:
        """End the burst."""
        self._record(np.ones(len(self._since), dtype=bool), self._time, has_ended=False)

    def _record(self, selected: np.ndarray, time: float, has_ended: bool) -> None:
        """Add the selected contacts that began within the burst, with durations up to `time` [s]."""
        began = self._since[selected]
        self._followed.add(time - began[np.isfinite(began)], has_ended)


def survival(observed: np.ndarray, has_ended: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Survival function of the contact duration: times (m,) of observed ends [s], and share (m,) that lasts
    longer.

        S(t) = product over t_i <= t of (1 - d_i / n_i)

    d_i: ended at t_i, n_i: at risk. Estimator of Kaplan and Meier (1958): a censored contact counts as at
    risk until its observation ends. `observed` (n,) [s], `has_ended` (n,) bool.
    """
    times = np.unique(observed[has_ended])
    at_risk = len(observed) - np.searchsorted(np.sort(observed), times)
    ended_count = np.array([np.count_nonzero(has_ended & (observed == time)) for time in times])
    return times, np.cumprod(1.0 - ended_count / at_risk) if len(times) else np.empty(0)


def median_of(times: np.ndarray, share: np.ndarray) -> float:
    """Median duration [s] of a survival function; nan if more than half of the contacts outlast the
    observation.

    `times` (m,) [s], `share` (m,): from `survival`.
    """
    below = np.flatnonzero(share <= 0.5)
    return float(times[below[0]]) if len(below) else float("nan")


# ---------------------------------------------------------------- contacts of two successive samples

KEY_BASE = 2**32
"""Exceeds every id, so that two ids combine into one integer key."""
FIRST_WALL_KEY = 2**31
"""Key of the first wall, above all ids."""


class ActingContacts(NamedTuple):
    """Contacts with a force above zero: integer key (n,) of the two partners, and branch vector (n, 3) [m].

    A pair has several contacts where a particle is in contact with several triangles of one mesh, two clumps
    with several of their spheres, or two particles directly and across a periodic face; these have equal
    keys.
    """

    keys: np.ndarray
    branch: np.ndarray


def acting_contacts(snapshot: Snapshot) -> ActingContacts:
    """The contacts of a snapshot with a force above zero; keys and branch vectors depend on the two partners
    only.

    Walls have numbers from FIRST_WALL_KEY on, above all ids. The branch vector points from the lower to the
    higher one.
    """
    contacts = snapshot.contacts
    assert contacts is not None
    first = contacts["id_i"].astype(np.int64)
    wall = contacts["wall"].astype(np.int64)
    other = np.where(wall >= 0, FIRST_WALL_KEY + wall, contacts["id_j"].astype(np.int64))
    low, high = np.minimum(first, other), np.maximum(first, other)
    direction = np.where((first <= other)[:, None], 1.0, -1.0)
    branch = direction * (contacts["position_j"] - contacts["position_i"])
    acting = contacts["normal_force"] > 0.0
    return ActingContacts((low * KEY_BASE + high)[acting], branch[acting])


def continued(before: ActingContacts, after: ActingContacts) -> tuple[np.ndarray, np.ndarray]:
    """Indices (m,) of the contacts that continue from one sample to the next, in the first and in the second
    one.

    The contact of a pair with one contact in both samples continues. Of a pair with several, those with the
    nearest branch vectors are the same contact, the nearest two first.
    """
    rows_before, rows_after = _rows_by_key(before.keys), _rows_by_key(after.keys)
    found: list[tuple[int, int]] = []
    for key in rows_before.keys() & rows_after.keys():
        old, new = rows_before[key], rows_after[key]
        if len(old) == len(new) == 1:
            found.append((old[0], new[0]))
            continue
        distance = np.linalg.norm(before.branch[old][:, None] - after.branch[new][None], axis=2)
        for _ in range(min(len(old), len(new))):
            i, j = np.unravel_index(np.argmin(distance), distance.shape)
            found.append((old[i], new[j]))
            distance[i, :] = distance[:, j] = np.inf
    pairs = np.array(found, dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _rows_by_key(keys: np.ndarray) -> dict[int, list[int]]:
    """Rows of each key."""
    found: dict[int, list[int]] = {}
    for row, key in enumerate(keys.tolist()):
        found.setdefault(key, []).append(row)
    return found
