"""Grains: particles as they enter the run, and what every generator needs to make them."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.scene.placing import NoRoomError
from granflow.scene.schema import Scene


@dataclass(frozen=True)
class Grains:
    """Particles entering the run, n of them.

    position (n, 3) [m], velocity (n, 3) [m/s], spin (n, 3) [rad/s], radius (n,) [m], all float64;
    material (n,) int32 index into list(scene.materials), group (n,) int32 index into list(scene.particles).
    """

    position: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    radius: np.ndarray
    material: np.ndarray
    group: np.ndarray

    def __len__(self) -> int:
        return len(self.radius)

    @classmethod
    def joined(cls, parts: Sequence["Grains"]) -> "Grains":
        """All of them in order; no parts make no grains."""
        if not parts:
            none, nowhere, unnamed = np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.int32)
            return cls(nowhere, nowhere, nowhere, none, unnamed, unnamed)
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__))


def grains_of(scene: Scene, group_name: str, position: np.ndarray, radius: np.ndarray) -> Grains:
    """Grains of one group at the given centres, with the group's velocity, spin and material."""
    group = scene.particles[group_name]
    count = len(radius)
    return Grains(
        position=position,
        velocity=np.broadcast_to(np.asarray(group.velocity, dtype=np.float64), (count, 3)).copy(),
        spin=np.broadcast_to(np.asarray(group.spin, dtype=np.float64), (count, 3)).copy(),
        radius=radius,
        material=np.full(count, list(scene.materials).index(group.material), dtype=np.int32),
        group=np.full(count, list(scene.particles).index(group_name), dtype=np.int32),
    )


def stream_of(scene: Scene, group_name: str) -> tuple[int, int]:
    """The seeds of a group: the scene's, and one from its name that is the same everywhere (CRC-32)."""
    return scene.seed, zlib.crc32(group_name.encode())


def random_for(scene: Scene, group_name: str) -> np.random.Generator:
    """The random numbers of one group: other groups coming or going do not change them."""
    return np.random.default_rng(np.random.SeedSequence(stream_of(scene, group_name)))


def shortfall(scene: Scene, group_name: str, error: NoRoomError) -> str:
    """The sentence for a group that does not fit, with the place of its count in the file."""
    group = scene.particles[group_name]
    place, where = scene.place("particles", group_name, "count"), "face" if group.place.kind == "inlet" else "region"
    return f"{place}: particles.{group_name}.count is {group.count}, but {error.finding} in its {where}. {error.remedy}"
