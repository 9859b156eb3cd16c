"""The particles of a scene: those there at the start, and those that rain in later.

The same scene and seed give the same particles to the last bit on one machine, whatever the number of threads.
"""

from collections.abc import Mapping

import numpy as np

from granflow.errors import SceneError
from granflow.scene.border import Border
from granflow.scene.grains import Grains, grains_of, random_for, shortfall
from granflow.scene.placing import NoRoomError, Spheres, place_at_random, place_on_lattice
from granflow.scene.rain import Rain, rains
from granflow.scene.rooms import room_of
from granflow.scene.schema import Scene
from granflow.scene.sizes import draw_diameters

__all__ = ["Grains", "Rain", "initial_grains", "rains"]

PLACING_ORDER = ("list", "lattice", "pack")
"""Groups with given places first, those that find their own way last, so that each can keep clear of the others."""


def initial_grains(scene: Scene, earlier: Mapping[str, Grains] | None = None) -> Grains:
    """Every particle that is there at t = 0, group by group in the order of the scene.

    Groups in `earlier`, the particles of an earlier run, are not placed: the others keep clear of them.

    No two overlap, except where lists of positions say so. Raises SceneError with the shortfall of every group
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
    group = scene.particles[name]
    random = random_for(scene, name)
    radius = draw_diameters(group.diameter, group.count, random) / 2
    if group.place.kind == "list":
        position = np.array(group.place.positions, dtype=np.float64).reshape(-1, 3)
    elif group.place.kind == "lattice":
        position = place_on_lattice(room_of(group.place.region), radius, group.place.jitter, present, random)
    else:
        position = place_at_random(room_of(group.place.region), radius, present, random)
    return grains_of(scene, name, position, radius)
