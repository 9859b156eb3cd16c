"""Initial capacities of the neighbor lists. Lists that are too short grow, and all kernels are compiled again."""

from math import ceil

GENEROUS_BELOW = 20_000
"""Number of particles below which memory is negligible and each particle gets `GENEROUS_NEIGHBORS` list entries."""

GENEROUS_NEIGHBORS = 7.0
"""List entries per particle in small scenes."""

IN_CONTACT_NEIGHBORS, NEIGHBORS_PER_SKIN = 3.4, 10.0
"""Candidate pairs per particle in a settled bed: contacts, and an increase with skin over radius.

Measured in beds with friction 0.5 and 10 % size spread: 3.6 to 4.0 at a skin of 0.11 radii; the rest is reserve.
"""

HISTORY_SHARE = 0.8
"""Share of the list entries that can hold a contact history at a neighbor-list rebuild."""

SPARE = 8
"""Entries per chunk in addition to a share, for chunks with few list entries."""

BOUNDS = 256
"""Number of parts of the particle list whose bounding boxes are computed in parallel at a rebuild."""

SCAN_BLOCK = 1024
"""Number of cells summed by one task of the prefix sum."""

REACH_STEPS = 40
"""Number of steps at its velocity that a particle may move between rebuilds, in addition to half the skin."""

WALL_BATCH = 256
"""Number of steps whose wall poses are uploaded together."""

GROWTH_FACTOR = 1.3
"""Factor by which the capacity exceeds the needed list entries when a list grows."""

EXTRA_PER_PARTICLE = 6
"""List entries per particle beyond twice the mean number of candidate pairs, for a chunk size of 1.

With chunk size 1, both particles list a pair, and no other particle of the chunk has free list entries."""

SHARE_AT_MESHES = 0.1
"""Share of the particles of a bed that are near a mesh wall."""


def near_triangles(edge: float, skin: float) -> float:
    """Candidate triangles of a sphere at a mesh with this edge length [m]: those within the skin of the contact.

        n = 2 (1 + 2 skin / edge)^2

    `skin` [m]. A real number, which enters the mean of all particles.
    """
    return 2.0 * (1.0 + 2.0 * skin / edge) ** 2


def neighbors_per_particle(particle_count: int, skin_over_radius: float) -> float:
    """List entries per particle, as a real number.

    Linear in `skin_over_radius`, at least GENEROUS_NEIGHBORS for fewer than GENEROUS_BELOW particles. Each pair within
    a chunk has one entry, each pair across two chunks has two.
    """
    neighbors = IN_CONTACT_NEIGHBORS + NEIGHBORS_PER_SKIN * skin_over_radius
    return max(neighbors, GENEROUS_NEIGHBORS) if particle_count < GENEROUS_BELOW else neighbors


def history_capacity(list_entries: int) -> int:
    """History entries saved at a rebuild for a chunk with this number of list entries.

    Fewer than list entries, because only pairs in contact have a history; HISTORY_SHARE is the share that fits.
    """
    return int(HISTORY_SHARE * list_entries) + SPARE


def grown_capacity(needed: int) -> int:
    """New capacity of a chunk that needs this number of list entries."""
    return int(GROWTH_FACTOR * needed) + SPARE


def list_capacity_for(saved: int) -> int:
    """List entries per chunk for which a rebuild can save this number of history entries.

    `history_capacity` of the result is at least `saved`.
    """
    return ceil((saved - SPARE + 1) / HISTORY_SHARE)
