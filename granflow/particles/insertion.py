"""Particles of a scene: the initial ones, and those that inserters add during the run.

The same scene and seed give bit-identical particles on one machine for any number of threads: each group
has a separate random number generator (`SceneGroup.random`). Inserters add a number or a mass of particles
per second, at random free positions in a region.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from granflow.errors import SceneError
from granflow.geometry.close_pairs import overlaps_any
from granflow.geometry.packing import RegionFullError, Spheres, check_width
from granflow.geometry.periodic_box import PeriodicBox
from granflow.geometry.sphere import sphere_volume
from granflow.particles.file import particles_from_file
from granflow.particles.group import ParticleData, SceneGroup, groups_of, particles_of, shortfall
from granflow.scene.blocks.insertions import TimedInsertion
from granflow.scene.blocks.scene import SceneInput

# Initial particles.


def initial_particles(scene: SceneInput, earlier: Mapping[str, ParticleData] | None = None) -> ParticleData:
    """All particles at t = 0, group by group in the order of the scene.

    Groups in `earlier` keep their particles from an earlier run; the other groups avoid them, and those of
    kinds before theirs (`InsertionKind.order`). Particles do not overlap, except where given positions or
    files overlap. Groups with rain, inlet or python have no particles yet.

    Raises SceneError with one message for each group that does not fit.
    """
    inserted: dict[str, ParticleData] = dict(earlier or {})
    remaining = {name: group for name, group in groups_of(scene).items() if name not in inserted}
    problems: list[str] = []
    orders = {order for each in remaining.values() if (order := each.spec.insert.order) is not None}
    for order in sorted(orders):
        for name, group in remaining.items():
            if group.spec.insert.order == order:
                try:
                    inserted[name] = insert_group(group, all_spheres(inserted, scene.domain.periodic_box()))
                except RegionFullError as error:
                    others = list(inserted) if fits_alone(group) else []
                    problems.append(shortfall(group, error, others))
    if problems:
        raise SceneError(problems)
    return ParticleData.joined([inserted[name] for name in scene.particles if name in inserted])


def fits_alone(group: SceneGroup) -> bool:
    """Whether a group fits where there are no particles of other groups."""
    try:
        insert_group(group, Spheres.none())
    except RegionFullError:
        return False
    return True


def all_spheres(inserted: dict[str, ParticleData], periodic_box: PeriodicBox) -> Spheres:
    """Spheres of all groups inserted so far, with the periodic images of those that cross a periodic face.

    `inserted`: particles by group, in any order.
    """
    together = ParticleData.joined(list(inserted.values()))
    return Spheres(*periodic_box.with_images(together.position, together.radius))


def insert_group(group: SceneGroup, existing: Spheres) -> ParticleData:
    """Initial particles of one group, without overlap with `existing`.

    Radii are drawn before positions, with the random number generator of the group. Given positions and files
    are not checked for overlap.

    Raises RegionFullError if a lattice or packing does not fit, and SceneError for an invalid file.
    """
    spec = group.spec
    if spec.insert.source is not None:
        return particles_from_file(group)
    random = group.random()
    radius = spec.sizes.draw(spec.count, random) / 2
    return particles_of(group, spec.insert.centers(radius, existing, random), radius)


# Insertion during the run: inserters run on the host.
#
# `next_time` is the time of the next batch, `insert_due` returns its particles.

MAX_BATCHES = 500
"""Largest number of batches of one group: each batch interrupts the device."""
BATCH_FRACTION = 0.05
"""Largest solid fraction of the region that one batch fills."""
DUE_TOLERANCE = 1e-6
"""Tolerance of due times, as a fraction of the mean interval between particles: `next_time` is rounded."""
MAX_RETRIED_BATCHES = 4
"""Largest number of queued particles that are tried again in one batch, in batch sizes: limits the cost of a
full region."""
SAVED_FIELDS = ("queued", "due_count", "batch_count", "start", "is_over", "next_time")
"""Attributes of an inserter in checkpoints: particle numbers (q,), counts, the start [s], whether its stages
or its time are over, and the time of the next batch [s]."""
ATTEMPTS = (8, 56)
"""Positions tried for a particle: in the first round, and in the second round after a failure of the
first."""
IsClear = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function of centers (n, 3) [m] and radii (n,) [m] of spheres that returns whether each (n,) is outside of
walls."""


class Inserter:
    """Inserter of one group, such as rain or inlet; the sizes and their order are drawn at construction.

    Particle k is due at start + k / rate, or, with a mass flow rate, at

        t_k = start + (m_0 + ... + m_(k-1)) / mass_flow

    Due particles are inserted in batches. A particle without a free position is queued and has priority in
    the next batch. Positions inside walls are not used. The positions depend on the seed of the scene, the
    number of the batch, the existing particles, and walls in the region.

    With `stages`, start is that of the first of them (`begin_stage`), and infinite before. After the last of
    them, or after `end`, nothing is inserted, queued particles included.

    `radius`, `mass`, `delays` (count,): radii [m], masses [kg] and due times after the start [s] in the order
    of insertion, read-only; of clumps the radius of the sphere around each.
    `queued` (q,) int64: particle numbers in the order of priority. `batch`: particles per batch. `interval`
    [s]: mean time between particles. `end` [s]: of the insertion. `next_time` [s]: time of the next batch;
    infinite after the last.

    Raises ValueError for a group of another kind, and RegionFullError if the largest particle does not
    fit into the region.
    """

    def __init__(self, group: SceneGroup) -> None:
        self.group = group
        self.group_name = group.name
        spec = group.spec
        insertion = spec.insert
        if not isinstance(insertion, TimedInsertion):
            raise ValueError(f"{group.name} has no particles that enter during the run.")
        self.start = insertion.start if insertion.stages is None else math.inf
        self.end = math.inf if insertion.end is None else insertion.end
        self.is_over = False
        self.radius = spec.sizes.ordered(spec.count, group.random()) / 2
        self.mass = group.spec.shape.volume(self.radius) * group.density
        self.delays = insertion.delays(self.mass)
        self.interval = insertion.interval(float(self.mass.mean()))
        for array in (self.radius, self.mass, self.delays):
            array.setflags(write=False)
        gathered = math.ceil(spec.count / MAX_BATCHES)
        self.region = insertion.region_for(
            self.radius.max(), np.array(spec.velocity, float), gathered * self.interval
        )
        check_width(self.region, self.radius.max())
        self.batch = batch_size(self.radius, self.region.volume)
        self.queued = np.empty(0, dtype=np.int64)
        self.due_count = 0
        self.batch_count = 0
        self.next_time = self.start

    def state_dict(self) -> dict[str, Any]:
        """State of the insertion: SAVED_FIELDS. The random numbers follow from the number of the batch."""
        return {name: getattr(self, name) for name in SAVED_FIELDS}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state saved by `state_dict`; a flow that was complete goes on if there are more
        particles now, because the run lasts longer."""
        for name in SAVED_FIELDS:
            setattr(self, name, saved[name])
        if math.isinf(self.next_time) and not self.is_over:
            self.next_time = self.time_after(self.next_time)

    def begin_stage(self, name: str, time: float) -> None:
        """Begin the flow at `time` [s] if the stage is the first of its stages, end it if they are over."""
        stages = getattr(self.group.spec.insert, "stages", None)
        if stages is None:
            return
        first, last = self.group.scene.stage_range(stages)
        index = self.group.scene.stage_names.index(name)
        if index == first:
            self.start = self.next_time = time
        if index > last:
            self.is_over = True
            self.next_time = math.inf

    @property
    def is_pending(self) -> bool:
        """Whether particles are missing that can enter without a further stage."""
        return self.remaining > 0 and not self.is_over and not math.isinf(self.start)

    @property
    def due_at(self) -> np.ndarray:
        """Due times (count,) [s] in the order of insertion."""
        return self.start + self.delays

    @property
    def remaining(self) -> int:
        """Number of particles not inserted yet, including queued ones."""
        return len(self.radius) - self.due_count + len(self.queued)

    @property
    def is_inserted(self) -> np.ndarray:
        """Whether each particle (count,) has been inserted."""
        is_inserted = np.arange(len(self.radius)) < self.due_count
        is_inserted[self.queued] = False
        return is_inserted

    def insert_due(
        self,
        time: float,
        position: np.ndarray,
        radius: np.ndarray,
        is_clear: IsClear = lambda centers, radii: np.ones(len(radii), dtype=bool),
    ) -> ParticleData:
        """Particles inserted at `time` [s], without overlap with existing ones or each other.

        `position` (m, 3) [m], `radius` (m,) [m]: existing particles, whose periodic images are considered
        too. `is_clear`: whether spheres are outside of walls. Particles without a free position are added to
        `queued`; at most MAX_RETRIED_BATCHES batches of queued particles are tried. Changes `queued`,
        `due_count`, `batch_count` and `next_time`.
        """
        due = int(np.searchsorted(self.due_at, time + DUE_TOLERANCE * self.interval, side="right"))
        arriving = np.arange(self.due_count, due)
        queue = np.concatenate([self.queued, arriving])
        self.due_count += len(arriving)
        candidates = queue[: MAX_RETRIED_BATCHES * self.batch + len(arriving)]
        periodic_box = self.group.scene.domain.periodic_box()
        existing = (np.asarray(position, dtype=np.float64), np.asarray(radius, dtype=np.float64))
        obstacles = Spheres(*periodic_box.with_images(*existing))
        random = np.random.default_rng([*self.group.seeds, self.batch_count])
        positions = self.find_positions(candidates, obstacles.near(self.region), random, is_clear)
        inserted = np.array(list(positions), dtype=np.int64)
        self.queued = queue[~np.isin(queue, inserted)]
        centers = np.array([positions[k] for k in inserted]).reshape(-1, 3)
        particles = particles_of(self.group, centers, self.radius[inserted], self.batch_count)
        self.batch_count += 1
        self.next_time = self.time_after(time)
        if self.next_time > self.end + DUE_TOLERANCE * self.interval:
            self.is_over, self.next_time = True, math.inf
        return particles

    def time_after(self, time: float) -> float:
        """Time of the next batch [s], when its last particle is due; infinite if no particles remain.

        If only queued particles remain, one mean batch interval after `time` [s].
        """
        if self.remaining == 0:
            return math.inf
        if self.due_count == 0:
            return self.start
        if self.due_count == len(self.radius):
            return time + self.batch * self.interval
        last = min(self.due_count + self.batch, len(self.radius)) - 1
        return float(self.due_at[last])

    def find_positions(
        self, candidates: np.ndarray, obstacles: Spheres, random: np.random.Generator, is_clear: IsClear
    ) -> dict[int, np.ndarray]:
        """Free centers (3,) [m] found for `candidates`, by particle number, in the order tried.

        `candidates` (c,) int64: particle numbers; `obstacles`: existing spheres near the region. Each
        particle has ATTEMPTS[0] attempts in the first round, and ATTEMPTS[1] in the second if the first
        fails.
        """
        positions: dict[int, np.ndarray] = {}
        for attempts in ATTEMPTS:
            unplaced = np.array([k for k in candidates if k not in positions], dtype=np.int64)
            repeated_radii = np.repeat(self.radius[unplaced], attempts)
            proposed = self.region.sample(repeated_radii, random)
            free = ~overlaps_any(proposed, repeated_radii, obstacles.position, obstacles.radius)
            free &= is_clear(proposed, repeated_radii)
            for row, k in enumerate(unplaced):
                own = slice(row * attempts, (row + 1) * attempts)
                self.place_first_clear(int(k), proposed[own][free[own]], positions)
        return positions

    def place_first_clear(self, k: int, proposed: np.ndarray, positions: dict[int, np.ndarray]) -> None:
        """Add the first proposed center of particle `k` without overlap with those of this batch to
        `positions`.

        `proposed` (t, 3) [m]: centers without overlap with existing particles. Nothing is added if none is
        clear.
        """
        if len(proposed) and positions:
            occupied = np.array(list(positions.values()))
            limit = self.radius[k] + self.radius[list(positions)]
            is_clear = np.linalg.norm(proposed[:, None, :] - occupied, axis=2) >= limit
            proposed = proposed[is_clear.all(axis=1)]
        if len(proposed):
            positions[k] = proposed[0]


def inserters(scene: SceneInput) -> tuple[Inserter, ...]:
    """Inserters of all groups whose particles enter during the run, in the order of the scene.

    Raises SceneError with one message for each group that does not fit into its region.
    """
    inserters = []
    problems = []
    for group in groups_of(scene).values():
        if isinstance(group.spec.insert, TimedInsertion):
            try:
                inserters.append(Inserter(group))
            except RegionFullError as error:
                problems.append(shortfall(group, error))
    if problems:
        raise SceneError(problems)
    return tuple(inserters)


def batch_size(radius: np.ndarray, volume: float) -> int:
    """Number of particles per batch, at least 1.

        n = min(count / MAX_BATCHES, BATCH_FRACTION V / mean sphere volume)

    `radius` (count,) [m]: of all particles of the group; `volume` V [m3] of the region. The second limit
    keeps the region dilute, so that free positions are found.
    """
    mean_volume = float(np.mean(sphere_volume(radius)))
    capacity = int(BATCH_FRACTION * volume / mean_volume)
    return max(1, min(math.ceil(len(radius) / MAX_BATCHES), capacity))
