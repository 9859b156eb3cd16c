"""Oblique collisions of two spheres against LAMMPS, and against a reference integration in numpy.

`lammps_tangential.json` has the results of LAMMPS, with its version and input. LAMMPS takes the radius as the
lever arm of the slip velocity; at the recorded 10 um/s the overlap is below 3e-7 radii, so that the
difference does not count.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, run_to_end

from granflow.contact import theory

RECORDED = json.loads(Path(__file__).with_name("lammps_tangential.json").read_text())
RADIUS, DENSITY, RESTITUTION = 0.005, 2500.0, 0.7
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * DENSITY
NORMAL_STIFFNESS, TANGENTIAL_STIFFNESS = 2e4, 1.5e4
VARIANTS = {
    "mindlin": {"law": "mindlin", "increments": "displacement", "unloading": "kept"},
    "mindlin/force": {"law": "mindlin", "unloading": "kept"},
    "mindlin_rescale": {"law": "mindlin", "increments": "displacement"},
    "mindlin_rescale/force": {"law": "mindlin"},
    "linear_history": {"law": "linear_history", "stiffness": TANGENTIAL_STIFFNESS},
}
"""Models of granflow by the names of LAMMPS."""
QUICK = "mindlin_rescale/force"


def collide(name, friction, damping, velocity, spins, modulus, duration, steps, energy_budget=False):
    """Velocities and angular velocities (2, 6) of two spheres after an oblique collision, and the last
    snapshot."""
    groups = {
        side: particle_group(
            [[-sign * RADIUS * (1.0 + 1e-9), 0.0, 0.0]],
            2 * RADIUS,
            velocity=0.5 * sign * np.array(velocity),
            angular_velocity=spin,
        )
        for side, sign, spin in zip(("left", "right"), (1.0, -1.0), spins, strict=True)
    }
    material = {"young_modulus": modulus, "poisson_ratio": 0.25, "density": DENSITY}
    linear = {"law": "linear", "stiffness": {"value": NORMAL_STIFFNESS}}
    scene = build_scene(
        groups, materials={"glass": material},
        pair={"restitution": RESTITUTION if damping else 1.0, "friction": friction},
        run={"duration": duration, "time_step": duration / steps, "velocity_max": float(np.linalg.norm(velocity))},
        output={"interval": duration, "energy_budget": energy_budget},
        contact={"normal": linear if name == "linear_history" else "hertz", "rolling": "none",
                 "tangential": VARIANTS[name] | {"damping": damping}},
    )  # fmt: skip
    last, _ = run_to_end(scene)
    return np.concatenate([last.particles["velocity"], last.particles["angular_velocity"]], axis=1), last


def recorded_case(case):
    """Parameter of a test; the default variant is quick because other tests compile it too."""
    marks = [] if case["tangential"] == QUICK else [pytest.mark.slow]
    return pytest.param(case, id=f"{case['tangential']}-{case['friction']}-{case['damping']}", marks=marks)


@pytest.mark.parametrize("case", [recorded_case(case) for case in RECORDED["cases"]])
def test_oblique_collisions_equal_those_of_lammps(taichi_f64, case):
    """Within 1e-6 of the impact velocity, with damping in the limit of small steps.

    LAMMPS and granflow take the velocity of the dashpot at different times of a step: without damping their
    steps are equal, with damping the difference is of first order in the time step.
    """
    velocity = [1e-5, 6e-6, 2e-6]
    spins = [[0.0, 0.0, 2e-4], [1e-4, 0.0, -3e-4]]
    name = case["tangential"]
    damping = case["damping"]

    steps = 1_600_000 if damping else 4000
    found, _ = collide(name, case["friction"], damping, velocity, spins, 1e10, RECORDED["duration"], steps)
    scale = np.array([1.0, 1.0, 1.0, RADIUS, RADIUS, RADIUS]) / velocity[0]
    np.testing.assert_allclose(scale * found, scale * case["result"], rtol=0.0, atol=1e-6)


def reference_collision(name, friction, damping, velocity, spins, modulus, duration, steps):
    """The same as `collide` in numpy, from the equations of LAMMPS' pair style granular, with the lever arm R
    - d/2.

    The slip has the normal and the lever arm at the half step, the time of the velocities, unlike in LAMMPS.
    """
    time_step = duration / steps
    shear = modulus / 2.5 / 2.0 / (2.0 - 0.25)
    k = 4.0 / 3.0 * modulus / (2.0 * (1.0 - 0.25**2))
    mass_eff = MASS / 2.0
    radius_eff = RADIUS / 2.0
    zeta = theory.damping_ratio_for(RESTITUTION) if damping else 0.0
    by_force = name.endswith("force")
    rescaled = "rescale" in name
    opposite = np.array([[1.0], [-1.0]])
    position = -RADIUS * (1.0 + 1e-9) * opposite * [1.0, 0.0, 0.0]
    velocities = 0.5 * opposite * velocity
    rotations = np.array(spins)
    force = np.zeros(3)
    torque = np.zeros(3)
    history = np.zeros(3)
    stiffness_before = 0.0
    for _ in range(steps):
        velocities = velocities + opposite * force * time_step / MASS
        rotations = rotations + torque * time_step / (0.4 * MASS * RADIUS**2)
        position = position + time_step * velocities
        branch = position[0] - position[1]
        distance = np.sqrt(branch @ branch)
        overlap = 2.0 * RADIUS - distance
        normal = branch / distance
        force, torque = np.zeros(3), np.zeros(3)
        if overlap <= 0.0:
            continue
        relative = velocities[0] - velocities[1]
        arm = RADIUS - 0.5 * overlap
        branch_half = branch - 0.5 * time_step * relative
        distance_half = np.sqrt(branch_half @ branch_half)
        normal_half = branch_half / distance_half
        arm_half = 0.5 * distance_half
        slip = relative - (relative @ normal_half) * normal_half
        slip = slip - np.cross(arm_half * (rotations[0] + rotations[1]), normal_half)
        slip = slip - (slip @ normal) * normal
        contact_radius = np.sqrt(radius_eff * overlap)
        dashpot = np.sqrt(5.0) * zeta * np.sqrt(mass_eff * k * contact_radius)
        stiffness = 8.0 * shear * contact_radius
        load = max(k * contact_radius * overlap - dashpot * (relative @ normal), 0.0)
        if rescaled and stiffness < stiffness_before:
            history = history * stiffness / stiffness_before
        stiffness_before = stiffness
        turned = history - (history @ normal) * normal
        if turned.any():
            history = turned * np.linalg.norm(history) / np.linalg.norm(turned)
        history = history - stiffness * slip * time_step if by_force else history + slip * time_step
        viscous = -damping * dashpot * slip
        tangential = (history if by_force else -stiffness * history) + viscous
        size = np.linalg.norm(tangential)
        if size > friction * load:
            tangential = tangential * friction * load / size
            history = tangential - viscous if by_force else (viscous - tangential) / stiffness
        force = load * normal + tangential
        torque = -arm * np.cross(normal, tangential)
    return np.concatenate([velocities + opposite * force * time_step / MASS / 2.0, rotations], axis=1)


@pytest.mark.parametrize("friction", [0.3, 2.0])
@pytest.mark.parametrize(
    "name",
    [
        QUICK,
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in VARIANTS
            if name not in (QUICK, "linear_history")
        ),
    ],
)
def test_collisions_with_large_overlap_equal_the_reference_integration(taichi_f64, name, friction):
    """Undamped, overlap up to 2 % of the radius, the branch vector turns by 2 degrees; within 1e-6 of the
    velocity."""
    given = (name, friction, 0.0, [0.5, 0.3, 0.1], [[0.0, 0.0, 10.0], [5.0, 0.0, -15.0]], 1e8, 5e-4, 4000)
    found, last = collide(*given, energy_budget=True)
    scale = np.array([1.0, 1.0, 1.0, RADIUS, RADIUS, RADIUS]) / 0.5
    assert found[0, 0] < 0.0 and last.totals["contact_count"] == 0.0
    np.testing.assert_allclose(scale * found, scale * reference_collision(*given), rtol=0.0, atol=1e-6)
    assert abs(last.totals["energy_error"]) < 1e-4
