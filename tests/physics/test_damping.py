"""Damping of all motion for settling: closed forms of drag and of Cundall damping for spheres and clumps."""

import numpy as np
import pytest
from clumps import about, clump_group
from scene_builders import build_scene, particle_group, plane, run_and_sample

GRAVITY, NONE = 9.81, 1e-14
"""Gravity [m/s2], and damping without effect."""
ASYMMETRIC = [[0.0, 0.0, 0.0], [4e-3, 0.0, 0.0], [0.0, 2.5e-3, 0.0]]


def damped(cundall, drag, gravity):
    """Snapshots of a ball and a clump that fly and spin, and of a rod that falls on a plate.

    Damping acts until 0.08 s.
    """
    motion = {"velocity": [0.3, -0.2, 0.1], "angular_velocity": [4.0, 30.0, -8.0]}
    groups = {
        "ball": particle_group([[0.1, 0.0, 0.5]], **motion),
        "free": clump_group([[0.0, 0.0, 0.5]], ASYMMETRIC, **motion),
        "falling": clump_group([[0.2, 0.0, 0.004]], orientation=about([0, 1, 0], 20)),
    }
    solid = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}
    scene = build_scene(
        groups, {"plate": plane([0, 0, 0], [0, 0, 1])}, {"restitution": 0.6, "friction": 0.3},
        materials={"glass": solid}, gravity=[0.0, 0.0, -gravity], run={"velocity_max": 1.0, "time_step": 1e-5},
        stages=[{"name": "settle", "duration": 0.08}, {"name": "rest", "duration": 0.02}],
        output={"interval": 1.0, "energy_budget": True},
        damping={"cundall": cundall, "drag": drag, "stages": ["settle"]},
    )  # fmt: skip
    return run_and_sample(scene, 0.01, threads=2)


def test_drag_decays_velocity_and_rotation_in_its_stage(taichi_f64):
    """A step changes both by (1 - h) / (1 + h), h = g dt / 2: the rate is wrong by h^2 / 3, also after the stage."""
    rate = 20.0
    half = 0.5 * rate * 1e-5
    snapshots = damped(NONE, rate, 0.0)
    first = snapshots[0].particles
    rows = {"velocity": 0, "angular_velocity": 0, "clump_velocity": 1, "clump_angular_momentum": 1}
    for each in snapshots:
        for name, row in rows.items():
            expected = np.exp(-rate * min(each.time, 0.08)) * first[name][row]
            assert each.particles[name][row] == pytest.approx(expected, rel=half**2)
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-6
    assert snapshots[-1].totals["damping_dissipation"] > 0.9 * snapshots[0].totals["kinetic_energy"]


def test_cundall_damping_opposes_the_velocity_and_brings_clumps_to_rest(taichi_f64):
    """Free fall has the acceleration (1 - a) g downwards and (1 + a) g upwards; a rod on a plate comes to rest.

    Without damping of its rotation, the rod would rock on both ends for much longer. Without torque there is no
    damping of the rotation.
    """
    ratio = 0.6
    snapshots = damped(ratio, NONE, GRAVITY)
    first, last = snapshots[0].particles, snapshots[8].particles
    up = 0.1 / (GRAVITY * (1.0 + ratio))
    expected = GRAVITY * (1.0 - ratio) * (snapshots[8].time - up)
    assert (-last["velocity"][0, 2], -last["clump_velocity"][1, 2]) == pytest.approx(
        (expected, expected), rel=1e-3
    )
    for name, row in (("angular_velocity", 0), ("clump_angular_momentum", 1)):
        assert last[name][row].tolist() == first[name][row].tolist()
    spins = [np.abs(each.particles["angular_velocity"][-1]).max() for each in snapshots[:9]]
    assert max(spins) > 5.0 and spins[-1] < 0.02 * max(spins)
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-3
    assert snapshots[8].totals["damping_dissipation"] > 0.0
