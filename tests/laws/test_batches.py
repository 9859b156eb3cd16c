"""Laws whose force has no branch are worked out in batches: as one contact at a time, and no compiler crashes."""

import numpy as np
import pytest
from child import in_child
from trials import SOFT, balls, finished, trial

from granflow.plan import plan_for

REFERENCE = {"stiffness": {"reference_velocity": 1.0}}
NORMALS = {
    "thornton": {"law": "thornton", "yield_ratio": 1.6},
    "walton_braun": {"law": "walton_braun", "unloading": {"reference_velocity": 1.0}, "stiffness": "onset"},
    "luding": {"law": "luding", "plasticity_depth": 0.02, "tension": 0.3, "stiffness": "onset"},
    "luding, no tension": {"law": "luding", "plasticity_depth": 0.02, "tension": 0.0, **REFERENCE},
}
SIDE, DIAMETER = 6, 0.01
STEPS, TIME_STEP = 250, 1e-6


def pressed_lattice(law, adhesion, chunk_size):
    """Spheres that touch their neighbours from the start, in motion, so that contacts load, unload, pull and part."""
    rng = np.random.default_rng(3)
    places = 0.999 * DIAMETER * (np.argwhere(np.ones((SIDE, SIDE, SIDE))) - 2.5)
    group = balls(places, DIAMETER, velocity=rng.normal(0.0, 0.3, places.shape))
    pair = {"friction": 0.4} | ({} if law == "thornton" else {"restitution": 0.7})
    pair |= {} if adhesion == "none" else {"cohesion_energy_density": 1e4}
    return trial(
        {"balls": group}, pairs={"glass-glass": pair}, materials={"glass": SOFT | {"yield_strength": 3e6}},
        contact={"normal": NORMALS[law], "tangential": "mindlin", "rolling": "none", "adhesion": adhesion},
        run={"duration": STEPS * TIME_STEP, "time_step": TIME_STEP, "velocity_max": 2.0},
        numerics={"chunk_size": chunk_size},
    )  # fmt: skip


def both_ways(law, adhesion):
    """Positions, velocities and spins after the same steps, contact by contact and in batches; contacts by then."""
    seen, contacts = [], []
    for chunk_size in (1, SIDE**3):
        scene = pressed_lattice(law, adhesion, chunk_size)
        assert plan_for(scene).chunk_size == chunk_size
        last, _ = finished(scene)
        seen.append([last.particles[name].tolist() for name in ("position", "velocity", "spin")])
        contacts.append(last.totals["contact_count"])
    return seen, contacts


@pytest.mark.parametrize(
    ("law", "adhesion"),
    [
        ("luding", "sjkr"),
        pytest.param("thornton", "none", marks=pytest.mark.slow),
        pytest.param("walton_braun", "none", marks=pytest.mark.slow),
        pytest.param("luding, no tension", "none", marks=pytest.mark.slow),
    ],
)
def test_batches_give_what_single_contacts_give(law, adhesion):
    """But for rounding, since forces are summed in another order: 1e-16 a step, which 250 steps of collisions raise."""
    (single, batched), contacts = in_child(both_ways, law, adhesion)
    assert 0.3 * 3 * SIDE**2 * (SIDE - 1) < contacts[0] == contacts[1]
    for one, other, scale in zip(single, batched, (SIDE * DIAMETER, 0.3, 0.3 / DIAMETER), strict=True):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-11 * scale)
