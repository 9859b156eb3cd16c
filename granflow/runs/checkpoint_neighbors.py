"""Checks the neighbor lists of a checkpoint: valid partners, walls first, each pair as in a rebuild."""

import numpy as np

from granflow.io.checkpoint_parts import Part
from granflow.io.machine import available_memory
from granflow.plan.memory_check import MAX_LIST_ENTRIES
from granflow.plan.memory_estimate import estimate_memory
from granflow.plan.plan import Plan

LARGEST_STATE = 2
"""`in_contact` is 0 (no contact), 1 (in contact) or 2 (history that another list entry takes over)."""


def check_neighbors(neighbors: Part, count: int, plan: Plan) -> None:
    """Check the neighbor lists of `count` particles. Raises CheckpointError.

    `list_length` and `list_walls` (count,): entries per particle, and how many of these are walls or triangles, which
    precede particles. `partner` (entries,): index of a particle, or a negative number for a wall or triangle.
    `in_contact` (entries,) and the history fields (entries, components) exist if the contact model has a history.
    """
    history = plan.history
    neighbors.mapping(("list_length", "list_walls", "partner", *(["in_contact"] if history else []), *history))
    entries = len(neighbors["partner"].value) if isinstance(neighbors["partner"].value, np.ndarray) else 0
    length = neighbors["list_length"].integers(count, high=entries).astype(np.int64)
    if length.sum() != entries:
        raise neighbors["list_length"].error(f"adds up to {length.sum()}, but partner has {entries} entries")
    walls = neighbors["list_walls"].integers(count, high=entries).astype(np.int64)
    if np.any(walls > length):
        raise neighbors["list_walls"].error("is larger than list_length")
    surfaces = len(plan.walls) + sum(mesh.triangle_count for mesh in plan.meshes.values())
    partner = neighbors["partner"].integers(entries, low=-surfaces, high=count - 1).astype(np.int64)
    for name, width in history.items():
        neighbors[name].floats(entries, width)
    if history:
        neighbors["in_contact"].integers(entries, high=LARGEST_STATE)
    owner = np.repeat(np.arange(count), length)
    position_in_list = np.arange(entries) - np.repeat(np.cumsum(length) - length, length)
    if np.any((partner < 0) != (position_in_list < walls[owner])):
        raise neighbors["partner"].error("does not begin each list with its walls")
    _check_pairs(neighbors["partner"], owner, partner, count, surfaces, plan.chunk_size)
    _check_memory(neighbors["list_length"], length, plan)


def _check_pairs(part: Part, owner: np.ndarray, partner: np.ndarray, count: int, surfaces: int, chunk: int) -> None:
    """Check that each wall or triangle is listed once, a pair within a chunk in one list, across chunks in both.

    `owner`, `partner` (entries,): indices; `surfaces`: number of walls and triangles; `chunk`: particles per chunk.
    Raises CheckpointError.
    """
    if np.any(owner == partner):
        raise part.error("lists a particle as its own neighbor")
    if _repeats(owner * (count + surfaces) + partner + surfaces):
        raise part.error("lists a neighbor twice for one particle")
    particles = partner >= 0
    owner, partner = owner[particles], partner[particles]
    within = owner // chunk == partner // chunk
    if _repeats(np.minimum(owner, partner)[within] * count + np.maximum(owner, partner)[within]):
        raise part.error("lists a pair within one chunk twice")
    forward, back = (owner * count + partner)[~within], (partner * count + owner)[~within]
    if not np.array_equal(np.sort(forward), np.sort(back)):
        raise part.error("lists a pair across two chunks only once")


def _repeats(numbers: np.ndarray) -> bool:
    """Return whether a value occurs more than once in an array (n,)."""
    return len(np.unique(numbers)) < len(numbers)


def _check_memory(part: Part, length: np.ndarray, plan: Plan) -> None:
    """Check the memory: all chunks get the capacity of the longest one. Raises CheckpointError if it does not fit.

    `length` (n,): list entries of each particle.
    """
    chunk = np.arange(len(length)) // plan.chunk_size
    largest = int(np.bincount(chunk, weights=length, minlength=1).max())
    if largest <= plan.capacities.list_entries_per_chunk:
        return
    entries = plan.capacities.grown(largest, 0).list_entries
    needed, free = entries * estimate_memory(plan, plan.precision).per_neighbor, available_memory()
    if entries > MAX_LIST_ENTRIES or (free is not None and needed > free):
        raise part.error(f"requires {needed / 1e9:.3g} GB for {entries} list entries")
