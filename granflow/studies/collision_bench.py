"""Binary collisions: many separate pairs of particles, or particles and walls, in one simulation.

All contacts are normal to x, at the same x; the collisions are far apart in y and z. There is no gravity.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from granflow import ParticleData, Plan, Scene, plan_for
from granflow.contact.material import PairMaterial
from granflow.contact.registry import models
from granflow.geometry.sphere import sphere_mass
from granflow.scene.schema.run import LARGEST_OVERLAP

if TYPE_CHECKING:
    from granflow import Simulation

LONGEST = 20.0
"""Maximum length of a collision in units of its expected duration; longer collisions count as sticking."""
SPACING = 4.0
"""Spacing of neighboring collisions over the largest diameter."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Golden ratio; its multiples modulo 1 are evenly distributed in the unit interval."""
FORCES_TO_END = 4
"""Number of final forces of a contact that determine its end."""
EARLIEST_END, LATEST_END = -0.5, 1.0
"""Range of the end of a contact after its last force, in steps."""

Settings = Mapping[str, Any]
"""Entries of a block of a scene."""


def duration_given(diameter: float, velocity: float) -> float:
    """Value of run.duration [s]: LONGEST times the travel by a diameter [m] at up to 1 m/s, at most 1 s.

    The bench ends with the last collision; a longer duration of small particles is refused for its number of steps.
    """
    return min(1.0, LONGEST * diameter / min(velocity, 1.0))


@dataclass(frozen=True)
class Collision:
    """One collision of a particle with another particle or with a wall, in SI units.

    first, second:   names of the materials
    radius:          of the first particle
    other_radius:    of the second particle; None for a wall
    velocity:        approach velocity; `share` of it is that of the first particle, 1 toward a wall
    along, spin:     velocity of the first particle along y, and angular velocity about -z; the surface of the particle
                     slides at the velocity along - radius * spin
    first_contact:   time of first contact
    """

    first: str
    second: str
    radius: float
    other_radius: float | None
    velocity: float
    share: float = 0.5
    along: float = 0.0
    spin: float = 0.0
    first_contact: float = 0.0

    def reduced(self, scene: Scene) -> tuple[float, float]:
        """Effective radius [m] and mass [kg]; a wall has infinite radius and mass."""
        mass = sphere_mass(self.radius, scene.materials[self.first].density)
        if self.other_radius is None:
            return self.radius, mass
        other = sphere_mass(self.other_radius, scene.materials[self.second].density)
        radius_eff = self.radius * self.other_radius / (self.radius + self.other_radius)
        return radius_eff, mass * other / (mass + other)


class CollisionBench:
    """Collisions in one simulation; call `free` after use.

    materials, pairs:  blocks of a scene; missing pairs are elastic, because their materials do not touch
    contact, run:      blocks of a scene
    numerics:          additions to this block
    contact_x:         coordinate of all contacts [m]
    arch, threads:     as for Simulation
    Raises:            SceneError if the contact model or the time step is not suitable
    """

    def __init__(
        self, materials: Settings, pairs: Settings, contact: Settings, collisions: Sequence[Collision], run: Settings,
        numerics: Settings = MappingProxyType({}), contact_x: float = 0.0, arch: str = "cpu",
        threads: int | None = None,
    ) -> None:  # fmt: skip
        self.collisions, self._contact_x = collisions, contact_x
        self._arch, self._threads = arch, threads
        self.scene = Scene.from_dict(self._described(materials, pairs, contact, run, numerics))

    @cached_property
    def simulation(self) -> "Simulation":
        """Simulation of the scene."""
        from granflow import Simulation  # imports Taichi, which `granflow check` does not need

        return Simulation(self.scene, arch=self._arch, threads=self._threads)  # type: ignore[arg-type]

    @cached_property
    def plan(self) -> Plan:
        """Plan of the scene."""
        return plan_for(self.scene)

    def pair_of(self, collision: Collision) -> tuple[PairMaterial, float, float, float]:
        """Pair of materials, effective radius [m] and mass [kg], velocity [m/s]: arguments of contact models."""
        pair = self.plan.pair(collision.first, collision.second)
        return pair, *collision.reduced(self.scene), collision.velocity

    @property
    def most_steps(self) -> int:
        """Upper bound of the number of steps until the slowest collision has ended."""
        cases = {(c.first, c.second, c.radius, c.other_radius, c.velocity): c for c in self.collisions}
        longest = max(sum(self.plan.law.phase_durations(*self.pair_of(each))) for each in cases.values())
        approach = max(each.first_contact for each in self.collisions)
        return int((approach + LONGEST * longest) / self.simulation.time_step) + 10

    def restart(self, collisions: Sequence[Collision], time_step: float | None = None) -> None:
        """Replace the collisions by others of the same partners and materials; optionally another time step [s]."""
        self.collisions = collisions
        self.simulation.restart(self._particles()[0], time_step)

    def sample(self) -> np.ndarray:
        """Present overlap [m], overlap rate [m/s] and repulsion [N] (3, n); negative overlaps are gaps."""
        particles = self.simulation.snapshot().particles
        x, rate, force = (particles[name][:, 0].astype(float) for name in ("position", "velocity", "force"))
        radius = particles["radius"].astype(float)
        left, right = self._ids.T
        is_pair = right >= 0
        wall_x = np.where(is_pair, 0.0, self._contact_x)
        overlap = radius[left] + np.where(is_pair, radius[right], 0.0) - (np.where(is_pair, x[right], wall_x) - x[left])
        return np.array([overlap, rate[left] - np.where(is_pair, rate[right], 0.0), -force[left]])

    def run(self, every: int = 1) -> np.ndarray:
        """Samples (samples, 3, n) after every `every` steps, until all partners have separated.

        Collisions that have not ended after the maximum number of steps remain in the result.
        """
        samples, done, limit = [self.sample()], 0, self.most_steps
        has_touched = np.zeros(len(self.collisions), dtype=bool)
        while done < limit:
            self.simulation.step(every)
            done += every
            samples.append(self.sample())
            _, rate, force = samples[-1]
            has_touched |= (force != 0.0) | (rate < 0.0)
            if np.all(has_touched & (force == 0.0) & (rate < 0.0)):
                break
        return np.array(samples)

    def rebound(self) -> np.ndarray:
        """Run until all partners have separated; velocities of separation (n,) [m/s], 0 for partners that stick."""
        _, rate, force = self.run(every=max(self.most_steps // 200, 1))[-1]
        return np.where((force == 0.0) & (rate < 0.0), -rate, 0.0)

    def motions(self) -> tuple[np.ndarray, np.ndarray]:
        """Present velocities [m/s] and angular velocities [rad/s] (n, 2, 3) of both partners; those of walls are 0."""
        particles = self.simulation.snapshot().particles
        both = (particles[name][self._ids].astype(float) for name in ("velocity", "angular_velocity"))
        velocity, spin = (np.where((self._ids >= 0)[:, :, None], each, 0.0) for each in both)
        return velocity, spin

    def free(self) -> None:
        """Free the device memory."""
        self.simulation.free()

    def _described(
        self, materials: Settings, pairs: Settings, contact: Settings, run: Settings, numerics: Settings
    ) -> dict[str, Any]:
        """Scene of all collisions: one group of particles per material, one rectangle per material of walls."""
        used = dict.fromkeys(name for each in self.collisions for name in (each.first, each.second))
        counts = _particle_counts(self.collisions)
        self._names = [name for name in used if counts[name]]
        data, self._ids = self._particles()
        groups = {}
        for number, name in enumerate(self._names):
            mine = data.group == number
            groups[name] = {
                "material": name, "diameter": 2.0 * data.radius[mine], "velocity": data.velocity[mine],
                "angular_velocity": data.angular_velocity[mine],
                "insert": {"kind": "positions", "positions": data.position[mine]},
            }  # fmt: skip
            if not data.angular_velocity.any():
                del groups[name]["angular_velocity"]
        travel = max(abs(each.along) for each in self.collisions) * run["duration"]
        high = np.full(3, np.abs(data.position).max() + travel + self._spacing)
        return {
            "title": "Separate collisions",
            "gravity": [0, 0, 0],
            "materials": {name: materials[name] for name in used},
            "pairs": _all_pairs(self.collisions, pairs, contact),
            "contact": {"tangential": "none", "rolling": "none", **contact},
            "particles": groups,
            "walls": self._walls(),
            "domain": {"min": -high, "max": high, "on_exit": "error"},
            "run": run,
            "numerics": {"max_overlap": LARGEST_OVERLAP, **numerics},
            "output": {"interval": run["duration"]},
        }

    def _particles(self) -> tuple[ParticleData, np.ndarray]:
        """All particles, sorted by material, and the ids (n, 2) of the partners of each collision; -1 for a wall."""
        rows = []
        for index, (each, place) in enumerate(zip(self.collisions, self._places(), strict=True)):
            radii = (each.radius, each.other_radius)
            shares = (each.share, each.share - 1.0)
            for side, (name, radius, share) in enumerate(zip((each.first, each.second), radii, shares, strict=True)):
                if radius is not None:
                    speed = share * each.velocity
                    x = self._contact_x + (radius if side else -radius) - speed * each.first_contact
                    motion = (0.0, 0.0) if side else (each.along, -each.spin)
                    rows.append((self._names.index(name), index, side, radius, x, *place, speed, *motion))
        table = np.array(sorted(rows, key=lambda row: row[0]))
        ids = np.full((len(self.collisions), 2), -1)
        ids[table[:, 1].astype(int), table[:, 2].astype(int)] = np.arange(len(table))
        group, zeros = table[:, 0].astype(np.int32), np.zeros(len(table))
        velocity = np.stack([table[:, 7], table[:, 8], zeros], axis=1)
        spin = np.stack([zeros, zeros, table[:, 9]], axis=1)
        return ParticleData(table[:, 4:7], velocity, spin, table[:, 3], group, group), ids

    @property
    def _spacing(self) -> float:
        """Distance of neighboring collisions [m]."""
        return SPACING * 2.0 * max(max(each.radius, each.other_radius or 0.0) for each in self.collisions)

    def _blocks(self) -> Iterable[tuple[str | None, np.ndarray, int, int, int]]:
        """Collisions in blocks: material of the wall or None, indices, first row (z), columns (y) and rows.

        Particles that move along y have one column.
        """
        partners = [each.second if each.other_radius is None else None for each in self.collisions]
        row, moves = 0, any(each.along for each in self.collisions)
        for partner in dict.fromkeys(partners):
            indices = np.array([index for index, each in enumerate(partners) if each == partner])
            columns = 1 if moves else int(np.ceil(np.sqrt(len(indices))))
            rows = -(-len(indices) // columns)
            yield partner, indices, row, columns, rows
            row += rows

    def _places(self) -> np.ndarray:
        """Coordinates y and z (n, 2) [m] of the collisions."""
        places = np.zeros((len(self.collisions), 2))
        for _, indices, row, columns, _ in self._blocks():
            z, y = np.divmod(np.arange(len(indices)), columns)
            places[indices] = self._spacing * np.stack([y, row + z], axis=1)
        return places

    def _walls(self) -> dict[str, Any]:
        """Walls: a rectangle at each block of collisions with a wall, or a plane if there are no other collisions."""
        blocks, spacing = list(self._blocks()), self._spacing
        if len(blocks) == 1 and blocks[0][0] is not None:
            plane = {"shape": "plane", "point": [self._contact_x, 0, 0], "normal": [-1, 0, 0]}
            return {"wall": plane | {"material": blocks[0][0]}}
        return {
            f"wall_{material}": {
                "shape": "rectangle", "material": material,
                "corner": [self._contact_x, -0.5 * spacing, (row - 0.5) * spacing],
                "sides": [[0.0, columns * spacing, 0.0], [0.0, 0.0, rows * spacing]],
            }
            for material, _, row, columns, rows in blocks if material is not None
        }  # fmt: skip


def _particle_counts(collisions: Sequence[Collision]) -> Counter[str]:
    """Number of particles of each material."""
    seconds = (each.second for each in collisions if each.other_radius is not None)
    return Counter([*(each.first for each in collisions), *seconds])


def _all_pairs(collisions: Sequence[Collision], pairs: Settings, contact: Settings) -> dict[str, Any]:
    """Given entries, and those of other materials, which a scene requires although their particles do not touch."""
    elastic: dict[str, Any] = {"friction": 0.0, "restitution": 1.0}
    normal = contact["normal"]
    if models("normal")[normal if isinstance(normal, str) else normal["law"]].restitution == "nothing":
        del elastic["restitution"]
    found, counts = {}, _particle_counts(collisions)
    used = dict.fromkeys(name for each in collisions for name in (each.first, each.second))
    for first, second in combinations_with_replacement(used, 2):
        key = f"{second}-{first}" if f"{second}-{first}" in pairs else f"{first}-{second}"
        if key in pairs or first != second or counts[first] > 1:
            found[key] = pairs.get(key, elastic)
    return found
