"""Liquid content of particle groups, and messages about invalid combinations with liquid transfer."""

import pytest
from scene_builders import LIQUID, SOFT, build_scene, particle_group

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.plan.build import plan_for
from granflow.plan.explain import explain


def problems(group=None, cohesion=None, **parts):
    """Messages of a scene with one wet group, changed."""
    scene = build_scene(
        {"wet": particle_group([[0, 0, 0], [0, 0, 0.1]], liquid_content=0.01)}, **LIQUID
    ).to_dict()
    scene["particles"]["wet"] |= group or {}
    if cohesion:
        scene["contact"]["cohesion"] = cohesion
    scene["particles"]["wet"] = {k: v for k, v in scene["particles"]["wet"].items() if v is not None}
    try:
        plan_for(Scene.from_dict(scene | parts))
    except SceneError as error:
        return error.problems
    return []


CASES = [
    ({"group": {"liquid_content": None}}, "particles.wet.liquid_content is missing: contact.cohesion is "
     "capillary_transfer; give the volume of the film"),
    ({"group": {"liquid_content": -0.1}},
     "particles.wet.liquid_content is -0.1, but a fraction must be at least 0"),
    ({"cohesion": "sjkr"}, "particles.wet.liquid_content is 0.01, but contact.cohesion is sjkr; remove "
     "liquid_content, or choose capillary_transfer"),
    ({"cohesion": {"law": "capillary_transfer"}},
     "contact.cohesion.max_bridge_volume is missing: largest volume of a bridge [m3]"),
    ({"start_from": "out/earlier"},
     "start_from cannot be combined with contact.cohesion: capillary_transfer: it reads no liquid"),
    ({"run": {"duration": 1.0, "precision": "f32"}}, "run.precision is f32, but contact.cohesion: "
     "capillary_transfer conserves liquid in f64 only; write f64."),
]  # fmt: skip


@pytest.mark.parametrize(("change", "sentence"), CASES)
def test_invalid_liquid_has_its_message(change, sentence):
    found = problems(**change)
    assert any(sentence in each for each in found), found


def test_valid_liquid_has_no_message_and_explain_shows_the_feature():
    assert problems() == []
    text = explain(plan_for(build_scene({"wet": particle_group([[0, 0, 0]], liquid_content=0.01)}, **LIQUID)))
    assert "liquid transfer" in text and "contact.cohesion is capillary_transfer" in text
    dry = explain(plan_for(build_scene({"dry": particle_group([[0, 0, 0]])}, materials={"glass": SOFT})))
    assert "no cohesion model takes liquid from films" in dry
