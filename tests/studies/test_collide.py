"""`granflow collide`: the first half step of a dashpot, and unsupported input."""

import pytest

from granflow.errors import GranflowError
from granflow.studies.collide import collide

STEEL = {"material": "stainless_316", "diameter": 0.0254, "velocity": 0.5}


def test_dashpot_of_a_collision_that_begins_with_touching_surfaces_acts_from_the_first_contact(taichi_f64):
    """Within 1 % with the default time step, 24 steps; without the first half step 5 % too high."""
    assert collide("hertz", restitution=0.05, **STEEL)["restitution"] == pytest.approx(0.05, rel=0.01)


@pytest.mark.parametrize(("law", "given", "sentence"), [
    ("torton", {}, "Unknown contact model torton. Did you mean thornton?"),
    ("thornton", {"restitution": 0.5}, "derives the restitution from the materials"),
    ("thornton", {"material": "glass"}, "requires a yield strength, which glass lacks"),
    ("hertz", {}, "requires a restitution coefficient"),
    ("zhou", {"velocity": 1e30}, "the overlap would reach .* m, more than the radius"),
    ("thornton", {"settings": ["yeld_ratio=1"]}, "is not a known key. Did you mean yield_ratio?")
])  # fmt: skip
def test_unsupported_input_of_a_contact_model_is_rejected(taichi_f64, law, given, sentence):
    with pytest.raises(GranflowError, match=sentence):
        collide(law, **(STEEL | given))
