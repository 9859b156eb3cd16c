"""Checks the clumps of a checkpoint: complete bodies with the spheres, masses and moments of inertia of the scene."""

import numpy as np

from granflow.geometry.sphere import sphere_mass
from granflow.io.checkpoint_parts import Part
from granflow.plan.plan import Plan

ROUNDING = 1e-5
"""Relative tolerance of masses, moments, lengths and norms: rounding in single precision."""


def check_clumps(particles: Part, ids: np.ndarray, group: np.ndarray, density: np.ndarray, plan: Plan) -> np.ndarray:
    """Check the clumps of particles with these ids, groups and densities [kg/m3], all (n,); returns the masses (n,).

    The device reads the spheres of a clump by their ids, which follow each other: each must exist. Raises
    CheckpointError.
    """
    count = len(ids)
    clump = particles["clump"].integers(count, low=-1).astype(np.int64)
    shapes = [each.clump for each in plan.groups]
    size = np.array([1 if shape is None else len(shape) for shape in shapes])[group]
    if np.any((clump >= 0) != np.array([shape is not None for shape in shapes])[group]):
        raise particles["clump"].error("differs from the groups in accounting")
    if np.any(particles["clump_size"].integers(count) != size):
        raise particles["clump_size"].error("differs from the number of spheres in the scene")
    member = np.where(clump >= 0, ids - clump, 0)
    of_clump, found = np.unique(clump[clump >= 0], return_counts=True)
    sizes = size[np.searchsorted(ids, of_clump)] if np.isin(of_clump, ids).all() else np.zeros(len(of_clump))
    if np.any((member < 0) | (member >= size)) or np.any(found != sizes):
        raise particles["clump"].error("describes a clump without some of its spheres")
    return _check_shapes(particles, group, density, member, plan)


def _check_shapes(
    particles: Part, group: np.ndarray, density: np.ndarray, member: np.ndarray, plan: Plan
) -> np.ndarray:
    """Check masses, moments and spheres of the clumps; returns the masses (n,) [kg] of all spheres."""
    count, radius = len(group), particles["radius"].floats(len(group)).astype(float)
    mass, inertia, offset = sphere_mass(radius, density), np.zeros((count, 3)), np.zeros((count, 3))
    of_body = mass.copy()
    for number, shape in enumerate(each.clump for each in plan.groups):
        rows = group == number
        if shape is not None:
            of_body[rows] = density[rows] * shape.volume
            mass[rows] = of_body[rows] * shape.volume_share[member[rows]]
            inertia[rows], offset[rows] = density[rows, None] * shape.moments, shape.offset[member[rows]]
    expected = {"clump_mass": of_body, "clump_inertia": inertia, "clump_offset": offset}
    for name, values in expected.items():
        scale = np.abs(values).max(axis=tuple(range(1, values.ndim)), keepdims=True)
        if np.any(np.abs(particles[name].floats(*values.shape) - values) > ROUNDING * scale):
            raise particles[name].error("differs from the clumps of the scene")
    norm = np.linalg.norm(particles["orientation"].floats(count, 4).astype(float), axis=1)
    if np.any(np.abs(norm - 1.0) > ROUNDING):
        raise particles["orientation"].error("is not a unit quaternion")
    return mass
