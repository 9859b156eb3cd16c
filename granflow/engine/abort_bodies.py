"""The bodies of a contact at the time of an abort."""

from dataclasses import dataclass
from math import hypot, isfinite

AT_REST = 1e-9
"""Speed [m/s] below which messages report `at rest`."""


@dataclass(frozen=True)
class Body:
    """A particle or a wall: name, material, velocity [m/s] at the contact, and position [m] of a particle."""

    name: str
    material: str
    velocity: tuple[float, float, float]
    position: tuple[float, float, float] | None

    @property
    def speed(self) -> float:
        """Speed [m/s]."""
        return hypot(*self.velocity)

    def __str__(self) -> str:
        """Description for messages: particle 7 (glass, 3.2 m/s)."""
        moving = f"{self.speed:.3g} m/s" if isfinite(self.speed) else "velocity not a number"
        return f"{self.name} ({self.material}, {'at rest' if self.speed < AT_REST else moving})"


@dataclass(frozen=True)
class ContactPair:
    """A contact at the time of the abort.

    overlap:          over the smaller radius
    approach:         [m/s] along the normal, negative if the bodies separate
    impact_velocity:  impact velocity [m/s] with the energy of this overlap and approach
    stable_step:      time step [s] that is stable for it
    radius:           [m] of the smaller particle
    radius_eff:       effective radius [m]
    mass_eff:         effective mass [kg]
    weight:           pressure [Pa] of the weight of all particles on the section of the present bed
    """

    first: Body
    second: Body
    overlap: float
    approach: float
    impact_velocity: float
    stable_step: float
    radius: float
    radius_eff: float
    mass_eff: float
    weight: float
