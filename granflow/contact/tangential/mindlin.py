"""Mindlin's no-slip spring with history, limited by Coulomb friction, with an optional dashpot.

The four combinations of `increments` and `unloading` are the styles mindlin, mindlin/force, mindlin_rescale
and mindlin_rescale/force of LAMMPS; `dashpot: sticking` is the rule of LIGGGHTS (tangential history).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from granflow.contact.law import (
    ContactModel,
    HistoryField,
    ModelRequest,
    Options,
    SlidingFriction,
    SurfaceState,
    TangentialLaw,
    carried,
    half_carried,
    reference_carried,
    reference_half_carried,
)
from granflow.contact.tangential.spring import (
    elastic_plastic_spring,
    limit_ratio,
    reference_spring,
    spring_loss,
)
from granflow.device_functions import ti
from granflow.schema.quantities import Number

DampingFactor = Annotated[
    float,
    Number(noun="a damping factor", at_least=0),
    Field(description="tangential dashpot over the dashpot of the normal model; 0: none", examples=["1"]),
]
"""Option `damping` of the tangential models: eta_t / eta_n, x_gamma_t of LAMMPS."""
StiffnessFactor = Annotated[
    float,
    Number(noun="a factor", above=0),
    Field(
        description="tangential stiffness over the no-slip stiffness of the moduli",
        examples=["0.286"],
    ),
]
DashpotRule = Annotated[
    Literal["limited", "sticking"],
    Field(
        description="force of the dashpot. limited: the Coulomb limit applies to spring and dashpot together "
        "(LAMMPS); sticking: it applies to the spring, and the dashpot acts only below it (LIGGGHTS)"
    ),
]
"""Option `dashpot` of the tangential models."""


@dataclass(frozen=True)
class Mindlin(TangentialLaw):
    """Elastic-plastic spring with the no-slip stiffness of the normal model, see `tangential.spring`.

    force_increments:  whether a change of the stiffness preserves the force; otherwise it preserves the
                       displacement
    rescaled:          whether a decrease of the stiffness decreases the force in proportion
    damping:           ratio of the tangential to the normal dashpot
    dashpot_sticks:    whether the dashpot acts only while the spring is below the Coulomb limit
    energy_budget:     whether the run accounts for energies

    A dashpot that exceeds the limit deflects the spring against the motion. The energy of this deflection is
    not elastic energy while the contact slides: it is dissipated, unless the contact sticks again. With the
    energy budget the history has the elastic energy.
    """

    force_increments: bool = True
    rescaled: bool = True
    damping: float = 0.0
    dashpot_sticks: bool = False
    energy_budget: bool = False

    name = "mindlin"
    source = "Mindlin 1949; Cundall & Strack 1979; Thornton, Cummins & Cleary 2013"
    limits = "slip occurs in the whole contact area at once"
    constant_names: ClassVar[tuple[str, ...]] = ("friction",)

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Mindlin":
        """The law that a scene requests."""
        options = request.options
        return cls(
            options.increments == "force",
            options.unloading == "rescaled",
            options.damping,
            options.dashpot == "sticking",
            request.energy_budget,
        )

    @property
    def damped(self) -> bool:
        """Whether the dashpot is compiled."""
        return self.damping > 0.0

    @property
    def deflects(self) -> bool:
        """Whether the dashpot can deflect the spring, and the history has the elastic energy."""
        return self.damped and not self.dashpot_sticks and self.energy_budget

    @property
    def parameters(self) -> Mapping[str, float]:
        """The ratio of the dashpots."""
        return {"damping": self.damping} if self.damped else {}

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Elastic tangential displacement, the force of the dashpot, and the elastic energy."""
        dashpot = (HistoryField("dashpot", "force of the tangential dashpot", "N", size=3),)
        stored = (HistoryField("stored", "elastic energy of the tangential spring", "J"),)
        return (
            HistoryField("displacement", "tangential displacement", "m", size=3),
            *(dashpot if self.damped else ()),
            *(stored if self.deflects else ()),
        )

    @ti.func
    def limit(self, constants, contact):
        """Coulomb limit [N]."""
        return constants.friction * contact.normal_load

    @ti.func
    def stiffness(self, constants, contact):
        """Stiffness of the spring [N/m]."""
        return contact.stiffness

    @ti.func
    def stiffness_ratio(self, contact):
        """Ratio of the previous to the present stiffness."""
        return contact.stiffness_ratio

    @ti.func
    def displacement_ratio(self, ratio):
        """Factor of the displacement if the stiffness changes; `ratio`: previous over present stiffness.

        force, rescaled:         min(ratio, 1)        force, kept:         ratio
        displacement, rescaled:  min(1 / ratio, 1)    displacement, kept:  1
        """
        factor = 0.0 * ratio + 1.0
        if ti.static(self.force_increments and self.rescaled):
            factor = ti.min(ratio, 1.0)
        elif ti.static(self.force_increments):
            factor = ratio
        elif ti.static(self.rescaled):
            factor = 1.0 / ti.max(ratio, 1.0)
        return factor

    @ti.func
    def force(self, constants, contact, history):
        """Force of spring and dashpot [N] after the slip of this step, limited to mu F.

        F = -k s - eta_t v_t;   if |F| > mu F_n:   F <- mu F_n F / |F|,   s <- -(F + eta_t v_t) / k

        With `dashpot_sticks`:  if k |s| > mu F_n:   F <- -mu F_n s / |s|,   s <- -F / k

        The dashpot acts from the second step on: in the first one the normal force is a mean since first
        contact, and the spring would keep the difference between the dashpot and a limit that depends on the
        time of first contact.
        """
        history_new = history
        stiffness = self.stiffness(constants, contact)
        ratio = self.stiffness_ratio(contact)
        rotated = carried(history.displacement, contact)
        slip = half_carried(contact.slip, contact)
        factor = self.displacement_ratio(ratio)
        limit = self.limit(constants, contact)
        spring = 0.0 * rotated
        displacement = 0.0 * rotated
        force = 0.0 * rotated
        further_loss = 0.0 * ratio
        if ti.static(self.damped):
            damping = ti.select(rotated.dot(rotated) > 0.0, constants.damping * contact.normal_damping, 0.0)
            dashpot = -damping * contact.slip_rate
            if ti.static(self.dashpot_sticks):
                spring, displacement = elastic_plastic_spring(stiffness, factor, limit, rotated, slip)
                trial = factor * rotated + slip
                dashpot *= ti.select(limit_ratio(-stiffness * trial, limit) < 1.0, 0.0, 1.0)
                force = spring + dashpot
            else:
                displacement = factor * rotated + slip
                trial = dashpot - stiffness * displacement
                share = limit_ratio(trial, limit)
                force = share * trial
                displacement = ti.select(share < 1.0, (dashpot - force) / stiffness, displacement)
                spring = -stiffness * displacement
                if ti.static(self.deflects):
                    spring_energy = 0.5 * stiffness * displacement.dot(displacement)
                    stored = ti.select(share < 1.0, 0.5 * force.dot(force) / stiffness, spring_energy)
                    deflection_before = history.stored - 0.5 * ratio * stiffness * rotated.dot(rotated)
                    further_loss = spring_energy - stored + deflection_before
                    history_new.stored = stored
            further_loss -= 0.5 * (history.dashpot + dashpot).dot(slip)
            history_new.dashpot = dashpot
        else:
            spring, displacement = elastic_plastic_spring(stiffness, factor, limit, rotated, slip)
            force = spring
        energy_lost = spring_loss(stiffness, ratio, rotated, slip, spring, displacement) + further_loss
        history_new.displacement = displacement
        return force, history_new, energy_lost

    def reference_stiffness(self, contact: SurfaceState) -> tuple[float, float]:
        """Reference implementation of `stiffness` and `stiffness_ratio`."""
        return contact.stiffness, contact.stiffness_ratio

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `force` in numpy."""
        stiffness, ratio = self.reference_stiffness(contact)
        preserved = ratio if self.force_increments else 1.0  # by which the displacement changes
        if self.rescaled and ratio > 1.0:
            preserved /= ratio
        slip = reference_half_carried(contact.slip, contact)
        kept = preserved * reference_carried(contact.history.displacement, contact)
        limit = contact.constants.friction * contact.normal_load
        if not self.damped:
            force, displacement = reference_spring(stiffness, limit, kept, slip)
            return force, {"displacement": displacement}
        damping = self.damping * contact.normal_damping if contact.history.displacement.any() else 0.0
        dashpot = -damping * contact.slip_rate
        if self.dashpot_sticks:
            spring, displacement = reference_spring(stiffness, limit, kept, slip)
            trial = stiffness * (kept + slip)
            if trial @ trial > limit * limit:
                dashpot = np.zeros(3)
            return spring + dashpot, {"displacement": displacement, "dashpot": dashpot}
        displacement = kept + slip
        force = dashpot - stiffness * displacement
        size = float(np.sqrt(force @ force))
        elastic_force = stiffness * displacement
        if size > limit:
            force = force * (limit / size)
            displacement = (dashpot - force) / stiffness
            elastic_force = force
        stored = {"stored": 0.5 * elastic_force @ elastic_force / stiffness} if self.deflects else {}
        return force, {"displacement": displacement, "dashpot": dashpot, **stored}

    @ti.func
    def present_force(self, constants, contact, history):
        """Force of spring and dashpot [N] and its size [N]."""
        force = -self.stiffness(constants, contact) * history.displacement
        if ti.static(self.damped):
            force += history.dashpot
        return force, ti.sqrt(force.dot(force))

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the spring [J]."""
        energy = 0.5 * self.stiffness(constants, contact) * history.displacement.dot(history.displacement)
        if ti.static(self.deflects):
            energy = history.stored
        return energy


class MindlinOptions(Options):
    """Options of the model."""

    increments: Literal["force", "displacement"] = Field(
        "force",
        description="quantity that a change of the stiffness preserves: the force (each step adds an "
        "increment of force), or the displacement",
    )
    unloading: Literal["rescaled", "kept"] = Field(
        "rescaled",
        description="rescaled: the force decreases with the contact radius during unloading; kept: it does "
        "not",
    )
    stiffness_factor: StiffnessFactor = 1.0
    damping: DampingFactor = 0.0
    dashpot: DashpotRule = "limited"


MODEL = ContactModel(
    Mindlin,
    "spring with history, Coulomb limit",
    options=MindlinOptions,
    pair_properties=SlidingFriction,
)
