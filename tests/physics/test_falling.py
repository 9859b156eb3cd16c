"""Free fall, and the residence times of a uniform motion."""

import numpy as np
import pytest
from scene_builders import build_scene, column, few_spheres, particle_group, run_and_sample, times
from subprocess_runner import in_subprocess

import granflow as gf

GRAVITY = 9.81


def test_free_fall_is_exact(taichi_f64):
    """Leapfrog integrates a constant acceleration exactly, within the rounding error of 4000 steps."""
    ball = particle_group([[0.1, -0.2, 0.5]], velocity=[1.0, 0.3, 2.0])
    run = {"duration": 0.2, "time_step": 5e-5, "velocity_max": 4.0}
    snapshots = run_and_sample(few_spheres({"ball": ball}, gravity=[0.5, 0.0, -GRAVITY], run=run), 0.05)
    t = times(snapshots)[:, None]
    acceleration = np.array([0.5, 0.0, -GRAVITY])
    position = [0.1, -0.2, 0.5] + t * [1.0, 0.3, 2.0] + 0.5 * t**2 * acceleration
    rounding = 4000 * np.finfo(float).eps
    np.testing.assert_allclose(column(snapshots, "position")[:, 0], position, rtol=0, atol=rounding)
    np.testing.assert_allclose(
        column(snapshots, "velocity")[:, 0], [1.0, 0.3, 2.0] + t * acceleration, rtol=0, atol=4 * rounding
    )


def fast_fall(precision):
    """Change of the velocity [m/s] of a ball that falls at 8 m/s, in 40 000 steps of 50 ns."""
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.5]], velocity=[0.0, 0.0, -8.0])}, gravity=[0.0, 0.0, -GRAVITY],
        run={"duration": 2e-3, "time_step": 5e-8, "velocity_max": 9.0},
    )  # fmt: skip
    simulation = gf.Simulation(scene, precision=precision)
    simulation.run()
    return float(simulation.snapshot().particles["velocity"][0, 2]) + 8.0


def test_gravity_changes_a_fast_velocity_in_float32():
    """g dt is half of the spacing of float32 at 8 m/s, 9.5e-7 m/s, to which the result is rounded."""
    assert in_subprocess(fast_fall, "mixed") == pytest.approx(-GRAVITY * 2e-3, abs=9.6e-7)


def test_residence_times_of_a_uniform_motion(taichi_f64, tmp_path):
    """Without gravity, particles of 4 mm start within two diameters behind the face with 0.5 m/s; the meter
    "out" is 0.2 m from it, and "gate" 0.05 m. From gate to out each needs 0.15 m / (0.5 m/s) = 0.3 s."""
    speed, distance, diameter = 0.5, 0.2, 0.004
    face = {"disc": {"center": [0, 0, 0], "normal": [0, 0, -1], "radius": 0.03}}
    feed = {
        "material": "glass", "diameter": diameter, "count": 40, "velocity": [0, 0, -speed],
        "insert": {"kind": "inlet", "face": face, "rate": 100.0},
    }  # fmt: skip
    meters = {"gate": {"point": [0, 0, -0.05], "normal": [0, 0, -1]},
              "out": {"point": [0, 0, -distance], "normal": [0, 0, -1], "passages": True}}  # fmt: skip
    scene = few_spheres(
        {"feed": feed}, run={"duration": 0.9, "velocity_max": 1.0},
        output={"interval": 0.01, "energy_budget": True, "flow_meters": meters,
                "residence_time": {"from": "gate", "to": "out"}},
    )  # fmt: skip
    with gf.Simulation(scene, out=tmp_path) as simulation:
        result = simulation.run()
    found = result.flow_meters["out"]
    assert found["flow_count"] == 40
    latest = distance / speed
    assert latest - 2 * diameter / speed < found["residence_time"] < latest
    assert 0 < found["residence_time_deviation"] < diameter / speed
    times = result.residence_time["out"]
    assert (times["residence_count"], times["residing_count"]) == (40, 0)
    assert times["residence_mean"] == pytest.approx(0.3, rel=1e-9)
    assert times["residence_deviation"] < 1e-9
    rows = np.genfromtxt(
        tmp_path / "residence_time.csv", delimiter=",", skip_header=1, usecols=(0, 1, 2, 6, 7)
    )
    np.testing.assert_allclose(rows[:, 2], 0.3, rtol=1e-9)
    np.testing.assert_allclose(rows[:, 0] - rows[:, 1], rows[:, 2], rtol=1e-9)
    np.testing.assert_allclose(rows[:, 4], 2500.0 * np.pi / 6.0 * rows[:, 3] ** 3, rtol=1e-6)
    passages = np.genfromtxt(tmp_path / "passages_out.csv", delimiter=",", skip_header=1, usecols=(0, 1, 2))
    np.testing.assert_array_equal(passages[:, 0], rows[:, 0])
    assert passages[:, 2].mean() == pytest.approx(found["residence_time"], rel=1e-9)
