"""Arrays of inserted particles."""

import numpy as np

from granflow.engine.clump_arrays import Arrays, angular_momentum, arms
from granflow.geometry.quaternion import product
from granflow.geometry.sphere import sphere_mass, sphere_volume
from granflow.particles.particle_data import ParticleData
from granflow.plan.plan import Plan


def new_particle_arrays(plan: Plan, new: ParticleData, first_id: int) -> Arrays:
    """Arrays (k,) or (k, 3) by particle field for new particles, with ids from `first_id`.

    Velocities are at the time of the positions; materials are numbers of the plan. Each clump is one particle of `new`
    and several rows of the arrays, see `sphere_rows`.
    """
    density, count = _densities(plan), len(new)
    numbers = {name: number for number, name in enumerate(plan.materials)}
    material = np.array([numbers.get(name, 0) for name in plan.solids])
    fixed = np.array([group.fixed for group in plan.groups])
    arrays = {
        "id": first_id + np.arange(count),
        "material": material[new.material],
        "fixed": fixed[new.group].astype(np.int32),
        "radius": new.radius,
        "mass": sphere_mass(new.radius, density[new.material]),
        "position": new.position,
        "position_at_rebuild": new.position,
        "velocity": new.velocity,
        "angular_velocity": new.angular_velocity,
    }
    if plan.features.liquid_transfer:
        arrays["liquid_film"] = _films(plan, new)
    return _sphere_arrays(plan, new, arrays, first_id) if plan.features.clumps else arrays


def _films(plan: Plan, new: ParticleData) -> np.ndarray:
    """Volumes (k,) [m3] of the films of new particles, whole units."""
    content = np.array([group.liquid_content for group in plan.groups])
    volume = content[new.group] * sphere_volume(new.radius)
    films: np.ndarray = np.rint(volume / plan.liquid_unit) * plan.liquid_unit
    return films


def sphere_rows(plan: Plan, new: ParticleData) -> np.ndarray:
    """Row (k,) in `new` of each of the k spheres: that of its clump, or its own."""
    sizes = np.array([1 if group.clump is None else len(group.clump) for group in plan.groups])
    return np.repeat(np.arange(len(new)), sizes[new.group])


def _densities(plan: Plan) -> np.ndarray:
    """Densities [kg/m3] of the materials of the scene."""
    return np.array([solid.density for solid in plan.solids.values()])


def _sphere_arrays(plan: Plan, new: ParticleData, bodies: Arrays, first_id: int) -> Arrays:
    """Arrays (k,) or (k, 3) of the spheres of all clumps, and of single spheres.

    bodies:  arrays (n,) or (n, 3) with a row per clump or single sphere
    """
    row = sphere_rows(plan, new)
    size = np.bincount(row, minlength=len(new))
    first = np.cumsum(size) - size
    member, count = np.arange(len(row)) - first[row], len(row)
    arrays = {name: values[row] for name, values in bodies.items()}
    arrays |= {"id": first_id + np.arange(count), "clump": np.full(count, -1), "clump_size": size[row]}
    arrays |= {"clump_mass": arrays["mass"].copy(), "orientation": np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))}
    arrays |= {name: np.zeros((count, 3)) for name in ("clump_inertia", "clump_offset")}
    for number, group in enumerate(plan.groups):
        own = np.flatnonzero(new.group[row] == number)
        if group.clump is not None and len(own):
            assert new.orientation is not None
            shape, density = group.clump, float(_densities(plan)[new.material[row[own[0]]]])
            arrays["clump"][own] = first_id + first[row[own]]
            arrays["radius"][own], arrays["clump_offset"][own] = shape.radius[member[own]], shape.offset[member[own]]
            arrays["mass"][own] = density * shape.volume * shape.volume_share[member[own]]
            arrays["clump_mass"][own], arrays["clump_inertia"][own] = density * shape.volume, density * shape.moments
            arrays["orientation"][own] = product(new.orientation[row[own]], shape.principal_axes)
    return arrays | _motion_of_spheres(arrays)


def _motion_of_spheres(arrays: Arrays) -> Arrays:
    """Positions and velocities of spheres, from those of the clumps in the same arrays."""
    arm = arms(arrays)
    position = arrays["position"] + arm
    return {
        "position": position,
        "position_at_rebuild": position,
        "velocity": arrays["velocity"] + np.cross(arrays["angular_velocity"], arm),
        "clump_position": arrays["position"],
        "clump_position_at_rebuild": arrays["position"],
        "clump_velocity": arrays["velocity"],
        "clump_angular_momentum": angular_momentum(arrays),
    }
