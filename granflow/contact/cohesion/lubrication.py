"""Viscous force of the liquid in a bridge, for the models of liquid bridges.

    F_n = 6 pi eta R^2 v_n / h                            (Adams & Perchard 1985)
    F_t = 6 pi eta R v_t [8/15 ln(R / h) + 0.9588]        (Goldman, Cox & Brenner 1967)

R is the effective radius, eta the viscosity, h the distance of the surfaces, at least a share of R: that at
which their roughness touches. Both resist the velocities of the surfaces. The second formula is 0 beyond
h = 6.03 R, where the bracket would change its sign; bridges are shorter.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from granflow.contact.law import ContactState, Options
from granflow.device_functions import logarithm, ti
from granflow.schema.model import Model, optional
from granflow.schema.quantities import Number

LOGARITHMIC, CONSTANT = 8.0 / 15.0, 0.9588
"""Coefficients of the tangential force."""
VISCOUS_SOURCE = (
    "viscous force: Adams & Perchard 1985, IChemE Symp. Ser. 91:147; Goldman, Cox & Brenner 1967, Chem. Eng. "
    "Sci. 22:637, as in Nase et al. 2001, Powder Technol. 116:214"
)


class ViscousForce(Model):
    """Viscous force of the liquid."""

    viscosity: Annotated[float, Number("viscosity", noun="a viscosity", above=0)] = Field(
        description="dynamic viscosity of the liquid [Pa s]", examples=["1 mPa s"]
    )
    min_separation_ratio: Annotated[float, Number(noun="a fraction", above=0, at_most=1)] = Field(
        description="smallest distance of the surfaces in the formulas over the effective radius; about the "
        "roughness over the radius",
        examples=["0.01"],
    )


class ViscousOptions(Options):
    """Option of the models of liquid bridges."""

    viscous_force: ViscousForce | None = optional(
        "viscous force of the liquid",
        "none",
        examples=[{"viscosity": "1 mPa s", "min_separation_ratio": 0.01}],
    )


@dataclass(frozen=True)
class Lubrication:
    """The numbers of `ViscousForce`; a viscosity of 0 is no viscous force."""

    viscosity: float = 0.0
    min_separation_ratio: float = 1.0

    @classmethod
    def of(cls, given: ViscousForce | None) -> "Lubrication":
        """The numbers that a scene gives."""
        return cls() if given is None else cls(given.viscosity, given.min_separation_ratio)

    @property
    def acts(self) -> bool:
        """Whether there is a viscous force."""
        return self.viscosity > 0.0

    @property
    def parameters(self) -> dict[str, float]:
        """Numbers for the device, if there is a viscous force."""
        if not self.acts:
            return {}
        return {"viscosity": self.viscosity, "min_separation_ratio": self.min_separation_ratio}

    def resistance(self, radius_eff: float) -> tuple[float, float]:
        """Ratios of force to velocity [N s/m] at the smallest distance, normal and tangential."""
        stokes = 6.0 * math.pi * self.viscosity * radius_eff
        bracket = LOGARITHMIC * math.log(1.0 / self.min_separation_ratio) + CONSTANT
        return stokes / self.min_separation_ratio, stokes * bracket

    def reference(self, contact: ContactState) -> tuple[float, np.ndarray]:
        """Reference implementation of `lubrication_force`."""
        radius = contact.radius_eff
        h = max(-contact.overlap, self.min_separation_ratio * radius)
        normal = 6.0 * math.pi * self.viscosity * radius**2 * contact.overlap_rate / h
        bracket = max(LOGARITHMIC * math.log(radius / h) + CONSTANT, 0.0)
        return normal, -6.0 * math.pi * self.viscosity * radius * bracket * contact.slip_rate


@ti.func
def lubrication_force(constants, contact):
    """Normal and tangential viscous force [N], see `CohesionLaw.viscous_force`; `constants` with
    `Lubrication.parameters`."""
    stokes = 6.0 * math.pi * constants.viscosity * contact.radius_eff
    ratio = contact.radius_eff / ti.max(-contact.overlap, constants.min_separation_ratio * contact.radius_eff)
    bracket = ti.max(LOGARITHMIC * logarithm(ratio) + CONSTANT, 0.0)
    return stokes * ratio * contact.overlap_rate, -stokes * bracket * contact.slip_rate
