"""Data of new particles, and helper functions of all generators."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow.particles.group import SceneGroup
from granflow.particles.packing import RegionFullError
from granflow.particles.thermal import thermal_velocities


@dataclass(frozen=True)
class ParticleData:
    """Arrays of n new particles.

    `position` (n, 3) [m], `velocity` (n, 3) [m/s], `angular_velocity` (n, 3) [rad/s], `radius` (n,) [m], all float64;
    `material` (n,) int32 index into list(scene.materials), `group` (n,) int32 index into list(scene.particles).

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

    def __len__(self) -> int:
        return len(self.radius)

    @classmethod
    def joined(cls, parts: Sequence["ParticleData"]) -> "ParticleData":
        """Concatenation of all parts in order; no particles without parts."""
        if not parts:
            empty, empty_vectors, empty_numbers = np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.int32)
            return cls(empty_vectors, empty_vectors, empty_vectors, empty, empty_numbers, empty_numbers)
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__))


def particles_of(group: SceneGroup, position: np.ndarray, radius: np.ndarray) -> ParticleData:
    """Particles of one group at centers (n, 3) [m] with radii (n,) [m], and the motion and material of the group.

    A single velocity [m/s] or angular velocity [rad/s] of the group applies to all particles.
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
    )


def shortfall(group: SceneGroup, error: RegionFullError) -> str:
    """Error message for a group that does not fit, with the source position of its count."""
    where = "face" if group.spec.insert.kind == "inlet" else "region"
    return (
        f"{group.locate('count')}: particles.{group.name}.count is {group.spec.count}, but "
        f"{error.shortfall} in its {where}. {error.remedy}"
    )
