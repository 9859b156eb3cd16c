"""Particles that are deleted when a stage begins."""

import numpy as np

from granflow.engine.host import remove_particles
from granflow.engine.selection import PresentParticles
from granflow.engine.state import State
from granflow.engine.totals import Accounting


def mark_deletions(state: State, accounting: Accounting, stage: str) -> list[int]:
    """Mark the particles that a stage deletes; the next rebuild of the neighbor list deletes them.

    Returns the number of particles, of all ranks, that each deletion of the stage takes, a clump as its
    spheres. The result depends on neither the order of the particles nor the ranks. All ranks call this.
    """
    plan = state.plan
    number = [each.name for each in plan.stages].index(stage)
    particles = PresentParticles(state, accounting)
    remains = np.ones(len(particles.group), bool)
    counts = []
    for index, deletion in enumerate(plan.stages[number].delete):
        chosen = remains & particles.chosen(deletion.groups, deletion.region, deletion.part)
        if deletion.fraction is not None:
            random = np.random.default_rng([plan.scene.seed, number, index])
            chosen &= random.random(accounting.inserted_count)[particles.body] < deletion.fraction
        remains &= ~chosen
        counts.append(particles.count_on_all_ranks(chosen))
    if not remains.all():
        remove_particles(state, np.flatnonzero(~remains))
    return counts
