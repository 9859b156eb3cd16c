"""Observers of a variant's run: bed heights, normal forces, contact durations.

They hold their results in memory; `granflow.studies.compare.report` writes them.
"""

from dataclasses import dataclass, field
from math import inf

import numpy as np

from granflow.load import Scene
from granflow.observers.base import CONTACTS
from granflow.snapshot import Snapshot
from granflow.studies.compare.contact_durations import ContactFollower, FollowedContacts

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
        gravity = np.array(scene.gravity, dtype=float)
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
        """Share of contacts of a stage with more than this multiple of the mean force, which must be a bin edge.

        Between 0 and 1; nan for a stage without frames.
        """
        found = self.counts.get(stage)
        if found is None:
            return float("nan")
        return float(found[FORCE_EDGES[:-1] > multiple - 1e-9].sum() / found.sum())


class ContactBursts:
    """Samples all contacts in short bursts at several times of the run; see `ContactFollower`.

    `times`: sample times [s] of each burst, in ascending order; `spacing` [s]: time between the samples of a burst.
    `followed`: the observed contacts.
    """

    wants = frozenset({CONTACTS})

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
