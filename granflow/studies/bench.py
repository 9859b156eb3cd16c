"""The collision bench: many separate collisions in one simulation, with the kernels of every scene.

All studies of single collisions run here: two spheres, or a sphere and a wall, that approach each other along
x without gravity. All contacts are normal to x and at the same x; the collisions are far apart in y and z, so
that each has only its own contact.

`collide(pairs, law, step)` is the usual entry: it simulates head-on collisions of equal spheres and returns
their `Outcomes`, with one column per result and one row per collision. `CollisionBench` is the bench below
it. It takes the blocks of a scene (`materials`, `pairs`, `contact`, `run`, `numerics`) and a list of
`Collision`, which may have different partners, walls, tangential velocity and spin, and it repeats them with
other time steps. The bench writes no files.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granflow import GranflowError, ParticleData, Plan, Scene, plan_for
from granflow.contact.registry import models
from granflow.plan.restitution import LONGEST, Collision, Impact
from granflow.scene.blocks.run import LARGEST_OVERLAP

if TYPE_CHECKING:
    from granflow import Simulation

Settings = Mapping[str, Any]
"""Entries of a block of a scene."""


# ---------------------------------------------------------------- head-on collisions of equal spheres

GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Golden ratio; its multiples modulo 1 are evenly distributed in the unit interval."""


@dataclass(frozen=True)
class HeadOnCollision:
    """Head-on collision of two equal spheres.

    `material`, `restitution`: as in a scene; `diameter` [m]; `velocity` [m/s]: approach velocity, half of it
    for each sphere.
    """

    material: Settings
    restitution: Any
    diameter: float
    velocity: float

    @property
    def key(self) -> str:
        """Equal for collisions with the same material and restitution."""
        return json.dumps([dict(self.material), self.restitution], sort_keys=True)


@dataclass(frozen=True)
class Outcomes:
    """Results of n collisions, one column (n,) each, and their time series (steps, n).

    A collision begins at first contact and ends when the force vanishes; both times are interpolated within a
    step. Partners that do not separate have restitution 0 and duration nan.
    """

    restitution: np.ndarray
    duration: np.ndarray
    """Time in contact [s]."""
    overlap_max: np.ndarray
    """Largest overlap [m] of all steps."""
    overlap_residual: np.ndarray
    """Overlap at which the force vanishes [m]."""
    force_max: np.ndarray
    """Largest repulsion [N] of all steps."""
    stored_energy: np.ndarray
    """Work done on the contact up to the maximum overlap [J]."""
    time_step: float
    """Time step of all collisions [s]."""
    overlap: np.ndarray
    """Overlap [m] after each step; negative for a gap."""
    force: np.ndarray
    """Repulsion [N] after each step."""


def collide(
    pairs: Sequence[HeadOnCollision], law: Any, step: float, arch: str = "cpu", precision: str = "f64"
) -> Outcomes:
    """Simulate head-on collisions of equal spheres without friction.

    `law`: entry `contact.normal` of a scene; `step`: time step [s] of all collisions. Their times of first
    contact are evenly distributed over the phases of a step.

    Raises SceneError if the contact model or the time step is not suitable, GranflowError if a pair never
    touches.
    """
    first_contact = step * (GOLDEN * np.arange(len(pairs)) % 1.0)
    with head_on_bench(pairs, law, step, first_contact, arch=arch, precision=precision) as bench:
        return bench.collide()


def head_on_bench(
    pairs: Sequence[HeadOnCollision],
    law: Any,
    step: Any,
    first_contact: np.ndarray,
    *,
    arch: str = "cpu",
    precision: str = "f64",
    threads: int | None = None,
    contact_x: float = 0.0,
    velocity_max: float | None = None,
    numerics: Settings = MappingProxyType({}),
) -> "CollisionBench":
    """Bench with head-on collisions of equal spheres; the materials are m0, m1, ...

    `step`: time step [s], or "auto"; `first_contact` (n,): times of first contact [s]. The plan assumes
    `velocity_max` [m/s], by default the largest velocity. Other arguments as for CollisionBench.
    """
    names = {key: f"m{number}" for number, key in enumerate(dict.fromkeys(each.key for each in pairs))}
    materials = {names[each.key]: each for each in pairs}
    collisions = []
    for each, time in zip(pairs, first_contact, strict=True):
        name = names[each.key]
        radius = 0.5 * each.diameter
        collisions.append(Collision(name, name, radius, radius, each.velocity, first_contact=float(time)))
    return CollisionBench(
        materials={name: each.material for name, each in materials.items()},
        pairs={f"{name}-{name}": _pair_entry(each.restitution) for name, each in materials.items()},
        contact={"normal": law},
        collisions=collisions,
        run={
            "duration": min(run_duration(each.diameter, each.velocity) for each in pairs),
            "time_step": step,
            "precision": precision,
            "velocity_max": velocity_max or max(each.velocity for each in pairs),
        },
        numerics=numerics,
        contact_x=contact_x,
        arch=arch,
        threads=threads,
    )


def _pair_entry(restitution: Any) -> dict[str, Any]:
    """Entry of `pairs`; None for a restitution that the contact model derives from the materials."""
    if restitution is None:
        return {"friction": 0}
    return {"friction": 0, "restitution": restitution}


# ---------------------------------------------------------------- the bench

SPACING = 4.0
"""Spacing of neighboring collisions over the largest diameter."""
REBOUND_SAMPLES = 200
"""Number of samples of `CollisionBench.rebound` in the maximum time of its collisions."""


def run_duration(diameter: float, velocity: float) -> float:
    """Value of run.duration [s]: LONGEST times the travel by a diameter [m] at up to 1 m/s, at most 1 s.

    The bench ends with the last collision; a longer duration of small particles is refused for its number of
    steps.
    """
    return min(1.0, LONGEST * diameter / min(velocity, 1.0))


class _Partner(NamedTuple):
    """A sphere of a collision: index of its material and of the collision, side (0 or 1), and its state."""

    group: int
    collision: int
    side: int
    radius: float
    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    angular_velocity: tuple[float, float, float]


class _Block(NamedTuple):
    """Collisions with the same wall, on a grid of `columns` (y) by `rows` (z) that begins at a row."""

    wall: str | None
    """Material of the wall; None for collisions of two spheres."""
    indices: np.ndarray
    """Indices of the collisions."""
    first_row: int
    columns: int
    rows: int


class CollisionBench:
    """Collisions in one simulation. As a context manager, the bench frees the device memory at the end.

    `collide` records every step and returns all results; `rebound` returns the velocities of separation only,
    with few samples; `run` returns the samples themselves. After each, `motions` returns the velocities and
    spins of all partners. The simulation is then used up: `restart` places the partners again.

    materials, pairs:  blocks of a scene; missing pairs are elastic, because their materials do not touch
    contact, run:      blocks of a scene
    numerics:          additions to this block
    contact_x:         coordinate of all contacts [m]
    arch, threads:     as for Simulation
    Raises:            SceneError if the contact model or the time step is not suitable
    """

    def __init__(
        self,
        materials: Settings,
        pairs: Settings,
        contact: Settings,
        collisions: Sequence[Collision],
        run: Settings,
        numerics: Settings = MappingProxyType({}),
        contact_x: float = 0.0,
        arch: str = "cpu",
        threads: int | None = None,
    ) -> None:
        self.collisions = collisions
        self._contact_x = contact_x
        self._arch = arch
        self._threads = threads
        self.scene = Scene.from_dict(self._described(materials, pairs, contact, run, numerics))

    def __enter__(self) -> "CollisionBench":
        return self

    def __exit__(self, *_: object) -> None:
        self.free()

    @cached_property
    def plan(self) -> Plan:
        """Plan of the scene."""
        return plan_for(self.scene)

    @cached_property
    def simulation(self) -> "Simulation":
        """Simulation of the scene."""
        from granflow import Simulation  # imports Taichi, which `granflow check` does not need

        return Simulation(self.scene, arch=self._arch, threads=self._threads)  # type: ignore[arg-type]

    def impact_of(self, collision: Collision) -> Impact:
        """Arguments of contact models for a collision."""
        pair = self.plan.pair(collision.first, collision.second)
        return pair, *collision.reduced(self.scene), collision.velocity

    @property
    def most_steps(self) -> int:
        """Upper bound of the number of steps until the slowest collision has ended."""
        cases = {(c.first, c.second, c.radius, c.other_radius, c.velocity): c for c in self.collisions}
        longest = max(
            sum(self.plan.laws.normal.phase_durations(*self.impact_of(each))) for each in cases.values()
        )
        approach = max(each.first_contact for each in self.collisions)
        return int((approach + LONGEST * longest) / self.simulation.time_step) + 10

    def restart(self, collisions: Sequence[Collision], time_step: float | None = None) -> None:
        """Replace the collisions by others of the same partners and materials; optionally another time step
        [s]."""
        self.collisions = collisions
        self.simulation.restart(self._particles()[0], time_step)

    def free(self) -> None:
        """Free the device memory, if a simulation has begun."""
        if "simulation" in self.__dict__:
            self.simulation.free()

    # Running and sampling.

    def collide(self) -> Outcomes:
        """Run the collisions until all partners have separated, and measure them.

        Raises GranflowError if a pair never touches.
        """
        overlap, rate, force = np.moveaxis(self.run(), 1, 0)
        if missing := int(np.sum(~np.any(force != 0.0, axis=0))):
            raise GranflowError(
                f"{missing} of {len(self.collisions)} pairs have not touched within {len(force)} steps."
            )
        time_step = self.simulation.time_step
        series = zip(self.collisions, overlap.T, rate.T, force.T, strict=True)
        columns = np.array([_measured(*each, time_step) for each in series]).T
        return Outcomes(*columns, time_step, overlap, force)  # type: ignore[call-arg]

    def rebound(self) -> np.ndarray:
        """Run until all partners have separated; velocities of separation (n,) [m/s], 0 for partners that
        stick."""
        _, rate, force = self.run(every=max(self.most_steps // REBOUND_SAMPLES, 1))[-1]
        return np.where((force == 0.0) & (rate < 0.0), -rate, 0.0)

    def run(self, every: int = 1) -> np.ndarray:
        """Samples (samples, 3, n) after every `every` steps, until all partners have separated.

        Collisions that have not ended after the maximum number of steps remain in the result.
        """
        samples = [self.sample()]
        done = 0
        limit = self.most_steps
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

    def sample(self) -> np.ndarray:
        """Present overlap [m], overlap rate [m/s] and repulsion [N] (3, n); negative overlaps are gaps."""
        particles = self.simulation.snapshot().particles
        x, rate, force = (particles[name][:, 0].astype(float) for name in ("position", "velocity", "force"))
        radius = particles["radius"].astype(float)
        left, right = self._ids.T
        is_pair = right >= 0
        wall_x = np.where(is_pair, 0.0, self._contact_x)
        overlap = (
            radius[left]
            + np.where(is_pair, radius[right], 0.0)
            - (np.where(is_pair, x[right], wall_x) - x[left])
        )
        return np.array([overlap, rate[left] - np.where(is_pair, rate[right], 0.0), -force[left]])

    def motions(self) -> tuple[np.ndarray, np.ndarray]:
        """Present velocities [m/s] and angular velocities [rad/s] (n, 2, 3) of both partners; those of walls
        are 0."""
        particles = self.simulation.snapshot().particles
        is_sphere = (self._ids >= 0)[:, :, None]
        velocity = np.where(is_sphere, particles["velocity"][self._ids].astype(float), 0.0)
        spin = np.where(is_sphere, particles["angular_velocity"][self._ids].astype(float), 0.0)
        return velocity, spin

    # The scene: one group of particles per material, and one wall per material of walls.

    def _described(
        self, materials: Settings, pairs: Settings, contact: Settings, run: Settings, numerics: Settings
    ) -> dict[str, Any]:
        """Scene of all collisions."""
        used = _materials_of(self.collisions)
        counts = _particle_counts(self.collisions)
        self._names = [name for name in used if counts[name]]
        data, self._ids = self._particles()
        groups = {}
        for number, name in enumerate(self._names):
            mine = data.group == number
            groups[name] = {
                "material": name,
                "diameter": 2.0 * data.radius[mine],
                "velocity": data.velocity[mine],
                "insert": {"kind": "positions", "positions": data.position[mine]},
            }
            if data.angular_velocity.any():
                groups[name]["angular_velocity"] = data.angular_velocity[mine]
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
        """All particles, sorted by material, and the ids (n, 2) of the partners of each collision; -1 for a
        wall."""
        partners = sorted(self._partners(), key=lambda each: each.group)
        ids = np.full((len(self.collisions), 2), -1)
        for number, each in enumerate(partners):
            ids[each.collision, each.side] = number
        group = np.array([each.group for each in partners], dtype=np.int32)
        data = ParticleData(
            position=np.array([each.position for each in partners]),
            velocity=np.array([each.velocity for each in partners]),
            angular_velocity=np.array([each.angular_velocity for each in partners]),
            radius=np.array([each.radius for each in partners]),
            material=group,
            group=group,
        )
        return data, ids

    def _partners(self) -> Iterable[_Partner]:
        """The spheres of all collisions, at the distance that they cover until the time of first contact."""
        for index, (each, place) in enumerate(zip(self.collisions, self._places(), strict=True)):
            y, z = (float(coordinate) for coordinate in place)
            group = self._names.index(each.first)
            speed = each.share * each.velocity
            x = self._contact_x - each.radius - speed * each.first_contact
            velocity = (speed, each.along, 0.0)
            yield _Partner(group, index, 0, each.radius, (x, y, z), velocity, (0.0, 0.0, -each.spin))
            if each.other_radius is not None:
                group = self._names.index(each.second)
                speed = (each.share - 1.0) * each.velocity
                x = self._contact_x + each.other_radius - speed * each.first_contact
                velocity = (speed, 0.0, 0.0)
                yield _Partner(group, index, 1, each.other_radius, (x, y, z), velocity, (0.0, 0.0, 0.0))

    @property
    def _spacing(self) -> float:
        """Distance of neighboring collisions [m]."""
        return SPACING * 2.0 * max(max(each.radius, each.other_radius or 0.0) for each in self.collisions)

    def _blocks(self) -> Iterable[_Block]:
        """The collisions, in blocks one above the other; spheres that move along y have one column."""
        walls = [each.second if each.other_radius is None else None for each in self.collisions]
        first_row = 0
        moves = any(each.along for each in self.collisions)
        for wall in dict.fromkeys(walls):
            indices = np.array([index for index, each in enumerate(walls) if each == wall])
            columns = 1 if moves else int(np.ceil(np.sqrt(len(indices))))
            rows = -(-len(indices) // columns)
            yield _Block(wall, indices, first_row, columns, rows)
            first_row += rows

    def _places(self) -> np.ndarray:
        """Coordinates y and z (n, 2) [m] of the collisions."""
        places = np.zeros((len(self.collisions), 2))
        for block in self._blocks():
            z, y = np.divmod(np.arange(len(block.indices)), block.columns)
            places[block.indices] = self._spacing * np.stack([y, block.first_row + z], axis=1)
        return places

    def _walls(self) -> dict[str, Any]:
        """Walls: a rectangle at each block of collisions with a wall, or a plane if there are no other
        collisions."""
        blocks = list(self._blocks())
        spacing = self._spacing
        if len(blocks) == 1 and blocks[0].wall is not None:
            plane = {"shape": "plane", "point": [self._contact_x, 0, 0], "normal": [-1, 0, 0]}
            return {"wall": plane | {"material": blocks[0].wall}}
        return {
            f"wall_{block.wall}": {
                "shape": "rectangle",
                "material": block.wall,
                "corner": [self._contact_x, -0.5 * spacing, (block.first_row - 0.5) * spacing],
                "sides": [[0.0, block.columns * spacing, 0.0], [0.0, 0.0, block.rows * spacing]],
            }
            for block in blocks
            if block.wall is not None
        }


def _materials_of(collisions: Sequence[Collision]) -> list[str]:
    """Names of all materials, in the order of their first use."""
    return list(dict.fromkeys(name for each in collisions for name in (each.first, each.second)))


def _particle_counts(collisions: Sequence[Collision]) -> Counter[str]:
    """Number of particles of each material."""
    seconds = (each.second for each in collisions if each.other_radius is not None)
    return Counter([*(each.first for each in collisions), *seconds])


def _all_pairs(collisions: Sequence[Collision], pairs: Settings, contact: Settings) -> dict[str, Any]:
    """Given entries, and those of other materials, which a scene requires although their particles do not
    touch."""
    elastic: dict[str, Any] = {"friction": 0.0, "restitution": 1.0}
    normal = contact["normal"]
    if models("normal")[normal if isinstance(normal, str) else normal["law"]].restitution == "nothing":
        del elastic["restitution"]
    found = {}
    counts = _particle_counts(collisions)
    for first, second in combinations_with_replacement(_materials_of(collisions), 2):
        key = f"{second}-{first}" if f"{second}-{first}" in pairs else f"{first}-{second}"
        if key in pairs or first != second or counts[first] > 1:
            found[key] = pairs.get(key, elastic)
    return found


# ---------------------------------------------------------------- measurement of one collision

FORCES_TO_END = 4
"""Number of final forces of a contact that determine its end."""
EARLIEST_END, LATEST_END = -0.5, 1.0
"""Range of the end of a contact after its last force, in steps."""


def _measured(
    collision: Collision, overlap: np.ndarray, rate: np.ndarray, force: np.ndarray, time_step: float
) -> tuple[float, ...]:
    """Columns of `Outcomes` for one collision, in their order, from its time series.

    `overlap` [m], `rate` [m/s], `force` [N] (steps,); `time_step` [s].
    """
    peak = int(np.argmax(overlap))
    last = int(np.flatnonzero(force)[-1])
    overlap_max = float(overlap[peak])
    force_max = float(force.max())
    work = 0.5 * float((force[1 : peak + 1] + force[:peak]) @ np.diff(overlap[: peak + 1]))
    if last + 1 == len(force):
        return 0.0, np.nan, overlap_max, float(overlap[last]), force_max, work
    share = share_to_end(force[last - 3 : last + 1], overlap[last : last + 2])
    restitution = float(-rate[last + 1] / collision.velocity)
    duration = (last + share) * time_step - collision.first_contact
    residual = overlap[last] + share * (overlap[last + 1] - overlap[last])
    return restitution, duration, overlap_max, residual, force_max, work


def share_to_end(force: np.ndarray, overlap: np.ndarray) -> float:
    """Fraction s of a step from the last force to the time at which the force vanishes; may be negative.

    Extrapolates the three forces before the last with F = a t + b t^1.5 at the times t = s + 1, s + 2, s + 3
    before the end: exact for a linear spring, a Hertz contact, and their sum. The last force may be a mean
    over a step that extends beyond the end. A contact under tension ends at zero overlap.

    `force` (FORCES_TO_END,) [N]: last forces; `overlap` (2,) [m]: at the last force and one step later.
    """
    from scipy.optimize import brentq

    if force[-1] < 0.0:
        return float(np.clip(overlap[0] / (overlap[0] - overlap[1]), 0.0, 1.0))
    if not (len(force) == FORCES_TO_END and force[0] > force[1] > force[2]):
        return 0.0

    def mismatch(share: float) -> float:
        times = share + np.array([3.0, 2.0, 1.0])
        return float(np.linalg.det(np.stack([force[:3], times, times**1.5])))

    if mismatch(EARLIEST_END) * mismatch(LATEST_END) > 0.0:
        return LATEST_END
    return float(brentq(mismatch, EARLIEST_END, LATEST_END, xtol=1e-15))
