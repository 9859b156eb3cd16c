"""Numbers of collisions by impact energy: each contact counts once, in the step in which it begins.

    E = m_eff v_n^2 / 2,     v_n: approach velocity half a step before the first force

The counts are integers, so that they do not depend on threads and ranks.
"""

from typing import Any

import numpy as np

from granflow.engine.exact_sums import SHARES, build_list_shares, exact_totals
from granflow.engine.neighbor.contact_history_entry import NO_CONTACT
from granflow.engine.state import State
from granflow.kernel_language import ti


def build_count_collision(state: State, with_wall: bool) -> Any:
    """Device function (chunk, list index, j, bodies, overlap rate at the half step): count a contact that begins.

    Without collision energies it does nothing. It precedes `write_history`, which marks the contact.

    Reads:   in_contact, collision_edges
    Writes:  collisions
    """
    control, neighbors, list_shares = state.control, state.neighbors, build_list_shares(state)
    wanted, rows = state.plan.features.collision_energies, state.capacities.wall_rows
    classes = state.capacities.energy_classes
    first = classes if with_wall else 0

    @ti.func
    def count_collision(chunk, list_index, j, bodies, overlap_rate):
        if ti.static(wanted):
            if neighbors.in_contact[list_index] == NO_CONTACT:
                velocity, number = ti.cast(ti.max(overlap_rate, 0.0), ti.f64), first
                energy = 0.5 * ti.cast(bodies.mass_eff, ti.f64) * (velocity * velocity)
                for edge in range(classes - 1):
                    number += ti.cast(energy >= control.collision_edges[edge], ti.i32)
                ti.atomic_add(control.collisions[chunk % rows, number][0], ti.cast(list_shares(chunk, j), ti.i64))

    return count_collision


def collision_counts(state: State) -> dict[str, np.ndarray]:
    """Numbers of collisions since the start by kind of the partner, "particle" or "wall": arrays (classes,) int64.

    The first class is below the smallest edge, the last one above the largest. Empty without collision energies.
    """
    if state.control.collisions is None:
        return {}
    words = state.ranks.total(state.control.collisions.to_numpy())
    counts = [exact_totals(words[:, column], np.array([1.0 / SHARES]))[0] for column in range(words.shape[1])]
    by_kind = np.rint(counts).astype(np.int64).reshape(2, -1)
    kinds = ("particle", "wall") if state.plan.has_walls else ("particle",)
    return dict(zip(kinds, by_kind, strict=False))
