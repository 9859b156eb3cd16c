"""Schema of outlets: where particles are deleted and counted."""

from typing import Annotated

from pydantic import Field, Tag

from granflow.scene.fields import Direction, Model, Point, PositiveLength, chosen
from granflow.scene.places import Box, one_of


class Beyond(Model):
    """What lies beyond a plane, or beyond a disc of it."""

    point: Point = Field(description="a point on the plane; the centre, if there is a radius [m]")
    normal: Direction = Field(description="direction in which it lies; its length does not matter")
    radius: PositiveLength | None = Field(None, description="radius around the point [m]; left out: the whole plane")


class BoxOutlet(Model):
    """Particles whose centre is in a box are deleted at the next search."""

    box: Box = Field(description="a box along the axes, {min: [..], max: [..]}")


class BeyondOutlet(Model):
    """Particles whose centre is beyond a plane or a disc are deleted at the next search."""

    beyond: Beyond = Field(
        description="beyond a plane, {point: [..], normal: [..]}, or with radius beyond a disc of it"
    )


Outlet = Annotated[
    Annotated[BoxOutlet, Tag("<box>")] | Annotated[BeyondOutlet, Tag("<beyond>")],
    chosen(
        one_of(box=BoxOutlet, beyond=BeyondOutlet),
        "it must be {box: {min: [..], max: [..]}} or {beyond: {point: [..], normal: [..], radius: ..}}",
    ),
]
