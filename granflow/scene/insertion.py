"""Particles that arrive during the run: so many, or so much mass, a second, at random wherever there is room."""

import math
from typing import Any

import numpy as np

from granflow.errors import SceneError
from granflow.scene.close_pairs import overlaps_any
from granflow.scene.insertion_schema import DiscFace, InletInsertion, RainInsertion
from granflow.scene.packing import RegionFullError, Spheres, check_width
from granflow.scene.particle_data import ParticleData, particles_of, random_for, seeds_of, shortfall
from granflow.scene.periodic_box import PeriodicBox
from granflow.scene.regions import CylinderSampler, RegionSampler, SlabSampler, sampler_of
from granflow.scene.schema import Scene
from granflow.scene.size_sampling import ordered_diameters

MAX_BATCHES = 500
"""Into how many batches a long rain is gathered: each one stops the device for a moment."""

BATCH_FRACTION = 0.05
"""Solid fraction of the region that one batch fills at most."""

DUE_TOLERANCE = 1e-6
"""How much of a particle may be missing when it is called due: `next_time` is rounded."""

MAX_RETRIED_BATCHES = 4
"""How many batches of waiting particles are tried again in one pour, so that a clogged region costs little."""

SAVED_FIELDS = ("queued", "due_count", "batch_count", "next_time")

ATTEMPTS = (8, 56)
"""Places tried for a particle: first round, and second round for those without luck."""


class Inserter:
    """The rain or the inlet of one group: which sizes come in which order is settled beforehand.

    Particle k is due at start + k / rate, or once the mass of those before it should have come:

        t_k = start + (m_0 + ... + m_(k-1)) / mass_flow

    Those due are poured in batches; one that finds no room waits and goes first the next time. Walls are not looked
    at. The places depend on the scene's seed, the number of the pour, and what is there already.

    radius (count,) [m]: all sizes in the order of arrival.  due_at (count,) [s]: when each is due.
    remaining: how many are still to come.  next_time [s]: when to pour next; infinite once all have come.
    """

    def __init__(self, scene: Scene, group_name: str) -> None:
        group = scene.particles[group_name]
        self.scene, self.group_name = scene, group_name
        insertion = group.insert
        if not isinstance(insertion, RainInsertion | InletInsertion):
            raise ValueError(f"{group_name} does not come in while the scene runs.")
        self.start = insertion.start
        self.radius = ordered_diameters(group.sizes, group.count, random_for(scene, group_name)) / 2
        self.mass = 4.0 / 3.0 * np.pi * self.radius**3 * scene.materials[group.material].density
        self.due_at = self.start + _delays(insertion, self.mass)
        self.interval = (
            1.0 / insertion.rate if insertion.rate else float(self.mass.mean()) / (insertion.mass_flow or math.inf)
        )
        for array in (self.radius, self.mass, self.due_at):
            array.setflags(write=False)
        gathered = math.ceil(group.count / MAX_BATCHES)
        self.region = _insertion_region(
            insertion, self.radius.max(), np.array(group.velocity, float), gathered * self.interval
        )
        check_width(self.region, self.radius.max())
        self.batch = batch_size(self.radius, self.region.volume)
        self.queued = np.empty(0, dtype=np.int64)
        self.due_count = 0
        self.batch_count = 0
        self.next_time = self.start

    def state_dict(self) -> dict[str, Any]:
        """What decides how it goes on raining; random numbers follow from the number of the pour."""
        return {name: getattr(self, name) for name in SAVED_FIELDS}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Go on from what was kept."""
        for name in SAVED_FIELDS:
            setattr(self, name, saved[name])

    @property
    def remaining(self) -> int:
        """How many have not come yet, those waiting for room included."""
        return len(self.radius) - self.due_count + len(self.queued)

    @property
    def is_inserted(self) -> np.ndarray:
        """Whether each (count,) has come."""
        is_inserted = np.arange(len(self.radius)) < self.due_count
        is_inserted[self.queued] = False
        return is_inserted

    def insert_due(self, time: float, position: np.ndarray, radius: np.ndarray) -> ParticleData:
        """The grains that come at `time`, clear of those present (position (m, 3), radius (m,)) and of each other."""
        due = int(np.searchsorted(self.due_at, time + DUE_TOLERANCE * self.interval, side="right"))
        arriving = np.arange(self.due_count, due)
        queue = np.concatenate([self.queued, arriving])
        self.due_count += len(arriving)
        candidates = queue[: MAX_RETRIED_BATCHES * self.batch + len(arriving)]
        periodic_box = PeriodicBox.of(self.scene.domain)
        existing = (np.asarray(position, dtype=np.float64), np.asarray(radius, dtype=np.float64))
        obstacles = Spheres(*periodic_box.with_images(*existing))
        random = np.random.default_rng([*seeds_of(self.scene, self.group_name), self.batch_count])
        positions = self.find_positions(candidates, obstacles.near(self.region), random)
        inserted = np.array(list(positions), dtype=np.int64)
        self.queued = queue[~np.isin(queue, inserted)]
        self.batch_count += 1
        self.next_time = self.time_after(time)
        centers = np.array([positions[k] for k in inserted]).reshape(-1, 3)
        return particles_of(self.scene, self.group_name, centers, self.radius[inserted])

    def time_after(self, time: float) -> float:
        """When the next batch is due; while only waiting ones are left, after the time a batch takes."""
        if self.remaining == 0:
            return math.inf
        if self.due_count == 0:
            return self.start
        if self.due_count == len(self.radius):
            return time + self.batch * self.interval
        last = min(self.due_count + self.batch, len(self.radius)) - 1
        return float(self.due_at[last])

    def find_positions(
        self, candidates: np.ndarray, obstacles: Spheres, random: np.random.Generator
    ) -> dict[int, np.ndarray]:
        """Centers found for those of `candidates` that have room, by number, in the order tried."""
        positions: dict[int, np.ndarray] = {}
        for attempts in ATTEMPTS:
            unplaced = np.array([k for k in candidates if k not in positions], dtype=np.int64)
            repeated_radii = np.repeat(self.radius[unplaced], attempts)
            proposed = self.region.sample(repeated_radii, random)
            free = ~overlaps_any(proposed, repeated_radii, obstacles.position, obstacles.radius)
            for row, k in enumerate(unplaced):
                own = slice(row * attempts, (row + 1) * attempts)
                self.place_first_clear(int(k), proposed[own][free[own]], positions)
        return positions

    def place_first_clear(self, k: int, proposed: np.ndarray, positions: dict[int, np.ndarray]) -> None:
        """Note the first proposed center (t, 3) for particle k that is clear of the places taken in this pour."""
        if len(proposed) and positions:
            occupied = np.array(list(positions.values()))
            limit = self.radius[k] + self.radius[list(positions)]
            is_clear = np.linalg.norm(proposed[:, None, :] - occupied, axis=2) >= limit
            proposed = proposed[is_clear.all(axis=1)]
        if len(proposed):
            positions[k] = proposed[0]


def batch_size(radius: np.ndarray, volume: float) -> int:
    """How many particles to gather for one pour."""
    mean_volume = float(np.mean(4 / 3 * np.pi * radius**3))
    capacity = int(BATCH_FRACTION * volume / mean_volume)
    return max(1, min(math.ceil(len(radius) / MAX_BATCHES), capacity))


def _delays(insertion: RainInsertion | InletInsertion, mass: np.ndarray) -> np.ndarray:
    """How long after the start each particle (n,) is due [s], given all masses [kg] in their order."""
    if insertion.rate is not None:
        return np.arange(len(mass)) / insertion.rate
    assert insertion.mass_flow is not None
    return (np.cumsum(mass) - mass) / insertion.mass_flow


def _insertion_region(
    insertion: RainInsertion | InletInsertion, radius: float, velocity: np.ndarray, gathered: float
) -> RegionSampler:
    """Where particles appear: a region, or behind a face as deep as they come in the time [s] a batch is gathered."""
    if isinstance(insertion, RainInsertion):
        return sampler_of(insertion.region)
    if isinstance(insertion.face, DiscFace):
        disc = insertion.face.disc
        normal = np.array(disc.normal) / math.hypot(*disc.normal)
        depth = 2.0 * radius + max(float(velocity @ normal), 0.0) * gathered
        return CylinderSampler(np.array(disc.center), disc.center + depth * normal, disc.radius)
    rectangle = insertion.face.rectangle
    first, second = np.array(rectangle.sides, float)
    normal = np.cross(first, second) / np.linalg.norm(np.cross(first, second))
    depth = 2.0 * radius + max(float(velocity @ normal), 0.0) * gathered
    return SlabSampler(np.array(rectangle.corner), first, second, depth)


def inserters(scene: Scene) -> tuple[Inserter, ...]:
    """One for each group that comes in while the scene runs, in the order of the scene. Raises SceneError."""
    inserters, problems = [], []
    for name, group in scene.particles.items():
        if isinstance(group.insert, RainInsertion | InletInsertion):
            try:
                inserters.append(Inserter(scene, name))
            except RegionFullError as error:
                problems.append(shortfall(scene, name, error))
    if problems:
        raise SceneError(problems)
    return tuple(inserters)
