"""Schema of the key `clump` of particle groups: rigid bodies of spheres, and their orientation."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from granflow.geometry.clump_shape import ClumpShape, clump_shape
from granflow.scene.schema import quantities as q
from granflow.scene.schema.faults import Fault, whole
from granflow.scene.schema.fields import ListOf, Model, choose_by
from granflow.scene.schema.walls import RotationStep

MOST_SPHERES = 100
"""Largest number of spheres of a clump: the integration of each sphere adds up the forces on all of them."""


class ClumpSphere(Model):
    """One sphere of a clump.

    >>> gf.ClumpSphere(position=[0, 0, "1 mm"], radius="2 mm").radius
    0.002
    """

    position: q.UnscaledPoint = Field(description="center [m]; the origin of all centers of a clump is arbitrary")
    radius: q.UnscaledLength = Field(description="radius [m]")


def _orientation_tag(value: Any) -> str | None:
    if isinstance(value, list | tuple):
        return "<list>"
    return "<random>" if value == "random" else "<one>" if isinstance(value, dict | RotationStep) else None


Orientation = Annotated[
    Annotated[Literal["random"], Tag("<random>")]
    | Annotated[RotationStep, Tag("<one>")]
    | Annotated[tuple[RotationStep, ...], Tag("<list>")],
    choose_by(_orientation_tag, "it must be random, {axis: [..], angle: ..}, or a list of these rotations"),
]
"""Random orientations, one rotation for all clumps, or one for each."""


class Clump(Model):
    """A rigid body of spheres, which may overlap; its density is that of the material, and overlaps count once.

    >>> spheres = [gf.ClumpSphere(position=[x, 0, 0], radius="2 mm") for x in (0, 0.003)]
    >>> gf.Clump(spheres=spheres, orientation="random").orientation
    'random'
    """

    spheres: Annotated[
        tuple[ClumpSphere, ...], ListOf(some="[{position: [0, 0, 0], radius: 1 mm}, {position: [1.5 mm, 0, 0], ...}]")
    ] = Field(description="centers and radii of the spheres, {position: [..], radius: ..}, at most 100")
    orientation: Orientation | None = Field(
        None,
        description="orientation of new clumps: {axis: [..], angle: ..} turns the given positions; random; with "
        "insert: {kind: positions}, also a list; default: as given",
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for more than MOST_SPHERES spheres."""
        if len(self.spheres) > MOST_SPHERES:
            yield whole(("spheres",), f"has {len(self.spheres)} spheres, but the limit is {MOST_SPHERES}")

    @property
    def shape(self) -> ClumpShape:
        """Volume, moments of inertia and spheres of the clump."""
        return clump_shape(tuple(each.position for each in self.spheres), tuple(each.radius for each in self.spheres))

    @property
    def outer_diameter(self) -> float:
        """Diameter [m] of the smallest sphere around the center of mass that contains the clump."""
        return 2.0 * self.shape.outer_radius
