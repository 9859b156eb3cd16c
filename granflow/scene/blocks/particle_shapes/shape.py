"""What a shape of particles answers, and the sphere.

A particle of any shape consists of spheres, which are the rows of the device arrays: a contact is one of two
spheres, or of a sphere and a wall. A shape is one record: the keys of the scene, and what insertion, plan,
engine and checkpoints ask of it. `Group.shape` gives the record of a group.
"""

from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import numpy as np

from granflow.geometry.clump import ClumpBody
from granflow.geometry.sphere import sphere_mass, sphere_volume
from granflow.schema.faults import Fault


class ParticleShape:
    """Shape of the particles of a group. Base class of the shapes.

    Where a method takes radii [m], they are those of the particles when they are inserted: of the smallest
    sphere around the center of mass that contains the particle.

    rotates:        whether particles rotate in every scene, also without friction
    packs_loosely:  whether a bed at rest can be as loose as one of cohesive particles
    sphere_count:   number of spheres of a particle
    """

    rotates: ClassVar[bool]
    packs_loosely: ClassVar[bool]

    @property
    def sphere_count(self) -> int:
        """Number of spheres of a particle."""
        raise NotImplementedError

    @property
    def title(self) -> str:
        """What the particles of a group are, after their number; empty for spheres."""
        raise NotImplementedError

    @property
    def body(self) -> ClumpBody | None:
        """The rigid body of several spheres; None for a sphere."""
        raise NotImplementedError

    @property
    def outer_diameter(self) -> float | None:
        """Diameter [m] of each particle when it is inserted; None if the keys of the group define it."""
        raise NotImplementedError

    @property
    def diameters(self) -> tuple[float, ...]:
        """Diameters [m] of the spheres in ascending order; empty if the keys of the group define them."""
        raise NotImplementedError

    def volume(self, radius: np.ndarray) -> np.ndarray:
        """Volumes (n,) [m3] of particles with radii (n,) [m]."""
        raise NotImplementedError

    def mass_of_sphere(self, radius: float, density: float) -> float:
        """Mass [kg] that moves with a sphere of radius [m] and density [kg/m3]: that of its particle."""
        raise NotImplementedError

    def placed_spheres(
        self, position: np.ndarray, radius: np.ndarray, orientation: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Centers (n, k, 3) [m] and radii (n, k) [m] of the k spheres of particles at (n, 3) [m].

        `radius` (n,) [m] of the particles; `orientation` (n, 4), None for those of new particles.
        """
        raise NotImplementedError

    def orientations(self, count: int, random: Callable[[], np.random.Generator]) -> np.ndarray | None:
        """Orientations (count, 4) of new particles, unit quaternions; None for spheres.

        `random`: creates the generator of random orientations.
        """
        raise NotImplementedError

    def faults_in_group(self, group: Any) -> Iterator[Fault]:
        """Yield a fault for each key of the group that the shape does not allow."""
        yield from ()

    def faults_in_scene(self, scene: Any, group: str) -> Iterator[Fault]:
        """Yield a fault for each part of the scene that cannot be combined with the shape of a group."""
        yield from ()

    def warnings(self, key: Callable[..., str]) -> Iterator[str]:
        """A sentence for each probable mistake; `key`: text of a key path below the group."""
        yield from ()


class Sphere(ParticleShape):
    """A sphere, whose size is in the keys of its group."""

    rotates = False
    packs_loosely = False
    sphere_count = 1
    title = ""
    body = None
    outer_diameter = None
    diameters = ()

    def volume(self, radius: np.ndarray) -> np.ndarray:
        """See `ParticleShape`."""
        return sphere_volume(radius)

    def mass_of_sphere(self, radius: float, density: float) -> float:
        """See `ParticleShape`."""
        return sphere_mass(radius, density)

    def placed_spheres(
        self, position: np.ndarray, radius: np.ndarray, orientation: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `ParticleShape`."""
        return position[:, None], radius[:, None]

    def orientations(self, count: int, random: Callable[[], np.random.Generator]) -> None:
        """None: a sphere has no orientation."""
        return None


SPHERE = Sphere()
"""The shape of particles without another one."""
