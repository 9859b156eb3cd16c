"""Liquid content of particle groups: invalid combinations with liquid transfer."""

import pytest
from scene_builders import LIQUID, build_scene, particle_group

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.plan.build import plan_for
from granflow.plan.explain import explain

GROUP = particle_group([[0, 0, 0], [0, 0, 0.1]], liquid_content=0.01)


@pytest.mark.parametrize(("group", "cohesion", "parts", "sentence"), [
    ({}, {}, {}, None),
    ({"liquid_content": None}, {}, {}, "liquid_content is missing: contact.cohesion is capillary_transfer; give the"),
    ({"liquid_content": -0.1}, {}, {}, "liquid_content is -0.1, but a fraction must be at least 0"),
    ({}, {"cohesion": "sjkr"}, {}, "is 0.01, but contact.cohesion is sjkr; remove liquid_content, or choose"),
    ({}, {"cohesion": {"law": "capillary_transfer"}}, {}, "max_bridge_volume is missing: largest volume of a bridge"),
    ({}, {}, {"start_from": "out/earlier"}, "start_from cannot be combined with contact.cohesion: capillary_transfer"),
    ({}, {}, {"run": {"duration": 1.0, "precision": "f32"}}, "is f32, .* conserves liquid in f64 only; write f64."),
])  # fmt: skip
def test_invalid_liquid_is_refused(group, cohesion, parts, sentence):
    scene = build_scene({"wet": GROUP}, **LIQUID).to_dict()
    changed = scene["particles"]["wet"] | group
    scene["particles"]["wet"] = {key: value for key, value in changed.items() if value is not None}
    scene["contact"] |= cohesion
    if sentence is None:
        assert "liquid transfer" in explain(plan_for(Scene.from_dict(scene)))
        return
    with pytest.raises(SceneError, match=sentence):
        plan_for(Scene.from_dict(scene | parts))
