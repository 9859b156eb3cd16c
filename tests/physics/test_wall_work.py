"""Work and power of moving walls against the mechanics of one sphere, and walls that only some groups touch."""

import csv

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, column, few_spheres, particle_group, plane, run_and_sample

from granflow import Simulation

RADIUS, OVERLAP, PERIOD = 5e-3, 2e-5, 2e-3
GRAVITY = 9.81
OUTPUT = {"interval": 1.0, "energy_budget": True, "wall_forces": True}
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * 2500.0
VIBRATION = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": OVERLAP, "frequency": 1.0 / PERIOD}
ROTATION = {"kind": "rotation", "point": [0.05, 0, 0.01], "axis": [0, 1, 0], "angular_velocity": 0.2}


def error(motion, steps, periods=2):
    """Largest error of the energy budget over its peak, of a particle between two planes, the upper one moving.

    K + E_elastic - W - E_inserted [J]        16 times in each period, of `steps` steps
    """
    particle = particle_group([[0.0, 0.0, RADIUS - OVERLAP]], 2 * RADIUS)
    top = plane([0, 0, 2 * RADIUS - 2 * OVERLAP], [0, 0, -1], motion=motion)
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


@pytest.mark.parametrize("motion", [VIBRATION, ROTATION], ids=["vibration", "rotation"])
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


DIAMETER = 0.004
HEIGHT = 0.02
DURATION = 0.07


def screen_scene():
    """A coarse and a fine ball fall on a screen that holds the coarse one."""
    groups = {
        name: particle_group([[x, 0.0, HEIGHT]], DIAMETER) for name, x in (("coarse", 0.0), ("fine", 0.01))
    }
    return build_scene(
        groups, {"screen": plane([0, 0, 0], [0, 0, 1], groups=["coarse"])}, {"restitution": 1.0}, normal="hertz",
        gravity=[0, 0, -GRAVITY], run={"duration": 2 * DURATION, "time_step": 1e-5, "velocity_max": 1.5},
    )  # fmt: skip


def test_a_screen_holds_one_group_and_lets_the_other_pass(taichi_f64):
    """The fine ball falls freely, z = h - g t^2 / 2; the coarse one bounces elastically from z = r.

    A ball that returns has the height h - g (t - 2 t1 - tc)^2 / 2 where t1 = sqrt(2 (h - r) / g) is the time of
    fall and tc the duration of the impact, below 0.1 ms.
    """
    coarse, fine = np.moveaxis(column(run_and_sample(screen_scene(), DURATION), "position")[1:, :, 2], 1, 0)
    times = DURATION * np.array([1, 2])
    assert fine == pytest.approx(HEIGHT - 0.5 * GRAVITY * times**2, rel=1e-9)
    fall = np.sqrt(2.0 * (HEIGHT - DIAMETER / 2) / GRAVITY)
    assert fall < DURATION < times[1] < 3 * fall
    returned = HEIGHT - 0.5 * GRAVITY * (times - 2.0 * fall) ** 2
    assert coarse == pytest.approx(returned, abs=1e-4 * GRAVITY * 2 * fall)


def test_a_particle_that_changes_its_group_meets_the_screen(taichi_f64):
    simulation = Simulation(screen_scene(), out=None)
    simulation.run(until=0.5 * DURATION)
    simulation.particles.group[:] = "coarse"
    simulation.run()
    assert np.asarray(simulation.particles.position)[1, 2] > 0.0
