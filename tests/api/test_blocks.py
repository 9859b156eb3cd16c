"""Scenes built in Python: blocks, the constructor of scenes, and scenes that are written and read again."""

from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

import granflow as gf

SCENES = Path(__file__).resolve().parents[2] / "scenes"
SHIPPED = sorted(path for path in SCENES.rglob("*.yaml") if path.parent.name not in ("sweeps", "calibration"))


def blocks(**changes):
    """Blocks of a scene with a cylinder, as keywords of `Scene`."""
    found = dict(
        title="Blocks",
        gravity=np.array([0.0, 0.0, -9.81]),
        materials={"glass": gf.Material(young_modulus="60 MPa", poisson_ratio=0.25, density=2500)},
        pairs={"glass-glass": gf.MaterialPair(restitution=0.9, friction=0.5)},
        contact=gf.Contact(normal="zhou", tangential="mindlin", rolling="none"),
        walls={
            "drum": gf.Cylinder(
                material="glass", from_=[0, "-1 cm", 0], to=[0, 0.01, 0], radius="5 cm",
                motion=gf.Rotation(point=[0, 0, 0], axis=[0, 1, 0], angular_velocity="30 rpm"),
            )
        },
        particles={
            "balls": gf.Group(
                material="glass", count=20, diameter="4 mm",
                insert=gf.PackInsertion(region=gf.BoxRegion(box=gf.Box(min=[-0.02] * 3, max=[0.02] * 3))),
            )
        },
        domain=gf.Domain(min=[-0.1] * 3, max=[0.1] * 3, on_exit="delete"),
        run=gf.RunSettings(duration="50 ms"),
        output=gf.Output(interval="5 ms", flow_meters={"out": gf.FlowMeter(point=[0, 0, 0], normal=[0, 0, 1])}),
    )  # fmt: skip
    return found | changes


def problems(create, *arguments, **values):
    with pytest.raises(gf.SceneError) as caught:
        create(*arguments, **values)
    return list(caught.value.problems)


def test_blocks_and_plain_values_give_the_same_scene():
    plain = {
        "materials": {"glass": {"young_modulus": 60e6, "poisson_ratio": 0.25, "density": 2500}},
        "walls": {
            "drum": {
                "shape": "cylinder", "material": "glass", "from": [0, -0.01, 0], "to": [0, 0.01, 0], "radius": 0.05,
                "motion": {"kind": "rotation", "point": [0, 0, 0], "axis": [0, 1, 0], "angular_velocity": np.pi},
            }
        },
        "output": {"interval": 5e-3, "flow_meters": {"out": {"point": [0, 0, 0], "normal": [0, 0, 1]}}},
    }  # fmt: skip
    assert gf.Scene(**blocks()) == gf.Scene.from_dict(blocks(**plain))
    assert gf.Scene(**blocks()).walls["drum"].motion[0].angular_velocity == pytest.approx(np.pi)


def test_a_block_is_validated_where_it_is_created():
    assert problems(gf.Material, young_modulus=-1, poison_ratio=0.2, density=2500) == [
        "young_modulus is -1, but Young's modulus must be above 0.",
        "poison_ratio is not a known key. Did you mean poisson_ratio?",
    ]
    assert problems(gf.Plane, point=[0, 0, 0], normal=[0, 0, 1]) == [
        "Plane: material is missing: name of the wall's material."
    ]
    (problem,) = problems(gf.Cylinder, material="a", from_=[0, 0, 0], to=[0, 0, 0], radius=1)
    assert (
        problem
        == "to is [0, 0, 0], but it is the same point as from; the end points of the axis must differ."
    )
    (problem,) = problems(gf.Vibration, direction=[0, 0, 1], amplitude="1 mm")
    assert problem == "Vibration gives one of amplitude, frequency and gamma; give exactly two of them."
    (problem,) = problems(
        gf.Cone, shape="disc", material="a", from_=[0, 0, 0], to=[1, 0, 0], radius_from=1, radius_to=1
    )
    assert problem == "shape is disc, but it must be cone."


def test_problems_of_a_scene_have_key_paths():
    (problem,) = problems(gf.Scene, **blocks(pairs={}))
    assert "glass-glass" in problem and "pairs" in problem
    found = problems(
        gf.Scene, **blocks(gravity=[0, 0], walls={"drum": {"shape": "cylinder", "material": "glass"}})
    )
    assert found[0].startswith("gravity is [0, 0], but ")
    assert {each.partition(" is missing")[0] for each in found[1:]} == {
        f"walls.drum: walls.drum.{key}" for key in ("from", "to", "radius")
    }


def test_defaults_of_blocks_are_not_given():
    scene = gf.Scene(**blocks())
    assert scene.is_given("walls", "drum", "radius") and not scene.is_given("particles", "balls", "velocity")


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_scene_is_equal_after_saving_and_from_its_blocks(path, tmp_path):
    scene = gf.load_scene(path)
    parts = {
        name: getattr(scene, name) for name in type(scene).model_fields if getattr(scene, name) is not None
    }
    assert gf.Scene(folder=path.parent, **parts) == scene
    assert gf.Scene.from_dict(scene.to_dict(), scene.folder) == scene
    for _, name in scene.input_names():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((path.parent / name).read_bytes())
    assert gf.load_scene(scene.save(tmp_path / "again.yaml")) == scene


def test_saving_refuses_a_folder_without_the_input_files(tmp_path):
    scene = gf.load_scene(SCENES / "mixer.yaml")
    with pytest.raises(gf.GranflowError, match=r"which does not exist in .*: copy it there from "):
        scene.save(tmp_path / "mixer.yaml")
    assert not list(tmp_path.iterdir())
    with pytest.raises(gf.OutputError, match="cannot be written: No such file or directory; give a file in"):
        gf.Scene(**blocks()).save(tmp_path / "none" / "scene.yaml")


def test_representations_show_given_values_only():
    assert repr(gf.Plane(material="a", point=[0, 0, 0], normal=[0, 0, 1])) == (
        "Plane(material='a', point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))"
    )
    scene = gf.Scene(**blocks(title="<b>A & B</b>"))
    assert (
        repr(scene)
        == '<Scene "<b>A & B</b>": 20 particles in 1 group, 1 wall, zhou contacts, at most 0.05 s>'
    )
    assert "&lt;b&gt;A &amp; B&lt;/b&gt;" in scene._repr_html_() and "<b>" not in scene._repr_html_()
    assert deepcopy(scene) == scene
