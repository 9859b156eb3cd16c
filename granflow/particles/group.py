"""A group of particles of a scene, and the arrays of its new particles.

`SceneGroup` is a group with its scene, for what its particles need of other parts, and with its random number
generators. `particles_of` gives particles at given centers the motion, material and orientation of their
group.
"""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from granflow.arguments import shown
from granflow.errors import GranflowError
from granflow.geometry.packing import RegionFullError
from granflow.scene.blocks.materials import Material
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.scene import SceneInput


@dataclass(frozen=True)
class SceneGroup:
    """A group of a scene: the scene, its name there, and its index among the groups."""

    scene: SceneInput
    name: str
    number: int

    @property
    def spec(self) -> Group:
        """Its record in the scene, the entry of `particles`."""
        return self.scene.particles[self.name]

    @property
    def material_number(self) -> int:
        """Index of its material in the scene."""
        return list(self.scene.materials).index(self.spec.material)

    @property
    def material(self) -> Material:
        """Its material."""
        return self.scene.materials[self.spec.material]

    @property
    def density(self) -> float:
        """Density [kg/m3] of its material."""
        return self.material.density

    def locate(self, *keys: str | int) -> str:
        """Position of a key below the group in the scene file, for messages."""
        return self.scene.locate("particles", self.name, *keys)

    def is_given(self, key: str) -> bool:
        """Whether the scene file contains a key of the group."""
        return self.scene.is_given("particles", self.name, key)

    @property
    def seeds(self) -> tuple[int, int]:
        """Seeds of the group: that of the scene, and the platform-independent CRC-32 of its name."""
        return self.scene.seed, zlib.crc32(self.name.encode())

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


def groups_of(scene: SceneInput) -> dict[str, SceneGroup]:
    """The groups of a scene by name."""
    return {name: SceneGroup(scene, name, number) for number, name in enumerate(scene.particles)}


@dataclass(frozen=True)
class ParticleData:
    """Arrays of n new particles.

    `position` (n, 3) [m], `velocity` (n, 3) [m/s], `angular_velocity` (n, 3) [rad/s], `radius` (n,) [m], all
    float64; `material` (n,) int32 index into list(scene.materials), `group` (n,) int32 index into
    list(scene.particles). `orientation` (n, 4): unit quaternions (w, x, y, z) by which clumps are turned;
    None without clumps. The position of a clump is its center of mass, its radius that of the sphere around
    it. `initial_values`: arrays (n,) of properties that particle equations change, such as temperature, by
    name; NaN, or a property without an array, is the value of the group.

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
    initial_values: Mapping[str, np.ndarray] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        shape = np.shape(self.radius)
        vectors = ("position", "velocity", "angular_velocity")
        expected = dict.fromkeys(("radius", "material", "group"), shape) | dict.fromkeys(vectors, (*shape, 3))
        if self.orientation is not None:
            expected["orientation"] = (*shape, 4)
        expected |= dict.fromkeys(self.initial_values, shape)
        for name, wanted in expected.items():
            values = self.initial_values[name] if name in self.initial_values else getattr(self, name)
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

    def chosen(self, rows: np.ndarray) -> "ParticleData":
        """The particles of some rows, given as indices or as a mask (n,)."""
        names = [name for name in self.__dataclass_fields__ if name not in ("orientation", "initial_values")]
        return ParticleData(
            **{name: getattr(self, name)[rows] for name in names},
            orientation=None if self.orientation is None else self.orientation[rows],
            initial_values={name: each[rows] for name, each in self.initial_values.items()},
        )

    @classmethod
    def joined(cls, parts: Sequence["ParticleData"]) -> "ParticleData":
        """Concatenation of all parts in order; no particles without parts."""
        if not parts:
            empty = np.empty(0)
            empty_vectors = np.empty((0, 3))
            empty_numbers = np.empty(0, dtype=np.int32)
            return cls(empty_vectors, empty_vectors, empty_vectors, empty, empty_numbers, empty_numbers)
        names = [name for name in cls.__dataclass_fields__ if name not in ("orientation", "initial_values")]
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        properties = dict.fromkeys(name for part in parts for name in part.initial_values)
        values = {
            name: np.concatenate(
                [part.initial_values.get(name, np.full(len(part), np.nan)) for part in parts]
            )
            for name in properties
        }
        return cls(**arrays, orientation=_joined_orientations(parts), initial_values=values)


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
        velocity = velocity + group.spec.thermal.velocities(radius, group.velocity_random())
    return ParticleData(
        position=position,
        velocity=np.broadcast_to(velocity, (count, 3)).copy(),
        angular_velocity=np.broadcast_to(
            np.asarray(group.spec.angular_velocity, dtype=np.float64), (count, 3)
        ).copy(),
        radius=radius,
        material=np.full(count, group.material_number, dtype=np.int32),
        group=np.full(count, group.number, dtype=np.int32),
        orientation=group.spec.shape.orientations(count, partial(group.orientation_random, batch)),
    )


def shortfall(group: SceneGroup, error: RegionFullError, others: Sequence[str] = ()) -> str:
    """Error message for a group that does not fit, with the source position of its count.

    `others`: names of groups without which it fits.
    """
    spec = group.spec
    place = f" in its {spec.insert.place_key}" if spec.insert.place_key else ""
    outer = spec.shape.outer_diameter
    spheres = (
        ""
        if outer is None
        else f" For clumps the spheres around them count, here of {outer:.3g} m, so that none overlap in any "
        "orientation: insert fewer at a time, as rain or through an inlet, and let them settle."
    )
    remedy = error.remedy
    if others:
        place += f" between the particles of {' and '.join(others)}, which are placed before"
        remedy = (
            "Without them it fits: write the group with the largest particles first, or use one group with "
            "several sizes."
        )
    return (
        f"{group.locate('count')}: particles.{group.name}.count is {spec.count}, but "
        f"{error.shortfall}{place}. {remedy}{spheres}"
    )
