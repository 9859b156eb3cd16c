"""Reading of scenes from files and from Python: YAML 1.2, SI units, presets, defaults, overrides, other names."""

import math
from pathlib import Path

import pytest
from plan.scenes import scene_of
from scene_builders import build_scene, particle_group

from granflow import Output, Scene, SceneError
from granflow.load import load_scene
from granflow.scene.blocks.materials import PRESETS
from granflow.scene.blocks.motions import Vibration
from granflow.scene.reference import json_schema
from granflow.schema.document import parse

GOOD = Path(__file__).parent.parent / "messages" / "good.yaml"
DRUM = Path(__file__).parents[2] / "scenes/drum.yaml"


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


@pytest.mark.parametrize(("override", "suggestion"), [
    ("contact.normal=hertz-mindlin", "Did you mean hertz?"),
    ("contact.cohesion=simplified_jkr", "Did you mean sjkr?"),
    ("particles.beads.insert={kind: insert/stream}", "Did you mean inlet?"),
    ("walls.floor.shape=fix wall/gran", "Did you mean plane?"),
    ("materials.glass.youngsModulus=1e7", "Did you mean young_modulus?"),
    ("run.dt=1e-5", "Did you mean time_step?"),
    ("walls.floor.motion={kind: wiggle}", "Did you mean vibration?"),
    ("pairs.glass-glass.xmu=0.3", "Did you mean friction?"),
    ("pairs.glass-glass.static_friction=0.3", "Did you mean friction?"),
    ("pairs.glass-glass.rolling_friction_coefficient=0.3", "Did you mean rolling_friction?"),
    ("materials.glass.shear_modulus=4 MPa", "Give young_modulus, 2 (1 + poisson_ratio) times the shear modulus."),
    ("pairs.glass-glass={restitution: 0.9, friction:0.3}", "Write friction: 0.3, with a colon and a space"),
    ("boundary=p", "Did you mean domain?"),
    ("g=[0, 0, -9.81]", "g is not a known key. Did you mean gravity?"),
    ("walls.floor={type: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}", "type is not a known key. Did you mean shape?"),
    ("contact.tangential=linear_history", "linear_history requires stiffness, such as {law: linear_history, sti"),
    ("contact.normal=jkr", "jkr is given as contact.cohesion: jkr"),
    ("pairs.glass-glass={restitution: 0.9, friction: 0,3}", "Numbers have a decimal point, not a comma"),
])  # fmt: skip
def test_names_of_other_codes_are_recognized(tmp_path, override, suggestion):
    with pytest.raises(SceneError) as refused:
        scene_of(tmp_path, override)
    assert suggestion in str(refused.value)


@pytest.mark.parametrize("override", [
    "walls.shell.motion.angular_velocity=2", "walls.shell.motion.0.angular_velocity=2",
    "contact.normal.damping_ratio=0.1", "contact.normal=hertz", "pairs.steel-glass.friction=0.2",
])  # fmt: skip
def test_overrides_have_the_same_path_in_a_scene_and_in_its_resolved_form(tmp_path, override):
    """`granflow resume` applies overrides to scene_as_run.yaml."""
    resolved = tmp_path / "scene_as_run.yaml"
    resolved.write_text(load_scene(DRUM).to_yaml())
    first, second = (load_scene(path, [override]) for path in (DRUM, resolved))
    assert first.to_yaml() == second.to_yaml() != load_scene(DRUM).to_yaml()


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


@pytest.mark.parametrize(("text", "value"), [
    ("012", 12), ("0o14", 12), ("0x1F", 31), ("1e-5", 1e-5), ("1E5", 1e5), (".5", 0.5), ("-4.", -4.0),
    ("+3", 3), ("true", True), ("False", False), ("yes", "yes"), ("no", "no"), ("on", "on"), ("null", None),
    ("~", None), ("none", "none"), ("1:30", "1:30"), ("1_000", "1_000"), ("2020-01-01", "2020-01-01"),
    ("'1e-5'", "1e-5"), (".inf", math.inf), ("-.INF", -math.inf), ("4 mm", "4 mm"), ("1" * 500, math.inf)
], ids=lambda value: str(value)[:20])  # fmt: skip
def test_scalars_have_their_yaml_1_2_type(text, value):
    data = parse(f"key: {text}", "file").root.data()["key"]
    assert data == value and type(data) is type(value)


def test_keys_values_and_duplicates_have_positions_and_aliases_are_resolved():
    document = parse("a:\n  - b: &x 1\n    c: [2, {d: *x}]\na: 3\nc: .nan\nc: 4\n", "file")
    data = document.root.data()
    assert data["a"] == [{"b": 1, "c": [2, {"d": 1}]}] and math.isnan(data["c"])
    assert str(document.key_position(("a",))) == "file:1:1"
    assert str(document.key_position(("a", 0, "c"))) == "file:3:5"
    assert document.where(("a", 0, "c", 1, "x", "y")) == "file:3"
    assert [str(problem.position) for problem in document.problems] == ["file:4:1", "file:6:1"]
