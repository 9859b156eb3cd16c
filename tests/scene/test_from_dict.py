"""Scenes from Python mappings: the same checks as for files, with key paths as positions."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group

from granflow import Output, Scene, SceneError
from granflow.load import scene_of


def described(**changes):
    """A scene with one particle as a mapping, with other values for some of its keys."""
    scene = build_scene({"ball": particle_group([[0.0, 0.0, 0.0]])})
    return scene.model_dump(by_alias=True, exclude_none=True) | changes


def problems(**changes):
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(described(**changes))
    return list(caught.value.problems)


def test_mapping_and_text_give_the_same_scene():
    scene = Scene.from_dict(described(gravity=np.array([0.0, 0.0, -9.81]), run={"duration": "20 ms"}))
    assert scene.gravity == (0.0, 0.0, -9.81) and scene.run.duration == 0.02
    assert scene_of(scene.to_yaml(), "scene") == scene


def test_problems_name_the_key_path():
    (problem,) = problems(gravity=[0.0, 0.0])
    assert problem.startswith("gravity is [0.0, 0.0], but ")
    assert "seed: a value is of type object; give a number, text, list or mapping." in problems(seed=object())


@pytest.mark.parametrize("data", [[], None, "scene.yaml", [("title", "A scene")]])
def test_an_object_that_is_no_mapping_is_refused(data):
    with pytest.raises(
        SceneError, match=f"scene: this is a {type(data).__name__}, but a scene is a mapping of keys"
    ):
        Scene.from_dict(data)


def test_checks_and_amounts_are_those_of_files():
    without = {key: value for key, value in described().items() if key != "gravity"}
    with pytest.raises(SceneError, match="^scene: gravity is missing"):
        Scene.from_dict(without)
    (problem,) = problems(stages=[{"name": "fill", "duration": 1.0}])
    assert problem.startswith("run.duration is 1.0, but the stages have durations")
    region = {"box": {"min": [0, 0, 0], "max": [0.5, 0.5, 0.5]}}
    group = {
        "material": "glass",
        "diameter": 0.01,
        "mass": "10 g",
        "insert": {"kind": "pack", "region": region},
    }
    assert Scene.from_dict(described(particles={"beads": group})).particles["beads"].count == 8


def test_scene_is_immutable():
    scene = Scene.from_dict(described())
    with pytest.raises(AttributeError, match="immutable"):
        scene.seed = 2
    with pytest.raises(TypeError, match="immutable"):
        scene.walls["floor"] = None
    with pytest.raises(TypeError, match="immutable"):
        scene.particles.clear()
    assert scene.model_copy(deep=True) == scene


def test_mappings_inside_of_blocks_are_immutable():
    """In copies of the blocks: those of the program remain as they are, and so do the names of the given
    fields."""
    given = Output(interval=0.1, flow_meters={"outlet": {"point": [0.0] * 3, "normal": [0.0, 0.0, -1.0]}})
    scene = Scene.from_dict(described(output=given))
    for mapping in (scene.output.flow_meters, scene.output.metrics):
        with pytest.raises(TypeError, match="immutable"):
            mapping["other"] = None
    given.flow_meters.clear()
    assert list(scene.output.flow_meters) == ["outlet"]
    assert scene.output.model_fields_set == {"interval", "flow_meters"}
