"""Walls: forces that they measure, the velocity of moving ones, and the energy that they supply."""

import csv

import numpy as np
import pytest
from scene_builders import (
    SOFT,
    box,
    build_scene,
    few_spheres,
    particle_group,
    plane,
    run_and_sample,
    run_to_end,
)

from granflow.contact import theory
from granflow.fields import RUN_QUANTITIES
from granflow.simulation import Simulation

MASS = 4.0 / 3.0 * np.pi * 0.005**3 * 2500.0
GRAVITY = 9.81
EPS = np.finfo(float).eps
MODULUS = SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2))
"""Effective modulus of two bodies of the material [Pa]."""
ACCELERATION = 800.0
"""Of a wall that a force moves [m/s2]."""


def shaken_box():
    """Spinning particles in a box with a vibrating floor and a rotating lid; friction and rolling
    friction."""
    rng = np.random.default_rng(2)
    positions = 0.0115 * (np.argwhere(np.ones((5, 5, 5))) + 0.6)
    walls = box(0.0575)
    shaking = {"kind": "vibration", "direction": [1, 0, 1], "amplitude": 1e-4, "frequency": 300.0}
    walls["low_z"]["motion"] = shaking
    walls["high_z"]["motion"] = {
        "kind": "rotation", "point": [0.03, 0.03, 0.0], "axis": [0, 0, 1], "angular_velocity": 60.0,
    }  # fmt: skip
    walls["low_x"]["torque_point"] = [0.01, 0.02, -0.03]
    velocity = rng.normal(0.0, 0.5, positions.shape)
    angular_velocity = rng.normal(0.0, 50.0, positions.shape)
    return build_scene(
        {"balls": particle_group(positions, 0.01, velocity=velocity, angular_velocity=angular_velocity)},
        walls=walls,
        rolling="epsd",
        pair={"friction": 0.4, "rolling_friction": 0.1},
        run={"duration": 0.004, "velocity_max": 4.0},
        numerics={"chunk_size": 32, "max_overlap": 0.3},
        output={"interval": 1.0, "wall_forces": True},
    )


def momenta(p):
    """Momentum and angular momentum about the origin (2, 3), their rates (2, 3), and the sum of all |m v_i|."""
    inertia = 0.4 * (p["mass"] * p["radius"] ** 2)[:, None]
    linear = p["mass"][:, None] * p["velocity"]
    angular = np.cross(p["position"], linear) + inertia * p["angular_velocity"]
    torque = np.cross(p["position"], p["force"]) + p["torque"]
    sums = [each.sum(axis=0) for each in (linear, angular, p["force"], torque)]
    return np.array(sums[:2]), np.array(sums[2:]), np.abs(linear).sum()


def test_wall_impulses_equal_the_momentum_lost_by_the_particles(taichi_f64):
    """The leapfrog satisfies P(t) - P(0) + J = dt/2 [F(0) - F(t)] to rounding, for momentum and angular
    momentum.

    Wall torques refer to the point of the wall's rotation, or to a given one: (x - p) x F integrates to
    L - p x J. The work of a wall that rotates steadily is its angular impulse times the angular velocity.
    """
    scene = shaken_box()
    snapshots = run_and_sample(scene, 0.004)
    (before, rate_before, scale), (after, rate_after, _) = (momenta(each.particles) for each in snapshots)
    impulses = np.array([[impulse[:3], impulse[3:6]] for impulse in snapshots[-1].impulses.values()])
    impulses[0, 1] += np.cross([0.01, 0.02, -0.03], impulses[0, 0])
    impulses[-1, 1] += np.cross([0.03, 0.03, 0.0], impulses[-1, 0])
    half_step = 0.5 * snapshots[-1].time / snapshots[-1].step
    residual = after - before + impulses.sum(axis=0) - half_step * (rate_before - rate_after)
    assert list(snapshots[-1].impulses) == list(scene.walls)
    lid = snapshots[-1].impulses["high_z"]
    assert lid[7] == pytest.approx(-60.0 * lid[5], rel=1e-9) and lid[7] > 0.0
    assert snapshots[-1].impulses["low_x"][7] == 0.0
    assert np.abs(impulses).max() > 0.1 * scale, "the wall impulses are a large part of the momentum"
    assert np.abs(residual[0]).max() < snapshots[-1].step * EPS * scale
    assert np.abs(residual[1]).max() < snapshots[-1].step * EPS * scale * 0.06


FREE = {"kind": "free", "direction": [1, 0, 0], "mass": 1.0}
DISC = {"shape": "disc", "normal": [0, 0, 1], "radius": 0.03, "material": "glass"}


def measured(positions, walls, velocity=(0.0, 0.0, 0.0), **parts):
    """Balls and walls whose forces are measured. All scenes have one compiled structure: a disc and a free wall are
    far away unless given, and other pairs have friction and damping."""
    far = {"disc": DISC | {"center": [0, 0, -0.8]}, "piston": plane([0, 0, 0.9], [0, 0, -1], motion=[FREE])}
    is_free = any(motion["kind"] == "free" for wall in walls.values() for motion in wall.get("motion", []))
    walls = far | walls if not is_free else {"disc": far["disc"]} | walls
    parts = {"output": {"interval": 1.0, "energy_budget": True, "wall_forces": True}} | parts
    return few_spheres(
        {"balls": particle_group(positions, velocity=velocity)}, walls, normal="hertz", **parts
    )


@pytest.mark.parametrize("moves", ["before", "force"])
def test_torque_refers_to_the_axis_that_moves_with_the_wall(taichi_f64, moves):
    """A particle at x = 10 mm rests on a turntable without friction: its weight m g has the torque (x - p) m g
    about y. The axis p = 20 mm + v t moves with a translation before the rotation, so that the mean over n steps
    is (-10 mm - v T / 2 (1 + 1/n)) m g.

    A force moves it by p = 20 mm + a t^2 / 2, of which the mean is a dt^2 / 2 (n + 1) (2 n + 1) / 6.
    """
    height = 0.005 - (MASS * GRAVITY / theory.hertz_stiffness(MODULUS, 0.005)) ** (2.0 / 3.0)
    travel = {"kind": "translation", "velocity": [2.0, 0, 0]}
    turn = {"kind": "rotation", "point": [0.02, 0, 0], "axis": [0, 0, 1], "angular_velocity": 3.0}
    push = FREE | {"force": ACCELERATION}
    table = plane([0, 0, 0], [0, 0, 1], motion=[{"before": travel, "force": push}[moves], turn])
    scene = measured(
        [[0.01, 0.0, height]], {"table": table}, gravity=[0.0, 0.0, -GRAVITY], run={"duration": 0.004, "velocity_max": 0.5}
    )  # fmt: skip
    last = run_and_sample(scene, 0.004)[-1]
    steps = last.step
    mean_travel = {
        "before": 0.5 * 2.0 * last.time * (1 + 1 / steps),
        "force": 0.5 * ACCELERATION * last.time**2 * (steps + 1) * (2 * steps + 1) / (6 * steps**2),
    }
    arm = -0.01 - mean_travel[moves]
    weight = MASS * GRAVITY * last.time
    np.testing.assert_allclose(last.impulses["table"][[2, 4]], [-weight, arm * weight], rtol=1e-9)


def test_impulse_of_one_impact(taichi_f64):
    """J = m (1 + e) v with the measured e; no tangential impulse; the pressure is over the area of the disc."""
    scene = measured(
        [[0.01, 0.0, 0.0051]], {"disc": DISC | {"center": [0, 0, 0]}}, [0.0, 0.0, -1.0], pair={"restitution": 0.6},
        run={"duration": 0.002, "velocity_max": 1.0},
        output={"interval": 1.0, "energy_budget": True, "wall_forces": ["disc"]},
    )  # fmt: skip
    simulation = Simulation(scene)
    result = simulation.run().numbers
    last = simulation.snapshot()
    simulation.free()
    rebound = last.particles["velocity"][0, 2]
    assert rebound == pytest.approx(0.6, rel=0.02)
    impulse = MASS * (1.0 + rebound)
    np.testing.assert_allclose(
        last.impulses["disc"][[2, 4, 6]], [-impulse, 0.01 * impulse, impulse], rtol=1e-12
    )
    np.testing.assert_allclose(last.impulses["disc"][[0, 1, 3, 5]], 0.0, atol=1e-12 * impulse)
    mean = impulse / last.time
    assert result["wall_force_z.disc"] == pytest.approx(-mean, rel=1e-12)
    assert result["wall_pressure.disc"] == pytest.approx(mean / (np.pi * 0.03**2), rel=1e-12)


def stacked_particles(count=3):
    """Particles stacked on a floor, each contact at its static overlap."""
    heights, below = [], 0.0
    for index in range(count):
        k = theory.hertz_stiffness(MODULUS, 0.005 if index == 0 else 0.0025)
        below += (0.005 if index == 0 else 0.01) - ((count - index) * MASS * GRAVITY / k) ** (2.0 / 3.0)
        heights.append([0.0, 0.0, below])
    walls = {"floor": plane([0, 0, 0], [0, 0, 1]), "lid": plane([0, 0, 1], [0, 0, -1])}
    expected = {"quantity": "wall_force_z.floor", "equals": -count * MASS * GRAVITY, "tolerance": 1e-9}
    output = {"interval": 0.002, "timeseries_interval": 0.001, "energy_budget": True, "wall_forces": True}
    return measured(
        heights, walls, gravity=[0.0, 0.0, -GRAVITY], run={"duration": 0.004, "velocity_max": 0.5}, output=output,
        expect=[expected],
    )  # fmt: skip


def test_floor_carries_the_weight_in_every_row(tmp_path, taichi_f64):
    simulation = Simulation(stacked_particles(), out=tmp_path)
    result = simulation.run()
    simulation.free()
    assert [each.met for each in result.expectations] == [True]
    with open(tmp_path / "timeseries.csv") as file:
        rows = list(csv.DictReader(file))
    weight = 3 * MASS * GRAVITY
    assert [float(row["wall_force_z.floor [N]"]) for row in rows[1:]] == pytest.approx(
        [-weight] * 4, rel=1e-9
    )
    assert {float(row["wall_force_z.lid [N]"]) for row in rows} == {0.0}
    assert "wall_pressure.floor [Pa]" not in rows[0]
    assert result.numbers["wall_force_largest.floor"] == pytest.approx(weight, rel=1e-9)
    assert result.numbers["wall_force_z_last.floor"] == float(rows[-1]["wall_force_z.floor [N]"])
    assert set(result.run) == set(RUN_QUANTITIES), "check accepts expectations of every number of a run"


def test_friction_uses_the_wall_velocity_in_the_middle_of_the_step(taichi_f64):
    """A particle too heavy to move sticks to a plane that vibrates below it. Its tangential force is Kt times
    the sum

        sum of dt A w cos(w (k - 1/2) dt), k = 1..n  =  A sin(w n dt) (w dt / 2) / sin(w dt / 2)

    with Kt = 8 G sqrt(R d) (Mindlin). w t ends near pi/2, where the velocity has dropped from A w to 0: a
    velocity evaluated half a step early or late changes the sum by A w dt / 2, 2.5 % of it.
    """
    radius, overlap, amplitude, omega, step, count = 0.005, 1e-4, 1e-5, 5e4, 1e-6, 31
    heavy = {"glass": SOFT | {"density": 1e6}}
    motion = {
        "kind": "vibration", "direction": [1, 0, 0], "amplitude": amplitude, "angular_frequency": omega
    }  # fmt: skip
    scene = measured(
        [[0.0, 0.0, radius - overlap]], {"plate": plane([0, 0, 0], [0, 0, 1], motion=[motion])},
        pair={"restitution": 1.0, "friction": 10.0}, materials=heavy,
        run={"duration": 1.0, "time_step": step, "velocity_max": 1.0},
    )  # fmt: skip
    last, _ = run_to_end(scene, until=count * step)
    modulus = SOFT["young_modulus"] / (2 * (1 + SOFT["poisson_ratio"])) / (2 * (2 - SOFT["poisson_ratio"]))
    stiffness = 8 * modulus * np.sqrt(radius * overlap)
    half = 0.5 * omega * step
    displacement = amplitude * np.sin(omega * count * step) * half / np.sin(half)
    assert last.particles["force"][0, 0] == pytest.approx(stiffness * displacement, rel=1e-3)
