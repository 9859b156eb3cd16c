"""Cases of the paper (Zhou 2011): two equal spheres of one material, with the closed forms of their collision."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from granflow.contact import theory
from granflow.contact.material import Solid, VelocityRestitution, limit_velocity, modulus_eff
from granflow.geometry.sphere import sphere_mass
from granflow.scene.schema.presets import PRESETS
from granflow.studies.head_on import HeadOnCollision

DIAMETER = 25.4e-3
"""Diameter of the spheres in Figs. 3 and 4 [m] (Stevens & Hrenya 2005)."""

STEPS_PER_CONTACT = 200
"""Ratio of collision duration to time step for the reported deviations."""


@dataclass(frozen=True)
class PaperCase:
    """Two equal spheres of one solid.

    `material` as in a scene; `fit`: e(v) of Zhou (2011), Eq. 12; `yield_velocity` [m/s] for Thornton's e(v); `diameter`
    [m].
    """

    name: str
    title: str
    solid: Solid
    material: Mapping[str, Any]
    fit: VelocityRestitution | None = None
    yield_velocity: float | None = None
    diameter: float = DIAMETER

    @cached_property
    def modulus_eff(self) -> float:
        """Effective modulus of the pair [Pa]."""
        return modulus_eff(self.solid, self.solid)

    def mass_eff(self, diameter: float | None = None) -> float:
        """Effective mass [kg] of two equal spheres: half the mass of one."""
        return 0.5 * sphere_mass(0.5 * (diameter or self.diameter), self.solid.density)

    def stiffness(self, diameter: float | None = None) -> float:
        """Hertz stiffness k [N/m^1.5]; the effective radius is a quarter of the diameter."""
        return float(theory.hertz_stiffness(self.modulus_eff, 0.25 * (diameter or self.diameter)))

    def duration(self, e: float, velocity: float, diameter: float | None = None) -> float:
        """Collision duration [s] for a restitution `e`, an approach velocity [m/s] and a diameter [m] (Eq. 13)."""
        return float(theory.duration(e, self.stiffness(diameter), self.mass_eff(diameter), velocity))

    def durations(self, e: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Collision durations (n,) [s] at the diameter of the case, for restitutions (n,) and velocities (n,) [m/s]."""
        return np.array([self.duration(float(a), float(v)) for a, v in zip(e, velocity, strict=True)])

    def springs(self, velocity: np.ndarray) -> np.ndarray:
        """Stiffness (n,) [N/m] of the linear spring with the same energy at velocities (n,) [m/s] (Eq. 19)."""
        return np.asarray(theory.equivalent_spring(self.stiffness(), self.mass_eff(), velocity))

    def diameter_lasting(self, duration: float, e: float, velocity: float) -> float:
        """Diameter [m] of spheres with the given collision duration [s], which is proportional to the diameter."""
        return self.diameter * duration / self.duration(e, velocity)

    def head_on(self, restitution: Any, velocity: float, diameter: float | None = None) -> HeadOnCollision:
        """Head-on collision of the case at a velocity [m/s]; `restitution` as in a scene."""
        return HeadOnCollision(self.material, restitution, diameter or self.diameter, velocity)


def paper_case(preset: str, title: str, yield_velocity: float) -> PaperCase:
    """Case with one of the materials of Figs. 3 and 4.

    `preset`: name of the material; the limit velocity of Eq. 12 is that of Eq. 11. `yield_velocity` [m/s].
    """
    known = PRESETS[preset]
    solid = Solid(known.young_modulus, known.poisson_ratio, known.density, known.yield_strength)
    sigma, psi = known.restitution_fit or (0.0, 1.0)
    fit = VelocityRestitution(sigma, psi, limit_velocity(solid, solid))
    return PaperCase(preset, title, solid, {"preset": preset}, fit, yield_velocity)


PAPER_CASES = (
    paper_case("stainless_316", "stainless steel 316", 0.0082),
    paper_case("chrome_52100", "chrome steel 52100", 0.9090),
)
"""Yield velocities [m/s] of the paper, from Stevens & Hrenya (2005)."""


def small_soft_case() -> PaperCase:
    """Spheres of the estimate below Eq. 19: 1e-4 m, 1e8 Pa, 1e3 kg/m3; no Poisson ratio is given, 0.3 is chosen."""
    solid = Solid(1e8, 0.3, 1e3)
    material = {"young_modulus": 1e8, "poisson_ratio": 0.3, "density": 1e3}
    return PaperCase("estimate", "R = 0.1 mm, E = 0.1 GPa", solid, material, diameter=2e-4)
