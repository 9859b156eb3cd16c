"""Arrays of inserted particles."""

from math import pi

import numpy as np

from granflow.particles.particle_data import ParticleData
from granflow.plan.plan import Plan


def new_particle_arrays(plan: Plan, new: ParticleData, first_id: int) -> dict[str, np.ndarray]:
    """Arrays (k,) or (k, 3) by particle field for k new particles, with ids from `first_id`.

    Velocities are at the time of the positions; materials are numbers of the plan.
    """
    count = len(new)
    density = np.array([solid.density for solid in plan.solids.values()])
    numbers = {name: number for number, name in enumerate(plan.materials)}
    material = np.array([numbers.get(name, 0) for name in plan.solids])
    fixed = np.array([group.fixed for group in plan.groups])
    return {
        "id": first_id + np.arange(count),
        "material": material[new.material],
        "fixed": fixed[new.group].astype(np.int32),
        "radius": new.radius,
        "mass": 4.0 / 3.0 * pi * new.radius**3 * density[new.material],
        "position": new.position,
        "position_at_rebuild": new.position,
        "velocity": new.velocity,
        "angular_velocity": new.angular_velocity,
    }
