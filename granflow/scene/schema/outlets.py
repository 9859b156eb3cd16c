"""Schema of outlets: regions in which particles are deleted and counted."""

from typing import Annotated

from pydantic import Field, Tag

from granflow.scene.schema.fields import Direction, Model, Point, PositiveLength, choose_by
from granflow.scene.schema.insertion import Box, choose_by_field


class HalfSpaceGiven(Model):
    """All points on one side of a plane."""

    point: Point = Field(description="a point on the plane [m]")
    normal: Direction = Field(description="normal of the plane, toward the half space; its length does not matter")


class DiscGiven(Model):
    """The semi-infinite cylinder on the downstream side of a disc."""

    center: Point = Field(description="center of the disc [m]")
    normal: Direction = Field(
        description="normal of the disc, in the direction of the particle flow; its length does not matter"
    )
    radius: PositiveLength = Field(description="radius of the disc [m]")


class BoxOutlet(Model):
    """Particles whose center is in a box are deleted at the next rebuild of the neighbor list."""

    box: Box = Field(description="a box along the coordinate axes, {min: [..], max: [..]}")


class HalfSpaceOutlet(Model):
    """Particles whose center is in a half space are deleted at the next rebuild of the neighbor list."""

    half_space: HalfSpaceGiven = Field(description="a half space, {point: [..], normal: [..]}")


class DiscOutlet(Model):
    """Particles whose center is in the semi-infinite cylinder downstream of a disc are deleted at the next rebuild."""

    disc: DiscGiven = Field(description="a disc, {center: [..], normal: [..], radius: ..}")


Outlet = Annotated[
    Annotated[BoxOutlet, Tag("<box>")]
    | Annotated[HalfSpaceOutlet, Tag("<half_space>")]
    | Annotated[DiscOutlet, Tag("<disc>")],
    choose_by(
        choose_by_field(box=BoxOutlet, half_space=HalfSpaceOutlet, disc=DiscOutlet),
        "it must be {box: {min: [..], max: [..]}}, {half_space: {point: [..], normal: [..]}} or "
        "{disc: {center: [..], normal: [..], radius: ..}}",
    ),
]
"""An outlet of any shape: box, half space or disc, selected by its key."""
