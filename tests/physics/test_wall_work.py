"""Work and power of moving walls against the mechanics of one sphere."""

import csv

import numpy as np
import pytest
from scene_builders import SOFT, few_spheres, particle_group, plane

from granflow import Simulation

RADIUS, OVERLAP, PERIOD = 5e-3, 2e-5, 2e-3
GRAVITY = 9.81
OUTPUT = {"interval": 1.0, "energy_budget": True, "wall_forces": True}
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * 2500.0
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
        run={"duration": 1.0, "time_step": PERIOD / steps, "velocity_max": 0.5}, output=OUTPUT,
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


def test_a_vibrating_plate_lifts_a_sphere(tmp_path, taichi_f64):
    """A sphere stays on a plate z = A sin(w t) as long as A w^2 < g, with its velocity.

        W(t) = m g z + m (v^2 - v0^2) / 2 = m g A sin(w t) - m (A w)^2 / 2 sin^2(w t)

    so that a quarter of a period takes m g A - m (A w)^2 / 2 and the next one returns it; the largest power of a
    row is that of a quarter, too. The sphere starts at rest relative to the plate, on an elastic contact that
    carries its weight. The weight is carried by the plate alone, so that its force is (g + z'') m.
    """
    period, amplitude = 0.02, 2e-5
    rate = 2 * np.pi / period
    stiff = SOFT | {"young_modulus": 1e10}
    modulus = stiff["young_modulus"] / (2.0 * (1.0 - stiff["poisson_ratio"] ** 2))
    overlap = (MASS * GRAVITY / (4.0 / 3.0 * modulus * np.sqrt(RADIUS))) ** (2.0 / 3.0)
    motion = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": amplitude, "frequency": 1.0 / period}
    ball = particle_group([[0.0, 0.0, RADIUS - overlap]], velocity=[[0.0, 0.0, amplitude * rate]])
    scene = few_spheres(
        {"ball": ball}, {"plate": plane([0, 0, 0], [0, 0, 1], motion=motion)}, {"restitution": 0.8},
        materials={"glass": stiff}, gravity=[0.0, 0.0, -GRAVITY],
        run={"duration": 0.5 * period, "velocity_max": 0.1},
        output=OUTPUT | {"timeseries_interval": 0.25 * period},
    )  # fmt: skip
    with Simulation(scene, out=tmp_path / "out") as simulation:
        result = simulation.run().numbers
    lifted = MASS * GRAVITY * amplitude - 0.5 * MASS * (amplitude * rate) ** 2
    with (tmp_path / "out" / "timeseries.csv").open() as file:
        powers = [float(row["wall_power.plate [W]"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(powers, [0.0, lifted / (0.25 * period), -lifted / (0.25 * period)], rtol=0.01)
    assert result["wall_power.plate"] == pytest.approx(0.5 * (powers[1] + powers[2]), abs=1e-9 * powers[1])
    assert result["wall_power_last.plate"] == powers[2]
    assert result["wall_power_largest.plate"] == max(map(abs, powers))
