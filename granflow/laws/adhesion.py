"""Adhesion slot: an attraction that any normal law can have added.

Simplified Johnson-Kendall-Roberts (SJKR): a cohesion energy density times the area in which the undeformed spheres
cross, while they touch. It presses nothing together, so friction is capped with the force of the law without it, as
Luding (2008) caps it with f_n + k_c d.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import taichi as ti

from granflow.laws.law import NormalLaw, Touch
from granflow.laws.material import PairMaterial


def with_sjkr(law: NormalLaw) -> NormalLaw:
    """The law with SJKR adhesion; its closed forms stay those of the law itself.

    F = F_law - w A,   A = 2 pi R d   to first order in d / R,   w the pair's cohesion energy density [J/m3]
    """
    place = len(law.constant_names)

    @ti.func
    def pull(constants, radius_eff, overlap):
        return 2.0 * math.pi * constants[place] * radius_eff * overlap

    @ti.func
    def attraction(constants, radius_eff, overlap, history):
        total = pull(constants, radius_eff, overlap)
        if ti.static(law.attracts):
            total += law.attraction(constants, radius_eff, overlap, history)
        return total

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """Force of the law less the pull; what is viscous and what is remembered are the law's."""
        normal_force, viscous, memory = law.force(
            constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history
        )
        return normal_force - pull(constants, radius_eff, overlap), viscous, memory

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """The law's, less what the surfaces gained by meeting: pi w R d^2."""
        gained = 0.5 * pull(constants, radius_eff, overlap) * overlap
        return law.stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history) - gained

    def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
        return *law.pair_constants(pair), pair.cohesion_energy_density

    def twin(touch: Touch) -> tuple[float, np.ndarray]:
        force, memory = law.twin(replace(touch, constants=touch.constants[:place]))
        area = 2.0 * math.pi * touch.radius_eff * touch.overlap
        return force - touch.constants[place] * area, memory

    return replace(
        law,
        source=f"{law.source}; adhesion: SJKR as in LIGGGHTS, after Johnson, Kendall & Roberts 1971",
        constant_names=(*law.constant_names, "cohesion_energy_density"),
        pair_constants=pair_constants,
        force=force,
        stored_energy=stored_energy,
        attraction=attraction,
        twin=twin,
    )


ADHESIONS: Mapping[str, Callable[[NormalLaw], NormalLaw]] = MappingProxyType({"sjkr": with_sjkr})
"""What `contact.adhesion` may say besides none."""
