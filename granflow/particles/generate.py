"""Particles of a scene: initial particles, and inserters for later ones.

The same scene and seed give bit-identical particles on one machine for any number of threads: each group has a separate
random number generator (`SceneGroup.random`).
"""

from collections.abc import Mapping

import numpy as np

from granflow.errors import SceneError
from granflow.geometry.periodic_box import PeriodicBox
from granflow.particles.from_file import particles_from_file
from granflow.particles.group import SceneGroup, groups_of
from granflow.particles.insertion import Inserter, inserters
from granflow.particles.packing import RegionFullError, Spheres, fill_lattice, pack_at_random
from granflow.particles.particle_data import ParticleData, particles_of, shortfall
from granflow.particles.regions import sampler_of
from granflow.particles.sizes import draw_diameters
from granflow.scene.schema.insertion import FileInsertion, LatticeInsertion, PackInsertion, PositionsInsertion
from granflow.scene.schema.scene import SceneInput

__all__ = ["ParticleData", "Inserter", "initial_particles", "inserters"]

INSERTION_ORDER = ("positions", "file", "lattice", "pack")
"""Groups with given positions first, random packings last, so that each kind can avoid the particles before it."""


def initial_particles(scene: SceneInput, earlier: Mapping[str, ParticleData] | None = None) -> ParticleData:
    """All particles at t = 0, group by group in the order of the scene.

    Groups in `earlier` keep their particles from an earlier run; the other groups avoid them. Particles do not
    overlap, except where given positions or files overlap. Groups with rain, inlet or python have no particles yet.

    Raises SceneError with one message for each group that does not fit.
    """
    inserted: dict[str, ParticleData] = dict(earlier or {})
    remaining = {name: group for name, group in groups_of(scene).items() if name not in inserted}
    problems: list[str] = []
    for kind in INSERTION_ORDER:
        for name, group in remaining.items():
            if group.spec.insert.kind == kind:
                try:
                    inserted[name] = insert_group(group, all_spheres(inserted, scene.domain.periodic_box()))
                except RegionFullError as error:
                    problems.append(shortfall(group, error))
    if problems:
        raise SceneError(problems)
    return ParticleData.joined([inserted[name] for name in scene.particles if name in inserted])


def all_spheres(inserted: dict[str, ParticleData], periodic_box: PeriodicBox) -> Spheres:
    """Spheres of all groups inserted so far, with the periodic images of those that cross a periodic face.

    `inserted`: particles by group, in any order.
    """
    together = ParticleData.joined(list(inserted.values()))
    return Spheres(*periodic_box.with_images(together.position, together.radius))


def insert_group(group: SceneGroup, existing: Spheres) -> ParticleData:
    """Initial particles of one group, without overlap with `existing`.

    Radii are drawn before positions, with the random number generator of the group. Given positions and files are not
    checked for overlap.

    Raises RegionFullError if a lattice or packing does not fit, and SceneError for an invalid file.
    """
    spec, insertion = group.spec, group.spec.insert
    if isinstance(insertion, FileInsertion):
        return particles_from_file(group)
    random = group.random()
    radius = draw_diameters(spec.sizes, spec.count, random) / 2
    if isinstance(insertion, PositionsInsertion):
        position = np.array(insertion.positions, dtype=np.float64).reshape(-1, 3)
    elif isinstance(insertion, LatticeInsertion):
        position = fill_lattice(sampler_of(insertion.region), radius, insertion.jitter, existing, random)
    else:
        assert isinstance(insertion, PackInsertion)
        position = pack_at_random(sampler_of(insertion.region), radius, existing, random)
    return particles_of(group, position, radius)
