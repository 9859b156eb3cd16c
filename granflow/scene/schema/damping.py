"""Schema of the block `damping`: damping of all motion, for settling."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from granflow.scene.schema.faults import Fault, whole
from granflow.scene.schema.fields import Model, Names
from granflow.scene.schema.numbers import Number

LARGEST_CUNDALL = 0.95
"""Largest Cundall ratio: at 1 the force on a moving particle never accelerates it."""

CundallRatio = Annotated[float, Number(noun="a damping ratio", above=0, at_most=LARGEST_CUNDALL)]
DragRate = Annotated[float, Number("rate", noun="a drag rate", above=0)]


class Damping(Model):
    """Damping of the translation and rotation of all particles, to bring a packing to rest faster.

    Not part of the physics of a granular material: limit it to the stages in which particles settle.

        F_k = -cundall |F_k| sign(v_k) - drag m v_k      for each component k; the same for torques

    >>> gf.Damping(cundall=0.5, stages=["settle"])
    Damping(cundall=0.5, stages=('settle',))
    """

    cundall: CundallRatio | None = Field(
        None, description="ratio of the non-viscous damping force (Cundall) to the total force, by component"
    )
    drag: DragRate | None = Field(
        None, description="rate of a viscous background drag [1/s]: velocities decay as exp(-drag t)"
    )
    stages: Names | None = Field(None, description="stages in which the damping acts; default: all")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless one kind of damping is given."""
        if self.cundall is None and self.drag is None:
            yield whole((), "has no effect: give cundall, such as 0.5, or drag, such as 20 1/s")
