"""Free flight under gravity that turns, follows a table or jumps in a stage, and in float32."""

import numpy as np
import pytest
from clumps import clump_group
from scene_builders import build_scene, particle_group, run_and_sample
from subprocess_runner import in_subprocess

from granflow import Simulation

RATE = 100.0
STEP = 2e-5
TURN, HELD, TABLE, OFF = 0.02, 0.004, 0.008, 0.004
"""Durations [s] of the stages of the free flight."""
STRENGTH = 9.81
TILTED = [[3.0, -5.0, 0.0], [-4.0, 1.0, 8.0]]
"""First and last gravity of the table."""


def free_flight():
    """A sphere, a clump and a free wall that nothing touches: gravity turns, is held, follows a table, is off."""
    turning = {"kind": "rotation", "axis": [0, 1, 0], "angular_velocity": RATE, "stages": ["turn"]}
    stages = [
        {"name": "turn", "duration": TURN},
        {"name": "held", "duration": HELD},
        {"name": "table", "duration": TABLE, "gravity": {"times": [0.0, TABLE], "vectors": TILTED}},
        {"name": "off", "duration": OFF, "gravity": [0, 0, 0]},
    ]
    clump = clump_group([[0.1, 0, 0]], [[-0.002, 0, 0], [0.002, 0, 0]], angular_velocity=[[0.0, 30.0, 20.0]])
    far = {"shape": "rectangle", "corner": [-0.5, -0.5, -0.9], "sides": [[0.1, 0, 0], [0, 0.1, 0]]}
    lid = far | {"material": "glass", "motion": {"kind": "free", "mass": 0.3, "direction": [0, 0, 1]}}
    return build_scene(
        {"ball": particle_group([[0, 0, 0]]), "clump": clump}, {"lid": lid},
        gravity={"vector": [0, 0, -STRENGTH], "motion": turning}, stages=stages,
        run={"time_step": STEP, "velocity_max": 1.0}, output={"interval": 0.004, "energy_budget": True},
    )  # fmt: skip


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
        assert snapshot.totals["wall_velocity.lid"] == pytest.approx(velocity[2], rel=0.0, abs=allowed)
    fall = -STRENGTH / RATE * np.array([TURN - np.sin(angle) / RATE, 0.0, (1.0 - np.cos(angle)) / RATE])
    assert at[TURN].particles["position"][0] == pytest.approx(fall, abs=STEP**2 * STRENGTH)
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
