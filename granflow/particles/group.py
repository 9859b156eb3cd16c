"""One particle group of a scene, with what its particles need of other parts of the scene."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from granflow.scene.schema.domain import Domain
from granflow.scene.schema.particles import Group
from granflow.scene.schema.scene import SceneInput


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
        """The random number generator of the group (PCG64), independent of all other groups and of their order."""
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
