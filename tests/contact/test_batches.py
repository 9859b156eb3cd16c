"""Contact models without branches are evaluated in batches: same results as single contacts, and no compiler
crash."""

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, run_to_end
from subprocess_runner import in_subprocess

from granflow.plan.build import plan_for

REFERENCE = {"stiffness": {"reference_velocity": 1.0}}
NORMALS = {
    "thornton": {"law": "thornton", "yield_ratio": 1.6},
    "walton_braun": {"law": "walton_braun", "unloading": {"reference_velocity": 1.0}, "stiffness": "onset"},
    "luding": {"law": "luding", "plasticity_depth": 0.02, "tension": 0.3, "stiffness": "onset"},
    "luding, no tension": {"law": "luding", "plasticity_depth": 0.02, "tension": 0.0, **REFERENCE},
}
SIDE, DIAMETER = 6, 0.01
STEPS, TIME_STEP = 250, 1e-6


def overlapping_lattice(law, cohesion, chunk_size):
    """Moving particles in contact with their neighbors initially: contacts load, unload, attract and
    separate."""
    rng = np.random.default_rng(3)
    positions = 0.999 * DIAMETER * (np.argwhere(np.ones((SIDE, SIDE, SIDE))) - 2.5)
    group = particle_group(positions, DIAMETER, velocity=rng.normal(0.0, 0.3, positions.shape))
    pair = {"friction": 0.4} | ({} if law == "thornton" else {"restitution": 0.7})
    pair |= {} if cohesion == "none" else {"cohesion_energy_density": 1e4}
    return build_scene(
        {"balls": group}, pairs={"glass-glass": pair}, materials={"glass": SOFT | {"yield_strength": 3e6}},
        contact={"normal": NORMALS[law], "tangential": "mindlin", "rolling": "none", "cohesion": cohesion},
        run={"duration": STEPS * TIME_STEP, "time_step": TIME_STEP, "velocity_max": 2.0},
        numerics={"chunk_size": chunk_size},
    )  # fmt: skip


def single_and_batched(law, cohesion):
    """Positions, velocities, angular velocities and contact counts after `STEPS` for both ways of
    evaluation."""
    states = []
    contacts = []
    for chunk_size in (1, SIDE**3):
        scene = overlapping_lattice(law, cohesion, chunk_size)
        assert plan_for(scene).chunk_size == chunk_size
        last, _ = run_to_end(scene)
        states.append(
            [last.particles[name].tolist() for name in ("position", "velocity", "angular_velocity")]
        )
        contacts.append(last.totals["contact_count"])
    return states, contacts


@pytest.mark.parametrize(
    ("law", "cohesion"),
    [
        ("luding", "sjkr"),
        pytest.param("thornton", "none", marks=pytest.mark.slow),
        pytest.param("walton_braun", "none", marks=pytest.mark.slow),
        pytest.param("luding, no tension", "none", marks=pytest.mark.slow),
    ],
)
def test_batches_equal_single_contacts_within_rounding(law, cohesion):
    """The sum over forces has another order: rounding of 1e-16 per step, which 250 steps of collisions
    amplify."""
    (single, batched), contacts = in_subprocess(single_and_batched, law, cohesion)
    assert 0.3 * 3 * SIDE**2 * (SIDE - 1) < contacts[0] == contacts[1]
    for one, other, scale in zip(single, batched, (SIDE * DIAMETER, 0.3, 0.3 / DIAMETER), strict=True):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-11 * scale)
