"""Clumps: rigid bodies of spheres, with their keys, orientations, checks and warnings.

`geometry/clump.py` computes volume and inertia, `engine/clumps.py` moves the spheres of a clump.
"""

from collections.abc import Callable, Iterator
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, Tag

from granflow.geometry.clump import ClumpBody, about, clump_body, random_orientations
from granflow.geometry.connected_parts import connected_parts
from granflow.scene.blocks.insertions import InsertionKind, kinds
from granflow.scene.blocks.particle_shapes.shape import ParticleShape
from granflow.scene.blocks.primitives import RotationStep
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, missing, whole
from granflow.schema.model import FileName, ListOf, Model, choose_by, optional
from granflow.visible_text import alternatives

MOST_SPHERES = 100
"""Largest number of spheres of a clump: the integration of each sphere adds up the forces on all of them."""
SAME_SPHERE = 1e-6
"""Distance and difference of radii, over the radius, below which spheres are equal, or a gap below which they
touch."""
COMMON_OVERLAP = 0.1
"""Overlap over the smaller radius of the position that closes a gap."""


class ClumpSphere(Model):
    """One sphere of a clump.

    >>> gf.ClumpSphere(position=[0, 0, "1 mm"], radius="2 mm").radius
    0.002
    """

    position: q.UnscaledPoint = Field(
        description="center [m]; the origin of all centers of a clump is arbitrary"
    )
    radius: q.UnscaledLength = Field(description="radius [m]")


def _orientation_tag(value: Any) -> str | None:
    if isinstance(value, list | tuple):
        return "<list>"
    if isinstance(value, dict | RotationStep):
        return "<one>"
    return "<random>" if value == "random" else None


Orientation = Annotated[
    Annotated[Literal["random"], Tag("<random>")]
    | Annotated[RotationStep, Tag("<one>")]
    | Annotated[tuple[RotationStep, ...], Tag("<list>")],
    choose_by(_orientation_tag, "it must be random, {axis: [..], angle: ..}, or a list of these rotations"),
]
"""Random orientations, one rotation for all clumps, or one for each."""


class Clump(Model, ParticleShape):
    """A rigid body of spheres, which may overlap; its density is that of the material, and overlaps count
    once.

    >>> spheres = [gf.ClumpSphere(position=[x, 0, 0], radius="2 mm") for x in (0, 0.003)]
    >>> gf.Clump(spheres=spheres, orientation="random").orientation
    'random'
    """

    rotates: ClassVar[bool] = True
    packs_loosely: ClassVar[bool] = True

    spheres: (
        Annotated[
            tuple[ClumpSphere, ...],
            ListOf(some="[{position: [0, 0, 0], radius: 1 mm}, {position: [1.5 mm, 0, 0], ...}]"),
        ]
        | None
    ) = Field(
        None,
        description="centers and radii of the spheres, {position: [..], radius: ..}, at most 100; instead of "
        "a file, or from it",
        examples=[
            [{"position": [0, 0, 0], "radius": "2 mm"}, {"position": ["3 mm", 0, 0], "radius": "2 mm"}]
        ],
    )
    file: FileName | None = Field(
        None,
        description="text file with a row x, y, z, r for each sphere, with or without a header, or VTU file; "
        "path relative to the folder of the scene",
        examples=["stone.csv"],
    )
    scale: q.Positive = Field(
        1.0,
        description="with file: factor from its lengths to m, such as 0.001 for mm; also to change the size",
        examples=[0.001],
    )
    orientation: Orientation | None = optional(
        "orientation of new clumps: {axis: [..], angle: ..} turns the given positions; random; with "
        "insert: {kind: positions}, also a list",
        "as given",
    )

    # Numbers; a clump from a file has them as soon as the scene is resolved

    @property
    def known_spheres(self) -> tuple[ClumpSphere, ...]:
        """The spheres."""
        assert self.spheres is not None, "the file of the clump has not been read"
        return self.spheres

    @property
    def body(self) -> ClumpBody:
        """Volume, moments of inertia and spheres of the clump."""
        return clump_body(
            tuple(each.position for each in self.known_spheres),
            tuple(each.radius for each in self.known_spheres),
        )

    @property
    def sphere_count(self) -> int:
        """Number of spheres."""
        return len(self.known_spheres)

    @property
    def title(self) -> str:
        """See `ParticleShape`."""
        return f" clumps of {self.sphere_count} spheres"

    @property
    def outer_diameter(self) -> float:
        """Diameter [m] of the smallest sphere around the center of mass that contains the clump."""
        return 2.0 * self.body.outer_radius

    @property
    def diameters(self) -> tuple[float, ...]:
        """See `ParticleShape`."""
        return tuple(sorted({2.0 * sphere.radius for sphere in self.known_spheres}))

    def volume(self, radius: np.ndarray) -> np.ndarray:
        """See `ParticleShape`."""
        return np.full(np.shape(radius), self.body.volume)

    def mass_of_sphere(self, radius: float, density: float) -> float:
        """The mass of the clump."""
        return self.body.volume * density

    # Orientation and place of new clumps

    def orientations(self, count: int, random: Callable[[], np.random.Generator]) -> np.ndarray:
        """See `ParticleShape`."""
        if self.orientation is None:
            return np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
        if self.orientation == "random":
            return random_orientations(count, random())
        rotations = self.orientation if isinstance(self.orientation, tuple) else (self.orientation,)
        turns = about(
            np.array([each.axis for each in rotations]), np.array([each.angle for each in rotations])
        )
        return np.broadcast_to(turns, (count, 4)).copy()

    def placed_spheres(
        self, position: np.ndarray, radius: np.ndarray, orientation: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `ParticleShape`."""
        if orientation is None:
            orientation = self.orientations(len(position), lambda: np.random.default_rng(1))
        body = self.body
        radii = np.broadcast_to(body.radius, (len(position), len(body)))
        return body.spheres(position, orientation), radii

    # Faults

    def faults(self) -> Iterator[Fault]:
        """Yield a fault without spheres, and for more than MOST_SPHERES."""
        if self.file is None and self.spheres is None:
            yield missing(("spheres",), "centers and radii, {position: [..], radius: ..}; or give file")
        if self.file is None and self.scale != 1.0:
            yield Fault(("scale",), "it belongs to a file; change the spheres, and remove scale")
        if len(self.spheres or ()) > MOST_SPHERES:
            yield whole(
                ("spheres",), f"has {len(self.known_spheres)} spheres, but the limit is {MOST_SPHERES}"
            )

    def faults_in_group(self, group: Any) -> Iterator[Fault]:
        """Clumps have no other size, move with no wall, and are inserted by the scene."""
        for key in ("diameter", "radius"):
            if getattr(group, key) is not None:
                yield Fault((key,), f"the spheres of the clump define the sizes; remove {key}")
        if group.attached_to is not None:
            reason = "clumps cannot move with a wall; build the body of spheres without clump, or write true"
            yield Fault(("fixed",), reason)
        if not _places_clumps(type(group.insert)):
            others = alternatives(kinds(_places_clumps))
            yield Fault(("insert", "kind"), f"clumps are not inserted in this way; use {others}")

    def faults_in_scene(self, scene: Any, group: str) -> Iterator[Fault]:
        """Clumps exclude sheared boxes."""
        if scene.domain.lees_edwards is not None:
            yield whole(
                ("domain", "lees_edwards"),
                f"cannot be combined with the clumps of particles.{group}, which cross no sheared boundary; "
                "remove one of the two",
            )

    # Warnings: a sphere that occurs twice, and gaps between the spheres

    def warnings(self, key: Callable[..., str]) -> Iterator[str]:
        """A sentence if a sphere occurs twice, and one if the spheres are not connected.

        The forces on a sphere that occurs twice count twice, and volume and inertia once.
        """
        centers = np.array([each.position for each in self.known_spheres])
        radii = np.array([each.radius for each in self.known_spheres])
        distance = np.linalg.norm(centers[:, None] - centers[None], axis=2)

        def sphere(index: int) -> str:
            if self.file is not None:
                return f"spheres.{index}, row {index + 1} of {key('clump', 'file')},"
            return key("clump", "spheres", index, "position")

        yield from _repeated_spheres(centers, radii, distance, sphere)
        yield from _gaps(centers, radii, distance, sphere)


def _repeated_spheres(
    centers: np.ndarray, radii: np.ndarray, distance: np.ndarray, sphere: Callable[[int], str]
) -> Iterator[str]:
    """A sentence on the first sphere that equals an earlier one, with the number of further ones."""
    scale = SAME_SPHERE * np.minimum.outer(radii, radii)
    equal = (distance <= scale) & (np.abs(np.subtract.outer(radii, radii)) <= scale)
    repeated = [k for k in range(len(radii)) if equal[k, :k].any()]
    if repeated:
        index = repeated[0]
        first = int(equal[index].argmax())
        shifted = centers[index] + [radii[index], 0.0, 0.0]
        more = f" ({len(repeated) - 1} more of its spheres are repeated)" if len(repeated) > 1 else ""
        yield (
            f"{sphere(index)} is {_text(centers[index])} m with the radius "
            f"{radii[index]:.4g} m, the same sphere as spheres.{first}{more}: its contacts count twice. "
            f"Remove it, or give it another position such as {_text(shifted)} m."
        )


def _gaps(
    centers: np.ndarray, radii: np.ndarray, distance: np.ndarray, sphere: Callable[[int], str]
) -> Iterator[str]:
    """A sentence on the narrowest gap between the spheres that are connected with the first one and the
    others."""
    gap = distance - np.add.outer(radii, radii)
    part = connected_parts(np.argwhere(gap <= SAME_SPHERE * np.minimum.outer(radii, radii)), len(radii))
    count = part.max() + 1
    if count == 1:
        return
    of_first = part == part[0]
    gap[~np.outer(of_first, ~of_first)] = np.inf
    near, far = divmod(int(gap.argmin()), len(radii))
    reach = radii[near] + radii[far] - COMMON_OVERLAP * min(radii[near], radii[far])
    closed = centers[near] + (centers[far] - centers[near]) * (reach / distance[near, far])
    others = ", with the spheres connected with it," if (part == part[far]).sum() > 1 else ""
    yield (
        f"{sphere(far)} is {_text(centers[far])} m, {gap[near, far]:.3g} m away "
        f"from the surface of spheres.{near}, which is the nearest one of the others: the spheres of this "
        f"clump form {count} separate bodies that move as one. Move it{others} to a position such as "
        f"{_text(closed)} m, which closes the gap, or give the bodies groups of their own."
    )


def _text(position: np.ndarray) -> str:
    """Coordinates in the form of the scene."""
    return "[" + ", ".join(f"{each + 0.0:.4g}" for each in position) + "]"


def _places_clumps(kind: type[InsertionKind]) -> bool:
    """Whether the scene places particles of a kind with its sizes."""
    return not (kind.defines_sizes or kind.from_program)
