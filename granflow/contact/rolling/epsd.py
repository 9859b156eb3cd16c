"""Elastic-plastic spring torque (EPSD): the tangential spring, with torque for force and angle for length.

The rolling stiffness is k_t R^2 (Wensrich & Katterfeld 2012), the limit mu_r R F.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from granflow.contact.law import (
    ContactModel,
    HistoryField,
    RollingFriction,
    RollingLaw,
    SurfaceState,
    carried,
    half_carried,
    in_contact_plane,
    reference_carried,
    reference_half_carried,
    reference_in_contact_plane,
)
from granflow.contact.tangential.spring import (
    elastic_plastic_spring,
    reference_spring,
    spring_loss,
)
from granflow.device_functions import ti


@dataclass(frozen=True)
class Epsd(RollingLaw):
    """Elastic-plastic spring torque."""

    name = "epsd"
    source = (
        "Ai et al. 2011, Powder Technol. 206:269, model C; Wensrich & Katterfeld 2012, Powder Technol. "
        "217:409"
    )
    limits = (
        "the rolling stiffness is an assumption; without damping a particle at rest can oscillate about its "
        "spring"
    )
    constant_names: ClassVar[tuple[str, ...]] = ("rolling_friction",)

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Elastic rolling displacement."""
        return (HistoryField("angle", "rolling displacement", "rad", size=3),)

    @ti.func
    def torque(self, constants, contact, history):
        """Spring torque [N m]."""
        return self.spring_torque(constants, contact, history)

    @ti.func
    def spring_torque(self, constants, contact, history):
        """Spring torque [N m] after the rotation of this step, limited to mu_r R F, its history and loss."""
        history_new = history
        ratio = contact.stiffness_ratio
        rate = contact.rolling_rate
        rotated = carried(history.angle, contact)
        tangential_rate = in_contact_plane(rate, contact.normal, contact.normal_half)
        step = half_carried(contact.time_step * tangential_rate, contact)
        spring = contact.stiffness * contact.radius_eff * contact.radius_eff
        limit = constants.rolling_friction * contact.radius_eff * contact.normal_load
        torque, angle = elastic_plastic_spring(spring, ti.min(ratio, 1.0), limit, rotated, step)
        energy_lost = spring_loss(spring, ratio, rotated, step, torque, angle)
        history_new.angle = angle
        return torque, history_new, energy_lost

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `torque` in numpy."""
        tangential_rate = reference_in_contact_plane(contact.rolling_rate, contact)
        torque, angle = reference_spring(
            contact.stiffness * contact.radius_eff**2,
            contact.constants.rolling_friction * contact.radius_eff * contact.normal_load,
            min(contact.stiffness_ratio, 1.0) * reference_carried(contact.history.angle, contact),
            reference_half_carried(contact.time_step * tangential_rate, contact),
        )
        return torque, {"angle": angle}

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the spring [J]."""
        spring = 0.5 * contact.stiffness * contact.radius_eff * contact.radius_eff
        return spring * history.angle.dot(history.angle)


MODEL = ContactModel(Epsd, "elastic-plastic spring torque", pair_properties=RollingFriction)
