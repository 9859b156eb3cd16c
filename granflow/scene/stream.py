"""Particles that arrive during the run: so many, or so much mass, a second, at random wherever there is room."""

import math
from typing import Any

import numpy as np

from granflow.errors import SceneError
from granflow.scene.border import Border
from granflow.scene.grains import Grains, grains_of, random_for, shortfall, stream_of
from granflow.scene.nearness import meets_any
from granflow.scene.places import DiscFace, Inlet, Rain
from granflow.scene.placing import NoRoomError, Spheres, check_width
from granflow.scene.rooms import CylinderRoom, Opening, SlabRoom, room_of
from granflow.scene.schema import Scene
from granflow.scene.sizes import arriving_diameters

POURS_AT_MOST = 500
"""Into how many batches a long rain is gathered: each one stops the device for a moment."""

POURED_FRACTION = 0.05
"""Solid fraction of the region that one batch fills at most."""

EARLY = 1e-6
"""How much of a particle may be missing when it is called due: `next_time` is rounded."""

RETRIED_BATCHES = 4
"""How many batches of waiting particles are tried again in one pour, so that a clogged region costs little."""

KEPT = ("waiting", "due_count", "pour_count", "next_time")

TRIES = (8, 56)
"""Places tried for a particle: first round, and second round for those without luck."""


class Stream:
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
        place = group.place
        if not isinstance(place, Rain | Inlet):
            raise ValueError(f"{group_name} does not come in while the scene runs.")
        self.start = place.start
        self.radius = arriving_diameters(group.sizes, group.count, random_for(scene, group_name)) / 2
        self.mass = 4.0 / 3.0 * np.pi * self.radius**3 * scene.materials[group.material].density
        self.due_at = self.start + _waits(place, self.mass)
        self.interval = 1.0 / place.rate if place.rate else float(self.mass.mean()) / (place.mass_flow or math.inf)
        for array in (self.radius, self.mass, self.due_at):
            array.setflags(write=False)
        gathered = math.ceil(group.count / POURS_AT_MOST)
        self.room = _opening(place, self.radius.max(), np.array(group.velocity, float), gathered * self.interval)
        check_width(self.room, self.radius.max())
        self.batch = batch_size(self.radius, self.room.volume)
        self.waiting = np.empty(0, dtype=np.int64)
        self.due_count = 0
        self.pour_count = 0
        self.next_time = self.start

    def keep(self) -> dict[str, Any]:
        """What decides how it goes on raining; random numbers follow from the number of the pour."""
        return {name: getattr(self, name) for name in KEPT}

    def put_back(self, kept: dict[str, Any]) -> None:
        """Go on from what was kept."""
        for name in KEPT:
            setattr(self, name, kept[name])

    @property
    def remaining(self) -> int:
        """How many have not come yet, those waiting for room included."""
        return len(self.radius) - self.due_count + len(self.waiting)

    @property
    def came(self) -> np.ndarray:
        """Whether each (count,) has come."""
        came = np.arange(len(self.radius)) < self.due_count
        came[self.waiting] = False
        return came

    def pour(self, time: float, position: np.ndarray, radius: np.ndarray) -> Grains:
        """The grains that come at `time`, clear of those present (position (m, 3), radius (m,)) and of each other."""
        due = int(np.searchsorted(self.due_at, time + EARLY * self.interval, side="right"))
        arriving = np.arange(self.due_count, due)
        queue = np.concatenate([self.waiting, arriving])
        self.due_count += len(arriving)
        trying = queue[: RETRIED_BATCHES * self.batch + len(arriving)]
        border = Border.of(self.scene.domain)
        there = (np.asarray(position, dtype=np.float64), np.asarray(radius, dtype=np.float64))
        present = Spheres(*border.with_images(*there))
        random = np.random.default_rng([*stream_of(self.scene, self.group_name), self.pour_count])
        places = self.find_places(trying, present.near(self.room), random)
        poured = np.array(list(places), dtype=np.int64)
        self.waiting = queue[~np.isin(queue, poured)]
        self.pour_count += 1
        self.next_time = self.time_after(time)
        centers = np.array([places[k] for k in poured]).reshape(-1, 3)
        return grains_of(self.scene, self.group_name, centers, self.radius[poured])

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

    def find_places(self, trying: np.ndarray, present: Spheres, random: np.random.Generator) -> dict[int, np.ndarray]:
        """Centres found for those of `trying` that have room, by number, in the order tried."""
        places: dict[int, np.ndarray] = {}
        for tries in TRIES:
            left = np.array([k for k in trying if k not in places], dtype=np.int64)
            many = np.repeat(self.radius[left], tries)
            proposed = self.room.sample(many, random)
            free = ~meets_any(proposed, many, present.position, present.radius)
            for row, k in enumerate(left):
                own = slice(row * tries, (row + 1) * tries)
                self.take_first_clear(int(k), proposed[own][free[own]], places)
        return places

    def take_first_clear(self, k: int, proposed: np.ndarray, places: dict[int, np.ndarray]) -> None:
        """Note the first proposed centre (t, 3) for particle k that is clear of the places taken in this pour."""
        if len(proposed) and places:
            taken = np.array(list(places.values()))
            limit = self.radius[k] + self.radius[list(places)]
            apart = np.linalg.norm(proposed[:, None, :] - taken, axis=2) >= limit
            proposed = proposed[apart.all(axis=1)]
        if len(proposed):
            places[k] = proposed[0]


def batch_size(radius: np.ndarray, volume: float) -> int:
    """How many particles to gather for one pour."""
    mean_volume = float(np.mean(4 / 3 * np.pi * radius**3))
    room_for = int(POURED_FRACTION * volume / mean_volume)
    return max(1, min(math.ceil(len(radius) / POURS_AT_MOST), room_for))


def _waits(place: Rain | Inlet, mass: np.ndarray) -> np.ndarray:
    """How long after the start each particle (n,) is due [s], given all masses [kg] in their order."""
    if place.rate is not None:
        return np.arange(len(mass)) / place.rate
    assert place.mass_flow is not None
    return (np.cumsum(mass) - mass) / place.mass_flow


def _opening(place: Rain | Inlet, radius: float, velocity: np.ndarray, gathered: float) -> Opening:
    """Where particles appear: a region, or behind a face as deep as they come in the time [s] a batch is gathered."""
    if isinstance(place, Rain):
        return room_of(place.region)
    if isinstance(place.face, DiscFace):
        disc = place.face.disc
        normal = np.array(disc.normal) / math.hypot(*disc.normal)
        depth = 2.0 * radius + max(float(velocity @ normal), 0.0) * gathered
        return CylinderRoom(np.array(disc.center), disc.center + depth * normal, disc.radius)
    rectangle = place.face.rectangle
    first, second = np.array(rectangle.sides, float)
    normal = np.cross(first, second) / np.linalg.norm(np.cross(first, second))
    depth = 2.0 * radius + max(float(velocity @ normal), 0.0) * gathered
    return SlabRoom(np.array(rectangle.corner), first, second, depth)


def streams(scene: Scene) -> tuple[Stream, ...]:
    """One for each group that comes in while the scene runs, in the order of the scene. Raises SceneError."""
    found, problems = [], []
    for name, group in scene.particles.items():
        if isinstance(group.place, Rain | Inlet):
            try:
                found.append(Stream(scene, name))
            except NoRoomError as error:
                problems.append(shortfall(scene, name, error))
    if problems:
        raise SceneError(problems)
    return tuple(found)
