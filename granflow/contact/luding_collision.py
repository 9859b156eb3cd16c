"""Closed forms of a binary collision with the bilinear model of Luding (2008), in float64."""

import math
from dataclasses import dataclass

from granflow.contact.spring import quarter_period


@dataclass(frozen=True)
class LudingCollision:
    """A binary collision in closed form.

    stiffness:  k1 [N/m]
    growth:     relative increase of k2 with the maximum overlap [1/m]
    limit:      limit overlap [m]
    tension:    kc / k1
    mass_eff:   effective mass [kg]
    velocity:   approach velocity [m/s]
    """

    stiffness: float
    growth: float
    limit: float
    tension: float
    mass_eff: float
    velocity: float

    @property
    def overlap_max(self) -> float:
        """Largest plastic overlap [m]."""
        return min(self.velocity * math.sqrt(self.mass_eff / self.stiffness), self.limit)

    @property
    def unloading_stiffness(self) -> float:
        """Slope k2 [N/m] after loading to `overlap_max`."""
        return self.stiffness * (1.0 + self.growth * self.overlap_max)

    @property
    def overlap_in_tension(self) -> float:
        """Overlap [m] at the intersection of unloading line and tension line: (k2 - k1) dmax / (k2 + kc)."""
        unloading_stiffness_now = self.unloading_stiffness
        return (
            (unloading_stiffness_now - self.stiffness)
            * self.overlap_max
            / (unloading_stiffness_now + self.tension * self.stiffness)
        )

    @property
    def elastic_energy(self) -> float:
        """Energy [J] recovered by unloading before the force becomes tensile."""
        largest = self.overlap_max
        energy_lost = 0.5 * self.stiffness * largest**2 * (1.0 - self.stiffness / self.unloading_stiffness)
        return 0.5 * self.mass_eff * self.velocity**2 - energy_lost

    @property
    def restitution(self) -> float:
        """Restitution coefficient; 0 if the tension prevents separation."""
        tension_force = self.tension * self.stiffness * self.overlap_in_tension
        work = 0.5 * tension_force * self.overlap_in_tension + 0.5 * tension_force**2 / self.unloading_stiffness
        return math.sqrt(max(2.0 * (self.elastic_energy - work) / self.mass_eff, 0.0)) / self.velocity

    def durations(self) -> tuple[float, float]:
        """Loading and unloading durations [s]. If the spheres do not separate, unloading ends at zero force."""
        quarter = quarter_period(self.unloading_stiffness, self.mass_eff)
        return self._loading_duration(), quarter + (self._tension_duration() if self.restitution > 0.0 else 0.0)

    def _loading_duration(self) -> float:
        """Loading duration [s]: a quarter period of k1, or the limit overlap with k1 and the rest with kp."""
        omega = math.sqrt(self.stiffness / self.mass_eff)
        if self.velocity <= omega * self.limit:
            return 0.5 * math.pi / omega
        stiffer = math.sqrt(self.unloading_stiffness / self.mass_eff)
        velocity_at_limit = math.sqrt(self.velocity**2 - (omega * self.limit) ** 2)
        elastic = self.limit * self.stiffness / self.unloading_stiffness
        return (
            math.asin(omega * self.limit / self.velocity) / omega
            + math.atan2(velocity_at_limit, stiffer * elastic) / stiffer
        )

    def _tension_duration(self) -> float:
        """Time under tension [s]: first on the unloading line, then along -kc d."""
        if self.tension == 0.0 or self.overlap_in_tension == 0.0:
            return 0.0
        omega = math.sqrt(self.unloading_stiffness / self.mass_eff)
        stretch = self.tension * self.stiffness * self.overlap_in_tension / self.unloading_stiffness
        velocity_at_zero = math.sqrt(2.0 * self.elastic_energy / self.mass_eff)
        velocity_in_tension = math.sqrt(velocity_at_zero**2 - (omega * stretch) ** 2)
        rate = math.sqrt(self.tension * self.stiffness / self.mass_eff)
        return (
            math.asin(omega * stretch / velocity_at_zero) / omega
            + math.atanh(rate * self.overlap_in_tension / velocity_in_tension) / rate
        )
