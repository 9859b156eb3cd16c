"""Free flight under gravity that changes, in float32, and with damping, against closed forms."""

import numpy as np
import pytest
from clumps import about, clump_group
from scene_builders import build_scene, particle_group, plane, run_and_sample
from subprocess_runner import in_subprocess

from granflow import Simulation

RATE = 100.0
STEP = 2e-5
TURN, HELD, TABLE, OFF = 0.02, 0.004, 0.008, 0.004
"""Durations [s] of the stages of the free flight."""
STRENGTH = 9.81
TILTED = [[3.0, -5.0, 0.0], [-4.0, 1.0, 8.0]]
"""First and last gravity of the table."""


NONE = 1e-14
"""Damping without effect."""


def flight(groups, gravity, stages, damping, **run):
    """Bodies above a plate, and a free wall that nothing touches."""
    solid = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}
    far = {"shape": "rectangle", "corner": [-0.5, -0.5, -0.9], "sides": [[0.1, 0, 0], [0, 0.1, 0]]}
    lid = far | {"material": "glass", "motion": {"kind": "free", "mass": 0.3, "direction": [0, 0, 1]}}
    return build_scene(
        groups, {"plate": plane([0, 0, 0], [0, 0, 1]), "lid": lid}, {"restitution": 0.6, "friction": 0.3},
        materials={"glass": solid}, gravity=gravity, run={"velocity_max": 1.0} | run, damping=damping,
        stages=[{"name": name, "duration": duration, **more} for name, duration, more in stages],
        output={"interval": 0.004, "energy_budget": True},
    )  # fmt: skip


def free_flight():
    """A sphere and a clump; gravity turns, is held, follows a table, is off."""
    turning = {"kind": "rotation", "axis": [0, 1, 0], "angular_velocity": RATE, "stages": ["turn"]}
    stages = [
        ("turn", TURN, {}),
        ("held", HELD, {}),
        ("table", TABLE, {"gravity": {"times": [0.0, TABLE], "vectors": TILTED}}),
        ("off", OFF, {"gravity": [0, 0, 0]}),
    ]
    clump = clump_group(
        [[0.1, 0, 0.5]], [[-0.002, 0, 0], [0.002, 0, 0]], angular_velocity=[[0.0, 30.0, 20.0]]
    )
    groups = {"ball": particle_group([[0, 0, 0.5]]), "clump": clump}
    gravity = {"vector": [0, 0, -STRENGTH], "motion": turning}
    return flight(groups, gravity, stages, {"cundall": NONE, "drag": NONE}, time_step=STEP)


def turned(time):
    """Gravity turned about y by the angle a = w t: -g (sin a, 0, cos a)."""
    return -STRENGTH * np.array([np.sin(RATE * time), 0.0, np.cos(RATE * time)])


def test_free_flight_under_changing_gravity():
    """Velocity and position follow from integrals of g(t), with the known error of the leapfrog scheme.

    Over a turn by a = w t, v = -g/w (1 - cos a, 0, sin a). The velocity of the scheme is the trapezoidal sum
    of g, whose error is dt^2 (g'(T) - g'(0)) / 12 + O(dt^4), and exact where g is linear. Jumps of gravity
    at stages do not shift the velocity. Positions: x = x0 + int v dt, error below dt^2 g.
    """
    snapshots = run_and_sample(free_flight(), 0.004, threads=2)
    at = {round(each.time, 9): each for each in snapshots}
    angle = RATE * TURN
    after_turn = -STRENGTH / RATE * np.array([1.0 - np.cos(angle), 0.0, np.sin(angle)])
    rate_change = -STRENGTH * RATE * np.array([np.cos(angle) - 1.0, 0.0, -np.sin(angle)])
    after_turn += STEP**2 / 12.0 * rate_change
    after_held = after_turn + HELD * turned(TURN)
    after_table = after_held + 0.5 * TABLE * np.sum(TILTED, axis=0)
    expected = {TURN: after_turn, TURN + HELD: after_held, TURN + HELD + TABLE: after_table}
    expected[TURN + HELD + TABLE + OFF] = after_table
    allowed = STEP**4 * RATE**3 * STRENGTH + 1e-14
    for time, velocity in expected.items():
        snapshot = at[round(time, 9)]
        mass = snapshot.particles["mass"]
        of_clump = mass[1:] @ snapshot.particles["velocity"][1:] / mass[1:].sum()
        assert snapshot.particles["velocity"][0] == pytest.approx(velocity, rel=0.0, abs=allowed)
        assert of_clump == pytest.approx(velocity, rel=0.0, abs=1e-7)  # spheres move along chords
        place, speed, spin = (
            snapshot.particles[name][1:] for name in ("position", "velocity", "angular_velocity")
        )
        assert speed[1] - speed[0] == pytest.approx(np.cross(spin[0], place[1] - place[0]), rel=0.0, abs=1e-6)
        assert snapshot.totals["wall_velocity.lid"] == pytest.approx(velocity[2], rel=0.0, abs=allowed)
    fall = -STRENGTH / RATE * np.array([TURN - np.sin(angle) / RATE, 0.0, (1.0 - np.cos(angle)) / RATE])
    assert at[TURN].particles["position"][0] - [0, 0, 0.5] == pytest.approx(fall, abs=STEP**2 * STRENGTH)
    last = at[round(sum((TURN, HELD, TABLE, OFF)), 9)]
    assert [last.totals[f"gravity_{axis}"] for axis in "xyz"] == [0.0, 0.0, 0.0]
    assert at[TURN + HELD].totals["gravity_x"] == pytest.approx(turned(TURN)[0], rel=1e-12)
    # All energy comes from gravity: its potential at the start, and the work of its change.
    for snapshot in snapshots[1:]:
        totals = snapshot.totals
        dropped = at[0.0].totals["gravitational_energy"] - totals["gravitational_energy"]
        # The work of each step is rounded to the unit of the sums.
        assert totals["kinetic_energy"] == pytest.approx(dropped + totals["gravity_work"], rel=1e-6)
        assert abs(totals["energy_error"]) < 1e-6  # of the rotation of the clump
        assert totals["free_wall_energy"] == pytest.approx(totals["free_wall_work"], rel=1e-6, abs=1e-12)


def fast_fall(precision):
    """Change of the velocity [m/s] of a ball that falls at 8 m/s, in 40 000 steps of 50 ns."""
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.5]], velocity=[0.0, 0.0, -8.0])}, gravity=[0.0, 0.0, -STRENGTH],
        run={"duration": 2e-3, "time_step": 5e-8, "velocity_max": 9.0},
    )  # fmt: skip
    simulation = Simulation(scene, precision=precision)
    simulation.run()
    return float(simulation.snapshot().particles["velocity"][0, 2]) + 8.0


def test_gravity_changes_a_fast_velocity_in_float32():
    """g dt is half of the spacing of float32 at 8 m/s, 9.5e-7 m/s, to which the result is rounded."""
    assert in_subprocess(fast_fall, "mixed") == pytest.approx(-STRENGTH * 2e-3, abs=9.6e-7)


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
    changed = {"gravity": [0.0, 0.0, -gravity - 1e-9]}  # so that the kernels are those of changing gravity
    stages = [("settle", 0.08, {}), ("rest", 0.02, changed)]
    damping = {"cundall": cundall, "drag": drag, "stages": ["settle"]}
    scene = flight(groups, [0.0, 0.0, -gravity], stages, damping, time_step=1e-5)
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
    snapshots = damped(ratio, NONE, STRENGTH)
    first, last = snapshots[0].particles, snapshots[8].particles
    up = 0.1 / (STRENGTH * (1.0 + ratio))
    expected = STRENGTH * (1.0 - ratio) * (snapshots[8].time - up)
    assert (-last["velocity"][0, 2], -last["clump_velocity"][1, 2]) == pytest.approx(
        (expected, expected), rel=1e-3
    )
    for name, row in (("angular_velocity", 0), ("clump_angular_momentum", 1)):
        assert last[name][row].tolist() == first[name][row].tolist()
    spins = [np.abs(each.particles["angular_velocity"][-1]).max() for each in snapshots[:9]]
    assert max(spins) > 5.0 and spins[-1] < 0.02 * max(spins)
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-3
    assert snapshots[8].totals["damping_dissipation"] > 0.0
