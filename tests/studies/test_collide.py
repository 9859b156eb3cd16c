"""`granflow collide` with every contact model of the catalog, and unsupported input."""

import numpy as np
import pytest

from granflow.errors import GranflowError
from granflow.studies.bench import CollisionBench
from granflow.studies.collide import collide

STEEL = {"material": "stainless_316", "diameter": 0.0254, "velocity": 0.5}


def test_dashpot_of_a_collision_that_begins_with_touching_surfaces_acts_from_the_first_contact(taichi_f64):
    """Within 1 % with the default time step, 24 steps; without the first half step 5 % too high."""
    assert collide("hertz", restitution=0.05, **STEEL)["restitution"] == pytest.approx(0.05, rel=0.01)


@pytest.mark.parametrize(("law", "given", "sentence"), [
    ("torton", {}, "Unknown contact model torton. Did you mean thornton?"),
    ("thornton", {"restitution": 0.5}, "derives the restitution from the materials; remove --restitution"),
    ("thornton", {"material": "glass"}, "requires a yield strength, which glass lacks"),
    ("hertz", {}, "requires a restitution coefficient"),
    ("luding", {"restitution": 0.0}, "requires a restitution above 0"),
    ("zhou", {"restitution": 1.5}, r"restitution is 1.5, but must be in \[0, 1\]"),
    ("zhou", {"velocity": 1e30},
     "velocity is 1e[+]30 m/s, but the overlap would reach .* m, more than the radius"),
    ("thornton", {"settings": ["yield_ratio=-1"]}, "yield_ratio is -1, but a ratio must be above 0"),
    ("thornton", {"settings": ["yeld_ratio=1"]}, "is not a known key. Did you mean yield_ratio?")
])  # fmt: skip
def test_unsupported_input_of_a_contact_model_is_rejected(taichi_f64, law, given, sentence):
    with pytest.raises(GranflowError, match=sentence):
        collide(law, **(STEEL | given))


def test_rounding_of_a_dashpot_that_cancels_the_elastic_force_does_not_prolong_a_collision(
    taichi_f64, monkeypatch
):
    """A GPU in float32 leaves residues of some ulps where a CPU has exactly 0: 2^-24 of the elastic force."""
    arguments = {"law": "hertz", "restitution": 0.05, **STEEL}
    exact = collide(**arguments)
    run = CollisionBench.run

    def with_residues(bench, every=1):
        samples = run(bench, every)
        force = samples[:, 2, 0]
        end = int(np.flatnonzero(force)[-1]) + 1
        residues = np.repeat(samples[end : end + 1], 30, axis=0)
        residues[:, 2, 0] = 2.0**-24 * np.abs(force).max()
        return np.concatenate([samples[:end], residues, samples[end:]])

    monkeypatch.setattr(CollisionBench, "run", with_residues)
    assert collide(**arguments)["duration"] == exact["duration"]
