"""A bed at rest stays at rest: energy budget, rolling dissipation and rotation with every rolling model.

Equal spheres in face-centered cubic layers, twelve neighbors each, settle under gravity in a box from random angular
velocities. After that nothing does work on them: the energy of the bed can only fall, what falls must be booked as
dissipation, and rolling cannot dissipate more than the bed loses.
"""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, plane

from granflow.observe import every
from granflow.simulation import Simulation

DIAMETER = 0.01
SIDE = 7
DISSIPATED = tuple(f"{name}_dissipation" for name in ("plastic", "friction", "rolling", "damping"))
HELD = tuple(f"{name}_energy" for name in ("kinetic", "rotational", "gravitational", "elastic"))


def layers(count=8):
    """Centers [m] of square layers, each in the hollows of the one below: alternately 7 x 7 and 6 x 6 spheres."""
    positions = []
    for layer in range(count):
        inset = layer % 2
        grid = np.argwhere(np.ones((SIDE - inset, SIDE - inset, 1))) + 0.5 * (1 + inset)
        positions.append(DIAMETER * (grid * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.5 + layer / np.sqrt(2.0)]))
    return np.concatenate(positions)


def bed(rolling, normal, duration, chunk_size):
    """Soft spheres with angular velocities at random, rms 17 rad/s, in a box that the 7 x 7 layers fill."""
    positions = layers()
    angular_velocity = np.random.default_rng(4).normal(0.0, 10.0, positions.shape)
    walls = box(SIDE * DIAMETER) | {"high_z": plane([0.0, 0.0, 0.2], [0.0, 0.0, -1.0])}
    rolling_friction = {} if rolling == "none" else {"rolling_friction": 0.1}
    return build_scene(
        {"spheres": particle_group(positions, DIAMETER, angular_velocity=angular_velocity)},
        walls=walls,
        rolling=rolling,
        normal=normal,
        pair={"restitution": 0.5, "friction": 0.5} | rolling_friction,
        gravity=[0.0, 0.0, -9.81],
        materials={"glass": {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}},
        run={"duration": duration, "velocity_max": 0.1},
        output={"interval": 1.0, "energy_budget": True},
        numerics={"time_step_fraction": 0.2, "chunk_size": chunk_size},
    )


def resolve_scene(rolling, normal, chunk_size):
    """Snapshots at 0, 30 and 60 ms, and one step later."""
    seen = []
    scene = bed(rolling, normal, 0.06, chunk_size)
    simulation = Simulation(scene, observers=[every(0.03, seen.append, ("particles", "totals"))])
    simulation.run()
    simulation.engine.advance(1)
    seen.append(simulation.snapshot())
    simulation.free()
    return seen


def budget(snapshot):
    """Energy of the bed, energy dissipated, and what is missing between them and the energy brought in [J]."""
    totals = snapshot.totals
    held, dissipated = (sum(totals[name] for name in names) for names in (HELD, DISSIPATED))
    return held, dissipated, held + dissipated + totals["removed_energy"] - totals["wall_work"]


def rotation(snapshot):
    """Root mean square angular velocity [rad/s]."""
    return float(np.sqrt(np.mean(np.sum(snapshot.particles["angular_velocity"] ** 2, axis=1))))


BEDS = [
    *((rolling, "zhou", "auto") for rolling in ("none", "epsd", "cdt")),
    *(pytest.param(rolling, "hertz", "auto", marks=pytest.mark.slow) for rolling in ("none", "epsd", "cdt")),
    pytest.param("cdt", "zhou", 1, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("rolling", "normal", "chunk_size"), BEDS)
def test_bed_at_rest_closes_its_energy_budget_and_stops_rotating(taichi_f64, rolling, normal, chunk_size):
    """Chunk size 1 evaluates contacts one at a time instead of in batches."""
    start, early, late, next_step = resolve_scene(rolling, normal, chunk_size)
    (held, dissipated, residual), (held_late, dissipated_late, residual_late) = budget(early), budget(late)
    lost = held - held_late
    # what is left of vibration, far below the elastic energy that carries the weight of the bed
    assert 0.0 < lost < 0.25 * late.totals["elastic_energy"]
    rolled = late.totals["rolling_dissipation"] - early.totals["rolling_dissipation"]
    assert 0.0 <= rolled < lost
    assert abs(residual_late - residual) < 0.02 * (dissipated_late - dissipated)
    assert abs(residual_late) < 1e-3 * dissipated_late
    assert rotation(late) < rotation(early) < 0.05 * rotation(start)
    torque, torque_next = late.particles["torque"], next_step.particles["torque"]
    # vibrations last 20 steps or more: torques that alternate from step to step are the time step's, not the bed's
    assert np.sum(torque * torque_next) > 0.5 * np.sum(torque * torque)
