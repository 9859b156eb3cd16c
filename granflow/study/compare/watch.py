"""What is watched while a variant runs: heights of the bed, normal forces, durations of contacts."""

from dataclasses import dataclass, field
from math import inf

import numpy as np

from granflow.observe.observer import CONTACTS
from granflow.scene import Scene
from granflow.snapshot import Snapshot
from granflow.study.compare.durations import Followed, Follower

TOPS = 95.0
"""Percentile of the tops of grains that stands for the surface of the bed."""
FORCE_EDGES = np.concatenate([np.arange(0.0, 8.01, 0.2), [np.inf]])
"""Classes of force over mean force."""
LEAST_CONTACTS = 10
"""Contacts between grains that a frame must have to have a mean worth dividing by."""


@dataclass
class Heights:
    """Height of the centre of mass and of the surface [m], against gravity, from the origin."""

    up: np.ndarray
    """(3,), zero where there is no gravity."""
    rows: list[tuple[float, float, float]] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    """Speed [m/s] that few grains exceed at each moment: the percentile of the tops."""

    @property
    def fast(self) -> float:
        """Median of the speeds [m/s]: what a colour scale should reach."""
        return float(np.median(self.speeds)) if self.speeds else 0.0

    @classmethod
    def of(cls, scene: Scene) -> "Heights":
        """Make the gauge for a scene."""
        gravity = np.array(scene.gravity, dtype=float)
        strength = float(np.linalg.norm(gravity))
        return cls(-gravity / strength if strength > 0.0 else gravity)

    def look(self, snapshot: Snapshot) -> None:
        """Add a row: time [s], centre, surface; nan without grains or without gravity."""
        particles = snapshot.particles
        if len(particles["mass"]):
            speed = np.linalg.norm(particles["velocity"], axis=1)
            self.speeds.append(float(np.percentile(speed, TOPS)))
        if not len(particles["mass"]) or not self.up.any():
            self.rows.append((snapshot.time, np.nan, np.nan))
            return
        height = particles["position"] @ self.up
        centre = float(np.average(height, weights=particles["mass"]))
        self.rows.append((snapshot.time, centre, float(np.percentile(height + particles["radius"], TOPS))))


@dataclass
class Forces:
    """Normal forces between grains over their mean in the same frame: how many in each class, by stage."""

    counts: dict[str, np.ndarray] = field(default_factory=dict)

    def look(self, snapshot: Snapshot) -> None:
        """Add the contacts of a frame, if they are enough."""
        contacts = snapshot.contacts
        assert contacts is not None
        force = contacts["normal_force"][contacts["second_id"] >= 0]
        force = force[force > 0.0]
        if len(force) < LEAST_CONTACTS:
            return
        found, _ = np.histogram(force / force.mean(), FORCE_EDGES)
        self.counts[snapshot.stage] = self.counts.get(snapshot.stage, 0) + found

    def density(self, stage: str) -> np.ndarray:
        """P(f/<f>) in the classes but the last, which is open; nan where a stage has no frames."""
        found = self.counts.get(stage)
        if found is None:
            return np.full(len(FORCE_EDGES) - 2, np.nan)
        return np.asarray(found[:-1] / (found.sum() * np.diff(FORCE_EDGES[:-1])))

    def share_above(self, stage: str, multiple: float) -> float:
        """Share of contacts of a stage with more than this multiple of the mean force; an edge of a class."""
        found = self.counts.get(stage)
        if found is None:
            return float("nan")
        return float(found[FORCE_EDGES[:-1] > multiple - 1e-9].sum() / found.sum())


class Bursts:
    """Looks at all contacts in quick succession, at several times of the run; see `Follower`."""

    wants = frozenset({CONTACTS})

    def __init__(self, times: list[list[float]], spacing: float) -> None:
        self.followed = Followed()
        self._waiting = [list(burst) for burst in times]
        self._spacing = spacing
        self._follower: Follower | None = None

    def next_time(self) -> float:
        """Time [s] of the next look."""
        return self._waiting[0][0] if self._waiting else inf

    def observe(self, snapshot: Snapshot) -> None:
        """Look, if a look is due; a run shows every observer its first moment."""
        if not self._waiting or snapshot.time < self.next_time() - 0.5 * self._spacing:
            return
        if self._follower is None:
            self._follower = Follower(self.followed)
        self._follower.look(snapshot)
        later = [time for time in self._waiting[0] if time > snapshot.time + 0.5 * self._spacing]
        self._waiting[0] = later
        if not later:
            self._waiting.pop(0)
            self._close()

    def finish(self) -> None:
        """The run is over."""
        self._close()

    def _close(self) -> None:
        if self._follower is not None:
            self._follower.close()
            self._follower = None
