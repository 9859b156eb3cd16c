"""Elastic-plastic spring-dashpot torque (EPSD): the tangential spring with torque in place of force, and a dashpot.

The rolling stiffness is k = k_t R^2 (Wensrich & Katterfeld 2012), the limit mu_r R F. The dashpot 2 eta sqrt(I k) acts
as long as the spring is below its limit (Ai et al. 2011). Without damping the model is known as EPSD2.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.contact.device import ti
from granflow.contact.law import HistoryField, ModelRequest
from granflow.contact.model import ContactModel
from granflow.contact.options import ROLLING_FRICTION, Amount
from granflow.contact.surface_law import RollingLaw, SurfaceState
from granflow.contact.tangential.spring import (
    elastic_plastic_spring,
    reference_rotation,
    reference_spring,
    rotated_displacement,
    spring_loss,
)

BELOW_LIMIT = (1.0 - 1e-6) ** 2
"""Squared torque over squared limit up to which the spring counts as elastic, so that rounding does not decide."""


@dataclass(frozen=True)
class Epsd(RollingLaw):
    """Elastic-plastic spring-dashpot torque.

    damping_ratio:  eta of the dashpot; 0: no dashpot
    energy_budget:  whether the torque of the dashpot is saved for the dissipated energy
    """

    damping_ratio: float
    energy_budget: bool

    name = "epsd"
    source = "Ai et al. 2011, Powder Technol. 206:269, model C; Wensrich & Katterfeld 2012, Powder Technol. 217:409"
    limits = "the rolling stiffness is an assumption; without damping a particle at rest can oscillate about its spring"
    constant_names = ("rolling_friction",)

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Epsd":
        """The law that a scene requests."""
        return cls(request.options["damping_ratio"], request.energy_budget)

    @property
    def damped(self) -> bool:
        """Whether the dashpot acts."""
        return self.damping_ratio > 0.0

    @property
    def saves_dashpot(self) -> bool:
        """Whether the torque of the dashpot is a history field."""
        return self.damped and self.energy_budget

    @property
    def parameters(self) -> Mapping[str, float]:
        """The damping ratio of a dashpot."""
        return {"damping_ratio": self.damping_ratio} if self.damped else {}

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Elastic rolling displacement, and with the energy budget the torque of the dashpot."""
        dashpot = (HistoryField("dashpot", "torque of the rolling dashpot", "N m", size=3),)
        angle = HistoryField("angle", "rolling displacement", "rad", size=3)
        return angle, *(dashpot if self.saves_dashpot else ())

    @ti.func
    def torque(self, constants, contact, history):
        """Spring torque [N m] after the rotation of this step, limited to mu_r R F, and torque of the dashpot."""
        history_new, ratio, rate = history, contact.stiffness_ratio, contact.rolling_rate
        rotated = rotated_displacement(history.angle, contact.normal, contact.normal_half)
        step = contact.time_step * (rate - rate.dot(contact.normal) * contact.normal)
        spring = contact.stiffness * contact.radius_eff * contact.radius_eff
        limit = constants.rolling_friction * contact.radius_eff * contact.normal_load
        torque, angle = elastic_plastic_spring(spring, ratio, limit, rotated, step)
        energy_lost = spring_loss(spring, ratio, rotated, step, torque, angle)
        history_new.angle = angle
        if ti.static(self.damped):
            damping = 2.0 * constants.damping_ratio * ti.sqrt(contact.inertia_eff * spring)
            below = torque.dot(torque) < limit * limit * BELOW_LIMIT
            dashpot = ti.select(below, -damping / contact.time_step, 0.0) * step
            torque += dashpot
            if ti.static(self.energy_budget):
                energy_lost += -0.5 * (history.dashpot + dashpot).dot(step)
                history_new.dashpot = dashpot
        return torque, history_new, energy_lost

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `torque` in numpy."""
        rate = contact.rolling_rate - (contact.rolling_rate @ contact.normal) * contact.normal
        spring = contact.stiffness * contact.radius_eff**2
        limit = contact.constants.rolling_friction * contact.radius_eff * contact.normal_load
        rotated = reference_rotation(contact.history.angle, contact.normal, contact.normal_half)
        torque, angle = reference_spring(spring, contact.stiffness_ratio, limit, rotated, contact.time_step * rate)
        elastic = np.linalg.norm(torque) < math.sqrt(BELOW_LIMIT) * limit
        damping = 2.0 * self.damping_ratio * math.sqrt(contact.inertia_eff * spring) if elastic else 0.0
        dashpot = -damping * rate
        return torque + dashpot, {"angle": angle} | ({"dashpot": dashpot} if self.saves_dashpot else {})

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the spring [J]."""
        spring = 0.5 * contact.stiffness * contact.radius_eff * contact.radius_eff
        return spring * history.angle.dot(history.angle)


MODEL = ContactModel(
    Epsd,
    "elastic-plastic spring torque, with a dashpot if damping_ratio is above 0",
    options={
        "damping_ratio": Amount(
            "damping ratio of the rolling dashpot below the limit of the spring; 0: no dashpot (EPSD2)",
            *("0.3", "number", "a damping ratio"),
            at_least=0,
            at_most=1,
            default=0.0,
        )
    },
    pair_options=(ROLLING_FRICTION,),
    example={"damping_ratio": 0.3},
)
