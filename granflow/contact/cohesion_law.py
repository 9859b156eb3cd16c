"""Interface of the cohesion models."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from granflow.contact import theory
from granflow.contact.law import ContactState, Law
from granflow.contact.material import PairMaterial
from granflow.device_functions import ti


@dataclass(frozen=True)
class CohesionLaw(Law):
    """A cohesion model: an attraction in addition to any normal model; it does not press the surfaces together.

    `force` has no branch, as for a normal model. A model that acts at a distance also gets negative overlaps, down to
    minus its `range`; its first history field is above 0 as long as the contact keeps its history without overlap.
    """

    required = ("force",)
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {**Law.returns, "force": ("number", "history")}
    at_distance: ClassVar[bool] = False
    """True for a model that acts without overlap, such as a liquid bridge."""
    transfers_liquid: ClassVar[bool] = False
    """True for a model whose bridges take liquid from films on the particles; `form` gets the volume of a new one."""

    @property
    def range(self) -> float:
        """Largest distance [m] between the surfaces at which the model acts; 0 for a model that requires overlap."""
        return 0.0

    @property
    def parameters(self) -> Mapping[str, float]:
        """The range of a model that acts at a distance; the engine reads it on the device."""
        return {"range": self.range} if self.at_distance else {}

    def pull_off_force(self, pair: PairMaterial, radius_eff: float) -> float | None:
        """Force [N] that separates a pair at rest; None if it depends on the load."""
        return None

    def equivalent_velocity(self, pair: PairMaterial, radius_eff: float, mass_eff: float) -> float:
        """Impact velocity [m/s] at which a Hertz contact is as stiff as the cohesive contact at rest.

        By default that of a contact that the pull-off force F presses together: a^3 = 3 F R / (4 E).
        """
        force = self.pull_off_force(pair, radius_eff) or 0.0
        contact_radius = float(np.cbrt(0.75 * force * radius_eff / pair.modulus_eff))
        return theory.velocity_for_radius(pair.modulus_eff, radius_eff, mass_eff, contact_radius)

    @ti.func
    def force(self, constants, contact, history):
        """Attraction [N], positive, and the history."""

    @ti.func
    def form(self, constants, contact, history, volume):
        """The history after a bridge of a volume [m3] has formed; its first field is the volume of the bridge."""

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Recoverable energy [J]; negative for an attraction."""
        return 0.0 * contact.overlap

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Dissipated energy [J] that is a function of the history alone; of an open contact at minus the range."""
        return 0.0 * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`: attraction [N] and the changed history fields."""
        raise NotImplementedError
