"""Work of moving walls on elastic contacts: the energy of the particle, to second order in the time step."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow import Simulation

RADIUS, OVERLAP, PERIOD = 5e-3, 2e-5, 2e-3
MOTIONS = {
    "vibration": {
        "kind": "vibration",
        "direction": [0, 0, 1],
        "amplitude": OVERLAP,
        "frequency": 1.0 / PERIOD,
    },
    "rotation": {"kind": "rotation", "point": [0.05, 0, 0.01], "axis": [0, 1, 0], "angular_velocity": 0.2},
}


def residuals(motion, steps, periods):
    """Error of the energy budget (times,) of a particle between two planes, of which the upper one moves, and
    its peak.

    K + E_elastic - W - E_inserted [J]        16 times in each period, of `steps` steps
    """
    particle = particle_group([[0.0, 0.0, RADIUS - OVERLAP]], 2 * RADIUS)
    top = plane([0, 0, 2 * RADIUS - 2 * OVERLAP], [0, 0, -1], motion=MOTIONS[motion])
    scene = build_scene(
        {"ball": particle}, walls={"floor": plane([0, 0, 0], [0, 0, 1]), "top": top}, normal="hertz",
        pair={"restitution": 1.0}, run={"duration": 1.0, "time_step": PERIOD / steps, "velocity_max": 0.5},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    simulation = Simulation(scene)
    peak = 0.0
    found = []
    for _ in range(round(16 * periods)):
        simulation.step(steps // 16)
        totals = simulation.snapshot(contacts=True).totals
        energy = totals["kinetic_energy"] + totals["rotational_energy"] + totals["elastic_energy"]
        peak = max(peak, energy)
        found.append(energy - totals["wall_work"] + totals["removed_energy"])
    simulation.free()
    return np.array(found), peak


@pytest.mark.parametrize("motion", list(MOTIONS))
def test_wall_work_is_of_second_order(taichi_f64, motion):
    """Also in the middle of a cycle, and if the particle overlaps the wall at the start."""
    errors = []
    for steps in (128, 256, 512):
        found, peak = residuals(motion, steps, 2)
        errors.append(np.abs(found).max() / peak)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 1.8), errors
    assert errors[-1] < 1e-3
