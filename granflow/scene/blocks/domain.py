"""Block `domain`: the simulated box, its boundaries, and what happens to particles that leave it."""

from collections.abc import Iterator
from itertools import product
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from granflow.geometry.periodic_box import AXES, ImageMotion, PeriodicBox
from granflow.scene.blocks.deformation import Deformation
from granflow.scene.blocks.primitives import Box
from granflow.schema import quantities as q
from granflow.schema.faults import Fault
from granflow.schema.model import ListOf, Model, optional
from granflow.schema.quantities import Number

Axis = Literal["x", "y", "z"]
ShearRate = Annotated[float, Number("rate", noun="a shear rate")]
"""Shear rate [1/s] of either sign."""


class LeesEdwards(Model):
    """Lees-Edwards boundary conditions: uniform shear without walls; the periodic images move along the flow
    axis.

        velocity of the image above = rate * width of the box along the gradient axis      [m/s]

    Walls, flow meters and insertion during the run are not supported.

    >>> gf.LeesEdwards(flow="x", gradient="z", rate="10 1/s")
    LeesEdwards(flow='x', gradient='z', rate=10.0)
    """

    flow: Axis = Field(description="flow axis, the direction of the velocity")
    gradient: Axis = Field(description="gradient axis, along which the velocity changes")
    rate: ShearRate = Field(description="shear rate, change of velocity per length [1/s]; may be negative")
    start: q.Time = Field(0.0, description="time at which the shear begins [s]", examples=["0.2 s"])

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the flow and gradient axes differ."""
        if self.flow == self.gradient:
            yield Fault(("gradient",), "flow is the same axis; give another axis")


class Domain(Box):
    """The simulated box: particles outside are deleted, wrapped (periodic axes) or followed, or end the run.

    Walls may extend beyond it.

    >>> gf.Domain(min=[0, 0, 0], max=[0.1, 0.1, 0.1], periodic=["x", "y"], on_exit="delete").periodic
    ('x', 'y')
    """

    periodic: Annotated[tuple[Axis, ...], ListOf(one=True)] = Field(
        (), description="axes with periodic boundary conditions, such as [x, y]", examples=[["x", "y"]]
    )
    lees_edwards: LeesEdwards | None = Field(
        None, description="uniform shear with Lees-Edwards boundary conditions; both axes must be periodic"
    )
    deformation: Deformation | None = optional(
        "strain rate or target pressure of each periodic axis that changes its width, until a stage gives "
        "another deformation",
        "constant widths",
        examples=[{"z": {"strain_rate": "-1 1/s"}}],
    )
    on_exit: Literal["delete", "error", "expand"] = Field(
        description=(
            "action if the center of a particle leaves the domain: delete (and count), error (abort the "
            "run), or expand (enlarge the domain)"
        )
    )

    @property
    def diagonal(self) -> float:
        """Length [m] of the diagonal."""
        return float(np.linalg.norm(np.subtract(self.max, self.min)))

    @property
    def corners(self) -> np.ndarray:
        """Corners (8, 3) [m]."""
        return np.array(list(product(*zip(self.min, self.max, strict=True))))

    def periodic_box(self) -> PeriodicBox:
        """The periodic box of the domain at the start."""
        low = np.array(self.min)
        width = np.subtract(self.max, self.min)
        given = self.lees_edwards
        image_motion = None
        if given is not None:
            flow = AXES.index(given.flow)
            gradient = AXES.index(given.gradient)
            image_motion = ImageMotion(flow, gradient, given.rate * float(width[gradient]), given.start)
        return PeriodicBox(tuple(AXES.index(axis) for axis in self.periodic), low, width, image_motion)

    @property
    def image_speed(self) -> float:
        """Speed [m/s] of the images across a sheared boundary: shear rate times box width; 0 without."""
        image_motion = self.periodic_box().image_motion
        return 0.0 if image_motion is None else abs(image_motion.speed)

    def faults(self) -> Iterator[Fault]:
        """Yield faults of an empty volume, repeated periodic axes, and shear along other axes."""
        yield from super().faults()
        for index, axis in enumerate(self.periodic):
            if axis in self.periodic[:index]:
                yield Fault(("periodic", index), "this axis is a duplicate; give each axis once")
        for key in ("flow", "gradient") if self.lees_edwards else ():
            if getattr(self.lees_edwards, key) not in self.periodic:
                reason = "domain.periodic does not contain this axis; both axes must be periodic"
                yield Fault(("lees_edwards", key), reason)
