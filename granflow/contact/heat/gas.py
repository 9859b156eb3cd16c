"""Conduction through the stagnant gas around a contact and across a small gap (Rong & Horio 1999).

Each particle has a film of gas whose thickness is a share x of its radius. Heat crosses the gas on parallel
paths from surface to surface, at the distances r from the line of centers from that at which the surfaces
touch to that at which the outside of the larger film meets the surface of the smaller particle:

    Q = k_g (T_j - T_i) int 2 pi r dr / (l + p (D - l)),     l = max(D - w, s)
    w = sqrt(R_i^2 - r^2) + sqrt(R_j^2 - r^2)

D is the distance of the centers, w the length of a path in the two particles, s the smallest gap, that of
rough surfaces. p is k_g / k with the harmonic mean k of the conductivities, or 0 without the resistance of
the solid, as in MFiX-DEM. A wall has no film and, for its temperature is that of its surface, no path in it:
D is the distance of the center from it, w = sqrt(R^2 - r^2), p = k_g / k_i.

The integral has a closed form. With w for r, c = (R_i^2 - R_j^2)^2 and b = 1 - p,

    2 pi r dr = -pi/2 (w - c / w^3) dw,     4 w^2 r^2 = (w^2 - (R_i - R_j)^2) ((R_i + R_j)^2 - w^2)
    int w dw / (D - b w)         = -w/b - D/b^2 ln(D - b w)
    int dw / (w^3 (D - b w))     = -1/(2 D w^2) - b/(D^2 w) + b^2/D^3 ln(w / (D - b w))

The distance D of overlapping softened particles is that of the overlap of their real moduli at the same force
(Morris et al. 2016).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from granflow.device_functions import logarithm, ti
from granflow.schema import quantities as q
from granflow.schema.model import Flag, Model
from granflow.schema.quantities import Number

GAS_SOURCE = (
    "gas: Rong & Horio 1999, Second Int. Conf. on CFD in the Minerals and Process Industries, Melbourne, 65; "
    "Morris et al. 2016, AIChE J. 62:4526, doi 10.1002/aic.15331"
)


class StagnantGas(Model):
    """Keys of the gas."""

    conductivity: q.ThermalConductivity = Field(
        description="thermal conductivity of the gas [W/m/K]", examples=["0.026 W/m/K"]
    )
    min_gap: q.UnscaledLength = Field(
        description="smallest gap [m] of the surfaces on a path through the gas, at and near contacts: about "
        "their roughness, or the mean free path of the gas if this is larger",
        examples=["1 um"],
    )
    film: Annotated[float, Number(noun="a film", above=0, at_most=1)] = Field(
        0.4,
        description="thickness of the film of gas of a particle over its radius; heat crosses the gas where "
        "the film of the larger particle reaches the other one",
        examples=["0.4"],
    )
    solid_resistance: Flag = Field(
        True,
        description="true: a path has the resistance of its length in the particles, too; false: that of the "
        "gas only, as in MFiX-DEM",
    )


@dataclass(frozen=True)
class Gas:
    """The numbers of `StagnantGas`; a conductivity of 0 is no gas.

    reach:  largest distance [m] between surfaces across which heat flows
    """

    conductivity: float = 0.0
    min_gap: float = 0.0
    film: float = 0.0
    solid_resistance: bool = False
    reach: float = 0.0

    @classmethod
    def of(cls, given: StagnantGas | None, radius_max: float) -> "Gas":
        """The numbers that a scene gives, for particles up to a radius [m]."""
        if given is None:
            return cls()
        film = given.film
        return cls(given.conductivity, given.min_gap, film, given.solid_resistance, film * radius_max)

    @property
    def is_present(self) -> bool:
        """Whether there is gas."""
        return self.conductivity > 0.0

    @property
    def parameters(self) -> Mapping[str, float]:
        """Numbers for the device, if there is gas."""
        if not self.is_present:
            return {}
        return {"gas_conductivity": self.conductivity, "min_gap": self.min_gap, "film": self.film}

    def resistance_ratio(self, conductivity: float) -> float:
        """p of a solid [W/(m K)]: resistance of a path in it over that in the gas."""
        return self.conductivity / conductivity if self.solid_resistance and conductivity else 0.0

    def largest_conductance(self, radius: float) -> float:
        """Bound [W/K] of the conductance of a particle with a wall or a larger particle.

        At contact with a wall, without the resistance of the solid, up to the radius R instead of the film:

            2 pi k_g R (1 + ln(R / s))
        """
        if not self.is_present:
            return 0.0
        return 2.0 * math.pi * self.conductivity * radius * (1.0 + math.log(max(radius / self.min_gap, 1.0)))


@ti.func
def gas_conductance(constants, overlap, first, partner):
    """Conductance [W/K] of the gas between two particles.

    constants:  parameters of `Gas`, and `resistance_ratio`
    overlap:    that of the real moduli [m], or minus the distance of the surfaces
    """
    radius = ti.max(ti.cast(first.radius, ti.f64), ti.cast(partner.radius, ti.f64))
    smaller = ti.min(ti.cast(first.radius, ti.f64), ti.cast(partner.radius, ti.f64))
    gap = ti.cast(constants.min_gap, ti.f64)
    ratio = ti.cast(constants.resistance_ratio, ti.f64)
    sum_squared = (radius + smaller) * (radius + smaller)
    difference_squared = (radius - smaller) * (radius - smaller)
    distance = radius + smaller - ti.cast(overlap, ti.f64)
    lens = (1.0 + ti.cast(constants.film, ti.f64)) * radius
    outer = (
        (distance * distance - (lens - smaller) * (lens - smaller))
        * ((lens + smaller) * (lens + smaller) - distance * distance)
        / (4.0 * distance * distance)
    )
    outer = ti.min(ti.max(outer, 0.0), smaller * smaller)
    if distance * distance + smaller * smaller < lens * lens:  # the film covers half of the smaller particle
        outer = smaller * smaller
    # Lengths w of paths: where the film ends, where the surfaces touch, where the gap is the smallest one.
    touching = ti.min(radius + smaller, distance)
    far = ti.min(ti.sqrt(radius * radius - outer) + ti.sqrt(smaller * smaller - outer), touching)
    far = ti.max(far, SHORTEST_PATH * smaller)
    near = ti.max(ti.min(touching, distance - gap), far)
    area = math.pi * (
        squared_distance_from_axis(near, sum_squared, difference_squared)
        - squared_distance_from_axis(touching, sum_squared, difference_squared)
    )
    b = 1.0 - ratio
    log_length = logarithm((distance - b * far) / (distance - b * near))
    log_w = logarithm(near / far)
    squared = distance * distance
    linear = distance / (b * b) * log_length - (near - far) / b
    cubic = (
        0.5 / distance * (1.0 / (far * far) - 1.0 / (near * near))
        + b / squared * (1.0 / far - 1.0 / near)
        + b * b / (squared * distance) * (log_w + log_length)
    )
    integral = area / (gap + ratio * (distance - gap))
    integral += 0.5 * math.pi * (linear - sum_squared * difference_squared * cubic)
    return ti.cast(constants.gas_conductivity, ti.f64) * integral


SHORTEST_PATH = 1e-6
"""Length of the shortest path in two particles over the radius of the smaller one; the closed form divides by
it, in a term that is 0 for equal radii."""


@ti.func
def squared_distance_from_axis(w, sum_squared, difference_squared):
    """r^2 [m2] of a path of the length w [m] in two particles; from (R_i + R_j)^2 and (R_i - R_j)^2 [m2]."""
    return (w * w - difference_squared) * (sum_squared - w * w) / (4.0 * w * w)


@ti.func
def gas_conductance_of_wall(constants, overlap, first):
    """Conductance [W/K] of the gas between a particle and a wall, as `gas_conductance`.

    constants:  has `wall_resistance_ratio`
    """
    radius = ti.cast(first.radius, ti.f64)
    gap = ti.cast(constants.min_gap, ti.f64)
    ratio = ti.cast(constants.wall_resistance_ratio, ti.f64)
    distance = radius - ti.cast(overlap, ti.f64)
    lens = (1.0 + ti.cast(constants.film, ti.f64)) * radius
    outer = ti.min(ti.max(lens * lens - distance * distance, 0.0), radius * radius)
    touching = ti.min(radius, distance)
    far = ti.min(ti.sqrt(radius * radius - outer), touching)
    near = ti.max(ti.min(touching, distance - gap), far)
    area = math.pi * (touching * touching - near * near)
    b = 1.0 - ratio
    log_length = logarithm((distance - b * far) / (distance - b * near))
    integral = area / (gap + ratio * (distance - gap))
    integral += 2.0 * math.pi * (distance / (b * b) * log_length - (near - far) / b)
    return ti.cast(constants.gas_conductivity, ti.f64) * integral
