"""Registration of contact models from outside the package: records that are refused, scenes from before."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from contact.test_external_models import Sticky, StickyOptions
from pydantic import Field

from granflow import GranflowError, Scene, load_scene, register_contact_model
from granflow.contact.law import ContactModel, NormalLaw, Options, PairProperties
from granflow.contact.normal.hertz import Hertz
from granflow.device_functions import ti
from granflow.scene.registration import unregister_contact_model
from granflow.schema.quantities import Number


@dataclass(frozen=True)
class Incomplete(NormalLaw):
    name = "incomplete"
    source = "this test, 2026"
    limits = "a model without physical basis"


class WithoutExample(Options):
    size: float = Field(description="x")


class OtherFriction(PairProperties):
    friction: float = Field(description="x")


class WithDefault(PairProperties):
    stickiness: float = Field(0.0, description="x")


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (
            ContactModel(Incomplete, "x"),
            "must define force, reference, stored_energy, phase_durations, unloading_stiffness, see ",
        ),
        (
            ContactModel(type("Other", (Hertz,), {"name": "other", "constant_names": ("k",)}), "x"),
            "begins with modulus_e",
        ),
        (
            ContactModel(Sticky, "x", options={"size": 1.0}),
            "is not a subclass of granflow.contact.law.Options",
        ),
        (
            ContactModel(Sticky, "x", options=WithoutExample),
            "option size has neither a default nor an example",
        ),
        (
            ContactModel(Sticky, "x", pair_properties=OtherFriction),
            "key friction of pairs exists with another meaning",
        ),
        (ContactModel(Sticky, "x", pair_properties=WithDefault), "key stickiness of pairs has a default"),
    ],
)
def test_incomplete_models_are_refused_at_registration(model, message):
    """Without the refusal, the first scene fails with a traceback from the time step or the kernels."""
    with pytest.raises(GranflowError, match=message):
        register_contact_model(model)


def test_an_option_of_an_unknown_dimension_is_refused_where_it_is_declared():
    with pytest.raises(GranflowError, match="the dimension lenght is not one of number, "):
        Number("lenght")


def test_a_model_without_source_is_refused_at_registration():
    """As in the interactive interpreter: the kernel language compiles the text of the functions."""
    names: dict = {"ti": ti, "Sticky": Sticky}
    exec(
        "class Typed(Sticky):\n    @ti.func\n    def force(self, *values):\n        return 0.0, values[2]",
        names,
    )
    with pytest.raises(GranflowError, match="the source of force is not available, .*; define it in a file"):
        register_contact_model(ContactModel(names["Typed"], "x"))


def test_a_scene_from_before_the_registration_is_written_without_a_warning(recwarn):
    first = load_scene(Path(__file__).parents[2] / "scenes" / "hopper.yaml")
    model = ContactModel(
        type("Later", (Sticky,), {"name": "later"}),
        "x",
        options=StickyOptions,
    )
    register_contact_model(model)
    try:
        assert Scene.from_dict(first.to_dict(), first.folder).to_dict() == first.to_dict()
    finally:
        unregister_contact_model(model)
    assert not [each for each in recwarn if "serializer" in str(each.message)]
