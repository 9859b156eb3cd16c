"""Spring-dashpot-slider torque (SDS): the EPSD spring with a dashpot as long as it is below its limit.

The dashpot is 2 eta sqrt(I k), k the rolling stiffness of EPSD (Ai et al. 2011, model C with damping).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from granflow.contact.law import (
    ContactModel,
    HistoryField,
    ModelRequest,
    Remedy,
    RollingFriction,
    SurfaceState,
    in_contact_plane,
    reference_in_contact_plane,
)
from granflow.contact.rolling.epsd import Epsd
from granflow.device_functions import ti
from granflow.schema.quantities import Number

BELOW_LIMIT = 1.0 - 1e-6
"""Torque over the limit up to which the spring counts as elastic, so that rounding does not decide."""


@dataclass(frozen=True)
class Sds(Epsd):
    """Spring, dashpot and Coulomb limit.

    energy_budget:  whether the torque of the dashpot is saved for the dissipated energy
    """

    energy_budget: bool

    name = "sds"
    source = (
        "Ai et al. 2011, Powder Technol. 206:269, model C; Wensrich & Katterfeld 2012, Powder Technol. "
        "217:409"
    )
    limits = (
        "the rolling stiffness and the damping ratio are assumptions; no dashpot while the spring is at its "
        "limit"
    )
    constant_names = ("rolling_friction", "rolling_damping")

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Sds":
        """The law that a scene requests."""
        return cls(request.energy_budget)

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Elastic rolling displacement, and with the energy budget the torque of the dashpot."""
        dashpot = (HistoryField("dashpot", "torque of the rolling dashpot", "N m", size=3),)
        return *super().history, *(dashpot if self.energy_budget else ())

    @ti.func
    def torque(self, constants, contact, history):
        """Torque of spring and dashpot [N m]."""
        spring_torque, history_new, energy_lost = self.spring_torque(constants, contact, history)
        rate = contact.rolling_rate
        radius = contact.radius_eff
        tangential_rate = in_contact_plane(rate, contact.normal, contact.normal_half)
        spring = contact.stiffness * radius * radius
        limit = BELOW_LIMIT * constants.rolling_friction * radius * contact.normal_load
        damping = 2.0 * constants.rolling_damping * ti.sqrt(contact.inertia_eff * spring)
        dashpot = ti.select(spring_torque.dot(spring_torque) < limit * limit, -damping, 0.0) * tangential_rate
        if ti.static(self.energy_budget):
            energy_lost += -0.5 * contact.time_step * (history.dashpot + dashpot).dot(tangential_rate)
            history_new.dashpot = dashpot
        return spring_torque + dashpot, history_new, energy_lost

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `torque` in numpy."""
        spring_torque, history = super().reference(contact)
        rate = reference_in_contact_plane(contact.rolling_rate, contact)
        limit = contact.constants.rolling_friction * contact.radius_eff * contact.normal_load
        critical = 2.0 * contact.radius_eff * math.sqrt(contact.inertia_eff * contact.stiffness)
        elastic = np.linalg.norm(spring_torque) < BELOW_LIMIT * limit
        dashpot = -(contact.constants.rolling_damping * critical if elastic else 0.0) * rate
        return spring_torque + dashpot, {**history, **({"dashpot": dashpot} if self.energy_budget else {})}


class RollingResistance(RollingFriction):
    """Properties of pairs of the model."""

    rolling_damping: Annotated[
        float,
        Number(noun="a damping ratio", at_least=0, at_most=1),
        Remedy("give the ratio, or 0 for no dashpot"),
    ] = Field(description="damping ratio of the rolling dashpot; 1: critical", examples=["0.3"])


MODEL = ContactModel(
    Sds,
    "elastic-plastic spring torque with a dashpot",
    pair_properties=RollingResistance,
)
