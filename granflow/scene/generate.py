"""The particles of a scene: those there at the start, and those that come later.

The same scene and seed give the same particles to the last bit on one machine, whatever the number of threads.
"""

from collections.abc import Mapping

import numpy as np

from granflow.errors import SceneError
from granflow.scene.insertion import Inserter, inserters
from granflow.scene.insertion_schema import FileInsertion, LatticeInsertion, PackInsertion, PositionsInsertion
from granflow.scene.packing import RegionFullError, Spheres, fill_lattice, pack_at_random
from granflow.scene.particle_data import ParticleData, particles_of, random_for, shortfall
from granflow.scene.particle_file import particles_from_file
from granflow.scene.periodic_box import PeriodicBox
from granflow.scene.regions import sampler_of
from granflow.scene.schema import Scene
from granflow.scene.size_sampling import draw_diameters

__all__ = ["ParticleData", "Inserter", "initial_particles", "inserters"]

INSERTION_ORDER = ("positions", "file", "lattice", "pack")
"""Groups with given places first, those that find their own way last, so that each can keep clear of the others."""


def initial_particles(scene: Scene, earlier: Mapping[str, ParticleData] | None = None) -> ParticleData:
    """Every particle that is there at t = 0, group by group in the order of the scene.

    Groups in `earlier`, the particles of an earlier run, are not placed: the others keep clear of them.

    No two overlap, except where lists of positions or files say so. Raises SceneError with the shortfall of every group
    that does not fit.
    """
    inserted: dict[str, ParticleData] = dict(earlier or {})
    remaining = {name: group for name, group in scene.particles.items() if name not in inserted}
    problems: list[str] = []
    for kind in INSERTION_ORDER:
        for name in (name for name, group in remaining.items() if group.insert.kind == kind):
            try:
                inserted[name] = insert_group(scene, name, all_spheres(inserted, PeriodicBox.of(scene.domain)))
            except RegionFullError as error:
                problems.append(shortfall(scene, name, error))
    if problems:
        raise SceneError(problems)
    return ParticleData.joined([inserted[name] for name in scene.particles if name in inserted])


def all_spheres(inserted: dict[str, ParticleData], periodic_box: PeriodicBox) -> Spheres:
    """The spheres of all groups placed so far, with the images of those that reach through a periodic border."""
    together = ParticleData.joined(list(inserted.values()))
    return Spheres(*periodic_box.with_images(together.position, together.radius))


def insert_group(scene: Scene, name: str, existing: Spheres) -> ParticleData:
    """The grains of one group that is there from the start, clear of those present. Raises NoRoomError."""
    group, insertion = scene.particles[name], scene.particles[name].insert
    if isinstance(insertion, FileInsertion):
        return particles_from_file(scene, name)
    random = random_for(scene, name)
    radius = draw_diameters(group.sizes, group.count, random) / 2
    if isinstance(insertion, PositionsInsertion):
        position = np.array(insertion.positions, dtype=np.float64).reshape(-1, 3)
    elif isinstance(insertion, LatticeInsertion):
        position = fill_lattice(sampler_of(insertion.region), radius, insertion.jitter, existing, random)
    else:
        assert isinstance(insertion, PackInsertion)
        position = pack_at_random(sampler_of(insertion.region), radius, existing, random)
    return particles_of(scene, name, position, radius)
