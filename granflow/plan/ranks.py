"""Plan of one of several MPI ranks."""

from dataclasses import replace
from math import ceil

from granflow.plan.plan import Plan

BALANCE = 1.2
"""Particles of a rank over the mean for which its arrays are allocated; they grow if one rank has more."""

GHOST_LAYERS = 1.5
"""Thickness of the layer of ghosts in diameters."""


def rank_plan(plan: Plan, ranks: int) -> Plan:
    """The plan of each of `ranks` ranks: capacity for its share of the particles and for the ghosts of a cube of them.

    n + [(n^(1/3) + 2 layers)^3 - n]        n = 1.2 N / ranks
    """
    share = min(BALANCE * plan.particle_capacity / ranks, plan.particle_capacity)
    ghosts = (share ** (1 / 3) + 2.0 * GHOST_LAYERS) ** 3 - share if ranks > 1 else 0.0
    needed = ceil(share + min(ghosts, plan.particle_capacity - share)) + plan.chunk_size
    return replace(plan, particle_capacity=needed, has_ghosts=True)
