"""Power of walls: against the mechanics of one sphere, and as a part of the energy budget."""

import csv

import numpy as np
import pytest
from scene_builders import SOFT, box, build_scene, few_spheres, particle_group, plane

from granflow import Simulation
from granflow.engine.sums import SHARES, exact_totals

RADIUS, GRAVITY = 0.005, 9.81
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * 2500.0
SPEEDS = np.random.default_rng(2).normal(0.0, 0.5, (125, 3))
OUTPUT = {"interval": 1.0, "energy_budget": True, "wall_forces": True}


def driven_box():
    """A gas in a box whose walls vibrate, rotate, have a belt and follow forces; the floor does three of
    these."""
    walls = box(0.0575)
    shaken = {"kind": "vibration", "direction": [1, 0, 1], "amplitude": 1e-4, "frequency": 300.0}
    turning = {"kind": "rotation", "point": [0.03, 0.03, 0.0], "axis": [0, 0, 1], "angular_velocity": 60.0}
    belt = {"kind": "surface_velocity", "velocity": [0.7, 0.3, 0.0]}
    walls["low_z"]["motion"] = [shaken, turning, belt]
    walls["high_z"]["motion"] = {"kind": "translation", "velocity": [0.0, 0.0, -0.3]}
    walls["high_x"]["motion"] = [
        shaken, {"kind": "servo", "direction": [-1, 0, 0], "force": 2.0, "velocity_max": 0.2}
    ]  # fmt: skip
    walls["high_y"]["motion"] = {"kind": "free", "direction": [0, -1, 0], "mass": 0.2, "force": 5.0}
    return build_scene(
        {"lattice": particle_group(0.0115 * (np.argwhere(np.ones((5, 5, 5))) + 0.5), velocity=SPEEDS)}, walls=walls, normal="hertz",
        pair={"friction": 0.4, "restitution": 0.7}, run={"duration": 0.004, "velocity_max": 4.0},
        numerics={"chunk_size": 32, "max_overlap": 0.3}, output=OUTPUT,
    )  # fmt: skip


def test_the_powers_of_all_walls_are_the_work_of_the_walls(taichi_f64):
    """The wall work until t has half of the force at t, as the trapezoidal rule; the other half is ahead."""
    with Simulation(driven_box()) as simulation:
        simulation.run()
        last = simulation.snapshot()
        state = simulation.engine.state
        ahead = exact_totals(state.control.losses_ahead.to_numpy(), state.plan.sum_units.energy / SHARES)
    work = {name: impulse[7] for name, impulse in last.impulses.items()}
    moving = ("low_z", "high_z", "high_x", "high_y")
    assert all((work[name] != 0.0) == (name in moving) for name in work)
    size = sum(map(abs, work.values()))
    assert abs(ahead[0]) > 1e-9 * size, "particles touch driven walls at the end"
    assert sum(work.values()) == pytest.approx(last.totals["wall_work"] + ahead[0], abs=1e-12 * size)


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
