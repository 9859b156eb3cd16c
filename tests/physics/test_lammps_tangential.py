"""Oblique collisions of two spheres against LAMMPS.

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


def collide(case, velocity, spins, steps):
    """Velocities and angular velocities (2, 6) of two spheres after an oblique collision."""
    group = colliding(2 * RADIUS * (1.0 + 1e-9), 2 * RADIUS, 1.0, angular_velocity=spins) | {
        "velocity": [[0.5 * v for v in velocity], [-0.5 * v for v in velocity]]
    }
    name, damping, duration = case["tangential"], case["damping"], RECORDED["duration"]
    linear = {"law": "linear", "stiffness": {"value": NORMAL_STIFFNESS}}
    scene = few_spheres(
        {"balls": group}, materials={"glass": {"young_modulus": 1e10, "poisson_ratio": 0.25, "density": DENSITY}},
        pair={"restitution": RESTITUTION if damping else 1.0, "friction": case["friction"]},
        run={"duration": duration, "time_step": duration / steps, "velocity_max": float(np.linalg.norm(velocity))},
        contact={"normal": linear if name == "linear_history" else "hertz", "rolling": "none",
                 "tangential": VARIANTS[name] | {"damping": damping or 1e-12}},
    )  # fmt: skip
    last, _ = run_to_end(scene)
    return np.concatenate([last.particles[key][:2] for key in ("velocity", "angular_velocity")], axis=1)


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
    found = collide(case, velocity, spins, steps)
    scale = np.array([1.0, 1.0, 1.0, RADIUS, RADIUS, RADIUS]) / velocity[0]
    np.testing.assert_allclose(scale * found, scale * case["result"], rtol=0.0, atol=1e-6)
