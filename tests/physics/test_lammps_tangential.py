"""Oblique collisions of two spheres against LAMMPS, and against a reference integration in numpy.

`lammps_tangential.json` has the results of LAMMPS, with its version and input. LAMMPS takes the radius as the
lever arm of the slip velocity; at the recorded 10 um/s the overlap is below 3e-7 radii, so that the
difference does not count.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from scene_builders import colliding, few_spheres, run_to_end

RECORDED = json.loads(Path(__file__).with_name("lammps_tangential.json").read_text())
RADIUS, DENSITY, RESTITUTION = 0.005, 2500.0, 0.7
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * DENSITY
NORMAL_STIFFNESS, TANGENTIAL_STIFFNESS = 2e4, 1.5e4
VARIANTS = {
    "mindlin_rescale/force": {"law": "mindlin"},
    "mindlin": {"law": "mindlin", "increments": "displacement", "unloading": "kept"},
    "mindlin/force": {"law": "mindlin", "unloading": "kept"},
    "mindlin_rescale": {"law": "mindlin", "increments": "displacement"},
    "linear_history": {"law": "linear_history", "stiffness": TANGENTIAL_STIFFNESS},
}
"""Models of granflow by the names of LAMMPS."""
QUICK = "mindlin_rescale/force"


def collide(name, friction, damping, velocity, spins, modulus, duration, steps):
    """Velocities and angular velocities (2, 6) of two spheres after an oblique collision, and the last
    snapshot."""
    group = colliding(2 * RADIUS * (1.0 + 1e-9), 2 * RADIUS, 1.0, angular_velocity=spins) | {
        "velocity": [[0.5 * v for v in velocity], [-0.5 * v for v in velocity]]
    }
    linear = {"law": "linear", "stiffness": {"value": NORMAL_STIFFNESS}}
    scene = few_spheres(
        {"balls": group}, materials={"glass": {"young_modulus": modulus, "poisson_ratio": 0.25, "density": DENSITY}},
        pair={"restitution": RESTITUTION if damping else 1.0, "friction": friction},
        run={"duration": duration, "time_step": duration / steps, "velocity_max": float(np.linalg.norm(velocity))},
        contact={"normal": linear if name == "linear_history" else "hertz", "rolling": "none",
                 "tangential": VARIANTS[name] | {"damping": damping or 1e-300}},
    )  # fmt: skip
    last, _ = run_to_end(scene)
    return np.concatenate([last.particles[key][:2] for key in ("velocity", "angular_velocity")], axis=1), last


CASES = [
    pytest.param(case, id=f"{case['tangential']}-{case['friction']}-{case['damping']}",
                 marks=[] if case["tangential"] == QUICK else [pytest.mark.slow])
    for case in RECORDED["cases"]
]  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_oblique_collisions_equal_those_of_lammps(taichi_f64, case):
    """Within 1e-6 of the impact velocity, with damping in the limit of small steps.

    LAMMPS and granflow take the velocity of the dashpot at different times of a step: without damping their
    steps are equal, with damping the difference is of first order in the time step.
    """
    velocity = [1e-5, 6e-6, 2e-6]
    spins = [[0.0, 0.0, 2e-4], [1e-4, 0.0, -3e-4]]
    steps = 1_600_000 if case["damping"] else 4000
    given = (
        case["tangential"],
        case["friction"],
        case["damping"],
        velocity,
        spins,
        1e10,
        RECORDED["duration"],
    )
    found, _ = collide(*given, steps)
    scale = np.array([1.0, 1.0, 1.0, RADIUS, RADIUS, RADIUS]) / velocity[0]
    np.testing.assert_allclose(scale * found, scale * case["result"], rtol=0.0, atol=1e-6)


def reference_collision(friction, velocity, spins, modulus, duration, steps):
    """The same as an undamped `collide` in numpy, from the equations of LAMMPS' mindlin_rescale/force, with the
    lever arm R - d/2.

    The slip has the normal and the lever arm at the half step, the time of the velocities, unlike in LAMMPS.
    """
    time_step = duration / steps
    shear = modulus / 2.5 / 2.0 / (2.0 - 0.25)
    k = 4.0 / 3.0 * modulus / (2.0 * (1.0 - 0.25**2))
    opposite = np.array([[1.0], [-1.0]])
    position = -RADIUS * (1.0 + 1e-9) * opposite * [1.0, 0.0, 0.0]
    velocities = 0.5 * opposite * velocity
    rotations = np.array(spins)
    force, torque, history = np.zeros((3, 3))
    stiffness_before = 0.0
    for _ in range(steps):
        velocities = velocities + opposite * force * time_step / MASS
        rotations = rotations + torque * time_step / (0.4 * MASS * RADIUS**2)
        position = position + time_step * velocities
        branch = position[0] - position[1]
        distance = np.sqrt(branch @ branch)
        overlap = 2.0 * RADIUS - distance
        normal = branch / distance
        force, torque = np.zeros((2, 3))
        if overlap <= 0.0:
            continue
        relative = velocities[0] - velocities[1]
        branch_half = branch - 0.5 * time_step * relative
        distance_half = np.sqrt(branch_half @ branch_half)
        normal_half = branch_half / distance_half
        slip = relative - (relative @ normal_half) * normal_half
        slip = slip - np.cross(0.5 * distance_half * (rotations[0] + rotations[1]), normal_half)
        slip = slip - (slip @ normal) * normal
        contact_radius = np.sqrt(RADIUS / 2.0 * overlap)
        stiffness = 8.0 * shear * contact_radius
        if stiffness < stiffness_before:
            history = history * stiffness / stiffness_before
        stiffness_before = stiffness
        turned = history - (history @ normal) * normal
        if turned.any():
            history = turned * np.linalg.norm(history) / np.linalg.norm(turned)
        history = history - stiffness * slip * time_step
        load = k * contact_radius * overlap
        size = np.linalg.norm(history)
        if size > friction * load:
            history = history * friction * load / size
        force = load * normal + history
        torque = -(RADIUS - 0.5 * overlap) * np.cross(normal, history)
    return np.concatenate([velocities + opposite * force * time_step / MASS / 2.0, rotations], axis=1)


@pytest.mark.parametrize("friction", [0.3, 2.0])
def test_collisions_with_large_overlap_equal_the_reference_integration(taichi_f64, friction):
    """Undamped, overlap up to 2 % of the radius, the branch vector turns by 2 degrees; within 1e-6 of the
    velocity."""
    given = ([0.5, 0.3, 0.1], [[0.0, 0.0, 10.0], [5.0, 0.0, -15.0]], 1e8, 5e-4, 4000)
    found, last = collide(QUICK, friction, 0.0, *given)
    scale = np.array([1.0, 1.0, 1.0, RADIUS, RADIUS, RADIUS]) / 0.5
    assert found[0, 0] < 0.0 and last.totals["contact_count"] == 0.0
    np.testing.assert_allclose(
        scale * found, scale * reference_collision(friction, *given), rtol=0.0, atol=1e-6
    )
    assert abs(last.totals["energy_error"]) < 1e-4
