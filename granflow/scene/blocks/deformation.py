"""Block `deformation` of the domain and of stages: periodic boxes whose widths change.

Each periodic axis has either a strain rate or a target pressure, which the strain rate follows:

    rate = gain (P - target),    |rate| <= max_rate        dW/dt = rate W

with the width W of the box and the pressure P of the contacts along the axis, positive in compression. A
positive rate extends the box. (Similar: `fix deform/pressure` of LAMMPS; `PeriTriaxController` of YADE.) The
device code is `engine/deformation.py`.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated

from pydantic import Field

from granflow.schema.faults import Fault, missing, whole
from granflow.schema.model import Model, optional
from granflow.schema.quantities import Number, RatePerPressure

StrainRate = Annotated[float, Number("rate", noun="a strain rate")]
LargestRate = Annotated[float, Number("rate", noun="a strain rate", above=0)]
AxialPressure = Annotated[float, Number("pressure", noun="a pressure")]


class AxisDeformation(Model):
    """Deformation of a periodic box along one axis: a strain rate, or a pressure that controls it.

    >>> gf.AxisDeformation(pressure="100 kPa")
    AxisDeformation(pressure=100000.0)
    """

    strain_rate: StrainRate | None = Field(
        None,
        description="rate of the logarithmic strain [1/s]; a negative rate compresses",
        examples=["-1 1/s"],
    )
    pressure: AxialPressure | None = Field(
        None,
        description=(
            "target of the mean normal stress of the contacts along the axis [Pa], positive in compression"
        ),
        examples=["100 kPa"],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of strain rate and pressure is given."""
        if (self.strain_rate is None) == (self.pressure is None):
            found = "neither strain_rate nor" if self.pressure is None else "both strain_rate and"
            yield whole((), f"has {found} pressure; give one of them, such as pressure: 100 kPa")


class Deformation(Model):
    """Deformation of a periodic box: a strain rate or a target pressure for each axis that changes its width.

    The lower corner of the box stays at its place; particles move with the box affinely, and by their contact
    forces in addition.

    >>> gf.Deformation(z={"strain_rate": "-1 1/s"}).z.strain_rate
    -1.0
    """

    x: AxisDeformation | None = optional("deformation along x", "constant width")
    y: AxisDeformation | None = optional("deformation along y", "constant width")
    z: AxisDeformation | None = optional(
        "deformation along z", "constant width", examples=[{"strain_rate": "-1 1/s"}]
    )
    max_rate: LargestRate | None = Field(
        None,
        description="with pressure: largest magnitude of the strain rate of these axes [1/s]",
        examples=["5 1/s"],
    )
    gain: RatePerPressure | None = optional(
        "with pressure: strain rate over the deviation from the target [1/(Pa s)]",
        "T / (rho d^2), with the shortest loading or unloading time and the largest density and diameter",
        examples=["1e-4 1/(Pa s)"],
    )

    @property
    def by_axis(self) -> Mapping[str, AxisDeformation]:
        """The axes that change their width."""
        given = {"x": self.x, "y": self.y, "z": self.z}
        return {axis: each for axis, each in given.items() if each is not None}

    def largest_rate(self, axis: str) -> float:
        """Largest magnitude of the strain rate along an axis [1/s]."""
        given = self.by_axis.get(axis)
        if given is None:
            return 0.0
        return (self.max_rate or 0.0) if given.strain_rate is None else abs(given.strain_rate)

    def faults(self) -> Iterator[Fault]:
        """Yield faults of a deformation without axes, and of numbers of the control."""
        if not self.by_axis:
            yield whole((), "has no axis; give at least one, such as z: {strain_rate: -1 1/s}")
        has_pressure = any(each.pressure is not None for each in self.by_axis.values())
        if has_pressure and self.max_rate is None:
            yield missing(("max_rate",), "the largest strain rate of axes with pressure, such as 5 1/s")
        for key in ("max_rate", "gain"):
            if getattr(self, key) is not None and self.by_axis and not has_pressure:
                yield Fault((key,), f"it requires an axis with pressure; remove {key}")
