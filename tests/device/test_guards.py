"""Runs that go wrong stop at once, say where and when, and leave the last state to look at."""

import re

import numpy as np
import pytest
from trials import balls, trial

from granflow.errors import RunError
from granflow.simulation import Simulation

BAD = 2
"""Every scene here has spheres that are alright, and this one that is not (or the smaller of two)."""


def bystanders(*more):
    return {
        "good": balls([[0.3, 0.0, 0.0], [0.3, 0.1, 0.0]]),
        **{f"bad_{number}": group for number, group in enumerate(more)},
    }


SCENES = {
    "overlaps by more than": lambda: trial(
        bystanders(balls([[0.0, 0.0, 0.0]], velocity=[40.0, 0, 0]), balls([[0.012, 0.0, 0.0]])),
        run={"duration": 0.01, "velocity_max": 40.0},
    ),
    "moved farther than": lambda: trial(
        bystanders(balls([[0.0, 0.0, 0.0]], velocity=[500.0, 0, 0])),
        run={"duration": 0.01, "velocity_max": 1.0, "time_step": 5e-6}, numerics={"skin": 1e-3},
    ),
    "is not a number": lambda: trial(bystanders(balls([[0.0, 0.0, 0.0]])), run={"duration": 0.01}),
}  # fmt: skip


@pytest.mark.parametrize("reason", SCENES)
def test_guard_stops_the_run_names_particle_and_time_and_leaves_a_frame(taichi_f64, tmp_path, reason):
    simulation = Simulation(SCENES[reason](), out=tmp_path)
    if reason == "is not a number":
        simulation.engine.state.particles.velocity[BAD] = [float("nan")] * 3
    with pytest.raises(RunError) as stopped:
        simulation.run()
    message = str(stopped.value)
    assert reason in message
    assert f"particle {BAD} " in message
    time = float(re.search(r"at ([\d.e+-]+) s", message).group(1))
    assert time == pytest.approx(simulation.time, rel=1e-5)
    assert time < 0.001
    assert str(tmp_path) in message
    frames = sorted(tmp_path.rglob("*.vtu"))
    assert any("particles" in frame.name for frame in frames[-2:]), frames
    simulation.free()


def test_good_runs_trip_no_guard(taichi_f64):
    simulation = Simulation(trial(bystanders(balls([[0.0, 0.0, 0.0]], velocity=[1.0, 0, 0])), run={"duration": 0.01}))
    simulation.run()
    assert simulation.engine.trip is None
    assert np.isfinite(simulation.snapshot().particles["position"]).all()
    simulation.free()
