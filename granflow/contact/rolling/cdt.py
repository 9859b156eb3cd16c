"""Constant directional torque (CDT): a rolling torque of constant magnitude against the rolling rate.

CDT is discontinuous at zero rate; at small rates the bound of `bounded_torque` makes it a viscous torque.
"""

from dataclasses import dataclass

from granflow.contact.law import ContactModel, RollingFriction, SurfaceState
from granflow.contact.rolling.bounded_torque import BoundedTorque
from granflow.device_functions import ti


@dataclass(frozen=True)
class Cdt(BoundedTorque):
    """T = mu_r R F against the rolling rate (Ai et al. 2011, model A)."""

    name = "cdt"
    source = "Ai et al. 2011, Powder Technol. 206:269, model A"
    limits = "no torque at rest: a particle on a slope rolls, however slowly"
    constant_names = ("rolling_friction",)

    @ti.func
    def torque_size(self, constants, contact, speed):
        """mu_r R F [N m]."""
        return constants.rolling_friction * contact.radius_eff * contact.normal_load

    def reference_size(self, contact: SurfaceState, speed: float) -> float:
        """mu_r R F [N m]."""
        return float(contact.constants.rolling_friction * contact.radius_eff * contact.normal_load)


MODEL = ContactModel(Cdt, "constant directional torque", pair_properties=RollingFriction)
