"""Block `outlets`: regions in which particles are deleted and counted. A kind of outlet is one class below.

A class has the keys of the kind, the numbers that the device reads, the device function that finds particles
inside at neighbor-list rebuilds, and the depth in numpy, by which the host finds the outlet that has deleted
a particle. `Outlet` at the end lists the kinds.
"""

from collections.abc import Callable, Collection
from math import inf
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from granflow.device_functions import ti
from granflow.geometry.vectors import unit
from granflow.scene.blocks.primitives import Box
from granflow.schema import quantities as q
from granflow.schema.model import Model, choose_by_first_key


class OutletRegion(Model):
    """A region in which an outlet deletes particles. Base class of the kinds.

    `kind`: key of the kind. `thickness` [m]: smallest extent, which a particle must not cross between two
    rebuilds.
    """

    kind: ClassVar[str]

    def numbers(self) -> dict[str, float | np.ndarray]:
        """What the device reads, by name: scalars and vectors (3,), in SI units."""
        raise NotImplementedError

    def build_contains(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """Device function (point): true if the point [m] is inside.

        `numbers`: for each name in `numbers()` a device function () that reads the value.
        """
        raise NotImplementedError

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Depth [m] (n,) of points (n, 3) [m] inside: distance from the surface, negative outside.

        Outside near an edge, the absolute value is a lower bound of the distance.
        """
        raise NotImplementedError

    @property
    def thickness(self) -> float:
        """Smallest extent [m]; infinite by default."""
        return inf


class BoxOutlet(OutletRegion):
    """Particles whose center is in a box are deleted at the next rebuild of the neighbor list.

    >>> gf.BoxOutlet(box=gf.Box(min=[0, 0, -0.2], max=[0.1, 0.1, -0.1])).box.min
    (0.0, 0.0, -0.2)
    """

    kind = "box"
    box: Box = Field(description="a box along the coordinate axes, {min: [..], max: [..]}")

    def numbers(self) -> dict[str, float | np.ndarray]:
        """The corners."""
        return {"low": np.array(self.box.min), "high": np.array(self.box.max)}

    def build_contains(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """See `OutletRegion`."""

        @ti.func
        def in_box(p):
            is_inside = True
            lows = numbers.low()
            highs = numbers.high()
            for axis in ti.static(range(3)):
                is_inside = is_inside & (p[axis] >= lows[axis]) & (p[axis] <= highs[axis])
            return is_inside

        return in_box

    def depth(self, points: np.ndarray) -> np.ndarray:
        """See `OutletRegion`."""
        return np.asarray(np.minimum(points - self.box.min, np.array(self.box.max) - points).min(axis=1))

    @property
    def thickness(self) -> float:
        """Smallest edge [m]."""
        return float(np.subtract(self.box.max, self.box.min).min())


class HalfSpaceGiven(Model):
    """All points on one side of a plane."""

    point: q.Point = Field(description="a point on the plane [m]")
    normal: q.Direction = Field(
        description="normal of the plane, toward the half space; its length does not matter"
    )


class HalfSpaceOutlet(OutletRegion):
    """Particles whose center is in a half space are deleted at the next rebuild of the neighbor list.

    >>> gf.HalfSpaceOutlet(half_space={"point": [0, 0, -0.1], "normal": [0, 0, -1]}).half_space.point
    (0.0, 0.0, -0.1)
    """

    kind = "half_space"
    half_space: HalfSpaceGiven = Field(description="a half space, {point: [..], normal: [..]}")

    def numbers(self) -> dict[str, float | np.ndarray]:
        """The plane."""
        return {"point": np.array(self.half_space.point), "normal": unit(self.half_space.normal)}

    def build_contains(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """See `OutletRegion`."""

        @ti.func
        def in_half_space(p):
            return (p - numbers.point()).dot(numbers.normal()) >= 0.0

        return in_half_space

    def depth(self, points: np.ndarray) -> np.ndarray:
        """See `OutletRegion`."""
        return np.asarray((points - np.array(self.half_space.point)) @ unit(self.half_space.normal))


class DiscGiven(Model):
    """The semi-infinite cylinder on the downstream side of a disc."""

    center: q.Point = Field(description="center of the disc [m]")
    normal: q.Direction = Field(
        description="normal of the disc, in the direction of the particle flow; its length does not matter"
    )
    radius: q.PositiveLength = Field(description="radius of the disc [m]")


class DiscOutlet(OutletRegion):
    """Particles whose center is in the semi-infinite cylinder downstream of a disc are deleted at the next
    rebuild.

    >>> gf.DiscOutlet(disc={"center": [0, 0, 0], "normal": [0, 0, -1], "radius": "2 cm"}).disc.radius
    0.02
    """

    kind = "disc"
    disc: DiscGiven = Field(description="a disc, {center: [..], normal: [..], radius: ..}")

    def numbers(self) -> dict[str, float | np.ndarray]:
        """The plane of the disc, and its radius."""
        disc = self.disc
        return {"point": np.array(disc.center), "normal": unit(disc.normal), "radius": disc.radius}

    def build_contains(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """See `OutletRegion`."""

        @ti.func
        def in_cylinder(p):
            from_point = p - numbers.point()
            direction = numbers.normal()
            along = from_point.dot(direction)
            radial = from_point - along * direction
            return along >= 0.0 and radial.dot(radial) <= numbers.radius() * numbers.radius()

        return in_cylinder

    def depth(self, points: np.ndarray) -> np.ndarray:
        """See `OutletRegion`."""
        normal = unit(self.disc.normal)
        from_point = points - np.array(self.disc.center)
        along = from_point @ normal
        across = np.linalg.norm(from_point - along[:, None] * normal, axis=1)
        return np.asarray(np.minimum(along, self.disc.radius - across))

    @property
    def thickness(self) -> float:
        """Diameter [m]."""
        return 2.0 * self.disc.radius


Outlet = Annotated[
    BoxOutlet | HalfSpaceOutlet | DiscOutlet,
    choose_by_first_key(
        "it must be {box: {min: [..], max: [..]}}, {half_space: {point: [..], normal: [..]}} or "
        "{disc: {center: [..], normal: [..], radius: ..}}"
    ),
]
"""An outlet of any kind, selected by its key."""


def outlet_of(outlets: Collection[OutletRegion], position: np.ndarray, in_domain: np.ndarray) -> np.ndarray:
    """Index of the outlet that deleted each particle (n,), -1 for none: the outlet with the largest depth.

    `position` (n, 3) [m]; `in_domain` (n,) bool. A deleted particle inside the domain is always in an outlet,
    except for rounding. The order of the outlets decides between equal depths.
    """
    if not outlets:
        return np.full(len(position), -1)
    depth = np.stack([outlet.depth(position) for outlet in outlets])
    return np.where(in_domain | (depth.max(axis=0) >= 0.0), depth.argmax(axis=0), -1)
