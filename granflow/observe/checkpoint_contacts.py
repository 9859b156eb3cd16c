"""Checks the contact rows of a checkpoint: existing partners, walls first, each pair as the search lists it."""

import numpy as np

from granflow.observe.checkpoint_parts import Part
from granflow.plan import Plan
from granflow.plan.memory_check import MAX_LIST_ENTRIES, available_memory
from granflow.plan.memory_estimate import estimate_memory

LARGEST_STATE = 2
"""`in_contact` is 0 (apart), 1 (touching) or 2 (history for another slot to take over)."""

SPARE = 1.3
"""Factor by which rows that are too short grow."""


def check_contacts(contacts: Part, count: int, plan: Plan) -> None:
    """Check all rows of `count` particles. Raises CheckpointError."""
    history = plan.history
    contacts.mapping(("list_length", "list_walls", "partner", *(["in_contact"] if history else []), *history))
    slots = len(contacts["partner"].value) if isinstance(contacts["partner"].value, np.ndarray) else 0
    length = contacts["list_length"].wholes(count, high=slots).astype(np.int64)
    if length.sum() != slots:
        raise contacts["list_length"].wrong(f"adds up to {length.sum()}, but partner has {slots} slots")
    walls = contacts["list_walls"].wholes(count, high=slots).astype(np.int64)
    if np.any(walls > length):
        raise contacts["list_walls"].wrong("is larger than list_length")
    surfaces = len(plan.walls) + sum(mesh.triangle_count for mesh in plan.meshes.values())
    partner = contacts["partner"].wholes(slots, low=-surfaces, high=count - 1).astype(np.int64)
    for name, width in history.items():
        contacts[name].reals(slots, width)
    if history:
        contacts["in_contact"].wholes(slots, high=LARGEST_STATE)
    owner = np.repeat(np.arange(count), length)
    place = np.arange(slots) - np.repeat(np.cumsum(length) - length, length)
    if np.any((partner < 0) != (place < walls[owner])):
        raise contacts["partner"].wrong("does not begin each row with its walls")
    _check_pairs(contacts["partner"], owner, partner, count, surfaces, plan.chunk_size)
    _check_room(contacts["list_length"], length, plan)


def _check_pairs(part: Part, owner: np.ndarray, partner: np.ndarray, count: int, surfaces: int, chunk: int) -> None:
    """A wall or triangle is listed once, a pair within a chunk in one row, a pair across two chunks in both."""
    if np.any(owner == partner):
        raise part.wrong("names a particle as its own partner")
    if _repeats(owner * (count + surfaces) + partner + surfaces):
        raise part.wrong("names a partner twice in one row")
    particles = partner >= 0
    owner, partner = owner[particles], partner[particles]
    within = owner // chunk == partner // chunk
    if _repeats(np.minimum(owner, partner)[within] * count + np.maximum(owner, partner)[within]):
        raise part.wrong("lists a pair of one chunk in two rows")
    forward, back = (owner * count + partner)[~within], (partner * count + owner)[~within]
    if not np.array_equal(np.sort(forward), np.sort(back)):
        raise part.wrong("lists a pair of two chunks in one row only")


def _repeats(numbers: np.ndarray) -> bool:
    return len(np.unique(numbers)) < len(numbers)


def _check_room(part: Part, length: np.ndarray, plan: Plan) -> None:
    """Every chunk gets as many slots as the longest needs: that must fit into the memory."""
    chunk = np.arange(len(length)) // plan.chunk_size
    need = int(np.bincount(chunk, weights=length, minlength=1).max())
    if need <= plan.list_capacity_per_chunk:
        return
    slots = int(plan.chunk_capacity * SPARE * need)
    needed, free = slots * estimate_memory(plan, plan.scene.run.precision).per_neighbor, available_memory()
    if slots > MAX_LIST_ENTRIES or (free is not None and needed > free):
        raise part.wrong(f"needs room for {slots} contacts, {needed / 1e9:.3g} GB")
