"""A bed at rest stays at rest: energy budget, rolling dissipation and rotation with every rolling model.

Equal particles in face-centered cubic layers with twelve neighbors each settle under gravity in a box, from
random angular velocities. No external work is done on the bed, so its energy can only decrease, the
dissipation equals the decrease, and rolling dissipates at most that energy.
"""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, plane

from granflow.observers.observer import on_interval
from granflow.simulation import Simulation

DIAMETER = 0.01
SIDE = 7
DISSIPATED = tuple(f"{name}_dissipation" for name in ("plastic", "friction", "rolling", "damping"))
STORED = tuple(f"{name}_energy" for name in ("kinetic", "rotational", "gravitational", "elastic"))


def layers(count=8):
    """Centers [m] of square layers, alternately 7 x 7 and 6 x 6, each placed in the hollows of the layer
    below."""
    positions = []
    for layer in range(count):
        inset = layer % 2
        grid = np.argwhere(np.ones((SIDE - inset, SIDE - inset, 1))) + 0.5 * (1 + inset)
        positions.append(DIAMETER * (grid * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.5 + layer / np.sqrt(2.0)]))
    return np.concatenate(positions)


def bed(rolling, normal, duration, chunk_size):
    """Soft particles with random angular velocities (rms 17 rad/s) in a box as wide as the 7 x 7 layers."""
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


def run_bed(rolling, normal, chunk_size):
    """Snapshots at 0, 30 and 60 ms, and one step later."""
    snapshots = []
    scene = bed(rolling, normal, 0.06, chunk_size)
    simulation = Simulation(scene, observers=[on_interval(0.03, snapshots.append, ("particles", "totals"))])
    simulation.run()
    simulation.engine.advance(1)
    snapshots.append(simulation.snapshot())
    simulation.free()
    return snapshots


def budget(snapshot):
    """Stored energy, dissipated energy, and the residual of the energy budget [J]."""
    totals = snapshot.totals
    stored, dissipated = (sum(totals[name] for name in names) for names in (STORED, DISSIPATED))
    return stored, dissipated, stored + dissipated + totals["removed_energy"] - totals["wall_work"]


def rms_angular_velocity(snapshot):
    """Root mean square angular velocity [rad/s]."""
    return float(np.sqrt(np.mean(np.sum(snapshot.particles["angular_velocity"] ** 2, axis=1))))


BEDS = [
    ("cdt", "zhou", "auto"),
    *(pytest.param(rolling, "zhou", "auto", marks=pytest.mark.slow) for rolling in ("none", "epsd")),
    *(pytest.param(rolling, "hertz", "auto", marks=pytest.mark.slow) for rolling in ("none", "epsd", "cdt")),
    pytest.param("cdt", "zhou", 1, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("rolling", "normal", "chunk_size"), BEDS)
def test_bed_at_rest_closes_its_energy_budget_and_stops_rotating(taichi_f64, rolling, normal, chunk_size):
    """With chunk size 1, contacts are evaluated one at a time instead of in batches."""
    start, early, late, next_step = run_bed(rolling, normal, chunk_size)
    (stored, dissipated, residual), (stored_late, dissipated_late, residual_late) = (
        budget(early),
        budget(late),
    )
    loss = stored - stored_late
    # the residual vibration is far below the elastic energy that carries the weight of the bed
    assert 0.0 < loss < 0.25 * late.totals["elastic_energy"]
    rolling_loss = late.totals["rolling_dissipation"] - early.totals["rolling_dissipation"]
    assert 0.0 <= rolling_loss < loss
    assert abs(residual_late - residual) < 0.02 * (dissipated_late - dissipated)
    assert abs(residual_late) < 1e-3 * dissipated_late
    assert rms_angular_velocity(late) < rms_angular_velocity(early) < 0.05 * rms_angular_velocity(start)
    torque = late.particles["torque"]
    torque_next = next_step.particles["torque"]
    # vibration periods are at least 20 steps: torques that alternate from step to step are an artifact of the
    # time step
    assert np.sum(torque * torque_next) > 0.5 * np.sum(torque * torque)
