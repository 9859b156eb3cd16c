"""Particles that are deleted when a stage begins."""

import numpy as np

from granflow.engine.clumps import body_positions
from granflow.engine.host import copy_to_host, remove_particles
from granflow.engine.state import State
from granflow.engine.totals import Accounting

FIELDS = ("id", "radius", "position", "clump", "clump_position")
"""Fields from which the choice of particles follows."""


def mark_deletions(state: State, accounting: Accounting, stage: str) -> list[int]:
    """Mark the particles that a stage deletes; the next rebuild of the neighbor list deletes them.

    Returns the number of particles, of all ranks, that each deletion of the stage takes, a clump as its
    spheres. The result depends on neither the order of the particles nor the ranks. All ranks call this.
    """
    plan = state.plan
    number = [each.name for each in plan.stages].index(stage)
    arrays = copy_to_host(state, FIELDS)
    groups = [group.name for group in plan.groups]
    group = accounting.by_id("group", arrays["id"])
    clump = arrays.get("clump", np.full(len(group), -1))
    body = np.where(clump >= 0, clump, arrays["id"])
    center = state.periodic_box.wrap(body_positions(arrays).astype(float))
    position = state.periodic_box.wrap(arrays["position"].astype(float))
    remains = np.ones(len(body), bool)
    counts = []
    for index, deletion in enumerate(plan.stages[number].delete):
        chosen = remains & deletion.is_in_region(center, position, arrays["radius"])
        if deletion.part == "any":
            chosen |= np.isin(body, body[chosen])
        elif deletion.part == "all":
            chosen &= ~np.isin(body, body[~chosen])
        if deletion.groups is not None:
            chosen &= np.isin(group, [groups.index(name) for name in deletion.groups])
        if deletion.fraction is not None:
            random = np.random.default_rng([plan.scene.seed, number, index])
            chosen &= random.random(accounting.inserted_count)[body] < deletion.fraction
        remains &= ~chosen
        counts.append(int(state.ranks.total(np.array([[chosen.sum()]]))[0][0]))
    if not remains.all():
        remove_particles(state, np.flatnonzero(~remains))
    return counts
