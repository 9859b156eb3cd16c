"""Residence times and passages of flow meters in a uniform motion."""

import numpy as np
import pytest
from scene_builders import few_spheres

import granflow as gf


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
