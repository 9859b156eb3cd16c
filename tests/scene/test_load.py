"""Reading of scenes: SI units, presets, defaults, overrides, and a lossless round trip through text."""

import math
from pathlib import Path

import pytest

from granflow.errors import SceneError
from granflow.load import load_scene
from granflow.scene.blocks.materials import PRESETS
from granflow.scene.blocks.motions import Vibration
from granflow.scene.blocks.walls.half_space import Plane
from granflow.scene.reference import json_schema

GOOD = Path(__file__).parent.parent / "messages" / "good.yaml"


@pytest.fixture(scope="module")
def scene():
    return load_scene(GOOD)


def test_numbers_are_in_si_and_omitted_keys_have_their_defaults(scene):
    assert scene.walls["tube"].radius == 0.05
    assert scene.walls["tube"].motion[0].frequency == 25.0
    assert scene.materials["steel"].young_modulus == 193e9
    assert scene.particles["beads"].diameter.deviation == 0.0004
    assert [each.fraction for each in scene.particles["grit"].diameter.classes] == [0.75, 0.25]
    assert scene.particles["pair"].count == 2
    assert scene.output.timeseries_interval == scene.output.interval == 0.01
    assert scene.contact.normal.law == "zhou" and scene.contact.normal.restitution_at == "impact"
    assert scene.numerics.chunk_size == scene.run.time_step == "auto"


def test_presets_define_missing_properties(scene):
    glass = scene.materials["glass"]
    assert (glass.young_modulus, glass.yield_strength) == (PRESETS["glass"].young_modulus, 50e6)
    fit = "pairs.glass-steel.restitution={preset: chrome_52100, limit_velocity: 3}"
    found = load_scene(GOOD, ["materials.steel={preset: stainless_316}", fit])
    assert (found.materials["steel"].restitution_fit, found.materials["steel"].density) == (
        (3.0432, 0.540),
        8030.0,
    )
    pair = found.pair("steel", "glass")
    assert pair is found.pair("glass", "steel") is found.pairs["glass-steel"]
    assert (pair.restitution.sigma, pair.restitution.psi) == (0.1418, 0.3114)


def test_scene_without_stages_has_one_stage_named_run(scene):
    assert [stage.name for stage in scene.schedule] == ["fill", "settle", "discharge"]
    short = load_scene(GOOD, ["stages=[]", "run.duration=2", "walls.gate.stages=[run]"])
    assert [(stage.name, stage.duration) for stage in short.schedule] == [("run", 2.0)]


@pytest.mark.parametrize("given", [
    {"amplitude": 0.001, "frequency": 25},
    {"frequency": 25, "gamma": 2.5151},
    {"amplitude": 1e-3, "gamma": 2.5151}
])  # fmt: skip
def test_two_of_amplitude_frequency_and_gamma_define_a_vibration(given):
    vibration = Vibration(kind="vibration", direction=[0, 0, 1], **given)
    amplitude, omega = vibration.amplitude_and_angular_frequency((0.0, 0.0, -9.81))
    assert amplitude == pytest.approx(0.001, rel=1e-4)
    assert omega == pytest.approx(50 * math.pi, rel=1e-4)


def test_positions_of_keys_are_found(scene):
    """A single motion in place of a list has the positions of its keys; a missing key, that of its block."""
    assert scene.where("walls", "tube", "radius") == f"{GOOD}:26"
    assert scene.where("walls", "tube", "appears_at") == f"{GOOD}:22"
    assert load_scene(GOOD, ["seed=3"]).where("seed") == "--set seed=3"
    assert scene.is_given("walls", "tube", "motion", 0, "frequency")
    assert not scene.is_given("walls", "tube", "motion", 0, "phase")
    column = GOOD.read_text(encoding="utf-8").splitlines()[27].index("1 mm") + 1
    assert scene.locate("walls", "tube", "motion", 0, "amplitude") == f"{GOOD}:28:{column}"


def test_text_of_a_scene_is_read_back_as_an_equal_scene(scene, tmp_path):
    path = tmp_path / "again.yaml"
    path.write_text(scene.to_yaml(), encoding="utf-8")
    again = load_scene(path)
    assert again == scene and again.to_yaml() == scene.to_yaml()


def test_overrides_replace_values_of_the_file():
    """The restitution of every pair is a number then, so that it is constant by default."""
    scene = load_scene(GOOD, [
        "run.precision=f32", "numerics.chunk_size=64", "walls.tube.radius=6 cm", "stages.2.duration=5 s",
        "pairs.steel-glass.friction=0", "pairs.glass-steel.restitution=0.5", "title=a = b",
        "output.flow_meters.inlet={point: [0, 0, 1], normal: [0, 0, -1]}",
    ])  # fmt: skip
    assert (scene.run.precision, scene.numerics.chunk_size, scene.walls["tube"].radius) == ("f32", 64, 0.06)
    assert scene.stages[2].duration == 5.0 and scene.pairs["glass-steel"].friction == 0.0
    assert scene.contact.normal.restitution_at == "constant" and scene.title == "a = b"
    assert list(scene.output.flow_meters) == ["outlet", "inlet"]


def test_override_changes_only_one_of_two_walls_with_a_common_anchor(tmp_path):
    path = tmp_path / "scene.yaml"
    text = GOOD.read_text(encoding="utf-8").replace("  floor: {", "  base: &base {", 1)
    path.write_text(text.replace("  tube:\n", "  floor: *base\n  tube:\n", 1), encoding="utf-8")
    scene = load_scene(path, ["walls.floor.point=[0, 0, 1]"])
    assert (scene.walls["base"].point[2], scene.walls["floor"].point[2]) == (0.0, 1.0)
    (remark,) = scene.remarks
    assert remark.startswith("--set walls.floor.point changes this key alone: walls.base.point ")
    both = load_scene(path, ["walls.floor.point=[0, 0, 1]", "walls.base.point=[0, 0, 1]"])
    assert both.walls["base"].point[2] == 1.0 and not both.remarks


def test_scene_file_conforms_to_the_json_schema(scene):
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(json_schema())
    data = scene._document.root.data()
    assert [error.message for error in validator.iter_errors(data)] == []
    for change in ({"gravity": "5 Pa"}, {"unknown": 1}, {"output": {}}, {"contact": {"normal": "zou"}}):
        assert list(validator.iter_errors(data | change)), change
    assert list(validator.iter_errors({key: value for key, value in data.items() if key != "pairs"}))


def test_blocks_created_in_python_are_validated():
    with pytest.raises(SceneError, match=r"point is \[0, 0\], but a vector"):
        Plane(shape="plane", point=[0, 0], normal=[0, 0, 1], material="a")
