"""Tangential model: Mindlin's no-slip spring with history, limited by Coulomb friction."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.contact.law import HistoryField
from granflow.contact.material import PairMaterial
from granflow.contact.model import ContactModel
from granflow.contact.options import FRICTION
from granflow.contact.surface_law import SurfaceState, TangentialLaw
from granflow.contact.tangential.spring import (
    elastic_plastic_spring,
    reference_rotation,
    reference_spring,
    rotated_displacement,
    spring_loss,
)
from granflow.device_functions import ti


@dataclass(frozen=True)
class Mindlin(TangentialLaw):
    """Elastic-plastic spring with the no-slip stiffness of the normal model, see `tangential.spring`."""

    name = "mindlin"
    source = "Mindlin 1949; Cundall & Strack 1979; Thornton, Cummins & Cleary 2013"
    limits = "slip occurs in the whole contact area at once, and rotation about the normal does not rotate the spring"
    constant_names = ("friction",)

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Elastic tangential displacement."""
        return (HistoryField("displacement", "tangential displacement", "m", size=3),)

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Coefficient of sliding friction."""
        return (pair.friction,)

    @ti.func
    def limit(self, constants, contact):
        """Coulomb limit [N]."""
        return constants.friction * contact.normal_load

    @ti.func
    def force(self, constants, contact, history):
        """Spring force [N] after the slip of this step, limited to mu F."""
        history_new, stiffness, ratio = history, contact.stiffness, contact.stiffness_ratio
        rotated = rotated_displacement(history.displacement, contact.normal, contact.normal_half)
        force, displacement = elastic_plastic_spring(
            stiffness, ratio, self.limit(constants, contact), rotated, contact.slip
        )
        energy_lost = spring_loss(stiffness, ratio, rotated, contact.slip, force, displacement)
        history_new.displacement = displacement
        return force, history_new, energy_lost

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `force` in numpy."""
        force, displacement = reference_spring(
            contact.stiffness,
            contact.stiffness_ratio,
            contact.constants.friction * contact.normal_load,
            reference_rotation(contact.history.displacement, contact.normal, contact.normal_half),
            contact.slip,
        )
        return force, {"displacement": displacement}

    @ti.func
    def present_force(self, constants, contact, history):
        """Spring force [N] and its size [N]."""
        displacement = history.displacement
        return -contact.stiffness * displacement, contact.stiffness * ti.sqrt(displacement.dot(displacement))

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the spring [J]."""
        return 0.5 * contact.stiffness * history.displacement.dot(history.displacement)


MODEL = ContactModel(Mindlin, "spring with history, Coulomb limit", pair_options=(FRICTION,))
