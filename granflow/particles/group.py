"""One particle group of a scene, with what its particles need of other parts of the scene."""

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import log, sqrt
from pathlib import Path
from statistics import NormalDist

import numpy as np

from granflow.arguments import shown
from granflow.errors import GranflowError
from granflow.geometry.clump import about, random_orientations
from granflow.particles.packing import RegionFullError
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.particles import (
    ClassSizes,
    Clump,
    Group,
    LogNormalSizes,
    NormalSizes,
    SizeSpec,
    ThermalMotion,
    UniformSizes,
)
from granflow.scene.blocks.scene import SceneInput


@dataclass(frozen=True)
class SceneGroup:
    """A group of a scene.

    name, number:     name in the scene, and index among its groups
    spec:             entry of `particles`
    material_number:  index of its material in the scene
    density:          of its material [kg/m3]
    seed:             seed of the scene
    folder:           folder to which its file is relative
    domain:           domain of the scene
    locate:           function (*keys below the group) -> position in the scene file, for messages
    is_given:         function (key) -> whether the scene file contains the key
    """

    name: str
    number: int
    spec: Group
    material_number: int
    density: float
    seed: int
    folder: Path
    domain: Domain
    locate: Callable[..., str]
    is_given: Callable[..., bool]

    @property
    def seeds(self) -> tuple[int, int]:
        """Seeds of the group: that of the scene, and the platform-independent CRC-32 of its name."""
        return self.seed, zlib.crc32(self.name.encode())

    def random(self) -> np.random.Generator:
        """The random number generator of the group (PCG64), independent of all other groups and of their
        order."""
        return np.random.default_rng(np.random.SeedSequence(self.seeds))

    def velocity_random(self) -> np.random.Generator:
        """The generator of random velocities, which do not change sizes and positions."""
        return np.random.default_rng(np.random.SeedSequence((*self.seeds, 1)))

    def orientation_random(self, batch: int) -> np.random.Generator:
        """The generator of random orientations of a batch of clumps."""
        return np.random.default_rng(np.random.SeedSequence((*self.seeds, 2, batch)))

    @property
    def particle_mass(self) -> float | None:
        """Mass [kg] of each clump; None for spheres."""
        return None if self.spec.clump is None else self.density * self.spec.clump.shape.volume


def groups_of(scene: SceneInput) -> dict[str, SceneGroup]:
    """The groups of a scene by name."""
    materials = list(scene.materials)
    return {
        name: SceneGroup(
            name,
            number,
            spec,
            materials.index(spec.material),
            scene.materials[spec.material].density,
            scene.seed,
            scene.folder,
            scene.domain,
            partial(scene.locate, "particles", name),
            partial(scene.is_given, "particles", name),
        )
        for number, (name, spec) in enumerate(scene.particles.items())
    }


# Sampling of diameters from the size distributions of the scene.
#
# Numbers of particles, not masses, follow the distribution, except for classes with fractions by mass.

MAX_COUNTED = 10_000_000
"""Largest count that is derived from a mass by summation; larger counts follow from the mean of a sample."""
SAMPLE = 10_000
"""Number of diameters in a sample from which the mean cube is estimated."""


def draw_diameters(sizes: SizeSpec, count: int, random: np.random.Generator) -> np.ndarray:
    """Exactly `count` diameters (count,) [m] in random order; a list keeps its order.

    Normal and log-normal distributions are truncated: values beyond the limits are excluded, not clamped. A
    single diameter is repeated. Classes have the exact number of `class_counts`. float64.
    """
    if isinstance(sizes, ClassSizes):
        diameter = np.array([each.diameter for each in sizes.classes])
        return random.permutation(np.repeat(diameter, class_counts(sizes, count)))
    if isinstance(sizes, UniformSizes):
        return random.uniform(sizes.min, sizes.max, count)
    if isinstance(sizes, NormalSizes):
        return truncated_normal(NormalDist(sizes.mean, sizes.deviation), sizes.min, sizes.max, count, random)
    if isinstance(sizes, LogNormalSizes):
        logarithm = NormalDist(math.log(sizes.median), sizes.sigma)
        low, high = math.log(sizes.min), math.log(sizes.max)
        drawn = np.exp(truncated_normal(logarithm, low, high, count, random))
        return np.clip(drawn, sizes.min, sizes.max)  # exp(log(max)) may round to beyond max
    return np.broadcast_to(np.asarray(sizes, dtype=np.float64), (count,)).copy()


def count_for_volume(sizes: SizeSpec, cubes: float, random: Callable[[], np.random.Generator]) -> int:
    """Number of diameters from `draw_diameters` whose sum of cubes is nearest to `cubes` [m3]; at least 1.

    `random` returns a new generator with the seed of the later draw at each call, so that the sum is that of
    the later particles. Above MAX_COUNTED particles, and for one size, the count follows from the mean cube.
    """
    if isinstance(sizes, ClassSizes):
        return max(round(min(cubes / mean_cube(sizes), 1e18)), 1)
    sample = draw_diameters(sizes, SAMPLE, random())
    guess = min(cubes / float(np.mean(sample**3)), 1e18)
    if guess > MAX_COUNTED or isinstance(sizes, float):
        return max(round(guess), 1)
    total = np.cumsum(draw_diameters(sizes, int(1.5 * guess) + SAMPLE, random()) ** 3)
    return int(np.abs(total - cubes).argmin()) + 1


def mean_cube(sizes: ClassSizes) -> float:
    """Mean cube of the diameter of size classes, weighted by number [m3]."""
    share = number_shares(sizes)
    return float(share @ np.array([each.diameter for each in sizes.classes]) ** 3)


def number_shares(sizes: ClassSizes) -> np.ndarray:
    """Number fractions (k,) of the classes, with the sum 1.

    Mass fractions w of classes with diameter d are converted by n ~ w / d^3.
    """
    share = np.array([each.fraction for each in sizes.classes])
    if sizes.by == "mass":
        share = share / np.array([each.diameter for each in sizes.classes]) ** 3
    return np.asarray(share / share.sum())


def ordered_diameters(sizes: SizeSpec, count: int, random: np.random.Generator) -> np.ndarray:
    """Diameters (count,) [m] in the order of insertion; classes alternate, so that their fractions are
    constant.

    Particle j of the n particles of a class is at the fraction (j + 1/2) / n of the sequence.
    """
    if not isinstance(sizes, ClassSizes):
        return draw_diameters(sizes, count, random)
    counts = class_counts(sizes, count)
    rank = np.concatenate([(np.arange(n) + 0.5) / n for n in counts if n])
    diameter = np.repeat([each.diameter for each in sizes.classes], counts)
    return diameter[np.argsort(rank, kind="stable")]


def truncated_normal(
    normal: NormalDist, low: float, high: float, count: int, random: np.random.Generator
) -> np.ndarray:
    """Values (count,) of a normal distribution truncated to [low, high].

        x = F^-1(u),      u uniform in [F(low), F(high)]

    F: distribution function of `normal`. One uniform number per value, so that no value is rejected.
    """
    share = random.uniform(normal.cdf(low), normal.cdf(high), count)
    inside = np.clip(
        share, np.finfo(float).tiny, 1 - np.finfo(float).epsneg
    )  # inv_cdf is undefined at 0 and 1
    drawn = np.fromiter(map(normal.inv_cdf, inside.tolist()), dtype=np.float64, count=count)
    return np.clip(drawn, low, high)


def class_counts(sizes: ClassSizes, count: int) -> np.ndarray:
    """Number of particles (k,) of each class: integers with the sum `count`, by the largest-remainder
    method."""
    exact = count * number_shares(sizes)
    whole = np.floor(exact).astype(np.int64)
    largest_remainders = np.argsort(whole - exact, kind="stable")
    whole[largest_remainders[: count - whole.sum()]] += 1
    return whole


# Random initial velocities with the Maxwell distribution.

EXCEEDED = 1e-3
"""Approximate probability that any particle of a group is faster than `largest_speed`."""


def thermal_velocities(thermal: ThermalMotion, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Velocities (n, 3) [m/s] of particles of one density with radii (n,) [m]: normal components, scaled to
    the rms.

    u <- u - sum m u / sum m    (zero_momentum)        u <- u rms / sqrt(sum u^2 / n)
    """
    velocity = random.standard_normal((len(radius), 3))
    if thermal.zero_momentum:
        weight = radius**3
        velocity -= weight @ velocity / weight.sum()
    return velocity * (thermal.rms / np.sqrt((velocity**2).sum() / len(radius)))


def largest_speed(thermal: ThermalMotion, count: int) -> float:
    """Speed [m/s] that the random velocities of `count` particles hardly exceed: rms / sqrt(3) sqrt(2 ln(n /
    p))."""
    return min(thermal.rms / sqrt(3.0) * sqrt(2.0 * log(count / EXCEEDED)), thermal.rms * sqrt(count))


# Data of new particles, and helper functions of all generators.


@dataclass(frozen=True)
class ParticleData:
    """Arrays of n new particles.

    `position` (n, 3) [m], `velocity` (n, 3) [m/s], `angular_velocity` (n, 3) [rad/s], `radius` (n,) [m], all
    float64; `material` (n,) int32 index into list(scene.materials), `group` (n,) int32 index into
    list(scene.particles). `orientation` (n, 4): unit quaternions (w, x, y, z) by which clumps are turned;
    None without clumps. The position of a clump is its center of mass, its radius that of the sphere around
    it.

    >>> import numpy as np
    >>> vectors, numbers = np.zeros((1, 3)), np.zeros(1, dtype=np.int32)
    >>> len(gf.ParticleData(vectors, vectors, vectors, np.full(1, 0.002), numbers, numbers))
    1
    """

    position: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    radius: np.ndarray
    material: np.ndarray
    group: np.ndarray
    orientation: np.ndarray | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.radius)
        vectors = ("position", "velocity", "angular_velocity")
        expected = dict.fromkeys(("radius", "material", "group"), shape) | dict.fromkeys(vectors, (*shape, 3))
        for name, wanted in expected.items():
            values = getattr(self, name)
            if not isinstance(values, np.ndarray) or values.dtype.kind not in "iuf" or len(shape) != 1:
                raise GranflowError(
                    f"ParticleData: {name} is {shown(values)}, but must be an array of numbers."
                )
            if values.shape != wanted:
                raise GranflowError(
                    f"ParticleData: {name} has the shape {values.shape}, but must have {wanted}, as radius "
                    f"has {shape}."
                )

    def __len__(self) -> int:
        return len(self.radius)

    @classmethod
    def joined(cls, parts: Sequence["ParticleData"]) -> "ParticleData":
        """Concatenation of all parts in order; no particles without parts."""
        if not parts:
            empty = np.empty(0)
            empty_vectors = np.empty((0, 3))
            empty_numbers = np.empty(0, dtype=np.int32)
            return cls(empty_vectors, empty_vectors, empty_vectors, empty, empty_numbers, empty_numbers)
        names = [name for name in cls.__dataclass_fields__ if name != "orientation"]
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(**arrays, orientation=_joined_orientations(parts))


def _joined_orientations(parts: Sequence[ParticleData]) -> np.ndarray | None:
    """Orientations (n, 4) of all parts; spheres have that of the given positions. None without clumps."""
    if all(part.orientation is None for part in parts):
        return None
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    return np.concatenate(
        [
            np.tile(identity, (len(part), 1)) if part.orientation is None else part.orientation
            for part in parts
        ]
    )


def particles_of(group: SceneGroup, position: np.ndarray, radius: np.ndarray, batch: int = 0) -> ParticleData:
    """Particles of one group at centers (n, 3) [m] with radii (n,) [m], and the motion and material of the
    group.

    A single velocity [m/s] or angular velocity [rad/s] of the group applies to all particles. `batch`: number
    of the batch of an insertion, for random orientations.
    """
    count = len(radius)
    velocity = np.asarray(group.spec.velocity, dtype=np.float64)
    if group.spec.thermal is not None:
        velocity = velocity + thermal_velocities(group.spec.thermal, radius, group.velocity_random())
    return ParticleData(
        position=position,
        velocity=np.broadcast_to(velocity, (count, 3)).copy(),
        angular_velocity=np.broadcast_to(
            np.asarray(group.spec.angular_velocity, dtype=np.float64), (count, 3)
        ).copy(),
        radius=radius,
        material=np.full(count, group.material_number, dtype=np.int32),
        group=np.full(count, group.number, dtype=np.int32),
        orientation=None
        if group.spec.clump is None
        else orientations(group.spec.clump, count, partial(group.orientation_random, batch)),
    )


def orientations(clump: Clump, count: int, random: Callable[[], np.random.Generator]) -> np.ndarray:
    """Orientations (count, 4) of new clumps; `random`: creates the generator of random orientations."""
    if clump.orientation is None:
        return np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    if clump.orientation == "random":
        return random_orientations(count, random())
    rotations = clump.orientation if isinstance(clump.orientation, tuple) else (clump.orientation,)
    turns = about(np.array([each.axis for each in rotations]), np.array([each.angle for each in rotations]))
    return np.broadcast_to(turns, (count, 4)).copy()


def shortfall(group: SceneGroup, error: RegionFullError) -> str:
    """Error message for a group that does not fit, with the source position of its count."""
    where = "face" if group.spec.insert.kind == "inlet" else "region"
    return (
        f"{group.locate('count')}: particles.{group.name}.count is {group.spec.count}, but "
        f"{error.shortfall} in its {where}. {error.remedy}"
    )
