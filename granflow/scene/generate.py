"""The particles of a scene: those there at the start, and those that come later.

The same scene and seed give the same particles to the last bit on one machine, whatever the number of threads.
"""

from collections.abc import Mapping

import numpy as np

from granflow.errors import SceneError
from granflow.scene.border import Border
from granflow.scene.filed import grains_from
from granflow.scene.grains import Grains, grains_of, random_for, shortfall
from granflow.scene.places import FromFile, Lattice, Listed, Pack
from granflow.scene.placing import NoRoomError, Spheres, place_at_random, place_on_lattice
from granflow.scene.rooms import room_of
from granflow.scene.schema import Scene
from granflow.scene.sizes import draw_diameters
from granflow.scene.stream import Stream, streams

__all__ = ["Grains", "Stream", "initial_grains", "streams"]

PLACING_ORDER = ("list", "file", "lattice", "pack")
"""Groups with given places first, those that find their own way last, so that each can keep clear of the others."""


def initial_grains(scene: Scene, earlier: Mapping[str, Grains] | None = None) -> Grains:
    """Every particle that is there at t = 0, group by group in the order of the scene.

    Groups in `earlier`, the particles of an earlier run, are not placed: the others keep clear of them.

    No two overlap, except where lists of positions or files say so. Raises SceneError with the shortfall of every group
    that does not fit.
    """
    placed: dict[str, Grains] = dict(earlier or {})
    to_place = {name: group for name, group in scene.particles.items() if name not in placed}
    problems: list[str] = []
    for kind in PLACING_ORDER:
        for name in (name for name, group in to_place.items() if group.place.kind == kind):
            try:
                placed[name] = place_group(scene, name, all_spheres(placed, Border.of(scene.domain)))
            except NoRoomError as error:
                problems.append(shortfall(scene, name, error))
    if problems:
        raise SceneError(problems)
    return Grains.joined([placed[name] for name in scene.particles if name in placed])


def all_spheres(placed: dict[str, Grains], border: Border) -> Spheres:
    """The spheres of all groups placed so far, with the images of those that reach through a periodic border."""
    together = Grains.joined(list(placed.values()))
    return Spheres(*border.with_images(together.position, together.radius))


def place_group(scene: Scene, name: str, present: Spheres) -> Grains:
    """The grains of one group that is there from the start, clear of those present. Raises NoRoomError."""
    group, place = scene.particles[name], scene.particles[name].place
    if isinstance(place, FromFile):
        return grains_from(scene, name)
    random = random_for(scene, name)
    radius = draw_diameters(group.sizes, group.count, random) / 2
    if isinstance(place, Listed):
        position = np.array(place.positions, dtype=np.float64).reshape(-1, 3)
    elif isinstance(place, Lattice):
        position = place_on_lattice(room_of(place.region), radius, place.jitter, present, random)
    else:
        assert isinstance(place, Pack)
        position = place_at_random(room_of(place.region), radius, present, random)
    return grains_of(scene, name, position, radius)
