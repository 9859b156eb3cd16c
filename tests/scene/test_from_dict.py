"""Scenes from Python mappings: the same checks as for files, with key paths as positions; immutable."""

import pytest
from scene_builders import build_scene, particle_group

from granflow import Output, Scene, SceneError


def described(**changes):
    """A scene with one particle as a mapping, with other values for some of its keys."""
    scene = build_scene({"ball": particle_group([[0.0, 0.0, 0.0]])})
    return scene.model_dump(by_alias=True, exclude_none=True) | changes


@pytest.mark.parametrize(("data", "message"), [
    (described(gravity=[0.0, 0.0]), r"^gravity is \[0.0, 0.0\], but "),
    (described(seed=object()), "seed: a value is of type object; give a number, text, list or mapping."),
    ({key: value for key, value in described().items() if key != "gravity"}, "^scene: gravity is missing"),
    (described(stages=[{"name": "a", "duration": 1.0}]), "^run.duration is 1.0, but the stages have durations"),
    ([("title", "A scene")], "scene: this is a list, but a scene is a mapping of keys"),
])  # fmt: skip
def test_problems_name_the_key_path(data, message):
    with pytest.raises(SceneError, match=message):
        Scene.from_dict(data)


def test_scene_and_its_mappings_are_immutable():
    """Blocks of the program are copied, with the names of the given fields."""
    given = Output(interval=0.1, flow_meters={"outlet": {"point": [0.0] * 3, "normal": [0.0, 0.0, -1.0]}})
    scene = Scene.from_dict(described(output=given))
    with pytest.raises(AttributeError, match="immutable"):
        scene.seed = 2
    for mapping in (scene.walls, scene.output.flow_meters, scene.output.metrics):
        with pytest.raises(TypeError, match="immutable"):
            mapping["other"] = None
    with pytest.raises(TypeError, match="immutable"):
        scene.particles.clear()
    assert scene.model_copy(deep=True) == scene
    given.flow_meters.clear()
    assert list(scene.output.flow_meters) == ["outlet"]
    assert scene.output.model_fields_set == {"interval", "flow_meters"}
