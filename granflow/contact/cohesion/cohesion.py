"""Cohesion models: an attractive force that can be added to any normal contact model.

Simplified Johnson-Kendall-Roberts (SJKR): cohesion energy density times the intersection area of the undeformed
spheres, while they overlap. The attraction does not press the surfaces together, so the friction limit uses the normal
force without it, as Luding (2008) uses f_n + k_c d.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import taichi as ti

from granflow.contact.material import PairMaterial
from granflow.contact.model import ContactState, NormalLaw


def with_sjkr(law: NormalLaw) -> NormalLaw:
    """Add SJKR cohesion to a contact model. Closed forms (durations, restitution) remain those of the model alone.

        F = F_law - w A,   A = 2 pi R d   to first order in d / R,   w the cohesion energy density of the pair [J/m3]

    law:      contact model; its constants, history and attraction are kept
    Returns:  model with the additional constant `cohesion_energy_density`
    """
    index = len(law.constant_names)

    @ti.func
    def cohesive_force(constants, radius_eff, overlap):
        """Attraction w A [N] of an overlap."""
        return 2.0 * math.pi * constants[index] * radius_eff * overlap

    @ti.func
    def attraction(constants, radius_eff, overlap, history):
        """Attraction [N] that the friction limit excludes: that of the model and the cohesive force."""
        total = cohesive_force(constants, radius_eff, overlap)
        if ti.static(law.attracts):
            total += law.attraction(constants, radius_eff, overlap, history)
        return total

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """Force of the model minus the attraction; viscous part and history of the model are unchanged."""
        normal_force, viscous, history_new = law.force(
            constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history
        )
        return normal_force - cohesive_force(constants, radius_eff, overlap), viscous, history_new

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """Stored energy of the model minus the surface energy pi w R d^2 [J]."""
        surface_energy = 0.5 * cohesive_force(constants, radius_eff, overlap) * overlap
        return law.stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history) - surface_energy

    def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
        return *law.pair_constants(pair), pair.cohesion_energy_density

    def reference(contact: ContactState) -> tuple[float, np.ndarray]:
        force, history_new = law.reference(replace(contact, constants=contact.constants[:index]))
        area = 2.0 * math.pi * contact.radius_eff * contact.overlap
        return force - contact.constants[index] * area, history_new

    return replace(
        law,
        source=f"{law.source}; cohesion: SJKR as in LIGGGHTS, after Johnson, Kendall & Roberts 1971",
        constant_names=(*law.constant_names, "cohesion_energy_density"),
        pair_constants=pair_constants,
        force=force,
        stored_energy=stored_energy,
        attraction=attraction,
        reference=reference,
    )


COHESIONS: Mapping[str, Callable[[NormalLaw], NormalLaw]] = MappingProxyType({"sjkr": with_sjkr})
"""Values of `contact.cohesion` other than none."""
