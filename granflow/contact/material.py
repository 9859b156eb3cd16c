"""Material and pair properties for contact models: plain float64 numbers, no fields.

SI units throughout. Symbols as in Zhou (2011).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np


class Solid(Protocol):
    """Elastic and plastic constants of one material, as those of the block `materials` of a scene."""

    @property
    def young_modulus(self) -> float:
        """Young's modulus [Pa]."""

    @property
    def poisson_ratio(self) -> float:
        """Poisson ratio."""

    @property
    def density(self) -> float:
        """Density [kg/m3]."""

    @property
    def yield_strength(self) -> float | None:
        """Yield strength [Pa]; None if the material never yields."""

    @property
    def shear_modulus(self) -> float:
        """Shear modulus [Pa], G = E / (2 (1 + nu))."""


@dataclass(frozen=True)
class VelocityRestitution:
    """Restitution coefficient that decreases with the approach velocity (Zhou 2011, Eq. 12).

        e(v) = exp(-sigma (v / (vlim - v))^psi)   for v < vlim, else 0

    sigma, psi:      dimensionless fit constants of the pair
    limit_velocity:  vlim [m/s], Eq. 11
    """

    sigma: float
    psi: float
    limit_velocity: float

    def __call__(self, velocity: float | np.ndarray) -> np.ndarray:
        """Restitution coefficient at an approach velocity [m/s] >= 0 of any shape; float64."""
        speed = np.asarray(velocity, dtype=float)
        below = np.minimum(speed, np.nextafter(self.limit_velocity, 0.0))
        e = np.exp(-self.sigma * (below / (self.limit_velocity - below)) ** self.psi)
        return np.where(speed < self.limit_velocity, e, 0.0)


@dataclass(frozen=True)
class PairMaterial:
    """Effective constants of a pair of materials, symmetric under exchange of the two.

    modulus_eff:        E [Pa], see `modulus_eff`
    shear_modulus_eff:  G [Pa], see `shear_modulus_eff`, times `stiffness_factor` of the tangential model
    properties:         keys of `pairs` that contact models declare, in SI units
    materials:          the two materials, with the keys that contact models declare as attributes
    """

    modulus_eff: float
    shear_modulus_eff: float
    restitution: float | VelocityRestitution | None
    """Number or function of velocity. None if the pair gives none; the model then derives it from the
    materials."""
    yield_strength: float | None = None
    """Yield strength of the softer material [Pa]; None if neither material has one."""
    properties: Mapping[str, float] = field(default_factory=dict)
    materials: tuple[Any, ...] = ()
    has_tangential_force: bool = False
    """Whether a tangential or rolling model acts between the two."""
    tangential_stiffness: float | None = None
    """Stiffness [N/m] of a tangential model that does not take that of the normal model."""

    @property
    def fit(self) -> VelocityRestitution | None:
        """The restitution if it is a function of the velocity."""
        return self.restitution if isinstance(self.restitution, VelocityRestitution) else None

    def restitution_at(self, velocity: float) -> float:
        """Restitution coefficient at an approach velocity [m/s]. Raises ValueError if the pair has none."""
        if self.restitution is None:
            raise ValueError("this pair has no restitution coefficient")
        return float(self.restitution(velocity) if callable(self.restitution) else self.restitution)


def modulus_eff(a: Solid, b: Solid) -> float:
    """Effective modulus [Pa]: 1/E = (1 - nu1^2)/E1 + (1 - nu2^2)/E2."""
    compliance = (1.0 - a.poisson_ratio**2) / a.young_modulus + (1.0 - b.poisson_ratio**2) / b.young_modulus
    return 1.0 / compliance


def shear_modulus_eff(a: Solid, b: Solid) -> float:
    """Effective shear modulus [Pa]: 1/G = (2 - nu1)/G1 + (2 - nu2)/G2 (Mindlin 1949)."""
    return 1.0 / ((2.0 - a.poisson_ratio) / a.shear_modulus + (2.0 - b.poisson_ratio) / b.shear_modulus)


def yield_strength(a: Solid, b: Solid) -> float | None:
    """Yield strength [Pa] of the softer of two materials; a material without one never yields."""
    return min((solid.yield_strength for solid in (a, b) if solid.yield_strength is not None), default=None)


def limit_velocity(a: Solid, b: Solid) -> float:
    """Velocity [m/s] above which the collision is perfectly plastic (Zhou 2011, Eq. 11).

        vlim = sqrt(3 Ymin / rho)      rho of the material with the lower yield strength

    A material without a yield strength never yields. Raises ValueError if neither has one.
    """
    known = [(solid.yield_strength, -solid.density) for solid in (a, b) if solid.yield_strength is not None]
    if not known:
        raise ValueError(
            "the limit velocity (Zhou 2011, Eq. 11) requires a yield strength of at least one of the two "
            "materials"
        )
    strength, minus_density = min(known)
    return float(np.sqrt(3.0 * strength / -minus_density))
