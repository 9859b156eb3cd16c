"""Torsion spring, dashpot and limit with given numbers; `twisting sds` of LAMMPS.

`TorsionLaw` is also the base class of `marshall`. The twist angle is the integral of the relative angular
velocity about the normal. If the partners are exchanged, the normal and the relative angular velocity change
their signs, and the twist angle does not.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from granflow.contact.law import (
    ContactModel,
    HistoryField,
    ModelRequest,
    Options,
    PairProperties,
    Remedy,
    SurfaceState,
    TwistingLaw,
)
from granflow.device_functions import ti
from granflow.schema.quantities import Number


@dataclass(frozen=True)
class TorsionLaw(TwistingLaw):
    """Torsion spring, whose stiffness k, dashpot c and limit T_max the models define.

        T = -k theta - c w_n;   if |T| > T_max:   T <- T_max T / |T|,   theta <- -(T + c w_n) / k

    dashpot:        whether the dashpot is compiled
    energy_budget:  whether the torque of the dashpot and the elastic energy are saved for the dissipated
                    energy, see `tangential.mindlin.Mindlin`

    If the stiffness increases, the torque is preserved; if it decreases, the angle is. The dashpot acts from
    the second step on, as that of the tangential models.
    """

    dashpot: bool
    energy_budget: bool

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Elastic twist angle, stiffness, and with the energy budget torque of the dashpot and energy."""
        saved = (
            HistoryField("dashpot", "torque of the twisting dashpot", "N m"),
            HistoryField("stored", "elastic energy of the twisting spring", "J"),
        )
        return (
            HistoryField("angle", "elastic twist angle", "rad"),
            HistoryField("stiffness", "twisting stiffness of the previous step", "N m/rad"),
            *(saved if self.dashpot and self.energy_budget else ()),
        )

    @ti.func
    def torsion(self, constants, contact):
        """Stiffness [N m/rad], dashpot coefficient [N m s] and limit [N m]."""

    def reference_torsion(self, contact: SurfaceState) -> tuple[float, float, float]:
        """Reference implementation of `torsion`."""
        raise NotImplementedError

    @ti.func
    def torque(self, constants, contact, history):
        """Torque [N m] along the normal, history, and energy dissipated in this step [J]."""
        history_new = history
        stiffness, coefficient, limit = self.torsion(constants, contact)
        rate = contact.rolling_rate.dot(contact.normal_half)
        step = contact.time_step * rate
        before = history.angle
        angle = ti.min(history.stiffness / stiffness, 1.0) * before + step
        dashpot = 0.0 * rate
        if ti.static(self.dashpot):
            dashpot = ti.select(before == 0.0, 0.0, -coefficient * rate)
        trial = dashpot - stiffness * angle
        torque = ti.max(ti.min(trial, limit), -limit)
        angle = ti.select(ti.abs(trial) > limit, (dashpot - torque) / stiffness, angle)
        lost = 0.5 * (history.stiffness * before + stiffness * angle) * step
        if ti.static(self.dashpot and self.energy_budget):
            elastic_torque = ti.select(ti.abs(trial) > limit, torque, stiffness * angle)
            stored = 0.5 * elastic_torque * elastic_torque / stiffness
            lost += history.stored - stored - 0.5 * (history.dashpot + dashpot) * step
            history_new.dashpot = dashpot
            history_new.stored = stored
        else:
            lost += 0.5 * history.stiffness * before * before - 0.5 * stiffness * angle * angle
        history_new.angle = angle
        history_new.stiffness = stiffness
        return torque * contact.normal, history_new, lost

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `torque` in numpy."""
        stiffness, coefficient, limit = self.reference_torsion(contact)
        rate = float(contact.rolling_rate @ contact.normal_half)
        before = contact.history
        angle = before.angle * min(before.stiffness / stiffness, 1.0) + contact.time_step * rate
        dashpot = -coefficient * rate if self.dashpot and before.angle != 0.0 else 0.0
        torque = dashpot - stiffness * angle
        elastic_torque = stiffness * angle
        if abs(torque) > limit:
            torque = float(np.copysign(limit, torque))
            angle = (dashpot - torque) / stiffness
            elastic_torque = torque
        saved = {"dashpot": dashpot, "stored": 0.5 * elastic_torque**2 / stiffness}
        saved = saved if self.dashpot and self.energy_budget else {}
        return torque * contact.normal, {"angle": angle, "stiffness": stiffness, **saved}

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the spring [J]."""
        energy = 0.5 * history.stiffness * history.angle * history.angle
        if ti.static(self.dashpot and self.energy_budget):
            energy = history.stored
        return energy


@dataclass(frozen=True)
class TorsionSpring(TorsionLaw):
    """Spring k [N m/rad] and dashpot c [N m s] of the scene; limit mu_t F_n, mu_t [m] of the pair."""

    torsion_stiffness: float
    torsion_damping: float

    name = "torsion_spring"
    source = "Luding 2008, Granular Matter 10:235"
    limits = "stiffness and dashpot are the same for all pairs and particle sizes"
    constant_names = ("twisting_friction",)

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "TorsionSpring":
        """The law that a scene requests."""
        stiffness = request.options.stiffness
        damping = request.options.damping
        return cls(damping > 0.0, request.energy_budget, stiffness, damping)

    @property
    def parameters(self) -> Mapping[str, float]:
        """Stiffness and dashpot coefficient."""
        damping = {"torsion_damping": self.torsion_damping} if self.dashpot else {}
        return {"torsion_stiffness": self.torsion_stiffness} | damping

    @ti.func
    def torsion(self, constants, contact):
        """Stiffness [N m/rad], dashpot coefficient [N m s] and limit [N m]."""
        coefficient = 0.0 * contact.overlap
        if ti.static(self.dashpot):
            coefficient += constants.torsion_damping
        return constants.torsion_stiffness, coefficient, constants.twisting_friction * contact.normal_load

    def reference_torsion(self, contact: SurfaceState) -> tuple[float, float, float]:
        """Reference implementation of `torsion`."""
        limit = contact.constants.twisting_friction * contact.normal_load
        return self.torsion_stiffness, self.torsion_damping, limit


class TorsionSpringOptions(Options):
    """Options of the model."""

    stiffness: Annotated[float, Number("torsion_stiffness", noun="a twisting stiffness", above=0)] = Field(
        description="twisting stiffness [Nm/rad]", examples=["1 mNm/rad"]
    )
    damping: Annotated[float, Number("torsion_damping", noun="a twisting dashpot", at_least=0)] = Field(
        0.0, description="twisting dashpot [Nms]", examples=["1 uNms"]
    )


class TwistingFriction(PairProperties):
    """Properties of pairs of the model."""

    twisting_friction: Annotated[
        float,
        Number("length", noun="a length", at_least=0),
        Remedy("give the length, or 0 to disable twisting friction"),
    ] = Field(description="largest twisting torque over the normal force [m]", examples=["10 um"])


MODEL = ContactModel(
    TorsionSpring,
    "torsion spring and dashpot with a limit",
    options=TorsionSpringOptions,
    pair_properties=TwistingFriction,
)
