"""Interface of the normal contact models."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np

from granflow.contact import theory
from granflow.contact.law import ContactState, Law
from granflow.contact.material import PairMaterial
from granflow.device_functions import ti


@dataclass(frozen=True)
class NormalLaw(Law):
    """A normal contact model.

    The first two constants are the effective moduli E and G [Pa]. The first history field is positive from the first
    step of a contact on. Closed forms describe a binary collision of a pair at an approach velocity [m/s] with the
    effective radius [m] and mass [kg].
    """

    required = ("force", "stored_energy", "phase_durations", "unloading_stiffness")
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Law.returns,
        "force": ("number", "number", "history"),
        "prepare": ("history",),
        **dict.fromkeys(("tangential_stiffness", "damping", "attraction"), ("number",)),
    }
    constant_names: ClassVar[tuple[str, ...]] = ("modulus_eff", "shear_modulus_eff")
    tangential_stiffness_grows: ClassVar[bool] = True
    """True if the tangential stiffness is proportional to the square root of the overlap."""
    branch_free: ClassVar[bool] = True
    """True if `force` has no branch, so that contacts can be evaluated in SIMD batches. Other models use full
    neighbor lists."""
    has_dashpot: ClassVar[bool] = False
    """True for a model with `damping`."""
    limits_restitution: ClassVar[bool] = False
    """True for a model that bounds its unloading tangent by the time step, see `least_restitution`."""

    @property
    def softer_after_slow_onset(self) -> bool:
        """Whether a contact that begins slowly remains softer than a Hertz contact when it is loaded later."""
        return False

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`: the effective moduli [Pa], by default followed by pair options.

        Raises ValueError for a pair that the model does not support.
        """
        options = (pair.options[name] for name in self.constant_names[2:])
        return pair.modulus_eff, pair.shear_modulus_eff, *options

    @property
    def unloading_angle(self) -> float:
        """theta of a model that bounds its unloading tangent by theta^2 M/dt^2; 0: no such bound."""
        return 0.0

    @property
    def reloading_damping(self) -> float:
        """Damping ratio, with the unloading tangent, of contacts that are compressed again without having separated."""
        return 0.0

    def unloading_number(self, pair: PairMaterial) -> float:
        """Largest K dt^2/M + 2 c dt/M of a bounded unloading tangent K and its damping c, by default theta^2."""
        return self.unloading_angle**2

    def unresolved_unloading(self, pair: PairMaterial) -> float:
        """If the ratio of unloading to loading duration is below this value, the time step need not resolve unloading.

        The model then bounds its own tangent.
        """
        return 0.0

    @property
    def rate_dependent(self) -> bool:
        """Whether the force depends on the overlap rate at the time level."""
        return False

    @property
    def attracts(self) -> bool:
        """Whether the force can be attractive."""
        return False

    @property
    def prepares(self) -> bool:
        """Whether `prepare` changes the history."""
        return False

    @ti.func
    def prepare(self, constants, contact, history):
        """History after rare operations with branches, such as the initialization of a contact.

        Evaluated before `force`, so that `force` remains branch-free arithmetic that the compiler can vectorize over
        contacts.
        """
        return history

    @ti.func
    def force(self, constants, contact, history):
        """Normal force [N], its viscous part [N], and the history."""

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Recoverable energy [J]."""

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Dissipated energy [J] that is a function of the history alone (plastic work)."""
        return 0.0 * contact.overlap

    @ti.func
    def tangential_stiffness(self, constants, contact, history):
        """No-slip stiffness of a Hertz contact [N/m] (Mindlin 1949).

        kt = 8 G sqrt(R d)
        """
        return 8.0 * constants.shear_modulus_eff * ti.sqrt(contact.radius_eff * contact.overlap)

    @ti.func
    def damping(self, constants, contact, history):
        """Ratio of the viscous force to the overlap rate at the present overlap [N s/m]."""
        return 0.0 * contact.overlap

    @ti.func
    def attraction(self, constants, contact, history):
        """Attractive part of `force` [N] that does not press the surfaces together."""
        return 0.0 * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`: normal force [N] and the changed history fields.

        In numpy, written from the publication and not from the kernel.
        """
        raise NotImplementedError

    def reference_force(
        self,
        constants: np.ndarray,
        radius_eff: float,
        mass_eff: float,
        time_step: float,
        overlap: float,
        overlap_rate: float,
        history: np.ndarray,
    ) -> tuple[float, np.ndarray]:
        """Normal force [N] and history from the reference implementation, with constants and history as arrays."""
        named = SimpleNamespace(**dict(zip(self.constant_names, constants, strict=False)))
        before = dict(zip(self.history_names, history, strict=False))
        state = ContactState(named, radius_eff, mass_eff, time_step, overlap, overlap_rate, SimpleNamespace(**before))
        force, changed = self.reference(state)
        return float(force), np.array(list((before | dict(changed)).values()) or history)

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s]."""
        raise NotImplementedError

    def unloading_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Largest tangent stiffness [N/m] in a binary collision."""
        raise NotImplementedError

    def stable_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Tangent stiffness [N/m] at the maximum overlap of a confined particle; it bounds the time step."""
        return self.unloading_stiffness(pair, radius_eff, mass_eff, velocity)

    def loading_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Normal tangent stiffness [N/m] at the maximum overlap; 4 G/E times it is the tangential stiffness."""
        return self.stable_stiffness(pair, radius_eff, mass_eff, velocity)

    def overlap_max(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Maximum overlap [m]; by default that of Hertz loading (Zhou 2011, Eq. 5)."""
        k = theory.hertz_stiffness(pair.modulus_eff, radius_eff)
        return float(theory.overlap_max(k, mass_eff, velocity))

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Ratio of viscous force to overlap rate at the maximum overlap of a collision [N s/m]."""
        return 0.0

    def present_response(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> tuple[float, float]:
        """Largest tangent stiffness [N/m] and viscosity [N s/m] at the maximum overlap, loading or unloading.

        A servo wall, which reacts to the force, must react more slowly than these change the force. A contact of the
        restitution 0 stops the particle in one step: M/dt.
        """
        arguments, rate = (pair, radius_eff, mass_eff, velocity), mass_eff / time_step
        stiffness = self.unloading_stiffness(*arguments)
        if self.limits_restitution:
            stiffness = min(stiffness, self.unloading_angle**2 * rate / time_step)
        at_rest = 2.0 * self.reloading_damping * float(np.sqrt(stiffness * mass_eff))
        return stiffness, rate if pair.restitution == 0.0 else max(self.viscosity(*arguments), at_rest)

    def restitution(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Restitution at a time step that resolves the collision; by default that of the pair.

        Raises ValueError if the pair has none.
        """
        return pair.restitution_at(velocity)

    def least_restitution(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> float:
        """Smallest restitution that a collision can reach at a time step [s]."""
        return 0.0
