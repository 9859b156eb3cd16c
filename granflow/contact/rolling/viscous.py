"""Viscous rolling torque (Brilliantov & Poeschel 1998): proportional to load and rolling rate."""

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from granflow.contact.law import ContactModel, PairProperties, Remedy, SurfaceState
from granflow.contact.rolling.bounded_torque import BoundedTorque
from granflow.device_functions import ti
from granflow.schema import quantities as q


@dataclass(frozen=True)
class Viscous(BoundedTorque):
    """T = A R F w, w the rolling rate [rad/s] and A the dissipative constant of the pair [s].

    A sphere that rolls at the velocity V = R w has the coefficient of rolling friction A V.
    """

    name = "viscous"
    source = "Brilliantov & Poeschel 1998, Europhys. Lett. 42:511, doi 10.1209/epl/i1998-00281-7"
    limits = (
        "no torque at rest: a particle on a slope rolls at the velocity at which the torque balances its "
        "weight"
    )
    constant_names = ("rolling_dissipation",)

    @ti.func
    def torque_size(self, constants, contact, speed):
        """A R F w [N m]."""
        return constants.rolling_dissipation * contact.radius_eff * contact.normal_load * speed

    def reference_size(self, contact: SurfaceState, speed: float) -> float:
        """A R F w [N m]."""
        velocity = contact.radius_eff * speed
        return float(contact.constants.rolling_dissipation * velocity * contact.normal_load)


class RollingDissipation(PairProperties):
    """Properties of pairs of the model."""

    rolling_dissipation: Annotated[q.Time, Remedy("give it in s, or 0 to disable rolling friction")] = Field(
        description="dissipative constant A of rolling [s]", examples=["1e-3 s"]
    )


MODEL = ContactModel(
    Viscous,
    "torque proportional to load and rolling rate (Brilliantov & Poeschel 1998)",
    pair_properties=RollingDissipation,
)
