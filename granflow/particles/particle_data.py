"""Data of new particles, and helper functions of all generators."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from granflow.arguments import shown
from granflow.errors import GranflowError
from granflow.geometry.quaternion import about, random_orientations
from granflow.particles.group import SceneGroup
from granflow.particles.packing import RegionFullError
from granflow.particles.thermal import thermal_velocities
from granflow.scene.schema.clumps import Clump


@dataclass(frozen=True)
class ParticleData:
    """Arrays of n new particles.

    `position` (n, 3) [m], `velocity` (n, 3) [m/s], `angular_velocity` (n, 3) [rad/s], `radius` (n,) [m], all float64;
    `material` (n,) int32 index into list(scene.materials), `group` (n,) int32 index into list(scene.particles).
    `orientation` (n, 4): unit quaternions (w, x, y, z) by which clumps are turned; None without clumps. The position of
    a clump is its center of mass, its radius that of the sphere around it.

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
                raise GranflowError(f"ParticleData: {name} is {shown(values)}, but must be an array of numbers.")
            if values.shape != wanted:
                raise GranflowError(
                    f"ParticleData: {name} has the shape {values.shape}, but must have {wanted}, as radius has {shape}."
                )

    def __len__(self) -> int:
        return len(self.radius)

    @classmethod
    def joined(cls, parts: Sequence["ParticleData"]) -> "ParticleData":
        """Concatenation of all parts in order; no particles without parts."""
        if not parts:
            empty, empty_vectors, empty_numbers = np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.int32)
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
        [np.tile(identity, (len(part), 1)) if part.orientation is None else part.orientation for part in parts]
    )


def particles_of(group: SceneGroup, position: np.ndarray, radius: np.ndarray, batch: int = 0) -> ParticleData:
    """Particles of one group at centers (n, 3) [m] with radii (n,) [m], and the motion and material of the group.

    A single velocity [m/s] or angular velocity [rad/s] of the group applies to all particles. `batch`: number of the
    batch of an insertion, for random orientations.
    """
    count, velocity = len(radius), np.asarray(group.spec.velocity, dtype=np.float64)
    if group.spec.thermal is not None:
        velocity = velocity + thermal_velocities(group.spec.thermal, radius, group.velocity_random())
    return ParticleData(
        position=position,
        velocity=np.broadcast_to(velocity, (count, 3)).copy(),
        angular_velocity=np.broadcast_to(np.asarray(group.spec.angular_velocity, dtype=np.float64), (count, 3)).copy(),
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
