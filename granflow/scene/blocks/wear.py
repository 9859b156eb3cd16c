"""Key `wear` of walls: a law of wear is one class below, with its keys and its power on the device.

The worn volume is

    V = sum over contacts of the integral of (k / H) P dt

with the coefficient k of the material of the particle, the hardness H of the wall, and the power P [W] of the
law. Every law also has the normal and the tangential work of the contacts (`engine/wear.py`). Wear does not
change the surface of the wall.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, Tag

from granflow.device_functions import ti
from granflow.schema import quantities as q
from granflow.schema.model import Model, Name, choose_by, choose_by_key
from granflow.schema.quantities import Number

Coefficient = Annotated[float, Number(noun="a wear coefficient", at_least=0)]
CoefficientOrMany = Annotated[
    Annotated[Coefficient, Tag("<one>")] | Annotated[dict[Name, Coefficient], Tag("<materials>")],
    choose_by(
        lambda value: "<materials>" if isinstance(value, dict) else "<one>",
        "a number or a mapping of materials of particles is expected, such as {sand: 1e-4}",
    ),
]
"""One coefficient for all particles, or one for each of their materials by name."""
_COEFFICIENT: Any = Field(
    description="dimensionless coefficient k, or a mapping with one for each material of the particles",
    examples=[1e-4],
)
_HARDNESS: Any = Field(description="hardness H of the surface of the wall [Pa]", examples=["2 GPa"])


class WallWear(Model):
    """A law of wear. Base class of the kinds."""

    has_volume: ClassVar[bool] = True
    """False if the law has works only."""

    law: str = Field(description="law of wear")

    def volume_per_work(self, material: str) -> float:
        """k / H [1/Pa] for particles of a material."""
        return 0.0

    @property
    def materials(self) -> Sequence[str] | None:
        """The materials of particles that the law names; None if it is the same for all."""
        return None

    @staticmethod
    def build_power() -> Callable[..., Any]:
        """Device function (load): the power P [W]. `load` is a struct of one contact, in f64:

        force:          magnitude of the contact force [N]
        normal_force:   component that presses the particle on the wall [N], 0 if the contact pulls
        slip_speed:     speed [m/s] at which the surface of the particle slides over the wall
        approach:       component of the velocity of the particle's center toward the wall [m/s]
        passing_speed:  magnitude of the other component [m/s], along the wall
        """
        raise NotImplementedError


class VolumeWear(WallWear):
    """A law that gives a volume. Base class."""

    coefficient: CoefficientOrMany = _COEFFICIENT
    hardness: q.Pressure = _HARDNESS

    def volume_per_work(self, material: str) -> float:
        """See `WallWear`."""
        given = self.coefficient[material] if isinstance(self.coefficient, Mapping) else self.coefficient
        return given / self.hardness

    @property
    def materials(self) -> Sequence[str] | None:
        """See `WallWear`."""
        return tuple(self.coefficient) if isinstance(self.coefficient, Mapping) else None


class ArchardWear(VolumeWear):
    """Sliding wear (Archard 1953): the worn volume is k / H times normal force times sliding distance.

        P = F_n v_t        F_n: normal force,  v_t: sliding speed of the surfaces at the contact

    >>> gf.ArchardWear(coefficient=1e-4, hardness="2 GPa").hardness
    2000000000.0
    """

    law: Literal["archard"] = Field("archard", description="law of wear")

    @staticmethod
    def build_power() -> Callable[..., Any]:
        """See `WallWear`."""

        @ti.func
        def archard(load):
            return load.normal_force * load.slip_speed

        return archard


class FinnieWear(VolumeWear):
    """Erosion by impacts at an angle (Finnie 1960), as `wear finnie` of LIGGGHTS, with k_finnie = k / H.

        P = 2 F v f(a)       F: contact force,  v: speed of the particle,  a: angle of its path with the wall
        f(a) = sin 2a - 3 sin^2 a  if tan a <= 1/3,  otherwise cos^2 a / 3;  0 while the particle moves away

    >>> gf.FinnieWear(coefficient={"sand": 0.1}, hardness="1 GPa").coefficient
    {'sand': 0.1}
    """

    law: Literal["finnie"] = Field("finnie", description="law of wear")

    @staticmethod
    def build_power() -> Callable[..., Any]:
        """See `WallWear`."""

        @ti.func
        def finnie(load):
            speed = ti.sqrt(load.approach * load.approach + load.passing_speed * load.passing_speed)
            power = 0.0 * load.force
            if load.approach >= 0.0 and speed > 0.0:
                sine = load.approach / speed
                cosine = load.passing_speed / speed
                share = cosine * cosine / 3.0
                if 3.0 * sine <= cosine:
                    share = 2.0 * sine * cosine - 3.0 * sine * sine
                power = 2.0 * load.force * speed * share
            return power

        return finnie


class RelativeWear(WallWear):
    """No volume: only the normal and the tangential work of the contacts, for comparison between places.

    >>> gf.RelativeWear().has_volume
    False
    """

    has_volume: ClassVar[bool] = False

    law: Literal["relative"] = Field("relative", description="law of wear")

    @staticmethod
    def build_power() -> Callable[..., Any]:
        """See `WallWear`."""

        @ti.func
        def nothing(load):
            return 0.0 * load.force

        return nothing


WearSpec = Annotated[ArchardWear | FinnieWear | RelativeWear, choose_by_key("law")]
"""Any law of wear; the key `law` selects it."""
