"""Schema of the block `outlets`: regions in which particles are deleted and counted."""

from typing import Annotated

from pydantic import Field

from granflow.scene.schema import quantities as q
from granflow.scene.schema.fields import Model, choose_by_first_key
from granflow.scene.schema.shapes import Box


class HalfSpaceGiven(Model):
    """All points on one side of a plane."""

    point: q.Point = Field(description="a point on the plane [m]")
    normal: q.Direction = Field(description="normal of the plane, toward the half space; its length does not matter")


class DiscGiven(Model):
    """The semi-infinite cylinder on the downstream side of a disc."""

    center: q.Point = Field(description="center of the disc [m]")
    normal: q.Direction = Field(
        description="normal of the disc, in the direction of the particle flow; its length does not matter"
    )
    radius: q.PositiveLength = Field(description="radius of the disc [m]")


class BoxOutlet(Model):
    """Particles whose center is in a box are deleted at the next rebuild of the neighbor list.

    >>> gf.BoxOutlet(box=gf.Box(min=[0, 0, -0.2], max=[0.1, 0.1, -0.1])).box.min
    (0.0, 0.0, -0.2)
    """

    box: Box = Field(description="a box along the coordinate axes, {min: [..], max: [..]}")


class HalfSpaceOutlet(Model):
    """Particles whose center is in a half space are deleted at the next rebuild of the neighbor list.

    >>> gf.HalfSpaceOutlet(half_space={"point": [0, 0, -0.1], "normal": [0, 0, -1]}).half_space.point
    (0.0, 0.0, -0.1)
    """

    half_space: HalfSpaceGiven = Field(description="a half space, {point: [..], normal: [..]}")


class DiscOutlet(Model):
    """Particles whose center is in the semi-infinite cylinder downstream of a disc are deleted at the next rebuild.

    >>> gf.DiscOutlet(disc={"center": [0, 0, 0], "normal": [0, 0, -1], "radius": "2 cm"}).disc.radius
    0.02
    """

    disc: DiscGiven = Field(description="a disc, {center: [..], normal: [..], radius: ..}")


Outlet = Annotated[
    BoxOutlet | HalfSpaceOutlet | DiscOutlet,
    choose_by_first_key(
        "it must be {box: {min: [..], max: [..]}}, {half_space: {point: [..], normal: [..]}} or "
        "{disc: {center: [..], normal: [..], radius: ..}}"
    ),
]
"""An outlet of any shape: box, half space or disc, selected by its key."""
