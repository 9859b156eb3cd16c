"""Synthetic snapshots with distinct random numbers."""

import numpy as np

from granflow.fields import CONTACT_QUANTITIES, PARTICLE_QUANTITIES
from granflow.snapshot import Snapshot, WallPose


def arrays_of(quantities, count, seed=0):
    """Random arrays of all stored quantities by name, of the shapes and types in which they are written."""
    random = np.random.default_rng(seed)
    arrays = {}
    for name, quantity in quantities.items():
        if not quantity.in_snapshot:
            continue
        if quantity.file_type.startswith("float"):
            arrays[name] = random.uniform(0.1, 1.0, quantity.shape(count))
        else:
            arrays[name] = random.integers(0, 2, count).astype(quantity.file_type)
    return arrays


def particles_of(count, seed=0, **replaced):
    """Random particle arrays of single spheres; `replaced` gives arrays by name."""
    single = {"id": np.arange(count), "clump": np.full(count, -1)}
    return {**arrays_of(PARTICLE_QUANTITIES, count, seed), **single, **replaced}


def spheres_of(position, **replaced):
    """Mobile spheres of 1 kg at positions (n, 3) [m], of one group and material, each with three contacts."""
    none = np.zeros(len(position), int)
    same = {"position": position, "fixed": none, "mass": none + 1.0, "material": none, "group": none}
    contacts = {"coordination_number": none + 3, "wall_contact_count": none}
    return particles_of(len(position), **same | contacts | replaced)


def snapshot_of(time=0.0, step=0, stage="run", particles=None, contacts=None, walls=None, totals=None):
    """A snapshot of the given parts; by default of five particles with two totals, without contacts and
    walls."""
    particles = particles_of(5) if particles is None else particles
    totals = (
        {"particle_count": len(particles.get("id", ())), "kinetic_energy": 0.25} if totals is None else totals
    )
    return Snapshot(time, step, stage, particles, contacts, walls or {}, totals)


def contacts_of(count, seed=1):
    """Random contact arrays."""
    return arrays_of(CONTACT_QUANTITIES, count, seed)


def turned(angle, offset=(0.0, 0.0, 0.0), pivot=(0.0, 0.0, 0.0), present=True):
    """Pose of a wall that is rotated about z by `angle` [rad] around `pivot` [m] and then moved by `offset`
    [m]."""
    c = np.cos(angle)
    s = np.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return WallPose(present, np.array(offset), rotation, np.array(pivot))
