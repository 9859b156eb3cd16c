"""Grains: particles as they enter the run, and what every generator needs to make them."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.scene.packing import RegionFullError
from granflow.scene.schema import Scene


@dataclass(frozen=True)
class ParticleData:
    """Particles entering the run, n of them.

    position (n, 3) [m], velocity (n, 3) [m/s], spin (n, 3) [rad/s], radius (n,) [m], all float64;
    material (n,) int32 index into list(scene.materials), group (n,) int32 index into list(scene.particles).
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
        """All of them in order; no parts make no grains."""
        if not parts:
            empty, empty_vectors, empty_numbers = np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.int32)
            return cls(empty_vectors, empty_vectors, empty_vectors, empty, empty_numbers, empty_numbers)
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__))


def particles_of(scene: Scene, group_name: str, position: np.ndarray, radius: np.ndarray) -> ParticleData:
    """Grains of one group at the given centers, with the group's velocity, spin and material."""
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


def seeds_of(scene: Scene, group_name: str) -> tuple[int, int]:
    """The seeds of a group: the scene's, and one from its name that is the same everywhere (CRC-32)."""
    return scene.seed, zlib.crc32(group_name.encode())


def random_for(scene: Scene, group_name: str) -> np.random.Generator:
    """The random numbers of one group: other groups coming or going do not change them."""
    return np.random.default_rng(np.random.SeedSequence(seeds_of(scene, group_name)))


def shortfall(scene: Scene, group_name: str, error: RegionFullError) -> str:
    """The sentence for a group that does not fit, with the place of its count in the file."""
    group = scene.particles[group_name]
    location, where = (
        scene.locate("particles", group_name, "count"),
        "face" if group.insert.kind == "inlet" else "region",
    )
    return (
        f"{location}: particles.{group_name}.count is {group.count}, but "
        f"{error.shortfall} in its {where}. {error.remedy}"
    )
