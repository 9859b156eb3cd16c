"""Work of moving walls on elastic contacts: the energy of the particle, to second order in the time step."""

import numpy as np
import pytest
from scene_builders import few_spheres, particle_group, plane

from granflow import Simulation

RADIUS, OVERLAP, PERIOD = 5e-3, 2e-5, 2e-3
MOTIONS = {
    "vibration": {"direction": [0, 0, 1], "amplitude": OVERLAP, "frequency": 1.0 / PERIOD},
    "rotation": {"point": [0.05, 0, 0.01], "axis": [0, 1, 0], "angular_velocity": 0.2},
}


def error(motion, steps, periods=2):
    """Largest error of the energy budget over its peak, of a particle between two planes, the upper one moving.

    K + E_elastic - W - E_inserted [J]        16 times in each period, of `steps` steps
    """
    particle = particle_group([[0.0, 0.0, RADIUS - OVERLAP]], 2 * RADIUS)
    moved = {"kind": motion} | MOTIONS[motion]
    top = plane([0, 0, 2 * RADIUS - 2 * OVERLAP], [0, 0, -1], motion=moved)
    scene = few_spheres(
        {"ball": particle}, {"floor": plane([0, 0, 0], [0, 0, 1]), "top": top}, {"restitution": 1.0},
        run={"duration": 1.0, "time_step": PERIOD / steps, "velocity_max": 0.5},
    )  # fmt: skip
    peak, largest = 0.0, 0.0
    with Simulation(scene) as simulation:
        for _ in range(round(16 * periods)):
            simulation.step(steps // 16)
            totals = simulation.snapshot(contacts=True).totals
            energy = totals["kinetic_energy"] + totals["rotational_energy"] + totals["elastic_energy"]
            peak = max(peak, energy)
            largest = max(largest, abs(energy - totals["wall_work"] + totals["removed_energy"]))
    return largest / peak


@pytest.mark.parametrize("motion", list(MOTIONS))
def test_wall_work_is_of_second_order(taichi_f64, motion):
    """Also in the middle of a cycle, and if the particle overlaps the wall at the start."""
    coarse, fine = error(motion, 64), error(motion, 256)
    assert np.log2(coarse / fine) > 2 * 1.8
    assert fine < 1e-3
