"""Linear spring and dashpot. The stiffness is a number, or follows from Eq. 19 of Zhou (2011).

`SpringLaw` is the base class of the models `linear`, `walton_braun` and `luding`, `SpringOptions` that of
their options. The stiffness of a contact is constant from first contact to separation.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from granflow.contact import theory
from granflow.contact.law import (
    ContactModel,
    ContactState,
    HistoryField,
    ModelRequest,
    NormalLaw,
    Options,
)
from granflow.contact.material import PairMaterial
from granflow.contact.step_corrections import build_step_mean, reference_step_mean
from granflow.device_functions import DeviceObject, power, ti
from granflow.schema import quantities as q
from granflow.schema.model import Model, choose_by_first_key
from granflow.schema.quantities import Number


class SpringAtVelocity(Model):
    """Stiffness with the energy of a Hertz contact at a velocity (Zhou 2011, Eq. 19)."""

    reference_velocity: q.Speed = Field(
        description="approach velocity [m/s] at which the spring stores the same energy as a Hertz contact",
        examples=["1 m/s"],
    )


class SpringValue(Model):
    """Stiffness as a number."""

    value: Annotated[float, Number("stiffness", above=0)] = Field(
        description="stiffness [N/m] of the spring, for all pairs and particle sizes", examples=["1e4 N/m"]
    )


class SpringOptions(Options):
    """Option of every model with a linear spring."""

    stiffness: Annotated[
        Literal["onset"] | SpringAtVelocity | SpringValue,
        choose_by_first_key(
            "it must be onset, {reference_velocity: 1 m/s} or {value: 1e4 N/m}", words=("onset",)
        ),
    ] = Field(
        description="spring stiffness: onset (Zhou 2011, Eq. 19, for each contact at its impact velocity), "
        "{reference_velocity: 1 m/s} (Eq. 19 at this velocity) or {value: 1e4 N/m}",
        examples=["onset"],
    )


@ti.func
def equivalent_spring(constants, contact, velocity):
    """Stiffness [N/m] with the Hertz energy at the same maximum overlap (Zhou 2011, Eq. 19).

    K = (4/5) k sqrt(dmax) = (4/5) k (5 M v^2 / (4 k))^(1/5)        k = (4/3) E sqrt(R)
    """
    k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
    return 0.8 * k * power(1.25 * contact.mass_eff * velocity * velocity / k, 0.2)


@dataclass(frozen=True)
class Spring(DeviceObject):
    """Spring whose stiffness [N/m] is constant from first contact to separation.

    value:               constant stiffness [N/m], or None
    reference_velocity:  velocity [m/s] in Eq. 19; None: the impact velocity of each contact
    velocity_floor:      smallest velocity [m/s] in Eq. 19 per contact, because the stiffness would be zero
                         for a contact that forms at rest
    """

    value: float | None
    reference_velocity: float | None
    velocity_floor: float

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Spring":
        """Spring from the option `stiffness`; the floor is a share of the largest velocity."""
        given = request.options.stiffness
        return cls(
            given.value if isinstance(given, SpringValue) else None,
            given.reference_velocity if isinstance(given, SpringAtVelocity) else None,
            theory.MIN_VELOCITY_SHARE * request.velocity_max,
        )

    @property
    def parameters(self) -> Mapping[str, float]:
        """The number that determines the stiffness, by its name in `constants`."""
        if self.value is not None:
            return {"spring_stiffness": self.value}
        if self.reference_velocity is not None:
            return {"spring_velocity": self.reference_velocity}
        return {"spring_velocity_floor": self.velocity_floor}

    @property
    def is_fixed(self) -> bool:
        """Whether the velocity in Eq. 19 is the same for all contacts."""
        return self.reference_velocity is not None

    def stiffness(self, modulus: float, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Stiffness [N/m] in a collision; effective modulus [Pa], radius [m], mass [kg], velocity [m/s]."""
        if self.value is not None:
            return self.value
        speed = self.reference_velocity
        if speed is None:
            speed = max(velocity, self.velocity_floor)
        return float(theory.equivalent_spring(theory.hertz_stiffness(modulus, radius_eff), mass_eff, speed))


@dataclass(frozen=True)
class SpringLaw(NormalLaw):
    """Base class of normal models with a linear spring.

    The stiffness is a history field, which `prepare` sets, unless it is a number.
    """

    spring: Spring

    @property
    def spring_history(self) -> tuple[HistoryField, ...]:
        """History field of the spring; empty if the stiffness is a number."""
        if self.spring.value is not None:
            return ()
        return (HistoryField("spring_stiffness", "spring stiffness", "N/m"),)

    @property
    def tangential_stiffness_grows(self) -> bool:
        """The stiffness of a contact is constant."""
        return False

    @property
    def prepares(self) -> bool:
        """Whether the stiffness is set at first contact."""
        return self.spring.value is None

    @property
    def softer_after_slow_onset(self) -> bool:
        """Whether the stiffness follows from the velocity at first contact."""
        return self.spring.value is None and not self.spring.is_fixed

    @ti.func
    def prepare(self, constants, contact, history):
        """Set the stiffness in the history at first contact."""
        history_new = history
        if ti.static(self.prepares):
            if history_new.spring_stiffness == 0.0:
                velocity = 0.0 * contact.overlap_rate
                if ti.static(self.spring.is_fixed):
                    velocity += constants.spring_velocity
                else:
                    velocity = ti.max(contact.overlap_rate, constants.spring_velocity_floor)
                history_new.spring_stiffness = equivalent_spring(constants, contact, velocity)
        return history_new

    @ti.func
    def stiffness_of(self, constants, contact, history):
        """Stiffness K [N/m] of a contact."""
        value = 0.0 * contact.overlap
        if ti.static(self.prepares):
            value += history.spring_stiffness
        else:
            value += constants.spring_stiffness
        return value

    @ti.func
    def tangential_stiffness(self, constants, contact, history):
        """Mindlin's ratio 4 G / E times K [N/m]."""
        return (
            4.0
            * constants.shear_modulus_eff
            / constants.modulus_eff
            * self.stiffness_of(constants, contact, history)
        )

    def loading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Stiffness K [N/m] in a collision of a pair."""
        return self.spring.stiffness(pair.modulus_eff, radius_eff, mass_eff, velocity)

    def overlap_max(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Maximum overlap [m] of the undamped spring, v sqrt(M / K)."""
        stiffness = self.loading_stiffness(pair, radius_eff, mass_eff, velocity)
        return velocity * float(np.sqrt(mass_eff / stiffness))

    def reference_stiffness(self, contact: ContactState) -> tuple[float, dict[str, float]]:
        """Reference implementation of `prepare` and `stiffness_of`: stiffness [N/m] and its history field."""
        saved = getattr(contact.history, "spring_stiffness", 0.0)
        modulus = contact.constants.modulus_eff
        new = self.spring.stiffness(modulus, contact.radius_eff, contact.mass_eff, contact.overlap_rate)
        stiffness = float(saved) if saved > 0.0 else new
        if self.spring.value is not None:
            return stiffness, {}
        return stiffness, {"spring_stiffness": stiffness}


def quarter_period(stiffness: float, mass_eff: float) -> float:
    """Time [s] from first contact to the maximum overlap of a linear spring, (pi/2) sqrt(M / K)."""
    return 0.5 * np.pi * float(np.sqrt(mass_eff / stiffness))


_step_mean = build_step_mean(0.0)


@dataclass(frozen=True)
class Linear(SpringLaw):
    """Linear spring of stiffness K [N/m] and dashpot."""

    name = "linear"
    source = "Cundall & Strack 1979; spring: Zhou 2011, Eq. 19; damping: Schwager & Poeschel 2007"
    limits = (
        "duration and restitution do not depend on velocity; with damping the force is discontinuous at "
        "first contact"
    )
    constant_names = ("modulus_eff", "shear_modulus_eff", "damping_ratio")

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Linear":
        """The law that a scene requests."""
        return cls(Spring.from_scene(request))

    @property
    def rate_dependent(self) -> bool:
        """The contact has damping."""
        return True

    @property
    def parameters(self) -> Mapping[str, float]:
        """Those of the spring."""
        return self.spring.parameters

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """The stiffness, unless it is a number."""
        return self.spring_history

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; zeta follows from the restitution (`theory.damping_ratio_for`).

        Raises ValueError if the restitution is 0 or depends on velocity.
        """
        if not isinstance(pair.restitution, float):
            raise ValueError("the contact model linear requires one number as restitution coefficient")
        return pair.modulus_eff, pair.shear_modulus_eff, theory.damping_ratio_for(pair.restitution)

    @ti.func
    def force(self, constants, contact, history):
        """F = max(K d + 2 zeta sqrt(K M) d', 0); K is constant from first contact on.

        In the first step the dashpot acts for the time since first contact only, which can be 1.5 steps: a
        strong one then stops the bodies at most.
        """
        stiffness = self.stiffness_of(constants, contact, history)
        elastic = stiffness * contact.overlap
        _overlap_at, share = _step_mean(contact.overlap, contact.overlap_rate, contact.time_step)
        damping = ti.min(
            2.0 * constants.damping_ratio * share * ti.sqrt(stiffness * contact.mass_eff),
            contact.mass_eff / contact.time_step,
        )
        viscous = ti.max(damping * contact.overlap_rate, -elastic)
        return elastic + viscous, viscous, history

    @ti.func
    def damping(self, constants, contact, history):
        """2 zeta sqrt(K M) [N s/m]."""
        stiffness = self.stiffness_of(constants, contact, history)
        return 2.0 * constants.damping_ratio * ti.sqrt(stiffness * contact.mass_eff)

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the spring [J], K d^2 / 2."""
        return 0.5 * self.stiffness_of(constants, contact, history) * contact.overlap * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force` in numpy."""
        stiffness, history = self.reference_stiffness(contact)
        rate = (
            reference_step_mean(0.0, contact.overlap, contact.overlap_rate, contact.time_step)
            * contact.overlap_rate
        )
        viscous = 2.0 * contact.constants.damping_ratio * np.sqrt(stiffness * contact.mass_eff) * rate
        viscous = min(viscous, contact.mass_eff / contact.time_step * abs(contact.overlap_rate))
        return float(max(stiffness * contact.overlap + viscous, 0.0)), history

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Two quarter periods of the undamped spring [s]."""
        quarter = quarter_period(self.loading_stiffness(pair, radius_eff, mass_eff, velocity), mass_eff)
        return quarter, quarter

    def unloading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Stiffness K [N/m]."""
        return self.loading_stiffness(pair, radius_eff, mass_eff, velocity)

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Dashpot constant 2 zeta sqrt(K M) [N s/m]."""
        stiffness = self.loading_stiffness(pair, radius_eff, mass_eff, velocity)
        return 2.0 * self.pair_constants(pair)[2] * float(np.sqrt(stiffness * mass_eff))


MODEL = ContactModel(Linear, "Linear spring and dashpot.", options=SpringOptions)
