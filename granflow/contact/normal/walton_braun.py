"""Bilinear model: loading with stiffness k1, unloading and reloading with k2 > k1 (Walton & Braun 1986)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from granflow.contact.law import ContactModel, ContactState, HistoryField, ModelRequest
from granflow.contact.material import PairMaterial
from granflow.contact.normal.linear import Spring, SpringLaw, SpringOptions, quarter_period
from granflow.device_functions import ti
from granflow.schema import quantities as q
from granflow.schema.model import Model, choose_by_first_key


@dataclass(frozen=True)
class WaltonBraun(SpringLaw):
    """Bilinear model with the loading spring k1.

    reference_velocity:  velocity [m/s] at which e applies, or None

    Without a reference velocity k2 = k1 / e^2, so that e does not depend on velocity; otherwise k2 = k1 (1 +
    S F_max) with the slope S that gives e at the reference velocity, and e decreases with velocity.
    """

    reference_velocity: float | None

    name = "walton_braun"
    source = "Walton & Braun 1986, J. Rheol. 30:949, doi 10.1122/1.549893; spring: Zhou 2011, Eq. 19"
    limits = (
        "unloading is 1/e^2 times as stiff as loading, so that the time step is proportional to e; with a "
        "given stiffness the duration, with a constant k2 the restitution, does not depend on velocity"
    )
    constant_names = ("modulus_eff", "shear_modulus_eff", "loss_ratio")

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "WaltonBraun":
        """The law that a scene requests."""
        given = request.options.unloading
        velocity = given.reference_velocity if isinstance(given, RestitutionAtVelocity) else None
        return cls(Spring.from_scene(request), velocity)

    @property
    def velocity_dependent(self) -> bool:
        """Whether the restitution depends on velocity."""
        return self.reference_velocity is not None

    @property
    def parameters(self) -> Mapping[str, float]:
        """Those of the spring, and the reference velocity [m/s] if the restitution depends on velocity."""
        velocity = {} if self.reference_velocity is None else {"reference_velocity": self.reference_velocity}
        return {**self.spring.parameters, **velocity}

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Maximum overlap, and the stiffness unless it is a number."""
        return HistoryField("overlap_max", "maximum overlap", "m", in_output=True), *self.spring_history

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; the loss ratio is 1/e^2 - 1.

        Raises ValueError if the restitution is 0 or depends on velocity.
        """
        if not isinstance(pair.restitution, float) or not 0.0 < pair.restitution <= 1.0:
            raise ValueError(
                "the contact model walton_braun requires one number above 0 as restitution coefficient"
            )
        return pair.modulus_eff, pair.shear_modulus_eff, 1.0 / pair.restitution**2 - 1.0

    @ti.func
    def unloading_slope(self, constants, contact, stiffness, overlap_max):
        """Slope k2 [N/m]: k1 / e^2, or k1 (1 + (1/e^2 - 1) dmax sqrt(k1/M) / v_ref)."""
        excess = constants.loss_ratio
        if ti.static(self.velocity_dependent):
            excess *= overlap_max * ti.sqrt(stiffness / contact.mass_eff) / constants.reference_velocity
        return stiffness * (1.0 + excess)

    @ti.func
    def force(self, constants, contact, history):
        """F = k1 d beyond the previous maximum overlap, max(k2 (d - d0), 0) below it [N]."""
        history_new = history
        stiffness = self.stiffness_of(constants, contact, history)
        largest = ti.max(contact.overlap, history.overlap_max)
        history_new.overlap_max = largest
        slope = self.unloading_slope(constants, contact, stiffness, largest)
        normal_force = ti.max(stiffness * largest - slope * (largest - contact.overlap), 0.0)
        return normal_force, 0.0 * normal_force, history_new

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy recovered by unloading [J], F^2 / (2 k2)."""
        stiffness = self.stiffness_of(constants, contact, history)
        largest = history.overlap_max
        slope = self.unloading_slope(constants, contact, stiffness, largest)
        force = ti.max(stiffness * largest - slope * (largest - contact.overlap), 0.0)
        return 0.5 * force * force / slope

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Work of loading minus recoverable energy at the maximum overlap [J], k1 dmax^2 (1 - k1/k2) / 2."""
        stiffness = self.stiffness_of(constants, contact, history)
        largest = history.overlap_max
        slope = self.unloading_slope(constants, contact, stiffness, largest)
        return 0.5 * stiffness * largest * largest * (1.0 - stiffness / slope)

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`, with the slope S [1/N] of the paper: k2 = k1 (1 + S F_max)."""
        stiffness, spring = self.reference_stiffness(contact)
        largest = contact.history.overlap_max
        history = {"overlap_max": max(largest, contact.overlap), **spring}
        if contact.overlap >= largest:
            return stiffness * contact.overlap, history
        k2 = stiffness * (1.0 + contact.constants.loss_ratio)
        if self.reference_velocity is not None:
            slope = contact.constants.loss_ratio / (
                self.reference_velocity * math.sqrt(stiffness * contact.mass_eff)
            )
            k2 = stiffness * (1.0 + slope * stiffness * largest)
        return max(k2 * (contact.overlap - largest * (1.0 - stiffness / k2)), 0.0), history

    def restitution(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """e(v) = 1 / sqrt(1 + (1/e^2 - 1) v / v_ref), or e (Walton & Braun 1986)."""
        share = 1.0 if self.reference_velocity is None else velocity / self.reference_velocity
        return 1.0 / math.sqrt(1.0 + self.pair_constants(pair)[2] * share)

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Quarter periods [s] of k1 and of k2 = k1 / e(v)^2."""
        quarter = quarter_period(self.loading_stiffness(pair, radius_eff, mass_eff, velocity), mass_eff)
        return quarter, self.restitution(pair, radius_eff, mass_eff, velocity) * quarter

    def unloading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Slope k2 [N/m] = k1 / e(v)^2."""
        stiffness = self.loading_stiffness(pair, radius_eff, mass_eff, velocity)
        return stiffness / self.restitution(pair, radius_eff, mass_eff, velocity) ** 2


class RestitutionAtVelocity(Model):
    """Unloading with the restitution of the pair at a velocity."""

    reference_velocity: q.Speed = Field(
        description="approach velocity [m/s] at which e equals the restitution of the pair",
        examples=["1 m/s"],
    )


class WaltonBraunOptions(SpringOptions):
    """Options of the model."""

    unloading: Annotated[
        Literal["constant"] | RestitutionAtVelocity,
        choose_by_first_key("it must be constant or {reference_velocity: 1 m/s}", words=("constant",)),
    ] = Field(
        description="constant (k2 = k1 / e^2: constant restitution) or {reference_velocity: 1 m/s} (k2 "
        "increases with the maximum force; e decreases with velocity and equals the restitution of the pair "
        "at this velocity)",
        examples=["constant"],
    )


MODEL = ContactModel(
    WaltonBraun,
    "Bilinear: stiffness k1 on loading, the steeper k2 on unloading (Walton & Braun 1986).",
    options=WaltonBraunOptions,
)
