"""How many contact slots to allocate at first; rows that turn out too short grow, at the cost of compiling anew."""

from math import ceil

GENEROUS_BELOW = 20_000
"""Particles up to which memory is no matter and every one gets `GENEROUS_NEIGHBORS` slots."""

GENEROUS_NEIGHBORS = 7.0

IN_CONTACT_NEIGHBORS, NEIGHBORS_PER_SKIN = 3.4, 10.0
"""Near partners listed per particle of a settled bed: those that touch, and more with the skin over the radius.

Measured in beds with friction 0.5 and 10 % spread: 3.6 to 4.0 at a skin of 0.11 radii; what is above that is spare.
"""

HISTORY_SHARE = 0.8
"""Share of the slots that can hold history at a search."""

SPARE = 8

BOUNDS = 1024
"""Parts of the particles whose boxes are found side by side at a search."""

EXTRA_PER_PARTICLE = 6
"""Slots above twice the mean where every particle is a chunk of its own and lists all of its partners."""


SHARE_AT_MESHES = 0.1
"""Particles of a bed that lie at a mesh wall."""


def near_triangles(edge: float, skin: float) -> float:
    """Triangles of a mesh with such edges [m] that a sphere at it lists: those within the skin of its foot."""
    return 2.0 * (1.0 + 2.0 * skin / edge) ** 2


def neighbors_per_particle(particle_count: int, skin_over_radius: float) -> float:
    """Slots for each particle."""
    neighbors = IN_CONTACT_NEIGHBORS + NEIGHBORS_PER_SKIN * skin_over_radius
    return max(neighbors, GENEROUS_NEIGHBORS) if particle_count < GENEROUS_BELOW else neighbors


def history_capacity(list_entries: int) -> int:
    """Slots in which a search keeps the history of a chunk that has so many slots."""
    return int(HISTORY_SHARE * list_entries) + SPARE


def list_capacity_for(saved: int) -> int:
    """Slots a chunk must have for a search to keep so many."""
    return ceil((saved - SPARE + 1) / HISTORY_SHARE)
