"""Values of properties that stages and programs set, and what they add to contents such as the heat."""

from collections.abc import Sequence

import numpy as np

from granflow.engine.clumps import mass_shares
from granflow.engine.host import copy_to_host, write_particles
from granflow.engine.selection import PresentParticles
from granflow.engine.state import State
from granflow.engine.sums import exact_sum
from granflow.engine.totals import Accounting, capacity_of
from granflow.scene.blocks.settings import StageSetting


def apply_settings(state: State, accounting: Accounting, settings: Sequence[StageSetting]) -> list[int]:
    """Set the properties of the particles that are present, in the order of the settings.

    A clump takes them if its center of mass is in the region. Particles keep what a wall holds to which they
    are attached.

    Returns the number of particles, of all ranks, to which each setting applies. All ranks call this.
    """
    particles = PresentParticles(state, accounting, ("mass", "clump_mass"))
    share = mass_shares(particles.arrays)
    sources = [source.name for source in state.plan.sources.values()]
    counts = []
    for setting in settings:
        chosen = particles.chosen(setting.groups, setting.region)
        indices = np.flatnonzero(chosen)
        for name, value in setting.values.items():
            held = state.plan.held_values.get(name, (None,) * len(state.plan.groups))
            free = np.array([each is None for each in held])[particles.group[indices]]
            values = np.full(len(indices), value)
            if name in sources:  # that of a clump is released in its spheres
                values *= share[indices]
            set_property(state, accounting, name, indices[free], values[free])
        counts.append(particles.count_on_all_ranks(chosen))
    return counts


def set_property(
    state: State, accounting: Accounting, name: str, indices: np.ndarray, values: np.ndarray
) -> None:
    """Set a property of the particles with these device indices (k,) to values (k,); its content is booked.

    All ranks call this.
    """
    equation = next((each for each in state.plan.scene.equations if each.name == name), None)
    if equation is not None and equation.content is not None:
        arrays = {key: each[indices] for key, each in copy_to_host(state, ("mass", "material", name)).items()}
        change = capacity_of(state.plan, equation, arrays) * (values - arrays[name])
        accounting.contents[equation.content_change("set").name] += exact_sum(change, state.ranks)
    write_particles(state, indices, {name: values})
