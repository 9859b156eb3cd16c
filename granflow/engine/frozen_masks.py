"""Fixed particles on the device: they do not move, and other particles collide with them as with an infinite mass."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.engine.state import State
from granflow.kernel_language import ti

FROZEN_MASS_FACTOR = 2.0**60
"""Mass factor of a fixed particle in contacts: the term of its partner's mass is below rounding, also in f64."""


def build_mobility(state: State) -> Any:
    """Device function (i): 1, or 0 for a fixed particle.

    Reads:  fixed
    """
    particles, real = state.particles, state.backend.real

    @ti.func
    def mobility(i):
        share = ti.cast(1.0, real)
        if ti.static(state.plan.features.fixed_particles):
            share = ti.cast(1 - particles.fixed[i], real)
        return share

    return mobility


def build_contact_mass(state: State) -> Any:
    """Device function (i): mass [kg] of a particle in its contacts, FROZEN_MASS_FACTOR times as large if it is fixed.

    A sphere of a clump has the mass of the clump, as in LIGGGHTS and MercuryDPM.

    Reads:  mass, fixed, clump_mass
    """
    particles, real = state.particles, state.backend.real
    mass_field = particles.clump_mass if state.plan.features.clumps else particles.mass

    @ti.func
    def contact_mass(i):
        mass = mass_field[i]
        if ti.static(state.plan.features.fixed_particles):
            mass *= ti.select(particles.fixed[i] == 1, ti.cast(FROZEN_MASS_FACTOR, real), ti.cast(1.0, real))
        return mass

    return contact_mass


def build_can_touch(state: State) -> Any:
    """Device function (i, j): false for two fixed particles, a fixed particle and a wall (j < 0), and in a clump.

    Reads:  fixed, clump
    """
    particles = state.particles

    @ti.func
    def can_touch(i, j):
        can = True
        if ti.static(state.plan.features.fixed_particles):
            if particles.fixed[i] == 1:
                can = j >= 0
                if j >= 0:
                    can = particles.fixed[j] == 0
        if ti.static(state.plan.features.clumps):
            if j >= 0:
                can = can and (particles.clump[i] < 0 or particles.clump[i] != particles.clump[j])
        return can

    return can_touch


def mobility_mask(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """1.0 for mobile and 0.0 for fixed particles, float64 (n,).

    arrays:  particle fields: mass (n,), and `fixed` (n,) only if some are fixed
    """
    fixed = arrays.get("fixed", np.zeros(len(arrays["mass"]), np.int32))
    return 1.0 - np.asarray(fixed, float)
