"""Checks the contacts of a checkpoint: valid partners, and each contact between two particles at both of them."""

import numpy as np

from granflow.io.checkpoint_parts import Part
from granflow.plan.plan import Plan


def check_contacts(contacts: Part, ids: np.ndarray, plan: Plan, complete: bool = True) -> None:
    """Check the contact histories of the particles with these ids (n,). Raises CheckpointError.

    `complete`: whether these are all particles; otherwise partners can be in the files of other ranks.
    `count` (n,): contacts per particle. `partner` (contacts,): id of a particle, or a negative number for a wall or
    triangle. The histories (contacts, components) exist if the contact models have some.
    """
    names = set(contacts.mapping()) - {"count", "partner"}
    contacts.mapping(("count", "partner", *(plan.history if names else ())))
    total = len(contacts["partner"].value) if isinstance(contacts["partner"].value, np.ndarray) else 0
    if total and not names:
        raise contacts.error("has no histories")
    count = contacts["count"].integers(len(ids), high=total).astype(np.int64)
    if count.sum() != total:
        raise contacts["count"].error(f"adds up to {count.sum()}, but partner has {total} entries")
    surfaces = len(plan.walls) + sum(mesh.triangle_count for mesh in plan.meshes.values())
    partner = contacts["partner"].integers(total, low=-surfaces).astype(np.int64)
    for name in names:
        contacts[name].floats(total, plan.history[name])
    _check_pairs(contacts["partner"], np.repeat(ids.astype(np.int64), count), partner, ids, complete)


def _check_pairs(part: Part, owner: np.ndarray, partner: np.ndarray, ids: np.ndarray, complete: bool) -> None:
    """Check that each contact occurs once at each of its particles, which have the ids (n,). Raises CheckpointError."""
    particles = partner >= 0
    if complete and not np.isin(partner[particles], ids).all():
        raise part.error("names a particle that does not exist")
    if np.any(owner == partner):
        raise part.error("lists a particle as in contact with itself")
    pairs = np.stack([owner, partner], axis=1)
    if len(np.unique(pairs, axis=0)) < len(pairs):
        raise part.error("lists a contact twice for one particle")
    forward, back = pairs[particles], pairs[particles][:, ::-1]
    if complete and not np.array_equal(_in_order(forward), _in_order(back)):
        raise part.error("lists a contact between two particles at one of them only")


def _in_order(pairs: np.ndarray) -> np.ndarray:
    """The rows of an array (n, 2) in lexicographic order."""
    found: np.ndarray = pairs[np.lexsort(pairs.T)]
    return found
