"""Falling, bouncing and compressed particles against the MFiX verification manual (Garg et al. 2012,
doi 10.1016/j.powtec.2011.09.019) and against numerical solutions of the equations of motion."""

import numpy as np
import pytest
from scene_builders import build_scene, column, few_spheres, particle_group, plane, run_and_sample, times
from scipy.integrate import solve_ivp
from subprocess_runner import in_subprocess

import granflow as gf
from granflow.contact import theory

GRAVITY = 9.81

HEIGHTS = (0.42400, 0.36244, 0.312576, 0.272187, 0.239471)
"""Rebound heights [m] of a hard sphere of radius 0.1 m from 0.5 m with e = 0.9: R + (h0 - R) e^(2 n)."""


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


def test_bouncing_ball_reaches_the_rebound_heights_of_a_hard_sphere(taichi_f64):
    """A stiff material approaches the hard sphere: each bounce may change the height by the maximum
    overlap."""
    stiff = {"young_modulus": 1e12, "poisson_ratio": 0.3, "density": 2600.0}
    scene = few_spheres(
        {"ball": particle_group([[0.0, 0.0, 0.5]], 0.2)}, {"floor": plane([0, 0, 0], [0, 0, 1])}, {"restitution": 0.9},
        materials={"glass": stiff}, gravity=[0.0, 0.0, -GRAVITY],
        run={"duration": 2.4, "velocity_max": 2.9}, numerics={"time_step_fraction": 0.02},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.01)
    z, speed = (column(snapshots, name)[:, 0, 2] for name in ("position", "velocity"))
    apex = (z + speed**2 / (2.0 * GRAVITY))[z > 0.1]
    bounces = np.cumsum(np.diff(apex, prepend=apex[0]) < -0.01)
    mass = 4.0 / 3.0 * np.pi * 1e-3 * 2600.0
    k = theory.hertz_stiffness(1e12 / (2.0 * (1.0 - 0.3**2)), 0.1)
    overlap = theory.overlap_max(k, mass, np.sqrt(2.0 * GRAVITY * 0.4))
    for number, height in enumerate((0.5, *HEIGHTS)):
        heights = apex[bounces == number]
        assert len(heights) > 10
        np.testing.assert_allclose(heights, height, rtol=0.0, atol=number * overlap + 1e-9)


def test_two_stacked_spheres_between_walls_follow_their_equations_of_motion(taichi_f64):
    """A light particle on a heavy one, compressed between walls at a distance of 1.8 mm: two coupled
    equations."""
    radius, modulus, restitution = 5e-4, 1e6, 0.8
    soft = {"young_modulus": modulus, "poisson_ratio": 0.3}
    heights = {"heavy": 4.5e-4, "light": 1.35e-3}
    floor, lid = plane([0, 0, 0], [0, 0, 1], "light"), plane([0, 0, 1.8e-3], [0, 0, -1], "light")
    scene = build_scene(
        {name: particle_group([[0, 0, z]], 2 * radius, name) for name, z in heights.items()}
        | {"fixed": particle_group([[0.9, 0.9, 1e-3]], 2 * radius, "light") | {"fixed": True}},
        {"floor": floor, "lid": lid}, {"restitution": restitution},
        materials={"heavy": soft | {"density": 2e4}, "light": soft | {"density": 1e4}}, normal="hertz",
        pairs={"light-light": {"restitution": restitution, "friction": 0.3}},
        gravity=[0.0, 0.0, -GRAVITY], numerics={"max_overlap": 0.5}, run={"duration": 0.01, "time_step": 1e-6},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 1e-4)
    volume = 4.0 / 3.0 * np.pi * radius**3
    m1, m2 = volume * 2e4, volume * 1e4
    modulus_eff = modulus / (2.0 * (1.0 - 0.3**2))
    zeta = theory.damping_ratio_for(restitution)

    def force(overlap, rate, radius_eff, mass_eff):
        k = 4.0 / 3.0 * modulus_eff * np.sqrt(radius_eff)
        d = max(overlap, 0.0)
        return max(k * d**1.5 + np.sqrt(5.0) * zeta * np.sqrt(mass_eff * k) * d**0.25 * rate, 0.0)

    def motion(t, s):
        y1, y2, v1, v2 = s
        floor = force(radius - y1, -v1, radius, m1)
        contact = force(2.0 * radius - (y2 - y1), v1 - v2, 0.5 * radius, m1 * m2 / (m1 + m2))
        lid = force(y2 + radius - 1.8e-3, v2, radius, m2)
        return [v1, v2, (floor - contact) / m1 - GRAVITY, (contact - lid) / m2 - GRAVITY]

    exact = solve_ivp(
        motion, (0.0, 0.01), [4.5e-4, 1.35e-3, 0.0, 0.0], method="DOP853", rtol=1e-9, atol=1e-13,
        t_eval=np.minimum(times(snapshots), 0.01), max_step=5e-5,
    )  # fmt: skip
    height = column(snapshots, "position")[:, :2, 2].T
    amplitude = np.ptp(exact.y[:2], axis=1)
    assert np.all(amplitude > 5e-6)
    np.testing.assert_allclose((height - exact.y[:2]) / amplitude[:, None], 0.0, atol=1e-3)


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
