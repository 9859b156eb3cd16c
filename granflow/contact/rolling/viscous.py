"""Viscous rolling torque (Brilliantov & Poeschel 1998): proportional to load and rolling rate."""

from dataclasses import dataclass

from granflow.contact.law import Amount, ContactModel, PairOption, SurfaceState
from granflow.contact.rolling.bounded_torque import BoundedTorque
from granflow.device_functions import ti


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


MODEL = ContactModel(
    Viscous,
    "torque proportional to load and rolling rate (Brilliantov & Poeschel 1998)",
    pair_options=(
        PairOption(
            "rolling_dissipation",
            Amount("dissipative constant A of rolling [s]", "1e-3 s", "time", "a time", at_least=0),
            "give it in s, or 0 to disable rolling friction",
        ),
    ),
)
