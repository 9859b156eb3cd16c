"""Requirements on the record of every contact model, and on its host functions."""

from types import SimpleNamespace

import pytest
from contact.cases import SHEAR_MODULUS

from granflow.contact import registry
from granflow.contact.law import SLOTS, ModelRequest
from granflow.contact.material import PairMaterial

RECORDS = [model for slot in SLOTS for model in registry.models(slot).values()]


def law_of(model):
    """The law of a record with its example options, and the pair of materials."""
    given = model.options(**model.example)
    restitution = None if model.restitution == "nothing" else 0.7
    options = dict.fromkeys(model.pair_properties.model_fields, 0.1)
    solid = SimpleNamespace(
        young_modulus=1e7, poisson_ratio=0.3, thermal_conductivity=50.0, true_young_modulus=None
    )
    pair = PairMaterial(
        4e7, SHEAR_MODULUS, restitution, yield_strength=1e6, properties=options, materials=(solid, solid)
    )
    return model.law.from_scene(ModelRequest(given, (pair,), 1.0, 0.5, energy_budget=True)), pair


@pytest.mark.parametrize("model", RECORDS, ids=lambda model: f"{model.slot}-{model.name}")
def test_every_model_describes_its_constants_history_limits_and_source(model):
    law, pair = law_of(model)
    assert len(law.pair_constants(pair)) == len(law.constant_names) == len(set(law.constant_names))
    assert len(model.law.limits) > 20 and not model.law.limits.endswith(".")
    assert model.slot == "cohesion" or any(character.isdigit() for character in law.source), (
        "the source has a year"
    )
    assert all(each.size in (1, 3) and each.description for each in law.history)
    if model.slot == "normal":
        assert law.constant_names[:2] == ("modulus_eff", "shear_modulus_eff")
        assert law.pair_constants(pair)[:2] == (pair.modulus_eff, pair.shear_modulus_eff)


def test_a_second_model_of_the_same_name_is_rejected():
    for model in RECORDS:
        with pytest.raises(ValueError, match=f"a {model.slot} model of this name exists"):
            registry.add(model)
