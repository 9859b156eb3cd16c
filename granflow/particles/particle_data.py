"""Data of new particles, and helper functions of all generators."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.particles.packing import RegionFullError
from granflow.scene.schema.scene import SceneInput


@dataclass(frozen=True)
class ParticleData:
    """Arrays of n new particles.

    `position` (n, 3) [m], `velocity` (n, 3) [m/s], `angular_velocity` (n, 3) [rad/s], `radius` (n,) [m], all float64;
    `material` (n,) int32 index into list(scene.materials), `group` (n,) int32 index into list(scene.particles).
    """

    position: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    radius: np.ndarray
    material: np.ndarray
    group: np.ndarray

    def __len__(self) -> int:
        return len(self.radius)

    @classmethod
    def joined(cls, parts: Sequence["ParticleData"]) -> "ParticleData":
        """Concatenation of all parts in order; no particles without parts."""
        if not parts:
            empty, empty_vectors, empty_numbers = np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.int32)
            return cls(empty_vectors, empty_vectors, empty_vectors, empty, empty_numbers, empty_numbers)
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__))


def particles_of(scene: SceneInput, group_name: str, position: np.ndarray, radius: np.ndarray) -> ParticleData:
    """Particles of one group at centers (n, 3) [m] with radii (n,) [m], and the motion and material of the group.

    A single velocity [m/s] or angular velocity [rad/s] of the group applies to all particles. Raises KeyError for an
    unknown group.
    """
    group = scene.particles[group_name]
    count = len(radius)
    return ParticleData(
        position=position,
        velocity=np.broadcast_to(np.asarray(group.velocity, dtype=np.float64), (count, 3)).copy(),
        angular_velocity=np.broadcast_to(np.asarray(group.angular_velocity, dtype=np.float64), (count, 3)).copy(),
        radius=radius,
        material=np.full(count, list(scene.materials).index(group.material), dtype=np.int32),
        group=np.full(count, list(scene.particles).index(group_name), dtype=np.int32),
    )


def seeds_of(scene: SceneInput, group_name: str) -> tuple[int, int]:
    """The seeds of a group: that of the scene, and the platform-independent CRC-32 of its name."""
    return scene.seed, zlib.crc32(group_name.encode())


def random_for(scene: SceneInput, group_name: str) -> np.random.Generator:
    """The random number generator of one group (PCG64), independent of all other groups and of their order."""
    return np.random.default_rng(np.random.SeedSequence(seeds_of(scene, group_name)))


def shortfall(scene: SceneInput, group_name: str, error: RegionFullError) -> str:
    """Error message for a group that does not fit, with the source position of its count."""
    group = scene.particles[group_name]
    location = scene.locate("particles", group_name, "count")
    where = "face" if group.insert.kind == "inlet" else "region"
    return (
        f"{location}: particles.{group_name}.count is {group.count}, but "
        f"{error.shortfall} in its {where}. {error.remedy}"
    )
