"""Particles that roll over curved, turning and moving surfaces, against independent integrations of their
equations."""

from typing import Any

import numpy as np
from geometry.meshes import write
from scene_builders import build_scene, particle_group, plane, run_to_end
from scipy.integrate import solve_ivp

RADIUS, DENSITY, GRAVITY = 5e-4, 2500.0, np.array([0.0, 0.0, -30.0])
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * DENSITY
INERTIA = 0.4 * MASS * RADIUS**2
POISSON_RATIO = 0.25
NORMAL, TANGENTIAL, TORSION = 20.0, 15.0, 2e-9
"""Stiffnesses [N/m], [N/m] and [N m/rad]; the torsion spring is so weak that particles keep their spin."""
ROLLING = 2.0 * (1.0 - POISSON_RATIO) / (2.0 - POISSON_RATIO) * NORMAL
"""Rolling stiffness over the square of the effective radius [N/m]: Mindlin's ratio times the normal
stiffness."""
DURATION = 0.008
COARSE, DRUM_RADIUS, DRUM_CENTER = 4e-3, 8e-3, np.array([0.03, 0.0, 0.0])
DRUM_RATE, PLATE_RATE = np.array([20.0, 0.0, 0.0]), np.array([0.0, -6.0, 0.0])
PIVOT, EDGE = np.array([0.0, 0.0, -0.03]), np.array([0.0, 0.03, 0.0])
ASLANT, ACROSS = np.array([0.0, np.sin(0.3), np.cos(0.3)]), np.array([0.0, np.cos(0.3), -np.sin(0.3)])


def on_sphere(t, x):
    """Distance [m] of a point from the surface of the fixed sphere, and normal."""
    distance = np.linalg.norm(x)
    return distance - COARSE, x / distance


def inside_drum(t, x):
    """As `on_sphere`, in a drum about x."""
    branch = (x - DRUM_CENTER) * [0.0, 1.0, 1.0]
    distance = np.linalg.norm(branch)
    return DRUM_RADIUS - distance, -branch / distance


def on_plate(t, x):
    """As `on_sphere`, above a plate that turns about y."""
    angle = PLATE_RATE[1] * t
    normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
    return (x - PIVOT) @ normal, normal


def over_edge(t, x):
    """As `on_sphere`, on an edge along x."""
    branch = (x - EDGE) * [0.0, 1.0, 1.0]
    distance = np.linalg.norm(branch)
    return distance, branch / distance


SURFACES: dict[str, Any] = {
    "sphere": (on_sphere, RADIUS * COARSE / (RADIUS + COARSE), np.zeros(3), np.zeros(3)),
    "drum": (inside_drum, RADIUS, DRUM_RATE, DRUM_CENTER),
    "plate": (on_plate, RADIUS, PLATE_RATE, PIVOT),
    "edge": (over_edge, RADIUS, np.zeros(3), EDGE),
}
"""Distance and normal, effective radius of contacts [m], angular velocity [rad/s] and pivot [m] of each
surface."""
OVERLAP = MASS * 30.0 / NORMAL
STARTS = {
    "sphere": ((COARSE + RADIUS - OVERLAP) * ASLANT, 0.15 * ACROSS + [0.05, 0.0, 0.0], [10.0, -20.0, 400.0]),
    "drum": (DRUM_CENTER + [0.0, 0.0, RADIUS - DRUM_RADIUS - OVERLAP], [0.05, 0.3, 0.0], [30.0, 20.0, 400.0]),
    "plate": (PIVOT + [0.01, 0.0, RADIUS - OVERLAP], [0.1, 0.1, 0.06], [20.0, 20.0, 400.0]),
    "edge": (EDGE + [0.0, 0.0, RADIUS - OVERLAP], [0.1, 0.02, 0.0], [30.0, -10.0, 400.0]),
}
"""Position [m], velocity [m/s] and angular velocity [rad/s] of each particle at the start."""


def derivatives(surface, t, state):
    """Time derivatives of position, velocity, angular velocity and displacements; load [N].

    Spring of friction s, of rolling a and of twist b; the first two turn with the contact plane, and about its
    normal with the mean of both bodies, at the rate q:

        s' = v_t - (s . n') n + q n x s        a' = w_t - (a . n') n + q n x a        b' = w . n
    """
    distance_and_normal, radius_eff, turning, pivot = surface
    x, v, w, s, a, b = np.split(state, [3, 6, 9, 12, 15])
    distance, n = distance_and_normal(t, x)
    arm = 0.5 * (RADIUS + distance)
    step = 1e-6  # RADIUS - overlap / 2
    after, before = (distance_and_normal(t + sign * step, x + sign * step * v)[1] for sign in (1.0, -1.0))
    turn = (after - before) / (2.0 * step)
    relative = v - np.cross(turning, x - arm * n - pivot)
    rate = w - turning
    slip = relative - relative @ n * n - arm * np.cross(w, n)
    friction = TANGENTIAL * s
    load = NORMAL * (RADIUS - distance)
    torque = arm * np.cross(n, friction) - ROLLING * radius_eff**2 * a - TORSION * b * n
    spin = 0.5 * (w + turning) @ n
    slipping = slip - s @ turn * n + spin * np.cross(n, s)
    rolling = rate - rate @ n * n - a @ turn * n + spin * np.cross(n, a)
    changes = slipping, rolling, [rate @ n]
    return np.concatenate([v, GRAVITY + (load * n - friction) / MASS, torque / INERTIA, *changes]), load


def integrated(name):
    """Position and angular velocity (6,) at the end, with the method of Dormand and Prince of order 8."""
    surface = SURFACES[name]
    times = np.linspace(0.0, DURATION, 200)
    start = np.concatenate([*STARTS[name], np.zeros(7)])
    found = solve_ivp(
        lambda t, state: derivatives(surface, t, state)[0], times[[0, -1]], start, "DOP853", times, rtol=1e-8, atol=1e-12
    ).y  # fmt: skip
    assert min(derivatives(surface, *each)[1] for each in zip(times, found.T, strict=True)) > 0.0
    return np.concatenate([found[0:3, -1], RADIUS * found[6:9, -1]])


def simulated(steps):
    """The same (particles, 6) of all particles in one scene."""
    position, velocity, angular_velocity = (np.array(each) for each in zip(*STARTS.values(), strict=True))
    fine = particle_group(position, 2 * RADIUS, velocity=velocity, angular_velocity=angular_velocity)
    turning, rising = (
        {"kind": "rotation", "point": point.tolist(), "axis": axis, "angular_velocity": rate}
        for point, axis, rate in ((DRUM_CENTER, [1, 0, 0], DRUM_RATE[0]), (PIVOT, [0, 1, 0], PLATE_RATE[1]))
    )
    ends = [(DRUM_CENTER + [side * 6e-3, 0.0, 0.0]).tolist() for side in (-1, 1)]
    scene = build_scene(
        {"fine": fine, "coarse": particle_group([[0.0, 0.0, 0.0]], 2 * COARSE) | {"fixed": True}},
        walls={
            "drum": {"shape": "cylinder", "from": ends[0], "to": ends[1], "radius": DRUM_RADIUS, "material": "glass",
                     "motion": turning},
            "plate": plane(PIVOT, [0, 0, 1], motion=rising),
            "edge": {"shape": "mesh", "file": "ridge.stl", "material": "glass"},
        },
        materials={"glass": {"young_modulus": 1e6, "poisson_ratio": POISSON_RATIO, "density": DENSITY}},
        pair={"restitution": 1.0, "friction": 1e3, "rolling_friction": 1e3, "twisting_friction": 1.0},
        gravity=GRAVITY.tolist(),
        contact={"normal": {"law": "linear", "stiffness": {"value": NORMAL}}, "rolling": "epsd",
                 "tangential": {"law": "linear_history", "stiffness": TANGENTIAL},
                 "twisting": {"law": "torsion_spring", "stiffness": TORSION}},
        domain={"min": [-0.05] * 3, "max": [0.05] * 3, "on_exit": "error"},
        run={"duration": DURATION, "time_step": DURATION / steps, "velocity_max": 0.5},
    )  # fmt: skip
    particles = run_to_end(scene)[0].particles
    fine = particles["radius"] < 2 * RADIUS
    return np.concatenate([particles["position"][fine], RADIUS * particles["angular_velocity"][fine]], axis=1)


def test_trajectories_with_spin_converge_with_second_order(taichi_f64, tmp_path, monkeypatch):
    """On a sphere, in a rotating drum, on a turning plate and over the edge of a mesh, springs below their
    limits.

    Slip, rolling and twist are those at the half step. With the normal of the full step, those of a particle
    that spins about the normal have an error of first order.
    """
    monkeypatch.chdir(tmp_path)
    ridge = EDGE + np.array([[-0.01, 0, 0], [0.01, 0, 0], [-0.01, 0.01, -0.01], [0.01, 0.01, -0.01],
                             [-0.01, -0.01, -0.01], [0.01, -0.01, -0.01]])  # fmt: skip
    write(tmp_path / "ridge.stl", ridge, np.array([[0, 1, 3], [0, 3, 2], [0, 4, 5], [0, 5, 1]]))
    exact = np.array([integrated(name) for name in STARTS])
    scale = np.array([1e-3] * 3 + [1e-1] * 3)  # displacement [m] and surface velocity [m/s]
    errors = np.array([np.linalg.norm((simulated(n) - exact) / scale, axis=1) for n in (500, 1000, 2000)])
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all(np.abs(orders - 2.0) < 0.2), dict(zip(STARTS, orders.T.round(2).tolist(), strict=True))
    assert errors[-1].max() < 0.01
